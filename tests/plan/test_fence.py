"""Plans inside a fence: bent where the flux would take a vehicle out, refused only where nothing fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fg_gcs.core.coverage import flux_metric
from fg_gcs.core.formation import Pose
from fg_gcs.core.separation import Fence
from fg_gcs.errors import PlanError
from fg_gcs.plan.flux_guided import plan_path
from fg_gcs.plan.path.poses import Poses
from fg_gcs.plan.path.rigid_path import PosePath
from fg_gcs.plan.search.rigid import furthest_outside
from tests.plan.scenes import PAPER, compiled, task

FLOOR = Fence((-60.0, -60.0, 3.0), (60.0, 60.0, 60.0))


@pytest.mark.parametrize("target", [(20, 5, 4), (-20, 5, 4), (20, 5, 5), (-20, 0, 3.6), (0, 25, 3.5), (30, -30, 4.5)])
def test_a_target_near_the_floor_is_surrounded_from_above(target: tuple[float, float, float]) -> None:
    made = task(target)
    free = plan_path(PAPER, made.start, made.target_enu_m, 0.25)
    assert min(PAPER.place(pose)[:, 2].min() for pose in free.poses) < 3.0  # there is something to bend
    flight = compiled(replace(made, rules=replace(made.rules, fence=FLOOR)))
    sample = flight.approach.sample(np.linspace(0.0, flight.approach.duration_s, 2000)).position_m
    assert sample[:, :, 2].min() >= 3.0
    rim = sample[-1:][:, flight.rim_of]
    assert flux_metric(rim, made.target_enu_m)[0] >= 0.999
    assert flight.separation.distance_m >= 1.5


def test_the_compiled_excess_over_a_box_is_that_of_the_fence() -> None:
    for seed in range(30):
        draw = np.random.default_rng(seed)
        low, high = np.sort(draw.uniform(-20.0, 20.0, (2, 3)), axis=0)
        poses = [
            Pose(draw.uniform(-20.0, 20.0, 3), Rotation.random(rng=draw).as_matrix(), float(draw.uniform(0.5, 2.0)))
            for _ in range(3)
        ]
        fence = Fence((float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2])))
        expected = max(float(fence.excess_m(PAPER.place(pose)).max()) for pose in poses)
        assert furthest_outside(Poses.of(poses).rows, PAPER.slots_m, low, high) == pytest.approx(expected)


def test_a_ceiling_and_a_wall_bend_the_path_too() -> None:
    for target, fence in (
        ((20.0, 5.0, 17.5), Fence((-60.0, -60.0, 3.0), (60.0, 60.0, 18.5))),
        ((20.0, 5.0, 12.0), Fence((-60.0, -60.0, 3.0), (60.0, 6.5, 60.0))),
    ):
        made = task(target)
        flight = compiled(replace(made, rules=replace(made.rules, fence=fence)))
        sample = flight.approach.sample(np.linspace(0.0, flight.approach.duration_s, 2000)).position_m
        assert fence.excess_m(sample).max() <= 0.0


def test_random_targets_inside_random_fences_never_leave_them() -> None:
    draw = np.random.default_rng(5)
    refused = 0
    for _ in range(80):
        low = np.array([-30.0, -30.0, 3.0])
        high = np.array([*draw.uniform(10, 40, 2), draw.uniform(20, 40)])
        target = draw.uniform(low + np.array([1.0, 1.0, 0.6]), high - 1.0)
        made = task((float(target[0]), float(target[1]), float(target[2])))
        fence = Fence((-30.0, -30.0, 3.0), (float(high[0]), float(high[1]), float(high[2])))
        try:
            path = plan_path(PAPER, made.start, target, 0.25, fence=fence)
        except PlanError:
            refused += 1
            continue
        assert max(float(fence.excess_m(PAPER.place(pose)).max()) for pose in path.poses) <= 1e-9
    assert refused <= 8  # corners, where no attitude fits


@pytest.mark.parametrize(("last", "above_m"), [(0.4, 0.7), (1.6, 2.0)])
def test_a_formation_that_changes_its_scale_stays_inside_too(last: float, above_m: float) -> None:
    draw = np.random.default_rng(int(10 * last))
    low, high = np.array(FLOOR.low_enu_m), np.array(FLOOR.high_enu_m)
    bent = 0
    for _ in range(40):
        target = draw.uniform(low + above_m, np.array([40.0, 40.0, low[2] + 2.0 * above_m]))
        made = task((float(target[0]), float(target[1]), float(target[2])))
        try:
            path = plan_path(PAPER, made.start, target, 0.25, last, FLOOR)
        except PlanError as error:
            assert "does not fit" in str(error)  # noqa: PT017 (some may be refused, for this)
            continue
        free = plan_path(PAPER, made.start, target, 0.25, last)
        bent += len(free.poses) != len(path.poses)
        body = PosePath(PAPER.slots_m, path.poses)
        places = body.at(np.linspace(0.0, body.length_m, 1000)).position_m
        assert (places >= low - 1e-9).all()
        assert (places <= high + 1e-9).all()
        assert path.poses[-1].scale == last
    assert bent >= 10


def test_what_cannot_fit_is_refused_with_the_smallest_change() -> None:
    made = task((20.0, 5.0, 3.1))
    with pytest.raises(
        PlanError, match=r"does not fit around the target \(20, 5, 3\.1\) inside the fence: .* 0\.\d\d m outside"
    ):
        plan_path(PAPER, made.start, made.target_enu_m, 0.25, fence=FLOOR)
