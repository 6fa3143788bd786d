"""Random missions with one moving target: as mission files, so that they take the same way as everybody's."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

MOTIONS = ("static", "circle", "figure_eight", "waypoints", "random_walk")
AUTOPILOTS = ("px4", "ardupilot")
HOLD_S = 10.0  # from the capture on: long enough for a dozen replans a second to go wrong

TEMPLATE = """\
description = "{motion}, seed {seed}"

[swarm]
vehicles = 9

[formation]
shape = "hemisphere"
leaders = 4
followers = 5
edge_m = 6.0
centre_enu_m = {centre}
normal_enu = {normal}

[[targets]]
name = "target"
[targets.motion]
{keys}
[targets.sensor]
rate_hz = {rate_hz:.2f}
sigma_m = {sigma_m:.3f}
delay_s = {delay_s:.3f}
jitter_s = {jitter_s:.3f}
drop = {drop:.3f}
outliers = {outliers:.3f}
silence = {silence}
seed = {seed}

[hold]
duration_s = {hold_s}
depth_m = 1.0

[limits]
speed_m_s = 10.0
acceleration_m_s2 = 5.0
separation_m = 1.5

[fence]
low_enu_m = [-100.0, -100.0, 3.0]
high_enu_m = [100.0, 100.0, 60.0]

[pads]
first_enu_m = [-3.0, -3.0]
"""


class RandomMission(NamedTuple):
    """A mission and the autopilot of the vehicles that shall fly it."""

    text: str  # TOML
    motion: str
    autopilot: str


def random_mission(seed: int) -> RandomMission:
    """Return a mission with nine vehicles: motion, its speed, start and sensor drawn; the same for the same seed.

    Targets move with up to 5 m/s, half the vehicles' own speed, well inside the fence.

    Args:
        seed: 0 or more.
    """
    random = np.random.default_rng(seed)
    motion = str(random.choice(MOTIONS))
    heading = random.uniform(0.0, 2.0 * np.pi)
    silent_s = random.uniform(5.0, 25.0)
    text = TEMPLATE.format(
        motion=motion,
        seed=seed,
        centre=_numbers([*random.uniform(-30.0, 30.0, 2), random.uniform(12.0, 25.0)]),
        normal=_numbers([np.cos(heading), np.sin(heading), random.uniform(-0.3, 0.3)]),
        keys="\n".join(f"{key} = {value}" for key, value in _motion(motion, random).items()),
        rate_hz=random.uniform(5.0, 20.0),
        sigma_m=random.uniform(0.1, 1.0),
        delay_s=random.uniform(0.0, 0.3),
        jitter_s=random.uniform(0.0, 0.03),
        drop=random.uniform(0.0, 0.3),
        outliers=random.uniform(0.0, 0.05),
        silence=f"[{_numbers([silent_s, silent_s + random.uniform(2.0, 6.0)])}]" if random.random() < 0.3 else "[]",
        hold_s=HOLD_S,
    )
    return RandomMission(text, motion, str(random.choice(AUTOPILOTS)))


def _motion(kind: str, random: np.random.Generator) -> dict[str, str]:
    """The keys of a motion, drawn."""
    height_m = float(random.uniform(14.0, 35.0))
    place = [*random.uniform(-30.0, 30.0, 2), height_m]
    speed = f"{random.uniform(1.0, 5.0):.3f}"
    keys = {"kind": f'"{kind}"'}
    match kind:
        case "static":
            return keys | {"position_enu_m": _numbers([*(2.0 * np.array(place[:2])), height_m])}
        case "circle":
            return keys | {
                "centre_enu_m": _numbers(place),
                "radius_m": f"{random.uniform(15.0, 50.0):.3f}",
                "speed_m_s": speed,
                "phase_deg": f"{random.uniform(0.0, 360.0):.3f}",
                "clockwise": str(random.random() < 0.5).lower(),
            }
        case "figure_eight":
            return keys | {
                "centre_enu_m": _numbers(place),
                "length_m": f"{random.uniform(40.0, 100.0):.3f}",
                "top_speed_m_s": speed,
                "heading_deg": f"{random.uniform(0.0, 360.0):.3f}",
            }
        case "waypoints":
            # On a ring, a tenth of the round off at most: every leg is long enough for the turns at its ends
            angles = 2.0 * np.pi * (np.arange(4) / 4.0 + random.uniform(-0.05, 0.05, 4))
            radii_m = random.uniform(50.0, 70.0, 4)
            points = np.stack(
                (radii_m * np.cos(angles), radii_m * np.sin(angles), random.uniform(14.0, 35.0, 4)), axis=1
            )
            return keys | {
                "points_enu_m": f"[{', '.join(_numbers(point) for point in points)}]",
                "speed_m_s": speed,
                "acceleration_m_s2": f"{random.uniform(1.0, 2.0):.3f}",
                "closed": str(random.random() < 0.5).lower(),
            }
        case _:
            return keys | {
                "low_enu_m": "[-70.0, -70.0, 14.0]",
                "high_enu_m": "[70.0, 70.0, 35.0]",
                "start_enu_m": _numbers(place),
                "speed_m_s": speed,
                "acceleration_m_s2": f"{random.uniform(0.3, 1.0):.3f}",
                "seed": str(random.integers(1_000_000)),
            }


def _numbers(values: object) -> str:
    return f"[{', '.join(f'{value:.3f}' for value in np.asarray(values, dtype=float))}]"
