"""How well a face covers a source: flux metric and coverage."""

from __future__ import annotations

import numpy as np

from fg_gcs.core import solid_angle
from fg_gcs.core.arrays import Array

FACING = 0.99  # a face counts as turned to its target from here on (the project's figure for "after the first turn")


def flux_metric(rims_enu_m: Array, sources_enu_m: Array) -> Array:
    """Return the share of half the source's flux that passes the face, clipped to [0, 1] [Hartley2021]_.

    One means that the source lies in the face, or just behind it among the swarm.

    Args:
        rims_enu_m: leaders over time, shape (T, N, 3) [m].
        sources_enu_m: the source, shape (3,) or over time (T, 3) [m].

    Returns:
        Shape (T,).
    """
    return np.clip(_flux(rims_enu_m, sources_enu_m) / solid_angle.HALF_SPHERE, 0.0, 1.0)


def coverage(rims_enu_m: Array, sources_enu_m: Array) -> Array:
    """Return the flux divided by the largest that this face could have at this distance, clipped to [0, 1].

    The largest is that of the same rim, turned so that the source lies on the normal through its centre.

    Args:
        rims_enu_m: leaders over time, shape (T, N, 3) [m].
        sources_enu_m: the source, shape (3,) or over time (T, 3) [m].

    Returns:
        Shape (T,).
    """
    centres = rims_enu_m.mean(axis=1)
    distances = np.linalg.norm(np.asarray(sources_enu_m) - centres, axis=1)
    best = solid_angle.flux(rims_enu_m, (centres + distances[:, None] * normals(rims_enu_m))[:, None, :])
    return np.clip(_flux(rims_enu_m, sources_enu_m) / np.maximum(best, np.finfo(float).tiny), 0.0, 1.0)


def least_after_facing(covered: Array) -> float | None:
    """Return the least coverage over time, shape (T,), since the face first was turned to the source; None: never."""
    facing = np.flatnonzero(covered >= FACING)
    return float(covered[facing[0] :].min()) if len(facing) else None


def normals(rims: Array) -> Array:
    """Return the unit normals of faces by the winding of their leaders; (T, N, 3) to (T, 3)."""
    arms = rims - rims.mean(axis=1, keepdims=True)
    area = np.cross(arms, np.roll(arms, -1, axis=1)).sum(axis=1)
    unit: Array = area / np.linalg.norm(area, axis=1, keepdims=True)
    return unit


def _flux(rims_enu_m: Array, sources_enu_m: Array) -> Array:
    sources = np.asarray(sources_enu_m, dtype=float)
    per_instant = sources[:, None, :] if sources.ndim == 2 else sources
    return solid_angle.unwrapped(solid_angle.flux(rims_enu_m, per_instant))
