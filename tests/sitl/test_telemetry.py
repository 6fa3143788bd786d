"""What the vehicles tell: frames that agree with each other and with the truth, streams, texts, small dialogues."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import all as dialect

from sitl_mock.physics.geodesy import Geodetic
from sitl_mock.profiles.px4 import PROFILE as PX4
from tests.sitl.driver import ARM, GUIDED, USE_POSITION, Station, ready

QUANTUM_M = 0.02  # 1e-7 degrees are 1.1 cm


def newest(station: Station, kind: str, vehicle: int = 0) -> dict[str, float]:
    message = station.messages(kind, vehicle)[-1]
    return {name: getattr(message, name) for name in message.fieldnames}


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_all_positions_say_the_same(autopilot: str) -> None:
    """Origin + LOCAL_POSITION_NED, GLOBAL_POSITION_INT and the truth are one place."""
    station = ready(autopilot, vehicles=2, seed=4)
    for number in (32, 33):
        station.command(511, number, 1e5, vehicle=1)
    station.command(512, 49, vehicle=1)
    station.fly_to(5.0, vehicle=1)
    world = station.vehicle(1).world
    local = newest(station, "LOCAL_POSITION_NED", 1)
    place = newest(station, "GLOBAL_POSITION_INT", 1)
    origin = newest(station, "GPS_GLOBAL_ORIGIN", 1)

    def ned_m(latitude: float, longitude: float, altitude: float) -> tuple[float, float, float]:
        return world.ned_m(Geodetic(latitude * 1e-7, longitude * 1e-7, altitude * 1e-3))

    start_m = ned_m(origin["latitude"], origin["longitude"], origin["altitude"])
    from_local_m = [s + local[axis] for s, axis in zip(start_m, "xyz", strict=True)]
    assert from_local_m == pytest.approx(station.position_m(1), abs=QUANTUM_M)
    assert ned_m(place["lat"], place["lon"], place["alt"]) == pytest.approx(station.position_m(1), abs=QUANTUM_M)
    assert place["relative_alt"] * 1e-3 == pytest.approx(station.height_m(1), abs=QUANTUM_M)


def test_every_vehicle_has_its_own_local_frame() -> None:
    ardupilot = ready("ardupilot", vehicles=3)
    for k in range(3):
        ardupilot.command(511, 32, 1e5, vehicle=k)
    ardupilot.run(0.5)
    px4 = ready("px4", vehicles=9)
    heights = []
    for k in range(3):
        assert [newest(ardupilot, "LOCAL_POSITION_NED", k)[axis] for axis in "xyz"] == [0.0, 0.0, 0.0]
    for k in range(9):
        local = newest(px4, "LOCAL_POSITION_NED", k)
        assert math.hypot(local["x"], local["y"]) < 0.5  # measured: origin off by up to 0.4 m
        heights.append(local["z"])
    assert max(abs(z) for z in heights) < 0.8
    assert max(heights) - min(heights) > 0.2  # measured: -0.7 ... +0.6 on the ground


def test_common_origin() -> None:
    """SET_GPS_GLOBAL_ORIGIN moves PX4's frame on the ground; ArduPilot that has an origin ignores it."""
    for autopilot, moved in (("px4", True), ("ardupilot", False)):
        station = ready(autopilot, vehicles=2)
        point = station.vehicle(1).world.origin
        message = dialect.MAVLink_set_gps_global_origin_message(
            2, round(point.latitude_deg * 1e7), round(point.longitude_deg * 1e7), round(point.altitude_m * 1e3)
        )
        answers = station.send(message, 1)
        assert [m.get_type() for m in answers] == (["GPS_GLOBAL_ORIGIN"] if moved else [])
        station.command(511, 32, 1e5, vehicle=1)
        station.run(0.5)
        assert (newest(station, "LOCAL_POSITION_NED", 1)["y"] == pytest.approx(3.0, abs=QUANTUM_M)) is moved


def test_ardupilot_takes_an_origin_before_it_has_one() -> None:
    station = Station("ardupilot")
    station.run(0.6)
    point = station.autopilot.world.geodetic(-10.0, 0.0, 0.0)
    message = dialect.MAVLink_set_gps_global_origin_message(
        1, round(point.latitude_deg * 1e7), round(point.longitude_deg * 1e7), round(point.altitude_m * 1e3)
    )
    assert [m.get_type() for m in station.send(message)] == ["GPS_GLOBAL_ORIGIN", "HOME_POSITION"]
    assert station.autopilot.local_origin_ned_m == pytest.approx((-10.0, 0.0, 0.0), abs=QUANTUM_M)


