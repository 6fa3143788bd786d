"""Bring your own target motion: a helix, seen by the sensor that the mission describes."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

from fg_gcs.run import FlyOptions, fly_blocking, load_mission

MISSION = Path(__file__).parent.parent / "missions" / "circle.toml"
RADIUS_M, RATE_RAD_S, CLIMB_M_S, LOW_M, HIGH_M = 14.0, 0.14, 0.1, 18.0, 22.0


class Helix:
    """A target that circles, and rises until it is high enough."""

    top_speed_m_s = math.hypot(RADIUS_M * RATE_RAD_S, CLIMB_M_S)
    box_enu_m = np.array([(-RADIUS_M, -RADIUS_M, LOW_M), (RADIUS_M, RADIUS_M, HIGH_M)])

    def at(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions [m; ENU] and velocities [m/s; ENU] at times, shape (T,) [s]; each (T, 3)."""
        angle, rises = RATE_RAD_S * time_s, time_s < (HIGH_M - LOW_M) / CLIMB_M_S
        up = np.minimum(LOW_M + CLIMB_M_S * np.maximum(time_s, 0.0), HIGH_M)
        position = np.stack([RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), up], axis=1)
        speed = RADIUS_M * RATE_RAD_S
        velocity = np.stack([-speed * np.sin(angle), speed * np.cos(angle), CLIMB_M_S * rises], axis=1)
        return position, velocity


def main(logs: Path) -> None:
    """Fly after the helix in virtual time."""
    mission = load_mission(MISSION)
    assert mission.targets is not None
    options = FlyOptions(motions={mission.targets[0].name: Helix()}, logs=logs)
    result = fly_blocking(mission, options, speed=math.inf)
    print(f"{result.outcome.value}; caught after {result.summary['capture_time_s']:.1f} s")
    print(f"centre off the target {result.summary['centre_error_rms_m']:.2f} m rms; report: {result.report}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "logs"))
