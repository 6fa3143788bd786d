"""Time-optimal timing of a swarm's path under norm limits, by reachability analysis [Pham2018]_, with exact discs.

With path speed ``s'`` and path acceleration ``s''`` a vehicle moves at ``q' s'`` and accelerates by ``q' s'' + q''
s'^2``. In ``u = s''`` and ``x = s'^2``, constant ``u`` within a cell of the grid makes ``x`` linear in ``s``, and

- the speed norm bounds ``x <= speed^2 / |q'|^2``; climb and descent bound ``x`` through ``q'_z`` alike;
- the acceleration norm is a disc in the plane of ``q'`` and ``q''``. For a given ``x`` it leaves ``u`` an interval
  whose ends are the roots of ``|q'|^2 u^2 + 2 q'.q'' x u + |q''|^2 x^2 = a^2``: exact, where linear programmes need
  polygons.

A cell keeps its limits at its start, middle and end, where ``x`` is ``x_i + 2 d u``. The set of (u, x) that all
vehicles allow is convex and holds (0, 0), so going backwards the largest ``x`` from which the next cell can still be
entered is found by bisection; going forwards the largest ``u`` that stays within is taken. All vehicles share ``u``
and ``x``, so the formation stays in step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fg_gcs.errors import PlanError
from fg_gcs.plan.limits import Limits
from fg_gcs.plan.paths import SwarmPath

Array = NDArray[np.float64]

GRID_M = 0.1  # spacing of the grid along the path; halving it shortens the paper's flights by less than 0.5 %
GRID_POINTS = (40, 250)  # fewer make the bang-bang switch coarse, more cost time without gain
AT = 3  # places of a cell where its limits hold: start, middle, end


class Timing(NamedTuple):
    """Path speed at grid points; between them the path acceleration is constant."""

    s_m: Array  # (S,) ascending from 0
    speed: Array  # (S,) ds/dt >= 0 [m/s]
    time_s: Array  # (S,) ascending from 0


def time_optimal(path: SwarmPath, limits: Limits, start_speed: float = 0.0, end_speed: float = 0.0) -> Timing:
    """Return the fastest timing of a path.

    Args:
        path: the swarm's path.
        limits: of every vehicle.
        start_speed: path speed at the start [m/s]; the limits may force a lower one only by an error.
        end_speed: path speed at the end [m/s].

    Raises:
        PlanError: no timing keeps the limits; the text says where the path stops being passable.
    """
    if path.length_m == 0.0:  # everybody is where it should be: nothing to do, in no time
        return Timing(np.zeros(2), np.zeros(2), np.zeros(2))
    grid = grid_of(path)
    _, first, second = path.outline.at(_with_middles(grid))
    ceiling = _squared_speed_bound(first[::2], limits)
    squares = _reach(grid, first, second, ceiling, limits.acceleration_m_s2, start_speed**2, end_speed**2)
    if np.isnan(squares[-1]):
        stuck_m = grid[int(np.flatnonzero(np.isnan(squares))[0])]
        raise PlanError(f"the path cannot be timed under the limits: nothing fits at {stuck_m:.1f} m of its way")
    speed = np.sqrt(squares)
    steps = np.diff(grid) / np.maximum(0.5 * (speed[:-1] + speed[1:]), np.finfo(float).tiny)
    time_s = np.concatenate(([0.0], np.cumsum(steps)))
    if not time_s[-1] < 1e6:  # eleven days: the timing came to a stand on the way
        raise PlanError("the path cannot be timed under the limits: the swarm would come to a stand on the way")
    return Timing(grid, speed, time_s)


def grid_of(path: SwarmPath) -> Array:
    """Return grid points, the path's knots among them: within a cell everything is smooth, shape (S,) [m]."""
    knots = path.knots_m
    spacing_m = path.length_m / np.clip(path.length_m / GRID_M, *GRID_POINTS)
    cells = np.ceil(np.diff(knots) / spacing_m).astype(int)
    starts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(knots, knots[1:], cells, strict=False)]
    return np.concatenate((*starts, knots[-1:]))


