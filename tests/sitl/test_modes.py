"""Modes, arming, take-off, landing and failsafes: every (mode, event) pair, and the measured stories."""

from __future__ import annotations

import struct

import pytest

from sitl_mock import profiles
from sitl_mock.autopilot.profile import Behaviour, ModeEvent, Need
from sitl_mock.messages import Landed, SystemStatus
from sitl_mock.physics.reference import Thrust
from tests.sitl.driver import (
    AP_LAND,
    AP_RTL,
    ARM,
    BRAKE,
    GUIDED,
    LAND,
    LOITER,
    OFFBOARD,
    PX4_LAND,
    PX4_RTL,
    TAKEOFF,
    USE_POSITION,
    USE_VELOCITY,
    Station,
    ready,
)

PLACE = (0.0, 0.0, -5.0)
MODES = {name: profiles.strategy(name).rules.profile.modes for name in profiles.names()}
PAIRS = [(name, mode.name, event) for name, modes in MODES.items() for mode in modes for event in ModeEvent]
# What leaves a mode, written out once more; whatever is not here leaves the mode as it is.
EXPECTED = {
    ("px4", "TAKEOFF", ModeEvent.CLIMBED): "LOITER",
    ("px4", "TAKEOFF", ModeEvent.DISARMED): "LOITER",
    ("px4", "LAND", ModeEvent.DISARMED): "LOITER",
    ("px4", "PRECLAND", ModeEvent.DISARMED): "LOITER",
    ("px4", "RTL", ModeEvent.DISARMED): "LOITER",
    ("px4", "OFFBOARD", ModeEvent.STREAM_LOST): "LAND",
    **{("px4", mode.name, ModeEvent.GCS_LOST): "LOITER" for mode in MODES["px4"]},
    **{("px4", mode.name, ModeEvent.FAILSAFE_DELAY_OVER): "RTL" for mode in MODES["px4"]},
    **{("ardupilot", mode.name, ModeEvent.GCS_LOST): "LAND" for mode in MODES["ardupilot"]},
    **{("ardupilot", mode.name, ModeEvent.FAILSAFE_DELAY_OVER): "LAND" for mode in MODES["ardupilot"]},
}


def stream(station: Station, seconds: float) -> None:
    station.run(seconds, lambda _: station.setpoint(PLACE, mask=USE_POSITION))


def flying_in(autopilot: str, mode: str) -> Station:
    """High in the air in a mode, with all failsafes wanted and quick."""
    station = ready(autopilot)
    vehicle = station.autopilot
    station.command(ARM, 1, 2989)
    vehicle.airborne = True
    vehicle.guidance.takeoff_height_m = 1000.0  # not reached by itself
    station.fleet.swarm.position_m[0, 2] = -200.0
    if station.px4:
        station.parameter("NAV_DLL_ACT", _bytewise(2), 6)
        station.parameter("COM_DL_LOSS_T", _bytewise(0), 6)  # PX4 acts 1.45 s later than this
        station.parameter("COM_FAIL_ACT_T", 2.0)
        station.parameter("COM_OBL_RC_ACT", _bytewise(4), 6)
    else:
        station.parameter("FS_GCS_ENABLE", 5)
        station.parameter("FS_GCS_TIMEOUT", 1.4)
    vehicle.change(vehicle.modes[mode], keep_intention=False)
    if vehicle.mode.behaviour is Behaviour.FOLLOW:
        stream(station, 0.1)
    else:
        station.run(0.1)
    assert vehicle.mode.name == mode
    return station


def _bytewise(value: int) -> float:
    number: float = struct.unpack("<f", struct.pack("<i", value))[0]
    return number


def happen(station: Station, event: ModeEvent) -> None:
    vehicle = station.autopilot
    station.heartbeats = event not in (ModeEvent.GCS_LOST, ModeEvent.FAILSAFE_DELAY_OVER)
    keep = vehicle.mode.behaviour is Behaviour.FOLLOW and event is not ModeEvent.STREAM_LOST
    if event is ModeEvent.CLIMBED:
        vehicle.guidance.takeoff_height_m = 100.0
    elif event is ModeEvent.DISARMED:
        vehicle.disarm("command", force=True)
    seconds = {ModeEvent.GCS_LOST: 1.6, ModeEvent.FAILSAFE_DELAY_OVER: 3.8, ModeEvent.STREAM_LOST: 1.3}.get(event, 0.2)
    if keep and vehicle.armed:
        stream(station, seconds)
    else:
        station.run(seconds)


