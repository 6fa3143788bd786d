from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from fg_gcs.core.formation import Pose
from fg_gcs.core.separation import Fence
from fg_gcs.errors import PlanError
from fg_gcs.plan.flux_guided import plan_path
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.paths import LinePath, SwarmPath
from fg_gcs.plan.rigid_path import PosePath, ball_points
from fg_gcs.plan.timing import time_optimal
from fg_gcs.plan.trajectory import BLEND_S, check, timed
from tests.plan.scenes import LIMITS, PAPER, START, compiled, task, tops

WIDE = Rules(LIMITS, 1.5, Fence((-1e4, -1e4, -1e4), (1e4, 1e4, 1e4)))


def approach(target: tuple[float, float, float]) -> PosePath:
    return PosePath(PAPER.slots_m, plan_path(PAPER, START, np.array(target)).poses)


def line(distance_m: float) -> LinePath:
    places = np.array([(0.0, 0, 10), (0, 5, 10), (0, 10, 10)])
    return LinePath(places, places + np.array([distance_m, 0.0, 0.0]))


@pytest.mark.parametrize("path", [approach((10, 10, 10)), approach((-20, 20, 20)), line(30.0)])
def test_path_derivatives_are_finite_differences(path: SwarmPath) -> None:
    step = 1e-5
    s = np.linspace(0.3, path.length_m - 0.3, 50)
    at, before, after = path.at(s), path.at(s - step), path.at(s + step)
    assert np.abs(at.first - (after.position_m - before.position_m) / (2 * step)).max() < 1e-6
    assert np.abs(at.second - (after.first - before.first) / (2 * step)).max() < 1e-6


def test_a_pose_path_is_rigid_between_its_poses_and_passes_through_them() -> None:
    poses = plan_path(PAPER, START, np.array([-20.0, 20.0, 20.0])).poses
    path = PosePath(PAPER.slots_m, poses)
    for positions in path.at(np.linspace(0.0, path.length_m, 97)).position_m:
        assert pdist(positions) == pytest.approx(pdist(PAPER.slots_m), rel=1e-9)
    assert path.at(np.zeros(1)).position_m[0] == pytest.approx(PAPER.place(poses[0]))
    assert path.at(np.array([path.length_m])).position_m[0] == pytest.approx(PAPER.place(poses[-1]))


@pytest.mark.parametrize(("distance_m", "optimum_s"), [(2.0, 2 * np.sqrt(2 / 5)), (66.4, 66.4 / 10 + 10 / 5)])
def test_a_straight_line_takes_the_bang_bang_time(distance_m: float, optimum_s: float) -> None:
    flown_s = timed(line(distance_m), LIMITS).duration_s
    assert optimum_s + BLEND_S <= flown_s <= optimum_s * 1.02 + BLEND_S  # what continuous acceleration costs


@pytest.mark.parametrize(
    "limits", [LIMITS, Limits(10.0, 2.5, 2.5, 1.5), Limits(3.0, 9.0), Limits(20.0, 1.0, 0.5, 20.0)]
)
@pytest.mark.parametrize("target", [(10, 10, 10), (-10, 10, 10), (40, 40, 40), (-40, 2.5, 2.5), (0.4, 2.5, 2.5)])
def test_every_limit_holds_at_a_kilohertz(limits: Limits, target: tuple[float, float, float]) -> None:
    flight = timed(approach(target), limits)
    sample = flight.sample(np.arange(0.0, flight.duration_s, 1e-3))
    speed = np.linalg.norm(sample.velocity_m_s, axis=2)
    acceleration = np.linalg.norm(sample.acceleration_m_s2, axis=2)
    assert speed.max() <= limits.speed_m_s * 1.0001
    assert acceleration.max() <= limits.acceleration_m_s2 * 1.0001
    assert sample.velocity_m_s[:, :, 2].max() <= limits.climb_m_s * 1.0001
    assert -sample.velocity_m_s[:, :, 2].min() <= limits.descent_m_s * 1.0001
    assert max(speed.max() / limits.speed_m_s, acceleration.max() / limits.acceleration_m_s2) > 0.3  # not idling


def test_samples_are_each_others_derivatives() -> None:
    flight = timed(approach((-20, 20, 20)), LIMITS)
    times = np.linspace(0.0, flight.duration_s, 20001)
    step = times[1]
    sample = flight.sample(times)
    mean_velocity = (sample.velocity_m_s[1:] + sample.velocity_m_s[:-1]) / 2
    assert np.abs(np.diff(sample.position_m, axis=0) / step - mean_velocity).max() < 1e-3
    mean_acceleration = (sample.acceleration_m_s2[1:] + sample.acceleration_m_s2[:-1]) / 2
    assert np.abs(np.diff(sample.velocity_m_s, axis=0) / step - mean_acceleration).max() < 2e-2
    assert np.abs(np.diff(sample.acceleration_m_s2, axis=0)).max() < 0.1  # continuous: no step from cell to cell


@pytest.mark.parametrize("jerk", [5.0, 20.0, 60.0])
def test_jerk_is_bounded_where_a_limit_is_given(jerk: float) -> None:
    flight = timed(approach((-10, 10, 10)), replace(LIMITS, jerk_m_s3=jerk))
    times = np.arange(0.0, flight.duration_s, 1e-3)
    growth = np.diff(flight.sample(times).acceleration_m_s2, axis=0) / 1e-3
    largest = np.linalg.norm(growth, axis=2).max()
    assert largest <= jerk * 1.02
    assert largest >= 0.3 * jerk


