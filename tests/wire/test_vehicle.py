import math
import random

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.autopilots import ARDUPILOT, PX4, AutopilotProfile
from fg_gcs.wire.codec import Codec, Message, is_known
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.vehicle import ARMING, LOST_AFTER_S, MOST_PARAMETERS, QUEUE_LENGTH, Origin, Vehicle

PREARM = dialect.MAV_SYS_STATUS_PREARM_CHECK
ON_GROUND, IN_AIR = dialect.MAV_LANDED_STATE_ON_GROUND, dialect.MAV_LANDED_STATE_IN_AIR

HEARD = {
    "HEARTBEAT",
    "CURRENT_MODE",
    "SYS_STATUS",
    "EXTENDED_SYS_STATE",
    "LOCAL_POSITION_NED",
    "ATTITUDE",
    "GPS_GLOBAL_ORIGIN",
    "AUTOPILOT_VERSION",
    "HOME_POSITION",
    "COMMAND_ACK",
    "STATUSTEXT",
    "PARAM_VALUE",
    "PARAM_ERROR",
    "MESSAGE_INTERVAL",
}


class Probe:
    """A vehicle and the autopilot that speaks to it, over real frames."""

    def __init__(self, profile: AutopilotProfile = PX4) -> None:
        self.vehicle = Vehicle(VehicleAddress(MAIN, 1), profile, 0.0)
        self.sender, self.codec = Sender(1, 1), Codec()
        self.now_s = 0.0

    def hear(self, *messages: Message) -> Vehicle:
        for message in messages:
            self.now_s += 0.01
            for heard in self.codec.receive(self.sender.pack(message)):
                self.vehicle.handle(heard, self.now_s)
        return self.vehicle

    def heartbeat(self, mode: int, *, armed: bool, status: int = 3) -> Vehicle:
        base_mode = 0x1D | (0x80 if armed else 0)
        autopilot = self.vehicle.profile.autopilot
        return self.hear(dialect.MAVLink_heartbeat_message(2, autopilot, base_mode, mode, status, 3))

    def landed(self, state: int) -> Vehicle:
        return self.hear(dialect.MAVLink_extended_sys_state_message(0, state))

    def prearm(self, *, good: bool) -> Vehicle:
        return self.hear(sys_status(PREARM if good else 0))


def sys_status(health: int, millivolt: int = 16200, percent: int = 96) -> Message:
    message: Message = dialect.MAVLink_sys_status_message(0, 0, health, 0, millivolt, 0, percent, 0, 0, 0, 0, 0, 0)
    return message


def position(*numbers: float, time_ms: int = 0) -> Message:
    message: Message = dialect.MAVLink_local_position_ned_message(time_ms, *numbers)
    return message


def text(words: str, identity: int = 0, chunk: int = 0, severity: int = 2) -> Message:
    message: Message = dialect.MAVLink_statustext_message(severity, words.encode(), identity, chunk)
    return message


def test_a_flight_walks_through_the_phases() -> None:
    probe = Probe()
    offboard, land = PX4.streaming_mode, PX4.land_mode
    seen = [probe.heartbeat(PX4.modes["LOITER"], armed=False).phase, probe.prearm(good=True).phase]
    probe.vehicle.command_mode(offboard)
    probe.vehicle.asked_at_s[ARMING] = probe.now_s
    seen.append(probe.heartbeat(offboard, armed=True).phase)
    probe.landed(ON_GROUND)
    seen.append(probe.landed(IN_AIR).phase)
    probe.vehicle.command_mode(land)
    seen.append(probe.heartbeat(offboard, armed=True).phase)  # still the mode before: not a take-over
    seen.append(probe.hear(dialect.MAVLink_current_mode_message(0, land, land)).phase)
    probe.landed(ON_GROUND)
    seen.append(probe.heartbeat(PX4.modes["LOITER"], armed=False).phase)
    flying = Phase.FLYING
    assert seen == [Phase.DISCOVERED, Phase.READY, Phase.ARMED, flying, flying, Phase.LANDING, Phase.LANDED]
    assert [change.after for change in probe.vehicle.changes] == [seen[k] for k in (1, 2, 3, 5, 6)]
    assert [change.at_s for change in probe.vehicle.changes] == sorted(c.at_s for c in probe.vehicle.changes)


@pytest.mark.parametrize(
    ("uid", "uid2", "told"),
    [(0, b"", ""), (0x5349544C, b"", "000000005349544c"), (7, bytes(range(18)), bytes(range(18)).hex())],
)
def test_hardware_is_told_by_the_longer_identity_that_it_has(uid: int, uid2: bytes, told: str) -> None:
    probe, nothing = Probe(), [0] * 8
    longer = list(uid2.ljust(18, b"\0"))
    version = dialect.MAVLink_autopilot_version_message(0, 0, 0, 0, 0, nothing, nothing, nothing, 0, 0, uid, longer)
    assert probe.vehicle.uid == ""
    assert probe.hear(version).uid == told


