"""How to turn a face about its normal so that nobody is above anybody: whoever falls or lands then meets nobody."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.distance import pdist

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Pose, rolled

STEP_DEG: Final = 3.0  # between two rolls that are tried; at 3 m from the centre that is 0.16 m
MOST_DEG: Final = 90.0  # a turn by 180 degrees swaps above and below, and leaves distances as they are


class Roll(NamedTuple):
    """A turn of a face about its normal, and what comes of it."""

    by_deg: float  # counter-clockwise as seen from the target
    apart_m: float  # least distance of two vehicles as seen from above


def apart_m(slots_m: Array, poses: Sequence[Pose]) -> float:
    """Return the least distance of two vehicles as seen from above, in any of some poses [m].

    Args:
        slots_m: template of the formation, shape (V, 3) [m].
        poses: where the formation is.
    """
    return float(min(pdist((pose.scale * slots_m @ pose.rotation.T)[:, :2]).min() for pose in poses))


def clearest_roll(slots_m: Array, poses: Sequence[Pose]) -> Roll:
    """Return the roll that leaves vehicles farthest from each other as seen from above; the smallest of equal ones.

    Args:
        slots_m: template of the formation, shape (V, 3) [m].
        poses: where the formation is, one roll for all of them.
    """
    steps = round(MOST_DEG / STEP_DEG)
    degrees = sorted(STEP_DEG * np.arange(1 - steps, steps + 1), key=lambda by: (abs(by), -by))
    found = [
        Roll(
            float(by),
            apart_m(slots_m, [pose._replace(rotation=rolled(pose.rotation, math.radians(by))) for pose in poses]),
        )
        for by in degrees
    ]
    return max(found, key=lambda roll: round(roll.apart_m, 2))
