"""The inner loop's laws: trajectories join smoothly, keep every limit, and end at rest by themselves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import FACING, coverage
from fg_gcs.core.formation import Formation, Pose, facing, hemisphere
from fg_gcs.core.separation import Fence
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.track.estimate.imm import Prediction
from fg_gcs.track.follow.fail_safe import FailSafeTrajectory, verify
from fg_gcs.track.follow.replanner import HORIZON_S, MET_S, FollowMode, Goal, Replanner, Swarm

NINE = hemisphere(4, 5, 6.0)
RULES = Rules(Limits(10.0, 5.0), 1.5, Fence((-150.0, -150.0, 2.0), (150.0, 150.0, 80.0)))
START = Pose(np.array([0.0, 0.0, 20.0]), facing(np.array([1.0, 0.2, 0.0])))
DEPTH_M = 1.0


def replanner(formation: Formation = NINE, rules: Rules = RULES, start: Pose = START) -> Replanner:
    return Replanner(Swarm(formation, formation.slots_m, DEPTH_M, rules), start, 0.0)


def wandering(seed: int, time_s: float) -> Goal:
    """A target that moves and jumps a little from look to look, as estimates do."""
    draw = np.random.default_rng((seed, round(1000 * time_s)))
    place = np.array([40.0 * np.cos(0.1 * time_s), 40.0 * np.sin(0.1 * time_s), 20.0 + 3.0 * np.sin(0.3 * time_s)])
    velocity = np.array([-4.0 * np.sin(0.1 * time_s), 4.0 * np.cos(0.1 * time_s), 0.9 * np.cos(0.3 * time_s)])
    noise = draw.normal(size=(3, 3)) * np.array([[0.2], [0.3], [0.1]])
    mean = np.stack((place, velocity, np.zeros(3))) + noise
    prediction = Prediction(time_s, np.ones(1), mean[None], np.array([4.0]), np.zeros(1))
    return Goal(prediction, 1.0 + 0.3 * (seed % 3))


def steady(time_s: float, place: Array, velocity: Array | None = None, scale: float = 1.0) -> Goal:
    return Goal(Prediction.straight(time_s, place, np.zeros(3) if velocity is None else velocity), scale)


def flown(trajectory: FailSafeTrajectory, time_s: Array, formation: Formation = NINE) -> tuple[Array, Array, Array]:
    return trajectory.frames(time_s).swarm(formation.slots_m)


@pytest.mark.parametrize("seed", range(4))
def test_whatever_the_target_does_every_ride_continues_the_last_one_and_keeps_all_limits(seed: int) -> None:
    made = replanner()
    draw = np.random.default_rng(seed)
    now_s = 0.0
    while now_s < 25.0:
        before = made.trajectory
        replan = made.replan(wandering(seed, now_s), now_s)
        for one, other in zip(
            flown(before, np.array([now_s])), flown(replan.trajectory, np.array([now_s])), strict=True
        ):
            assert one == pytest.approx(other, abs=1e-6)
        step_s = float(draw.choice([0.05, 0.1, 0.1, 0.4, 2.0]))
        position, velocity, acceleration = flown(replan.trajectory, np.arange(now_s, now_s + step_s, 0.002))
        assert np.linalg.norm(velocity, axis=2).max() <= 10.0
        assert np.linalg.norm(acceleration, axis=2).max() <= 5.0
        assert min(float(pdist(places).min()) for places in position[::10]) >= 1.5
        assert RULES.fence.excess_m(position).max() <= 0.0
        now_s += step_s


@pytest.mark.parametrize("seed", range(3))
def test_a_ride_that_nothing_follows_is_flown_to_rest_within_all_limits(seed: int) -> None:
    made = replanner()
    for step in range(60 + 37 * seed):
        made.replan(wandering(seed, 0.1 * step), 0.1 * step)
    trajectory = made.trajectory
    position, velocity, acceleration = flown(trajectory, np.arange(trajectory.start_s, trajectory.end_s + 1.0, 0.002))
    assert np.linalg.norm(velocity, axis=2).max() <= 10.0
    assert np.linalg.norm(acceleration, axis=2).max() <= 5.0
    assert RULES.fence.excess_m(position).max() <= 0.0
    assert np.abs(velocity[-400:]).max() < 1e-6
    assert np.linalg.norm(np.diff(acceleration, axis=0), axis=2).max() < 0.2  # nowhere a step: continuous to the end


def test_a_target_at_rest_is_reached_faced_all_the_way_and_held_with_the_target_on_the_axis() -> None:
    target = np.array([50.0, 30.0, 25.0])
    made = replanner()
    rims = []
    for step in range(200):
        made.replan(steady(0.1 * step, target), 0.1 * step)
        rims.append(flown(made.trajectory, np.array([0.1 * step]))[0][0, :4])
    covered = coverage(np.array(rims), target)
    assert covered[int(np.argmax(covered >= FACING)) :].min() >= 0.95
    state = made.trajectory.state(20.0)
    assert made.mode is FollowMode.FOLLOW
    assert state.axes[0, :3] - DEPTH_M * state.attitude[:, 0] == pytest.approx(target, abs=0.01)
    assert np.abs(state.axes[1:]).max() < 0.01


def test_a_face_that_looks_away_turns_before_it_moves() -> None:
    made = replanner()
    target = np.array([-60.0, 10.0, 20.0])
    assert made.replan(steady(0.0, target), 0.0).mode is FollowMode.TURN
    middle = made.trajectory.state(0.5 * made.trajectory.end_s)
    assert middle.axes[0, :3] == pytest.approx(START.centre_enu_m, abs=1e-9)
    end = made.trajectory.state(made.trajectory.end_s)
    assert end.attitude[:, 0] @ (target - START.centre_enu_m) > 0.99 * 60.0


@pytest.mark.parametrize(
    "limits", [Limits(10.0, 5.0, 3.0, 1.5), Limits(10.0, 2.5, 2.5, 1.5, 5.0)], ids=["px4", "ardupilot"]
)
def test_a_turn_that_lifts_half_the_formation_keeps_climb_and_descent(limits: Limits) -> None:
    for seed in range(12):
        draw = np.random.default_rng(seed)
        away = np.array([-1.0, 0.3, 0.0]) + 0.6 * draw.normal(size=3)
        made = replanner(rules=replace(RULES, limits=limits))
        replan = made.replan(steady(0.0, START.centre_enu_m + 40.0 * away / np.linalg.norm(away)), 0.0)
        assert replan.taken  # or it would stand here for ever
        assert replan.mode is FollowMode.TURN
        velocity = flown(made.trajectory, np.arange(0.0, made.trajectory.end_s, 0.01))[1]
        assert velocity[:, :, 2].max() <= limits.climb_m_s
        assert velocity[:, :, 2].min() >= -limits.descent_m_s


@pytest.mark.parametrize("seed", range(3))
def test_an_approach_meets_the_target_where_and_when_it_is_predicted_and_moves_as_it_does_then(seed: int) -> None:
    """Farther ahead than the horizon no prediction is trusted: there it aims at where the target is at the horizon."""
    draw = np.random.default_rng(seed)
    mean = np.stack(
        (START.centre_enu_m + np.array([45.0, 9.0, 0.0]), draw.normal(size=3) * [2.5, 2.5, 0.5], np.zeros(3))
    )
    mean[2, :2] = 0.1
    way = Prediction(0.0, np.ones(1), mean[None], np.array([20.0]), np.zeros(1))
    made, took_s = replanner(), []
    for now_s in np.arange(0.0, 10.0, 0.5).tolist():
        goal = Goal(Prediction(now_s, np.ones(1), way.at(now_s)[None], way.eases_s, way.rates_rad_s), 1.0)
        replan = made.replan(goal, now_s)
        if replan.mode is not FollowMode.APPROACH:
            break
        time_s = np.arange(now_s, replan.trajectory.end_s, 0.002)
        frames = replan.trajectory.frames(time_s)
        gap = frames.centre - np.array([goal.at(min(at_s, now_s + HORIZON_S)) for at_s in time_s.tolist()])
        gap[:, 0] -= DEPTH_M * frames.arms[:, 0, :, 0] / frames.scale[:, None]
        place_m, speed_m_s, acceleration_m_s2 = np.linalg.norm(gap, axis=2).T
        met = int(np.argmin(place_m + speed_m_s + 0.1 * acceleration_m_s2))
        assert place_m[met] <= (MET_S + 0.002) * float(np.linalg.norm(goal.at(now_s)[1])) + 0.01
        assert speed_m_s[met] <= 0.005
        assert acceleration_m_s2[met] <= 0.03 < 0.5 * np.linalg.norm(goal.at(now_s + HORIZON_S)[2])
        going_on = frames.centre[met : met + 100, 1] - frames.centre[met, 1]
        assert np.linalg.norm(going_on, axis=1).max() <= 0.05  # for 0.2 s at least, before it brakes
        took_s.append(float(time_s[met]) - now_s)
    assert min(took_s) < HORIZON_S < max(took_s)


def test_a_target_that_is_too_fast_is_chased_without_breaking_a_limit() -> None:
    made = replanner()
    for step in range(120):
        now_s = 0.1 * step
        goal = steady(now_s, np.array([30.0 + 14.0 * now_s - 80.0, 40.0, 20.0]), np.array([14.0, 0.0, 0.0]))
        assert made.chases(goal)
        made.replan(goal, now_s)
        _, velocity, acceleration = flown(made.trajectory, np.arange(now_s, now_s + 0.1, 0.005))
        assert np.linalg.norm(velocity, axis=2).max() <= 10.0
        assert np.linalg.norm(acceleration, axis=2).max() <= 5.0
    assert float(np.linalg.norm(flown(made.trajectory, np.array([12.0]))[1][0].mean(axis=0))) > 5.0  # it does chase


def test_a_target_outside_the_fence_is_followed_along_the_inside() -> None:
    tight = replace(RULES, fence=Fence((-20.0, -20.0, 2.0), (20.0, 20.0, 40.0)))
    made = replanner(rules=tight)
    for step in range(150):
        now_s = 0.1 * step
        made.replan(steady(now_s, np.array([60.0, 2.0 * now_s, 20.0]), np.array([0.0, 2.0, 0.0])), now_s)
        position = flown(made.trajectory, np.arange(now_s, now_s + 0.1, 0.02))[0]
        assert tight.fence.excess_m(position).max() <= 0.0
    assert position[-1, :, 0].max() > 10.0  # as near as it may come


def test_climb_descent_and_jerk_have_limits_of_their_own() -> None:
    limits = Limits(10.0, 5.0, climb_m_s=2.0, descent_m_s=1.0, jerk_m_s3=8.0)
    made = replanner(rules=replace(RULES, limits=limits))
    for step in range(200):
        now_s = 0.1 * step
        height = 50.0 if now_s < 10.0 else 10.0
        made.replan(steady(now_s, np.array([30.0, 5.0, height])), now_s)
        _, velocity, acceleration = flown(made.trajectory, np.arange(now_s, now_s + 0.1, 0.002))
        assert velocity[:, :, 2].max() <= 2.0
        assert velocity[:, :, 2].min() >= -1.0
        assert np.linalg.norm(np.diff(acceleration, axis=0), axis=2).max() / 0.002 <= 8.0


@pytest.mark.parametrize("limits", [Limits(10.0, 5.0), Limits(10.0, 2.5, jerk_m_s3=5.0)], ids=["px4", "ardupilot"])
def test_a_stop_at_once_is_shorter_and_no_more_than_a_tenth_beyond_the_limits(limits: Limits) -> None:
    ways_m = []
    for at_s in (1.5, 3.0, 4.5, 6.0):
        made = replanner(rules=replace(RULES, limits=limits))
        for step in range(round(10.0 * at_s)):
            made.replan(wandering(0, 0.1 * step), 0.1 * step)
        before, begun = made.trajectory, made.trajectory.state(at_s).axes
        stops = []
        for at_once in (False, True):
            made.trajectory = before
            assert made.stop(at_s, at_once=at_once).taken
            stops.append(math.dist(made.trajectory.state(made.trajectory.end_s).axes[0, :3], begun[0, :3]))
        ways_m.append(stops)
        np.testing.assert_allclose(made.trajectory.state(at_s).axes, begun, atol=1e-6)  # it goes on from there
        _, _, acceleration = flown(made.trajectory, np.arange(at_s, made.trajectory.end_s, 0.002))
        assert np.linalg.norm(acceleration, axis=2).max() <= 1.1 * limits.acceleration_m_s2 + 1e-6
        if np.isfinite(limits.jerk_m_s3):
            jerk = np.linalg.norm(np.diff(acceleration, axis=0), axis=2) / 0.002
            assert jerk.max() <= 1.1 * limits.jerk_m_s3 + 0.05
    gentle, sudden = np.array(ways_m).T
    assert (sudden <= gentle).all()
    assert sudden.sum() < 0.75 * gentle.sum()


@pytest.mark.parametrize(
    ("limits", "most_s"),
    [(Limits(10.0, 5.0), 2.5), (Limits(10.0, 2.5, climb_m_s=2.5, descent_m_s=1.5, jerk_m_s3=5.0), 6.0)],
    ids=["px4", "ardupilot"],
)
def test_stopping_comes_to_rest_soon_and_waiting_grows_in_place(limits: Limits, most_s: float) -> None:
    made = replanner(rules=replace(RULES, limits=limits))
    for step in range(60):
        made.replan(wandering(0, 0.1 * step), 0.1 * step)
    assert np.linalg.norm(made.trajectory.state(6.0).axes[1, :3]) > 3.0
    assert made.stop(6.0).taken
    assert made.trajectory.end_s < 6.0 + most_s
    rest = made.trajectory.state(made.trajectory.end_s)
    assert not made.wait(1.5, made.trajectory.end_s - 0.1).taken  # not before it rests
    grown = made.wait(1.5, made.trajectory.end_s)
    assert grown.taken
    assert grown.mode is FollowMode.WAIT
    assert grown.trajectory.state(grown.trajectory.end_s).axes[0] == pytest.approx(
        [*rest.axes[0, :3], 0, 0, 0, 1.5], abs=1e-6
    )
    assert not made.wait(1.5, grown.trajectory.end_s).taken  # in place already


def test_a_formation_that_must_not_shrink_below_the_minimum_does_not() -> None:
    made = replanner(rules=replace(RULES, separation_m=0.999 * NINE.smallest_separation_m))
    goal = steady(0.0, np.array([30.0, 0.0, 20.0]), scale=0.5)
    assert not made.replan(goal, 0.0).taken
    assert made.replan(goal._replace(scale=1.0), 0.1).taken


def test_the_same_looks_give_the_same_rides() -> None:
    trajectories = []
    for _ in range(2):
        made = replanner(start=Pose(np.zeros(3) + 30.0, Rotation.from_euler("z", 2.0).as_matrix()))
        for step in range(50):
            made.replan(wandering(1, 0.1 * step), 0.1 * step)
        trajectories.append(flown(made.trajectory, np.linspace(4.9, 12.0, 50))[0])
    assert np.array_equal(trajectories[0], trajectories[1])


def test_the_proof_sees_what_a_dense_sample_sees() -> None:
    made = replanner()
    for step in range(80):
        made.replan(wandering(2, 0.1 * step), 0.1 * step)
        if step % 10 == 0:
            proof = verify(made.trajectory, NINE.slots_m, RULES)
            _, velocity, acceleration = flown(
                made.trajectory, np.arange(made.trajectory.start_s, made.trajectory.end_s, 0.001)
            )
            assert np.linalg.norm(velocity, axis=2).max() <= proof.peaks.speed_m_s
            assert np.linalg.norm(acceleration, axis=2).max() <= proof.peaks.acceleration_m_s2
