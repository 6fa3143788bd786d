"""How memory grows with a flight, and what its evaluation needs after the landing; on Linux, which tells a process."""

from __future__ import annotations

import math
import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from fg_gcs.errors import FgError
from fg_gcs.flight.snapshot import Snapshot
from fg_gcs.mission.formats.toml import parse_mission
from fg_gcs.run.flying import FlyOptions, fly_blocking
from fg_gcs.run.observing import Observer

HOUR_S = 3600.0
GROWTH_BUDGET_MB = 5.0  # in an hour, after the first minute
SAMPLE_S = 60.0
HOLD = re.compile(r"(?m)^(\[hold\]\s*\n(?:.*\n)*?duration_s\s*=\s*)[^\s#]+")


class MemoryFigures(NamedTuple):
    """Memory of the process, the simulator in it included; a megabyte is 1e6 bytes."""

    vehicles: int
    flight_s: float  # from the first minute to the last sample
    first_minute_mb: float
    growth_mb: float  # at most, since then
    evaluation_mb: float  # above that at the end of the flight: what figures from the tables need at their peak
    budget_mb: float


def memory_bench(text: str, hold_s: float = HOUR_S) -> MemoryFigures:
    """Fly a mission in virtual time, with another duration of its hold, and look at the memory once a minute.

    Args:
        text: of the mission file.
        hold_s: duration of the hold [s].

    Raises:
        FgError: the mission is wrong or has no plan, or the flight was shorter than two minutes.
    """
    mission = parse_mission(HOLD.sub(rf"\g<1>{hold_s:g}", text))
    looks = _Looks()
    with TemporaryDirectory(prefix="fg-gcs-bench-") as place:
        options = FlyOptions(autopilot="px4", logs=Path(place), snapshot_hz=1.0 / SAMPLE_S, write_report=False)
        result = fly_blocking(mission, options, [looks], speed=math.inf)
    peak_mb = memory_mb("VmHWM")
    if result.error is not None:
        raise result.error
    after = [size_mb for time_s, size_mb in looks.taken if round(time_s) >= SAMPLE_S]  # off by rounding only
    if not result.completed or len(after) < 2:
        raise FgError(f"no flight of more than two minutes: {result.reason or 'it was over before'}")
    return MemoryFigures(
        mission.swarm.vehicles,
        (len(after) - 1) * SAMPLE_S,
        after[0],
        max(after) - after[0],
        peak_mb - after[-1],
        GROWTH_BUDGET_MB,
    )


class _Looks(Observer):
    """Looks at the memory whenever a snapshot comes, and lets its peak count anew."""

    def __init__(self) -> None:
        self.taken: list[tuple[float, float]] = []  # time since the run's start [s], memory [MB]

    def snapshot(self, snapshot: Snapshot) -> None:
        """Look."""
        self.taken.append((snapshot.time_s, memory_mb("VmRSS")))
        Path("/proc/self/clear_refs").write_text("5")


def memory_mb(key: str, process: int | str = "self") -> float:
    """Return the memory that a process has (``VmRSS``), or had at most (``VmHWM``) [MB]."""
    (line,) = (line for line in Path(f"/proc/{process}/status").read_text().splitlines() if line.startswith(key))
    return 1024e-6 * float(line.split()[1])
