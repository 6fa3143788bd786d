"""A target that moves as a file says."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from fg_gcs.core.arrays import Array


class Recorded:
    """Through points at their times, with a continuous velocity and no overshoot; at rest before and after them.

    Between two points every coordinate is monotone: Fritsch and Carlson's slopes in between, and none at the ends.

    Args:
        time_s: one or more, ascending, shape (N,) [s].
        position_enu_m: where the target is then, shape (N, 3) [m; ENU].

    Raises:
        ValueError: no points, shapes that do not match, or times that do not ascend.
    """

    def __init__(self, time_s: Array, position_enu_m: Array) -> None:
        times, positions = np.array(time_s, dtype=float), np.array(position_enu_m, dtype=float)
        if times.ndim != 1 or len(times) == 0 or positions.shape != (len(times), 3):
            raise ValueError("times and positions do not match; accepted: one position for each time, and at least one")
        if not (np.diff(times) > 0.0).all():
            raise ValueError("the times do not ascend; accepted: each time_s above the one before")
        self._times, self._positions = times, positions
        slopes = np.zeros_like(positions)
        if len(times) > 2:
            slopes[1:-1] = PchipInterpolator(times, positions).derivative()(times[1:-1])
        self._slopes = slopes
        self._curve = CubicHermiteSpline(times, positions, slopes) if len(times) > 1 else None

    @property
    def box_enu_m(self) -> Array:
        """Corners of the points' box, shape (2, 3) [m; ENU]."""
        return np.array([self._positions.min(axis=0), self._positions.max(axis=0)])

    @property
    def top_speed_m_s(self) -> float:
        """A bound of the speed [m/s].

        The velocity between two points is a quadratic, inside the triangle of its control points: its two ends and
        ``3 d - s0 - s1``, d being the mean velocity and s0 and s1 those at the ends.
        """
        if len(self._times) == 1:
            return 0.0
        mean = np.diff(self._positions, axis=0) / np.diff(self._times)[:, None]
        between = 3.0 * mean - self._slopes[:-1] - self._slopes[1:]
        return float(np.linalg.norm(np.concatenate((self._slopes, between)), axis=1).max())

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Return position [m; ENU] and velocity [m/s; ENU] at times, shape (T,) [s]; each (T, 3)."""
        if self._curve is None:
            return np.tile(self._positions[0], (len(time_s), 1)), np.zeros((len(time_s), 3))
        clipped = np.clip(time_s, self._times[0], self._times[-1])
        return self._curve(clipped), self._curve(clipped, 1)  # at both ends the velocity is zero
