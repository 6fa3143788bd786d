"""Plan a flux-guided path from the smallest mission there is, print what it promises, and draw it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from fg_gcs.run import parse_mission, plan

MISSION = """
[swarm]
vehicles = 4
[formation]
shape = "hemisphere"
leaders = 3
followers = 1
edge_m = 6.0
centre_enu_m = [0.0, 0.0, 10.0]
normal_enu = [1.0, 0.0, 0.0]
[target]
position_enu_m = [-20.0, 15.0, 14.0]
[limits]
speed_m_s = 8.0
acceleration_m_s2 = 4.0
separation_m = 1.5
[fence]
low_enu_m = [-50.0, -50.0, 2.0]
high_enu_m = [50.0, 50.0, 40.0]
"""


def main(folder: Path) -> None:
    """Plan, print, draw into a folder."""
    planned = plan(parse_mission(MISSION))
    print(f"{planned.figures['path_length_m']:.1f} m over all leaders in {planned.figures['duration_s']:.1f} s")
    approach = planned.flight.approach
    sample = approach.sample(np.linspace(0.0, approach.duration_s, 200))  # arrays of shape (200, vehicles, 3)
    print(f"highest speed {np.linalg.norm(sample.velocity_m_s, axis=2).max():.2f} m/s")
    folder.mkdir(parents=True, exist_ok=True)
    picture = folder / "plan.png"
    planned.draw(picture)
    print(f"drawn: {picture}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
