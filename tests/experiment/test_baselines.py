from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from fg_gcs.core import solid_angle
from fg_gcs.core.arrays import Array
from fg_gcs.errors import PlanError
from fg_gcs.experiment.baselines.least_squares import FREE_SIZE, HELD_SIZE, Baseline, plan_least_squares
from fg_gcs.experiment.baselines.reference_planner import (
    THINNED_M,
    central_gradient,
    face_flux,
    place_followers,
    plan_leaders,
    plan_swarm,
    thinned,
)
from fg_gcs.experiment.scenes import LIMITS, Scene, scene
from fg_gcs.plan.limits import Limits

FRONT, BEHIND = (50.0, 50.0, 50.0), (-50.0, 50.0, 50.0)


def edges(leaders: Array) -> Array:
    return np.asarray(np.linalg.norm(leaders - np.roll(leaders, -1, axis=-2), axis=-1), dtype=float)


@pytest.mark.parametrize(
    ("target_m", "baseline", "authors_m"),
    [(FRONT, FREE_SIZE, 455.6), (FRONT, HELD_SIZE, 344.0), (BEHIND, FREE_SIZE, 499.7), (BEHIND, HELD_SIZE, 543.0)],
)
def test_least_squares_has_the_lengths_of_the_authors_program(
    target_m: tuple[float, float, float], baseline: Baseline, authors_m: float
) -> None:
    made = scene(target_m)
    path = plan_least_squares(made.leaders_enu_m, made.target_enu_m, baseline)
    assert path.length_m == pytest.approx(authors_m, abs=0.5)  # one of the four is known to the metre only


@pytest.mark.parametrize("baseline", [FREE_SIZE, HELD_SIZE])
def test_least_squares_ends_with_the_first_iterate_that_is_near_enough(baseline: Baseline) -> None:
    made = scene((10.0, 10.0, 10.0))
    path = plan_least_squares(made.leaders_enu_m, made.target_enu_m, baseline)
    distance_m = np.linalg.norm(path.leaders_enu_m.mean(axis=1) - made.target_enu_m, axis=1)
    assert (distance_m >= baseline.stop_m).all()
    assert np.linalg.norm(path.end_enu_m.mean(axis=0) - made.target_enu_m) < baseline.stop_m
    assert np.array_equal(path.leaders_enu_m[0], made.leaders_enu_m)


def test_least_squares_steps_solve_the_papers_linear_problem() -> None:
    made = scene((12.0, -7.0, 5.0))
    path = plan_least_squares(made.leaders_enu_m, made.target_enu_m, HELD_SIZE).leaders_enu_m
    differences = np.array([[1, -1, 0, 0], [0, 1, -1, 0], [0, 0, 1, -1], [-1, 0, 0, 1]], dtype=float)
    held = np.kron(differences.T @ differences, np.eye(3))
    for before, after in pairwise(path[:21]):
        slope = solid_angle.gradient(before, made.target_enu_m).ravel()
        reference = np.exp(0.1 * float(solid_angle.flux(before, made.target_enu_m)))
        matrix = np.eye(12) + 1000.0 * np.outer(slope, slope) + 400.0 * held
        residual = matrix @ (after - before).ravel() - 1000.0 * reference * slope
        assert np.abs(residual).max() < 1e-9 * np.abs(1000.0 * slope).max()


def test_the_weight_of_the_size_holds_the_size() -> None:
    made = scene(FRONT)
    free, held = (
        plan_least_squares(made.leaders_enu_m, made.target_enu_m, each).leaders_enu_m[-1]
        for each in (FREE_SIZE, HELD_SIZE)
    )
    assert edges(free).min() > 50.0
    assert edges(held).max() < 8.0


def test_least_squares_says_when_it_does_not_arrive() -> None:
    made = scene(FRONT)
    with pytest.raises(PlanError, match="after 4 steps"):
        plan_least_squares(made.leaders_enu_m, made.target_enu_m, HELD_SIZE, max_steps=3)


