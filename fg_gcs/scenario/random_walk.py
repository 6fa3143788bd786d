"""A target that dodges at random."""

from __future__ import annotations

import math

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.scenario.motions import Pieces, Point

STEP_S = 1.0  # how long an acceleration lasts: long enough to be seen by a sensor at 10 Hz, short enough to surprise
TRIES = 16  # draws before it brakes: near a corner of the box some one in eight fits
BLOCK = 64  # steps worked out at a time
SLACK = 1.0 + 1e-9  # rounding must not cost a whole further braking step


class RandomWalk:
    """From rest, an acceleration drawn anew every second; speed and place stay in bounds.

    Every draw is checked before it is taken: the speed must stay allowed, and the target must still be able to stop
    inside the box, by braking along its velocity in whole steps. Where no draw will do it brakes. A step at a constant
    acceleration lies in the triangle of its ends and of the point half a step ahead, so that the box, being convex,
    holds all of it. The path depends on the arguments alone, not on the times that are asked for.

    Args:
        low_enu_m: a corner of the box [m; ENU]; an axis along which the box has no extent is not moved along.
        high_enu_m: the opposite corner [m; ENU].
        speed_m_s: norm of the velocity, at most, above 0 [m/s].
        acceleration_m_s2: norm of the acceleration, at most, above 0 [m/s^2].
        seed: of the draws.
        start_enu_m: where it begins; without it in the middle of the box.

    Raises:
        ValueError: the corners are no box, or the start is outside.
    """

    def __init__(
        self,
        low_enu_m: Point,
        high_enu_m: Point,
        speed_m_s: float,
        acceleration_m_s2: float,
        seed: int,
        start_enu_m: Point | None = None,
    ) -> None:
        self.box_enu_m = np.array([low_enu_m, high_enu_m], dtype=float)
        self.box_enu_m.setflags(write=False)
        if (self.box_enu_m[0] > self.box_enu_m[1]).any():
            raise ValueError("high_enu_m lies below low_enu_m; accepted: each number at least that of low_enu_m")
        start = self.box_enu_m.mean(axis=0) if start_enu_m is None else np.array(start_enu_m, dtype=float)
        if not self._inside(start):
            raise ValueError("start_enu_m lies outside the box; accepted: a point inside")
        self.top_speed_m_s = speed_m_s
        self._acceleration_m_s2 = acceleration_m_s2
        # Along a flat side of the box hardly any full draw would fit: draws are flat as well
        extent = self.box_enu_m[1] - self.box_enu_m[0]
        self._stretch = np.minimum(1.0, extent / (2.0 * acceleration_m_s2 * STEP_S**2))
        self._random = np.random.default_rng(seed)
        self._states = [(start, np.zeros(3))]  # at the beginning of every step, and of the next one
        self._accelerations: list[Array] = []
        self._pieces: Pieces | None = None

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Return position [m; ENU] and velocity [m/s; ENU] at times, shape (T,) [s]; each (T, 3)."""
        latest_s = max(float(np.max(time_s, initial=0.0)), 0.0)
        steps = BLOCK * math.ceil((latest_s / STEP_S + 1.0) / BLOCK)
        if self._pieces is None or len(self._accelerations) < steps:
            self._pieces = self._walked(steps)
        return self._pieces.at(time_s)

    def _walked(self, steps: int) -> Pieces:
        while len(self._accelerations) < steps:
            position, velocity = self._states[-1]
            acceleration = self._chosen(position, velocity)
            self._accelerations.append(acceleration)
            self._states.append(_after(position, velocity, acceleration))
        positions, velocities = (np.array(each) for each in zip(*self._states[:-1], strict=True))
        return Pieces(STEP_S * np.arange(float(len(positions))), positions, velocities, np.array(self._accelerations))

    def _chosen(self, position: Array, velocity: Array) -> Array:
        """Draw an acceleration that leaves every bound in reach, or brake."""
        for _ in range(TRIES):
            direction = self._random.standard_normal(3)
            length = self._acceleration_m_s2 * self._random.random() ** (1.0 / 3.0)  # evenly in the ball
            acceleration: Array = self._stretch * length * direction / np.linalg.norm(direction)
            place, speed = _after(position, velocity, acceleration)
            if (
                np.linalg.norm(speed) <= self.top_speed_m_s
                and self._inside(place)
                and self._inside(place + 0.5 * self._braking(speed) * STEP_S * speed)
            ):
                return acceleration
        return -velocity / (max(self._braking(velocity), 1) * STEP_S)

    def _braking(self, velocity: Array) -> int:
        """How many steps it takes to stop; slowing down evenly over them it goes half as far as it would go on."""
        return math.ceil(float(np.linalg.norm(velocity)) / (self._acceleration_m_s2 * STEP_S * SLACK))

    def _inside(self, place: Array) -> bool:
        return bool(((self.box_enu_m[0] <= place) & (place <= self.box_enu_m[1])).all())


def _after(position: Array, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
    return position + STEP_S * (velocity + 0.5 * STEP_S * acceleration), velocity + STEP_S * acceleration
