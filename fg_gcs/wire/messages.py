"""The messages that come often, read by one precompiled layout each into light tuples.

Fields have the names and the order that they have on the wire, and values are those that pymavlink reads.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect


class Heartbeat(NamedTuple):
    """HEARTBEAT: kind of autopilot, mode, armed or not."""

    custom_mode: int
    type: int  # MAV_TYPE
    autopilot: int  # MAV_AUTOPILOT
    base_mode: int  # MAV_MODE_FLAG
    system_status: int  # MAV_STATE
    mavlink_version: int


class CurrentMode(NamedTuple):
    """CURRENT_MODE: what PX4 sends five times a second beside its heartbeat."""

    custom_mode: int
    intended_custom_mode: int
    standard_mode: int  # MAV_STANDARD_MODE


class SysStatus(NamedTuple):
    """SYS_STATUS: sensors, load, battery."""

    onboard_control_sensors_present: int  # MAV_SYS_STATUS_SENSOR, as the two that follow
    onboard_control_sensors_enabled: int
    onboard_control_sensors_health: int
    load: int  # [0.1 %]
    voltage_battery: int  # [mV], 65535 unknown
    current_battery: int  # [cA], -1 unknown
    drop_rate_comm: int  # [0.01 %]
    errors_comm: int
    errors_count1: int
    errors_count2: int
    errors_count3: int
    errors_count4: int
    battery_remaining: int  # [%], -1 unknown
    onboard_control_sensors_present_extended: int
    onboard_control_sensors_enabled_extended: int
    onboard_control_sensors_health_extended: int


class ExtendedSysState(NamedTuple):
    """EXTENDED_SYS_STATE: on the ground or in the air."""

    vtol_state: int  # MAV_VTOL_STATE
    landed_state: int  # MAV_LANDED_STATE


class LocalPositionNed(NamedTuple):
    """LOCAL_POSITION_NED: position and velocity in the vehicle's own frame."""

    time_boot_ms: int
    x: float  # [m; north, east, down from the vehicle's local origin]
    y: float
    z: float
    vx: float  # [m/s; NED]
    vy: float
    vz: float


class Attitude(NamedTuple):
    """ATTITUDE: angles and their rates."""

    time_boot_ms: int
    roll: float  # [rad]
    pitch: float
    yaw: float  # [rad; clockwise from north]
    rollspeed: float  # [rad/s]
    pitchspeed: float
    yawspeed: float


class GlobalPositionInt(NamedTuple):
    """GLOBAL_POSITION_INT: position on Earth."""

    time_boot_ms: int
    lat: int  # [1e-7 deg]
    lon: int  # [1e-7 deg]
    alt: int  # [mm above mean sea level]
    relative_alt: int  # [mm above home]
    vx: int  # [cm/s; NED]
    vy: int
    vz: int
    hdg: int  # [0.01 deg], 65535 unknown


class Timesync(NamedTuple):
    """TIMESYNC: a question for the time, or the answer."""

    tc1: int  # [ns] time of who answers, 0 in a question
    ts1: int  # [ns] time of who asks


HEARTBEAT: Final[int] = dialect.MAVLINK_MSG_ID_HEARTBEAT
GLOBAL_POSITION_INT: Final[int] = dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
LOCAL_POSITION_NED: Final[int] = dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED

Reader = Callable[[bytes], Any]  # payload to a tuple or one of pymavlink's messages


def _reader(fields: Any, kind: Any) -> Reader:  # noqa: ANN401 - classes of NamedTuple and of pymavlink
    """Return what reads payloads of one kind: trailing zeros may be cut off, what is too long is a newer version's."""
    make, unpack, size = fields._make, kind.unpacker.unpack, kind.unpacker.size

    def read(payload: bytes) -> Any:  # noqa: ANN401 - of the kind given
        return make(unpack(payload if len(payload) == size else payload[:size].ljust(size, b"\0")))

    return read


READERS: Final[Mapping[int, Reader]] = MappingProxyType(
    {
        kind.id: _reader(fields, kind)
        for fields, kind in (
            (Heartbeat, dialect.MAVLink_heartbeat_message),
            (CurrentMode, dialect.MAVLink_current_mode_message),
            (SysStatus, dialect.MAVLink_sys_status_message),
            (ExtendedSysState, dialect.MAVLink_extended_sys_state_message),
            (LocalPositionNed, dialect.MAVLink_local_position_ned_message),
            (Attitude, dialect.MAVLink_attitude_message),
            (GlobalPositionInt, dialect.MAVLink_global_position_int_message),
            (Timesync, dialect.MAVLink_timesync_message),
        )
    }
)
