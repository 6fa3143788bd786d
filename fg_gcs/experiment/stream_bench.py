"""What streaming costs: ours beside other ground stations and a bare loop of ``sendto``, in one run.

Times of one machine say little of another's, and on a busy one they wander: what counts are the ratios to the bare
loop, which takes its turn with each station, round by round.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import numpy as np

from fg_gcs.errors import LinkError
from fg_gcs.experiment.bare_process import bare_vehicles, free_ports
from fg_gcs.experiment.baseline import Progress
from fg_gcs.experiment.baselines.ground_stations import BareLoop, GroundStation, Mavsdk, Mavutil, Numbers
from fg_gcs.experiment.required import Figure, at_most
from fg_gcs.experiment.streaming import OwnStation, Streaming, stream, telemetry_us

LARGE: Final = 250
RATIO: Final = 2.0  # of a setpoint's time from array to socket to the bare loop's, in a large swarm
TELEMETRY_US: Final = 15.0
CORE: Final = 0.08  # of 250 vehicles at 50 Hz without telemetry
GATE_US: Final = 3.0  # of a setpoint through the last gate, whatever the swarm
MANY_CORE: Final = 0.5  # of 1000 vehicles
MANY_LATE_MS: Final = 10.0
MANY_MEMORY_MB: Final = 300.0

OWN: Final = "fg-gcs"
COUNTS: Final = (9, 50, 100, 250)
RATE_HZ: Final = 50.0
MANY: Final = 1000
MANY_HZ: Final = 20.0
MANY_NETWORKS: Final = 4
MANY_POSITION_HZ: Final = 4.0
LEAST_ROUNDS: Final = 4


class Size(NamedTuple):
    """How much is measured; the default is the benchmark, tests take less."""

    counts: tuple[int, ...] = COUNTS
    many: int = MANY
    race_s: float = 2.0  # of each race against the bare loop
    stream_s: float = 10.0  # of each stream
    others: bool = True  # other ground stations as well


class SetpointRow(NamedTuple):
    """One station with one number of vehicles."""

    station: str
    vehicles: int
    setpoint_us: float | None  # from array to socket; None: see the remark
    bare_us: float | None  # by the bare loop, in turn
    right: int  # setpoints that reached the vehicle that they are for
    wrong: int  # setpoints that reached another one
    remark: str = ""

    @property
    def ratio(self) -> float | None:
        """Return how many times as long as the bare loop it takes."""
        return None if self.setpoint_us is None or not self.bare_us else self.setpoint_us / self.bare_us


class StreamBench(NamedTuple):
    """The figures, by the names of the command line's JSON."""

    setpoints: tuple[SetpointRow, ...]
    telemetry_us: float  # a message read into state and recorded
    mavutil_telemetry_us: float | None  # a message read, in turn
    streams: tuple[Streaming, ...]  # at 50 Hz without telemetry, the fewest vehicles first
    many: Streaming  # in several networks, with telemetry

    def figures(self) -> tuple[Figure, ...]:
        """Return what is required, and whether it is met."""
        largest, many = self.streams[-1], self.many
        # A round has its own cost besides, so that the setpoints of a small swarm cost more each
        most_ratio = RATIO if largest.vehicles >= LARGE else math.inf
        ratio = next((row.ratio for row in reversed(self.setpoints) if row.station == OWN), None)
        wrong = sum(row.wrong for row in self.setpoints if row.station == OWN)
        wrong += sum(each.wrong for each in (*self.streams, many))
        return (
            at_most(f"setpoint from array to socket, {largest.vehicles} vehicles [bare sendto]", most_ratio, ratio),
            at_most("telemetry message read into state and recorded [us]", TELEMETRY_US, self.telemetry_us),
            at_most(f"{largest.vehicles} vehicles at {largest.rate_hz:g} Hz [of a core]", CORE, largest.core),
            at_most(f"{many.vehicles} vehicles at {many.rate_hz:g} Hz [of a core]", MANY_CORE, many.core),
            at_most(
                "setpoint through the last gate [us]", GATE_US, max(each.gate_us for each in (*self.streams, many))
            ),
            at_most("their p99 lateness [ms]", MANY_LATE_MS, many.late_p99_ms),
            at_most("memory with them [MB]", MANY_MEMORY_MB, many.memory_mb),
            at_most("setpoints at vehicles that they are not for", 0.0, float(wrong)),
        )


