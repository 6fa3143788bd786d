"""Local frames that move in flight: seen in one sample, and never where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.core.frames import swap_ned_enu
from fg_gcs.flight.origins import MOVED_M, OriginWatch
from fg_gcs.mission import parse_mission
from fg_gcs.run.trial import Trial, judge
from fg_gcs.wire.states import State, StateTable
from tests.flight.harness import AUTOPILOTS, SMALL

NOTHING = State(*[0.0] * 14)


def place(time_s: float, phase: float) -> tuple[np.ndarray, np.ndarray]:
    """A curve of 8 m/s and 10 m/s^2 at most, NED."""
    turn = 1.2 * time_s + phase
    return (
        np.array([6.0 * np.sin(turn), 6.0 * np.cos(turn), -12.0 + np.sin(0.7 * time_s)]),
        np.array([7.2 * np.cos(turn), -7.2 * np.sin(turn), 0.7 * np.cos(0.7 * time_s)]),
    )


@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.floats(-20.0, 20.0), min_size=3, max_size=3),
    st.integers(2, 60),
)
def test_a_frame_that_jumps_is_joined_anew_and_nothing_else_is(seed: int, jump: list[float], when: int) -> None:
    draw = np.random.default_rng(seed)
    states, way = StateTable(2), np.array(jump)
    origins_m = np.zeros((2, 3))
    watch, time_s = OriginWatch((), states), 5.0
    for count in range(80):
        time_s += draw.choice([0.04, 0.05, 0.1])
        if count % 7 == 3:
            continue  # lost
        moved_m = way if count >= when else np.zeros(3)
        for row in range(2):
            position_m, velocity_m_s = place(time_s, float(row))
            seen_m = position_m - moved_m * (row == 1)
            states.set_motion(row, *seen_m, *velocity_m_s, time_s, time_s)
        found = watch.moved_enu_m()
        assert 0 not in found
        assert not (1 in found and np.linalg.norm(way) < MOVED_M - 0.2)
        for row, by_m in found.items():
            origins_m[row] += by_m
        assert watch.moved_enu_m() == {}
        if np.linalg.norm(way) > MOVED_M + 0.2:
            assert np.linalg.norm(origins_m[1] - swap_ned_enu(moved_m)) < 0.2


def test_an_estimate_that_stands_still_or_begins_anew_is_no_frame_that_moves() -> None:
    states = StateTable(1)
    watch = OriginWatch((), states)
    for count in range(50):
        states.set_motion(0, 1.0, 2.0, -5.0, 5.0, 0.0, 0.0, 10.0 + 0.05 * count, 0.0)
        assert watch.moved_enu_m() == {}
    states.set_motion(0, 90.0, 2.0, -5.0, 5.0, 0.0, 0.0, 1.0, 0.0)  # another boot
    assert watch.moved_enu_m() == {}


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("told", [True, False])
def test_a_frame_that_creeps_is_joined_anew_before_anybody_is_near(autopilot: str, told: bool) -> None:
    """By 0.4 m/s, which velocities do not show: positions on Earth do."""
    creeps = {"kind": "origin", "rate_enu_m_s": [0.3, -0.26, 0.0], "told": told, "vehicles": [2], "stage": "gather"}
    found = judge(Trial(parse_mission(SMALL), autopilot, faults=(creeps,)))
    assert found.broken == []
    assert found.result is not None
    assert found.result.reason.startswith("vehicle 2 has a local frame that moves: it has gone 0.")
    assert found.result.summary["vehicles_landed"] == 4


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_frame_that_lies_elsewhere_than_it_says_does_not_fly(autopilot: str) -> None:
    wrong = {"kind": "origin_wrong", "offset_enu_m": [3.0, -4.0, 0.0], "vehicles": [3]}
    found = judge(Trial(parse_mission(SMALL), autopilot, faults=(wrong,)))
    assert found.broken == []
    assert found.result is not None
    assert found.result.reason.startswith(
        "vehicle 3: its local frame lies 5.0 m from where GPS_GLOBAL_ORIGIN says, by its own positions"
    )


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_nobody_lands_on_a_vehicle_that_started_again_in_the_air(autopilot: str) -> None:
    """Its new frame has its zero where it did so; what it tells of its height then is far below the ground."""
    again = {"kind": "reboot", "vehicles": [3], "stage": "gather", "at_s": 0.1}
    dead = {"kind": "dead", "vehicles": [1], "stage": "gather", "at_s": 0.9}
    found = judge(Trial(parse_mission(SMALL), autopilot, faults=(again, dead)))
    assert found.broken == []
    assert found.result is not None
    assert found.result.summary["vehicles_landed"] in (2, 3)  # one is dead, and one may be down by itself


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("at_s", [1.5, 3.0])
def test_one_that_starts_again_while_it_lands_has_not_completed_its_flight(autopilot: str, at_s: float) -> None:
    again = {"kind": "reboot", "vehicles": [2], "stage": "land", "at_s": at_s}
    found = judge(Trial(parse_mission(SMALL), autopilot, faults=(again,), impairments=({"loss": 0.15},)))
    assert found.broken == []
    assert found.result is not None
    assert not found.result.completed


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_vehicle_whose_frame_moves_on_the_way_home_stays_where_it_is_and_all_come_home(autopilot: str) -> None:
    moves = {"kind": "origin", "offset_enu_m": [4.0, -3.0, 1.5], "vehicles": [2], "stage": "home", "at_s": 1.0}
    found = judge(Trial(parse_mission(SMALL), autopilot, faults=(moves,)))
    assert found.broken == []
    assert found.result is not None
    assert found.result.reason.startswith("vehicle 2 has a local frame that moves: it has gone 5.2 m")
    assert found.result.summary["vehicles_landed"] == 4
