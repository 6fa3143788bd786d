"""The model of the free formulation, compiled: flux, edges, frame and distances by the leaders' departures.

:mod:`fg_gcs.plan.free` explains the method. Everything is in the axes of the template at the iterate, so that far
targets leave no large numbers to cancel. The linear algebra is small and written out: it compiles faster so.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.core.kernels import edge_derivatives

Indices = NDArray[np.int64]

DEPENDENT = 1e-9  # pivot, as a share of its row's length, below which rows depend on each other


class Shape(NamedTuple):
    """What the leaders' departures from their slots must keep."""

    slots_m: Array  # (V, 3) leaders first
    edges_m: Array  # (N,) lengths, edge e from leader e to e + 1
    pairs: Indices  # (P, 2) pairs of vehicles to keep apart, the first of each a leader
    least_m: Array  # (P,) their least distances
    size_m: float  # root mean square distance of the leaders from the centre
    reach_m: float  # largest distance of a vehicle from the centre


@kernel
def model(shape: Shape, departure: Array, places: Array, source: Array) -> tuple[Array, Array, Array]:
    """Return gradient (6 + B,) and Hessian of the flux by move, turn and bend, and the basis of bends (3 N, B).

    Bends are the changes of shape that keep edges and frame to first order. The derivatives are those of the Lagrangian
    with the multipliers of the edges: what the restoration of the edges does to second order is in the Hessian.
    """
    count = departure.shape[0]
    place_gradient, curvature = np.zeros(3 * count), np.zeros((3 * count, 3 * count))
    _flux_derivatives(places, source, place_gradient, curvature)
    held, bends = count + 6, 2 * count - 6
    rows, errors = np.zeros((held, 3 * count)), np.zeros(held)
    held_rows(shape, departure, rows, errors)
    axes = factor(rows)
    basis = axes[:, held:].copy()
    ways = np.zeros((3 * count, 6 + bends))
    for i in range(count):
        x, y, z = places[i]
        for k in range(3):
            ways[3 * i + k, k] = 1.0
            for b in range(bends):
                ways[3 * i + k, 6 + b] = basis[3 * i + k, b]
        ways[3 * i, 4], ways[3 * i, 5] = z, -y  # turn x place
        ways[3 * i + 1, 3], ways[3 * i + 1, 5] = -z, x
        ways[3 * i + 2, 3], ways[3 * i + 2, 4] = y, -x
    _hold_edges(shape, rows, axes, place_gradient, curvature)
    hessian = ways.T @ (curvature @ ways)
    _turn_curvature(places, place_gradient, ways, hessian)
    return ways.T @ place_gradient, hessian, basis


@kernel
def _flux_derivatives(places: Array, source: Array, place_gradient: Array, curvature: Array) -> None:
    """Add gradient (3 N,) and Hessian (3 N, 3 N) of the flux by all leaders' places."""
    count = places.shape[0]
    out = np.empty((14, 3))
    sx, sy, sz = source
    for i in range(count):
        j = (i + 1) % count
        ax, ay, az = places[i]
        bx, by, bz = places[j]
        edge_derivatives(ax - sx, ay - sy, az - sz, bx - sx, by - sy, bz - sz, out)
        for p in range(3):
            place_gradient[3 * i + p] += out[0, p]
            place_gradient[3 * j + p] += out[1, p]
            for q in range(3):
                curvature[3 * i + p, 3 * i + q] += out[2 + p, q]
                curvature[3 * i + p, 3 * j + q] += out[5 + p, q]
                curvature[3 * j + p, 3 * i + q] += out[8 + p, q]
                curvature[3 * j + p, 3 * j + q] += out[11 + p, q]


@kernel
def held_rows(shape: Shape, departure: Array, rows: Array, errors: Array) -> None:
    """Fill the first N + 6 rows by what departures must not change (edges, sums, moments), and the errors."""
    count = departure.shape[0]
    share = 1.0 / math.sqrt(count)
    for i in range(count):
        j = (i + 1) % count
        square = 0.0
        for k in range(3):
            apart = shape.slots_m[j, k] + departure[j, k] - shape.slots_m[i, k] - departure[i, k]
            rows[i, 3 * j + k] = apart / shape.edges_m[i]
            rows[i, 3 * i + k] = -apart / shape.edges_m[i]
            rows[count + k, 3 * i + k] = share
            square += apart * apart
        errors[i] = 0.5 * (square / shape.edges_m[i] - shape.edges_m[i])
        x, y, z = shape.slots_m[i] * (share / shape.size_m)
        rows[count + 3, 3 * i + 1], rows[count + 3, 3 * i + 2] = -z, y  # slot x departure
        rows[count + 4, 3 * i], rows[count + 4, 3 * i + 2] = z, -x
        rows[count + 5, 3 * i], rows[count + 5, 3 * i + 1] = -y, x
    for row in range(count, count + 6):
        for i in range(count):
            for k in range(3):
                errors[row] += rows[row, 3 * i + k] * departure[i, k]