def is_installed(package: str) -> bool:
    """Tell whether a package can be imported."""
    return find_spec(package) is not None


async def stream_bench(
    progress: Progress, size: Size | None = None, installed: Callable[[str], bool] = is_installed
) -> StreamBench:
    """Measure everything; in real time, on the running loop.

    Args:
        progress: told what is being measured.
        size: how much; None: all of it.
        installed: tells whether a package is there: MAVSDK is needed for nothing but tests and this.

    Raises:
        LinkError: our own station does not hear its vehicles.
    """
    chosen = size or Size()
    # First, while nothing of other people's is loaded: memory is the whole process's
    progress(f"{chosen.many} vehicles in {MANY_NETWORKS} networks at {MANY_HZ:g} Hz")
    many = await stream(chosen.many, MANY_HZ, MANY_NETWORKS, MANY_POSITION_HZ, chosen.stream_s)
    streams = []
    for count in chosen.counts:
        progress(f"{count} vehicles at {RATE_HZ:g} Hz")
        streams.append(await stream(count, RATE_HZ, 1, 0.0, chosen.stream_s))
    own_us, their_us = await telemetry_us(chosen.race_s, others=chosen.others)
    rows = []
    for station in (OWN, *(("mavutil", "MAVSDK") if chosen.others else ())):
        for count in chosen.counts:
            progress(f"setpoints of {station} for {count} vehicles")
            if station == "MAVSDK" and not installed("mavsdk"):
                rows.append(SetpointRow(station, count, None, None, 0, 0, "not installed"))
            else:
                rows.append(await _race(station, count, chosen.race_s))
    return StreamBench(tuple(rows), own_us, their_us, tuple(streams), many)


async def _race(station: str, count: int, race_s: float) -> SetpointRow:
    """Let a station and the bare loop send setpoints in turn."""
    (port,) = free_ports(1)
    ids = range(1, count + 1)
    numbers = np.random.default_rng(2103).uniform(-50.0, 50.0, (count, 10))
    with TemporaryDirectory(prefix="fg-gcs-bench-") as place:
        competitor = await _open(station, port, Path(place))
        try:
            with bare_vehicles({port: ids}, 1.0) as vehicles:
                await competitor.hear(ids)
                bare = BareLoop(ids, vehicles.ports, numbers)
                try:
                    times_s = await _in_turn(competitor, bare, numbers, race_s)
                finally:
                    bare.close()
                await asyncio.sleep(0.5)  # until what is under way has come
                right, wrong = vehicles.deliveries()
        except LinkError as error:
            if station == OWN:
                raise
            return SetpointRow(station, count, None, None, 0, 0, str(error))
        finally:
            competitor.close()
    own_us, bare_us = (1e6 * median(each) / count for each in times_s)
    return SetpointRow(station, count, own_us, bare_us, right, wrong)


async def _open(station: str, port: int, folder: Path) -> GroundStation:
    match station:
        case "mavutil":
            return Mavutil(port)
        case "MAVSDK":
            return await Mavsdk.open(port)
        case _:
            return await OwnStation.open({"main": port}, folder)


async def _in_turn(
    station: GroundStation, bare: BareLoop, numbers: Numbers, race_s: float
) -> tuple[list[float], list[float]]:
    """Return how long each round took, the station's and the bare loop's [s]."""
    taken: tuple[list[float], list[float]] = ([], [])
    end_s, turn = time.perf_counter() + race_s, 0
    while time.perf_counter() < end_s or turn < LEAST_ROUNDS:
        for which in (turn % 2, 1 - turn % 2):  # whoever comes second finds everything in the processor's caches
            began_s = time.perf_counter()
            if which:
                bare.send()
            else:
                await station.send(numbers)
            taken[which].append(time.perf_counter() - began_s)
        turn += 1
        await asyncio.sleep(0.002)  # the vehicles have to read all this
    return taken
