from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Synchronization, Trajectory

from fg_gcs.track.follow.axes import Axes, Bounds


def bounds(count: int = 3, speed: float = 3.0, acceleration: float = 2.0, jerk: float = 10.0) -> Bounds:
    return Bounds(*(np.full(count, value) for value in (-speed, speed, -acceleration, acceleration, jerk)))


def chained(seed: int) -> Axes:
    """A motion to a moving state, straight on, and to rest, from a state within the bounds."""
    draw = np.random.default_rng(seed)
    start = np.stack((draw.normal(size=3) * 5.0, draw.uniform(-2, 2, 3), draw.uniform(-1, 1, 3)))
    goal = np.stack((draw.normal(size=3) * 5.0, draw.uniform(-2, 2, 3), draw.uniform(-1, 1, 3)))
    axes = Axes(10.0, start)
    assert axes.to(goal, bounds(), float(draw.choice([0.0, 6.0])))
    assert axes.end == pytest.approx(goal, abs=1e-6)
    assert axes.to_velocity(goal[1], bounds())
    axes.straight_on(axes.end_s + 1.5)
    assert axes.end[1] == pytest.approx(goal[1], abs=1e-6)
    assert axes.to_velocity(np.zeros(3), bounds())
    return axes


@pytest.mark.parametrize("seed", range(20))
def test_a_chain_is_continuous_up_to_the_acceleration_and_keeps_every_bound(seed: int) -> None:
    axes = chained(seed)
    time_s = np.linspace(axes.start_s - 0.5, axes.end_s + 0.5, 4001)
    inside = (time_s > axes.start_s) & (time_s < axes.end_s)
    states = axes.at(time_s)
    step = float(time_s[1] - time_s[0])
    position, velocity, acceleration = states.transpose(1, 0, 2)
    assert np.abs(np.diff(position, axis=0) - step * velocity[:-1]).max() < 3.0 * step**2
    assert np.abs(velocity[inside]).max() <= 3.0 + 1e-6
    assert np.abs(acceleration[inside]).max() <= 2.0 + 1e-6
    jumps = np.abs(np.diff(acceleration[inside], axis=0))
    assert jumps.max() <= 10.0 * step + 1e-6
    assert states[-1, 1:] == pytest.approx(np.zeros((2, 3)), abs=1e-9)


def test_a_least_duration_is_kept_and_a_state_in_place_takes_no_time() -> None:
    start = np.zeros((3, 2))
    slow = Axes(0.0, start)
    assert slow.to(np.array([[1.0, 0.5], [0.0, 0.0], [0.0, 0.0]]), bounds(2), 4.0)
    assert slow.end_s == pytest.approx(4.0)
    there = Axes(0.0, start)
    assert there.to(start, bounds(2))
    assert there.end_s == 0.0
    assert there.at(np.array([-1.0, 0.0, 1.0])) == pytest.approx(np.zeros((3, 3, 2)))


def test_what_no_bound_allows_and_what_is_no_number_is_refused_and_changes_nothing() -> None:
    axes = Axes(0.0, np.zeros((3, 1)))
    assert not axes.to(np.array([[1.0], [9.0], [0.0]]), bounds(1))
    assert axes.end_s == 0.0
    assert not Axes(0.0, np.full((3, 1), np.nan)).to_velocity(np.zeros(1), bounds(1))


def test_a_joint_that_is_off_by_a_rounding_stays_where_it_is() -> None:
    for seed in range(50):
        draw = np.random.default_rng(seed)
        start = np.zeros((3, 3))
        start[:, 1:] = 1e-16 * draw.normal(size=(3, 2))
        start[1:, 0] = draw.uniform(-0.5, 0.5, 2)
        start[0] += 1.0
        axes = Axes(0.0, start)
        assert axes.to(np.array([[4.0, 1.0, 1.0], np.zeros(3), np.zeros(3)]), bounds(), float(draw.uniform(0.0, 5.0)))
        states = axes.at(np.linspace(0.0, axes.end_s, 500))
        assert np.abs(states[:, 0, 1:] - 1.0).max() < 1e-8
        assert np.abs(states[:, 1:, 1:]).max() < 1e-8


