from __future__ import annotations

import re
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
from fg_gcs.plan.path.rigid_path import PosePath, ball_points
from fg_gcs.plan.path.swarm_path import LinePath, SwarmPath
from fg_gcs.plan.timing.profile import Profile
from fg_gcs.plan.timing.time_optimal import strictest, time_optimal
from fg_gcs.plan.trajectory import BLEND_S, Trajectory, timed
from fg_gcs.plan.verification import check
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


@pytest.mark.parametrize("target", [(10, 10, 10), (-20, 20, 20), (-40, 2.5, 2.5)])
def test_the_survey_misses_nothing_between_its_instants(target: tuple[float, float, float]) -> None:
    """Not even where the path passes a knot, where accelerations may peak without a step in the timing."""
    flight = timed(approach(target), LIMITS)
    sample = flight.sample(np.arange(0.0, flight.duration_s, 2.5e-4))
    peaks = flight.survey.peaks
    assert np.linalg.norm(sample.velocity_m_s, axis=2).max() <= peaks.speed_m_s * (1.0 + 1e-4)
    assert np.linalg.norm(sample.acceleration_m_s2, axis=2).max() <= peaks.acceleration_m_s2 * (1.0 + 1e-4)


def test_a_slower_trajectorys_survey_is_what_a_look_at_it_would_find() -> None:
    flight = timed(approach((-20, 20, 20)), replace(LIMITS, climb_m_s=3.0), 1.0, 0.5)
    slow = flight.slower(1.7)
    times = np.arange(0.0, slow.duration_s, 1e-3)
    sample = slow.sample(times)
    peaks = slow.survey.peaks
    assert np.linalg.norm(sample.velocity_m_s, axis=2).max() == pytest.approx(peaks.speed_m_s, rel=1e-4)
    assert np.linalg.norm(sample.acceleration_m_s2, axis=2).max() == pytest.approx(peaks.acceleration_m_s2, rel=1e-3)
    jerk = np.linalg.norm(np.diff(sample.acceleration_m_s2, axis=0), axis=2).max() / 1e-3
    assert jerk == pytest.approx(peaks.jerk_m_s3, rel=0.05)
    assert sample.velocity_m_s[:, :, 2].max() == pytest.approx(peaks.climb_m_s, rel=1e-4)
    assert -sample.velocity_m_s[:, :, 2].min() == pytest.approx(peaks.descent_m_s, rel=1e-3)
    ends = slow.sample(np.array([0.0, slow.duration_s])).velocity_m_s
    assert ends * 1.7 == pytest.approx(flight.sample(np.array([0.0, flight.duration_s])).velocity_m_s)


def test_a_trajectory_rests_before_and_after() -> None:
    flight = timed(line(5.0), LIMITS)
    outside = flight.sample(np.array([-3.0, flight.duration_s + 3.0]))
    assert not outside.velocity_m_s.any()
    assert not outside.acceleration_m_s2.any()
    assert outside.position_m[1] - outside.position_m[0] == pytest.approx(np.tile([5.0, 0, 0], (3, 1)))


MOVING = [
    (line(66.4), 4.0, 6.0),
    (line(66.4), 10.0, 10.0),
    (line(66.4), 0.0, 9.9),
    (line(2.0), 3.0, 0.0),
    (line(3.0), 10.0, 10.0),
    (approach((40, 40, 40)), 1.0, 0.0),
    (approach((40, 40, 40)), 0.0, 2.0),
    (approach((-20, 20, 20)), 1.5, 0.5),
    (approach((30, 2.5, 2.5)), 9.9, 0.0),
]


