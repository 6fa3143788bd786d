"""Time-optimal timing of a swarm's path under norm limits, by reachability analysis [Pham2018]_, with exact discs.

With path speed ``s'`` and path acceleration ``s''`` a vehicle moves at ``q' s'`` and accelerates by ``q' s'' + q''
s'^2``. In ``u = s''`` and ``x = s'^2``, constant ``u`` within a cell of the grid makes ``x`` linear in ``s``, and

- the speed norm bounds ``x <= speed^2 / |q'|^2``; climb and descent bound ``x`` through ``q'_z`` alike;
- the acceleration norm is a disc in the plane of ``q'`` and ``q''``: ``|q' u + q'' x| <= a``. For a given ``x`` it
  leaves ``u`` the interval ``m x -+ sqrt(b - r x^2)`` with ``m = -q'.q'' / |q'|^2``, ``b = a^2 / |q'|^2`` and ``r =
  |q''|^2 / |q'|^2 - m^2``: exact, where linear programmes need polygons.

A cell keeps its limits at its start, middle and end, where ``x`` is ``x_i + 2 d u``. The set of (u, x) that all
vehicles allow is convex and holds (0, 0). So going backwards the largest ``x`` from which the next cell can still be
entered is the least of what each disc allows alone, which has a closed form, unless two discs exclude each other
there: then it is found by bisection. Going forwards the largest ``u`` that stays within is taken. All vehicles share
``u`` and ``x``, so the formation stays in step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.errors import PlanError
from fg_gcs.plan.limits import Limits
from fg_gcs.plan.path.swarm_path import SwarmPath

BENDING = 0.5  # share of the jerk that bends of the path may take; the rest is left to changes of speed
GRID_M = 0.1  # spacing of the grid along the path; halving it shortens the paper's flights by less than 0.5 %
GRID_POINTS = (40, 250)  # fewer make the bang-bang switch coarse, more cost time without gain
AT = 3  # places of a cell where its limits hold: start, middle, end
HALVINGS = 26  # where discs exclude each other: to a hundred-millionth of the squared speed
SAME = 1e-9  # share by which a speed may exceed its bound: rounding of one that a plan before this one ended with
FOREVER_S = 1e6  # eleven days: a timing that takes longer has come to a stand on the way
BRAKING = 0.5  # share of the acceleration limit that lowered limits are approached with: the other half is for bends


class Timing(NamedTuple):
    """Path speed at grid points; between them the path acceleration is constant."""

    s_m: Array  # (S,) ascending
    speed: Array  # (S,) ds/dt >= 0 [m/s]
    time_s: Array  # (S,) ascending from 0


class Bound(NamedTuple):
    """Which limit of which vehicle is the strictest on a path flown at constant path speed, and where."""

    speed: float  # the path speed that it allows [m/s]
    s_m: float
    vehicle: int  # index
    name: str  # field of the limits
    limit: float

    def __str__(self) -> str:
        """Say so; vehicles are counted from 1."""
        return f"vehicle {self.vehicle + 1} may pass at {self.speed:.3g} m/s at most ({self.name} {self.limit:g})"


def time_optimal(
    path: SwarmPath,
    limits: Limits,
    start_speed: float = 0.0,
    end_speed: float = 0.0,
    leads_m: tuple[float, float] = (0.0, 0.0),
    cruise: Limits | None = None,
) -> Timing:
    """Return the fastest timing of a path.

    Args:
        path: the swarm's path.
        limits: of every vehicle.
        start_speed: path speed at the start [m/s].
        end_speed: path speed at the end [m/s].
        leads_m: how much of the path's start and end is left out of the timing, because it is passed at constant
            speed there, >= 0, together less than the path [m].
        cruise: lower limits, kept wherever the speeds at both ends leave time to brake to them; None: the same.

    Raises:
        PlanError: no timing keeps the limits; the text says where, by which limit of which vehicle (counted from 1),
            and how fast start or end may be.
    """
    if path.length_m == 0.0:  # every vehicle is where it should be: nothing to do, in no time
        return Timing(np.zeros(2), np.zeros(2), np.zeros(2))
    _check_lead(path, limits, start_speed, 0.0, leads_m[0])
    _check_lead(path, limits, end_speed, path.length_m - leads_m[1], path.length_m)
    fine = fine_grid(path, leads_m)
    grid = fine[::2].copy()
    _, first, second = path.outline.at(fine)
    ceiling = _ceilings(first, limits.speed_m_s, limits.climb_m_s, limits.descent_m_s)
    if math.isfinite(limits.jerk_m_s3):
        _lower_for_jerk(fine, second, BENDING * limits.jerk_m_s3, ceiling)
    acceleration = limits.acceleration_m_s2
    if cruise is not None:
        lowered = _ceilings(first, cruise.speed_m_s, cruise.climb_m_s, cruise.descent_m_s)
        ceiling = _approached(grid, ceiling, lowered, start_speed, end_speed, BRAKING * acceleration)
        acceleration = cruise.acceleration_m_s2
    discs = _discs(grid, first, second, acceleration, ceiling)
    reachable, squares = _reach(grid, discs, ceiling, start_speed**2, end_speed**2)
    if start_speed**2 > reachable[0] * (1.0 + SAME):
        stuck_m = float(grid[_stuck(grid, discs, ceiling, start_speed**2)])
        raise _cannot_start(path, limits, stuck_m, (start_speed, end_speed), math.sqrt(reachable[0]))
    if end_speed**2 > squares[-1] * (1.0 + SAME):
        raise _cannot_end(path, limits, end_speed, math.sqrt(reachable[-1]), math.sqrt(squares[-1]))
    speed, time_s = _times(grid, squares)
    if not time_s[-1] < FOREVER_S:
        bound = strictest(path, grid[1:-1], limits)
        raise PlanError(
            "the path cannot be timed under the limits, the swarm would come to a stand on the way: "
            f"at {bound.s_m:.1f} m of it {bound}; raise that limit"
        )
    return Timing(grid, speed, time_s)


def fine_grid(path: SwarmPath, leads_m: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Return grid points of a path without its leads, and the middles between them, shape (2 S - 1,) [m].

    The path's knots are grid points: within a cell everything is smooth.
    """
    length_m = path.length_m
    spacing_m = length_m / min(max(length_m / GRID_M, GRID_POINTS[0]), GRID_POINTS[1])
    return _divided(path.knots_m, leads_m[0], length_m - leads_m[1], spacing_m)


