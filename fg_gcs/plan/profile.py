"""The path parameter over time, with continuous acceleration.

A time-optimal timing steps from one path acceleration to the next. Averaging its parameter over a window of time,

    s~(t) = 1/w integral of s over [t - w, t],

keeps the path, leaves speeds within the range they had, and makes the acceleration continuous: its growth is a
difference of path accelerations over the window, at most ``2 a / w``. The flight becomes longer by the window and no
more. As ``s`` is a quadratic in time within each cell, everything here is exact.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fg_gcs.plan.timing import Timing

Array = NDArray[np.float64]


class Profile:
    """A timing, averaged over a window and run slower by a factor."""

    def __init__(self, timing: Timing, window_s: float, stretch: float = 1.0) -> None:
        """Take a timing from rest to rest, the window, >= 0 [s], and how many times slower to run, >= 1."""
        self._timing = timing
        self._window_s = window_s
        self._stretch = stretch
        spans = np.diff(timing.time_s)
        growths = np.diff(timing.speed) / np.maximum(spans, np.finfo(float).tiny)
        cells = ((growths * spans / 6.0 + timing.speed[:-1] / 2.0) * spans + timing.s_m[:-1]) * spans
        self._growths = growths
        self._areas = np.concatenate(([0.0], np.cumsum(cells)))  # integral of s up to each grid point
        self._quickest_s = float(timing.time_s[-1] + window_s)
        self.duration_s = self._quickest_s * stretch

    def instants(self, rate_hz: float) -> Array:
        """Return instants of the whole profile, ascending: evenly spaced ones, and those where the jerk steps [s].

        Run slower, the profile has them at the same places of the path.
        """
        even = np.linspace(0.0, self._quickest_s, max(2, int(np.ceil(self._quickest_s * rate_hz)) + 1))
        knots = self._timing.time_s
        return np.unique(np.concatenate((even, knots, knots + self._window_s))) * self._stretch

    def slower(self, factor: float) -> Profile:
        """Return the same profile, run ``factor`` times slower."""
        return Profile(self._timing, self._window_s, self._stretch * factor)

    def at(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Return parameter [m], path speed [m/s] and path acceleration [m/s^2] at ``time_s``, each of shape (T,)."""
        grid, speed, knots = self._timing
        own_s = np.asarray(time_s, dtype=float) / self._stretch
        s_m, rate, growth = _averaged(own_s, self._window_s, grid, speed, knots, self._growths, self._areas)
        return s_m, rate / self._stretch, growth / self._stretch**2


@njit(cache=True)
def _averaged(
    times: Array, window: float, grid: Array, speed: Array, knots: Array, growths: Array, areas: Array
) -> tuple[Array, Array, Array]:
    count = len(times)
    s, rate, growth = np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        area, here, fast, gains = _base(times[i], grid, speed, knots, growths, areas)
        if window > 0.0:
            area0, here0, fast0, _ = _base(times[i] - window, grid, speed, knots, growths, areas)
            s[i], rate[i], growth[i] = (area - area0) / window, (here - here0) / window, (fast - fast0) / window
        else:
            s[i], rate[i], growth[i] = here, fast, gains
        s[i] = min(max(s[i], 0.0), grid[-1])  # rounding must not leave the path
    return s, rate, growth


@njit(cache=True)
def _base(
    time: float, grid: Array, speed: Array, knots: Array, growths: Array, areas: Array
) -> tuple[float, float, float, float]:
    """Integral of the parameter, parameter, speed and acceleration of the timing itself; at rest outside it."""
    last = len(knots) - 1
    if time <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    if time >= knots[last]:
        return areas[last] + grid[last] * (time - knots[last]), grid[last], 0.0, 0.0
    cell = min(max(int(np.searchsorted(knots, time, side="right")) - 1, 0), last - 1)
    t, v, a = time - knots[cell], speed[cell], growths[cell]
    area = areas[cell] + (grid[cell] + (v / 2.0 + a * t / 6.0) * t) * t
    return area, grid[cell] + (v + 0.5 * a * t) * t, v + a * t, a
