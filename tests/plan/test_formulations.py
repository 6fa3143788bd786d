"""Both formulations behind one interface: what every one of them gives, and what the free one refuses."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import flux_metric
from fg_gcs.core.formation import Pose, hemisphere
from fg_gcs.core.separation import Fence
from fg_gcs.errors import PlanError
from fg_gcs.plan.compiled import build, is_built
from fg_gcs.plan.formulations import FORMULATIONS, FormulationName
from fg_gcs.plan.free import plan_leaders
from fg_gcs.plan.path.leader_paths import LeadersPath
from fg_gcs.plan.targets import Charges
from tests.plan.scenes import PAPER, START

OPEN = Fence((-999.0, -999.0, -999.0), (999.0, 999.0, 999.0))
BEHIND = np.array([-10.0, 10.0, 10.0])
NAMES = sorted(FORMULATIONS)


def test_every_name_has_its_formulation() -> None:
    assert set(get_args(FormulationName)) == set(FORMULATIONS)


@pytest.mark.parametrize("name", NAMES)
def test_a_formulation_once_built_is_in_the_cache(name: FormulationName) -> None:
    build([name])
    assert is_built([name])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("target", [(10.0, 10.0, 10.0), (-10.0, 10.0, 10.0), (-40.0, 2.5, 2.5)])
def test_each_goes_from_the_start_to_a_hold_with_every_vehicle_in_its_own_slot(
    name: FormulationName, target: tuple[float, float, float]
) -> None:
    source, goal_of = np.array(target), np.random.default_rng(4).permutation(9)
    found = FORMULATIONS[name](PAPER, START, source, 0.25, 1.0, OPEN)
    path = found.swarm_path(goal_of)
    assert found.iterates > 0
    assert path.vehicles == 9
    begin, end = path.at(np.array([0.0, path.length_m])).position_m
    assert begin == pytest.approx(PAPER.place(START)[goal_of], abs=1e-9)
    slots = np.empty((9, 3))
    slots[goal_of] = end  # vehicle v has brought slot goal_of[v]
    assert pdist(slots) == pytest.approx(pdist(PAPER.slots_m), abs=1e-6)
    assert flux_metric(slots[None, :4], source)[0] >= 0.999
    normal = np.cross(slots[1] - slots[0], slots[2] - slots[0])
    assert slots[:4].mean(axis=0) - source == pytest.approx(0.25 * normal / np.linalg.norm(normal), abs=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_the_closest_pair_is_told_by_vehicles(name: FormulationName) -> None:
    goal_of = np.random.default_rng(5).permutation(9)
    path = FORMULATIONS[name](PAPER, START, BEHIND, 0.25, 1.0, OPEN).swarm_path(goal_of)
    distance_m, s_m, (one, other) = path.closest()
    assert one < other
    places = path.at(np.array([s_m])).position_m[0]
    assert np.linalg.norm(places[one] - places[other]) == pytest.approx(distance_m, abs=1e-4)
    dense = path.at(np.linspace(0.0, path.length_m, 2000)).position_m
    assert min(pdist(each).min() for each in dense) >= distance_m - 1e-4


def test_a_free_path_in_other_slots_is_the_same_path_by_other_vehicles() -> None:
    found, goal_of = plan_leaders(PAPER, START, BEHIND), np.random.default_rng(6).permutation(9)
    own, other = LeadersPath(PAPER, found), LeadersPath(PAPER, found, goal_of)
    s_m = np.linspace(0.0, own.length_m, 50)
    for here, there in zip(own.at(s_m), other.at(s_m), strict=True):
        assert np.array_equal(here[:, goal_of], there)
    assert own.outline is own


def test_the_outline_of_many_followers_bounds_them_all() -> None:
    formation = hemisphere(70, 71, 2.0)
    path = LeadersPath(formation, plan_leaders(formation, START, np.array([-150.0, 60.0, 90.0])))
    outline = path.outline
    assert (path.vehicles, outline.vehicles) == (141, 82)
    assert outline.outline is outline
    assert (outline.length_m, outline.closest()) == (path.length_m, path.closest())
    s_m = np.linspace(0.0, path.length_m, 400)
    draw = np.random.default_rng(7)
    whole, few = path.at(s_m), outline.at(s_m)
    for rate, growth in draw.normal(size=(20, 2)):
        for of_whole, of_few in (
            (whole.first * rate, few.first * rate),
            (
                whole.first * growth + whole.second * rate**2,
                few.first * growth + few.second * rate**2,
            ),
        ):
            bound = np.linalg.norm(of_few, axis=2).max(axis=1)
            assert (np.linalg.norm(of_whole, axis=2).max(axis=1) <= bound + 1e-9).all()
    assert (whole.position_m.max(axis=1) <= few.position_m.max(axis=1) + 1e-9).all()
    assert (whole.position_m.min(axis=1) >= few.position_m.min(axis=1) - 1e-9).all()


CHARGES = Charges(np.array([(9.0, 2.0, 3.0), (12.0, 0.0, 1.0)]), np.ones(2))


@pytest.mark.parametrize(
    ("source", "last_scale", "fence", "said"),
    [
        (CHARGES, 1.0, OPEN, 'one source, not by 2; use formulation = "rigid"'),
        (BEHIND, 2.0, OPEN, "cannot change the formation's size.*2.00 times.*use formulation"),
        (BEHIND, np.nan, OPEN, "cannot change the formation's size.*use formulation"),
        (
            BEHIND,
            1.0,
            Fence((-99.0, -99.0, -0.5), (99.0, 99.0, 99.0)),
            'm outside the fence.*use formulation = "rigid"',
        ),
    ],
)
def test_the_free_one_says_what_it_cannot_do_and_what_can(
    source: Array | Charges, last_scale: float, fence: Fence, said: str
) -> None:
    with pytest.raises(PlanError, match=said):
        FORMULATIONS["free"](PAPER, START, source, 0.25, last_scale, fence)


def test_the_rigid_one_can_what_the_free_one_cannot() -> None:
    grown = FORMULATIONS["rigid"](PAPER, START, BEHIND, 0.25, 2.0, OPEN).swarm_path(np.arange(9))
    end = grown.at(np.array([grown.length_m])).position_m[0]
    assert pdist(end) == pytest.approx(2.0 * pdist(PAPER.slots_m))
    fence = Fence((-99.0, -99.0, -0.5), (99.0, 99.0, 99.0))
    bent = FORMULATIONS["rigid"](PAPER, START, BEHIND, 0.25, 1.0, fence).swarm_path(np.arange(9))
    assert fence.excess_m(bent.at(np.linspace(0.0, bent.length_m, 1000)).position_m).max() <= 0.0
    around = FORMULATIONS["rigid"](PAPER, START, CHARGES, 0.25, 1.0, OPEN).swarm_path(np.arange(9))
    rim = around.at(np.array([around.length_m])).position_m[:, :4]
    assert flux_metric(rim, CHARGES.centre_enu_m)[0] >= 0.999


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "start",
    [
        Pose(np.array([np.nan, 0.0, 0.0]), np.eye(3)),
        Pose(np.array([0.0, np.inf, 0.0]), np.eye(3)),
        Pose(np.zeros(2), np.eye(3)),
        Pose(np.zeros(3), np.full((3, 3), np.nan)),
        Pose(np.zeros(3), np.zeros((3, 3))),
        Pose(np.zeros(3), -np.eye(3)),  # a mirror
        Pose(np.zeros(3), np.eye(2)),
        Pose(np.zeros(3), 2.0 * np.eye(3)),  # a scale belongs into the pose's scale
        Pose(np.zeros(3), np.eye(3), 0.0),
        Pose(np.zeros(3), np.eye(3), -1.0),
        Pose(np.zeros(3), np.eye(3), np.nan),
        Pose(np.zeros(3), np.eye(3), np.inf),
    ],
    ids=lambda start: " ".join(f"{start}".split()),
)
def test_a_start_that_is_none_is_refused(name: FormulationName, start: Pose) -> None:
    with pytest.raises(PlanError):
        FORMULATIONS[name](PAPER, start, BEHIND, 0.25, start.scale, OPEN)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("target", [(np.nan, 0.0, 0.0), (0.0, 0.0, -np.inf)])
def test_a_target_that_is_none_is_refused(name: FormulationName, target: tuple[float, float, float]) -> None:
    with pytest.raises(PlanError, match="finite"):
        FORMULATIONS[name](PAPER, START, np.array(target), 0.25, 1.0, OPEN)


@pytest.mark.parametrize("name", NAMES)
def test_any_attitude_is_a_start(name: FormulationName) -> None:
    for seed in range(20):
        draw = np.random.default_rng(seed)
        start = Pose(draw.normal(size=3) * 5, Rotation.random(rng=draw).as_matrix(), draw.uniform(0.5, 2.0))
        target = draw.uniform(-50.0, 50.0, 3)
        path = FORMULATIONS[name](PAPER, start, target, 0.25, start.scale, OPEN).swarm_path(np.arange(9))
        assert path.at(np.zeros(1)).position_m[0] == pytest.approx(PAPER.place(start), abs=1e-9)