def _with_middles(grid: Array) -> Array:
    fine = np.empty(2 * len(grid) - 1)
    fine[::2] = grid
    fine[1::2] = 0.5 * (grid[:-1] + grid[1:])
    return fine


def _squared_speed_bound(first: Array, limits: Limits) -> Array:
    """Largest squared path speed that no vehicle's speed, climb or descent limit forbids; (S, V, 3) to (S,)."""
    needs = np.stack(
        (
            np.sqrt(np.einsum("svk,svk->sv", first, first)) / limits.speed_m_s,
            first[:, :, 2] / limits.climb_m_s,
            -first[:, :, 2] / limits.descent_m_s,
        )
    )
    bound: Array = 1.0 / np.maximum(needs.max(axis=(0, 2)), 1e-9) ** 2
    return bound


@njit(cache=True)
def _reach(grid: Array, first: Array, second: Array, ceiling: Array, limit: float, start: float, end: float) -> Array:
    """Squared path speeds at the grid points, shape (S,); NaN from where the path stops being passable."""
    count = len(grid)
    squares = np.full(count, np.nan)
    reachable = np.empty(count)
    reachable[count - 1] = min(end, ceiling[count - 1])
    for i in range(count - 2, -1, -1):
        width = grid[i + 1] - grid[i]
        if _entered(ceiling[i], i, width, first, second, limit, reachable[i + 1]):
            reachable[i] = ceiling[i]
            continue
        low, high = 0.0, ceiling[i]
        for _ in range(26):  # to a hundred-millionth of the ceiling
            middle = 0.5 * (low + high)
            if _entered(middle, i, width, first, second, limit, reachable[i + 1]):
                low = middle
            else:
                high = middle
        reachable[i] = low
    if start > reachable[0] * (1.0 + 1e-9) + 1e-12:  # rounding of a speed that a plan before this one ended with
        return squares
    squares[0] = min(start, reachable[0])
    for i in range(count - 1):
        width = grid[i + 1] - grid[i]
        least, largest = _interval(squares[i], i, width, first, second, limit)
        wanted = min(largest, (reachable[i + 1] - squares[i]) / (2.0 * width))
        if wanted < least - 1e-6 * limit:  # more than rounding
            return squares
        squares[i + 1] = max(0.0, squares[i] + 2.0 * width * wanted)
    return squares


@njit(cache=True)
def _entered(x: float, i: int, width: float, first: Array, second: Array, limit: float, reachable: float) -> bool:
    """Say whether the next grid point can be reached in time from squared speed ``x`` at point ``i``."""
    least, largest = _interval(x, i, width, first, second, limit)
    return least <= largest and x + 2.0 * width * least <= reachable and x + 2.0 * width * largest >= 0.0


@njit(cache=True)
def _interval(x: float, i: int, width: float, first: Array, second: Array, limit: float) -> tuple[float, float]:
    """Path accelerations that keep every vehicle's norm at start, middle and end of cell ``i``; empty: (1, -1)."""
    least, largest = -np.inf, np.inf
    for place in range(AT):
        at, ahead = 2 * i + place, place * width  # x grows by 2 u times half a width a place
        for v in range(first.shape[1]):
            pp, ps, ss = 0.0, 0.0, 0.0
            for k in range(3):
                s = second[at, v, k]
                p = first[at, v, k] + ahead * s
                pp += p * p
                ps += p * s
                ss += s * s
            rest = ss * x * x - limit * limit
            if pp < 1e-24:  # a vehicle that does not move with the parameter here
                if rest > 0.0:
                    return 1.0, -1.0
                continue
            root = ps * x * ps * x - pp * rest
            if root < 0.0:
                return 1.0, -1.0
            root = math.sqrt(root)
            least = max(least, (-ps * x - root) / pp)
            largest = min(largest, (-ps * x + root) / pp)
    return least, largest
