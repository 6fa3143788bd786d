"""Motions are pure functions of time; what the streamer makes of their headings is limited in rate."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Pose, hemisphere
from fg_gcs.core.separation import Fence
from fg_gcs.flight.motions import Braking, Follow, FormationMotion, Gaze, Headings, Motion, Rest, SwarmSetpoint
from fg_gcs.flight.yaw_limiter import YAW_RATE_RAD_S, YawRateLimiter
from fg_gcs.plan.flight_plan import Task, compile_flight
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.targets import Target
from fg_gcs.track.follow.fail_safe import FailSafeTrajectory

FORMATION = hemisphere(3, 1, 6.0)
START = Pose(np.array([0.0, 0.0, 10.0]), np.eye(3))
BEGIN_S = 100.0


def follow() -> Follow:
    rules = Rules(Limits(8.0, 4.0), 1.5, Fence((-30.0, -30.0, 2.0), (30.0, 30.0, 30.0)))
    task = Task(FORMATION, START, Target.ball((-6.0, 10.0, 12.0)), 0.25, rules, "rigid")
    tops = np.array([[3.0 * column, 0.0, 4.0] for column in range(4)])
    return Follow.from_now(range(4), compile_flight(task, tops, lambda: 0.0).approach, BEGIN_S)


def formation_motion() -> FormationMotion:
    trajectory = FailSafeTrajectory.resting(START, BEGIN_S)
    headings = Headings(BEGIN_S, np.zeros(4))
    motion = FormationMotion.beginning(range(4), FORMATION.slots_m, trajectory, np.array([9.0, 0.0, 10.0]), headings)
    return motion.with_trajectory(trajectory, Gaze(BEGIN_S, np.array([9.0, 0.0, 10.0]), np.array([0.0, 3.0, 0.0])))


def every_motion() -> list[Motion]:
    plan = follow()
    rest = Rest(range(4), plan.at(BEGIN_S).position_m, np.zeros(4))
    return [
        rest,
        plan,
        plan.stopping(BEGIN_S + 1.0),
        plan.stopping(BEGIN_S + 1.0).going_on(BEGIN_S + 1.3),
        formation_motion(),
    ]


def flat(motion: Motion, now_s: float) -> Array:
    wanted = motion.at(now_s)
    return np.concatenate([part.ravel() for part in wanted])


@pytest.mark.parametrize("index", range(5))
def test_a_motion_says_the_same_of_an_instant_whenever_and_in_whatever_order_it_is_asked(index: int) -> None:
    motion = every_motion()[index]
    times_s = BEGIN_S + np.linspace(0.0, 8.0, 33)
    forward = [flat(motion, now_s) for now_s in times_s]
    backward = [flat(motion, now_s) for now_s in times_s[::-1]][::-1]
    assert np.array_equal(forward, backward)


@pytest.mark.parametrize("share", [0.05, 0.4, 0.7, 0.99])
@pytest.mark.parametrize("stands_s", [0.0, 4.0])
def test_a_plan_that_stops_and_goes_on_stays_on_its_path_without_a_jump(share: float, stands_s: float) -> None:
    plan = follow()
    stop_s = BEGIN_S + share * plan.plan.duration_s
    stopped = plan.stopping(stop_s)
    go_s = stopped.end_s + stands_s
    again = stopped.going_on(go_s)
    assert np.isfinite(again.end_s)
    assert again.end_s > plan.end_s
    last_s = go_s + 0.6 * again.pace.lasts_s  # before it is at full speed it has to stop once more
    last = again.stopping(last_s)
    assert not last.at(last.end_s).velocity_m_s.any()
    times_s = np.arange(BEGIN_S, last.end_s + 1.0, 0.002)
    motions = [plan if t < stop_s else stopped if t < go_s else again if t < last_s else last for t in times_s]
    wanted = [motion.at(t) for motion, t in zip(motions, times_s, strict=True)]
    position, velocity, acceleration = (np.array([getattr(w, name) for w in wanted]) for name in wanted[0]._fields[:3])
    assert np.allclose(np.diff(position, axis=0) / 0.002, 0.5 * (velocity[1:] + velocity[:-1]), atol=5e-3)
    assert np.allclose(np.diff(velocity, axis=0) / 0.002, 0.5 * (acceleration[1:] + acceleration[:-1]), atol=0.15)
    assert np.linalg.norm(velocity, axis=2).max() <= 8.0 * (1.0 + 1e-6)
    assert np.linalg.norm(acceleration, axis=2).max() <= 4.0 * 1.4
    path = np.array([plan.at(now_s).position_m for now_s in np.linspace(BEGIN_S, plan.end_s, 2000)])
    rest = stopped.at(stopped.end_s + 5.0)
    assert not rest.velocity_m_s.any()
    assert not rest.acceleration_m_s2.any()
    assert np.linalg.norm(path - rest.position_m, axis=2).max(axis=1).min() < 0.02
    assert np.allclose(again.at(again.end_s + 0.01).position_m, path[-1], atol=1e-3)


def test_a_newer_trajectory_leaves_the_older_motion_as_it_was() -> None:
    older = formation_motion()
    before = flat(older, BEGIN_S + 1.0)
    elsewhere = FailSafeTrajectory.resting(Pose(np.array([5.0, 0.0, 10.0]), np.eye(3)), BEGIN_S)
    newer = older.with_trajectory(elsewhere, Gaze(BEGIN_S, np.zeros(3), np.zeros(3)))
    assert np.array_equal(flat(older, BEGIN_S + 1.0), before)
    assert np.allclose(newer.at(BEGIN_S).position_m - older.at(BEGIN_S).position_m, [5.0, 0.0, 0.0])
    assert newer.turns_from is older.turns_from


def test_noses_follow_a_point_that_moves() -> None:
    motion = formation_motion()
    for now_s in (BEGIN_S, BEGIN_S + 2.0):
        wanted = motion.at(now_s)
        east, north, _ = (motion.gaze.at(now_s) - wanted.position_m).T
        assert np.allclose(wanted.yaw_rad, np.arctan2(east, north))


def test_headings_turn_the_short_way_at_a_limited_rate() -> None:
    limiter = YawRateLimiter(Headings(0.0, np.array([3.0, -3.0, 0.0, 0.1])))
    wanted = np.array([-3.0, 3.0, 2.0, 0.1])
    sent = np.array([limiter.turn(wanted, now_s) for now_s in np.arange(0.0, 3.0, 0.02)])
    steps = np.remainder(np.diff(sent, axis=0) + np.pi, 2.0 * np.pi) - np.pi
    assert np.abs(steps).max() <= YAW_RATE_RAD_S * 0.02 + 1e-12
    assert np.all(np.abs(np.sum(steps, axis=0)) < [0.3, 0.3, 2.01, 0.01])  # across the seam, not around
    assert np.allclose(sent[-1], wanted)


def test_no_time_turns_no_nose() -> None:
    limiter = YawRateLimiter(Headings(5.0, np.array([1.0])))
    assert limiter.turn(np.array([2.0]), 5.0).tolist() == [1.0]
    assert limiter.turn(np.array([2.0]), 4.0).tolist() == [1.0]
    assert limiter.turn(np.array([2.0]), 5.25) == pytest.approx([1.0 + 0.25 * YAW_RATE_RAD_S])


def test_a_heading_that_is_no_number_is_forgotten() -> None:
    limiter = YawRateLimiter(Headings(0.0, np.array([0.5, 0.5])))
    assert np.isnan(limiter.turn(np.array([np.nan, 0.6]), 1.0)).tolist() == [True, False]
    assert limiter.turn(np.array([0.7, 0.7]), 2.0) == pytest.approx([0.7, 0.7])


@given(seed=st.integers(0, 999), deceleration=st.floats(0.5, 9.0))
def test_braking_leads_straight_on_and_to_rest(seed: int, deceleration: float) -> None:
    random = np.random.default_rng(seed)
    position, velocity, push = random.normal(size=(3, 4, 3))
    last = SwarmSetpoint(position, velocity, push, random.normal(size=4))
    last.velocity_m_s[0] = 0.0
    motion = Braking(range(4), last, 5.0, deceleration)
    assert all((now == then).all() for now, then in zip(motion.at(5.0)[:2], last[:2], strict=True))
    for now_s in np.linspace(5.0, motion.end_s + 0.5, 30):
        before, wanted, after = (motion.at(float(now_s) + step) for step in (-1e-4, 0.0, 1e-4))
        if now_s > 5.0:
            slope = (after.position_m - before.position_m) / 2e-4
            np.testing.assert_allclose(slope, wanted.velocity_m_s, atol=1e-3)
        assert np.linalg.norm(wanted.acceleration_m_s2, axis=1).max() <= deceleration * (1.0 + 1e-9)
    assert not motion.at(motion.end_s + 1e-9).velocity_m_s.any()
