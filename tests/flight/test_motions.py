"""Motions are pure functions of time; what the streamer makes of their headings is limited in rate."""

from __future__ import annotations

import numpy as np
import pytest

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Pose, hemisphere
from fg_gcs.core.separation import Fence
from fg_gcs.flight.motions import Brake, Follow, FormationMotion, Gaze, Headings, Motion, Rest
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
    return Follow(range(4), compile_flight(task, tops, lambda: 0.0).approach, BEGIN_S)


def formation_motion() -> FormationMotion:
    trajectory = FailSafeTrajectory.resting(START, BEGIN_S)
    headings = Headings(BEGIN_S, np.zeros(4))
    motion = FormationMotion.beginning(range(4), FORMATION.slots_m, trajectory, np.array([9.0, 0.0, 10.0]), headings)
    return motion.with_trajectory(trajectory, Gaze(BEGIN_S, np.array([9.0, 0.0, 10.0]), np.array([0.0, 3.0, 0.0])))


def every_motion() -> list[Motion]:
    plan = follow()
    rest = Rest(range(4), plan.at(BEGIN_S).position_m, np.zeros(4))
    return [rest, plan, Brake(plan, BEGIN_S + 1.0), formation_motion()]


def flat(motion: Motion, now_s: float) -> Array:
    wanted = motion.at(now_s)
    return np.concatenate([part.ravel() for part in wanted])


@pytest.mark.parametrize("index", range(4))
def test_a_motion_says_the_same_of_an_instant_whenever_and_in_whatever_order_it_is_asked(index: int) -> None:
    motion = every_motion()[index]
    times_s = BEGIN_S + np.linspace(0.0, 8.0, 33)
    forward = [flat(motion, now_s) for now_s in times_s]
    backward = [flat(motion, now_s) for now_s in times_s[::-1]][::-1]
    assert np.array_equal(forward, backward)


def test_braking_begins_as_the_plan_was_and_ends_at_rest_on_its_path() -> None:
    plan = follow()
    start_s = BEGIN_S + 0.4 * plan.plan.duration_s
    brake = Brake(plan, start_s)
    assert np.allclose(brake.at(start_s).position_m, plan.at(start_s).position_m)
    assert np.allclose(brake.at(start_s).velocity_m_s, plan.at(start_s).velocity_m_s)
    assert not brake.at(brake.end_s + 5.0).velocity_m_s.any()
    assert not brake.at(brake.end_s + 5.0).acceleration_m_s2.any()
    path = np.array([plan.at(now_s).position_m for now_s in np.linspace(BEGIN_S, plan.end_s, 2000)])
    rest = brake.at(brake.end_s).position_m
    assert np.linalg.norm(path - rest, axis=2).max(axis=1).min() < 0.02


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
