"""Planning on the streamer's own loop without delaying it: step by step, in the gaps between setpoints."""

from __future__ import annotations

import asyncio
from array import array
from collections import deque
from collections.abc import Callable, Iterator
from statistics import median

from fg_gcs.flight.streamer import Streamer
from fg_gcs.track.follow.replanner import Replan

FIRST_USUAL_S = 0.002  # that a step takes, until it is known
REMEMBERED = 60  # durations of steps: some twenty plans, or two seconds of ten sightings a second
SPARE = 2.0  # times the usual duration of a step is what the next one may take
MOST_DURATIONS = 65_536  # kept of plans: of flights up to an hour and three quarters, at ten a second, all
LATE_S = 0.06  # a plan from where the formation was so long ago is a step of centimetres by now


class Durations:
    """How long plans took, in memory that does not grow with the flight.

    The first `most` are all kept. When there are more, every second one is let go and from then on only every second
    is taken, then every fourth, and so on: what is kept lies evenly over the whole flight, between `most` / 2 and
    `most` of them, so that medians and percentiles are those of a fair sample.

    Attributes:
        count: of all, kept or not.
    """

    def __init__(self, most: int = MOST_DURATIONS) -> None:
        """Keep at most an even number of them."""
        self.count = 0
        self._most = most
        self._stride = 1
        self._kept = array("d")

    def add(self, duration_s: float) -> None:
        """Take one more [s]."""
        if self.count % self._stride == 0:
            if len(self._kept) == self._most:
                del self._kept[1::2]
                self._stride *= 2
            self._kept.append(duration_s)
        self.count += 1

    @property
    def kept_s(self) -> tuple[float, ...]:
        """Those that are kept, in their order [s]."""
        return tuple(self._kept)


class Planning:
    """Runs plans to their end, or gives them up.

    Attributes:
        late: plans that took longer than :data:`LATE_S` and were given up.
    """

    def __init__(self, streamer: Streamer) -> None:
        """Give way to a streamer's setpoints."""
        self.late = 0
        self._streamer = streamer
        self._usual_s = deque([FIRST_USUAL_S], maxlen=REMEMBERED)

    async def gap(self) -> None:
        """Wait until the next step fits in before the next setpoints."""
        if self._streamer.due_s - asyncio.get_running_loop().time() < SPARE * median(self._usual_s):
            await self._streamer.quiet_moment()

    async def result(self, steps: Iterator[Replan | None], is_over: Callable[[], bool]) -> Replan | None:
        """Return what steps lead to; None if there are no steps, if it is over, or if it comes too late.

        Args:
            steps: None after each that led to nothing yet, see :meth:`.FollowingCore.replanning`.
            is_over: says whether the plan is no longer wanted.
        """
        time = asyncio.get_running_loop().time
        began_s = begun_s = time()
        for replan in steps:
            self._usual_s.append(time() - begun_s)
            if replan is not None:
                return replan
            await self.gap()
            begun_s = time()
            if is_over():
                return None
            if begun_s - began_s > LATE_S:
                self.late += 1
                return None
        return None
