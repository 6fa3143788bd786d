"""The path of a rigid formation along poses, with every vehicle's derivatives in closed form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, RotationSpline

from fg_gcs.core.formation import Pose
from fg_gcs.plan.paths import Approach, PathPoint, SwarmPath, thinned

Array = NDArray[np.float64]

OUTLINED = 64  # above this many slots a ball stands for the swarm: costs some percent of the turn, saves all the time
SMALL_ANGLE2 = 1e-4  # squared angle below which series replace quotients of small numbers; their error is 1e-13


class PosePath:
    """A rigid formation along poses: centres on a cubic spline, attitudes on a rotation spline.

    Both are twice continuously differentiable, and every vehicle's derivatives follow from those of the pose. All
    distances within the formation are those of its template, times the scale, at every parameter and not only at the
    poses. The scale goes from the first pose's to the last one's along the whole way, by the polynomial
    ``10 x^3 - 15 x^4 + 6 x^5`` that begins and ends without slope and curvature.
    """

    def __init__(self, slots_m: Array, poses: Sequence[Pose]) -> None:
        """Take the slots in the order of the vehicles, shape (V, 3) [m; template], and one pose or more."""
        radius_m = float(np.linalg.norm(slots_m, axis=1).max())
        centres = np.array([pose.centre_enu_m for pose in poses])
        rotations = np.array([pose.rotation for pose in poses])
        chords_m = _chords(centres, rotations, np.array([pose.scale for pose in poses]), radius_m)
        kept = thinned(chords_m)
        self._slots_m = np.ascontiguousarray(slots_m)
        self._knots_m = chords_m[kept]
        self._scales = np.array([poses[0].scale, poses[-1].scale])
        # A path of one pose has no length, but a spline needs two places for it
        support_m = self._knots_m if self.length_m > 0.0 else np.array([0.0, 1.0])
        turns = RotationSpline(support_m, Rotation.from_matrix(rotations[kept]))
        self._splines = (
            support_m,
            CubicSpline(support_m, centres[kept], bc_type="natural").c,
            turns.rotations.as_matrix(),
            turns.interpolator.c,
            self._scales,
        )

    @property
    def knots_m(self) -> Array:
        """Where the poses are that all splines pass through."""
        return self._knots_m

    @property
    def length_m(self) -> float:
        """Sum of the largest moves of a vehicle from pose to pose [m]."""
        return float(self._knots_m[-1])

    @property
    def vehicles(self) -> int:
        """Number of vehicles."""
        return len(self._slots_m)

    def at(self, s_m: Array) -> PathPoint:
        """Return the swarm at the parameters ``s_m``, shape (S,)."""
        return self.points_at(s_m, self._slots_m)

    def points_at(self, s_m: Array, points_m: Array) -> PathPoint:
        """Return any points of the same rigid body, shape (P, 3) [m; template], at the parameters ``s_m``."""
        return PathPoint(*_rigid_points(np.asarray(s_m, dtype=float), *self._splines, points_m))

    @property
    def outline(self) -> SwarmPath:
        """The path of a few points that enclose all slots.

        Velocity and acceleration of a rigid body are affine in the slot, so their norms are convex: no slot exceeds the
        largest of any points that enclose it. Small swarms are their own outline; large ones get a ball's.
        """
        if len(self._slots_m) <= OUTLINED:
            return self
        return _Ball(self, float(np.linalg.norm(self._slots_m, axis=1).max()))

    def closest(self) -> Approach:
        """Return the closest pair of the template where the formation is smallest: a rigid shape has no other."""
        if len(self._slots_m) < 2:
            return Approach(np.inf, 0.0, (0, 0))
        found, neighbours = cKDTree(self._slots_m).query(self._slots_m, k=[2])
        distances, nearest = np.asarray(found)[:, 0], np.asarray(neighbours)[:, 0]
        one = int(distances.argmin())
        other = int(nearest[one])
        where_m = 0.0 if self._scales[0] <= self._scales[1] else self.length_m
        pair = (min(one, other), max(one, other))
        return Approach(float(distances[one] * self._scales.min()), where_m, pair)


class _Ball:
    """Points of a rigid formation's body that enclose all its slots."""

    def __init__(self, body: PosePath, radius_m: float) -> None:
        self.knots_m, self.length_m = body.knots_m, body.length_m
        self._body = body
        self._points_m = radius_m * ball_points()
        self.vehicles = len(self._points_m)

    @property
    def outline(self) -> _Ball:
        return self

    def at(self, s_m: Array) -> PathPoint:
        return self._body.points_at(s_m, self._points_m)

    def closest(self) -> Approach:
        return self._body.closest()


