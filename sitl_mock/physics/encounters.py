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

FEW_PER_VEHICLE = 4  # pairs that there is room for at first

Order = NDArray[np.intp]


def pairs_within(start_m: Array, end_m: Array, limit_m: float) -> list[tuple[int, int, float]]:
    """All pairs that came closer than a limit.

    Args:
        start_m: (V, 3) positions at the start of a straight motion, and
        end_m: (V, 3) at its end.
        limit_m: of centres; a pair at exactly this distance does not count.

    Returns:
        (first, second, distance [m]) with first < second, in this order.
    """
    order, low_m, high_m = _sorted(start_m, end_m)
    room = FEW_PER_VEHICLE * len(order)
    while True:
        pairs, distances_m = np.empty((room, 2), dtype=np.intp), np.empty(room)
        count = _sweep(start_m, end_m, order, low_m, high_m, limit_m, pairs, distances_m)
        if count <= room:
            found = zip(pairs[:count].tolist(), distances_m[:count].tolist(), strict=True)
            return sorted((first, second, distance_m) for (first, second), distance_m in found)
        room = count


def closest_pair(start_m: Array, end_m: Array, marked: NDArray[np.bool_]) -> tuple[int, int, float]:
    """The pair of marked vehicles that came closest.

    Args:
        start_m: (V, 3) positions at the start of a straight motion, and
        end_m: (V, 3) at its end.
        marked: (V,) which vehicles count.

    Returns:
        (first, second, distance [m]); (-1, -1, inf) when fewer than two are marked.
    """
    order, low_m, high_m = _sorted(start_m, end_m)
    return _closest(start_m, end_m, order[marked[order]], low_m, high_m)


def _sorted(start_m: Array, end_m: Array) -> tuple[Order, Array, Array]:
    """Vehicles in the order of their lower ends on the axis of the largest spread, and both ends (V,) on it."""
    axis = int(np.argmax(end_m.max(axis=0, initial=-math.inf) - end_m.min(axis=0, initial=math.inf)))
    low_m, high_m = np.minimum(start_m[:, axis], end_m[:, axis]), np.maximum(start_m[:, axis], end_m[:, axis])
    return np.argsort(low_m), low_m, high_m


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


@kernel
def _sweep(
    start_m: Array,
    end_m: Array,
    order: Order,
    low_m: Array,
    high_m: Array,
    limit_m: float,
    pairs: Order,
    found_m: Array,
) -> int:
    """Write down the pairs closer than a limit as far as there is room; return how many there are."""
    count = 0
    for k in range(len(order)):
        i = order[k]
        for n in range(k + 1, len(order)):
            j = order[n]
            if low_m[j] - high_m[i] >= limit_m:
                break
            square = _least_square(start_m, end_m, i, j)
            if square < limit_m * limit_m:
                if count < len(found_m):
                    pairs[count, 0], pairs[count, 1], found_m[count] = min(i, j), max(i, j), math.sqrt(square)
                count += 1
    return count


@kernel
def _closest(start_m: Array, end_m: Array, order: Order, low_m: Array, high_m: Array) -> tuple[int, int, float]:
    """The pair of the vehicles in `order` that came closest."""
    first, second, least = -1, -1, math.inf
    for k in range(len(order)):
        i = order[k]
        for n in range(k + 1, len(order)):
            j = order[n]
            gap_m = low_m[j] - high_m[i]
            if gap_m > 0.0 and gap_m * gap_m >= least:
                break
            square = _least_square(start_m, end_m, i, j)
            if square < least:
                first, second, least = min(i, j), max(i, j), square
    return first, second, math.sqrt(least)