@pytest.mark.parametrize("last_edge_m", [5.0, 8.0])
def test_the_papers_way_ends_around_the_target_with_equal_edges(last_edge_m: float) -> None:
    made = Scene("near", np.array([10.0, 10.0, 10.0]), 5.0, last_edge_m)
    path = plan_leaders(made.leaders_enu_m, made.target_enu_m, made.last_edge_m)
    end = path.leaders_enu_m[-1]
    assert edges(end) == pytest.approx(np.full(4, last_edge_m), rel=0.01)  # general tools hold their constraints so far
    assert np.linalg.norm(end.mean(axis=0) - made.target_enu_m) < 0.2 * last_edge_m
    assert path.length_m > 4.0 * np.linalg.norm(end.mean(axis=0) - made.leaders_enu_m.mean(axis=0)) * 0.99


def test_the_papers_way_times_every_vehicle_within_its_boxes() -> None:
    made = scene((10.0, 10.0, 10.0))
    path = plan_leaders(made.leaders_enu_m, made.target_enu_m, made.last_edge_m)
    plan = plan_swarm(path, made.formation, LIMITS)
    assert len(plan.vehicles) == 9
    time_s = np.linspace(0.0, plan.duration_s, 500)
    for vehicle in plan.vehicles:
        inside = np.clip(time_s, 0.0, vehicle.duration)
        assert np.abs(vehicle(inside, 1)).max() < 1.001 * LIMITS.speed_m_s
    assert plan.norms(time_s, 2).max() > 1.1 * LIMITS.acceleration_m_s2  # boxes are not norms: what the notes say


def test_an_empty_box_leaves_no_timing() -> None:
    made = scene((10.0, 10.0, 10.0))
    path = plan_leaders(made.leaders_enu_m, made.target_enu_m, made.last_edge_m)
    with pytest.raises(PlanError, match="vehicle 1"):
        plan_swarm(path, made.formation, Limits(LIMITS.speed_m_s, -1.0))


def test_the_flux_of_two_triangles_and_its_differences_are_the_closed_forms() -> None:
    random = np.random.default_rng(7)
    for _ in range(50):
        leaders = scene(FRONT).leaders_enu_m + random.normal(0.0, 0.2, (4, 3))
        target = random.uniform(-20.0, 20.0, 3) + np.array([30.0, 0.0, 0.0])
        assert face_flux(leaders, target) == pytest.approx(float(solid_angle.flux(leaders, target)), abs=1e-12)

        def flux(places: Array, target: Array = target) -> float:
            return face_flux(places.reshape(4, 3), target)

        closed = solid_angle.gradient(leaders, target).ravel()
        assert central_gradient(flux, leaders.ravel()) == pytest.approx(closed, abs=1e-8)  # rounding over the span


def test_thinning_keeps_both_ends_and_the_distance() -> None:
    made = scene(BEHIND)
    way = made.leaders_enu_m + np.linspace(0.0, 20.0, 101)[:, None, None] * np.array([1.0, 0.0, 0.0])
    kept = thinned(way)
    steps_m = np.linalg.norm(np.diff(kept.mean(axis=1), axis=0), axis=1)
    assert np.array_equal(kept[[0, -1]], way[[0, -1]])
    assert steps_m.min() >= THINNED_M - 1e-9
    assert steps_m.max() < 2.0 * THINNED_M


def test_followers_stand_where_the_formation_puts_them() -> None:
    made = scene(FRONT)
    placed = place_followers(made.leaders_enu_m[None], made.formation, made.edge_m)
    assert placed[0] == pytest.approx(made.formation.place(made.start), abs=1e-12)
    twice = place_followers(2.0 * made.leaders_enu_m[None], made.formation, 2.0 * made.edge_m)
    assert twice == pytest.approx(2.0 * placed, abs=1e-12)