@pytest.mark.parametrize(("autopilot", "mode", "event"), PAIRS)
def test_every_mode_and_event(autopilot: str, mode: str, event: ModeEvent) -> None:
    station = flying_in(autopilot, mode)
    vehicle = station.autopilot
    happen(station, event)
    assert vehicle.mode.name == EXPECTED.get((autopilot, mode, event), mode)
    assert vehicle.thrust is (Thrust.OFF if event is ModeEvent.DISARMED else Thrust.FLY)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_arming_in_every_mode(autopilot: str) -> None:
    """PX4 refuses with TEMPORARILY_REJECTED, ArduPilot with FAILED, both say why; force overrules."""
    for mode in MODES[autopilot]:
        station = ready(autopilot)
        vehicle = station.autopilot
        vehicle.change(mode, keep_intention=False)
        allowed = mode.armable and mode.need is Need.NOTHING
        refusal = 1 if station.px4 else 4
        assert station.command(ARM, 1) == [0 if allowed else refusal], mode.name
        assert any("rm" in text and ("denied" in text or "Arm:" in text) for text in station.texts()) != allowed
        assert station.command(ARM, 1, 2989) == [0]
        assert vehicle.armed
        assert station.command(ARM, 0) == [0]
        assert not vehicle.armed


def test_px4_flight() -> None:
    station = ready("px4")
    assert station.autopilot.status is SystemStatus.STANDBY
    station.setpoint(PLACE, mask=USE_POSITION)
    assert station.mode(OFFBOARD) == [0, 0]  # the blind one, then the truth
    station.command(ARM, 1)
    start_s = station.now_s
    stream(station, 2.9)
    assert not station.autopilot.airborne  # measured: 0.2 m at 3.4 s after arming
    stream(station, 12.0)
    assert station.height_m() == pytest.approx(5.0, abs=0.1)
    assert station.landed() is Landed.IN_AIR
    assert station.command(ARM, 0) == [1]
    assert "Disarming denied: not landed\t" in station.texts(since_s=start_s)
    land_s = station.now_s
    assert station.command(LAND) == [0]
    stream(station, 1.0)
    assert station.autopilot.mode.number == PX4_LAND  # a commanded LAND wins over the stream
    station.run(20.0)
    assert not station.autopilot.armed
    assert station.autopilot.mode.number == LOITER
    assert station.texts(since_s=land_s)[-2:] == ["Landing detected\t", "Disarmed by landing\t"]


def test_ardupilot_flight() -> None:
    station = ready("ardupilot")
    assert station.mode(GUIDED) == [0]
    assert station.command(ARM, 1) == [0]
    station.run(3.0)
    assert station.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 10.0) == [0]
    start_s = station.now_s
    station.run(0.9)
    assert station.landed() is Landed.ON_GROUND
    station.run(0.2)
    assert station.landed() is Landed.TAKEOFF  # measured +1.0 s
    station.run(6.4)
    assert station.height_m() == pytest.approx(9.7, abs=0.5)  # measured z < -9.5 at +7.1, -9.9 at +7.8
    station.run(3.0)
    assert station.landed() is Landed.IN_AIR
    assert station.command(ARM, 0) == [4]
    assert station.texts(since_s=start_s) == []
    assert station.mode(AP_LAND) == [0]
    station.run(21.0)
    assert station.landed() is Landed.LANDING  # measured: touch-down +20.4, ON_GROUND +22.0, disarmed +22.5
    station.run(3.0)
    assert not station.autopilot.armed
    assert station.autopilot.mode.number == AP_LAND


def test_setpoints_never_lift_ardupilot_off_and_cancel_its_take_off() -> None:
    station = ready("ardupilot")
    station.mode(GUIDED)
    station.command(ARM, 1)
    stream(station, 5.0)
    assert station.height_m() == 0.0
    assert station.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 10.0) == [0]
    station.run(0.5)
    station.setpoint(PLACE, mask=USE_POSITION)
    station.run(3.0)
    assert station.height_m() == 0.0
    station.run(5.0)
    assert not station.autopilot.armed  # idle


@pytest.mark.parametrize(("autopilot", "before_s", "after_s"), [("px4", 10.9, 11.3), ("ardupilot", 9.7, 10.1)])
def test_idle_disarm(autopilot: str, before_s: float, after_s: float) -> None:
    station = ready(autopilot)
    station.command(ARM, 1)
    station.run(before_s)
    assert station.autopilot.armed
    station.run(after_s - before_s)
    assert not station.autopilot.armed


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_forced_disarm_in_the_air_falls(autopilot: str) -> None:
    station = ready(autopilot)
    station.fly_to(5.0)
    assert station.command(ARM, 0, 21196) == [0]
    station.run(2.0)
    assert station.height_m() == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("action", "mode"),
    [(0, "POSCTL"), (1, "ALTCTL"), (2, "STABILIZED"), (3, "RTL"), (4, "LAND"), (5, "LOITER"), (99, "POSCTL")],
)
def test_px4_stream_loss(action: int, mode: str) -> None:
    station = ready("px4")
    station.parameter("COM_OBL_RC_ACT", _bytewise(action), 6)
    station.fly_to(5.0)
    station.run(0.9)
    assert station.autopilot.mode.name == "OFFBOARD"
    station.run(0.3)
    assert station.autopilot.mode.name == mode
    assert station.autopilot.status is SystemStatus.CRITICAL
    assert "Failsafe activated\t" in station.texts()
    station.setpoint(PLACE, mask=USE_POSITION)
    station.run(0.04)
    assert station.autopilot.mode.name == "OFFBOARD"  # back without any command


