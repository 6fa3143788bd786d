"""Bring your own source of sightings: here a camera that sees a walking person five times a second."""

from __future__ import annotations

import asyncio
import math
import random
import sys
from pathlib import Path

from fg_gcs.run import FlyOptions, OwnSightings, fly_blocking, load_mission

MISSION = Path(__file__).parent.parent / "missions" / "circle.toml"
WALK_M_S, SIGMA_M, DELAY_S = 1.2, 0.4, 0.15


class Camera(OwnSightings):
    """Replace the inside of the loop by what your own sensor says."""

    async def run(self) -> None:
        """Put sightings in, for as long as the target is tracked."""
        loop, noise = asyncio.get_running_loop(), random.Random(1)
        began_s = loop.time()
        while True:
            await asyncio.sleep(0.2)
            seen_s = loop.time() - began_s - DELAY_S  # when the picture was taken
            place = (8.0 + WALK_M_S * seen_s * 0.2, -6.0 + WALK_M_S * seen_s, 18.0)
            self.put([part + noise.gauss(0.0, SIGMA_M) for part in place], sigma_m=SIGMA_M, age_s=DELAY_S)


def main(logs: Path) -> None:
    """Follow the person in virtual time."""
    mission = load_mission(MISSION)
    assert mission.targets is not None
    options = FlyOptions(sightings={mission.targets[0].name: Camera()}, logs=logs)
    result = fly_blocking(mission, options, speed=math.inf)
    print(f"{result.outcome.value}{': ' if result.reason else ''}{result.reason}")
    print(f"{result.summary['sightings']} sightings, caught after {result.summary['capture_time_s']:.1f} s")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "logs"))
