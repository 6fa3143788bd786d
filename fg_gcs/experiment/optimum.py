"""The shortest time that a path allows, found independently of the planner's timing: a reference for it.

The squared path speed ``x`` and the path acceleration ``u`` of every vehicle obey ``|q' u + q'' x| <= a`` and
``|q'|^2 x <= v^2``, here as they stand, without polygons. Both sets are convex, so on a grid the largest ``x`` from
which the rest of the path can be run is found backwards by bisection, and then ``x`` is raised forwards as far as
that allows. The limits are asked for at grid points only, which flatters the result by a share that shrinks with the
grid.
"""

from __future__ import annotations

import math

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.plan.limits import Limits
from fg_gcs.plan.path.swarm_path import SwarmPath

SPACING_M = 0.01  # a tenth of the spacing that the planner's timing starts from
MIN_POINTS = 2001  # a short path needs a fine grid as well: its ends cost the most time
HALVINGS = 50  # of the range of x: past the last digit


def shortest_duration_s(path: SwarmPath, limits: Limits) -> float:
    """Return the shortest duration from rest to rest under the norms of speed and acceleration [s].

    Args:
        path: of at least one vehicle; a path of no length takes no time.
        limits: climb and descent are left out.
    """
    if path.length_m == 0.0:
        return 0.0
    count = max(MIN_POINTS, int(np.ceil(path.length_m / SPACING_M)) + 1)
    grid = np.linspace(0.0, path.length_m, count)
    _, first, second = path.at(grid)
    squares = np.einsum("svk,svk->sv", first, first)
    mixed = np.einsum("svk,svk->sv", first, second)
    bends = np.einsum("svk,svk->sv", second, second)
    ceiling = limits.speed_m_s**2 / np.maximum(squares.max(axis=1), np.finfo(float).tiny)
    return float(_duration(squares, mixed, bends, ceiling, float(grid[1]), limits.acceleration_m_s2))


@kernel
def _duration(squares: Array, mixed: Array, bends: Array, ceiling: Array, step: float, limit: float) -> float:
    """Run the grid backwards, then forwards; coefficients of shape (S, V), result [s]."""
    count = squares.shape[0]
    reach = np.zeros(count)  # largest x from which the end can be reached
    for i in range(count - 2, -1, -1):
        low, high = 0.0, ceiling[i]
        for _ in range(HALVINGS):
            x = 0.5 * (low + high)
            least, most = _range(squares[i], mixed[i], bends[i], x, limit)
            least, most = max(least, -x / (2.0 * step)), min(most, (reach[i + 1] - x) / (2.0 * step))
            if least <= most:
                low = x
            else:
                high = x
        reach[i] = low
    x = 0.0
    duration = 0.0
    for i in range(count - 1):
        _, most = _range(squares[i], mixed[i], bends[i], x, limit)
        following = max(0.0, min(reach[i + 1], x + 2.0 * step * most))
        duration += 2.0 * step / max(math.sqrt(x) + math.sqrt(following), 1e-12)  # constant acceleration in between
        x = following
    return duration


@kernel
def _range(squares: Array, mixed: Array, bends: Array, x: float, limit: float) -> tuple[float, float]:
    """Path accelerations that keep every vehicle's norm at squared path speed ``x``; empty when the first is larger."""
    least, most = -math.inf, math.inf
    for v in range(squares.shape[0]):
        if squares[v] < 1e-18:  # this vehicle stands on the path
            if bends[v] * x * x > limit * limit:
                return 1.0, 0.0
            continue
        middle = -mixed[v] * x / squares[v]
        root = middle * middle - (bends[v] * x * x - limit * limit) / squares[v]
        if root < 0.0:
            return 1.0, 0.0
        half = math.sqrt(root)
        least, most = max(least, middle - half), min(most, middle + half)
    return least, most