def strictest(path: SwarmPath, s_m: Array, limits: Limits) -> Bound:
    """Return the limit that allows the least constant path speed at any of the places ``s_m``, shape (S,)."""
    _, first, second = path.at(s_m)
    allowed = {  # (S, V) each; no vehicle moves less than a picometre a metre
        "speed_m_s": limits.speed_m_s / np.maximum(np.linalg.norm(first, axis=2), 1e-12),
        "acceleration_m_s2": np.sqrt(limits.acceleration_m_s2 / np.maximum(np.linalg.norm(second, axis=2), 1e-12)),
        "climb_m_s": limits.climb_m_s / np.maximum(first[:, :, 2], 1e-12),
        "descent_m_s": limits.descent_m_s / np.maximum(-first[:, :, 2], 1e-12),
    }
    name = min(allowed, key=lambda each: float(allowed[each].min()))
    place, vehicle = np.unravel_index(int(allowed[name].argmin()), first.shape[:2])
    speed = float(allowed[name][place, vehicle])
    return Bound(speed, float(s_m[place]), int(vehicle), name, getattr(limits, name))


def _check_lead(path: SwarmPath, limits: Limits, speed: float, low_m: float, high_m: float) -> None:
    """Refuse a stretch that cannot be passed at a constant speed."""
    if low_m == high_m:
        return
    bound = strictest(path, np.linspace(low_m, high_m, int(np.ceil((high_m - low_m) / GRID_M)) + 1), limits)
    if speed > bound.speed * (1.0 + SAME):
        raise PlanError(
            f"the path cannot be passed at {speed:.2f} m/s from {low_m:.2f} m to {high_m:.2f} m of its way, where "
            f"accelerations are blended: at {bound.s_m:.2f} m {bound}; {'end' if low_m else 'start'} "
            f"at {bound.speed:.2f} m/s or slower"
        )


def _cannot_start(
    path: SwarmPath, limits: Limits, stuck_m: float, speeds: tuple[float, float], slower: float
) -> PlanError:
    """Say why no vehicle can be as fast at the start, and how fast they may be."""
    bound = strictest(path, np.array([stuck_m]), limits)
    if bound.speed < speeds[0]:
        why = (
            f"from {speeds[0]:.2f} m/s no vehicle can brake in time for the place {stuck_m:.1f} m along, where {bound}"
        )
    else:
        mover = _furthest(path, stuck_m)
        why = (
            f"vehicle {mover + 1} cannot brake from {speeds[0]:.2f} to {speeds[1]:.2f} m/s within {stuck_m:.1f} m "
            f"(acceleration_m_s2 {limits.acceleration_m_s2:g})"
        )
    return PlanError(f"the path cannot be timed under the limits: {why}; start at {slower:.2f} m/s or slower")


