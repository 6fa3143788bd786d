"""What becomes of datagrams on their way: lost, late, out of order, twice, damaged. Sans-IO; time is an argument."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sitl_mock.faults.schema import ImpairmentOptions
from sitl_mock.faults.vehicle_faults import Stages
from sitl_mock.links import DUE_SLACK_S
from sitl_mock.protocol.codec import first_message_id
from sitl_mock.protocol.layouts import layout

FROM_VEHICLE, TO_VEHICLE = 0, 1
BEHIND_S = 1e-6  # a datagram that comes behind the next one, when that is not late by itself
WAIT_S = 0.1  # for the next one, at most


Way = tuple[int, int, int]  # row, link, direction


class Delivery(NamedTuple):
    """A datagram that is due some time; in the order of time, and of being sent."""

    due_s: float
    order: int
    row: int
    link: int
    direction: int
    data: bytes


class Impairments:
    """All links of a fleet.

    Args:
        options: what is wrong with them.
        system_ids: of the vehicles, in the order of their rows.
        links: of each vehicle.
        stages: when stages began.
        seed: of everything random; every vehicle and direction has a generator of its own.
    """

    def __init__(
        self, options: Sequence[ImpairmentOptions], system_ids: Sequence[int], links: int, stages: Stages, seed: int
    ) -> None:
        self._stages = stages
        self._rules: list[list[list[_Rule]]] = []  # by row and direction
        seeds = np.random.SeedSequence((seed, 0x1177))
        for row, child in enumerate(seeds.spawn(len(system_ids))):
            ways = ("from_vehicle", "to_vehicle")
            own = [o for o in options if not o.window.vehicles or system_ids[row] in o.window.vehicles]
            generators = [np.random.default_rng(grandchild) for grandchild in child.spawn(2)]
            self._rules.append(
                [
                    [_Rule(o, generators[d]) for o in own if o.values["direction"] in (way, "both")]
                    for d, way in enumerate(ways)
                ]
            )
        self._free = [[not rules for rules in both] for both in self._rules]
        self._under_way: list[Delivery] = []
        self._held: dict[Way, Delivery] = {}  # goes behind the next one
        self._orders = 0

    def concern(self, row: int, direction: int) -> bool:
        """Whether anything may be wrong with a vehicle's datagrams in a direction."""
        return not self._free[row][direction]

    def send(self, row: int, link: int, direction: int, data: bytes, now_s: float) -> None:
        """Put a datagram on its way; `arrived` has it, or what has become of it, when it is due."""
        copies, due_s, behind, way = 1, now_s, False, (row, link, direction)
        for rule in self._rules[row][direction]:
            start_s = self._stages.start_s(rule.options.window, row)
            if not start_s <= now_s < start_s + rule.options.window.for_s or not rule.means(data):
                continue
            verdict = rule.judge(data)
            copies *= verdict.copies
            due_s = rule.queued(way, due_s + verdict.late_s) if copies else due_s
            behind = behind or verdict.behind
            data = verdict.data
        for _ in range(copies):
            delivery = Delivery(due_s, self._next_order(), row, link, direction, data)
            if behind and way not in self._held:
                self._held[way] = delivery
                continue
            heapq.heappush(self._under_way, delivery)
            held = self._held.pop(way, None)
            if held is not None:
                heapq.heappush(self._under_way, held._replace(due_s=due_s + BEHIND_S, order=self._next_order()))

    def arrived(self, now_s: float) -> list[Delivery]:
        """Take out what is due, in order."""
        now_s += DUE_SLACK_S
        for way, held in list(self._held.items()):
            if now_s >= held.due_s + WAIT_S:
                heapq.heappush(self._under_way, self._held.pop(way))
        found = []
        while self._under_way and self._under_way[0].due_s <= now_s:
            found.append(heapq.heappop(self._under_way))
        return found

    @property
    def next_s(self) -> float | None:
        """When `arrived` has to be asked next; None: nothing is under way."""
        times_s = [self._under_way[0].due_s] if self._under_way else []
        times_s += [held.due_s + WAIT_S for held in self._held.values()]
        return min(times_s, default=None)

    def _next_order(self) -> int:
        self._orders += 1
        return self._orders


class _Verdict(NamedTuple):
    """What becomes of a datagram."""

    copies: int
    late_s: float
    behind: bool
    data: bytes


class _Rule:
    """One impairment of one vehicle in one direction."""

    def __init__(self, options: ImpairmentOptions, random: np.random.Generator) -> None:
        self.options = options
        self._random = random
        self._ids = frozenset(layout(name).id for name in options.values["messages"])
        self._newest_s: dict[Way, float] = {}

    def means(self, data: bytes) -> bool:
        """Whether it is about this datagram."""
        return not self._ids or first_message_id(data) in self._ids

    def queued(self, way: Way, due_s: float) -> float:
        """When a datagram comes that is late: not before another such one that was sent before it."""
        self._newest_s[way] = max(due_s, self._newest_s.get(way, due_s))
        return self._newest_s[way]

    def judge(self, data: bytes) -> _Verdict:
        """Draw what becomes of a datagram; the same number of draws for each, so that none changes another's."""
        values = self.options.values
        lost, twice, behind, damaged, late, place = self._random.random(6).tolist()
        copies = 0 if lost < values["loss"] else 2 if twice < values["duplicate"] else 1
        if damaged < values["corrupt"] and data:
            index = int(place * len(data))
            data = data[:index] + bytes([data[index] ^ 0xFF]) + data[index + 1 :]
        late_s = values["delay_s"] + late * values["jitter_s"]
        return _Verdict(copies, late_s, behind < values["reorder"], data)