def test_px4_stream_loss_time_is_a_parameter_and_7_disarms() -> None:
    station = ready("px4")
    station.parameter("COM_OF_LOSS_T", 0.5)
    station.parameter("COM_OBL_RC_ACT", _bytewise(7), 6)
    station.fly_to(5.0)
    station.run(0.4)
    assert station.autopilot.armed
    station.run(0.3)
    assert not station.autopilot.armed


def test_px4_position_failsafe_sinks_without_a_pilot() -> None:
    station = ready("px4")
    station.fly_to(5.0)
    station.run(3.0)
    height_m = station.height_m()
    station.run(2.0)
    assert (height_m - station.height_m()) / 2.0 == pytest.approx(0.7, abs=0.05)
    station.run(10.0)
    assert not station.autopilot.armed
    assert station.autopilot.mode.name == "OFFBOARD"  # measured: the intended mode again


def test_px4_sits_armed_under_a_position_setpoint_and_lands_by_velocity() -> None:
    station = ready("px4")
    station.fly_to(5.0)
    station.run(30.0, lambda _: station.setpoint((0.0, 0.0, 5.0), mask=USE_POSITION))
    assert station.autopilot.armed
    station.run(6.0, lambda _: station.setpoint(velocity=(0.0, 0.0, 0.7), mask=USE_VELOCITY))
    assert not station.autopilot.armed
    assert station.autopilot.mode.name == "OFFBOARD"


@pytest.mark.parametrize(("action", "mode"), [(1, AP_RTL), (2, AP_RTL), (3, 21), (5, AP_LAND), (7, BRAKE)])
def test_ardupilot_gcs_loss(action: int, mode: int) -> None:
    station = ready("ardupilot")
    station.parameter("FS_GCS_ENABLE", action)
    station.fly_to(5.0)
    station.heartbeats = False
    station.run(6.5)
    assert station.autopilot.mode.number == mode
    assert "GCS Failsafe" in station.texts()
    station.heartbeats = True
    station.run(2.0)
    assert "GCS Failsafe Cleared" in station.texts()
    assert station.autopilot.mode.number == mode  # the mode stays
    station.mode(GUIDED)
    assert station.autopilot.mode.number == GUIDED


def test_ardupilot_hears_only_its_own_gcs() -> None:
    station = ready("ardupilot")
    station.parameter("FS_GCS_ENABLE", 5)
    station.fly_to(5.0)
    station.heartbeats = False
    station.run(6.5, lambda _: station.heartbeat(system=254), rate_hz=1.0)
    assert station.autopilot.mode.number == AP_LAND


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_lost_gcs_is_nothing_by_default(autopilot: str) -> None:
    station = ready(autopilot)
    station.fly_to(5.0)
    station.heartbeats = False
    stream(station, 15.0)
    assert station.autopilot.mode.name == station.autopilot.profile.stream_mode


@pytest.mark.parametrize(("autopilot", "mode", "height_m"), [("px4", PX4_RTL, 30.0), ("ardupilot", AP_RTL, 15.0)])
def test_return_climbs_comes_home_and_lands(autopilot: str, mode: int, height_m: float) -> None:
    station = ready(autopilot)
    station.fly_to(5.0)
    station.run(8.0, lambda _: station.setpoint((20.0, 0.0, -5.0), mask=USE_POSITION))
    station.mode(mode)
    heights: list[float] = []
    station.run(90.0, lambda _: heights.append(station.height_m()), rate_hz=5.0)
    assert max(heights) == pytest.approx(height_m, abs=0.5)
    assert not station.autopilot.armed
    assert station.position_m() == pytest.approx((0.0, 0.0, 0.0), abs=0.5)


def test_boot_takes_as_long_as_the_real_one_if_wanted() -> None:
    for autopilot, early_s, late_s in (("px4", 3.8, 4.0), ("ardupilot", 41.0, 42.0)):
        station = Station(autopilot, real_boot=True)
        station.run(early_s)
        if not station.px4:
            station.mode(GUIDED)
        assert station.command(ARM, 1) != [0]
        station.run(late_s - early_s)
        assert station.command(ARM, 1) == [0]
