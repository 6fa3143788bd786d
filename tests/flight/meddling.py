"""Whole flights in virtual time with somebody on the line: datagrams that are lost, late, doubled or overtaken."""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable
from typing import NamedTuple

from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.link.memory import Address, MemoryNetwork
from tests.flight.harness import GROUND_PORT

LATENCY_S = 0.001
Judge = Callable[["Datagram"], list[float]]


class Datagram(NamedTuple):
    """One datagram between the station and a vehicle.

    Attributes:
        data: its bytes: one MAVLink 2 frame or several.
        outbound: it goes to the vehicle.
        at_s: when it was sent [s].
    """

    data: bytes
    outbound: bool
    at_s: float

    @property
    def message_id(self) -> int:
        """Of its first frame."""
        return int.from_bytes(self.data[7:10], "little")


class MeddlingLoop(VirtualTimeLoop):
    """Virtual time in which a judge says when each datagram arrives.

    Args:
        judge: returns the delays [s] with which a datagram between station and vehicles arrives, one for each copy.
    """

    def __init__(self, judge: Judge) -> None:
        super().__init__(LATENCY_S)
        self._network = _MeddlingNetwork(self, judge)


class StandingStill(VirtualTimeLoop):
    """Virtual time in which the program, the simulator included, can stand still."""

    def stand_still(self, seconds: float) -> None:
        """Let so much time pass in which nothing runs [s]."""
        self._now_s += seconds


class _MeddlingNetwork(MemoryNetwork):
    """Delivers each datagram when it is due, whatever was sent before it."""

    def __init__(self, loop: VirtualTimeLoop, judge: Judge) -> None:
        super().__init__(loop, LATENCY_S)
        self._judge = judge
        self._late: list[tuple[float, int, bytes, Address, Address]] = []
        self._count = 0

    def send(self, data: bytes, source: Address, target: Address) -> None:
        """Deliver each copy after the delay that the judge gives it."""
        now_s = self._loop.time()
        delays_s = [LATENCY_S]
        if GROUND_PORT in (source[1], target[1]):
            delays_s = self._judge(Datagram(data, source[1] == GROUND_PORT, now_s))
        for delay_s in delays_s:
            self._count += 1
            heapq.heappush(self._late, (now_s + delay_s, self._count, data, source, target))
            self._loop.call_at(now_s + delay_s, self._deliver_due)

    def _deliver_due(self) -> None:
        while self._late and self._late[0][0] <= self._loop.time() + 1e-9:
            _, _, data, source, target = heapq.heappop(self._late)
            endpoint = self._endpoints.get(target)
            if endpoint is not None:
                endpoint.deliver(data, source)


def lossy(seed: int, loss: float, least_s: float = 0.0, most_s: float = 0.0, double: float = 0.0) -> Judge:
    """Return what loses a share each way and delays the others, each by itself, so that they overtake each other."""
    draw = random.Random(seed)

    def judge(datagram: Datagram) -> list[float]:
        copies = 0 if draw.random() < loss else 2 if draw.random() < double else 1
        return [LATENCY_S + draw.uniform(least_s, most_s) for _ in range(copies)]

    return judge


class OneOf:
    """Loses or doubles exactly one datagram: the n-th of one kind in one direction.

    Args:
        message_id: which kind.
        outbound: which direction.
        number: which of them, counted from 0.
        late_s: when it comes a second time, after the first [s]; None: it is lost.
    """

    def __init__(self, message_id: int, number: int, late_s: float | None, *, outbound: bool) -> None:
        self._message_id, self._outbound = message_id, outbound
        self._left, self._late_s = number, late_s
        self.done = False

    def __call__(self, datagram: Datagram) -> list[float]:
        if not self.done and datagram.outbound == self._outbound and datagram.message_id == self._message_id:
            self.done, self._left = self._left == 0, self._left - 1
            if self.done:
                return [] if self._late_s is None else [LATENCY_S, LATENCY_S + self._late_s]
        return [LATENCY_S]
