"""The formation's frame over time: an affine map from template to ENU, with its velocity and acceleration.

Every vehicle of a rigid formation is at ``c + M b`` with its slot ``b``; ``M`` is scale times attitude. All that a
vehicle does is affine in its slot, so that the frame's twelve numbers and their two derivatives say everything.
docs/derivations.md derives both directions of the conversion between axes and frames.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.plan.path.splines import cross, mix, turning

AXES = 7  # what a frame can do: move (3), turn (3, as a rotation vector from a given attitude), change its scale


class Frames(NamedTuple):
    """The frame at T instants; the second axis counts derivatives by time: 0, 1, 2."""

    centre: Array  # (T, 3, 3) [m, m/s, m/s^2; ENU]
    arms: Array  # (T, 3, 3, 3) the template's axes in ENU, times the scale; the last axis counts them

    def swarm(self, slots_m: Array) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations of slots, shape (V, 3) [m; template]; each (T, V, 3)."""
        return _swarm(self.centre, self.arms, slots_m)

    @property
    def scale(self) -> Array:
        """Times the template, shape (T,)."""
        determinant: Array = np.linalg.det(self.arms[:, 0])
        return np.cbrt(determinant)


class State(NamedTuple):
    """The frame at one instant in the terms of its axes."""

    attitude: Array  # (3, 3) template axes to ENU
    axes: Array  # (3, 7) derivatives by rows: centre, turn from that attitude (so zero in row 0), scale


def state_of(frames: Frames) -> State:
    """Return the state at the first instant; its turn is zero, so the derivatives of the turn are those of rates."""
    return State(*_state(frames.centre[0], frames.arms[0]))


def frames_of(axes: Array, attitude: Array) -> Frames:
    """Return the frames of axes over time, shape (T, 3, 7), that turn from an attitude, shape (3, 3)."""
    return Frames(*_frames(axes, attitude))


@kernel
def _swarm(centre: Array, arms: Array, slots: Array) -> tuple[Array, Array, Array]:
    count, vehicles = len(centre), len(slots)
    out = np.empty((3, count, vehicles, 3))
    for i in range(count):
        for order in range(3):
            for v in range(vehicles):
                for k in range(3):
                    value = centre[i, order, k]
                    for axis in range(3):
                        value += arms[i, order, k, axis] * slots[v, axis]
                    out[order, i, v, k] = value
    return out[0], out[1], out[2]


@kernel
def _frames(axes: Array, attitude: Array) -> tuple[Array, Array]:
    """Centres, (T, 3, 3), and arms, (T, 3, 3, 3), of axes over time, (T, 3, 7).

    ``f`` is the rotation vector, ``w`` the turning rate and ``g`` its derivative, ``k`` the scale, ``r`` an axis of the
    template turned to ENU: ``r' = w x r`` and ``r'' = g x r + w x (w x r)``.
    """
    count = len(axes)
    centre, arms = np.empty((count, 3, 3)), np.empty((count, 3, 3, 3))
    for i in range(count):
        f = (axes[i, 0, 3], axes[i, 0, 4], axes[i, 0, 5])
        f1 = (axes[i, 1, 3], axes[i, 1, 4], axes[i, 1, 5])
        f2 = (axes[i, 2, 3], axes[i, 2, 4], axes[i, 2, 5])
        s, b, d, b1, d1 = turning(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
        square1 = 2.0 * (f[0] * f1[0] + f[1] * f1[1] + f[2] * f1[2])
        once, grown = cross(f, f1), cross(f, f2)
        twice, bent, grown_twice = cross(f, once), cross(f1, once), cross(f, grown)
        w = mix(1.0, f1, 1.0, mix(b, once, d, twice))
        first = mix(1.0, f2, 1.0, mix(b1 * square1, once, b, grown))
        g = mix(1.0, first, 1.0, mix(d1 * square1, twice, d, mix(1.0, bent, 1.0, grown_twice)))
        k0, k1, k2 = axes[i, 0, 6], axes[i, 1, 6], axes[i, 2, 6]
        for axis in range(3):
            a = (attitude[0, axis], attitude[1, axis], attitude[2, axis])
            side = cross(f, a)
            r = mix(1.0, a, 1.0, mix(s, side, b, cross(f, side)))
            r1 = cross(w, r)
            r2 = mix(1.0, cross(g, r), 1.0, cross(w, r1))
            for k in range(3):
                arms[i, 0, k, axis] = k0 * r[k]
                arms[i, 1, k, axis] = k1 * r[k] + k0 * r1[k]
                arms[i, 2, k, axis] = k2 * r[k] + 2.0 * k1 * r1[k] + k0 * r2[k]
                centre[i, axis, k] = axes[i, axis, k]
    return centre, arms


@kernel
def _state(centre: Array, arms: Array) -> tuple[Array, Array]:
    """Attitude, (3, 3), and axes, (3, 7), of a frame.

    The arms are ``k R``, so that ``(k R)' (k R)^-1 = k'/k + [w]`` and ``(k R)'' (k R)^-1 = k''/k + 2 k'/k [w] + [w'] +
    [w]^2`` with the turning rate ``w``: its parts are told apart by symmetry.
    """
    axes, attitude = np.zeros((3, AXES)), np.empty((3, 3))
    rows = arms[0]
    scale = np.cbrt(
        rows[0, 0] * (rows[1, 1] * rows[2, 2] - rows[1, 2] * rows[2, 1])
        + rows[0, 1] * (rows[1, 2] * rows[2, 0] - rows[1, 0] * rows[2, 2])
        + rows[0, 2] * (rows[1, 0] * rows[2, 1] - rows[1, 1] * rows[2, 0])
    )
    traces = np.zeros(2)
    for order in range(2):
        for k in range(3):  # of the product with the inverse: its antisymmetric part, and its trace
            j, m = (k + 1) % 3, (k + 2) % 3
            for axis in range(3):
                one, other = arms[1 + order, m, axis] * rows[j, axis], arms[1 + order, j, axis] * rows[m, axis]
                axes[1 + order, 3 + k] += 0.5 * (one - other) / scale**2
                traces[order] += arms[1 + order, k, axis] * rows[k, axis] / scale**2
    share, square = traces[0] / 3.0, 0.0
    for k in range(3):
        rate = axes[1, 3 + k]
        axes[2, 3 + k] -= 2.0 * share * rate
        square += rate * rate
        for order in range(3):
            axes[order, k] = centre[order, k]
            attitude[k, order] = rows[k, order] / scale
    axes[0, 6], axes[1, 6], axes[2, 6] = scale, share * scale, scale * (traces[1] + 2.0 * square) / 3.0
    return attitude, axes
