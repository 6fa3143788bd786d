"""The search of the free formulation, compiled: step with a working set, restoration, and the loop around them.

:mod:`fg_gcs.plan.free` explains the method. Places, moves and turns are in the axes of the template at the
iterate.
"""

from __future__ import annotations

import math

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.core.kernels import polygon_flux
from fg_gcs.plan.search.free_model import Shape, distance, distance_row, factor, held_rows, least_change, model
from fg_gcs.plan.search.steps import (
    ACCEPT,
    FOUND,
    NEAR_RIM,
    ON_RIM,
    TOO_MANY,
    TURN_RAD,
    longest_step,
    surrounds,
    turn_by,
)
from fg_gcs.plan.search.trust_region import gain, maximise_in_ball

BEND = 0.05  # largest change of shape in one step, as a share of the face's size: linearised edges hold that far
DEPARTURE = 0.15  # most that a leader departs from its slot, of the face's size: a face of any outline stays simple
NEAR_EDGE = 1e-7  # of the face's size: nearer to an edge the flux's derivative is lost in rounding
NORMAL_SHARE = 0.8  # of the region for reaching constraints, so that some is left for the flux ([Nocedal2006]_, 18.5)
EXACT = 1e-10  # of the face's size: error of an edge that no vehicle could notice, far above rounding
RESTORATIONS = 12  # Newton takes 3 or 4 on a shape that can be restored
STALLED = 1e-12  # share of the longest step below which rounding decides: no step will be accepted any more
STUCK = 1e-9  # gain by a turn, of the flux, that counts as none: a target close behind, where every turn loses


@kernel
def search(
    shape: Shape, centre: Array, rotation: Array, target: Array, frames: Array, departures: Array
) -> tuple[int, int, int]:
    """Fill frames and departures with the path up to where the target is surrounded.

    Args:
        shape: edges to hold and pairs to keep apart.
        centre: of the face at the start, shape (3,) [m].
        rotation: template axes to ENU at the start, shape (3, 3).
        target: shape (3,) [m].
        frames: room for the path, shape (K, 12): centre, rotation by rows.
        departures: room for the leaders' departures from their slots, shape (K, N, 3) [m; template].

    Returns:
        How it ended (FOUND, ON_RIM or TOO_MANY), the number of frames and the number of steps tried.
    """
    count = shape.edges_m.shape[0]
    centre, rotation = centre.copy(), rotation.copy()
    departure, moved = np.zeros((count, 3)), np.empty((count, 3))
    places = np.empty((count, 3))
    _keep(frames, departures, 0, centre, rotation, departure)
    kept, region, bound, supple = 1, 1.0, math.inf, True
    tipping = False  # turning against the flux, out of the place where it is highest among those turned away
    source = rotation.T @ (target - centre)
    bound = longest_step(_length(source), source[0], bound)
    for tried in range(frames.shape[0] - 1):
        _place(shape, departure, places)
        flux = polygon_flux(places, source)
        if surrounds(flux):
            return FOUND, kept, tried
        if _on_rim(places, source, shape.size_m):
            return ON_RIM, kept, tried
        first, last = (0, 2 * count if supple else 6) if flux > 0.0 else (3, 6)
        step, predicted = _best_step(shape, departure, places, source, first, last, region * bound)
        tipping = flux <= 0.0 and (tipping or predicted <= -STUCK * flux)
        if tipping and _length(source) <= shape.reach_m:
            return FOUND, kept, tried
        if tipping:
            step[3:6] = _tip(source, min(bound / shape.size_m, TURN_RAD))
        moved[:] = departure
        valid = last == 6 or _bend(shape, moved, step)
        turn = turn_by(step[3], step[4], step[5])
        _place(shape, moved, places)
        gained = polygon_flux(places, turn.T @ (source - step[:3])) - flux
        if not (tipping or (valid and predicted > 0.0 and gained > ACCEPT * predicted)):
            region *= 0.25
            if region < STALLED:
                return TOO_MANY, kept, tried
            supple = False  # the next try moves and turns the present shape: what bends promise and do not keep, it can
            continue
        centre = centre + rotation @ step[:3]
        rotation = rotation @ turn
        departure[:] = moved
        _keep(frames, departures, kept, centre, rotation, departure)
        kept, supple = kept + 1, True
        source = rotation.T @ (target - centre)
        region = min(1.0, 2.0 * region)
        bound = longest_step(_length(source), source[0], bound)
    return TOO_MANY, kept, frames.shape[0] - 1