def flying(profile: AutopilotProfile) -> Probe:
    probe = Probe(profile)
    probe.vehicle.command_mode(profile.streaming_mode)
    probe.heartbeat(profile.streaming_mode, armed=True)
    probe.landed(IN_AIR)
    return probe


@pytest.mark.parametrize("profile", [PX4, ARDUPILOT], ids=lambda profile: profile.name)
def test_any_mode_that_was_not_commanded_is_a_take_over_and_stays_one(profile: AutopilotProfile) -> None:
    for mode in set(profile.modes.values()) - {profile.streaming_mode}:
        probe = flying(profile)
        assert probe.vehicle.phase is Phase.FLYING
        assert probe.heartbeat(mode, armed=True).phase is Phase.FLYING  # one report may be a stale one
        assert probe.heartbeat(mode, armed=True).phase is Phase.TAKEN
        assert probe.heartbeat(profile.streaming_mode, armed=True).phase is Phase.TAKEN
        assert probe.heartbeat(profile.streaming_mode, armed=False).phase is Phase.TAKEN
        assert probe.heartbeat(profile.streaming_mode, armed=False).phase is Phase.LANDED


def test_one_report_alone_starts_no_alarm() -> None:
    loiter = PX4.modes["LOITER"]
    for stray in (
        dialect.MAVLink_heartbeat_message(2, PX4.autopilot, 0x1D, PX4.streaming_mode, 3, 3),
        dialect.MAVLink_heartbeat_message(2, PX4.autopilot, 0x9D, loiter, 3, 3),
        dialect.MAVLink_current_mode_message(0, loiter, loiter),
    ):
        probe = flying(PX4)
        for _ in range(3):
            assert probe.hear(stray).phase is Phase.FLYING
            assert probe.vehicle.armed
            assert probe.heartbeat(PX4.streaming_mode, armed=True).phase is Phase.FLYING


def test_two_reports_of_either_kind_are_a_take_over() -> None:
    probe, rtl = flying(PX4), PX4.modes["RTL"]
    probe.hear(dialect.MAVLink_current_mode_message(0, rtl, rtl))
    assert probe.heartbeat(rtl, armed=True).phase is Phase.TAKEN


def test_two_reports_are_a_disarming_and_on_the_ground_one() -> None:
    probe = flying(PX4)
    assert probe.heartbeat(PX4.streaming_mode, armed=False).phase is Phase.FLYING
    assert probe.heartbeat(PX4.streaming_mode, armed=False).phase is Phase.LANDED
    probe = flying(PX4)
    probe.landed(ON_GROUND)
    assert probe.heartbeat(PX4.streaming_mode, armed=False).phase is Phase.LANDED


def test_an_armed_heartbeat_from_the_past_makes_no_landed_vehicle_an_armed_one() -> None:
    probe = flying(PX4)
    probe.landed(ON_GROUND)
    assert probe.heartbeat(PX4.streaming_mode, armed=False).phase is Phase.LANDED
    probe.now_s += 30.0
    assert probe.heartbeat(PX4.streaming_mode, armed=True).phase is Phase.LANDED
    assert probe.heartbeat(PX4.streaming_mode, armed=False).phase is Phase.LANDED
    for phase in (Phase.LANDED, Phase.ARMED):  # somebody has armed it
        assert probe.heartbeat(PX4.streaming_mode, armed=True).phase is phase


def test_what_is_overtaken_by_its_like_says_nothing_and_what_comes_twice_neither() -> None:
    probe, land = Probe(), PX4.land_mode
    sent = [
        frame
        for message in (
            dialect.MAVLink_heartbeat_message(2, 12, 0x9D, PX4.streaming_mode, 3, 3),
            dialect.MAVLink_param_value_message(b"COM_OBL_RC_ACT", 0.0, 9, 1, 0),
            dialect.MAVLink_command_ack_message(176, 0, 0, 0, 255, 190),
            position(1, 0, 0, 0, 0, 0, time_ms=20),
            dialect.MAVLink_current_mode_message(0, land, land),
            dialect.MAVLink_param_value_message(b"COM_OBL_RC_ACT", 4.0, 9, 1, 0),
            dialect.MAVLink_command_ack_message(176, 1, 0, 0, 255, 190),
            position(2, 0, 0, 0, 0, 0, time_ms=60),
        )
        for frame in probe.codec.receive(probe.sender.pack(message))
    ]
    for order in (range(8), (4, 5, 6, 7, 0, 1, 2, 3), (0, 4, 5, 1, 6, 2, 7, 3, 0, 1, 2, 3), (7, 6, 5, 4, 3, 2, 1, 0)):
        vehicle = Vehicle(VehicleAddress(MAIN, 1), PX4, 0.0)
        for number, place in enumerate(order):
            vehicle.handle(sent[place], 0.01 * number)
        assert (vehicle.mode, vehicle.armed) == (land, True)
        assert (vehicle.params["COM_OBL_RC_ACT"], vehicle.acks[176].result) == (4.0, 1)
        assert vehicle.state.north_m == 2.0


