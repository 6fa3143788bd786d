"""Who flies is the same every time, whoever answers first, and every vehicle heard is told of."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import LinkError
from fg_gcs.flight.discovery import GAP_S, SETTLE_S, choose, discover, who_flies
from fg_gcs.flight.journal import Journal
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.link.endpoint import parse_networks
from fg_gcs.link.router import Router
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.autopilots import PX4
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.vehicle import Vehicle

PORT = 14550


def addresses(*system_ids: int) -> tuple[VehicleAddress, ...]:
    return tuple(VehicleAddress(MAIN, system_id) for system_id in system_ids)


def vehicles(
    system_ids: Iterator[int] | list[int],
    armed: frozenset[int] = frozenset(),
    fixed_wings: frozenset[int] = frozenset(),
) -> list[Vehicle]:
    heard = [Vehicle(address, PX4, 0.0) for address in addresses(*system_ids)]
    for vehicle in heard:
        vehicle.armed = vehicle.system_id in armed
        vehicle.kind = 1 if vehicle.system_id in fixed_wings else 2
    return heard


@given(st.sets(st.integers(1, 250), min_size=1, max_size=12), st.integers(1, 12), st.randoms())
def test_who_flies_does_not_depend_on_who_answers_first(ids: set[int], count: int, draw: random.Random) -> None:
    order = sorted(ids)
    draw.shuffle(order)
    assert choose(vehicles(order), count, None) == addresses(*sorted(ids)[:count])


@given(st.sets(st.integers(1, 30), min_size=1, max_size=12), st.frozensets(st.integers(1, 30)))
def test_an_armed_vehicle_flies_only_if_it_is_named(ids: set[int], armed: frozenset[int]) -> None:
    heard = vehicles(sorted(ids), armed)
    assert choose(heard, 12, None) == addresses(*sorted(ids - armed))
    assert choose(heard, 12, addresses(*ids)) == addresses(*sorted(ids))


@given(st.sets(st.integers(1, 250), min_size=2, max_size=12), st.frozensets(st.integers(1, 250)), st.booleans())
def test_every_vehicle_heard_is_told_of_once(ids: set[int], armed: frozenset[int], named: bool) -> None:
    heard = vehicles(sorted(ids), armed, frozenset({system_id for system_id in ids if system_id % 3 == 0}))
    wanted = addresses(min(ids)) if named else None
    said = who_flies(heard, choose(heard, 3, wanted), wanted)
    told = [
        system_id
        for run in "".join(c for c in said if c.isdigit() or c in "-,; ").replace(";", ",").split(",")
        if run.strip()
        for first, _, last in [run.strip().partition("-")]
        for system_id in range(int(first), int(last or first) + 1)
    ]
    assert sorted(told) == sorted(ids)


def test_the_line_about_who_flies() -> None:
    heard = vehicles([10, 200, *range(1, 10)], frozenset({200}))
    said = who_flies(heard, choose(heard, 9, None), None)
    assert said == "vehicles 1-9 fly; vehicle 200 is armed already; vehicle 10 is not needed"
    heard = vehicles([1, 2, 3, 4], frozenset({2}), frozenset({1, 2}))
    said = who_flies(heard, choose(heard, 2, None), None)
    assert said == "vehicles 3-4 fly; vehicle 2 is armed already; vehicle 1 is no multirotor"
    heard = vehicles([10, 200, *range(1, 10)])
    wanted = addresses(1, 2)
    assert who_flies(heard, wanted, wanted) == "vehicles 1-2 fly; vehicles 3-10, 200 are not named by the mission"


def test_one_that_is_silent_by_now_or_does_not_become_ready_is_passed_over() -> None:
    heard = vehicles([1, 2, 3, 4, 5])
    heard[1].phase = Phase.LOST
    chosen = choose(heard, 2, None, addresses(1))
    assert chosen == addresses(3, 4)
    said = who_flies(heard, chosen, None, addresses(1))
    assert said == (
        "vehicles 3-4 fly; vehicle 2 is silent; vehicle 1 does not become ready to arm; vehicle 5 is not needed"
    )


def discovered(
    folder: Path, begins_s: Mapping[int, float], count: int, armed: frozenset[int] = frozenset()
) -> tuple[list[int], float, str]:
    """Return who is chosen, when, and what is said, of vehicles that send a heartbeat a second from some time on."""

    async def speak(system_id: int, begin_s: float) -> None:
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, remote_addr=("127.0.0.1", PORT))
        sender = Sender(system_id, 1)
        await asyncio.sleep(begin_s)
        while True:
            base_mode = 0x81 if system_id in armed else 1
            transport.sendto(sender.pack(dialect.MAVLink_heartbeat_message(2, PX4.autopilot, base_mode, 0, 3, 3)))
            await asyncio.sleep(1.0)

    folder.mkdir(exist_ok=True)

    async def run() -> tuple[list[int], float, str]:
        loop = asyncio.get_running_loop()
        networks = parse_networks((f"udpin:127.0.0.1:{PORT}",))
        router = await Router.open(networks)
        speaking = [asyncio.create_task(speak(*one)) for one in begins_s.items()]
        try:
            with Recorder(folder, "", loop.time(), 0.0) as recorder:
                journal = Journal(recorder, loop.time)
                found = await discover(router, networks, count, None, 5.0, journal)
                recorder.flush()
            return [vehicle.system_id for vehicle in found], loop.time(), (folder / "events.jsonl").read_text()
        finally:
            for task in speaking:
                task.cancel()
            await asyncio.gather(*speaking, return_exceptions=True)
            router.close()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(run())


@pytest.mark.parametrize("seed", range(5))
def test_ten_on_the_link_and_nine_needed_are_the_same_nine_every_time(seed: int, tmp_path: Path) -> None:
    draw = random.Random(seed)
    ids, at_s, events = discovered(tmp_path, {system_id: draw.uniform(0.0, 1.0) for system_id in range(1, 11)}, 9)
    assert ids == list(range(1, 10))
    assert at_s < 1.0 + SETTLE_S + 0.1
    assert "vehicles 1-9 fly; vehicle 10 is not needed" in events


def test_a_lower_id_that_may_still_come_is_waited_for(tmp_path: Path) -> None:
    ids, at_s, _ = discovered(tmp_path, {3: 0.1, 4: 0.2, 1: 2.9}, 2)
    assert ids == [1, 3]
    assert at_s < 2.9 + GAP_S + 0.1


def test_one_that_somebody_else_has_armed_is_passed_over(tmp_path: Path) -> None:
    ids, _, events = discovered(tmp_path, {1: 0.1, 2: 0.2, 3: 0.3}, 2, frozenset({1}))
    assert ids == [2, 3]
    assert "vehicles 2-3 fly; vehicle 1 is armed already" in events
    with pytest.raises(LinkError, match=r"only vehicles 1-3 answered .* \(armed already: vehicle 1\)"):
        discovered(tmp_path / "more", {1: 0.1, 2: 0.2, 3: 0.3}, 3, frozenset({1}))
