"""Flights on links that lose, delay, double and overtake, and with single answers that are never heard."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as dialect

from tests.flight.harness import AUTOPILOTS, Flight, fly
from tests.flight.meddling import LATENCY_S, Datagram, Judge, MeddlingLoop, OneOf, lossy

FAILSAFES = {"px4": ("COM_OBL_RC_ACT", 4.0), "ardupilot": ("FS_GCS_ENABLE", 5.0)}


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize(
    "judge",
    [lossy(1, 0.2), lossy(2, 0.0, 0.1, 0.2, double=0.1), lossy(3, 0.3, 0.1, 0.2)],
    ids=["20 % lost", "150±50 ms, doubled", "30 % lost, 150±50 ms"],
)
def test_a_flight_on_a_bad_link_completes(judge: Judge, autopilot: str, tmp_path: Path) -> None:
    flight = fly(tmp_path, autopilot, loop=lambda: MeddlingLoop(judge))
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    assert flight.down_and_disarmed
    assert flight.truth_separation_m >= 1.4


def deaf_to(name: str, until_s: float) -> Judge:
    """Return what loses every answer of vehicle 3 about one parameter for a while."""

    def judge(datagram: Datagram) -> list[float]:
        about = datagram.message_id == dialect.MAVLINK_MSG_ID_PARAM_VALUE and name.encode() in datagram.data
        lost = about and not datagram.outbound and datagram.data[5] == 3 and datagram.at_s < until_s
        return [] if lost else [LATENCY_S]

    return judge


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_failsafe_that_is_heard_late_is_set_all_the_same(autopilot: str, tmp_path: Path) -> None:
    name, wanted = FAILSAFES[autopilot]
    during: list[float] = []

    async def look(flight: Flight) -> None:
        await flight.reaches("hold")
        pilots = [vehicle.autopilot for vehicle in flight.simulator.fleet.vehicles]
        during.extend(pilot.parameters[name] for pilot in pilots)

    flight = fly(tmp_path, autopilot, look, loop=lambda: MeddlingLoop(deaf_to(name, 20.0)))
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    assert during == [wanted] * 4


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_no_flight_begins_without_its_failsafe(autopilot: str, tmp_path: Path) -> None:
    name, _ = FAILSAFES[autopilot]

    async def never_armed(flight: Flight) -> None:
        await flight.reaches("take-off")
        raise AssertionError

    flight = fly(tmp_path, autopilot, never_armed, loop=lambda: MeddlingLoop(deaf_to(name, 1e6)))
    assert flight.result is not None
    assert f"vehicle 3 did not tell its parameter {name} within 30 s, but tells " in flight.result.reason


@pytest.mark.parametrize("late_s", [12.0, 17.0])
def test_a_heartbeat_from_before_arming_ends_no_flight(late_s: float, tmp_path: Path) -> None:
    one = OneOf(dialect.MAVLINK_MSG_ID_HEARTBEAT, 5, late_s, outbound=False)
    flight = fly(tmp_path, "px4", loop=lambda: MeddlingLoop(one))
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason


def test_the_first_setpoints_may_be_lost(tmp_path: Path) -> None:
    """PX4 refuses its streaming mode for that time, and is asked again."""
    lost: list[float] = []

    def judge(datagram: Datagram) -> list[float]:
        setpoint = datagram.message_id == dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
        if setpoint and len(lost) < 50:  # of all four vehicles: some 0.4 s
            lost.append(datagram.at_s)
            return []
        return [LATENCY_S]

    flight = fly(tmp_path, "px4", loop=lambda: MeddlingLoop(judge))
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
