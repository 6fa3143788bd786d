"""SET_POSITION_TARGET_LOCAL_NED as PX4 and ArduPilot understand it: fields -> reference, or why not.

Positions here are in the vehicle's own local NED; `offset_ned_m` (the local origin in world NED) turns them into the
world's. Which combination does what was measured on both autopilots, see `docs/autopilots`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from sitl_mock.physics.reference import ALL, NONE, ZERO, Flags3, Reference, Vec3

FORCE_BIT, YAW_BIT, YAW_RATE_BIT = 0x200, 0x400, 0x800
LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9  # MAV_FRAME
FASTEST_OBEYED_M_S = 1000.0  # ArduPilot brakes on wishes beyond
FARTHEST_SURVIVED_M = 1e8  # a position of 1e9 m killed ArduPilot's SITL, 1e6 m was flown to
LETHAL = "this setpoint would have killed a real SITL"


class Verdict(Enum):
    """What becomes of a setpoint."""

    FLY = auto()
    BRAKE = auto()  # ArduPilot: drops its target and brakes, in silence
    HOLD = auto()  # PX4: counts as a setpoint, holds with zero velocity, in silence
    INVALID = auto()  # PX4: does not count as a setpoint, one text per message


@dataclass(frozen=True, slots=True)
class Understood:
    """A setpoint after reading: a reference to fly, or the verdict and a text for the link."""

    verdict: Verdict
    reference: Reference | None = None
    text: str = ""


@dataclass(frozen=True, slots=True)
class Wish:
    """The fields of SET_POSITION_TARGET_LOCAL_NED, grouped; NED, with the type mask not yet applied."""

    mask: int
    frame: int
    position_m: Vec3
    velocity_m_s: Vec3
    acceleration_m_s2: Vec3
    yaw_rad: float
    yaw_rate_rad_s: float

    @classmethod
    def of(cls, fields: Mapping[str, Any]) -> Wish:
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


@dataclass(frozen=True, slots=True)
class Situation:
    """What a setpoint is read against: time, and the vehicle's pose in world NED."""

    now_s: float
    offset_ned_m: Vec3  # local origin in world NED
    position_ned_m: Vec3  # world
    yaw_rad: float


def understand_px4(wish: Wish, situation: Situation, carry_s: float) -> Understood:
    """Read a setpoint as PX4 does: axis by axis, NaN is the same as ignored, frame 1 for positions."""
    position = _masked(wish.position_m, wish.mask, 0)
    velocity = _masked(wish.velocity_m_s, wish.mask, 3)
    acceleration = _masked(wish.acceleration_m_s2, wish.mask, 6)
    used_p, used_v, used_a = _finite(position), _finite(velocity), _finite(acceleration)
    name = "SET_POSITION_TARGET_LOCAL_NED"
    if wish.frame not in (LOCAL_NED, BODY_NED):
        return Understood(Verdict.INVALID, text=f"{name} coordinate frame {wish.frame} unsupported")
    if wish.mask & FORCE_BIT and any(used_a):
        return Understood(Verdict.INVALID, text=f"{name} force not supported")
    if not any(used_p + used_v + used_a) or (wish.frame == BODY_NED and any(used_p)):
        return Understood(Verdict.INVALID, text=f"{name} invalid")
    if used_p[0] != used_p[1] or used_v[0] != used_v[1] or not _axes_controlled(used_p, used_v, used_a):
        return Understood(Verdict.HOLD)
    turn = situation.yaw_rad if wish.frame == BODY_NED else 0.0
    yaw_rad, rate_rad_s = _heading(wish)
    return Understood(
        Verdict.FLY,
        Reference(
            position_ned_m=_plus(_filled(position), situation.offset_ned_m),
            velocity_ned_m_s=_turned(_filled(velocity), turn),
            acceleration_ned_m_s2=_turned(_filled(acceleration), turn),
            position_used=used_p,
            velocity_used=used_v,
            yaw_rad=yaw_rad,
            yaw_rate_rad_s=rate_rad_s,
            since_s=situation.now_s,
            carry_s=carry_s,
        ),
    )