@kernel
def _hold_edges(shape: Shape, rows: Array, axes: Array, place_gradient: Array, curvature: Array) -> None:
    """Turn the flux's derivatives into those of the Lagrangian, least-squares multipliers of the edges."""
    count, held, size = shape.edges_m.shape[0], rows.shape[0], rows.shape[1]
    multipliers = np.zeros(held)
    for row in range(held - 1, -1, -1):  # the rows are lower triangular along the axes
        pivot = 0.0
        for p in range(size):
            multipliers[row] += axes[p, row] * place_gradient[p]
            pivot += rows[row, p] * axes[p, row]
        for later in range(row + 1, held):
            along = 0.0
            for p in range(size):
                along += rows[later, p] * axes[p, row]
            multipliers[row] -= along * multipliers[later]
        multipliers[row] /= pivot
    for i in range(count):
        j = (i + 1) % count
        stiffness = multipliers[i] / shape.edges_m[i]
        for p in range(size):
            place_gradient[p] -= multipliers[i] * rows[i, p]
        for k in range(3):
            curvature[3 * i + k, 3 * i + k] -= stiffness
            curvature[3 * j + k, 3 * j + k] -= stiffness
            curvature[3 * i + k, 3 * j + k] += stiffness
            curvature[3 * j + k, 3 * i + k] += stiffness


@kernel
def _turn_curvature(places: Array, place_gradient: Array, ways: Array, hessian: Array) -> None:
    """Add what turns do to second order: they bend, ``w x p + w x (w x p) / 2``, and they turn the bends."""
    for i in range(places.shape[0]):
        gx, gy, gz = place_gradient[3 * i], place_gradient[3 * i + 1], place_gradient[3 * i + 2]
        straight = places[i, 0] * gx + places[i, 1] * gy + places[i, 2] * gz
        for p in range(3):
            for q in range(3):
                mixed = places[i, p] * place_gradient[3 * i + q] + place_gradient[3 * i + p] * places[i, q]
                hessian[3 + p, 3 + q] += 0.5 * mixed
            hessian[3 + p, 3 + p] -= straight
        for b in range(6, hessian.shape[0]):
            bx, by, bz = ways[3 * i, b], ways[3 * i + 1, b], ways[3 * i + 2, b]
            swung = (by * gz - bz * gy, bz * gx - bx * gz, bx * gy - by * gx)
            for p in range(3):
                hessian[3 + p, b] += swung[p]
                hessian[b, 3 + p] += swung[p]


@kernel
def distance(shape: Shape, departure: Array, pair: int) -> float:
    """Return the distance of a pair, by its row in the shape [m]."""
    i, j = shape.pairs[pair]
    square = 0.0
    for k in range(3):
        apart = shape.slots_m[j, k] - shape.slots_m[i, k] - departure[i, k]
        if j < departure.shape[0]:
            apart += departure[j, k]
        square += apart * apart
    return math.sqrt(square)


@kernel
def distance_row(shape: Shape, departure: Array, pair: int, row: Array) -> float:
    """Return a pair's distance and fill its derivative by the departures, shape (3 N,)."""
    i, j = shape.pairs[pair]
    length = distance(shape, departure, pair)
    for k in range(3):
        apart = shape.slots_m[j, k] - shape.slots_m[i, k] - departure[i, k]
        if j < departure.shape[0]:
            apart += departure[j, k]
            row[3 * j + k] = apart / length
        row[3 * i + k] = -apart / length
    return length


@kernel
def factor(rows: Array) -> Array:
    """Return orthonormal axes as columns (n, n), by Householder; the rows (k, n) are lower triangular along them.

    The last n - k axes span what the rows do not see.
    """
    count, size = rows.shape
    work, axes = rows.copy(), np.eye(size)
    mirror = np.empty(size)
    for r in range(count):
        square = 0.0
        for p in range(r, size):
            mirror[p] = work[r, p]
            square += work[r, p] ** 2
        mirror[r] += math.copysign(math.sqrt(square), work[r, r])
        square += mirror[r] ** 2 - work[r, r] ** 2
        if square == 0.0:
            continue
        for table in (work, axes):
            for i in range(table.shape[0]):
                along = 0.0
                for p in range(r, size):
                    along += table[i, p] * mirror[p]
                along *= 2.0 / square
                for p in range(r, size):
                    table[i, p] -= along * mirror[p]
    return axes


@kernel
def least_change(rows: Array, axes: Array, wanted: Array, out: Array) -> bool:
    """Fill the least ``x`` with ``rows @ x = wanted``; False when the rows depend on each other."""
    count, size = rows.shape
    out[:] = 0.0
    for r in range(count):
        pivot, left, length = 0.0, wanted[r], 0.0
        for p in range(size):
            pivot += rows[r, p] * axes[p, r]
            left -= rows[r, p] * out[p]
            length += rows[r, p] ** 2
        if abs(pivot) <= DEPENDENT * math.sqrt(length):
            return False
        for p in range(size):
            out[p] += left / pivot * axes[p, r]
    return True
