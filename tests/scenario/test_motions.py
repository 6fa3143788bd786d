from __future__ import annotations

import math

import numpy as np
import pytest

from fg_gcs.scenario.motions import Circle, FigureEight, Static, TrueMotion
from fg_gcs.scenario.random_walk import RandomWalk
from fg_gcs.scenario.recorded import Recorded
from fg_gcs.scenario.waypoints import Waypoints

SQUARE = [(0.0, 0.0, 10.0), (40.0, 0.0, 10.0), (40.0, 30.0, 16.0), (0.0, 30.0, 12.0)]
BOX = ((-30.0, -20.0, 12.0), (30.0, 40.0, 15.0))


def walk(seed: int, acceleration_m_s2: float = 1.0) -> RandomWalk:
    return RandomWalk(*BOX, speed_m_s=5.0, acceleration_m_s2=acceleration_m_s2, seed=seed)


MOTIONS: dict[str, TrueMotion] = {
    "static": Static((1.0, 2.0, 3.0)),
    "circle": Circle((5.0, -5.0, 15.0), 50.0, 4.0, phase_deg=30.0),
    "clockwise": Circle((5.0, -5.0, 15.0), 20.0, 3.0, clockwise=True),
    "eight": FigureEight((3.0, 4.0, 15.0), 60.0, 5.0, heading_deg=0.0),
    "slanting eight": FigureEight((3.0, 4.0, 15.0), 60.0, 5.0, heading_deg=-125.0),
    "course": Waypoints(SQUARE, 4.0, 2.0),
    "round course": Waypoints(SQUARE, 4.0, 2.0, closed=True),
    "there and back": Waypoints([SQUARE[0], SQUARE[1], SQUARE[0]], 4.0, 1.0),
    "walk": walk(1),
    "gentle walk": walk(2, acceleration_m_s2=0.3),
    "recorded": Recorded(np.array([1.0, 4.0, 5.0, 12.0]), np.array(SQUARE)),
}
each_motion = pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS.keys())


@each_motion
def test_the_velocity_is_the_derivative_of_the_position(motion: TrueMotion) -> None:
    step_s = 1e-4
    times = np.arange(-3.0, 120.0, 0.0317)
    before, after = motion.at(times - step_s)[0], motion.at(times + step_s)[0]
    # accelerations are bounded, also where they jump: no more than 10 m/s^2 times half a step
    assert (after - before) / (2.0 * step_s) == pytest.approx(motion.at(times)[1], abs=10.0 * step_s / 2.0)


@each_motion
def test_the_velocity_is_continuous(motion: TrueMotion) -> None:
    velocities = motion.at(np.arange(-3.0, 120.0, 0.001))[1]
    # recorded points may be 40 m apart in a second, at some 100 m/s^2; the others keep below 5 m/s^2
    most_m_s2 = 250.0 if isinstance(motion, Recorded) else 5.0
    assert np.abs(np.diff(velocities, axis=0)).max() <= 0.001 * most_m_s2


@each_motion
def test_top_speed_and_box_hold(motion: TrueMotion) -> None:
    positions, velocities = motion.at(np.arange(-10.0, 400.0, 0.01))
    speeds = np.linalg.norm(velocities, axis=1)
    assert speeds.max() <= motion.top_speed_m_s * (1.0 + 1e-9)
    low, high = motion.box_enu_m
    assert (positions >= low - 1e-9).all()
    assert (positions <= high + 1e-9).all()
    if not isinstance(motion, (RandomWalk, Recorded)):
        assert speeds.max() == pytest.approx(motion.top_speed_m_s, rel=1e-3)


@pytest.mark.parametrize("heading_deg", range(0, 360, 25))
def test_the_box_of_an_eight_is_no_larger_than_it_needs_to_be(heading_deg: int) -> None:
    eight = FigureEight((3.0, 4.0, 15.0), 60.0, 5.0, float(heading_deg))
    positions = eight.at(np.arange(0.0, 80.0, 0.01))[0]
    assert np.array([positions.min(axis=0), positions.max(axis=0)]) == pytest.approx(eight.box_enu_m, abs=1e-3)


@each_motion
def test_every_time_has_one_answer_whatever_else_is_asked(motion: TrueMotion) -> None:
    times = np.random.default_rng(3).uniform(-5.0, 300.0, 200)
    together = motion.at(times)[0]
    assert np.array([motion.at(np.array([time_s]))[0][0] for time_s in times]) == pytest.approx(together, abs=1e-12)
    assert motion.at(np.empty(0))[0].shape == motion.at(np.empty(0))[1].shape == (0, 3)


def test_circles_turn_as_told() -> None:
    left, right = Circle((0.0, 0.0, 9.0), 50.0, 4.0), Circle((0.0, 0.0, 9.0), 50.0, 4.0, 90.0, clockwise=True)
    quarter_s = 0.5 * math.pi * 50.0 / 4.0
    assert left.at(np.array([0.0, quarter_s]))[0] == pytest.approx(np.array([[50, 0, 9], [0, 50, 9]]), abs=1e-9)
    assert right.at(np.array([0.0, quarter_s]))[0] == pytest.approx(np.array([[0, 50, 9], [50, 0, 9]]), abs=1e-9)


def test_an_eight_lies_along_its_heading() -> None:
    northwards = FigureEight((0.0, 0.0, 9.0), 60.0, 5.0, heading_deg=0.0)
    assert northwards.box_enu_m == pytest.approx(np.array([[-15, -30, 9], [15, 30, 9]]))
    position, velocity = northwards.at(np.array([0.0]))
    assert position[0] == pytest.approx([0.0, 0.0, 9.0])
    assert velocity[0] == pytest.approx(5.0 * np.array([-1.0, 1.0, 0.0]) / math.sqrt(2.0))


