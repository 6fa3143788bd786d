"""Regions that plans keep clear: where a vehicle that nobody commands may be by now, down to the ground."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array

Place = tuple[float, float]


class Column(NamedTuple):
    """Everything near a horizontal segment, from the ground up to a height.

    Attributes:
        start_enu_m: one end of the segment (east, north) [m].
        end_enu_m: the other end, which may be the same [m].
        top_m: the height up to which something may be [m; ENU].
        radius_m: how far from the segment it may be [m].
        place_enu_m: where it is if it hears, or was when it was heard; None: not known [m; ENU].
    """

    start_enu_m: Place
    end_enu_m: Place
    top_m: float
    radius_m: float
    place_enu_m: tuple[float, float, float] | None = None


def clearances_m(start_m: Array, end_m: Array, column: Column, above_m: float) -> Array:
    """Return how far straight moves stay from a column horizontally, shape (V,) [m]; its radius is taken off.

    Args:
        start_m: where vehicles are, shape (V, 3) [m; ENU].
        end_m: where they go, shape (V, 3).
        column: what is kept clear.
        above_m: a move that is higher than the column's top by so much all the way is infinitely far from it [m].
    """
    distances = _segments_apart(start_m[:, :2], end_m[:, :2], np.array(column.start_enu_m), np.array(column.end_enu_m))
    high = np.minimum(start_m[:, 2], end_m[:, 2]) >= column.top_m + above_m
    return np.where(high, np.inf, distances - column.radius_m)


def keeps_clear(
    start_m: Array, end_m: Array, columns: Sequence[Column], needed_m: float, *, leads_on: bool = False
) -> bool:
    """Say whether straight moves stay clear of all columns, or lead straight out of the ones that they begin in.

    Args:
        start_m: where vehicles are, shape (V, 3) [m; ENU].
        end_m: where they go, shape (V, 3).
        columns: what is kept clear.
        needed_m: distance to be kept from them [m].
        leads_on: the moves may end in a column that they begin in: others follow, which lead out of it.
    """
    for column in columns:
        on_the_way = clearances_m(start_m, end_m, column, needed_m)
        at_first = clearances_m(start_m, start_m, column, needed_m)
        at_last = clearances_m(end_m, end_m, column, needed_m)
        if (on_the_way < np.minimum(needed_m, at_first) - _ROUNDING_M).any():
            return False
        if column.place_enu_m is not None and not _keeps_off(start_m, end_m, np.array(column.place_enu_m), needed_m):
            return False
        if not leads_on and (at_last < needed_m - _ROUNDING_M).any():
            return False
    return True


def _keeps_off(start_m: Array, end_m: Array, place_m: Array, needed_m: float) -> bool:
    """Say whether straight moves stay away from a place, in all directions, or lead straight away from it."""
    on_the_way = _from_segment(place_m, start_m, end_m)
    at_first = np.linalg.norm(start_m - place_m, axis=1)
    return bool((on_the_way >= np.minimum(needed_m, at_first) - _ROUNDING_M).all())


_ROUNDING_M = 1e-6


def _segments_apart(start_m: Array, end_m: Array, other_start_m: Array, other_end_m: Array) -> Array:
    """Distances in the plane of V segments, ends of shape (V, 2), from one, ends of shape (2,) [m]."""
    apart = np.minimum.reduce(
        [
            _from_segment(start_m, other_start_m, other_end_m),
            _from_segment(end_m, other_start_m, other_end_m),
            _from_segment(other_start_m, start_m, end_m),
            _from_segment(other_end_m, start_m, end_m),
        ]
    )
    own, other = end_m - start_m, other_end_m - other_start_m
    sides = _cross(other, start_m - other_start_m) * _cross(other, end_m - other_start_m)
    other_sides = _cross(own, other_start_m - start_m) * _cross(own, other_end_m - start_m)
    return np.where((sides < 0.0) & (other_sides < 0.0), 0.0, apart)


def _from_segment(point_m: Array, start_m: Array, end_m: Array) -> Array:
    """Distances of points from segments, (..., D) each, to (...) [m]."""
    way = end_m - start_m
    length2 = np.maximum((way**2).sum(axis=-1), np.finfo(float).tiny)
    share = np.clip(((point_m - start_m) * way).sum(axis=-1) / length2, 0.0, 1.0)
    distances: Array = np.linalg.norm(point_m - start_m - share[..., None] * way, axis=-1)
    return distances


def _cross(first: Array, second: Array) -> Array:
    across: Array = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    return across