def test_a_position_of_the_past_is_dropped_and_a_clock_that_starts_again_is_believed() -> None:
    probe = Probe()
    probe.hear(position(5, 0, 0, 0, 0, 0, time_ms=9000), position(1, 0, 0, 0, 0, 0, time_ms=100))
    assert probe.vehicle.state.north_m == 5.0
    probe.hear(position(6, 0, 0, 0, 0, 0, time_ms=9040), position(1, 0, 0, 0, 0, 0, time_ms=140))
    assert probe.vehicle.state.north_m == 6.0
    for number in range(1, 100):
        probe.now_s += 0.03
        before = probe.vehicle.samples
        if probe.hear(position(2, 0, 0, 0, 0, 0, time_ms=140 + 40 * number)).samples > before:
            break
    assert number <= 6  # the fifth that fits the ones before it
    assert probe.vehicle.boot_time_s == pytest.approx(0.14 + 0.04 * number)


def test_the_mode_before_is_ours_only_until_the_commanded_one_was_seen() -> None:
    probe = Probe()
    probe.heartbeat(PX4.modes["LOITER"], armed=True)
    probe.vehicle.command_mode(PX4.streaming_mode)
    phases = [
        probe.heartbeat(mode, armed=True).phase
        for mode in (PX4.modes["LOITER"], PX4.modes["LOITER"], PX4.streaming_mode, *[PX4.modes["LOITER"]] * 2)
    ]
    assert phases == [Phase.ARMED] * 4 + [Phase.TAKEN]


def test_nothing_is_taken_over_while_nothing_was_commanded() -> None:
    probe = Probe()
    for mode in PX4.modes.values():
        assert probe.heartbeat(mode, armed=True).phase is Phase.ARMED


def test_silence_and_return() -> None:
    probe = flying(ARDUPILOT)
    vehicle, heard_s = probe.vehicle, probe.now_s

    def phase_at(now_s: float) -> Phase:
        vehicle.watch(now_s)
        return vehicle.phase

    assert phase_at(heard_s + LOST_AFTER_S) is Phase.FLYING
    assert phase_at(heard_s + LOST_AFTER_S + 0.01) is Phase.LOST
    # A position alone does not say in which mode it is.
    assert probe.hear(position(0, 0, 0, 0, 0, 0)).phase is Phase.LOST
    assert probe.heartbeat(ARDUPILOT.streaming_mode, armed=True).phase is Phase.FLYING


def test_readiness_follows_the_prearm_bit() -> None:
    probe = Probe()
    assert probe.prearm(good=True).phase is Phase.READY
    assert probe.prearm(good=False).phase is Phase.DISCOVERED
    assert not probe.vehicle.prearm_ok


def test_positions_are_taken_only_whole_and_finite() -> None:
    probe = Probe()
    vehicle = probe.hear(position(1, 2, -3, 4, 5, 6, time_ms=1500))
    assert (vehicle.position_ned_m, vehicle.velocity_ned_m_s) == ((1.0, 2.0, -3.0), (4.0, 5.0, 6.0))
    assert (vehicle.samples, vehicle.boot_time_s, vehicle.position_at_s) == (1, 1.5, probe.now_s)
    for place in range(6):
        for bad in (math.nan, math.inf, -math.inf):
            numbers = [9.0] * 6
            numbers[place] = bad
            probe.hear(position(*numbers, time_ms=9999))
    assert (vehicle.position_ned_m, vehicle.samples, vehicle.boot_time_s) == ((1.0, 2.0, -3.0), 1, 1.5)
    probe.hear(dialect.MAVLink_attitude_message(0, 0, 0, 1.5, 0, 0, 0))
    probe.hear(dialect.MAVLink_attitude_message(0, 0, 0, math.nan, 0, 0, 0))
    assert vehicle.yaw_rad == 1.5


def test_height_counts_from_where_it_stood_disarmed() -> None:
    probe = Probe()
    assert probe.vehicle.height_m is None
    probe.hear(position(0, 0, 0.5, 0, 0, 0))
    probe.heartbeat(PX4.streaming_mode, armed=True)
    vehicle = probe.hear(position(0, 0, -3.5, 0, 0, 0))
    assert vehicle.height_m == 4.0
    assert vehicle.ground_ned_m == (0.0, 0.0, 0.5)


