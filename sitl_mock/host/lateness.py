"""How late ticks are, kept in the memory of a few numbers however long the simulator runs."""

from __future__ import annotations

import math
from collections import Counter

BIN_S = 1e-4


class Lateness:
    """The lateness of all ticks so far, to a tenth of a millisecond.

    Attributes:
        ticks: how many there should have been.
        left_out: how many of them never came, because one before took too long.
        worst_s: the latest one [s].
    """

    def __init__(self) -> None:
        self.ticks = 0
        self.left_out = 0
        self.worst_s = 0.0
        self._bins: Counter[int] = Counter()

    def add(self, late_s: float, left_out: int, tick_s: float) -> None:
        """Count a tick, and those before it that were left out: each of them is late by a whole tick.

        Args:
            late_s: how late the tick begins [s].
            left_out: how many there should have been since the one before.
            tick_s: time from tick to tick [s].
        """
        self._bins[math.ceil(late_s / BIN_S)] += 1
        self.worst_s = max(self.worst_s, late_s)
        self.ticks += 1 + left_out
        if left_out > 0:
            self.left_out += left_out
            self._bins[math.ceil(tick_s / BIN_S)] += left_out
            self.worst_s = max(self.worst_s, tick_s)

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
