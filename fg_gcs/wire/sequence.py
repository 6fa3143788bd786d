"""Sequence numbers of one sender's frames: how many were lost, and whether two senders speak under one id.

MAVLink numbers the frames of each link 0 to 255, around and around. What comes late or twice is not lost; a number that
comes a second time within one round, in a frame of other content, was given by somebody else.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

ROUND: Final = 256
WINDOW_S: Final = 5.0  # losses are those of so long: a hundred frames of a slow telemetry
STEP_S: Final = 0.5  # counts are put away this often at most
LOST_TRACK: Final = 48  # frames of silence after which a step of the numbers no longer says how many were lost
LEAST_GAP_S: Final = 0.1
MOST_GAP_S: Final = 5.0
RUN: Final = 16  # frames in a row that go on from one another, all behind the newest: the sender has begun anew
MOST_RESTARTS: Final = 2  # within the window: one vehicle does not restart more often
LEAST_CONFLICTS: Final = 8  # within the window, and as a share of the frames: a few may be very late doubles
CONFLICTS_SHARE: Final = 0.1


class _Counts(NamedTuple):
    """What came in a step of the window."""

    at_s: float
    received: float
    expected: float
    conflicts: float
    restarts: float


class SequenceCounter:
    """Counts one sender's frames; knows no clock."""

    def __init__(self) -> None:
        self._tails: list[bytes | None] = [None] * ROUND  # checksums of those that came in the latest round
        self._newest = -1  # number of the newest frame, -1 before the first
        self._previous = -1  # of the frame before this one, in order of arrival
        self._run = 0
        self._at_s = 0.0
        self._gap_s = MOST_GAP_S
        self._interval_s = MOST_GAP_S  # from one frame to the next
        self._received = self._expected = 0.0
        self._conflicts = self._restarts = 0.0
        self._window: deque[_Counts] = deque()
        self._total = _Counts(0.0, 0.0, 0.0, 0.0, 0.0)  # of the window

    def add(self, sequence: int, tail: bytes, now_s: float) -> None:
        """Count a frame.

        Args:
            sequence: Its number, 0 to 255.
            tail: Its last two bytes, which tell it from others.
            now_s: Loop time [s].
        """
        if sequence == (self._newest + 1) & 0xFF and now_s - self._at_s < self._gap_s and self._newest >= 0:
            self._expected += 1
            self._run = 0
        elif not self._out_of_order(sequence, tail, now_s):
            return
        self._newest = self._previous = sequence
        self._tails[sequence] = tail
        self._received += 1
        self._at_s = now_s

    def roll(self, now_s: float) -> None:
        """Let the window go on: call it about every `STEP_S`."""
        window, latest = self._window, _Counts(now_s, self._received, self._expected, self._conflicts, self._restarts)
        self._received = self._expected = 0.0
        self._conflicts = self._restarts = 0.0
        window.append(latest)
        _, received, expected, conflicts, restarts = self._total
        received, expected = received + latest.received, expected + latest.expected
        conflicts, restarts = conflicts + latest.conflicts, restarts + latest.restarts
        while window[0].at_s < now_s - WINDOW_S:
            gone = window.popleft()
            received, expected = received - gone.received, expected - gone.expected
            conflicts, restarts = conflicts - gone.conflicts, restarts - gone.restarts
        self._total = _Counts(now_s, received, expected, conflicts, restarts)
        if received > 1.0 and latest.received:
            self._interval_s = min(WINDOW_S, len(window) * STEP_S) / received
            self._gap_s = min(max(LOST_TRACK * self._interval_s, LEAST_GAP_S), MOST_GAP_S)

    @property
    def loss(self) -> float:
        """Share of the frames of the last `WINDOW_S` that did not come, 0 to 1; NaN while there are none."""
        received, expected = self._received + self._total.received, self._expected + self._total.expected
        return math.nan if expected < 0.5 else min(max(1.0 - received / expected, 0.0), 1.0)

    @property
    def interleaved(self) -> bool:
        """Two senders have numbered the frames of the last `WINDOW_S`."""
        conflicts, restarts = self._conflicts + self._total.conflicts, self._restarts + self._total.restarts
        share = CONFLICTS_SHARE * (self._received + self._total.received + conflicts)
        return restarts > MOST_RESTARTS or conflicts >= max(LEAST_CONFLICTS, share)

    def _out_of_order(self, sequence: int, tail: bytes, now_s: float) -> bool:
        """Take a frame that is not the next one; tell whether it is the newest now."""
        if self._newest < 0 or now_s - self._at_s >= self._gap_s:
            if self._newest >= 0:  # nobody knows how many rounds were lost: so many as came in that time before
                self._expected += max((now_s - self._at_s) / self._interval_s - 1.0, 0.0)
            self._begin()
            self._expected += 1
            return True
        step = (sequence - self._newest) & 0xFF
        if 0 < step < ROUND // 2:
            for skipped in range(self._newest + 1, self._newest + step):
                self._tails[skipped & 0xFF] = None
            self._expected += step
            self._run = 0
            return True
        self._run = self._run + 1 if (sequence - self._previous) & 0xFF in (1, 2, 3) else 0
        self._previous = sequence
        if self._run >= RUN:
            self._begin()
            self._restarts += 1
            self._expected += 1
            return True
        before = self._tails[sequence]
        if before is None:  # late, not lost
            self._received += 1
            self._tails[sequence] = tail
        elif before != tail:  # otherwise it came twice
            self._conflicts += 1
        self._at_s = now_s
        return False

    def _begin(self) -> None:
        self._tails = [None] * ROUND
        self._run = 0