@pytest.mark.parametrize("jerk", [np.inf, 60.0])
@pytest.mark.parametrize(("path", "start_speed", "end_speed"), MOVING)
def test_moving_ends_have_their_speeds_and_all_between_is_smooth_and_within_limits(
    path: SwarmPath, start_speed: float, end_speed: float, jerk: float
) -> None:
    limits = replace(LIMITS, jerk_m_s3=jerk)
    flight = timed(path, limits, start_speed, end_speed)
    ends = flight.sample(np.array([0.0, flight.duration_s]))
    points = path.at(np.array([0.0, path.length_m]))
    speeds = np.array([start_speed, end_speed])[:, None, None]
    assert ends.position_m == pytest.approx(points.position_m, abs=1e-9)
    assert ends.velocity_m_s == pytest.approx(points.first * speeds, abs=1e-7)
    assert ends.acceleration_m_s2 == pytest.approx(points.second * speeds**2, abs=1e-6)  # no path acceleration
    times = np.arange(0.0, flight.duration_s, 1e-3)
    sample = flight.sample(times)
    assert np.linalg.norm(sample.velocity_m_s, axis=2).max() <= limits.speed_m_s * 1.0001
    assert np.linalg.norm(sample.acceleration_m_s2, axis=2).max() <= limits.acceleration_m_s2 * 1.0001
    mean_velocity = (sample.velocity_m_s[1:] + sample.velocity_m_s[:-1]) / 2
    assert np.abs(np.diff(sample.position_m, axis=0) / 1e-3 - mean_velocity).max() < 1e-3
    mean_acceleration = (sample.acceleration_m_s2[1:] + sample.acceleration_m_s2[:-1]) / 2
    assert np.abs(np.diff(sample.velocity_m_s, axis=0) / 1e-3 - mean_acceleration).max() < 0.1
    growth = np.linalg.norm(np.diff(sample.acceleration_m_s2, axis=0), axis=2).max() / 1e-3
    assert growth <= min(jerk * 1.02, 2.5 * limits.acceleration_m_s2 / BLEND_S)  # no step, at the ends neither


@pytest.mark.parametrize(("start_speed", "end_speed"), [(0.0, 0.0), (4.0, 6.0)])
def test_the_averaged_parameter_is_smooth_and_runs_from_end_to_end(start_speed: float, end_speed: float) -> None:
    window_s = 0.4
    leads_m = (0.5 * window_s * start_speed, 0.5 * window_s * end_speed)
    timing = time_optimal(line(30.0), LIMITS, start_speed, end_speed, leads_m)
    profile = Profile(timing, window_s)
    for slow, factor in ((profile, 1.0), (profile.slower(2.0), 2.0)):
        ends = np.array(slow.at(np.array([0.0, slow.duration_s])))
        assert ends[:, 0] == pytest.approx([0.0, start_speed / factor, 0.0], abs=1e-9)
        assert ends[:, 1] == pytest.approx([30.0, end_speed / factor, 0.0], abs=1e-9)
        times = np.linspace(0.0, slow.duration_s, 20001)
        s_m, rate, growth = slow.at(times)
        assert (np.diff(s_m) >= 0.0).all()
        assert np.abs(np.gradient(s_m, times)[1:-1] - rate[1:-1]).max() < 1e-5
        assert np.abs(np.gradient(rate, times)[1:-1] - growth[1:-1]).max() < 1e-2
        assert np.abs(np.diff(growth)).max() <= 2.0 * 5.0 / window_s * times[1] * 1.001  # what the window promises
        for share in (0.1, 0.5, 0.9):
            assert slow.at(np.array([slow.when(30.0 * share)]))[0][0] == pytest.approx(30.0 * share, abs=1e-9)
        instants = slow.instants(100.0)
        assert (np.diff(instants) > 0.0).all()
        assert instants[[0, -1]] == pytest.approx([0.0, slow.duration_s])
        assert np.diff(instants).max() <= factor / 100.0 * 1.001
        for knot_s in (*timing.time_s, *(timing.time_s + window_s)):  # where the jerk steps
            assert np.abs(instants - factor * knot_s).min() < 1e-9


