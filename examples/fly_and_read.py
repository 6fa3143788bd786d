"""Fly a mission in virtual time, watch it, and read its figures."""

from __future__ import annotations

import math
import sys
from pathlib import Path

from fg_gcs.run import FlyOptions, Observer, RunEvent, Snapshot, fly_blocking, load_mission

MISSION = Path(__file__).parent.parent / "missions" / "demo.toml"


class Watcher(Observer):
    """Prints the stages, and remembers the highest vehicle."""

    def __init__(self) -> None:
        self.highest_m = 0.0

    def event(self, event: RunEvent) -> None:
        """Print stages as they begin."""
        if event.kind == "stage":
            print(f"{event.time_s:6.1f} s  {event.text}")

    def snapshot(self, snapshot: Snapshot) -> None:
        """Look at every vehicle, at most 25 times a second."""
        self.highest_m = max([self.highest_m, *(vehicle.height_m or 0.0 for vehicle in snapshot.vehicles)])


def main(logs: Path) -> None:
    """Fly, and print what came of it."""
    watcher = Watcher()
    result = fly_blocking(load_mission(MISSION), FlyOptions(logs=logs), [watcher], speed=math.inf)
    print(f"{result.outcome.value}; {result.summary['vehicles_landed']} vehicles landed")
    print(f"flux metric at the hold {result.summary['flown_flux_metric']:.3f}, highest {watcher.highest_m:.1f} m")
    print(f"closest pair {result.summary['flown_min_separation_m']:.2f} m; report: {result.report}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "logs"))