def _cannot_end(path: SwarmPath, limits: Limits, speed: float, allowed: float, reached: float) -> PlanError:
    """Say why no vehicle can be as fast at the end, and how fast they may be."""
    if allowed < speed * (1.0 - SAME):
        why = f"{strictest(path, np.array([path.length_m]), limits)}, not at {speed:.2f} m/s"
    else:
        why = (
            f"vehicle {_furthest(path, path.length_m) + 1} cannot be at {speed:.2f} m/s yet "
            f"(acceleration_m_s2 {limits.acceleration_m_s2:g})"
        )
    return PlanError(
        f"the path cannot be timed under the limits: at its end, {path.length_m:.1f} m along, {why}; "
        f"end at {reached:.2f} m/s or slower"
    )


def _furthest(path: SwarmPath, s_m: float) -> int:
    """Index of the vehicle that moves furthest with the parameter, and so needs the most of its acceleration."""
    return int(np.linalg.norm(path.at(np.array([s_m])).first[0], axis=1).argmax())


@kernel
def _divided(knots: Array, start: float, end: float, spacing: float) -> Array:
    """Grid points from start to end and their middles: the knots in between, and even parts of what lies between."""
    corners = np.empty(len(knots) + 1)
    corners[0], count = start, 1
    for knot in knots:
        if start < knot < end:
            corners[count] = knot
            count += 1
    corners[count] = end
    parts = np.ceil(np.diff(corners[: count + 1]) / spacing).astype(np.int64)
    fine = np.empty(2 * parts.sum() + 1)
    row = 0
    for i in range(count):
        step = (corners[i + 1] - corners[i]) / (2 * parts[i])
        for part in range(2 * parts[i]):
            fine[row] = corners[i] + part * step
            row += 1
    fine[row] = end
    return fine


@kernel
def _ceilings(first: Array, speed: float, climb: float, descent: float) -> Array:
    """Largest squared path speed at grid points that no vehicle's speed, climb or descent limit forbids, (S,)."""
    count = (len(first) + 1) // 2
    bound = np.empty(count)
    for i in range(count):
        needed2 = 1e-18  # a swarm that stands still may pass at a billion metres a second
        for v in range(first.shape[1]):
            x, y, z = first[2 * i, v, 0], first[2 * i, v, 1], first[2 * i, v, 2]
            upright = max(z / climb, -z / descent)
            needed2 = max(needed2, (x * x + y * y + z * z) / (speed * speed), upright * upright)
        bound[i] = 1.0 / needed2
    return bound


@kernel
def _lower_for_jerk(fine: Array, second: Array, jerk: float, ceiling: Array) -> None:
    """Lower the ceilings, (S,), to where a constant path speed ``v`` keeps the jerk ``|q'''| v^3`` of the bends."""
    for i in range(len(ceiling)):
        first, last = max(2 * i - 1, 0), min(2 * i + 1, len(fine) - 1)
        third2 = 1e-24
        for v in range(second.shape[1]):
            change2 = 0.0
            for k in range(3):
                change2 += (second[last, v, k] - second[first, v, k]) ** 2
            third2 = max(third2, change2 / (fine[last] - fine[first]) ** 2)
        ceiling[i] = min(ceiling[i], (jerk * jerk / third2) ** (1.0 / 3.0))


@kernel
def _approached(grid: Array, ceiling: Array, lowered: Array, start: float, end: float, braking: float) -> Array:
    """Lowered ceilings, raised to what a steady braking from the start's and to the end's speed needs, (S,)."""
    raised = np.empty(len(grid))
    for i in range(len(grid)):
        from_start = start * start - 2.0 * braking * (grid[i] - grid[0])
        to_end = end * end - 2.0 * braking * (grid[-1] - grid[i])
        raised[i] = min(ceiling[i], max(lowered[i], from_start, to_end))
    return raised


