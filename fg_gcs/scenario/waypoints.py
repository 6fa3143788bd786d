"""A target that goes from point to point."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.scenario.motions import Pieces, Point


class Waypoints:
    """Straight from point to point at one speed, with rounded corners.

    At a corner the velocity turns from one leg's into the next one's at the given acceleration, half before and half
    after the moment at which the corner would be passed: the target passes it on the inside and loses no time. It
    starts from rest in the first point and comes to rest in the last; a closed course it goes round and round, and is
    in the middle of the first corner at time 0.

    Args:
        points_enu_m: two or more, three or more if closed, [m; ENU]; neighbours differ.
        speed_m_s: on the legs, above 0 [m/s].
        acceleration_m_s2: at the start, in the corners and at the end, above 0 [m/s^2].
        closed: go on from the last point to the first.

    Raises:
        ValueError: too few points, two neighbours in one place, or a leg too short for the turns at its ends.
    """

    def __init__(
        self, points_enu_m: Sequence[Point], speed_m_s: float, acceleration_m_s2: float, closed: bool = False
    ) -> None:
        points = np.array(points_enu_m, dtype=float).reshape(-1, 3)
        if len(points) < (3 if closed else 2):
            raise ValueError(f"got {len(points)} points; accepted: {'3 or more if closed' if closed else '2 or more'}")
        self._points = points
        self.top_speed_m_s = speed_m_s
        self._acceleration_m_s2 = acceleration_m_s2
        self._closed = closed
        ends = np.roll(points, -1, axis=0) if closed else points[1:]
        legs = ends - points[: len(ends)]  # (L, 3)
        lengths = np.linalg.norm(legs, axis=1)
        if not lengths.min() > 0.0:
            raise ValueError(
                f"point {int(lengths.argmin()) + 1} and the next are equal; accepted: points apart from each other"
            )
        self._velocities = speed_m_s * legs / lengths[:, None]  # (L, 3)
        self._legs_s = lengths / speed_m_s  # (L,)
        before, after = self._around()
        self._turns_s = np.linalg.norm(after - before, axis=1) / acceleration_m_s2  # (L,) if closed, else (L + 1,)
        following = np.roll(self._turns_s, -1)[: len(legs)]
        short_s = 0.5 * (self._turns_s[: len(legs)] + following) - self._legs_s
        if short_s.max() > 0.0:
            leg = int(short_s.argmax())
            needed_m = speed_m_s * (self._legs_s[leg] + short_s[leg])
            raise ValueError(
                f"the leg from point {leg + 1} is {lengths[leg]:.2f} m long; accepted: {needed_m:.2f} m or more for "
                "the turns at its ends, a lower speed_m_s or a higher acceleration_m_s2"
            )

    @property
    def box_enu_m(self) -> Array:
        """Corners of the points' box, shape (2, 3) [m; ENU]: corners are passed inside."""
        return np.array([self._points.min(axis=0), self._points.max(axis=0)])

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Return position [m; ENU] and velocity [m/s; ENU] at times, shape (T,) [s]; each (T, 3)."""
        time_s = np.asarray(time_s, dtype=float)
        if self._closed:
            time_s = self._turns_s[0] / 2.0 + np.mod(time_s, self._legs_s.sum())
        return self._pieces.at(time_s)

    def _around(self) -> tuple[Array, Array]:
        """Velocities before and after every corner; a start and an end are corners, too."""
        if self._closed:
            return np.roll(self._velocities, 1, axis=0), self._velocities
        rest = np.zeros((1, 3))
        return np.concatenate((rest, self._velocities)), np.concatenate((self._velocities, rest))

    @cached_property
    def _pieces(self) -> Pieces:
        """A turn and a straight piece for every corner; time 0 is where the first turn begins.

        On a closed course the first corner is turned once more at the end, so that a whole round can be asked for.
        """
        before, after = self._around()
        corners, turns_s = self._points, self._turns_s
        if self._closed:
            before, after = np.concatenate((before, before[:1])), np.concatenate((after, after[:1]))
            corners, turns_s = np.concatenate((corners, corners[:1])), np.append(turns_s, turns_s[0])
        passed_s = turns_s[0] / 2.0 + np.concatenate(([0.0], np.cumsum(self._legs_s)))
        turns, straights = turns_s[:, None] / 2.0, np.zeros_like(corners)
        # Half a turn before the corner on the leg that ends there, half a turn after it on the one that begins there
        begins, ends = corners - turns * before, corners + turns * after
        start_s = np.stack((passed_s - turns_s / 2.0, passed_s + turns_s / 2.0), axis=1)
        sharp = turns_s[:, None] == 0.0  # straight through: there is nothing to turn
        acceleration = np.where(sharp, 0.0, (after - before) / np.where(sharp, 1.0, turns_s[:, None]))
        return Pieces(
            start_s.reshape(-1),
            np.stack((begins, ends), axis=1).reshape(-1, 3),
            np.stack((before, after), axis=1).reshape(-1, 3),
            np.stack((acceleration, straights), axis=1).reshape(-1, 3),
        )
