"""Which vehicles came how close to each other: machine code over all pairs that can matter.

Vehicles are sorted along the axis on which they are spread most; each is compared with those that follow until the gap
on this axis alone is too large. Within a step every vehicle moves straight, so the least distance of a pair is that of
a point to a segment.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sitl_mock.physics.arrays import Array
from sitl_mock.physics.compiling import kernel, part


@part
def _least_square(start_m: Array, end_m: Array, i: int, j: int) -> float:
    """Least squared distance of two vehicles that move straight from start to end."""
    x, y, z = start_m[i, 0] - start_m[j, 0], start_m[i, 1] - start_m[j, 1], start_m[i, 2] - start_m[j, 2]
    u = end_m[i, 0] - end_m[j, 0] - x
    v = end_m[i, 1] - end_m[j, 1] - y
    w = end_m[i, 2] - end_m[j, 2] - z
    way = u * u + v * v + w * w
    share = min(max(-(x * u + y * v + z * w) / way, 0.0), 1.0) if way > 0.0 else 0.0
    x, y, z = x + share * u, y + share * v, z + share * w
    return float(x * x + y * y + z * z)


@part
def _widest(positions_m: Array) -> int:
    """The axis on which positions (V, 3) are spread most."""
    widest, most_m = 0, -1.0
    for axis in range(3):
        spread_m = positions_m[:, axis].max() - positions_m[:, axis].min()
        if spread_m > most_m:
            widest, most_m = axis, spread_m
    return widest


@kernel
def pairs_within(start_m: Array, end_m: Array, limit_m: float) -> list[tuple[int, int, float]]:
    """All pairs that came closer than a limit.

    Args:
        start_m: (V, 3) positions at the start of a straight motion, and
        end_m: (V, 3) at its end.
        limit_m: of centres; a pair at exactly this distance does not count.

    Returns:
        (first, second, distance [m]) with first < second, in no order.
    """
    axis = _widest(end_m)
    low_m, high_m = np.minimum(start_m[:, axis], end_m[:, axis]), np.maximum(start_m[:, axis], end_m[:, axis])
    order = np.argsort(low_m)
    found = [(0, 0, 0.0) for _ in range(0)]
    for k in range(len(order)):
        i = order[k]
        for n in range(k + 1, len(order)):
            j = order[n]
            if low_m[j] - high_m[i] >= limit_m:
                break
            square = _least_square(start_m, end_m, i, j)
            if square < limit_m * limit_m:
                found.append((min(i, j), max(i, j), math.sqrt(square)))
    return found


@kernel
def closest_pair(start_m: Array, end_m: Array, marked: NDArray[np.bool_]) -> tuple[int, int, float]:
    """The pair of marked vehicles that came closest.

    Args:
        start_m: (V, 3) positions at the start of a straight motion, and
        end_m: (V, 3) at its end.
        marked: (V,) which vehicles count.

    Returns:
        (first, second, distance [m]); (-1, -1, inf) when fewer than two are marked.
    """
    axis = _widest(end_m)
    low_m, high_m = np.minimum(start_m[:, axis], end_m[:, axis]), np.maximum(start_m[:, axis], end_m[:, axis])
    order = np.argsort(low_m)
    first, second, least = -1, -1, np.inf
    for k in range(len(order)):
        i = order[k]
        if not marked[i]:
            continue
        for n in range(k + 1, len(order)):
            j = order[n]
            gap_m = low_m[j] - high_m[i]
            if gap_m > 0.0 and gap_m * gap_m >= least:
                break
            if marked[j]:
                square = _least_square(start_m, end_m, i, j)
                if square < least:
                    first, second, least = min(i, j), max(i, j), square
    return first, second, math.sqrt(least)
