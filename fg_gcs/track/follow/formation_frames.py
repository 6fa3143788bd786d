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
from fg_gcs.plan.path.splines import cross, turning

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
    arms, first, second = frames.arms[0]
    scale = float(np.cbrt(np.linalg.det(arms)))
    inverse = arms.T / scale**2
    once, twice = first @ inverse, second @ inverse
    rate = _axis(once)
    share = float(np.trace(once)) / 3.0
    axes = np.zeros((3, AXES))
    axes[:, :3] = frames.centre[0]
    axes[1, 3:6] = rate
    axes[2, 3:6] = _axis(twice) - 2.0 * share * rate
    axes[0, 6] = scale
    axes[1, 6] = share * scale
    axes[2, 6] = scale * (float(np.trace(twice)) + 2.0 * float(rate @ rate)) / 3.0
    return State(arms / scale, axes)


def frames_of(axes: Array, attitude: Array) -> Frames:
    """Return the frames of axes over time, shape (T, 3, 7), that turn from an attitude, shape (3, 3)."""
    arms = np.empty((len(axes), 3, 3, 3))
    _turned(axes, arms)
    return Frames(np.ascontiguousarray(axes[:, :, :3]), arms @ attitude)


def _axis(matrix: Array) -> Array:
    """The vector of a matrix's antisymmetric part."""
    part = 0.5 * (matrix - matrix.T)
    return np.array([part[2, 1], part[0, 2], part[1, 0]])


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
def _turned(axes: Array, arms: Array) -> None:
    """Fill ``arms``, (T, 3, 3, 3), with scale times rotation and its derivatives; ``w`` is the turning rate."""
    r1, r2 = np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(axes)):
        f = (axes[i, 0, 3], axes[i, 0, 4], axes[i, 0, 5])
        f1 = (axes[i, 1, 3], axes[i, 1, 4], axes[i, 1, 5])
        f2 = (axes[i, 2, 3], axes[i, 2, 4], axes[i, 2, 5])
        k0, k1, k2 = axes[i, 0, 6], axes[i, 1, 6], axes[i, 2, 6]
        x, y, z = f
        s, b, d, b1, d1 = turning(x * x + y * y + z * z)
        square1 = 2.0 * (x * f1[0] + y * f1[1] + z * f1[2])
        once = cross(f, f1)
        twice = cross(f, once)
        grown = cross(f, f2)
        bent, grown_twice = cross(f1, once), cross(f, grown)
        w = np.empty(3)
        g = np.empty(3)
        for k in range(3):
            w[k] = f1[k] + b * once[k] + d * twice[k]
            g[k] = (
                f2[k] + b1 * square1 * once[k] + b * grown[k] + d1 * square1 * twice[k] + d * (bent[k] + grown_twice[k])
            )
        turn = np.array(
            [
                [1.0 - b * (y * y + z * z), b * x * y - s * z, b * x * z + s * y],
                [b * x * y + s * z, 1.0 - b * (x * x + z * z), b * y * z - s * x],
                [b * x * z - s * y, b * y * z + s * x, 1.0 - b * (x * x + y * y)],
            ]
        )
        for axis in range(3):
            r = (turn[0, axis], turn[1, axis], turn[2, axis])
            once_r = cross((w[0], w[1], w[2]), r)
            again = cross((w[0], w[1], w[2]), once_r)
            turned = cross((g[0], g[1], g[2]), r)
            for k in range(3):
                r1[k, axis] = once_r[k]
                r2[k, axis] = turned[k] + again[k]
        for k in range(3):
            for axis in range(3):
                arms[i, 0, k, axis] = k0 * turn[k, axis]
                arms[i, 1, k, axis] = k1 * turn[k, axis] + k0 * r1[k, axis]
                arms[i, 2, k, axis] = k2 * turn[k, axis] + 2.0 * k1 * r1[k, axis] + k0 * r2[k, axis]