def test_a_course_stops_at_its_ends_and_passes_corners_in_time() -> None:
    course = Waypoints(SQUARE, 4.0, 2.0)
    first_s = 0.5 * 4.0 / 2.0  # half of the time that speeding up takes is lost
    corner_s = first_s + 40.0 / 4.0
    end_s = corner_s + (math.sqrt(30.0**2 + 6.0**2) + math.sqrt(40.0**2 + 4.0**2)) / 4.0 + first_s
    positions, velocities = course.at(np.array([-1.0, 0.0, first_s + 5.0, end_s, end_s + 9.0]))
    assert positions[[0, 1, 3, 4]] == pytest.approx(np.array([SQUARE[0], SQUARE[0], SQUARE[3], SQUARE[3]]))
    assert positions[2] == pytest.approx([20.0, 0.0, 10.0])
    assert velocities[[0, 1, 3, 4]] == pytest.approx(0.0, abs=1e-9)
    corner = course.at(np.array([corner_s]))[0][0]
    turn_s = np.linalg.norm(course.at(np.array([corner_s + 2.0]))[1] - course.at(np.array([corner_s - 2.0]))[1]) / 2.0
    assert np.linalg.norm(corner - SQUARE[1]) == pytest.approx(2.0 * turn_s**2 / 8.0)


def test_a_closed_course_comes_round() -> None:
    course = Waypoints(SQUARE, 4.0, 2.0, closed=True)
    round_s = float(np.linalg.norm(np.diff([*SQUARE, SQUARE[0]], axis=0), axis=1).sum()) / 4.0
    times = np.arange(0.0, round_s, 0.1)
    for one, other in zip(course.at(times), course.at(times + round_s), strict=True):
        assert one == pytest.approx(other, abs=1e-9)


@pytest.mark.parametrize(
    ("points", "closed", "said"),
    [
        (SQUARE[:1], False, "1 points; accepted: 2 or more"),
        (SQUARE[:2], True, "2 points; accepted: 3 or more if closed"),
        ([SQUARE[0], SQUARE[1], SQUARE[1]], False, "point 2 and the next are equal"),
        ([*SQUARE[:3], SQUARE[0]], True, "point 4 and the next are equal"),
        ([SQUARE[0], (3.0, 0.0, 10.0)], False, "the leg from point 1 is 3.00 m long; accepted: 8.00 m or more"),
    ],
)
def test_courses_that_cannot_be_driven_are_refused(
    points: list[tuple[float, float, float]], closed: bool, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        Waypoints(points, 4.0, 2.0, closed)


def test_walks_keep_their_acceleration_and_differ_by_seed_alone() -> None:
    times = np.arange(0.0, 300.0, 1.0)
    accelerations = np.diff(walk(4).at(times)[1], axis=0)  # it is constant in each second
    assert np.linalg.norm(accelerations, axis=1).max() <= 1.0 + 1e-6
    assert (walk(4).at(times)[0] == walk(4).at(times)[0]).all()
    assert np.abs(walk(4).at(times)[0] - walk(5).at(times)[0]).max() > 5.0


def test_walks_use_what_they_may() -> None:
    for seed in range(5):
        positions, velocities = walk(seed).at(np.arange(0.0, 600.0, 0.1))
        speeds = np.linalg.norm(velocities, axis=1)
        assert speeds.mean() > 1.0  # a third of the box in ten seconds: nobody would say that it rests
        assert speeds.max() > 3.0
        assert (np.ptp(positions, axis=0) > [30.0, 30.0, 1.0]).all()


def test_a_walk_in_a_flat_box_stays_level() -> None:
    level = RandomWalk((-20.0, -20.0, 9.0), (20.0, 20.0, 9.0), 5.0, 1.0, seed=1, start_enu_m=(-20.0, 5.0, 9.0))
    positions = level.at(np.arange(0.0, 200.0, 0.1))[0]
    assert positions[0] == pytest.approx([-20.0, 5.0, 9.0])
    assert (positions[:, 2] == 9.0).all()
    assert np.ptp(positions[:, :2], axis=0).min() > 10.0


def test_walks_without_a_place_are_refused() -> None:
    with pytest.raises(ValueError, match="high_enu_m lies below"):
        RandomWalk(BOX[1], BOX[0], 5.0, 1.0, seed=0)
    with pytest.raises(ValueError, match="outside"):
        RandomWalk(*BOX, 5.0, 1.0, seed=0, start_enu_m=(0.0, 0.0, 0.0))


def test_a_recording_passes_its_points_without_overshoot_and_rests_at_its_ends() -> None:
    times, points = np.array([1.0, 4.0, 5.0, 12.0]), np.array(SQUARE)
    recorded = Recorded(times, points)
    assert recorded.at(times)[0] == pytest.approx(points)
    assert recorded.at(np.array([-9.0, 1.0, 12.0, 99.0]))[0] == pytest.approx(points[[0, 0, 3, 3]])
    assert recorded.at(np.array([-9.0, 1.0, 12.0, 99.0]))[1] == pytest.approx(0.0)
    between = recorded.at(np.linspace(1.0, 4.0, 50))[0]
    assert (np.diff(between[:, 0]) >= 0.0).all()
    alone = Recorded(np.array([3.0]), points[:1])
    assert alone.at(np.array([0.0, 9.0]))[0] == pytest.approx(points[[0, 0]])
    assert alone.top_speed_m_s == 0.0


@pytest.mark.parametrize("times", [[], [1.0, 1.0], [2.0, 1.0], [1.0, math.nan], [1.0]])
def test_recordings_that_are_none_are_refused(times: list[float]) -> None:
    with pytest.raises(ValueError, match="time"):
        Recorded(np.array(times), np.zeros((2 if times else 0, 3)))