def test_only_the_autopilot_speaks_for_the_vehicle() -> None:
    probe = Probe()
    probe.sender.component_id = 154
    camera = Sender(1, 154)
    for heard in probe.codec.receive(camera.pack(dialect.MAVLink_heartbeat_message(26, 8, 0x80, 5, 3, 3))):
        probe.vehicle.handle(heard, 1.0)
    other = dialect.MAVLink_heartbeat_message(2, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, 0x80, 4, 3, 3)
    for heard in probe.codec.receive(Sender(1, 1).pack(other)):
        probe.vehicle.handle(heard, 1.0)
    assert (probe.vehicle.mode, probe.vehicle.armed, probe.vehicle.heard_at_s) == (None, False, 0.0)


def test_only_acknowledgements_to_us_count_and_the_newest_wins() -> None:
    probe = Probe()
    for result, system, component in ((0, 255, 190), (1, 255, 190), (0, 254, 190), (4, 255, 1)):
        probe.hear(dialect.MAVLink_command_ack_message(176, result, 0, 0, system, component))
    assert probe.vehicle.acks[176][:2] == (1, 0.02)
    probe.hear(dialect.MAVLink_command_ack_message(176, 0, 0, 0, 0, 0))  # MAVLink 1 has no target
    assert probe.vehicle.acks[176].result == 0


def test_origin_and_battery() -> None:
    probe = Probe()
    probe.hear(dialect.MAVLink_gps_global_origin_message(473977428, 85455967, 489052))
    vehicle = probe.hear(sys_status(0))
    assert vehicle.origin == Origin(47.3977428, 8.5455967, 489.052)
    assert vehicle.battery == (16.2, 0.96)
    probe.hear(sys_status(0, millivolt=0xFFFF, percent=-1))
    assert math.isnan(vehicle.battery.voltage_v)
    assert math.isnan(vehicle.battery.remaining)


def test_texts_are_put_together() -> None:
    probe = Probe()
    long = "Arming denied: Resolve system health failures first\t"
    for identity in (0, 1, 77):  # PX4 counts from 0, although MAVLink keeps 0 for texts in one piece
        probe.hear(text(long[:50], identity, 0), text(long[50:], identity, 1))
    probe.hear(text("Takeoff detected\t", 78, severity=6))
    texts = [(said.severity, said.text) for said in probe.vehicle.texts]
    assert texts == [(2, long.strip())] * 3 + [(6, "Takeoff detected")]


def test_a_text_with_a_lost_chunk_is_told_with_a_gap() -> None:
    probe = Probe()
    probe.hear(text("a" * 50, 5, 0), text("c", 5, 2))
    probe.hear(text("d" * 50, 6, 0), text("e", 7))
    probe.hear(text("f" * 50))
    assert [said.text for said in probe.vehicle.texts] == ["a" * 50 + "…c", "d" * 50, "e"]
    probe.vehicle.watch(probe.now_s + 1.0)
    assert probe.vehicle.texts[-1].text == "f" * 50


def test_queues_and_tables_are_bounded() -> None:
    probe = Probe()
    for number in range(MOST_PARAMETERS + 100):
        probe.hear(dialect.MAVLink_param_value_message(f"P{number}".encode(), 1.0, 9, 1, 0))
        probe.hear(text(f"{number}", severity=6))
    assert len(probe.vehicle.params) == MOST_PARAMETERS
    assert len(probe.vehicle.texts) == QUEUE_LENGTH


def test_hostile_frames_never_raise() -> None:
    draw = random.Random(6)
    kinds = [kind for kind in dialect.mavlink_map.values() if kind.msgname in HEARD or draw.random() < 0.1]
    for profile in (PX4, ARDUPILOT):
        vehicle, codec = Vehicle(VehicleAddress(MAIN, 1), profile, 0.0), Codec()
        heard = 0
        for _ in range(1000):
            kind = draw.choice(kinds)
            payload = bytearray(draw.randbytes(kind.unpacker.size))
            if draw.random() < 0.5:  # NaN, infinity, all ones
                payload = bytearray(draw.choice((b"\x00\x00\xc0\x7f", b"\x00\x00\x80\xff", b"\xff\xff\xff\xff")) * 64)
            for message in codec.receive(frame_of(kind, bytes(payload[: kind.unpacker.size]))):
                assert is_known(message)
                vehicle.handle(message, float(heard))
                vehicle.watch(float(heard))
                heard += 1
        assert heard > 950
        assert vehicle.phase in Phase
        assert vehicle.position_ned_m is None or all(map(math.isfinite, vehicle.position_ned_m))


def frame_of(kind: type[dialect.MAVLink_message], payload: bytes) -> bytes:
    identity: int = kind.id
    body = bytes([len(payload), 0, 0, 0, 1, 1]) + identity.to_bytes(3, "little") + payload
    checksum: int = dialect.x25crc(body + bytes([kind.crc_extra])).crc
    return b"\xfd" + body + checksum.to_bytes(2, "little")