def test_a_trajectory_rests_before_and_after() -> None:
    flight = timed(line(5.0), LIMITS)
    outside = flight.sample(np.array([-3.0, flight.duration_s + 3.0]))
    assert not outside.velocity_m_s.any()
    assert not outside.acceleration_m_s2.any()
    assert outside.position_m[1] - outside.position_m[0] == pytest.approx(np.tile([5.0, 0, 0], (3, 1)))


def test_a_path_too_sharp_to_fly_is_an_error_with_a_reason() -> None:
    with pytest.raises(PlanError, match="limits"):
        time_optimal(line(5.0), Limits(1e-9, 5.0))


def test_turning_in_place_is_a_path_too() -> None:
    turned = Pose(START.centre_enu_m, START.rotation @ Rotation.from_rotvec([0.0, 0.0, 2.0]).as_matrix())
    between = Pose(START.centre_enu_m, START.rotation @ Rotation.from_rotvec([0.0, 0.0, 1.0]).as_matrix())
    flight = timed(PosePath(PAPER.slots_m, [START, between, turned]), LIMITS)
    assert flight.sample(np.array([flight.duration_s])).position_m[0] == pytest.approx(PAPER.place(turned))


def test_the_check_refuses_what_breaks_a_rule_and_says_which() -> None:
    gaze = np.zeros(3)
    flight = timed(line(5.0), LIMITS)
    assert check([flight], WIDE, gaze).separation.distance_m == pytest.approx(5.0)
    with pytest.raises(PlanError, match=r"vehicles 1 and 2 would come within 5\.00 m .*minimum 6\.00 m"):
        check([flight], replace(WIDE, separation_m=6.0), gaze)
    with pytest.raises(PlanError, match=r"vehicle 1 would be 2\.00 m outside the fence at t=0\.0 s"):
        check([flight], replace(WIDE, fence=Fence((-9, -9, 12.0), (9, 99, 99))), gaze)
    with pytest.raises(PlanError, match="acceleration_m_s2"):
        check([flight], replace(WIDE, limits=Limits(10.0, 4.0)), gaze)


def test_noses_look_at_the_target_without_a_jump_right_below_it() -> None:
    plan = check([timed(line(20.0), LIMITS)], WIDE, np.array([10.0, 0.0, 30.0]))
    assert plan.yaw_rad(np.array([[0.0, 0, 10], [10, -9, 0], [20, 0, 0]])) == pytest.approx([np.pi / 2, 0, -np.pi / 2])
    assert np.isfinite(plan.yaw_rad(np.array([10.0, 0.0, 5.0])))


def test_a_whole_flight_is_continuous_and_ends_where_it_began() -> None:
    for target in ((10.0, 10.0, 20.0), (-10.0, 10.0, 20.0)):
        flight = compiled(task(target))
        legs = (flight.gather, flight.approach, flight.home)
        ends = [leg.sample(np.array([0.0, leg.duration_s])).position_m for leg in legs]
        assert ends[0][1] == pytest.approx(ends[1][0], abs=1e-9)
        assert ends[1][1] == pytest.approx(ends[2][0], abs=1e-9)
        home = ends[2][1]
        assert sorted(home.round(6).tolist()) == sorted(tops().tolist())
        assert flight.separation.distance_m >= 1.5
        for leg in legs:
            jumps = np.diff(leg.sample(np.linspace(0.0, leg.duration_s, 2001)).position_m, axis=0)
            assert np.abs(jumps).max() <= 10.0 * leg.duration_s / 2000 * 1.001


def test_the_rim_of_a_compiled_flight_is_the_formations_rim() -> None:
    flight = compiled()
    rim = flight.approach.sample(np.zeros(1)).position_m[0][flight.rim_of]
    assert rim == pytest.approx(PAPER.place(task().start)[:4])


def test_a_balls_points_enclose_the_ball_and_not_much_more() -> None:
    points = ball_points()
    directions = np.random.default_rng(0).normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    support = (directions @ points.T).max(axis=1)  # of the hull of the points, in every direction
    assert support.min() >= 1.0
    assert np.linalg.norm(points, axis=1).max() < 1.27


def test_a_thousand_followers_keep_every_limit_that_their_outline_keeps() -> None:
    draw = np.random.default_rng(2)
    behind = draw.normal(size=(1000, 3)) * np.array([2.0, 2.0, 2.0])
    behind[:, 0] = -np.abs(behind[:, 0])
    slots = np.concatenate((PAPER.leaders_m, behind))
    path = PosePath(slots, plan_path(PAPER, START, np.array([-10.0, 10.0, 10.0])).poses)
    flight = timed(path, LIMITS)
    sample = flight.sample(np.linspace(0.0, flight.duration_s, 400))
    assert np.linalg.norm(sample.velocity_m_s, axis=2).max() <= 10.0
    assert np.linalg.norm(sample.acceleration_m_s2, axis=2).max() <= 5.0
    survey = flight.survey
    assert (sample.position_m.min(axis=(0, 1)) >= survey.low_enu_m).all()
    assert (sample.position_m.max(axis=(0, 1)) <= survey.high_enu_m).all()
    assert flight.closest.distance_m == pytest.approx(pdist(slots).min())
