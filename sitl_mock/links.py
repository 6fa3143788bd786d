"""What a vehicle keeps for one remote: whether it is sent status texts, and which messages how often."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

DUE_SLACK_S = 1e-6  # a deadline that floating point put a hair behind the tick is due
# Streams of a large swarm are spread over time, so that no tick has to say everything: of 250 vehicles as many as can
# be packed well in one pass speak in the same tick, the next ones in the next. Small fleets stay in phase.
PHASE_VEHICLES = 25
PHASE_STEP_S = 0.01
PHASES = 10  # the streams that take most of the time come ten times a second


def phase_s(row: int) -> float:
    """How much later than the first vehicle's the streams of a vehicle are [s]."""
    return row // PHASE_VEHICLES % PHASES * PHASE_STEP_S


@dataclass(slots=True)
class Interval:
    """Messages that are sent equally often, at absolute deadlines."""

    due_s: float
    names: list[str]


class Link:
    """State that the vehicle keeps per remote.

    Args:
        streams_hz: messages sent unasked, and how often.
        start_s: before this nothing is sent; all deadlines go by it; messages of one interval are due at once.

    Attributes:
        next_s: before this no stream is due.
        texts_open: whether it is sent status texts.
        parameter_index: next of a running PARAM_REQUEST_LIST.
        frozen_s: from then on nothing is sent, until something is heard again.
    """

    def __init__(self, streams_hz: Mapping[str, float], start_s: float) -> None:
        self._default_hz = streams_hz
        self._start_s = start_s
        self._periods_s = {name: 1.0 / hz for name, hz in streams_hz.items()}
        self._intervals: dict[float, Interval] = {}  # by period
        for name, period_s in self._periods_s.items():
            # What is seldom said, and takes longest to make, is not said with what is often said.
            due_s = start_s + len(self._intervals) * PHASE_STEP_S
            self._intervals.setdefault(period_s, Interval(due_s, [])).names.append(name)
        self.next_s = start_s
        self.texts_open = False
        self.parameter_index: int | None = None
        self.frozen_s = math.inf

    def set_interval(self, name: str, period_s: float | None, now_s: float) -> None:
        """Send a message every `period_s` from now on, first within that time; None stops it."""
        before_s = self._periods_s.pop(name, None)
        if before_s is not None:
            self._intervals[before_s].names.remove(name)
            if not self._intervals[before_s].names:
                del self._intervals[before_s]
        if period_s is None:
            return
        self._periods_s[name] = period_s
        if period_s not in self._intervals:
            passed = math.floor((now_s + DUE_SLACK_S - self._start_s) / period_s)
            self._intervals[period_s] = Interval(self._start_s + max(0, passed + 1) * period_s, [])
        self._intervals[period_s].names.append(name)
        self.next_s = min(self.next_s, self._intervals[period_s].due_s)

    def default_period_s(self, name: str) -> float | None:
        """The interval that a message has when it was not asked for; None: not sent."""
        hz = self._default_hz.get(name)
        return None if hz is None else 1.0 / hz

    def period_s(self, name: str) -> float | None:
        """The present interval of a message; None: not sent."""
        return self._periods_s.get(name)

    def due(self, now_s: float) -> list[str]:
        """Messages due now. A stream that is late sends once and goes on at its own deadlines."""
        if now_s < self.next_s - DUE_SLACK_S:
            return []
        names: list[str] = []
        for period_s, interval in self._intervals.items():
            if interval.due_s <= now_s + DUE_SLACK_S:
                names += interval.names
                missed = math.floor((now_s + DUE_SLACK_S - interval.due_s) / period_s)
                interval.due_s += (missed + 1) * period_s
        self.next_s = min((interval.due_s for interval in self._intervals.values()), default=math.inf)
        return names
