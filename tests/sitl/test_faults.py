"""Every fault does what it says, by the truth and on the wire, in both profiles; bad tables are refused."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from sitl_mock import parse_fault, parse_impairment
from sitl_mock.faults.schema import COMMANDS, IMPAIRMENT, KINDS, RESULTS, WINDOW
from sitl_mock.faults.vehicle_faults import EFFECTS
from sitl_mock.messages import SystemStatus
from tests.sitl.driver import AP_LAND, AP_RTL, ARM, GUIDED, OFFBOARD, PX4_LAND, PX4_RTL, Station

AUTOPILOTS = ("px4", "ardupilot")
BOTH = pytest.mark.parametrize("autopilot", AUTOPILOTS)
HEIGHT_M = 8.0
AT_S = 20.0  # 2 s until ready, 14 s to get up
LAND_MODE, RETURN_MODE = {"px4": PX4_LAND, "ardupilot": AP_LAND}, {"px4": PX4_RTL, "ardupilot": AP_RTL}
STREAM_MODE = {"px4": OFFBOARD, "ardupilot": GUIDED}


def flown(autopilot: str, *faults: Mapping[str, Any], vehicles: int = 1) -> Station:
    """Vehicles 1 ... in the air, streamed to; faults begin at AT_S unless they say otherwise."""
    tables = [{"at_s": AT_S, **fault} for fault in faults]
    station = Station(autopilot, vehicles, faults=tuple(map(parse_fault, tables)))
    station.run(2.0)
    for k in range(vehicles):
        station.command(511, 32, 1e5, vehicle=k)
        station.command(511, 245, 2e5, vehicle=k)
    for number in (1, 24, 49):
        station.command(511, number, 2e5)
    station.fly_to(HEIGHT_M)
    stream(station, AT_S - station.now_s - 0.2)
    return station


def stream(station: Station, seconds: float) -> None:
    """Hold the first vehicle by position setpoints."""
    station.run(seconds, lambda _: station.setpoint((0.0, 0.0, -HEIGHT_M), mask=0x9F8))


def climb(station: Station, seconds: float) -> None:
    station.run(seconds, lambda _: station.setpoint((0.0, 0.0, -HEIGHT_M - 30.0), mask=0x9F8))


def status(station: Station) -> SystemStatus:
    return station.autopilot.status


def local_m(station: Station, vehicle: int = 0, since_s: float = 0.0) -> np.ndarray[Any, Any]:
    """(T, 3) what LOCAL_POSITION_NED said, against the origin at the beginning; world NED."""
    said = station.messages("LOCAL_POSITION_NED", vehicle, since_s)
    return np.array([(m.x, m.y, m.z) for m in said]) + station.first_origin_m(vehicle)


def place_m(station: Station, vehicle: int = 0) -> np.ndarray[Any, Any]:
    return np.array(station.position_m(vehicle))


def fell(station: Station) -> bool:
    return station.height_m() < 0.5


@BOTH
def test_noise(autopilot: str) -> None:
    station = flown(autopilot, {"kind": "position_noise", "sigma_m": 0.5})
    before_m = local_m(station, since_s=AT_S - 1.0)
    stream(station, 6.0)
    during_m = local_m(station, since_s=AT_S + 0.5)
    assert before_m.std(axis=0).max() < 0.05
    assert during_m.std(axis=0) == pytest.approx(0.5, rel=0.5)


@BOTH
def test_a_jump_takes_the_vehicle_with_it_and_back(autopilot: str) -> None:
    """The estimate jumps east; the vehicle flies west until the estimate is where it was told to be."""
    station = flown(autopilot, {"kind": "position_jump", "offset_enu_m": [3.0, 0.0, 0.0], "for_s": 12.0})
    stream(station, 0.5)
    assert local_m(station)[-1][1] - place_m(station)[1] == pytest.approx(3.0, abs=0.3)
    stream(station, 10.0)
    assert place_m(station)[1] == pytest.approx(-3.0, abs=0.4)
    assert local_m(station)[-1][1] == pytest.approx(0.0, abs=0.4)
    stream(station, 12.0)
    assert place_m(station) == pytest.approx((0.0, 0.0, -HEIGHT_M), abs=0.4)


@BOTH
def test_a_bias_comes_slowly(autopilot: str) -> None:
    fault = {"kind": "position_bias", "offset_enu_m": [0.0, 2.0, 0.0], "over_s": 8.0}
    station = flown(autopilot, fault)
    stream(station, 4.2)
    assert place_m(station)[0] == pytest.approx(-1.0, abs=0.5)
    stream(station, 12.0)
    assert place_m(station)[0] == pytest.approx(-2.0, abs=0.3)


@BOTH
def test_a_drift_never_stops(autopilot: str) -> None:
    station = flown(autopilot, {"kind": "position_drift", "rate_enu_m_s": [0.0, 0.0, 0.2]})
    stream(station, 10.2)
    # The estimate says that it rises, so it sinks
    assert station.height_m() == pytest.approx(HEIGHT_M - 2.0, abs=0.4)


@BOTH
def test_without_gps_the_estimate_drifts_and_the_failsafe_lands_the_vehicle(autopilot: str) -> None:
    station = flown(autopilot, {"kind": "gps_loss"})
    stream(station, 4.0)
    assert station.messages("GPS_RAW_INT")[-1].fix_type <= 1
    assert station.autopilot.mode.number == STREAM_MODE[autopilot]
    stream(station, 6.0)
    assert station.autopilot.mode.number == LAND_MODE[autopilot]
    assert status(station) is SystemStatus.CRITICAL
    drifted_m = np.linalg.norm((local_m(station)[-1] - place_m(station))[:2])
    assert drifted_m > 0.3
    stream(station, 40.0)
    assert not station.autopilot.armed
    if autopilot == "ardupilot":  # measured: positions are not sent any more
        assert not station.messages("LOCAL_POSITION_NED", since_s=AT_S + 16.0)
        assert station.command(ARM, 1) == [4]


@BOTH
def test_gps_that_comes_back_in_time_changes_no_mode(autopilot: str) -> None:
    station = flown(autopilot, {"kind": "gps_loss", "for_s": 3.0})
    stream(station, 20.0)
    assert station.autopilot.mode.number == STREAM_MODE[autopilot]
    assert place_m(station) == pytest.approx((0.0, 0.0, -HEIGHT_M), abs=0.5)


@BOTH
def test_a_stuck_estimator_says_the_same_again_and_again(autopilot: str) -> None:
    station = flown(autopilot, {"kind": "estimator_stuck", "at_s": AT_S + 1.0})
    far = (20.0, 0.0, -HEIGHT_M)
    station.run(3.0, lambda _: station.setpoint(far, mask=0x9F8))
    said = station.messages("LOCAL_POSITION_NED", since_s=AT_S + 1.2)
    assert len({(m.x, m.y, m.z) for m in said}) == 1
    stamps = [m.time_boot_ms for m in said]
    assert stamps == sorted(set(stamps))
    assert place_m(station)[0] > local_m(station)[-1][0] + 0.5  # it is on its way meanwhile


@BOTH
def test_an_origin_that_moves_takes_the_frame_with_it(autopilot: str) -> None:
    station = flown(autopilot, {"kind": "origin", "offset_enu_m": [4.0, 0.0, 0.0]})
    told = len(station.messages("GPS_GLOBAL_ORIGIN"))
    stream(station, 0.5)
    assert len(station.messages("GPS_GLOBAL_ORIGIN")) > told
    here_m = station.autopilot.local_origin_ned_m
    assert here_m[1] - station.first_origin_m(0)[1] == pytest.approx(4.0)
    # A setpoint of the old frame is somewhere else now: the vehicle follows it
    first_m = station.first_origin_m(0)
    mask, down = 0x9F8, -HEIGHT_M
    message = dialect.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, mask, *(-first_m[0], -first_m[1], down - first_m[2]), *(0.0,) * 8
    )
    station.run(10.0, lambda _: station.send(message))
    assert place_m(station)[1] == pytest.approx(4.0, abs=0.4)


@BOTH
def test_an_origin_that_creeps_untold_is_found_in_no_message(autopilot: str) -> None:
    station = flown(autopilot, {"kind": "origin", "rate_enu_m_s": [0.0, 0.5, 0.0], "told": False})
    station.command(512, 49)
    before = station.messages("GPS_GLOBAL_ORIGIN")[-1]
    stream(station, 6.2)
    station.command(512, 49)
    after = station.messages("GPS_GLOBAL_ORIGIN")[-1]
    assert (after.latitude, after.longitude) == (before.latitude, before.longitude)
    assert station.autopilot.local_origin_ned_m[0] - station.first_origin_m(0)[0] == pytest.approx(3.0, abs=0.1)


@BOTH
def test_a_wrong_origin_is_told(autopilot: str) -> None:
    fault = {"kind": "origin_wrong", "offset_enu_m": [0.0, 100.0, 0.0], "at_s": 1.5}
    station = Station(autopilot, faults=(parse_fault(fault),))
    station.run(2.0)
    station.command(512, 49)
    told = station.messages("GPS_GLOBAL_ORIGIN")[-1]
    truth = station.autopilot.world.geodetic(*station.autopilot.local_origin_ned_m)
    assert (told.latitude * 1e-7 - truth.latitude_deg) * 111_200.0 == pytest.approx(100.0, rel=0.01)


@BOTH
def test_wind_blows_one_vehicle(autopilot: str) -> None:
    fault = {"kind": "wind", "speed_m_s": 8.0, "from_deg": 270.0, "for_s": 15.0}
    station = flown(autopilot, fault)
    stream(station, 1.2)
    off_m = place_m(station)[1]
    assert 0.02 < off_m < 2.0  # to the east, until the loops have learnt it
    stream(station, 12.0)
    assert abs(place_m(station)[1]) < 0.3


@BOTH
def test_a_weak_motor_climbs_slowly(autopilot: str) -> None:
    ways = []
    for faults in ((), ({"kind": "motor_weak", "thrust": 0.6},)):
        station = flown(autopilot, *faults)
        climb(station, 2.2)
        ways.append(station.height_m() - HEIGHT_M)
    healthy_m, weak_m = ways
    assert weak_m < 0.8 * healthy_m


@BOTH
def test_a_dead_motor_falls(autopilot: str) -> None:
    station = flown(autopilot, {"kind": "motor_dead"})
    stream(station, 3.0)
    assert fell(station)


def test_ardupilot_falls_as_measured() -> None:
    """From 10 m in 1.7 s."""
    station = flown("ardupilot", {"kind": "motor_dead"})
    stream(station, 0.3)
    start_s, seconds = station.now_s - 0.1, 0.0
    while not station.fleet.swarm.in_contact[0]:
        station.run(0.02)
        seconds = station.now_s - start_s
    assert seconds == pytest.approx(1.7 * math.sqrt(HEIGHT_M / 10.0), rel=0.2)


def test_px4_battery_levels() -> None:
    """Low is told, critical returns, emergency lands: COM_LOW_BAT_ACT 3."""
    station = flown(
        "px4",
        {"kind": "battery_low", "remaining": 0.12},
        {"kind": "battery_low", "remaining": 0.06, "at_s": AT_S + 3.0},
        {"kind": "battery_low", "remaining": 0.04, "at_s": AT_S + 6.0},
    )
    station.parameter("COM_LOW_BAT_ACT", float(np.array([3], np.int32).view(np.float32)[0]), kind=6)
    stream(station, 2.0)
    assert station.messages("SYS_STATUS")[-1].battery_remaining in (10, 11, 12)
    assert any("Low battery" in text for text in station.texts(since_s=AT_S))
    assert station.autopilot.mode.number == OFFBOARD
    stream(station, 1.8)
    assert station.autopilot.mode.number == PX4_RTL
    stream(station, 3.0)
    assert station.autopilot.mode.number == PX4_LAND
    assert status(station) is SystemStatus.CRITICAL


def test_px4_only_warns_by_default() -> None:
    station = flown("px4", {"kind": "battery_low", "remaining": 0.04})
    stream(station, 3.0)
    assert station.autopilot.mode.number == OFFBOARD
    assert any("battery" in text for text in station.texts(since_s=AT_S))


@pytest.mark.parametrize(("action", "mode"), [(0, GUIDED), (1, AP_LAND), (2, AP_RTL)])
def test_ardupilot_battery_failsafe(action: int, mode: int) -> None:
    """10 s below BATT_LOW_VOLT: told and critical in any case, and the mode by BATT_FS_LOW_ACT."""
    station = flown("ardupilot", {"kind": "battery_low", "remaining": 0.1})
    station.parameter("BATT_FS_LOW_ACT", action, kind=2)
    stream(station, 9.0)
    assert status(station) is SystemStatus.ACTIVE
    stream(station, 3.0)
    assert "Battery Failsafe" in station.texts(since_s=AT_S)
    assert status(station) is SystemStatus.CRITICAL
    assert station.autopilot.mode.number == mode


@BOTH
def test_an_empty_battery_stops_the_motors(autopilot: str) -> None:
    station = flown(autopilot, {"kind": "battery_empty", "lasts_s": 5.0})
    stream(station, 4.0)
    assert station.messages("SYS_STATUS")[-1].battery_remaining == 0
    assert not fell(station)
    stream(station, 5.0)
    assert fell(station)


@BOTH
def test_a_frozen_heartbeat_goes_on_saying_the_same(autopilot: str) -> None:
    station = flown(autopilot, {"kind": "heartbeat_frozen"})
    stream(station, 1.0)
    station.command(20)
    stream(station, 4.0)
    said = station.messages("HEARTBEAT", since_s=AT_S + 2.0)
    assert len(said) >= 3
    assert {m.custom_mode for m in said} == {STREAM_MODE[autopilot]}
    assert station.autopilot.mode.number == RETURN_MODE[autopilot]


@BOTH
@pytest.mark.parametrize("result", RESULTS)
def test_commands_are_refused_with_each_result(autopilot: str, result: str) -> None:
    fault = {"kind": "commands_refused", "command": "arm", "result": result, "text": "not today", "at_s": 2.0}
    station = Station(autopilot, faults=(parse_fault({**fault, "for_s": 5.0}),))
    station.run(2.5)
    assert station.command(ARM, 1) == [int(RESULTS[result])]
    assert any("not today" in text for text in station.texts())
    assert not station.autopilot.armed
    assert station.command(512, 49)[-1:] == [0]  # other commands are done
    station.mode(STREAM_MODE[autopilot])
    station.setpoint()
    station.run(5.0, lambda _: station.setpoint())
    assert station.command(ARM, 1) == [0]


@BOTH
def test_every_command_is_refused_without_a_number(autopilot: str) -> None:
    station = Station(autopilot, faults=(parse_fault({"kind": "commands_refused", "result": "failed"}),))
    station.run(2.0)
    assert [station.command(number) for number in (511, 512, 22, 400)] == [[4]] * 4


@BOTH
def test_a_reboot_in_flight_falls_and_boots_anew(autopilot: str) -> None:
    station = flown(autopilot, {"kind": "reboot"})
    stream(station, 3.0)
    assert fell(station)
    assert not station.autopilot.armed
    newest = station.messages("HEARTBEAT")[-1]
    assert not newest.base_mode & 128
    station.command(511, 32, 1e5)
    station.run(3.0)
    assert station.messages("LOCAL_POSITION_NED")[-1].time_boot_ms < 8000


@BOTH
def test_clocks_jump_and_run_off(autopilot: str) -> None:
    station = flown(
        autopilot,
        {"kind": "clock_jump", "by_s": 30.0},
        {"kind": "clock_drift", "rate": 0.1, "at_s": AT_S + 2.0, "for_s": 5.0},
    )

    def ahead_s() -> float:
        return float(station.messages("LOCAL_POSITION_NED")[-1].time_boot_ms) * 1e-3 - station.now_s

    assert ahead_s() == pytest.approx(0.0, abs=0.11)
    stream(station, 1.0)
    assert ahead_s() == pytest.approx(30.0, abs=0.11)
    stream(station, 3.2)
    assert 30.05 < ahead_s() < 30.4
    stream(station, 10.0)
    assert ahead_s() == pytest.approx(30.5, abs=0.11)
    answer = station.send(dialect.MAVLink_timesync_message(0, 5))[-1]
    assert answer.tc1 * 1e-9 - station.now_s == pytest.approx(30.5, abs=0.11)


@BOTH
def test_the_dead_say_nothing(autopilot: str) -> None:
    station = flown(autopilot, {"kind": "dead"})
    stream(station, 4.0)
    assert not [one for one in station.heard if one[0] > AT_S + 0.1]
    assert station.command(ARM, 1) == []
    assert fell(station)


@BOTH
def test_another_client_takes_over(autopilot: str) -> None:
    for name, mode in station_modes(autopilot).items():
        station = flown(autopilot, {"kind": "taken_over", "mode": name})
        station.run(0.5)
        assert station.autopilot.mode.number == mode, name


def station_modes(autopilot: str) -> dict[str, int]:
    """All modes that fly by themselves; those after a landing, and for pilots, as well."""
    vehicle = Station(autopilot).autopilot
    return {mode.name: mode.number for mode in vehicle.modes.values() if mode.name not in ("TAKEOFF", "OFFBOARD")}


@BOTH
def test_a_fault_is_in_its_vehicles_only_and_ends(autopilot: str) -> None:
    fault = {"kind": "position_jump", "offset_enu_m": [5.0, 0.0, 0.0], "vehicles": [2], "for_s": 2.0}
    station = flown(autopilot, fault, vehicles=3)
    stream(station, 1.2)
    off_m = station.fleet.swarm.estimated_position_m - station.fleet.swarm.position_m
    assert np.abs(off_m[[0, 2]]).max() < 0.01
    assert off_m[1] == pytest.approx((0.0, 5.0, 0.0), abs=0.01)
    stream(station, 2.0)
    assert np.abs(station.fleet.swarm.estimated_position_m - station.fleet.swarm.position_m).max() < 0.01


@BOTH
def test_faults_of_one_kind_that_overlap_last_as_long_as_the_longest(autopilot: str) -> None:
    """A short one inside a long one changes nothing."""
    short: dict[str, Any] = {"at_s": AT_S + 1.0, "for_s": 1.0}
    station = flown(
        autopilot,
        {"kind": "gps_loss", "for_s": 30.0},
        {"kind": "gps_loss", **short},
        {"kind": "heartbeat_frozen"},
        {"kind": "heartbeat_frozen", **short},
    )
    stream(station, 12.0)
    assert station.autopilot.mode.number == LAND_MODE[autopilot]
    said = station.messages("HEARTBEAT", since_s=AT_S + 4.0)
    assert {m.custom_mode for m in said} == {STREAM_MODE[autopilot]}
    stream(station, 20.0)
    assert station.autopilot.gps_lost_at_s is None


@BOTH
def test_a_weak_motor_under_measured_dynamics_sags_until_it_is_learnt(autopilot: str) -> None:
    heights = []
    for faults in ((), ({"kind": "motor_weak", "thrust": 0.8},)):
        tables = tuple(parse_fault({"at_s": AT_S, **fault}) for fault in faults)
        station = Station(autopilot, dynamics="measured", faults=tables)
        station.run(2.0)
        station.fly_to(HEIGHT_M)
        stream(station, AT_S - station.now_s)
        lowest_m = station.height_m()
        for _ in range(20):
            stream(station, 0.1)
            lowest_m = min(lowest_m, station.height_m())
        heights.append(lowest_m)
    healthy_m, weak_m = heights
    assert weak_m < healthy_m - 0.1
    stream(station, 15.0)
    assert station.height_m() == pytest.approx(HEIGHT_M, abs=1.0)


def test_a_fault_waits_for_a_stage_of_the_flight() -> None:
    fault = {"kind": "dead", "stage": "hold", "at_s": 1.5}
    station = flown("px4", fault)
    stream(station, 3.0)
    assert not station.autopilot.dead
    station.fleet.stages.begin("hold", station.now_s)
    stream(station, 1.4)
    assert not station.autopilot.dead
    stream(station, 0.2)
    assert station.autopilot.dead
    with pytest.raises(ValueError, match="accepted: connect"):
        station.fleet.stages.begin("lunch", station.now_s)


@pytest.mark.parametrize("stage", ["armed", "airborne", "landed"])
def test_a_fault_waits_for_a_stage_of_its_vehicle(stage: str) -> None:
    station = Station("ardupilot", faults=(parse_fault({"kind": "heartbeat_frozen", "stage": stage, "at_s": 0.0}),))
    vehicle = station.autopilot
    station.run(2.0)
    assert not vehicle.heartbeat_frozen
    station.mode(GUIDED)
    station.command(ARM, 1)
    station.run(0.1)
    assert vehicle.heartbeat_frozen is (stage == "armed")
    station.command(22, 0, 0, 0, 0, 0, 0, 3.0)
    station.run(8.0)
    assert vehicle.heartbeat_frozen is (stage in ("armed", "airborne"))
    station.mode(AP_LAND)
    station.run(14.0)
    assert vehicle.heartbeat_frozen


def test_the_same_seed_gives_the_same_bytes() -> None:
    faults = (
        {"kind": "position_noise", "sigma_m": 0.3, "at_s": 3.0},
        {"kind": "wind", "speed_m_s": 4.0, "gusts_m_s": 1.0, "at_s": 5.0},
        {"kind": "gps_loss", "at_s": 18.0, "for_s": 3.0},
        {"kind": "reboot", "at_s": 25.0},
    )
    runs = []
    for _ in range(2):
        station = flown("px4", *faults)
        stream(station, 8.0)
        runs.append(station.raw)
    assert runs[0] == runs[1]


# -- tables -----------------------------------------------------------------------------------------------------------


def test_every_kind_has_an_effect() -> None:
    assert set(EFFECTS) == set(KINDS)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({}, "kind = None"),
        ({"kind": "gps_los"}, "did you mean 'gps_loss'"),
        ({"kind": ["dead"]}, "kind = ['dead']"),
        ({"kind": {}}, "kind = {}"),
        ({"kind": "dead", "for_s": 3.0}, "happens once"),
        ({1: 2}, "not a table"),
        (None, "not a table"),
        (5, "not a table"),
        ({"kind": "gps_loss", "for": 3}, "has no key 'for' (did you mean 'for_s'?)"),
        ({"kind": "gps_loss", "vehicles": []}, "a list of system ids"),
        ({"kind": "gps_loss", "vehicles": [0]}, "a whole number from 1 to 255"),
        ({"kind": "gps_loss", "vehicles": [True]}, "a whole number"),
        ({"kind": "gps_loss", "stage": "lunch"}, "one of 'connect'"),
        ({"kind": "gps_loss", "at_s": -1.0}, "a number from 0"),
        ({"kind": "gps_loss", "at_s": math.nan}, "a number from 0"),
        ({"kind": "gps_loss", "at_s": "soon"}, "a number from 0"),
        ({"kind": "position_noise"}, "needs sigma_m"),
        ({"kind": "position_noise", "sigma_m": math.inf}, "a number from 0"),
        ({"kind": "position_jump", "offset_enu_m": [1, 2]}, "three numbers"),
        ({"kind": "position_jump", "offset_enu_m": [1, 2, "x"]}, "a number"),
        ({"kind": "origin"}, "needs offset_enu_m or rate_enu_m_s"),
        ({"kind": "battery_low", "remaining": 0.0}, "from 0.01 to 1"),
        ({"kind": "commands_refused", "command": "jump"}, "a MAV_CMD number"),
        ({"kind": "commands_refused", "result": "maybe"}, "one of 'accepted'"),
        ({"kind": "commands_refused", "text": "a\nb"}, "printable"),
        ({"kind": "clock_drift", "rate": 2.0}, "a number from -0.5"),
        ({"kind": "origin", "offset_enu_m": [1, 0, 0], "told": 1}, "true or false"),
    ],
)
def test_bad_fault_tables_are_one_line(table: Any, says: str) -> None:  # noqa: ANN401 - anything
    with pytest.raises(ValueError, match=r".+") as raised:
        parse_fault(table)
    assert says in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({}, "needs one of loss"),
        ({"loss": 1.5}, "a number from 0 to 1"),
        ({"loss": 0.1, "direction": "up"}, "one of 'from_vehicle'"),
        ({"loss": 0.1, "messages": ["heartbeat"]}, "a list of MAVLink messages"),
        ({"loss": 0.1, "messages": ["HEARTBEET"]}, "no message 'HEARTBEET'"),
        ({"delay": 1.0}, "did you mean 'delay_s'"),
    ],
)
def test_bad_impairments_are_one_line(table: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=r".+") as raised:
        parse_impairment(table)
    assert says in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("text", ["", "[1]", "{", '"x"', "[" * 10_000])
def test_bad_json_is_one_line(text: str) -> None:
    for parse in (parse_fault, parse_impairment):
        with pytest.raises(ValueError, match="JSON") as raised:
            parse(text)
        assert "\n" not in str(raised.value)


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=2),
    max_leaves=4,
)
KEYS = sorted({*WINDOW, *IMPAIRMENT, *(key for kind in KINDS.values() for key in kind.keys), "kind"})


@given(st.dictionaries(st.sampled_from(KEYS), anything | st.sampled_from(sorted(KINDS)), max_size=4))
def test_any_table_is_read_or_refused(table: dict[str, Any]) -> None:
    for parse in (parse_fault, parse_impairment):
        try:
            parse(table)
        except ValueError as error:
            assert "\n" not in str(error)  # noqa: PT017 - either is right


def test_unknown_vehicles_and_modes_are_refused() -> None:
    with pytest.raises(ValueError, match="there is no vehicle 9; the system ids are 1 to 2"):
        Station("px4", 2, faults=(parse_fault({"kind": "dead", "vehicles": [9]}),))
    with pytest.raises(ValueError, match="accepted: MANUAL"):
        Station("px4", 2, faults=(parse_fault({"kind": "taken_over", "mode": "GUIDED"}),))


def test_commands_have_their_numbers() -> None:
    names = {"arm": "COMPONENT_ARM_DISARM", "take_off": "NAV_TAKEOFF", "land": "NAV_LAND", "set_mode": "DO_SET_MODE"}
    for name, command in names.items():
        assert COMMANDS[name] == getattr(dialect, f"MAV_CMD_{command}")