def test_moving_ends_go_straight_on_outside_the_trajectory() -> None:
    flight = timed(approach((-20, 20, 20)), LIMITS, 1.5, 0.5)
    for first_s, last_s in ((-2.0, 0.0), (flight.duration_s + 2.0, flight.duration_s)):
        sample = flight.sample(np.array([first_s, last_s]))
        assert sample.velocity_m_s[0] == pytest.approx(sample.velocity_m_s[1])
        assert sample.position_m[0] == pytest.approx(
            sample.position_m[1] + (first_s - last_s) * sample.velocity_m_s[1], abs=1e-9
        )
        assert not sample.acceleration_m_s2[0].any()
        assert sample.velocity_m_s[0].any()


def test_what_blending_exceeds_is_mended_without_slowing_the_ends() -> None:
    """Blending smears the timing by up to half a metre here: where the path's bound dips, it runs over."""
    poses = plan_path(PAPER, START, np.array([-20.0, 20.0, 20.0])).poses
    mended = 0
    for first in range(0, len(poses) - 8, 2):
        path = PosePath(PAPER.slots_m, poses[first:])
        limits = Limits(10.0, 5.0, climb_m_s=2.0, jerk_m_s3=60.0)
        speed = 0.9 * strictest(path, np.linspace(0.0, 0.5, 9), limits).speed
        leads_m = (speed / 12.0, 0.0)  # half of the window of 1/6 s
        raw = Trajectory(path, Profile(time_optimal(path, limits, speed, 0.0, leads_m), 1.0 / 6.0))
        flight = timed(path, limits, speed)
        mended += raw.survey.peaks.climb_m_s > limits.climb_m_s * 1.00001
        assert flight.survey.peaks.climb_m_s <= limits.climb_m_s * 1.00001
        start = flight.sample(np.zeros(1)).velocity_m_s
        assert start == pytest.approx(path.at(np.zeros(1)).first * speed, abs=1e-7)
    assert mended > 0


def test_lowered_limits_are_approached_from_the_ends_speeds() -> None:
    way = line(66.4)
    cruise = Limits(5.0, 5.0)
    timing = time_optimal(way, LIMITS, 9.0, 8.0, cruise=cruise)
    assert timing.speed[[0, -1]] == pytest.approx([9.0, 8.0])
    assert timing.speed.min() == pytest.approx(5.0)
    assert timing.speed[(timing.s_m > 15.0) & (timing.s_m < 55.0)] == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("path", "start_speed", "end_speed", "reason"),
    [
        (line(66.4), -1.0, 0.0, "not negative"),
        (line(66.4), 0.0, np.nan, "finite"),
        (line(0.4), 10.0, 10.0, r"path of 0\.40 m is too short to blend .* takes 0\.50 m"),
        (line(0.0), 1.0, 0.0, r"path of 0\.00 m is too short"),
        (
            line(66.4),
            10.5,
            0.0,
            r"at 10\.50 m/s from 0\.00 m .*vehicle 1 may pass at 10 m/s .*speed_m_s 10.*start at 10\.00 m/s",
        ),
        (
            line(66.4),
            0.0,
            10.5,
            r"to 66\.40 m of its way.*vehicle 1 may pass at 10 m/s .*speed_m_s 10.*end at 10\.00 m/s",
        ),
        (
            line(5.0),
            9.0,
            0.0,
            r"vehicle 1 cannot brake from 9\.00 to 0\.00 m/s within 5\.0 m .*start at 6\.91 m/s or slower",
        ),
        (
            line(5.0),
            0.0,
            9.0,
            r"vehicle 1 cannot be at 9\.00 m/s yet .*acceleration_m_s2 5.*end at 6\.\d\d m/s or slower",
        ),
    ],
)
def test_ends_that_no_timing_has_are_errors_that_say_why(
    path: SwarmPath, start_speed: float, end_speed: float, reason: str
) -> None:
    with pytest.raises(PlanError, match=reason):
        timed(path, LIMITS, start_speed, end_speed)


