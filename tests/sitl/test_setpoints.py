"""Which setpoint does what: the type-mask tables of both autopilots, row by row."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from sitl_mock import profiles
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.autopilot.setpoints import LETHAL, Interpretation, Pose, SetpointEffect, SetpointFields
from tests.sitl.driver import TICK_S, USE_POSITION, ready

HERE = Pose(now_s=5.0, local_origin_ned_m=(100.0, 0.0, 0.0), position_ned_m=(103.0, 0.0, -10.0), yaw_rad=math.pi / 2)
NAN = math.nan
FLY, BRAKE, HOLD, INVALID = SetpointEffect.FLY, SetpointEffect.BRAKE, SetpointEffect.HOLD, SetpointEffect.INVALID
RULES = {name: profiles.strategy(name).rules for name in ("px4", "ardupilot")}
PARAMETERS = {name: Parameters(rules.profile, 1) for name, rules in RULES.items()}


def setpoint(
    mask: int,
    frame: int = 1,
    position: tuple[float, float, float] = (1.0, 2.0, -3.0),
    velocity: tuple[float, float, float] = (4.0, 5.0, 6.0),
    acceleration: tuple[float, float, float] = (0.1, 0.2, 0.3),
    yaw: float = 0.5,
) -> SetpointFields:
    return SetpointFields(mask, frame, position, velocity, acceleration, yaw, 0.25)


def px4(fields: SetpointFields) -> Interpretation:
    return RULES["px4"].interpret(fields, HERE, PARAMETERS["px4"])


def ardupilot(fields: SetpointFields) -> Interpretation:
    return RULES["ardupilot"].interpret(fields, HERE, PARAMETERS["ardupilot"])


@pytest.mark.parametrize(
    ("mask", "frame", "effect"),
    [
        (0xDF8, 1, FLY),  # position
        (0xDC0, 1, FLY),  # position, velocity
        (0xC00, 1, FLY),  # position, velocity, acceleration
        (0xDC7, 1, FLY),  # velocity
        (0xDE3, 1, FLY),  # velocity in x and y, position in z
        (0xC3F, 1, FLY),  # acceleration
        (0x000, 1, FLY),
        (0xF000, 1, FLY),  # unknown bits
        (0x3F8, 1, FLY),  # FORCE bit with position only (acceleration ignored)
        (0xFFF, 1, INVALID),
        (0xE00, 1, INVALID),  # FORCE bit with acceleration
        (0xDF8, 0, INVALID),
        (0xDF8, 4, INVALID),
        (0xDF8, 7, INVALID),
        (0xDF8, 9, INVALID),
        (0xDF8, 8, INVALID),  # BODY_NED with position
        (0xDC7, 8, FLY),  # BODY_NED with velocity
        (0xDF9, 1, HOLD),  # only x ignored
        (0xDFA, 1, HOLD),  # only y ignored
    ],
)
def test_px4_masks(mask: int, frame: int, effect: SetpointEffect) -> None:
    answer = px4(setpoint(mask, frame))
    assert answer.effect is effect
    assert (answer.reference is not None) == (effect is FLY)
    assert bool(answer.text) == (effect is INVALID)


@pytest.mark.parametrize("bad", [NAN, math.inf, -math.inf])
def test_px4_holds_on_one_bad_horizontal_coordinate_and_refuses_none_at_all(bad: float) -> None:
    assert px4(setpoint(0xDF8, position=(bad, 2.0, -3.0))).effect is HOLD
    assert px4(setpoint(0xDF8, position=(1.0, bad, -3.0))).effect is HOLD
    assert px4(setpoint(0xDF8, position=(bad, bad, bad))).effect is INVALID


@pytest.mark.parametrize(
    ("mask", "frame", "effect"),
    [
        (0xDF8, 1, FLY),
        (0xDC0, 1, FLY),
        (0xC00, 1, FLY),
        (0xDC7, 1, FLY),
        (0xC07, 1, FLY),
        (0xC3F, 1, FLY),
        (0x000, 1, FLY),
        (0x9F8, 1, FLY),
        (0x9C0, 1, FLY),
        (0x800, 1, FLY),
        (0xC38, 1, BRAKE),  # position and acceleration without velocity
        (0xFFF, 1, BRAKE),
        (0xDFC, 1, BRAKE),  # only z ignored: the whole group is
        (0xDE7, 1, BRAKE),  # only vz ignored
        (0xE00, 1, BRAKE),  # FORCE bit with acceleration
        (0xFC0, 1, FLY),  # FORCE bit without
        (0xDF8, 0, BRAKE),
        (0xDF8, 3, BRAKE),
        (0xDF8, 5, BRAKE),
        (0xDF8, 6, BRAKE),
        (0xDF8, 20, BRAKE),
        (0xDF8, 21, BRAKE),
        (0xDF8, 7, FLY),
        (0xDC7, 8, FLY),
        (0xDF8, 9, FLY),
    ],
)
def test_ardupilot_masks(mask: int, frame: int, effect: SetpointEffect) -> None:
    answer = ardupilot(setpoint(mask, frame))
    assert answer.effect is effect
    assert not answer.text


@pytest.mark.parametrize(
    ("bad", "text"),
    [
        (setpoint(0xDF8, position=(NAN, 0.0, 0.0)), LETHAL),
        (setpoint(0xDF8, position=(0.0, math.inf, 0.0)), LETHAL),
        (setpoint(0xDF8, position=(0.0, 0.0, 1e9)), LETHAL),
        (setpoint(0xC00, acceleration=(0.0, NAN, 0.0)), LETHAL),
        (setpoint(0x9F8, yaw=NAN), LETHAL),
        (setpoint(0xDC7, velocity=(NAN, 0.0, 0.0)), ""),
        (setpoint(0xDC7, velocity=(0.0, 1001.0, 0.0)), ""),
    ],
)
def test_ardupilot_brakes_on_numbers_that_are_none(bad: SetpointFields, text: str) -> None:
    answer = ardupilot(bad)
    assert (answer.effect, answer.text) == (BRAKE, text)


def test_nan_in_ignored_fields_is_harmless() -> None:
    hostile = setpoint(0xDF8, velocity=(NAN, NAN, NAN), acceleration=(NAN, NAN, NAN), yaw=NAN)
    for answer in (px4(hostile), ardupilot(hostile)):
        assert answer.effect is FLY
        assert answer.reference is not None
        assert answer.reference.velocity_ned_m_s == (0.0, 0.0, 0.0)


def test_frames_of_ardupilot() -> None:
    """Local from the origin; offset from here; body turned by the heading (here: east)."""
    places = {}
    for frame in (1, 7, 8, 9):
        reference = ardupilot(setpoint(0xDF8, frame, position=(1.0, 0.0, 0.0))).reference
        assert reference is not None
        places[frame] = reference.position_ned_m
    assert places[1] == pytest.approx((101.0, 0.0, 0.0))
    assert places[7] == pytest.approx((104.0, 0.0, -10.0))
    assert places[8] == pytest.approx((103.0, 1.0, -10.0))
    assert places[9] == pytest.approx((103.0, 1.0, -10.0))


def test_yaw_ignored() -> None:
    """PX4 keeps the heading; ArduPilot turns the nose into the direction of travel."""
    kept, turned = px4(setpoint(0xDF8)).reference, ardupilot(setpoint(0xDC7, velocity=(0.0, -3.0, 0.0))).reference
    assert kept is not None
    assert kept.yaw_rad is None
    assert turned is not None
    assert turned.yaw_rad == pytest.approx(-math.pi / 2)


def test_how_long_targets_run_on() -> None:
    alone, moving, px4_moving = ardupilot(setpoint(0xDF8)), ardupilot(setpoint(0xDC0)), px4(setpoint(0xDC0))
    assert [u.reference and (u.reference.carry_s, u.reference.lapses) for u in (alone, moving, px4_moving)] == [
        (0.0, False),
        (3.0, True),
        (0.1, False),
    ]


numbers = st.floats(allow_nan=True, allow_infinity=True, width=32)
vectors = st.tuples(numbers, numbers, numbers)


@given(st.integers(0, 0xFFFF), st.integers(0, 255), vectors, vectors, vectors, numbers, numbers)
def test_whatever_comes_what_is_flown_is_finite(
    mask: int,
    frame: int,
    position: tuple[float, float, float],
    velocity: tuple[float, float, float],
    acceleration: tuple[float, float, float],
    yaw: float,
    rate: float,
) -> None:
    for interpret in (px4, ardupilot):
        reference = interpret(SetpointFields(mask, frame, position, velocity, acceleration, yaw, rate)).reference
        if reference is not None:
            flown = (*reference.position_ned_m, *reference.velocity_ned_m_s, *reference.acceleration_ned_m_s2)
            assert all(map(math.isfinite, (*flown, reference.yaw_rad or 0.0, reference.yaw_rate_rad_s)))


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
@pytest.mark.parametrize("kind", ["local", "global"])
def test_a_setpoint_runs_on_from_the_instant_it_arrives(autopilot: str, kind: str) -> None:
    """Not from the last run of the logic, which is up to 20 ms old."""
    station = ready(autopilot)
    station.fly_to(5.0)
    for ticks in (1, 2, 3):
        station.run(ticks * TICK_S)
        if kind == "local":
            station.setpoint((1.0, 2.0, -5.0), mask=USE_POSITION)
        else:
            point = station.autopilot.world.geodetic(1.0, 2.0, -5.0)
            degrees = (round(point.latitude_deg * 1e7), round(point.longitude_deg * 1e7))
            message = dialect.MAVLink_set_position_target_global_int_message
            station.send(message(0, 1, 1, 5, USE_POSITION, *degrees, point.altitude_m, *[0.0] * 8))
        setpoint = station.autopilot.guidance.setpoint
        assert setpoint is not None
        assert setpoint.since_s == station.now_s
        assert setpoint.position_ned_m == pytest.approx((1.0, 2.0, -5.0), abs=0.02)
