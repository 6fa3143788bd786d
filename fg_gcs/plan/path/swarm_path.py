"""Geometric paths of a whole swarm: every vehicle's position as a function of one parameter, with two derivatives.

One parameter for all vehicles keeps the formation in step whatever the timing.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import closest_approach

KNOT_M = 0.25  # poses closer than this are thinned: a spline through nearly equal points has wild derivatives


class PathPoint(NamedTuple):
    """Positions and their derivatives by the path parameter, each of shape (S, V, 3)."""

    position_m: Array  # [m; ENU]
    first: Array  # [m / m]
    second: Array  # [m / m^2]


class ClosestApproach(NamedTuple):
    """Where on a path a pair comes closest."""

    distance_m: float
    s_m: float
    pair: tuple[int, int]


class SwarmPath(Protocol):
    """A path of V vehicles over a parameter from 0 to ``length_m``."""

    @property
    def knots_m(self) -> Array:
        """Parameters between which the path is smooth, first 0 and last ``length_m``, shape (K,) [m]."""

    @property
    def length_m(self) -> float:
        """Length of the parameter's range: about the way of the vehicle that moves furthest [m]."""

    @property
    def vehicles(self) -> int:
        """Number of vehicles."""

    def at(self, s_m: Array) -> PathPoint:
        """Return the swarm at the parameters ``s_m``, shape (S,)."""

    @property
    def outline(self) -> SwarmPath:
        """A path of few vehicles whose limits and box imply those of this one: what timing and verification sample."""

    def closest(self) -> ClosestApproach:
        """Return the closest approach of any pair on the whole path; a single vehicle has an infinite one."""


class Body(SwarmPath, Protocol):
    """A path in whose moving frame other points can stand than those of the vehicles."""

    def points_at(self, s_m: Array, points_m: Array) -> PathPoint:
        """Return points of the moving frame, shape (P, 3) [m; template], at the parameters ``s_m``, shape (S,)."""


class BodyPoints:
    """Points that stand for the vehicles of a body, on its path; the closest pair is that of the vehicles."""

    def __init__(self, body: Body, points_m: Array, vehicles: int) -> None:
        """Take the points, shape (P, 3) [m; template], and how many there are with what the body adds to them."""
        self.knots_m, self.length_m, self.vehicles = body.knots_m, body.length_m, vehicles
        self._body = body
        self._points_m = points_m

    @property
    def outline(self) -> SwarmPath:
        """Itself: it is what others are outlined by."""
        return self

    def at(self, s_m: Array) -> PathPoint:
        """Return the points at the parameters ``s_m``, shape (S,)."""
        return self._body.points_at(s_m, self._points_m)

    def closest(self) -> ClosestApproach:
        """Return the closest approach of any pair of vehicles."""
        return self._body.closest()


class LinePath:
    """All vehicles on straight lines, in step: from one set of places to another."""

    def __init__(self, start_m: Array, end_m: Array) -> None:
        """Take both sets of places, shape (V, 3) [m; ENU]."""
        self._start_m = start_m
        self._length_m = float(np.linalg.norm(end_m - start_m, axis=1).max())
        self._slope = (end_m - start_m) / self._length_m if self._length_m else np.zeros_like(start_m)

    @property
    def knots_m(self) -> Array:
        """Both ends."""
        return np.array([0.0, self._length_m])

    @property
    def length_m(self) -> float:
        """Way of the vehicle that moves furthest [m]."""
        return self._length_m

    @property
    def vehicles(self) -> int:
        """Number of vehicles."""
        return len(self._start_m)

    def at(self, s_m: Array) -> PathPoint:
        """Return the swarm at the parameters ``s_m``, shape (S,)."""
        first = np.repeat(self._slope[None], len(s_m), axis=0)
        return PathPoint(self._start_m + s_m[:, None, None] * self._slope, first, np.zeros_like(first))

    @property
    def outline(self) -> SwarmPath:
        """Itself: every vehicle has a line of its own."""
        return self

    def closest(self) -> ClosestApproach:
        """Return the closest approach, exact: relative positions run along lines too."""
        if len(self._start_m) < 2:
            return ClosestApproach(np.inf, 0.0, (0, 0))
        ends = np.stack((self._start_m, self._start_m + self._length_m * self._slope))
        found = closest_approach(ends, np.array([0.0, 1.0]))
        return ClosestApproach(found.distance_m, found.time_s * self._length_m, found.pair)


def thinned(ways_m: Array) -> list[int]:
    """Return the indices of places at least ``KNOT_M`` apart along the way, first and last always among them.

    Args:
        ways_m: cumulative way to every place, shape (K,), K >= 1 [m]; a single place counts as first and last.
    """
    ways = ways_m.tolist()  # plain numbers: an array gives them out one by one ten times slower
    last = len(ways) - 1
    kept = [0]
    for index in range(1, last):
        if min(ways[index] - ways[kept[-1]], ways[last] - ways[index]) >= KNOT_M:
            kept.append(index)
    return [*kept, last]