def test_a_path_too_sharp_to_fly_is_an_error_with_a_reason() -> None:
    with pytest.raises(PlanError, match=r"stand on the way: at .* m of it vehicle 1 may pass at 1e-09 m/s .*speed_m_s"):
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
    with pytest.raises(PlanError, match=r"vehicles 1 and 2 .* 5\.00 m .*t=0\.0 s \(minimum 6\.00 m\).* by 1\.00 m"):
        check([flight], replace(WIDE, separation_m=6.0), gaze)
    with pytest.raises(PlanError, match=r"vehicle 1 would be 2\.00 m outside the fence at t=0\.0 s"):
        check([flight], replace(WIDE, fence=Fence((-9, -9, 12.0), (9, 99, 99))), gaze)


@pytest.mark.parametrize(
    ("limits", "change"),
    [
        (Limits(4.0, 5.0), r"of speed_m_s \(limit 4\.000\) .* times slower or raise the limit by"),
        (Limits(10.0, 4.0), r"of acceleration_m_s2 \(limit 4\.000\) .* times slower or raise the limit by"),
        (Limits(10.0, 5.0, climb_m_s=3.0), r"of climb_m_s \(limit 3\.000\) .* times slower or raise the limit by"),
        (Limits(10.0, 5.0, descent_m_s=0.1), r"of descent_m_s \(limit 0\.100\) .* times slower or raise the limit by"),
        (Limits(10.0, 5.0, jerk_m_s3=9.0), r"of jerk_m_s3 \(limit 9\.000\) .* times slower or raise the limit by"),
    ],
)
def test_a_broken_limit_names_vehicle_time_and_what_would_help(limits: Limits, change: str) -> None:
    flight = timed(approach((-10, 10, 10)), LIMITS)
    pause = timed(line(5.0), Limits(0.1, 0.1))  # before it: times count from the plan's start
    with pytest.raises(PlanError, match=change) as refused:
        check([pause, flight], replace(WIDE, limits=limits), np.zeros(3))
    said = re.search(
        r"vehicle (\d+) would reach (\S+) of (\S+) .* at t=(\S+) s, .* fly (\S+) times", str(refused.value)
    )
    assert said is not None
    vehicle, value, name, time_s, factor = int(said[1]) - 1, float(said[2]), said[3], float(said[4]), float(said[5])
    times = np.arange(max(time_s - pause.duration_s - 0.06, 0.0), time_s - pause.duration_s + 0.06, 1e-3)
    sample = flight.sample(times)
    own = {
        "speed_m_s": np.linalg.norm(sample.velocity_m_s[:, vehicle], axis=1),
        "acceleration_m_s2": np.linalg.norm(sample.acceleration_m_s2[:, vehicle], axis=1),
        "climb_m_s": sample.velocity_m_s[:, vehicle, 2],
        "descent_m_s": -sample.velocity_m_s[:, vehicle, 2],
        "jerk_m_s3": np.linalg.norm(np.diff(sample.acceleration_m_s2[:, vehicle], axis=0), axis=1) / 1e-3,
    }[name]
    assert own.max() == pytest.approx(value, rel=0.02)
    slow = flight.slower(factor + 1e-3)  # the text is rounded
    assert check([slow], replace(WIDE, limits=limits), np.zeros(3)).peaks[0] < value * 2.0


def test_a_large_swarm_is_refused_by_the_points_around_it() -> None:
    swarm = np.concatenate((PAPER.leaders_m, np.random.default_rng(3).uniform(-2.0, 0.0, (80, 3))))
    flight = timed(PosePath(swarm, plan_path(PAPER, START, np.array([-20.0, 20.0, 20.0])).poses), LIMITS)
    reached = flight.largest(lambda sample, _: np.linalg.norm(sample.velocity_m_s, axis=2)).value
    between = Limits((reached + flight.survey.peaks.speed_m_s) / 2.0, 9.0)
    with pytest.raises(PlanError, match=r"a point around the swarm, next to vehicle \d+, would reach .* speed_m_s"):
        check([flight], replace(WIDE, separation_m=0.0, limits=between), np.zeros(3))


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
