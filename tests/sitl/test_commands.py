"""Acknowledgements, targets, message intervals and requests, as recorded from the real autopilots."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import all as dialect

from tests.sitl.driver import (
    ARM,
    BRAKE,
    GUIDED,
    LOITER,
    OFFBOARD,
    REQUEST,
    SET_INTERVAL,
    SET_MODE,
    TAKEOFF,
    USE_POSITION,
    Station,
    ready,
)

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
GET_INTERVAL, REPOSITION = 510, 192
NAN = math.nan


@pytest.mark.parametrize(
    ("number", "results"),
    [
        (16, [UNSUPPORTED]),
        (65000, [UNSUPPORTED]),
        (178, [ACCEPTED]),
        (185, [DENIED]),
        (189, [6]),
        (211, [5]),
        (203, []),
        (242, []),
        (30001, []),
        (192, [UNSUPPORTED]),  # as COMMAND_LONG
        (300, [DENIED]),
        (520, [ACCEPTED]),
        (2600, [FAILED]),
    ],
)
def test_px4_acknowledgements(number: int, results: list[int]) -> None:
    assert ready("px4").command(number) == results


@pytest.mark.parametrize(
    ("parameters", "results"),
    [
        ((1, 4, 3), [ACCEPTED, ACCEPTED]),
        ((1, 6), [ACCEPTED, ACCEPTED]),  # disarmed: also without a stream
        ((1, 99), [ACCEPTED, ACCEPTED]),
        ((1, 4, 99), [ACCEPTED, REJECTED]),
        ((0, 4, 3), [DENIED]),
        ((NAN, 4, 3), [DENIED]),
        ((1, NAN), [ACCEPTED, ACCEPTED]),
    ],
)
def test_px4_modes_are_acknowledged_twice(parameters: tuple[float, ...], results: list[int]) -> None:
    assert ready("px4").command(SET_MODE, *parameters) == results


def test_px4_offboard_needs_one_fresh_setpoint_when_armed() -> None:
    station = ready("px4")
    station.command(ARM, 1)
    assert station.mode(OFFBOARD) == [ACCEPTED, REJECTED]
    assert station.autopilot.mode.number == LOITER
    assert "Switching to Offboard is currently not available\t" in station.texts()
    station.setpoint(mask=USE_POSITION)
    assert station.mode(OFFBOARD) == [ACCEPTED, ACCEPTED]
    assert station.autopilot.mode.number == OFFBOARD


@pytest.mark.parametrize(
    ("number", "parameters", "result"),
    [
        (65000, (), UNSUPPORTED),
        (ARM, (2,), UNSUPPORTED),
        (ARM, (0.5,), UNSUPPORTED),
        (ARM, (0,), ACCEPTED),
        (SET_MODE, (0, 4), DENIED),
        (SET_MODE, (209, 4), ACCEPTED),
        (SET_MODE, (1, 27), FAILED),
        (SET_MODE, (1, 99), FAILED),
        (TAKEOFF, (0, 0, 0, 0, 0, 0, 10), FAILED),  # disarmed
        (TAKEOFF, (0, 0, 0, 0, 0, 0, NAN), FAILED),
        (246, (1,), ACCEPTED),
    ],
)
def test_ardupilot_acknowledgements(number: int, parameters: tuple[float, ...], result: int) -> None:
    assert ready("ardupilot").command(number, *parameters) == [result]


def test_px4_odd_arming() -> None:
    station = ready("px4")
    assert station.command(ARM, 2) == []
    assert "Unsupported ARM_DISARM param: 2.000\t" in station.texts()
    assert station.command(ARM, 0.5) == [ACCEPTED]
    assert station.autopilot.armed


@pytest.mark.parametrize(
    ("autopilot", "system", "component", "answered"),
    [
        ("px4", 1, 0, True),
        ("px4", 1, 99, False),
        ("px4", 0, 1, False),
        ("px4", 9, 1, False),
        ("ardupilot", 1, 0, True),
        ("ardupilot", 1, 190, True),
        ("ardupilot", 0, 100, True),
        ("ardupilot", 9, 1, False),
    ],
)
def test_targets(autopilot: str, system: int, component: int, answered: bool) -> None:
    station = ready(autopilot)
    if autopilot == "ardupilot":
        station.mode(GUIDED)
    assert station.command(ARM, 1, system=system, component=component) == ([ACCEPTED] if answered else [])
    assert station.autopilot.armed is answered


def test_acknowledgement_goes_to_the_sender() -> None:
    station = ready("px4", links=2)
    message = dialect.MAVLink_command_long_message(1, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0)
    station.send(message, link=1, system=42, component=7)
    assert not station.messages("COMMAND_ACK", link=0)
    (ack,) = station.messages("COMMAND_ACK", link=1)
    assert (ack.target_system, ack.target_component) == (42, 7)


def received_hz(station: Station, kind: str, seconds: float = 4.0) -> float:
    start_s = station.now_s
    station.run(seconds)
    return len(station.messages(kind, since_s=start_s + 0.001)) / seconds


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_message_intervals(autopilot: str) -> None:
    station = ready(autopilot)
    default_hz = 10.0 if station.px4 else 0.0
    assert received_hz(station, "LOCAL_POSITION_NED") == default_hz
    for hz in (50.0, 20.0, 5.0):
        assert station.command(SET_INTERVAL, 32, 1e6 / hz) == [ACCEPTED]
        assert received_hz(station, "LOCAL_POSITION_NED") == pytest.approx(hz, abs=0.3)
    station.command(GET_INTERVAL, 32)
    assert station.messages("MESSAGE_INTERVAL")[-1].interval_us == 200_000
    assert station.command(SET_INTERVAL, 32, -1) == [ACCEPTED]
    assert received_hz(station, "LOCAL_POSITION_NED") == 0.0
    assert station.command(SET_INTERVAL, 32, 0) == [ACCEPTED]
    assert received_hz(station, "LOCAL_POSITION_NED") == default_hz


@pytest.mark.parametrize(
    ("autopilot", "number", "interval_us", "result"),
    [
        ("px4", 9999, 1e5, FAILED),
        ("px4", 0, 1e5, FAILED),  # its heartbeat cannot be set
        ("px4", 32, 2000, ACCEPTED),  # capped
        ("ardupilot", 9999, 1e5, DENIED),
        ("ardupilot", 331, 1e5, DENIED),
        ("ardupilot", 0, 2e5, ACCEPTED),
        ("ardupilot", 32, 2500, DENIED),  # 2 ms after cutting
        ("ardupilot", 32, -5, DENIED),
        ("ardupilot", 32, NAN, DENIED),
    ],
)
def test_odd_intervals(autopilot: str, number: int, interval_us: float, result: int) -> None:
    assert ready(autopilot).command(SET_INTERVAL, number, interval_us) == [result]


def test_ardupilot_heartbeat_can_be_raised_and_follows_a_mode_change_at_once() -> None:
    station = ready("ardupilot")
    assert received_hz(station, "HEARTBEAT") == 1.0
    station.command(SET_INTERVAL, 0, 2e5)
    assert received_hz(station, "HEARTBEAT") == 5.0
    before = len(station.messages("HEARTBEAT"))
    station.mode(BRAKE)
    assert [m.custom_mode for m in station.messages("HEARTBEAT")[before:]] == [BRAKE]


@pytest.mark.parametrize(("autopilot", "unknown"), [("px4", DENIED), ("ardupilot", FAILED)])
def test_requests(autopilot: str, unknown: int) -> None:
    station = ready(autopilot)
    assert station.command(REQUEST, 49) == [ACCEPTED]
    assert station.messages("GPS_GLOBAL_ORIGIN")
    assert station.command(REQUEST, 148) == [ACCEPTED]
    assert station.messages("AUTOPILOT_VERSION")[-1].capabilities == station.autopilot.profile.capabilities
    assert station.messages("AUTOPILOT_VERSION")[-1].uid == 1 << 32 | 0x5349544C  # every vehicle's is its own
    assert station.command(REQUEST, 9999) == [unknown]


def test_ardupilot_data_streams() -> None:
    station = ready("ardupilot")
    station.send(dialect.MAVLink_request_data_stream_message(1, 1, 6, 10, 1))
    assert received_hz(station, "LOCAL_POSITION_NED") == 10.0
    station.send(dialect.MAVLink_request_data_stream_message(1, 1, 0, 4, 1))
    assert received_hz(station, "ATTITUDE") == 4.0
    station.send(dialect.MAVLink_request_data_stream_message(1, 1, 0, 0, 0))
    assert received_hz(station, "ATTITUDE") == 0.0


def test_reposition_by_command_int() -> None:
    station = ready("px4")
    station.fly_to(5.0)
    place = station.autopilot.world.geodetic(10.0, 0.0, -5.0)
    x, y = round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)
    message = dialect.MAVLink_command_int_message(1, 1, 0, REPOSITION, 0, 0, -1, 1, 0, 0, x, y, place.altitude_m)
    assert [m.result for m in station.send(message) if m.get_type() == "COMMAND_ACK"] == [ACCEPTED]
    station.run(10.0)
    assert station.autopilot.mode.number == LOITER
    assert station.position_m() == pytest.approx((10.0, 0.0, -5.0), abs=0.2)


def test_ardupilot_takes_only_relative_altitudes_by_command_int() -> None:
    station = ready("ardupilot")
    station.mode(GUIDED)
    station.command(ARM, 1)
    for frame, result in ((0, DENIED), (3, ACCEPTED)):
        message = dialect.MAVLink_command_int_message(1, 1, frame, TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 0, 5.0)
        assert [m.result for m in station.send(message) if m.get_type() == "COMMAND_ACK"] == [result]
