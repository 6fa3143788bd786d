"""What the simulator costs, alone and in whole flights; on Linux, which tells what a process takes.

Figures of one machine say little of another's, and on a busy one they wander: packing stands beside pymavlink's own
in the same run.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from fg_gcs.experiment.baseline import Progress
from fg_gcs.experiment.baselines.ground_stations import pymavlink_us
from fg_gcs.experiment.required import Figure, at_least, at_most
from fg_gcs.experiment.sim_flights import RealFlight, VirtualFlight, real_flight, virtual_flight
from fg_gcs.experiment.simulator_process import Alone, parts_alone, simulator_alone

STEPS_S: Final = {"paper": 2e6, "measured": 0.5e6}  # of one vehicle, in a second
LARGE: Final = 250  # with fewer vehicles a step's own cost counts more
LATE_MS: Final = 10.0
MEMORY_MB: Final = 100.0
VEHICLE_MB: Final = 0.05
TIMES_REAL: Final = 20.0
ERROR_M: Final = 0.1

PHYSICS: Final = (9, 250, 1000)
COUNTS: Final = (9, 50, 100, 250)
SWARM: Final = 249


class Size(NamedTuple):
    """How much is measured; the default is the benchmark, tests take less."""

    physics: tuple[int, ...] = PHYSICS
    counts: tuple[int, ...] = COUNTS
    swarm: int = SWARM  # vehicles of the flight in real time; 0: none
    part_s: float = 1.0  # of each part alone
    alone_s: float = 20.0  # of each simulator alone


class PhysicsRow(NamedTuple):
    """Physics alone."""

    dynamics: str
    vehicles: int
    steps_s: float  # steps of one vehicle, in a second


class PackingRow(NamedTuple):
    """Telemetry alone: from state to frames."""

    vehicles: int
    message_us: float
    pymavlink_us: float  # to make and pack the same messages from numbers

    @property
    def ratio(self) -> float:
        """Return how many times as long as pymavlink it takes."""
        return self.message_us / self.pymavlink_us


class SimBench(NamedTuple):
    """The figures, by the names of the command line's JSON."""

    physics: tuple[PhysicsRow, ...]
    packing: tuple[PackingRow, ...]
    alone: tuple[Alone, ...]  # the fewest vehicles first
    virtual: VirtualFlight
    real: RealFlight | None

    def figures(self) -> tuple[Figure, ...]:
        """Return what is required, and whether it is met."""
        figures = [
            at_least(f"{kind} physics, {most} vehicles [vehicle-steps/s]", least if most >= LARGE else 0.0, steps_s)
            for kind, least in STEPS_S.items()
            for most, steps_s in [self._slowest(kind)]
        ]
        largest = self.alone[-1]
        name = f"simulator alone, {largest.vehicles} vehicles"
        figures += [
            at_most(f"{name} [of a core]", 1.0, largest.core),
            at_most(f"{name}, p99 lateness [ms]", LATE_MS, largest.late_p99_ms),
            *(
                at_most(f"memory with {each.vehicles} [MB]", MEMORY_MB + VEHICLE_MB * each.vehicles, each.memory_mb)
                for each in self.alone
            ),
            at_least("flight in virtual time [times real]", TIMES_REAL, self.virtual.times_real),
        ]
        if self.real is not None:
            name, most = f"{self.real.vehicles} vehicles in real time", self.real
            figures += [
                Figure(f"{name}: completed", "1", float(most.completed), most.completed),
                at_most(f"{name}, tracking error [m rms]", ERROR_M, most.error_rms_m),
                at_most(f"{name}, p99 lateness of setpoints [ms]", LATE_MS, most.late_p99_ms),
            ]
        return tuple(figures)

    def _slowest(self, kind: str) -> tuple[int, float]:
        """Return the largest number of vehicles, and the fewest steps a second with them."""
        rows = [row for row in self.physics if (row.dynamics == "paper") == (kind == "paper")]
        most = max(row.vehicles for row in rows)
        return most, min(row.steps_s for row in rows if row.vehicles == most)


def sim_bench(mission: str, progress: Progress, size: Size | None = None) -> SimBench:
    """Measure everything.

    Args:
        mission: text of the mission that is flown in virtual time.
        progress: told what is being measured.
        size: how much; None: all of it.

    Raises:
        FgError: the mission is wrong or is not completed, or the simulator does not start.
    """
    chosen = size or Size()
    progress("physics and telemetry, each alone")
    parts = parts_alone(chosen.physics, chosen.counts, chosen.part_s)
    alone, frames = [], list[bytes]()
    for count in chosen.counts:
        progress(f"the simulator alone, {count} vehicles")
        found, frames = simulator_alone(count, chosen.alone_s)
        alone.append(found)
    their_us = pymavlink_us(frames, chosen.part_s) if frames else math.nan
    progress("a flight in virtual time, twice")
    virtual = virtual_flight(mission)
    real = None
    if chosen.swarm:
        progress(f"a flight of {chosen.swarm} vehicles in real time; that takes some minutes")
        real = real_flight(chosen.swarm)
    return SimBench(
        tuple(PhysicsRow(**row) for row in parts["physics"]),
        tuple(PackingRow(**row, pymavlink_us=their_us) for row in parts["telemetry"]),
        tuple(alone),
        virtual,
        real,
    )
