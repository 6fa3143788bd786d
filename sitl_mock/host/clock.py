"""Simulated time: it goes with an event loop's, many times as fast, as fast as it is computed, or not at all."""

from __future__ import annotations

import math
from collections.abc import Callable


class SimulatedClock:
    """Simulated time, from 0 on.

    Args:
        loop_time: of the event loop [s].
        speed: simulated seconds per second of the loop; infinity: as fast as `move` is called.
        paused: time stands still until `run`.

    Attributes:
        speed: as given.
        slipped_s: simulated time that never happened, because stalls were too long to make up.
    """

    def __init__(self, loop_time: Callable[[], float], speed: float, paused: bool) -> None:
        self.speed = speed
        self.slipped_s = 0.0
        self._loop_time = loop_time
        self._paused = paused
        self._since_s = loop_time()  # of the loop
        self._then_s = 0.0  # simulated, at that time

    @property
    def goes(self) -> bool:
        """Whether time goes by itself."""
        return not self._paused and math.isfinite(self.speed)

    @property
    def paused(self) -> bool:
        """Whether time stands still."""
        return self._paused

    def now_s(self) -> float:
        """Simulated time [s]."""
        return self._then_s + (self._loop_time() - self._since_s) * self.speed if self.goes else self._then_s

    def loop_s(self, time_s: float) -> float:
        """When the loop's time comes to a simulated one, if time goes by itself [s]."""
        return self._since_s + (time_s - self._then_s) / self.speed

    def slip(self, seconds: float) -> None:
        """Leave simulated time out."""
        self._then_s -= seconds
        self.slipped_s += seconds

    def move(self, seconds: float) -> None:
        """Let time go on, while it does not by itself."""
        self._then_s += seconds

    def pause(self) -> None:
        """Let time stand still."""
        self._then_s = self.now_s()
        self._paused = True

    def run(self) -> None:
        """Let time go."""
        if self._paused:
            self._since_s = self._loop_time()
            self._paused = False