def test_a_smooth_motion_joins_two_states_and_tells_the_jerk_that_it_starts_with() -> None:
    for seed in range(20):
        draw = np.random.default_rng(seed)
        start, goal = draw.normal(size=(2, 3, 3))
        takes_s, short_s = float(draw.uniform(0.5, 4.0)), 1e-5
        axes = Axes(10.0, start)
        jerk = axes.smoothly(goal, takes_s)
        assert axes.end_s == pytest.approx(10.0 + takes_s)
        assert axes.at(np.array([10.0]))[0] == pytest.approx(start)
        assert axes.at(np.array([10.0 + takes_s * (1.0 - 1e-12)]))[0] == pytest.approx(goal, abs=1e-6)
        time_s = np.linspace(10.0 + short_s, axes.end_s - short_s, 50)
        before, states, after = (axes.at(time_s + shift) for shift in (-short_s, 0.0, short_s))
        assert (after - before)[:, :2] / (2.0 * short_s) == pytest.approx(states[:, 1:], abs=1e-4)
        began = axes.at(np.array([10.0, 10.0 + short_s]))[:, 2]
        assert np.linalg.norm(np.diff(began, axis=0)) / short_s == pytest.approx(jerk, rel=1e-2)


def test_bounds_widen_as_far_as_a_goal_needs_in_either_direction_and_no_bound_narrows() -> None:
    goal = np.array([[0.0, 0.0, 0.0], [9.0, -9.0, 0.1], [1.0, 1.0, 0.0]])
    wide = bounds().reaching(goal)
    assert (wide.highest_velocity[:2] > 9.0).all()
    assert (wide.lowest_velocity[:2] < -9.0).all()
    assert (wide.highest_velocity[2], wide.lowest_velocity[2]) == (3.0, -3.0)
    for side in (1.0, -1.0):
        axes = Axes(0.0, np.zeros((3, 3)))
        assert axes.to(side * goal, bounds().reaching(side * goal))
        assert axes.end == pytest.approx(side * goal, abs=1e-6)


def test_states_do_not_depend_on_the_order_in_which_they_are_asked_for() -> None:
    axes = chained(3)
    time_s = np.linspace(axes.start_s - 1.0, axes.end_s + 1.0, 60)
    shuffled = np.random.default_rng(0).permutation(len(time_s))
    assert (axes.at(time_s[::-1])[::-1] == axes.at(time_s)).all()
    assert (axes.at(time_s[shuffled]) == axes.at(time_s)[shuffled]).all()


@given(
    st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(-5.0, 5.0)),
    st.floats(-9.0, 9.0),
    st.tuples(st.floats(0.5, 4.0), st.floats(0.5, 4.0), st.floats(1.0, 20.0)),
)
def test_a_velocity_is_reached_as_fast_as_by_ruckig_and_in_the_same_place(
    state: tuple[float, float, float], velocity: float, limits: tuple[float, float, float]
) -> None:
    braking, gaining, jerk = limits
    asked, judge = InputParameter(1), Trajectory(1)
    asked.control_interface, asked.synchronization = ControlInterface.Velocity, Synchronization.No
    asked.current_position, asked.current_velocity, asked.current_acceleration = ([number] for number in state)
    asked.target_velocity, asked.min_acceleration, asked.max_acceleration = [velocity], [-braking], [gaining]
    asked.max_velocity, asked.max_jerk = [99.0], [jerk]
    assert Ruckig(1).calculate(asked, judge) in (Result.Working, Result.Finished)
    axes = Axes(10.0, np.array(state)[:, None])
    assert axes.to_velocity(np.array([velocity]), Bounds(*np.array([[-99.0], [99.0], [-braking], [gaining], [jerk]])))
    assert axes.end_s == pytest.approx(10.0 + judge.duration, abs=1e-6)
    for share in np.linspace(0.0, 1.0, 41).tolist():
        place = np.array(judge.at_time(share * judge.duration))
        assert axes.at(np.array([10.0 + share * judge.duration]))[0] == pytest.approx(place, abs=1e-5)
    assert axes.end == pytest.approx(np.array(judge.at_time(judge.duration)), abs=1e-6)


def test_a_long_chain_keeps_what_it_began_with() -> None:
    axes = Axes(0.0, np.zeros((3, 2)))
    time_s, shown = np.linspace(0.0, 1.0, 20), []
    for number in range(80):
        axes.smoothly(np.full((3, 2), 0.1 * number), 1.0)
        shown.append(axes.at(time_s))
    assert all((states == shown[0]).all() for states in shown)