@kernel
def restore(shape: Shape, departure: Array) -> bool:
    """Bring departures (N, 3) back, in place, to exact edges, frame and least distances; say whether that succeeded."""
    count = departure.shape[0]
    held, exact = count + 6, EXACT * shape.size_m
    change = np.empty(3 * count)
    watched = np.zeros(shape.pairs.shape[0], dtype=np.int64)  # once too close, held at the bound to the end
    for _ in range(RESTORATIONS):
        near = 0
        for pair in range(shape.pairs.shape[0]):
            if watched[pair] == 1 or distance(shape, departure, pair) < shape.least_m[pair] - exact:
                watched[pair] = 1
                near += 1
        if held + near > 3 * count:
            return False
        rows, errors = np.zeros((held + near, 3 * count)), np.zeros(held + near)
        held_rows(shape, departure, rows, errors)
        row = held
        for pair in range(shape.pairs.shape[0]):
            if watched[pair] == 1:
                errors[row] = distance_row(shape, departure, pair, rows[row]) - shape.least_m[pair]
                row += 1
        largest = 0.0
        for row in range(held + near):
            largest = max(largest, abs(errors[row]))
        if largest < exact:
            return True
        if not least_change(rows, factor(rows), errors, change):
            return False
        for i in range(count):
            for k in range(3):
                departure[i, k] -= change[3 * i + k]
    return False


@kernel
def _best_step(
    shape: Shape, departure: Array, places: Array, source: Array, first: int, last: int, size: float
) -> tuple[Array, float]:
    """Return the best step within ``size`` [m] as (move, turn, change of departures), (6 + 3 N,), and the gain.

    It is free in the dimensions from ``first`` to before ``last`` of (move, turn, bends).
    """
    count = departure.shape[0]
    gradient, hessian, basis = model(shape, departure, places, source)
    turn, bend = min(size / shape.size_m, TURN_RAD), math.sqrt(count) * min(size, BEND * shape.size_m)
    dofs = gradient.shape[0]
    for i in range(dofs):
        reach = size if i < 3 else turn if i < 6 else bend
        gradient[i] *= reach
        for j in range(dofs):
            hessian[i, j] *= reach
            hessian[j, i] *= reach
    step = np.zeros(6 + 3 * count)
    if last == 6:
        reduced_gradient, reduced_hessian = gradient[first:6].copy(), hessian[first:6, first:6].copy()
        unit = maximise_in_ball(reduced_gradient, reduced_hessian)
        for k in range(first, 6):
            step[k] = (size if k < 3 else turn) * unit[k - first]
        return step, gain(reduced_gradient, reduced_hessian, unit)
    unit = maximise_in_ball(gradient, hessian)
    bends = dofs - 6
    row = np.empty(3 * count)
    rows, gaps = np.zeros((bends, bends)), np.zeros(bends)  # working set: linearised distances by the unit of bends
    for active in range(bends + 1):
        for p in range(3 * count):
            total = 0.0
            for b in range(bends):
                total += basis[p, b] * unit[6 + b]
            step[6 + p] = bend * total
        worst = _closest(shape, departure, step)
        if worst < 0 or active == bends:
            break
        row[:] = 0.0
        gaps[active] = max(0.0, distance_row(shape, departure, worst, row) - shape.least_m[worst])
        for b in range(bends):
            for p in range(3 * count):
                rows[active, b] += bend * row[p] * basis[p, b]
        unit = _constrained(gradient, hessian, rows[: active + 1].copy(), gaps[: active + 1].copy())
    for k in range(3):
        step[k], step[3 + k] = size * unit[k], turn * unit[3 + k]
    return step, gain(gradient, hessian, unit)


