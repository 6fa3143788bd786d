import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.autopilots import ARDUPILOT, PX4, AutopilotProfile, TakeOff, profile_of

TIME_OUTS = [(PX4, "COM_OF_LOSS_T", 1.0), (ARDUPILOT, "FS_GCS_TIMEOUT", 5.0), (ARDUPILOT, "GUID_TIMEOUT", 1.0)]
BOTH = pytest.mark.parametrize("profile", [PX4, ARDUPILOT], ids=lambda profile: profile.name)


@BOTH
def test_the_modes_we_use_have_names(profile: AutopilotProfile) -> None:
    used = [profile.streaming_mode, profile.land_mode]
    assert len(set(used)) == len(used)
    assert set(used) <= set(profile.modes.values())
    for name, number in profile.modes.items():
        assert profile.mode_name(number) == name
    assert profile.mode_name(0x7F123456) == "mode 0x7f123456"


def test_mode_numbers_as_seen_on_the_wire() -> None:
    assert (PX4.modes["OFFBOARD"], PX4.modes["LAND"], PX4.modes["LOITER"]) == (0x00060000, 0x06040000, 0x03040000)
    assert (ARDUPILOT.modes["GUIDED"], ARDUPILOT.modes["LAND"], ARDUPILOT.modes["BRAKE"]) == (4, 9, 17)


def test_profiles_are_chosen_by_the_heartbeat() -> None:
    def heartbeat(kind: int, autopilot: int) -> dialect.MAVLink_heartbeat_message:
        return dialect.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 3, 3)

    assert profile_of(heartbeat(dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_PX4)) is PX4
    assert profile_of(heartbeat(dialect.MAV_TYPE_HEXAROTOR, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA)) is ARDUPILOT
    assert profile_of(heartbeat(dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID)) is None
    assert profile_of(heartbeat(dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA)) is None
    assert profile_of(heartbeat(dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_GENERIC)) is None


@BOTH
def test_streams_name_messages_of_the_dialect(profile: AutopilotProfile) -> None:
    streams = {stream.name: stream for stream in profile.streams(telemetry_hz=25.0)}
    assert streams["LOCAL_POSITION_NED"].rate_hz == 25.0
    for name, stream in streams.items():
        assert dialect.mavlink_map[stream.message_id].msgname == name
        assert stream.rate_hz != 0.0  # would mean the vehicle's own default, whatever that is
    assert {name for name, stream in streams.items() if stream.needed} == {
        "LOCAL_POSITION_NED",
        "EXTENDED_SYS_STATE",
        "SYS_STATUS",
    }


def test_each_autopilot_shows_a_mode_change_quickly_its_own_way() -> None:
    assert "CURRENT_MODE" in PX4.rates_hz
    assert "HEARTBEAT" not in PX4.rates_hz  # refused there
    assert "CURRENT_MODE" not in ARDUPILOT.rates_hz  # unknown there
    assert "HEARTBEAT" in ARDUPILOT.rates_hz


@BOTH
def test_parameter_names_fit_the_wire(profile: AutopilotProfile) -> None:
    names = [name for limit in profile.limits for name in limit.names]
    names += [failsafe.name for failsafe in profile.failsafes]
    assert len(set(names)) == len(names)
    assert all(len(name) <= 16 for name in names)
    assert {"speed_m_s", "climb_m_s", "descent_m_s", "acceleration_m_s2"} <= {
        limit.quantity for limit in profile.limits
    }
    assert all(scale > 0.0 for limit in profile.limits for scale in limit.names.values())


def test_old_and_new_names_of_ardupilot_mean_the_same_limit() -> None:
    speed = next(limit for limit in ARDUPILOT.limits if limit.quantity == "speed_m_s")
    assert 1000.0 * speed.names["WPNAV_SPEED"] == 10.0 * speed.names["WP_SPD"]


def test_only_ardupilot_takes_off_by_command() -> None:
    assert (PX4.take_off, ARDUPILOT.take_off) == (TakeOff.BY_SETPOINT, TakeOff.BY_COMMAND)


@BOTH
def test_the_table_cannot_be_changed(profile: AutopilotProfile) -> None:
    with pytest.raises(TypeError):
        profile.modes["NEW"] = 1  # type: ignore[index]  # the point of this test
    with pytest.raises(AttributeError):
        profile.name = "other"  # type: ignore[misc]  # the point of this test


@pytest.mark.parametrize(("profile", "name", "wanted"), TIME_OUTS)
def test_time_outs_are_shortened_and_never_lengthened(profile: AutopilotProfile, name: str, wanted: float) -> None:
    found = next(each for each in profile.failsafes if each.name == name)
    assert found.wanted == wanted == float(np.float32(wanted))  # a vehicle keeps it as it is
    assert found.is_safe(wanted)
    assert found.is_safe(0.5 * wanted)
    assert not found.is_safe(1.01 * wanted)
    assert not found.is_safe(0.0)  # off, or at once


@BOTH
def test_what_is_planned_for_is_the_time_out_that_is_set(profile: AutopilotProfile) -> None:
    wanted = {each.name: each.wanted for each in profile.failsafes}
    longest_s = profile.lost_link.timeout_s
    assert longest_s == wanted[profile.stream_timeout[0]]
    for shorter_s in profile.shorter_timeouts_s:
        assert 0.0 < shorter_s == float(np.float32(shorter_s)) < longest_s
