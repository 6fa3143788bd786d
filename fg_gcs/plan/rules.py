"""The one place where motion is judged: shares of the limits, excess over the fence, pairs that are too close.

Planning, following, flight, experiments and the loading of missions all ask here, so that they cannot disagree on what
a limit bounds, or on what still counts as rounding.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.plan.limits import Limits, Rules

ROUNDING: Final = 1e-6  # share of a limit or a distance, and metres beyond the fence: arithmetic, not motion
INSTANT_S: Final = 1e-4  # instants closer together than this tell rounding, not jerk


class Peaks(NamedTuple):
    """Largest values over all vehicles and times, by the names of :class:`.Limits`."""

    speed_m_s: float
    acceleration_m_s2: float
    jerk_m_s3: float  # of differences between dense samples
    climb_m_s: float
    descent_m_s: float


def sizes(name: str, velocity_m_s: Array, acceleration_m_s2: Array, time_s: Array) -> Array:
    """Return what a limit bounds, of every vehicle at every instant, shape (T, V).

    Args:
        name: of the limit.
        velocity_m_s: shape (T, V, 3).
        acceleration_m_s2: shape (T, V, 3); jerks are its differences, the first one 0.
        time_s: ascending, shape (T,) [s].
    """
    if name in ("climb_m_s", "descent_m_s"):
        return velocity_m_s[:, :, 2] * (1.0 if name == "climb_m_s" else -1.0)
    if name == "jerk_m_s3":
        steps = np.diff(time_s)
        changes = np.linalg.norm(np.diff(acceleration_m_s2, axis=0), axis=2)
        jerks = np.where(steps > INSTANT_S, 1.0 / np.maximum(steps, INSTANT_S), 0.0)[:, None] * changes
        return np.concatenate((np.zeros((1, jerks.shape[1])), jerks))
    norms: Array = np.linalg.norm(velocity_m_s if name == "speed_m_s" else acceleration_m_s2, axis=2)
    return norms


def peaks_of(velocity_m_s: Array, acceleration_m_s2: Array, time_s: Array) -> Peaks:
    """Return the largest values among samples, arguments as those of :func:`sizes`."""
    return Peaks(*(float(sizes(name, velocity_m_s, acceleration_m_s2, time_s).max()) for name in Peaks._fields))


def limit_shares(peaks: Peaks, limits: Limits) -> dict[str, float]:
    """Return what share of each limit the peaks reach, by the limits' names."""
    return {name: getattr(peaks, name) / getattr(limits, name) for name in Peaks._fields}


def exceeded(peaks: Peaks, limits: Limits) -> tuple[str, ...]:
    """Return the names of the limits that the peaks exceed."""
    return tuple(name for name, share in limit_shares(peaks, limits).items() if not share <= 1.0 + ROUNDING)


def outside(excess_m: float) -> bool:
    """Say whether a place so far beyond the fence, negative inside, is outside [m]."""
    return not excess_m <= ROUNDING


def too_close(distance_m: float, minimum_m: float) -> bool:
    """Say whether a pair at a distance is closer than the minimum [m]."""
    return not distance_m >= minimum_m * (1.0 - ROUNDING)


def broken(peaks: Peaks, excess_m: float, closest_m: float, rules: Rules) -> tuple[str, ...]:
    """Return the names of the rules that a motion breaks: the limits' by their quantities, "separation" and "fence".

    Args:
        peaks: of the motion.
        excess_m: by how much a vehicle leaves the fence, negative inside [m].
        closest_m: distance of the closest pair [m].
        rules: what is to be kept.
    """
    names = [name.rpartition("_m_")[0] for name in exceeded(peaks, rules.limits)]
    names += ["separation"] if too_close(closest_m, rules.separation_m) else []
    names += ["fence"] if outside(excess_m) else []
    return tuple(names)
