"""How late ticks are, kept in the memory of a few numbers however long the simulator runs."""

from __future__ import annotations

import math
from collections import Counter

BIN_S = 1e-4


class Lateness:
    """The lateness of all ticks so far, to a tenth of a millisecond.

    Attributes:
        ticks: how many there should have been.
        left_out: how many of them never came, because the one before took too long.
        worst_s: the latest one [s].
    """

    def __init__(self) -> None:
        self.ticks = 0
        self.left_out = 0
        self.worst_s = 0.0
        self._bins: Counter[int] = Counter()

    def add(self, late_s: float, left_out: int, tick_s: float) -> None:
        """Count a tick, and those behind it that are left out: what they had to do waits for the one after them.

        Args:
            late_s: how late the tick begins [s].
            left_out: how many ticks are past when it has ended; the last of them is late by a whole tick, and so on.
            tick_s: time from tick to tick [s].
        """
        self.ticks += 1 + left_out
        self.left_out += left_out
        for each_s in (late_s, *(k * tick_s for k in range(1, left_out + 1))):
            self._bins[math.ceil(each_s / BIN_S)] += 1
            self.worst_s = max(self.worst_s, each_s)

    def percentile_s(self, percent: float) -> float:
        """The lateness that so many ticks of a hundred do not exceed [s]; 0 before the first tick."""
        wanted, seen = 0.01 * percent * self.ticks, 0
        for number in sorted(self._bins):
            seen += self._bins[number]
            if seen >= wanted:
                return number * BIN_S
        return 0.0

    def figures(self) -> dict[str, float]:
        """What there is to say of it, by names with units."""
        return {
            "ticks": self.ticks,
            "left_out": self.left_out,
            "late_p99_ms": 1e3 * self.percentile_s(99.0),
            "late_worst_ms": 1e3 * self.worst_s,
        }
