"""What a vehicle's inner loop is asked to do: the only thing that autopilot logic hands to the physics."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

Vec3 = tuple[float, float, float]
Flags3 = tuple[bool, bool, bool]

ZERO: Vec3 = (0.0, 0.0, 0.0)
ALL: Flags3 = (True, True, True)
NONE: Flags3 = (False, False, False)


def plus(a: Vec3, b: Vec3) -> Vec3:
    """The sum of two vectors."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


class Thrust(IntEnum):
    """What the motors do."""

    OFF = 0
    IDLE = 1  # armed on the ground: turning, not lifting
    FLY = 2


class Limits(NamedTuple):
    """Speeds and acceleration that the autopilot allows itself, from its parameters.

    `acceleration_m_s2` bounds corrections and steps; a fed-forward acceleration may exceed it up to what the body can.
    """

    speed_m_s: float  # [m/s; horizontal norm]
    climb_m_s: float  # [m/s]
    descent_m_s: float  # [m/s]
    acceleration_m_s2: float  # [m/s^2; norm]
    step_gain_per_s: float  # [1/s] approach to a position without velocity feed-forward


class Reference(NamedTuple):
    """One target, valid from `since_s` on, in world NED.

    Axes that are in neither `position_used` nor `velocity_used` fly open loop with `acceleration`. The target runs on
    by `velocity` and `acceleration` for at most `carry_s`; then it stops there if `lapses`, else keeps its velocity. In
    measured dynamics each autopilot decides whether a target runs on.
    """

    position_ned_m: Vec3 = ZERO
    velocity_ned_m_s: Vec3 = ZERO
    acceleration_ned_m_s2: Vec3 = ZERO
    position_used: Flags3 = NONE
    velocity_used: Flags3 = NONE
    yaw_rad: float | None = None  # [rad; clockwise from north] None keeps the heading
    yaw_rate_rad_s: float = 0.0  # [rad/s] used when `yaw_rad` is None
    since_s: float = 0.0
    carry_s: float = 0.0
    lapses: bool = False
    planned: bool = False  # the autopilot's own target, not a client's: measured dynamics shape the way to it

    @property
    def is_step(self) -> bool:
        """Whether there is no velocity to feed forward: the approach has to be planned on board."""
        return not any(self.velocity_used)
