"""Position targets on their way in: the fields of SET_POSITION_TARGET_LOCAL_NED, and what becomes of them.

Positions in the fields are in the vehicle's own local NED; `Pose.local_origin_ned_m` turns them into the world's.
Which combination of type mask and frame does what is the autopilot's own: `Rules.interpret`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum, auto
from typing import Any, NamedTuple

from sitl_mock.physics.reference import Reference, Vec3

FORCE_BIT, YAW_BIT, YAW_RATE_BIT = 0x200, 0x400, 0x800  # of POSITION_TARGET_TYPEMASK
PLAIN_MASK = YAW_RATE_BIT
LARGEST_PLAIN = 1e6  # of the square of all numbers; whatever is beyond is read with care
LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9  # MAV_FRAME
LETHAL = "this setpoint would have killed a real SITL"


class SetpointEffect(Enum):
    """What a setpoint does."""

    FLY = auto()
    BRAKE = auto()  # ArduPilot: drops its target and brakes, in silence
    HOLD = auto()  # PX4: counts as a setpoint, holds with zero velocity, in silence
    INVALID = auto()  # PX4: does not count as a setpoint, one text per message


class Interpretation(NamedTuple):
    """A setpoint as an autopilot understands it: a reference to fly, or what it does instead and a status text."""

    effect: SetpointEffect
    reference: Reference | None = None
    text: str = ""


class SetpointFields(NamedTuple):
    """The fields of SET_POSITION_TARGET_LOCAL_NED, grouped; SI units, NED, the type mask not yet applied."""

    mask: int
    frame: int
    position_m: Vec3
    velocity_m_s: Vec3
    acceleration_m_s2: Vec3
    yaw_rad: float
    yaw_rate_rad_s: float

    @classmethod
    def of(cls, fields: Mapping[str, Any]) -> SetpointFields:
        """Group the fields of the message."""
        return cls(
            int(fields["type_mask"]),
            int(fields["coordinate_frame"]),
            (fields["x"], fields["y"], fields["z"]),
            (fields["vx"], fields["vy"], fields["vz"]),
            (fields["afx"], fields["afy"], fields["afz"]),
            fields["yaw"],
            fields["yaw_rate"],
        )

    @property
    def is_plain(self) -> bool:
        """Whether it is of the kind that streams are made of."""
        return is_plain(
            self.mask, self.frame, *self.position_m, *self.velocity_m_s, *self.acceleration_m_s2, self.yaw_rad
        )

    def heading(self) -> tuple[float | None, float]:
        """Yaw [rad] (None: not given) and yaw rate [rad/s]; numbers that are not finite count as not given."""
        given = not self.mask & YAW_BIT and math.isfinite(self.yaw_rad)
        rate = not self.mask & YAW_RATE_BIT and math.isfinite(self.yaw_rate_rad_s)
        return (
            math.remainder(self.yaw_rad, 2.0 * math.pi) if given else None,
            self.yaw_rate_rad_s if rate else 0.0,
        )


def is_plain(
    mask: int,
    frame: int,
    x: float,
    y: float,
    z: float,
    u: float,
    v: float,
    w: float,
    a: float,
    b: float,
    c: float,
    yaw_rad: float,
) -> bool:
    """Whether a setpoint says everything but a yaw rate, in the local frame and in numbers that no flight exceeds."""
    # One comparison for all ten: NaN makes it false as infinity does.
    length = x * x + y * y + z * z + u * u + v * v + w * w + a * a + b * b + c * c + yaw_rad * yaw_rad
    return mask == PLAIN_MASK and frame == LOCAL_NED and length < LARGEST_PLAIN


class Pose(NamedTuple):
    """What a setpoint is relative to: the time, the vehicle's place and heading, and the origin of its local frame."""

    now_s: float
    local_origin_ned_m: Vec3  # world
    position_ned_m: Vec3  # world
    yaw_rad: float


def turned(v: Vec3, yaw_rad: float) -> Vec3:
    """A vector of the body's heading frame in NED."""
    if yaw_rad == 0.0:
        return v
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return (cos * v[0] - sin * v[1], sin * v[0] + cos * v[1], v[2])
