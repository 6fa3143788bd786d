"""Whole plans for targets that are more than a point, and by either formulation."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import flux_metric
from fg_gcs.core.separation import smallest_over_time
from fg_gcs.errors import PlanError
from fg_gcs.plan.flight_plan import FlightPlan, Task
from fg_gcs.plan.formulations import FORMULATIONS, FormulationName
from fg_gcs.plan.targets import Charges, Target, centre_of_charge
from tests.plan.scenes import PAPER, compiled, task

POINTS = np.array([(10.0, 10.0, 20.0), (14.0, 6.0, 22.0), (12.0, 12.0, 25.0)])


def samples(plan: FlightPlan) -> Array:
    return plan.approach.sample(np.linspace(0.0, plan.approach.duration_s, 1500)).position_m


def holds_its_rules(plan: FlightPlan, made: Task) -> None:
    """Limits, fence and separation, seen in samples of each part; and that the parts join."""
    parts = (plan.gather, plan.approach, plan.home)
    for part in parts:
        position, velocity, acceleration = part.sample(np.linspace(0.0, part.duration_s, 1500))
        assert np.linalg.norm(velocity, axis=2).max() <= made.rules.limits.speed_m_s
        assert np.linalg.norm(acceleration, axis=2).max() <= made.rules.limits.acceleration_m_s2
        assert made.rules.fence.excess_m(position).max() <= 1e-6
        assert smallest_over_time(position).min() >= max(part.separation.distance_m - 1e-3, made.rules.separation_m)
    for before, after in pairwise(parts):
        ends = before.sample(np.array([before.duration_s])).position_m
        assert ends == pytest.approx(after.sample(np.zeros(1)).position_m, abs=1e-6)


@pytest.mark.parametrize("name", sorted(FORMULATIONS))
def test_either_formulation_makes_a_whole_flight(name: FormulationName) -> None:
    for target in ((10.0, 10.0, 20.0), (-20.0, 5.0, 30.0)):
        made = replace(task(target), formulation=name)
        plan = compiled(made)
        holds_its_rules(plan, made)
        assert plan.figures.last_scale == 1.0
        assert plan.figures.iterates > 0
        assert plan.figures.flux_metric >= 0.999
        assert sorted(plan.slot_of.tolist()) == list(range(9))


@pytest.mark.parametrize("radius_m", [2.2, 2.5, 6.0, 15.0])
def test_the_circle_inscribed_in_the_face_around_the_target_has_its_radius(radius_m: float) -> None:
    made = replace(task(), target=Target.ball((10.0, 10.0, 30.0), radius_m))
    plan = compiled(made)
    holds_its_rules(plan, made)
    assert plan.figures.last_scale == pytest.approx(radius_m / 2.5)  # half the paper's edge of 5 m
    rim = samples(plan)[-1, plan.rim_of]
    middles = 0.5 * (rim + np.roll(rim, -1, axis=0))
    assert np.linalg.norm(middles - rim.mean(axis=0), axis=1) == pytest.approx(np.full(4, radius_m))
    assert plan.figures.flux_metric >= 0.999
    begin = samples(plan)[0, plan.rim_of]
    assert np.linalg.norm(begin - np.roll(begin, -1, axis=0), axis=1) == pytest.approx(np.full(4, 5.0))


def test_a_formation_that_would_shrink_below_the_separation_has_no_plan() -> None:
    with pytest.raises(PlanError, match=r"would come within 1\.46 m of each other"):
        compiled(replace(task(), target=Target.ball((10.0, 10.0, 20.0), 2.0)))


def test_several_targets_are_surrounded_at_their_centre_of_charge_both_ways() -> None:
    centre = centre_of_charge(POINTS)
    for target in (centre, Target(Charges(POINTS, np.ones(3)), centre.radius_m)):
        made = replace(task(), target=target)
        plan = compiled(made)
        holds_its_rules(plan, made)
        assert plan.figures.last_scale == pytest.approx(centre.radius_m / 2.5)
        rim = samples(plan)[-1, plan.rim_of]
        away_m = np.linalg.norm(rim.mean(axis=0) - POINTS.mean(axis=0))
        assert away_m == pytest.approx(made.hold_depth_m, abs=1e-6)
        assert flux_metric(rim[None], POINTS.mean(axis=0))[0] >= 0.999
        within_m = np.linalg.norm(rim - rim.mean(axis=0), axis=1).min()
        assert np.linalg.norm(POINTS - rim.mean(axis=0), axis=1).max() <= within_m


def test_weights_move_the_place_that_charges_are_surrounded_at() -> None:
    ends = []
    for weights in ([1.0, 1.0, 1.0], [5.0, 1.0, 1.0]):
        plan = compiled(replace(task(), target=Target(Charges(POINTS, np.array(weights)))))
        ends.append(samples(plan)[-1, plan.rim_of].mean(axis=0))
    light_m, heavy_m = (np.linalg.norm(end - POINTS[0]) for end in ends)
    assert heavy_m < light_m


def test_the_free_formulation_names_the_other_for_what_it_cannot_do() -> None:
    made = replace(task(), formulation="free")
    for target in (Target.ball((10.0, 10.0, 20.0), 5.0), Target(Charges(POINTS, np.ones(3)))):
        with pytest.raises(PlanError, match=r'use formulation = "rigid"'):
            compiled(replace(made, target=target))
    with pytest.raises(PlanError, match=r'outside the fence .* use formulation = "rigid"'):
        compiled(replace(made, target=Target.ball((20.0, 5.0, 4.0))))


def test_the_number_of_vehicles_must_be_that_of_the_slots() -> None:
    with pytest.raises(PlanError, match="9 slots, but there are 2 vehicles"):
        compiled(task(formation=PAPER), np.array([(0.0, 0.0, 4.0), (3.0, 0.0, 4.0)]))