def understand_ardupilot(wish: Wish, situation: Situation, carry_s: float) -> Understood:
    """Read a setpoint as ArduPilot does: group by group, any ignored bit of a group ignores the group."""
    use_p, use_v, use_a = (not wish.mask & (0b111 << shift) for shift in (0, 3, 6))
    if wish.mask & FORCE_BIT and use_a:
        return Understood(Verdict.BRAKE)
    if not (use_p or use_v or use_a) or (use_p and use_a and not use_v):
        return Understood(Verdict.BRAKE)
    if wish.frame not in (LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED):
        return Understood(Verdict.BRAKE)
    if use_v and not all(abs(v) <= FASTEST_OBEYED_M_S for v in wish.velocity_m_s):
        return Understood(Verdict.BRAKE)  # NaN compares false: it brakes too
    if (
        (use_p and not all(abs(p) < FARTHEST_SURVIVED_M for p in wish.position_m))
        or (use_a and not all(map(math.isfinite, wish.acceleration_m_s2)))
        or (not wish.mask & YAW_BIT and not math.isfinite(wish.yaw_rad))
    ):
        return Understood(Verdict.BRAKE, text=LETHAL)
    turn = situation.yaw_rad if wish.frame in (BODY_NED, BODY_OFFSET_NED) else 0.0
    base = situation.offset_ned_m if wish.frame == LOCAL_NED else situation.position_ned_m
    yaw_rad, rate_rad_s = _heading(wish)
    velocity = _turned(wish.velocity_m_s, turn) if use_v else ZERO
    if wish.mask & YAW_BIT and wish.mask & YAW_RATE_BIT:
        yaw_rad = _travel(velocity, wish.position_m if use_p else None, base, situation, turn)
    return Understood(
        Verdict.FLY,
        Reference(
            position_ned_m=_plus(_turned(wish.position_m, turn), base) if use_p else ZERO,
            velocity_ned_m_s=velocity,
            acceleration_ned_m_s2=_turned(wish.acceleration_m_s2, turn) if use_a else ZERO,
            position_used=ALL if use_p else NONE,
            velocity_used=ALL if use_v else NONE,
            yaw_rad=yaw_rad,
            yaw_rate_rad_s=rate_rad_s,
            since_s=situation.now_s,
            carry_s=carry_s if use_v or use_a else 0.0,
            lapses=use_v or use_a,  # a position alone holds for ever
        ),
    )


def _travel(velocity: Vec3, position: Vec3 | None, base: Vec3, situation: Situation, turn: float) -> float | None:
    """ArduPilot without a yaw: the nose turns into the direction of travel; None (keep) when there is none."""
    north, east = velocity[0], velocity[1]
    if position is not None and velocity == ZERO:
        target = _plus(_turned(position, turn), base)
        north, east = (target[i] - situation.position_ned_m[i] for i in (0, 1))
    if math.hypot(north, east) < 1.0:  # below a metre (or a metre per second) the direction is noise
        return None
    return math.atan2(east, north)


def _axes_controlled(used_p: Flags3, used_v: Flags3, used_a: Flags3) -> bool:
    """Whether every axis has something to fly; PX4 holds if one has nothing."""
    return all(p or v or a for p, v, a in zip(used_p, used_v, used_a, strict=True))


def _heading(wish: Wish) -> tuple[float | None, float]:
    """Yaw [rad] (None: not given) and yaw rate [rad/s] of a wish; hostile numbers count as not given."""
    given = not wish.mask & YAW_BIT and math.isfinite(wish.yaw_rad)
    rate = not wish.mask & YAW_RATE_BIT and math.isfinite(wish.yaw_rate_rad_s)
    return (
        math.remainder(wish.yaw_rad, 2.0 * math.pi) if given else None,
        wish.yaw_rate_rad_s if rate else 0.0,
    )


def _masked(values: Vec3, mask: int, shift: int) -> Vec3:
    x, y, z = (math.nan if mask & (1 << (shift + i)) else value for i, value in enumerate(values))
    return (x, y, z)


def _finite(values: Vec3) -> Flags3:
    x, y, z = (math.isfinite(value) for value in values)
    return (x, y, z)


def _filled(values: Vec3) -> Vec3:
    x, y, z = (value if math.isfinite(value) else 0.0 for value in values)
    return (x, y, z)


def _plus(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _turned(v: Vec3, yaw_rad: float) -> Vec3:
    """A vector of the body's heading frame in NED."""
    if yaw_rad == 0.0:
        return v
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return (cos * v[0] - sin * v[1], sin * v[0] + cos * v[1], v[2])
