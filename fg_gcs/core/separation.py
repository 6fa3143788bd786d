"""Closest approach of every pair of vehicles over time, and the box that no vehicle may leave."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array

BLOCK_ELEMENTS = 250_000  # pairs times instants compared together: some 20 MB of work space, whatever the swarm


class Separation(NamedTuple):
    """The smallest distance of any pair at any time."""

    distance_m: float
    time_s: float
    pair: tuple[int, int]  # indices of the two vehicles


@dataclass(frozen=True)
class Fence:
    """The box that every vehicle stays in [m; ENU]."""

    low_enu_m: tuple[float, float, float]  # the third is the floor
    high_enu_m: tuple[float, float, float]  # the third is the ceiling

    def excess_m(self, positions_enu_m: Array) -> Array:
        """Return by how much each position lies outside, <= 0 inside; (..., 3) to (...) [m]."""
        outside = np.maximum(np.array(self.low_enu_m) - positions_enu_m, positions_enu_m - np.array(self.high_enu_m))
        largest: Array = outside.max(axis=-1)
        return largest


def closest_approach(positions_m: Array, times_s: Array) -> Separation:
    """Return the closest approach of any pair, motion between samples taken as straight.

    Within one step the relative position of a pair runs along a line, whose point nearest to zero has a closed form;
    the true path departs from that line by at most ``a dt^2 / 8`` for a relative acceleration ``a``.

    Args:
        positions_m: shape (T, V, 3), T >= 1, V >= 2 [m].
        times_s: shape (T,), ascending [s].
    """
    first, second = np.triu_indices(positions_m.shape[1], k=1)
    rows = max(2, BLOCK_ELEMENTS // max(1, len(first)))
    best = Separation(np.inf, float(times_s[0]), (0, 1))
    for start in range(0, len(times_s), rows - 1):
        window = slice(start, start + rows)
        gaps = positions_m[window, first] - positions_m[window, second]  # (t, P, 3)
        fractions = np.zeros(gaps.shape[:2])  # the last sample stands for itself
        moves = np.diff(gaps, axis=0)
        lengths = np.einsum("tpk,tpk->tp", moves, moves)
        reach = -np.einsum("tpk,tpk->tp", gaps[:-1], moves)
        fractions[:-1] = np.clip(reach / np.maximum(lengths, np.finfo(float).tiny), 0.0, 1.0)
        gaps[:-1] += fractions[:-1, :, None] * moves
        squares = np.einsum("tpk,tpk->tp", gaps, gaps)
        instant, pair = np.unravel_index(int(squares.argmin()), squares.shape)
        distance = float(np.sqrt(squares[instant, pair]))
        if distance < best.distance_m:
            times = times_s[window]
            step = float(times[instant + 1] - times[instant]) if instant + 1 < len(times) else 0.0
            moment = float(times[instant] + fractions[instant, pair] * step)
            best = Separation(distance, moment, (int(first[pair]), int(second[pair])))
        if start + rows >= len(times_s):
            break
    return best


def smallest_over_time(positions_m: Array) -> Array:
    """Return the distance of the closest pair at every instant; (T, V, 3) to (T,) [m]."""
    first, second = np.triu_indices(positions_m.shape[1], k=1)
    rows = max(1, BLOCK_ELEMENTS // max(1, len(first)))
    smallest = np.empty(len(positions_m))
    for start in range(0, len(positions_m), rows):
        window = slice(start, start + rows)
        gaps = positions_m[window, first] - positions_m[window, second]
        smallest[window] = np.sqrt(np.einsum("tpk,tpk->tp", gaps, gaps).min(axis=1))
    return smallest