@cache
def ball_points() -> Array:
    """Return the corners of the icosahedron around the unit ball, shape (12, 3): they reach out to 1.26."""
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    corners = np.array([(0.0, a, b * golden) for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
    corners = np.concatenate([np.roll(corners, shift, axis=1) for shift in range(3)])
    enclosing: Array = corners * (1.0 + 1e-9) * np.sqrt(3.0) / golden**2  # the facets' distance is golden^2 / sqrt(3)
    enclosing.setflags(write=False)
    return enclosing


@njit(cache=True)
def _rigid_points(
    s_m: Array, knots: Array, centres: Array, attitudes: Array, turns: Array, scales: Array, slots: Array
) -> tuple[Array, Array, Array]:
    """Positions of all slots and their derivatives at S places, each (S, V, 3).

    Within a span the centre ``c`` and the rotation vector ``f`` from the span's first attitude are cubic polynomials,
    highest power first. ``r`` is a slot's arm turned to ENU, ``w`` and ``w'`` the turning rate and its growth, ``k``
    the scale: ``q = c + k r``, ``q' = c' + k' r + k w x r``, ``q'' = c'' + k'' r + 2 k' w x r + k (w' x r + w x (w x
    r))``.
    """
    places, vehicles, spans = len(s_m), len(slots), len(knots) - 1
    position = np.empty((places, vehicles, 3))
    first, second = np.empty((places, vehicles, 3)), np.empty((places, vehicles, 3))
    c = np.empty((3, 3))
    f = np.empty((3, 3))
    rotation, w, g, r = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    for i in range(places):
        span = min(max(np.searchsorted(knots, s_m[i], side="right") - 1, 0), spans - 1)
        t = s_m[i] - knots[span]
        for k in range(3):
            _polynomial(centres[:, span, k], t, c[:, k])
            _polynomial(turns[:, span, k], t, f[:, k])
        _attitude(attitudes[span], f, rotation, w, g)
        x, grown = min(max(s_m[i] / knots[-1], 0.0), 1.0), scales[1] - scales[0]
        k0 = scales[0] + grown * x * x * x * (10.0 + x * (6.0 * x - 15.0))
        k1 = grown * 30.0 * (x * (1.0 - x)) ** 2 / knots[-1]
        k2 = grown * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / knots[-1] ** 2
        for v in range(vehicles):
            for k in range(3):
                r[k] = rotation[k, 0] * slots[v, 0] + rotation[k, 1] * slots[v, 1] + rotation[k, 2] * slots[v, 2]
            tx, ty, tz = w[1] * r[2] - w[2] * r[1], w[2] * r[0] - w[0] * r[2], w[0] * r[1] - w[1] * r[0]
            swing = (tx, ty, tz)
            bend = (
                g[1] * r[2] - g[2] * r[1] + w[1] * tz - w[2] * ty,
                g[2] * r[0] - g[0] * r[2] + w[2] * tx - w[0] * tz,
                g[0] * r[1] - g[1] * r[0] + w[0] * ty - w[1] * tx,
            )
            for k in range(3):
                position[i, v, k] = c[0, k] + k0 * r[k]
                first[i, v, k] = c[1, k] + k1 * r[k] + k0 * swing[k]
                second[i, v, k] = c[2, k] + k2 * r[k] + 2.0 * k1 * swing[k] + k0 * bend[k]
    return position, first, second


@njit(cache=True)
def _polynomial(powers: Array, t: float, out: Array) -> None:
    """A cubic polynomial and its two derivatives."""
    out[0] = ((powers[0] * t + powers[1]) * t + powers[2]) * t + powers[3]
    out[1] = (3.0 * powers[0] * t + 2.0 * powers[1]) * t + powers[2]
    out[2] = 6.0 * powers[0] * t + 2.0 * powers[1]


@njit(cache=True)
def _attitude(base: Array, f: Array, rotation: Array, rate: Array, growth: Array) -> None:
    """Fill the attitude ``base exp(f)``, its turning rate and the rate's growth, both in ENU.

    Args:
        base: attitude at the start of the span, shape (3, 3).
        f: rotation vector and its two derivatives, shape (3, 3).
        rotation: filled, shape (3, 3).
        rate: filled, shape (3,).
        growth: filled, shape (3,).

    In the turned axes the rate is ``f' - b f x f' + d f x (f x f')`` with ``b = (1 - cos)/z``, ``d = (angle -
    sin)/angle^3`` and ``z`` the squared angle (the right Jacobian of rotations); its growth is the derivative of
    that.
    """
    x, y, z = f[0]
    angle2 = x * x + y * y + z * z
    if angle2 < SMALL_ANGLE2:
        s = 1.0 - angle2 / 6.0 * (1.0 - angle2 / 20.0)
        b = 0.5 - angle2 / 24.0 * (1.0 - angle2 / 30.0)
        d = 1.0 / 6.0 - angle2 / 120.0 * (1.0 - angle2 / 42.0)
        b1 = -1.0 / 24.0 + angle2 / 360.0
        d1 = -1.0 / 120.0 + angle2 / 2520.0
    else:
        angle = math.sqrt(angle2)
        sine, cosine = math.sin(angle), math.cos(angle)
        s = sine / angle
        b = (1.0 - cosine) / angle2
        d = (angle - sine) / (angle * angle2)
        b1 = (angle * sine - 2.0 * (1.0 - cosine)) / (2.0 * angle2 * angle2)
        d1 = (3.0 * sine - 2.0 * angle - angle * cosine) / (2.0 * angle2 * angle2 * angle)
    turn = np.empty((3, 3))
    turn[0, 0], turn[0, 1], turn[0, 2] = 1.0 - b * (y * y + z * z), b * x * y - s * z, b * x * z + s * y
    turn[1, 0], turn[1, 1], turn[1, 2] = b * x * y + s * z, 1.0 - b * (x * x + z * z), b * y * z - s * x
    turn[2, 0], turn[2, 1], turn[2, 2] = b * x * z - s * y, b * y * z + s * x, 1.0 - b * (x * x + y * y)
    slope = 2.0 * (f[0, 0] * f[1, 0] + f[0, 1] * f[1, 1] + f[0, 2] * f[1, 2])  # of the squared angle
    once, twice = np.empty(3), np.empty(3)  # f x f', f x (f x f')
    grown, grown_twice, bent = np.empty(3), np.empty(3), np.empty(3)  # f x f'', f x (f x f''), f' x (f x f')
    _cross(f[0], f[1], once)
    _cross(f[0], once, twice)
    _cross(f[0], f[2], grown)
    _cross(f[0], grown, grown_twice)
    _cross(f[1], once, bent)
    own_rate, own_growth = np.empty(3), np.empty(3)
    for k in range(3):
        own_rate[k] = f[1, k] - b * once[k] + d * twice[k]
        own_growth[k] = (
            f[2, k] - b1 * slope * once[k] - b * grown[k] + d1 * slope * twice[k] + d * (bent[k] + grown_twice[k])
        )
    for i in range(3):
        for j in range(3):
            rotation[i, j] = base[i, 0] * turn[0, j] + base[i, 1] * turn[1, j] + base[i, 2] * turn[2, j]
    for i in range(3):
        rate[i] = rotation[i, 0] * own_rate[0] + rotation[i, 1] * own_rate[1] + rotation[i, 2] * own_rate[2]
        growth[i] = rotation[i, 0] * own_growth[0] + rotation[i, 1] * own_growth[1] + rotation[i, 2] * own_growth[2]


@njit(cache=True)
def _cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


def _chords(centres: Array, rotations: Array, scales: Array, radius_m: float) -> Array:
    """Cumulative way from pose to pose at the outermost slot: of centre, turn and scale, shape (K,) [m]."""
    moves = np.diff(centres, axis=0)
    turns = np.diff(rotations, axis=0)
    angles = 2.0 * np.arcsin(np.minimum(np.sqrt((turns**2).sum(axis=(1, 2)) / 8.0), 1.0))  # |R - 1| = sqrt(8) sin(a/2)
    turned_m = radius_m * np.maximum(scales[:-1], scales[1:]) * angles
    ways_m = np.sqrt((moves**2).sum(axis=1) + turned_m**2 + (radius_m * np.diff(scales)) ** 2)
    return np.concatenate(([0.0], np.cumsum(ways_m)))
