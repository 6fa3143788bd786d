"""The path parameter over time, with continuous acceleration.

A time-optimal timing steps from one path acceleration to the next. Averaging its parameter over a window of time,

    s~(t) = 1/w integral of s over [t - w, t],

keeps the path, leaves speeds within the range they had, and makes the acceleration continuous: its derivative is a
difference of path accelerations over the window, at most ``2 a / w``. The flight becomes longer by the window and no
more. As ``s`` is a quadratic in time within each cell, everything here is exact.

Before its start the timing goes on backwards at its first speed, after its end forwards at its last one. At a constant
speed ``v`` the average lags by ``v w / 2``. So the profile starts that much before the timing's first place and ends
that much after its last one, at those speeds and without acceleration; between rests these are the same places.
"""

from __future__ import annotations

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.plan.timing.time_optimal import Timing

HALVINGS = 50  # of the duration, when a moment is searched for: past the last digit


class Profile:
    """A timing, averaged over a window and run slower by a factor."""

    def __init__(self, timing: Timing, window_s: float, stretch: float = 1.0) -> None:
        """Take a timing, the window, >= 0 [s], and how many times slower to run, >= 1."""
        self._timing = timing
        self._window_s = window_s
        self._stretch = stretch
        self._cells = _cells(*timing)
        self._quickest_s = float(timing.time_s[-1] + window_s)
        self.duration_s = self._quickest_s * stretch

    def instants(self, rate_hz: float) -> Array:
        """Return instants of the whole profile, ascending: evenly spaced ones, and those where the jerk steps [s].

        Run slower, the profile has them at the same places of the path.
        """
        even = max(2, int(np.ceil(self._quickest_s * rate_hz)) + 1)
        return _instants(self._timing.time_s, self._window_s, self._quickest_s, even, self._stretch)

    def slower(self, factor: float) -> Profile:
        """Return the same profile, run ``factor`` times slower; the speeds at its ends fall by the factor too."""
        return Profile(self._timing, self._window_s, self._stretch * factor)

    def at(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Return parameter [m], path speed [m/s] and path acceleration [m/s^2] at ``time_s``, each of shape (T,).

        Before the start and after the end the parameter stays at that end; speed and acceleration are those of the end.
        """
        times = np.asarray(time_s, dtype=float)
        return _averaged(times, self._stretch, self._window_s, self._quickest_s, *self._cells)

    def when(self, s_m: float) -> float:
        """Return the first time at which the parameter reaches ``s_m``, one of the profile's own [s]."""
        return float(_moment(s_m, self._window_s, self._quickest_s, *self._cells) * self._stretch)


@kernel
def _cells(s_m: Array, speed: Array, time: Array) -> tuple[Array, Array]:
    """Starts of the timing's cells, (S,), and what the parameter does from each on, (S, 4).

    The four are acceleration, speed, parameter, and the parameter's integral from the timing's start on; the last row
    goes on after the end.
    """
    last = len(time) - 1
    cells = np.zeros((last + 1, 4))
    for i in range(last + 1):
        cells[i, 1], cells[i, 2] = speed[i], s_m[i]
        if i < last:
            span = time[i + 1] - time[i]
            a = (speed[i + 1] - speed[i]) / span if span > 0.0 else 0.0
            cells[i, 0] = a
            cells[i + 1, 3] = cells[i, 3] + (s_m[i] + (speed[i] / 2.0 + a * span / 6.0) * span) * span
    return time, cells


@kernel
def _averaged(
    times: Array, stretch: float, window: float, quickest: float, starts: Array, cells: Array
) -> tuple[Array, Array, Array]:
    count, last = len(times), len(starts) - 1
    s, rate, s_ddot = np.empty(count), np.empty(count), np.empty(count)
    low = cells[0, 2] - 0.5 * window * cells[0, 1]
    high = cells[last, 2] + 0.5 * window * cells[last, 1]
    head, tail = 0, 0  # cells where the window ends and begins; times mostly ascend, so both are near the last ones
    for i in range(count):
        time = min(max(times[i] / stretch, 0.0), quickest)
        head = _cell(starts, time, head)
        area, here, fast, gains = _base(starts, cells, head, time)
        if window > 0.0:
            tail = _cell(starts, time - window, tail)
            area0, here0, fast0, _ = _base(starts, cells, tail, time - window)
            area, here, fast = area - area0, here - here0, fast - fast0
            here, fast, gains = area / window, here / window, fast / window
        s[i] = min(max(here, low), high)  # rounding must not leave the path
        rate[i], s_ddot[i] = fast / stretch, gains / (stretch * stretch)
    return s, rate, s_ddot


@kernel
def _cell(starts: Array, time: float, near: int) -> int:
    """The cell that a time lies in, searched for from another one on; the first one has no start, the last no end."""
    while near < len(starts) - 1 and time >= starts[near + 1]:
        near += 1
    while near > 0 and time < starts[near]:
        near -= 1
    return near


@kernel
def _base(starts: Array, cells: Array, cell: int, time: float) -> tuple[float, float, float, float]:
    """Integral of the parameter, parameter, speed and acceleration of the timing itself."""
    t, v, s = time - starts[cell], cells[cell, 1], cells[cell, 2]
    a = cells[cell, 0] if t >= 0.0 else 0.0  # before the start the speed is constant
    return cells[cell, 3] + (s + (v / 2.0 + a * t / 6.0) * t) * t, s + (v + 0.5 * a * t) * t, v + a * t, a


@kernel
def _moment(s: float, window: float, quickest: float, starts: Array, cells: Array) -> float:
    """The first time, unstretched, at which the averaged parameter is ``s`` or more; the parameter never falls."""
    low, high = 0.0, quickest
    middle = np.empty(1)
    for _ in range(HALVINGS):
        middle[0] = 0.5 * (low + high)
        if _averaged(middle, 1.0, window, quickest, starts, cells)[0][0] >= s:
            high = middle[0]
        else:
            low = middle[0]
    return high


@kernel
def _instants(knots: Array, window: float, quickest: float, even: int, stretch: float) -> Array:
    """Merge three ascending rows without repeats: ``even`` evenly spaced times, the knots, and those a window later."""
    count = len(knots)
    merged = np.empty(even + 2 * count)
    step = quickest / (even - 1)
    i, j, k, found = 0, 0, 0, 0
    while i < even or k < count:  # the second row ends before the third
        first = (i * step if i < even - 1 else quickest) if i < even else np.inf
        second = knots[j] if j < count else np.inf
        third = knots[k] + window if k < count else np.inf
        time = min(first, second, third)
        i, j, k = i + (first == time), j + (second == time), k + (third == time)
        if found == 0 or time * stretch > merged[found - 1]:
            merged[found] = time * stretch
            found += 1
    return merged[:found].copy()
