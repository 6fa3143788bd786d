"""Exactly one datagram lost, or doubled and late, of any kind and in either direction: the flight completes."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from pymavlink.dialects.v20 import all as dialect

from tests.flight.harness import AUTOPILOTS, Flight, fly
from tests.flight.meddling import LATENCY_S, Datagram, MeddlingLoop, OneOf

LATE_S = (None, 0.05, 0.3, 1.0, 3.0)  # None: lost
COMMON = {  # how many there are of each kind in a flight of four, about: some of each are drawn
    ("COMMAND_LONG", True): 76,
    ("HEARTBEAT", True): 148,
    ("PARAM_REQUEST_READ", True): 28,
    ("PARAM_SET", True): 8,
    ("SET_POSITION_TARGET_LOCAL_NED", True): 5000,
    ("ATTITUDE", False): 1400,
    ("AUTOPILOT_VERSION", False): 4,
    ("COMMAND_ACK", False): 76,
    ("EXTENDED_SYS_STATE", False): 700,
    ("GPS_GLOBAL_ORIGIN", False): 8,
    ("HEARTBEAT", False): 150,
    ("LOCAL_POSITION_NED", False): 3600,
    ("MESSAGE_INTERVAL", False): 24,
    ("PARAM_VALUE", False): 40,
    ("STATUSTEXT", False): 8,
    ("SYS_STATUS", False): 300,
}
KINDS = {
    "px4": {**COMMON, ("COMMAND_LONG", True): 104, ("CURRENT_MODE", False): 740, ("COMMAND_ACK", False): 100},
    "ardupilot": {**COMMON, ("HEARTBEAT", False): 880},
}


class Case(NamedTuple):
    """One datagram, and what becomes of it."""

    autopilot: str
    kind: str
    outbound: bool
    number: int
    late_s: float | None

    def __str__(self) -> str:
        way = "to" if self.outbound else "from"
        fate = "lost" if self.late_s is None else f"again after {self.late_s:g} s"
        return f"{self.kind} {self.number} {way} {self.autopilot}, {fate}"


def cases(of_each: int, seed: int) -> Iterator[Case]:
    """Yield some of every kind, with fates and places drawn."""
    draw = random.Random(seed)
    for autopilot in AUTOPILOTS:
        for (kind, outbound), count in KINDS[autopilot].items():
            for place in range(of_each):
                number = int((place + draw.random()) / of_each * count)
                yield Case(autopilot, kind, outbound, number, draw.choice(LATE_S))


def flown(case: Case, folder: Path) -> Flight:
    """Fly with one datagram lost or doubled."""
    one = OneOf(getattr(dialect, f"MAVLINK_MSG_ID_{case.kind}"), case.number, case.late_s, outbound=case.outbound)
    flight = fly(folder, case.autopilot, loop=lambda: MeddlingLoop(one))
    assert one.done, "there is no such datagram"
    return flight


@pytest.mark.parametrize("case", random.Random(11).sample(list(cases(1, 11)), 6), ids=str)
def test_one_datagram_lost_or_doubled_changes_nothing(case: Case, tmp_path: Path) -> None:
    flight = flown(case, tmp_path)
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    assert flight.down_and_disarmed
    assert '"kind": "fault"' not in flight.events
    assert flight.truth_separation_m >= 1.4


@pytest.mark.parametrize(("autopilot", "late_s"), [("px4", 1.7), ("ardupilot", 3.0)])
def test_all_telemetry_a_second_time_and_late_changes_nothing(late_s: float, autopilot: str, tmp_path: Path) -> None:
    def judge(datagram: Datagram) -> list[float]:
        return [LATENCY_S] if datagram.outbound else [LATENCY_S, LATENCY_S + late_s]

    flight = fly(tmp_path, autopilot, loop=lambda: MeddlingLoop(judge))
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    assert '"kind": "fault"' not in flight.events
