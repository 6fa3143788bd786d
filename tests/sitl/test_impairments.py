"""What becomes of datagrams on their way, by direction, vehicle, message and time, in both profiles."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from sitl_mock import SimulatorOptions, grid, parse_impairment
from tests.sitl.virtual import World, command, heartbeat

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
FIRST, SECOND = 18570, 18571
RATE_HZ, READY_S = 50.0, 2.0


@contextmanager
def impaired(autopilot: str, *tables: dict[str, Any], seed: int = 0) -> Iterator[World]:
    """Two vehicles that send ATTITUDE 50 times a second, on links that are whole until READY_S."""
    impairments = tuple(parse_impairment({"at_s": READY_S, **table}) for table in tables)
    options = SimulatorOptions(autopilot, grid(2), port_base=FIRST, seed=seed, impairments=impairments)
    world = World(options)
    try:
        world.run(1.0)
        for port in (FIRST, SECOND):
            world.station.send(command(511, 30, 1e6 / RATE_HZ, system=port - FIRST + 1), port)
        world.run(READY_S - world.loop.time())
        yield world
    finally:
        world.close()


def stamps_ms(world: World, port: int, since_s: float) -> list[int]:
    """Time stamps of ATTITUDE in the order in which they came."""
    return [m.time_boot_ms for _, m in world.station.messages("ATTITUDE", port, since_s)]


def delays_s(world: World, port: int, since_s: float) -> list[float]:
    return [t - m.time_boot_ms * 1e-3 for t, m in world.station.messages("ATTITUDE", port, since_s)]


@BOTH
def test_loss(autopilot: str) -> None:
    with impaired(autopilot, {"loss": 0.3, "direction": "from_vehicle", "vehicles": [1]}) as world:
        world.run(20.0)
        assert len(stamps_ms(world, FIRST, READY_S)) == pytest.approx(0.7 * 20.0 * RATE_HZ, rel=0.1)
        assert len(stamps_ms(world, SECOND, READY_S)) == pytest.approx(20.0 * RATE_HZ, abs=2)


@BOTH
def test_telemetry_muted_for_a_while(autopilot: str) -> None:
    with impaired(autopilot, {"loss": 1.0, "direction": "from_vehicle", "for_s": 3.0}) as world:
        world.run(6.0)
        times_s = [t for t, _, _ in world.station.heard if t > READY_S + 0.01]
        assert min(times_s) == pytest.approx(READY_S + 3.0, abs=0.05)


@BOTH
def test_commands_muted(autopilot: str) -> None:
    """Nothing reaches the vehicle, which goes on talking."""
    with impaired(autopilot, {"loss": 1.0, "direction": "to_vehicle", "for_s": 3.0}) as world:
        world.station.send(command(512, 148), FIRST)
        world.run(2.0)
        assert not world.station.messages("COMMAND_ACK", FIRST, READY_S)
        assert len(stamps_ms(world, FIRST, READY_S)) == pytest.approx(2.0 * RATE_HZ, abs=3)
        world.run(2.0)
        world.station.send(command(512, 148), FIRST)
        world.run(0.1)
        assert world.station.messages("AUTOPILOT_VERSION", FIRST, READY_S)


@BOTH
def test_some_messages_only(autopilot: str) -> None:
    table = {"loss": 1.0, "messages": ["HEARTBEAT"], "direction": "from_vehicle"}
    with impaired(autopilot, table) as world:
        world.run(5.0)
        assert not world.station.messages("HEARTBEAT", FIRST, READY_S + 0.01)
        assert len(stamps_ms(world, FIRST, READY_S)) == pytest.approx(5.0 * RATE_HZ, abs=2)


@BOTH
def test_what_is_late_or_lost_holds_nothing_else_back(autopilot: str) -> None:
    table = {"delay_s": 3.0, "messages": ["HEARTBEAT"], "direction": "from_vehicle"}
    for loss in (0.0, 1.0):
        with impaired(autopilot, {**table, "loss": loss}) as world:
            world.run(5.0)
            assert max(delays_s(world, FIRST, READY_S)) < 0.01
            assert len(stamps_ms(world, FIRST, READY_S)) == pytest.approx(5.0 * RATE_HZ, abs=2)
            late = world.station.messages("HEARTBEAT", FIRST, READY_S + 0.5)
            assert [t for t, _ in late if t < READY_S + 2.9] == []
            assert bool(late) is (loss == 0.0)


@BOTH
def test_delay_and_jitter_keep_the_order(autopilot: str) -> None:
    with impaired(autopilot, {"delay_s": 0.2, "jitter_s": 0.1, "direction": "from_vehicle"}) as world:
        world.run(10.0)
        late_s = np.array(delays_s(world, FIRST, READY_S + 0.3))
        assert late_s.min() >= 0.2
        assert late_s.max() <= 0.31
        assert late_s.std() > 0.01
        stamps = stamps_ms(world, FIRST, READY_S)
        assert stamps == sorted(stamps)
        assert len(stamps) == pytest.approx(9.75 * RATE_HZ, abs=3)


@BOTH
def test_a_delay_to_the_vehicle_delays_its_answers(autopilot: str) -> None:
    with impaired(autopilot, {"delay_s": 0.5, "direction": "to_vehicle"}) as world:
        world.station.send(command(512, 148), FIRST)
        world.run(1.0)
        ((at_s, _),) = world.station.messages("AUTOPILOT_VERSION", FIRST, READY_S)
        assert at_s == pytest.approx(READY_S + 0.5, abs=0.01)


@BOTH
def test_reordering_swaps_neighbours(autopilot: str) -> None:
    with impaired(autopilot, {"reorder": 0.2, "direction": "from_vehicle", "messages": ["ATTITUDE"]}) as world:
        world.run(10.0)
        stamps = stamps_ms(world, FIRST, READY_S)
        backwards = sum(b < a for a, b in pairwise(stamps))
        assert backwards > 20
        assert len(stamps) == len(set(stamps)) == pytest.approx(10.0 * RATE_HZ, abs=3)
        # Each is at most one place away from where it belongs, or was overtaken by a datagram of another kind
        ranks = np.argsort(np.argsort(stamps))
        assert np.abs(ranks - np.arange(len(stamps))).max() <= 1


@BOTH
def test_duplicates(autopilot: str) -> None:
    with impaired(autopilot, {"duplicate": 0.25, "direction": "from_vehicle"}) as world:
        world.run(20.0)
        stamps = stamps_ms(world, FIRST, READY_S)
        assert len(stamps) == pytest.approx(1.25 * len(set(stamps)), rel=0.06)
        assert stamps == sorted(stamps)


@BOTH
def test_corruption_is_found_by_checksums(autopilot: str) -> None:
    with impaired(autopilot, {"corrupt": 0.3}) as world:
        for k in range(200):
            world.station.send(heartbeat(), FIRST, sequence=k % 256)
            world.run(0.05)
        sent = 10.0 * RATE_HZ
        assert len(stamps_ms(world, FIRST, READY_S)) == pytest.approx(0.7 * sent, rel=0.1)
        assert world.simulator.counters.bad_bytes > 0


@BOTH
def test_the_same_seed_gives_the_same_datagrams(autopilot: str) -> None:
    table = {"loss": 0.2, "delay_s": 0.05, "jitter_s": 0.05, "reorder": 0.1, "duplicate": 0.1, "corrupt": 0.1}
    runs = []
    for seed in (3, 3, 4):
        with impaired(autopilot, table, seed=seed) as world:
            world.run(5.0)
            runs.append(world.station.heard)
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


@BOTH
def test_one_vehicles_links_change_no_others(autopilot: str) -> None:
    """Each vehicle draws its own luck: what is wrong with the first leaves the second's datagrams as they were."""
    table = {"loss": 0.3, "direction": "from_vehicle"}
    heard = []
    for tables in ([table], [table, {"loss": 0.5, "vehicles": [1]}]):
        with impaired(autopilot, *tables) as world:
            world.run(4.0)
            heard.append([(t, data) for t, port, data in world.station.heard if port == SECOND])
    assert heard[0] == heard[1]


def test_an_impairment_waits_for_a_stage() -> None:
    with impaired("px4", {"loss": 1.0, "stage": "hold", "at_s": 1.0}) as world:
        world.run(3.0)
        assert len(stamps_ms(world, FIRST, READY_S)) == pytest.approx(3.0 * RATE_HZ, abs=2)
        world.simulator.begin_stage("hold")
        world.run(5.0)
        assert len(stamps_ms(world, FIRST, READY_S)) == pytest.approx(4.0 * RATE_HZ, abs=2)


def test_vehicles_that_are_not_there_are_refused() -> None:
    with pytest.raises(ValueError, match="there is no vehicle 7"):
        SimulatorOptions(impairments=(parse_impairment({"loss": 0.5, "vehicles": [7]}),))