@kernel
def _constrained(gradient: Array, hessian: Array, rows: Array, gaps: Array) -> Array:
    """Return the best step in the unit ball with ``rows @ bend = -gaps``: one normal, one in their kernel."""
    active, bends = rows.shape
    dofs = bends + 6
    axes = factor(rows)
    normal = np.zeros(dofs)
    length = 0.0
    reached = np.empty(bends)
    if least_change(rows, axes, gaps, reached):  # rows that depend: stay at these distances, do not reach the bounds
        for b in range(bends):
            normal[6 + b] = -reached[b]
            length += reached[b] ** 2
    length = math.sqrt(length)
    if length > NORMAL_SHARE:
        normal *= NORMAL_SHARE / length
        length = NORMAL_SHARE
    left = math.sqrt(1.0 - length * length)
    kernel = np.zeros((dofs, dofs - active))
    for k in range(6):
        kernel[k, k] = left
    for b in range(bends):
        for c in range(bends - active):
            kernel[6 + b, 6 + c] = left * axes[b, active + c]
    reduced_gradient = kernel.T @ (gradient + hessian @ normal)
    step: Array = normal + kernel @ maximise_in_ball(reduced_gradient, kernel.T @ (hessian @ kernel))
    return step


@kernel
def _closest(shape: Shape, departure: Array, step: Array) -> int:
    """Return the pair that a step brings furthest below its least distance, to first order; -1 if none."""
    count = departure.shape[0]
    worst, deepest = -1, -EXACT * shape.size_m
    for pair in range(shape.pairs.shape[0]):
        i, j = shape.pairs[pair]
        square = along = 0.0
        for k in range(3):
            apart, shift = shape.slots_m[j, k] - shape.slots_m[i, k] - departure[i, k], -step[6 + 3 * i + k]
            if j < count:
                apart += departure[j, k]
                shift += step[6 + 3 * j + k]
            square += apart * apart
            along += apart * shift
        slack = math.sqrt(square) - shape.least_m[pair] + along / math.sqrt(square)
        if slack < deepest and along < -EXACT * square:  # a pair at its bound that stays there is no obstacle
            worst, deepest = pair, slack
    return worst


@kernel
def _bend(shape: Shape, departure: Array, step: Array) -> bool:
    """Change the departures by a step, drawn in as a whole where one becomes too large; say whether a shape is left."""
    largest = 0.0
    for i in range(departure.shape[0]):
        square = 0.0
        for k in range(3):
            departure[i, k] += step[6 + 3 * i + k]
            square += departure[i, k] ** 2
        largest = max(largest, math.sqrt(square))
    if largest > DEPARTURE * shape.size_m:
        departure *= DEPARTURE * shape.size_m / largest
    return restore(shape, departure)


@kernel
def _place(shape: Shape, departure: Array, places: Array) -> None:
    for i in range(departure.shape[0]):
        for k in range(3):
            places[i, k] = shape.slots_m[i, k] + departure[i, k]


@kernel
def _on_rim(places: Array, source: Array, size: float) -> bool:
    """Say whether the source lies where the flux has no derivative: at a leader, or exactly on an edge."""
    for i in range(places.shape[0]):
        j = (i + 1) % places.shape[0]
        away = edge = along = 0.0
        for k in range(3):
            away += (source[k] - places[i, k]) ** 2
            edge += (places[j, k] - places[i, k]) ** 2
            along += (source[k] - places[i, k]) * (places[j, k] - places[i, k])
        if away < (NEAR_RIM * size) ** 2:
            return True
        if 0.0 < along < edge and away - along * along / edge < (NEAR_EDGE * size) ** 2:
            return True
    return False


@kernel
def _tip(source: Array, angle: float) -> Array:
    """Return the turn that brings the face's normal (x) nearer to the source; about y where it is exactly behind."""
    y, z = -source[2], source[1]
    length = math.sqrt(y * y + z * z)
    if length <= EXACT * abs(source[0]):
        return np.array([0.0, angle, 0.0])
    return np.array([0.0, angle * y / length, angle * z / length])


@kernel
def _keep(frames: Array, departures: Array, row: int, centre: Array, rotation: Array, departure: Array) -> None:
    for i in range(3):
        frames[row, i] = centre[i]
        for k in range(3):
            frames[row, 3 + 3 * i + k] = rotation[i, k]
    departures[row] = departure


@kernel
def _length(vector: Array) -> float:
    return math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
