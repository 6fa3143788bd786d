"""Geometric paths of a whole swarm: every vehicle's position as a function of one parameter, with two derivatives.

One parameter for all vehicles keeps the formation in step whatever the timing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from fg_gcs.core.formation import Pose

Array = NDArray[np.float64]

KNOT_M = 0.25  # poses closer than this are thinned: a spline through nearly equal points has wild derivatives


class PathPoint(NamedTuple):
    """Positions and their derivatives by the path parameter, each of shape (S, V, 3)."""

    position_m: Array  # [m; ENU]
    first: Array  # [m / m]
    second: Array  # [m / m^2]


class SwarmPath(Protocol):
    """A path of V vehicles over a parameter from 0 to ``length_m``."""

    @property
    def knots_m(self) -> Array:
        """Parameters between which the path is smooth, first 0 and last ``length_m``, shape (K,) [m]."""

    @property
    def length_m(self) -> float:
        """Length of the parameter's range: about the way of the vehicle that moves furthest [m]."""

    def at(self, s_m: Array) -> PathPoint:
        """Return the swarm at the parameters ``s_m``, shape (S,)."""


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

    def at(self, s_m: Array) -> PathPoint:
        """Return the swarm at the parameters ``s_m``, shape (S,)."""
        shape = (len(s_m), *self._slope.shape)
        first = np.broadcast_to(self._slope, shape)
        return PathPoint(self._start_m + s_m[:, None, None] * self._slope, first, np.zeros(shape))


class PosePath:
    """A rigid formation along poses: centres on a cubic spline, attitudes on a rotation spline.

    Both are twice continuously differentiable, and every vehicle's derivatives follow from those of the pose:
    ``q' = c' + w x r`` and ``q'' = c'' + w' x r + w x (w x r)`` with ``r = R t``. All distances within the formation
    are those of its template at every parameter, not only at the poses.
    """

    def __init__(self, slots_m: Array, poses: Sequence[Pose]) -> None:
        """Take the slots in the order of the vehicles, shape (V, 3) [m; template], and one pose or more."""
        radius_m = float(np.linalg.norm(slots_m, axis=1).max())
        chords_m = _chords(poses, radius_m)
        kept = _thinned(chords_m)
        self._slots_m = slots_m
        self._knots_m = chords_m[kept]
        centres = np.array([pose.centre_enu_m for pose in poses])[kept]
        attitudes = Rotation.from_matrix(np.array([pose.rotation for pose in poses])[kept])
        # A path of one pose has no length, but a spline needs two places for it
        support_m = self._knots_m if self.length_m > 0.0 else np.array([0.0, 1.0])
        self._centre = CubicSpline(support_m, centres, bc_type="natural")
        self._attitude = RotationSpline(support_m, attitudes)

    @property
    def knots_m(self) -> Array:
        """Where the poses are that both splines pass through."""
        return self._knots_m

    @property
    def length_m(self) -> float:
        """Sum of the largest moves of a vehicle from pose to pose [m]."""
        return float(self._knots_m[-1])

    def at(self, s_m: Array) -> PathPoint:
        """Return the swarm at the parameters ``s_m``, shape (S,)."""
        rotation = self._attitude(s_m).as_matrix()  # (S, 3, 3)
        rate = np.einsum("skl,sl->sk", rotation, self._attitude(s_m, 1))[:, None, :]  # from template axes to ENU
        growth = np.einsum("skl,sl->sk", rotation, self._attitude(s_m, 2))[:, None, :]
        arms = np.einsum("skl,vl->svk", rotation, self._slots_m)
        swing = np.cross(rate, arms)
        return PathPoint(
            self._centre(s_m)[:, None, :] + arms,
            self._centre(s_m, 1)[:, None, :] + swing,
            self._centre(s_m, 2)[:, None, :] + np.cross(growth, arms) + np.cross(rate, swing),
        )


def _chords(poses: Sequence[Pose], radius_m: float) -> Array:
    """Cumulative way from pose to pose: the centre's and, at the given radius, the turn's, shape (K,) [m]."""
    if len(poses) == 1:
        return np.zeros(1)
    moves = np.diff([pose.centre_enu_m for pose in poses], axis=0)
    turns = Rotation.from_matrix([pose.rotation for pose in poses])
    angles = (turns[:-1].inv() * turns[1:]).magnitude()
    return np.concatenate(([0.0], np.cumsum(np.hypot(np.linalg.norm(moves, axis=1), radius_m * angles))))


def _thinned(knots_m: Array) -> list[int]:
    """Indices of knots at least ``KNOT_M`` apart, first and last always among them."""
    if len(knots_m) == 1:
        return [0, 0]
    last = len(knots_m) - 1
    kept = [0]
    for index in range(1, last):
        if knots_m[index] - knots_m[kept[-1]] >= KNOT_M and knots_m[last] - knots_m[index] >= KNOT_M:
            kept.append(index)
    return [*kept, last]
