"""True motions of targets: pure functions of time, for targets that are made up and not met.

Time counts from when tracking begins. Before that a target stays where it then is, unless its motion has no beginning.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fg_gcs.core.arrays import Array

Point = tuple[float, float, float]


class TrueMotion(Protocol):
    """Where a target really is."""

    @property
    def top_speed_m_s(self) -> float:
        """A speed that it never exceeds [m/s]; the least one for motions in closed form."""

    @property
    def box_enu_m(self) -> Array:
        """Corners of a box that it never leaves, the low one and the high one, shape (2, 3) [m; ENU]."""

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Return position [m; ENU] and velocity [m/s; ENU] at times, shape (T,) [s]; each (T, 3)."""


@dataclass(frozen=True)
class Static:
    """A target that stays where it is."""

    position_enu_m: Point

    @property
    def top_speed_m_s(self) -> float:
        """Zero [m/s]."""
        return 0.0

    @property
    def box_enu_m(self) -> Array:
        """The position twice, shape (2, 3) [m; ENU]."""
        return np.array([self.position_enu_m] * 2)

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Return the position and no velocity at times, shape (T,) [s]; each (T, 3)."""
        return np.tile(self.position_enu_m, (len(time_s), 1)), np.zeros((len(time_s), 3))


@dataclass(frozen=True)
class Circle:
    """A level circle at a steady speed, without beginning or end."""

    centre_enu_m: Point
    radius_m: float  # above 0
    speed_m_s: float  # 0 or more
    phase_deg: float = 0.0  # where it is at time 0, counter-clockwise from east as seen from above
    clockwise: bool = False

    @property
    def top_speed_m_s(self) -> float:
        """The speed [m/s]."""
        return self.speed_m_s

    @property
    def box_enu_m(self) -> Array:
        """Corners of the circle's box, shape (2, 3) [m; ENU]."""
        return _box(self.centre_enu_m, [self.radius_m, self.radius_m, 0.0])

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Return position [m; ENU] and velocity [m/s; ENU] at times, shape (T,) [s]; each (T, 3)."""
        rate = (-1.0 if self.clockwise else 1.0) * self.speed_m_s / self.radius_m
        angle = math.radians(self.phase_deg) + rate * np.asarray(time_s)
        outwards = np.stack((np.cos(angle), np.sin(angle), np.zeros_like(angle)), axis=1)
        along = np.stack((-outwards[:, 1], outwards[:, 0], outwards[:, 2]), axis=1)
        return np.array(self.centre_enu_m) + self.radius_m * outwards, rate * self.radius_m * along


@dataclass(frozen=True)
class FigureEight:
    """A level lemniscate of Gerono, without beginning or end; its crossing is passed at time 0, and fastest.

    With ``q = w t``: ``x = L/2 sin q`` along its length L, and ``y = L/2 sin q cos q`` to the left of that. The speed
    is ``L w / 2 sqrt(cos^2 q + cos^2 2q)``, at most ``L w / sqrt(2)``.
    """

    centre_enu_m: Point
    length_m: float  # from one end to the other, above 0; it is half as wide
    top_speed_m_s: float  # in the crossing, 0 or more
    heading_deg: float = 90.0  # of its length, clockwise from north

    @property
    def box_enu_m(self) -> Array:
        """Corners of its box, shape (2, 3) [m; ENU]: exact for every heading."""
        east, north = abs(math.sin(math.radians(self.heading_deg))), abs(math.cos(math.radians(self.heading_deg)))
        return _box(self.centre_enu_m, [self._reach(east, north), self._reach(north, east), 0.0])

    def _reach(self, along: float, across: float) -> float:
        """The largest of ``L/2 sin q (a + b cos q)``, where ``a cos q + b (2 cos^2 q - 1)`` vanishes; a, b >= 0."""
        cosine = 2.0 * across / (along + math.sqrt(along * along + 8.0 * across * across))
        return 0.5 * self.length_m * math.sqrt(1.0 - cosine * cosine) * (along + across * cosine)

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Return position [m; ENU] and velocity [m/s; ENU] at times, shape (T,) [s]; each (T, 3)."""
        half_m = 0.5 * self.length_m
        rate = self.top_speed_m_s / (math.sqrt(2.0) * half_m)
        angle = rate * np.asarray(time_s)
        heading = math.radians(self.heading_deg)
        axes = np.array(
            [[math.sin(heading), math.cos(heading), 0.0], [-math.cos(heading), math.sin(heading), 0.0]]
        )  # its length, and what is left of it
        place = half_m * np.stack((np.sin(angle), 0.5 * np.sin(2.0 * angle)), axis=1)
        velocity = half_m * rate * np.stack((np.cos(angle), np.cos(2.0 * angle)), axis=1)
        return np.array(self.centre_enu_m) + place @ axes, velocity @ axes


@dataclass(frozen=True)
class Pieces:
    """Motion with one acceleration after the other: position and velocity are continuous.

    Before the first piece it rests in its place; the last piece never ends.
    """

    start_s: Array  # (P,) when each piece begins, ascending [s]
    position_m: Array  # (P, 3) there [m; ENU]
    velocity_m_s: Array  # (P, 3) there [m/s; ENU]
    acceleration_m_s2: Array  # (P, 3) in it [m/s^2; ENU]

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Return position [m; ENU] and velocity [m/s; ENU] at times, shape (T,) [s]; each (T, 3)."""
        time_s = np.asarray(time_s, dtype=float)
        index = np.maximum(np.searchsorted(self.start_s, time_s, side="right") - 1, 0)
        moving = (time_s >= self.start_s[0])[:, None]
        passed = np.maximum(time_s - self.start_s[index], 0.0)[:, None]
        acceleration = self.acceleration_m_s2[index]
        velocity = np.where(moving, self.velocity_m_s[index] + passed * acceleration, 0.0)
        position = self.position_m[index] + passed * (self.velocity_m_s[index] + 0.5 * passed * acceleration)
        return position, velocity


def _box(centre_enu_m: Point, reach_m: list[float]) -> Array:
    """Return the corners of a box from its centre and half its extents."""
    corners: Array = np.array(centre_enu_m) + np.outer([-1.0, 1.0], reach_m)
    return corners