def test_moving_px4_s_origin_in_flight_moves_the_vehicle() -> None:
    station = ready("px4")
    station.fly_to(5.0)
    origin = station.autopilot.local_origin_ned_m
    station.autopilot.set_origin((origin[0] + 5.0, origin[1], origin[2]))
    message = dialect.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, USE_POSITION, -origin[0], -origin[1], -5.0 - origin[2], 0, 0, 0, 0, 0, 0, 0, 0
    )
    station.run(8.0, lambda _: station.send(message))
    assert station.position_m()[0] == pytest.approx(5.0, abs=0.2)


def test_default_streams() -> None:
    """PX4 talks unasked; ArduPilot says nothing but its heartbeat, origin and home."""
    px4, ardupilot = ready("px4"), ready("ardupilot")
    px4.run(4.0)
    ardupilot.run(4.0)
    assert {m.get_type() for *_, m in ardupilot.heard} == {"HEARTBEAT", "GPS_GLOBAL_ORIGIN", "HOME_POSITION"}
    assert {m.get_type() for *_, m in px4.heard} >= set(PX4.default_streams)


def test_texts_wait_for_a_ground_station() -> None:
    """PX4 wants a GCS heartbeat on that link, ArduPilot any frame; long texts come in chunks of 50."""
    for autopilot in ("px4", "ardupilot"):
        station = Station(autopilot, links=2)
        station.heartbeats = False
        station.run(0.5)
        station.command(ARM, 1)
        opened = [bool(station.messages("STATUSTEXT", link=k)) for k in (0, 1)]
        assert opened == [autopilot == "ardupilot", False]
        station.heartbeat()
        station.command(ARM, 1)
        assert station.messages("STATUSTEXT")
        assert not station.messages("STATUSTEXT", link=1)
        if autopilot == "px4":
            first, second = station.messages("STATUSTEXT")[-2:]
            assert (first.text, second.text) == ("Arming denied: Resolve system health failures firs", "t\t")
            assert (first.id, first.chunk_seq, second.chunk_seq) == (second.id, 0, 1)
            assert first.id != 0


def test_prearm_bit_is_about_the_present_mode() -> None:
    station = Station("ardupilot", real_boot=True)
    station.run(5.0)
    station.command(511, 1, 1e5)

    def able() -> bool:
        station.run(0.2)
        return bool(station.messages("SYS_STATUS")[-1].onboard_control_sensors_health & 0x10000000)

    assert able()  # STABILIZE needs no position
    station.mode(GUIDED)
    assert not able()
    station.run(37.0)
    assert able()


def test_timesync_and_ping() -> None:
    station = ready("px4")
    (answer,) = station.send(dialect.MAVLink_timesync_message(0, 12345))
    assert (answer.tc1, answer.ts1) == (round(station.now_s * 1e9), 12345)
    assert station.send(dialect.MAVLink_timesync_message(1, 12345)) == []
    (answer,) = station.send(dialect.MAVLink_ping_message(99, 3, 0, 0))
    assert (answer.get_type(), answer.seq, answer.target_system) == ("PING", 3, 255)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_missions_are_empty(autopilot: str) -> None:
    station = ready(autopilot)
    (count,) = station.send(dialect.MAVLink_mission_request_list_message(1, 1))
    assert (count.get_type(), count.count) == ("MISSION_COUNT", 0)
    (ack,) = station.send(dialect.MAVLink_mission_clear_all_message(1, 1))
    assert (ack.get_type(), ack.type) == ("MISSION_ACK", 0)
    for number, kind in ((0, 0), (5, 4)):
        (ack,) = station.send(dialect.MAVLink_mission_count_message(1, 1, number))
        assert ack.type == kind


def test_px4_reports_its_target() -> None:
    station = ready("px4")
    on_ground = station.messages("POSITION_TARGET_LOCAL_NED")[-1]
    assert on_ground.type_mask == 63
    assert math.isnan(on_ground.x)
    assert on_ground.afz == 100.0
    station.fly_to(5.0)
    target = station.messages("POSITION_TARGET_LOCAL_NED")[-1]
    assert target.type_mask == 0
    assert target.z == pytest.approx(-5.0 - station.autopilot.local_origin_ned_m[2], abs=1e-5)
