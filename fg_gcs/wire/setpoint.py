"""Position targets on the hot path: SET_POSITION_TARGET_LOCAL_NED packed with one precompiled layout.

Position, velocity, acceleration and yaw go out together, always: an autopilot ignores a whole group when one of its
bits is ignored, and ArduPilot turns the nose into the direction of travel when yaw is (measured, see docs/autopilots).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import FgError
from fg_gcs.wire.framing import Sender, id_bytes

Vec3 = Sequence[float]  # (3,)

_KIND: Final = dialect.MAVLink_set_position_target_local_ned_message
_pack_payload: Final = _KIND.unpacker.pack
_ID: Final = id_bytes(_KIND.id)
_CRC_EXTRA: Final = bytes([_KIND.crc_extra])

# The last byte of the payload. It is not zero, so MAVLink 2 never shortens this message.
_LOCAL_NED: Final[int] = dialect.MAV_FRAME_LOCAL_NED
TYPE_MASK: Final[int] = dialect.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE  # 0x800: everything counts but yaw rate
_AUTOPILOT: Final[int] = dialect.MAV_COMP_ID_AUTOPILOT1

LARGEST: Final = 1e6  # m, m/s, m/s^2, rad: ArduCopter flies to 1e6 m and dies of 1e9 m; no flight of ours comes near


class UnsafeSetpoint(FgError):
    """A setpoint with a number in it that must not reach an autopilot: NaN and huge values have killed some.

    Args:
        system_id: The vehicle it was meant for.
        setpoint: The setpoint.
    """

    def __init__(self, system_id: int, setpoint: "Setpoint") -> None:
        self.system_id, self.setpoint = system_id, setpoint
        super().__init__(
            f"setpoint for vehicle {system_id} is not finite or beyond {LARGEST:g} and is not sent: {setpoint}"
        )


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What one vehicle should be doing at one instant, in its own local frame.

    Attributes:
        position_ned_m: [m; north, east, down from the vehicle's local origin]
        velocity_ned_m_s: [m/s; NED]
        acceleration_ned_m_s2: [m/s^2; NED]
        yaw_ned_rad: [rad; clockwise from north]
    """

    position_ned_m: Vec3
    velocity_ned_m_s: Vec3
    acceleration_ned_m_s2: Vec3
    yaw_ned_rad: float


def pack_setpoint(setpoint: Setpoint, system_id: int, sender: Sender, time_boot_ms: int = 0) -> bytes:
    """Return the frame that streams ``setpoint`` to the autopilot of ``system_id``.

    Args:
        setpoint: Floats are fastest; numpy rows work (``.tolist()`` once a tick is cheaper than unpacking them here).
        system_id: The vehicle.
        sender: Gives our address and the sequence number.
        time_boot_ms: Time stamp [ms]; both autopilots ignore it.

    Raises:
        UnsafeSetpoint: A number is NaN, infinite or beyond `LARGEST`; no byte leaves and no sequence number is used.
    """
    x, y, z = setpoint.position_ned_m
    u, v, w = setpoint.velocity_ned_m_s
    a, b, c = setpoint.acceleration_ned_m_s2
    yaw = setpoint.yaw_ned_rad
    # One comparison for all ten: NaN makes it false as infinity does.
    if not x * x + y * y + z * z + u * u + v * v + w * w + a * a + b * b + c * c + yaw * yaw <= LARGEST * LARGEST:
        raise UnsafeSetpoint(system_id, setpoint)
    # Spelt out: unpacking tuples here would cost half as much again (1.5 us against 1.0, pymavlink 3.9).
    payload = _pack_payload(
        time_boot_ms,
        x,
        y,
        z,
        u,
        v,
        w,
        a,
        b,
        c,
        yaw,
        0.0,
        TYPE_MASK,
        system_id,
        _AUTOPILOT,
        _LOCAL_NED,
    )
    return sender.finish(_ID, _CRC_EXTRA, payload)