@kernel
def _discs(grid: Array, first: Array, second: Array, limit: float, ceiling: Array) -> Array:
    """The numbers m, b, r of all discs of every cell, (S - 1, 3 V, 3); lowers the ceiling to where they all exist.

    A vehicle that does not move with the parameter leaves ``u`` free.
    """
    cells, vehicles = len(grid) - 1, first.shape[1]
    discs = np.empty((cells, AT * vehicles, 3))
    for i in range(cells):
        highest2 = ceiling[i] * ceiling[i]
        for place in range(AT):
            at, ahead = 2 * i + place, place * (grid[i + 1] - grid[i])
            for v in range(vehicles):
                pp, ps, ss = 0.0, 0.0, 0.0
                for k in range(3):
                    s = second[at, v, k]
                    p = first[at, v, k] + ahead * s  # x grows by 2 u times the way into the cell
                    pp += p * p
                    ps += p * s
                    ss += s * s
                row = place * vehicles + v
                if pp < 1e-24:  # a picometre a metre: it stands
                    m, b, r = 0.0, 1e24 * limit * limit, 1e24 * ss
                else:
                    m, b = -ps / pp, limit * limit / pp
                    r = max(ss / pp - m * m, 0.0)
                discs[i, row, 0], discs[i, row, 1], discs[i, row, 2] = m, b, r
                if b < r * highest2:
                    highest2 = b / r
        ceiling[i] = min(ceiling[i], math.sqrt(highest2))
    return discs


@kernel
def _reach(grid: Array, discs: Array, ceiling: Array, start: float, end: float) -> tuple[Array, Array]:
    """Largest squared path speeds from which the end can be reached, and those of the fastest way, (S,) each."""
    count = len(grid)
    reachable, squares = np.empty(count), np.empty(count)
    reachable[count - 1] = min(end, ceiling[count - 1])
    for i in range(count - 2, -1, -1):
        reachable[i] = _entering(discs, i, 2.0 * (grid[i + 1] - grid[i]), ceiling[i], reachable[i + 1])
    squares[0] = min(start, reachable[0])
    for i in range(count - 1):
        width2 = 2.0 * (grid[i + 1] - grid[i])
        _, largest = _interval(discs, i, squares[i])
        squares[i + 1] = max(0.0, min(squares[i] + width2 * largest, reachable[i + 1]))
    return reachable, squares


@kernel
def _entering(discs: Array, i: int, width2: float, highest: float, reachable: float) -> float:
    """Largest squared speed at the start of cell ``i``, twice as wide, from which ``reachable`` is met at its end.

    The least ``u`` of a disc has to be at most ``(reachable - x) / width2``: with ``k = m + 1 / width2`` and ``c =
    reachable / width2`` that is ``k x - c <= sqrt(b - r x^2)``, a convex condition that holds at 0. So ``x`` may go up
    to the larger root of ``(k^2 + r) x^2 - 2 k c x + c^2 = b``.
    """
    x, c = highest, reachable / width2
    for row in range(discs.shape[1]):
        b, r = discs[i, row, 1], discs[i, row, 2]
        k = discs[i, row, 0] + 1.0 / width2
        over = k * x - c
        if over > 0.0 and over * over > b - r * x * x:
            square = k * k + r
            x = (k * c + math.sqrt(max(b * square - r * c * c, 0.0))) / square
    if _passable(discs, i, width2, x):
        return x
    low, high = 0.0, x
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _passable(discs, i, width2, middle):
            low = middle
        else:
            high = middle
    return low


@kernel
def _passable(discs: Array, i: int, width2: float, x: float) -> bool:
    """Say whether the discs of cell ``i`` leave any path acceleration, and one that does not end backwards."""
    least, largest = _interval(discs, i, x)
    return least <= largest and x + width2 * largest >= 0.0


@kernel
def _interval(discs: Array, i: int, x: float) -> tuple[float, float]:
    """Path accelerations that keep every vehicle's norm at start, middle and end of cell ``i``."""
    least, largest = -np.inf, np.inf
    for row in range(discs.shape[1]):
        middle = discs[i, row, 0] * x
        half = math.sqrt(max(discs[i, row, 1] - discs[i, row, 2] * x * x, 0.0))
        least, largest = max(least, middle - half), min(largest, middle + half)
    return least, largest


@kernel
def _stuck(grid: Array, discs: Array, ceiling: Array, start: float) -> int:
    """Index of the grid point that is too fast after the hardest braking from a squared speed; else the last one."""
    x = start
    for i in range(len(grid) - 1):
        least, largest = _interval(discs, i, x)
        if x > ceiling[i] or least > largest:
            return i
        x = max(0.0, x + 2.0 * (grid[i + 1] - grid[i]) * least)
    return len(grid) - 1


@kernel
def _times(grid: Array, squares: Array) -> tuple[Array, Array]:
    """Path speeds and times at the grid points, (S,) each."""
    speed, time = np.sqrt(squares), np.zeros(len(grid))
    for i in range(1, len(grid)):
        mean = max(0.5 * (speed[i - 1] + speed[i]), 1e-300)  # no division by zero where the swarm stands
        time[i] = time[i - 1] + (grid[i] - grid[i - 1]) / mean
    return speed, time
