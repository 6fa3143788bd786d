"""The path of a rigid formation along poses, with every vehicle's derivatives in closed form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Pose
from fg_gcs.plan.path.poses import Poses
from fg_gcs.plan.path.splines import Vector, cross, mix, natural_cubic, rotation_spline, turning
from fg_gcs.plan.path.swarm_path import BodyPoints, ClosestApproach, PathPoint, SwarmPath, thinned

OUTLINED = 64  # above this many slots a ball stands for the swarm: costs some percent of the turn, saves all the time


class PosePath:
    """A rigid formation along poses: centres on a cubic spline, attitudes on a rotation spline.

    Both are twice continuously differentiable, and every vehicle's derivatives follow from those of the pose. All
    distances within the formation are those of its template, times the scale, at every parameter and not only at the
    poses. The scale goes from the first pose's to the last one's along the whole way, by the polynomial
    ``10 x^3 - 15 x^4 + 6 x^5`` that begins and ends with both derivatives zero.
    """

    def __init__(self, slots_m: Array, poses: Sequence[Pose]) -> None:
        """Take the slots in the order of the vehicles, shape (V, 3) [m; template], and one pose or more."""
        rows = poses if isinstance(poses, Poses) else Poses.of(poses)
        centres, rotations, scales = rows.centres_enu_m, rows.rotations, rows.scales
        self._slots_m = np.ascontiguousarray(slots_m)
        self._radius_m = math.sqrt((self._slots_m**2).sum(axis=1).max())
        ways_m = _ways(centres, rotations, scales, self._radius_m)
        kept = thinned(ways_m)
        self._knots_m = ways_m[kept]
        self._scales = scales[[0, -1]]
        # A path of one pose has no length, but a spline needs two places for it
        support_m = self._knots_m if self.length_m > 0.0 else np.array([0.0, 1.0])
        attitudes, turns = rotation_spline(support_m, rotations[kept])
        self._splines = (support_m, natural_cubic(support_m, centres[kept]), attitudes, turns, self._scales)

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

    def of_points(self, points_m: Array) -> SwarmPath:
        """Return the path of other points of the same body, shape (P, 3) [m; template], with the same parameter."""
        return BodyPoints(self, points_m, len(points_m))

    @property
    def outline(self) -> SwarmPath:
        """The path of a few points that enclose all slots.

        Velocity and acceleration of a rigid body are affine in the slot, so their norms are convex: no slot exceeds the
        largest of any points that enclose it. Small swarms are their own outline; large ones get a ball's.
        """
        if len(self._slots_m) <= OUTLINED:
            return self
        return self.of_points(outline_of(self._slots_m))

    def closest(self) -> ClosestApproach:
        """Return the closest pair of the template where the formation is smallest: a rigid shape has no other."""
        if len(self._slots_m) < 2:
            return ClosestApproach(np.inf, 0.0, (0, 0))
        distance_m, pair = _closest_pair(self._slots_m)
        where_m = 0.0 if self._scales[0] <= self._scales[1] else self.length_m
        return ClosestApproach(float(distance_m * self._scales.min()), where_m, pair)


def outline_of(slots_m: Array) -> Array:
    """Return slots, shape (V, 3), or a few points that enclose them if they are many, shape (P, 3) [m; template]."""
    if len(slots_m) <= OUTLINED:
        return slots_m
    outline: Array = math.sqrt((slots_m**2).sum(axis=1).max()) * ball_points()
    return outline


@cache
def ball_points() -> Array:
    """Return the corners of the icosahedron around the unit ball, shape (12, 3): they reach out to 1.26."""
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    corners = np.array([(0.0, a, b * golden) for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
    corners = np.concatenate([np.roll(corners, shift, axis=1) for shift in range(3)])
    enclosing: Array = corners * (1.0 + 1e-9) * np.sqrt(3.0) / golden**2  # the facets' distance is golden^2 / sqrt(3)
    enclosing.setflags(write=False)
    return enclosing


@kernel
def _rigid_points(
    s_m: Array, knots: Array, centres: Array, attitudes: Array, turns: Array, scales: Array, slots: Array
) -> tuple[Array, Array, Array]:
    """Positions of all slots and their derivatives at S places, each (S, V, 3).

    Within a span the centre ``c`` and the rotation vector ``f`` from the span's first attitude are cubic polynomials,
    highest power first. ``r`` is a template axis turned to ENU, ``w`` and ``w'`` turning rate and acceleration, ``k``
    the scale: ``q = c + k r``, ``q' = c' + k' r + k w x r``, ``q'' = c'' + k'' r + 2 k' w x r + k (w' x r + w x (w x
    r))``. All this is affine in the slot: it is worked out for the three axes, and every slot adds up its shares.
    """
    places, vehicles = len(s_m), len(slots)
    position = np.empty((places, vehicles, 3))
    first, second = np.empty((places, vehicles, 3)), np.empty((places, vehicles, 3))
    rotation, axes = np.empty((3, 3)), np.empty((3, 3))
    axes1, axes2 = np.empty((3, 3)), np.empty((3, 3))  # derivatives of the template's axes with their scale
    span = 0
    for i in range(places):
        span = _span(knots, span, s_m[i])
        c, c1, c2 = _polynomial(centres, span, s_m[i] - knots[span])
        f, f1, f2 = _polynomial(turns, span, s_m[i] - knots[span])
        w, g = _attitude(attitudes, span, f, f1, f2, rotation)
        x, grown = min(max(s_m[i] / knots[-1], 0.0), 1.0), scales[1] - scales[0]
        k0 = scales[0] + grown * x * x * x * (10.0 + x * (6.0 * x - 15.0))
        k1 = grown * 30.0 * (x * (1.0 - x)) ** 2 / knots[-1]
        k2 = grown * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / knots[-1] ** 2
        for axis in range(3):
            r = (rotation[0, axis], rotation[1, axis], rotation[2, axis])
            r1 = cross(w, r)
            r2 = mix(1.0, cross(g, r), 1.0, cross(w, r1))
            for k in range(3):
                axes[k, axis] = k0 * r[k]
                axes1[k, axis] = k1 * r[k] + k0 * r1[k]
                axes2[k, axis] = k2 * r[k] + 2.0 * k1 * r1[k] + k0 * r2[k]
        _place(c, axes, slots, i, position)
        _place(c1, axes1, slots, i, first)
        _place(c2, axes2, slots, i, second)
    return position, first, second


@kernel
def attitudes_at(s_m: Array, knots: Array, attitudes: Array, turns: Array) -> tuple[Array, Array, Array]:
    """Return what a rotation spline is at S places, see :func:`fg_gcs.plan.path.splines.rotation_spline`.

    Returns:
        Attitudes, shape (S, 3, 3), turning rates and angular accelerations in ENU, each (S, 3).
    """
    places = len(s_m)
    rotations, rates, accelerations = np.empty((places, 3, 3)), np.empty((places, 3)), np.empty((places, 3))
    span = 0
    for i in range(places):
        span = _span(knots, span, s_m[i])
        f, f1, f2 = _polynomial(turns, span, s_m[i] - knots[span])
        rate, acceleration = _attitude(attitudes, span, f, f1, f2, rotations[i])
        for k in range(3):
            rates[i, k], accelerations[i, k] = rate[k], acceleration[k]
    return rotations, rates, accelerations


@kernel
def _span(knots: Array, span: int, place: float) -> int:
    """Return the span that a place is in, searched for from another one on."""
    while span < len(knots) - 2 and place >= knots[span + 1]:
        span += 1
    while span > 0 and place < knots[span]:
        span -= 1
    return span


@kernel
def _place(centre: Vector, axes: Array, slots: Array, row: int, out: Array) -> None:
    """Fill a row of ``out``, (S, V, 3), with ``centre + axes slot`` for every slot."""
    cx, cy, cz = centre
    a, b, c = axes[0, 0], axes[0, 1], axes[0, 2]
    d, e, f = axes[1, 0], axes[1, 1], axes[1, 2]
    g, h, i = axes[2, 0], axes[2, 1], axes[2, 2]
    for v in range(len(slots)):
        x, y, z = slots[v, 0], slots[v, 1], slots[v, 2]
        out[row, v, 0] = cx + a * x + b * y + c * z
        out[row, v, 1] = cy + d * x + e * y + f * z
        out[row, v, 2] = cz + g * x + h * y + i * z


@kernel
def _polynomial(powers: Array, span: int, t: float) -> tuple[Vector, Vector, Vector]:
    """Three cubic polynomials, coefficients (4, K - 1, 3), and their two derivatives."""
    a = (powers[0, span, 0], powers[0, span, 1], powers[0, span, 2])
    b = (powers[1, span, 0], powers[1, span, 1], powers[1, span, 2])
    c = (powers[2, span, 0], powers[2, span, 1], powers[2, span, 2])
    d = (powers[3, span, 0], powers[3, span, 1], powers[3, span, 2])
    value = mix(1.0, d, t, mix(1.0, c, t, mix(1.0, b, t, a)))
    return value, mix(1.0, c, t, mix(2.0, b, 3.0 * t, a)), mix(2.0, b, 6.0 * t, a)


@kernel
def _attitude(bases: Array, span: int, f: Vector, f1: Vector, f2: Vector, rotation: Array) -> tuple[Vector, Vector]:
    """Fill the attitude ``base exp(f)``; return its turning rate and angular acceleration, both in ENU.

    Args:
        bases: attitudes at the starts of the spans, shape (K, 3, 3).
        span: which one counts.
        f: rotation vector.
        f1: its derivative.
        f2: its second derivative.
        rotation: filled, shape (3, 3).

    In the turned axes the rate is ``f' - b f x f' + d f x (f x f')``, see :func:`fg_gcs.plan.path.splines.turning`; its
    derivative is the angular acceleration.
    """
    x, y, z = f
    s, b, d, b1, d1 = turning(x * x + y * y + z * z)
    turn = (
        (1.0 - b * (y * y + z * z), b * x * y - s * z, b * x * z + s * y),
        (b * x * y + s * z, 1.0 - b * (x * x + z * z), b * y * z - s * x),
        (b * x * z - s * y, b * y * z + s * x, 1.0 - b * (x * x + y * y)),
    )
    for i in range(3):
        p, q, r = bases[span, i, 0], bases[span, i, 1], bases[span, i, 2]
        for j in range(3):
            rotation[i, j] = p * turn[0][j] + q * turn[1][j] + r * turn[2][j]
    grown = 2.0 * (x * f1[0] + y * f1[1] + z * f1[2])  # derivative of the squared angle
    once, more = cross(f, f1), cross(f, f2)  # f x f', f x f''
    twice, more_twice, bent = cross(f, once), cross(f, more), cross(f1, once)
    rate = mix(1.0, f1, 1.0, mix(-b, once, d, twice))
    acceleration = mix(-b, more, d, mix(1.0, bent, 1.0, more_twice))
    acceleration = mix(1.0, mix(1.0, f2, 1.0, acceleration), grown, mix(-b1, once, d1, twice))
    return _turned(rotation, rate), _turned(rotation, acceleration)


@kernel
def _turned(r: Array, a: Vector) -> Vector:
    return (
        r[0, 0] * a[0] + r[0, 1] * a[1] + r[0, 2] * a[2],
        r[1, 0] * a[0] + r[1, 1] * a[1] + r[1, 2] * a[2],
        r[2, 0] * a[0] + r[2, 1] * a[1] + r[2, 2] * a[2],
    )


@kernel
def _ways(centres: Array, rotations: Array, scales: Array, radius: float) -> Array:
    """Cumulative way from pose to pose at the outermost slot: of centre, turn and scale, shape (K,) [m]."""
    ways = np.zeros(len(centres))
    for i in range(1, len(centres)):
        moved2, turned2 = 0.0, 0.0
        for j in range(3):
            moved2 += (centres[i, j] - centres[i - 1, j]) ** 2
            for k in range(3):
                turned2 += (rotations[i, j, k] - rotations[i - 1, j, k]) ** 2
        angle = 2.0 * math.asin(min(math.sqrt(turned2 / 8.0), 1.0))  # |R - 1| = sqrt(8) sin(a/2)
        turned = radius * max(scales[i - 1], scales[i]) * angle
        grown = radius * (scales[i] - scales[i - 1])
        ways[i] = ways[i - 1] + math.sqrt(moved2 + turned * turned + grown * grown)
    return ways


@kernel
def _closest_pair(slots: Array) -> tuple[float, tuple[int, int]]:
    """Distance and indices of the closest two of V >= 2 slots, by a sweep along the template's y axis."""
    order = np.argsort(slots[:, 1])
    best2, pair = np.inf, (0, 1)
    for i in range(len(order)):
        for j in range(i + 1, len(order)):
            one, other = order[i], order[j]
            ahead = slots[other, 1] - slots[one, 1]
            if ahead * ahead >= best2:
                break
            across, along = slots[other, 0] - slots[one, 0], slots[other, 2] - slots[one, 2]
            distance2 = ahead * ahead + across * across + along * along
            if distance2 < best2:
                best2, pair = distance2, (min(one, other), max(one, other))
    return math.sqrt(best2), pair
