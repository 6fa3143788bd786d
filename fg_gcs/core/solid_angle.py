"""Electric flux of a point source through a polygon, with closed-form derivatives.

The flux of a unit isotropic source (normalised to ``4 pi`` in all) through a surface is the solid angle under
which the source sees it. It depends on the rim alone: when the rim moves by ``d(s)``, the flux changes by
``closed integral of d . (r x dl) / |r|^3``. Along a straight edge from ``a`` to ``b`` (seen from the source)
``r x dl`` is the constant ``a x b``, and the two integrals that are left have closed forms, so that

    d flux / d a = (a x b) / (|a| D),    d flux / d b = (a x b) / (|b| D),    D = |a| |b| + a . b

summed over the edges that meet in a vertex. Differentiating once more gives the Hessian, a sum over edges too:
the cost grows with the number of vertices, not with its square. The value itself is a fan of triangles by the
formula of van Oosterom and Strackee [VanOosterom1983]_.

Sign: positive when the source lies on the side to which the rim's normal points (the right-hand rule).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array

FULL_SPHERE = 4.0 * np.pi
HALF_SPHERE = 2.0 * np.pi
IN_PLANE = 1e-9  # a source this flat (radians) over the plane counts as in front: one in the face has 2 pi, not 0 / 0


class EdgeDerivatives(NamedTuple):
    """First and second derivatives of the flux, edge by edge; edge ``e`` runs from vertex ``e`` to ``e + 1``."""

    gradient: Array  # (N, 2, 3) with respect to the edge's first and last point
    hessian: Array  # (N, 2, 2, 3, 3)


def flux(vertices: Array, source: Array) -> Array:
    """Return the flux of a unit source through a polygon.

    Args:
        vertices: rim of the polygon, shape (..., N, 3), N >= 3 [m].
        source: position of the source, shape (3,) [m], same frame.

    Returns:
        Solid angle in (-2 pi, 2 pi] for a flat convex polygon, shape (...) [sr].
    """
    rays = vertices - source
    first, second, third = rays[..., :1, :], rays[..., 1:-1, :], rays[..., 2:, :]
    d1, d2, d3 = (np.linalg.norm(ray, axis=-1) for ray in (first, second, third))
    triple = np.einsum("...k,...k->...", np.cross(second, first), third)  # positive in front of the face
    least = IN_PLANE * np.linalg.norm(np.cross(second - first, third - first), axis=-1) * np.maximum(d1, d2)
    triple = np.where(np.abs(triple) < least, least, triple)
    denominator = (
        d1 * d2 * d3
        + np.einsum("...k,...k->...", first, second) * d3
        + np.einsum("...k,...k->...", first, third) * d2
        + np.einsum("...k,...k->...", second, third) * d1
    )
    angle: Array = 2.0 * np.arctan2(triple, denominator).sum(axis=-1)
    return angle


def edge_derivatives(vertices: Array, source: Array) -> EdgeDerivatives:
    """Return the closed-form derivatives of :func:`flux`, one row an edge.

    Args:
        vertices: rim of the polygon, shape (N, 3) [m].
        source: position of the source, shape (3,) [m]; it must not lie on the rim.

    Returns:
        Gradient rows [sr/m] and Hessian blocks [sr/m^2]; sum the blocks over shared vertices.
    """
    a = vertices - source
    b = np.roll(a, -1, axis=0)
    length_a = np.linalg.norm(a, axis=1)[:, None]
    length_b = np.linalg.norm(b, axis=1)[:, None]
    dot = np.einsum("ek,ek->e", a, b)[:, None]
    normal = np.cross(a, b)

    # D = |a| |b| + a . b, by the product with its conjugate where the source is near the edge and the sum would cancel
    lengths = length_a * length_b
    near = dot < 0.0
    conjugate = np.where(near, lengths - dot, 1.0)
    d = np.where(near, np.einsum("ek,ek->e", normal, normal)[:, None] / conjugate, lengths + dot)
    # f_a = 1 / (|a| D) and f_b = 1 / (|b| D), with their derivatives by a and b
    f_a, f_b = 1.0 / (length_a * d), 1.0 / (length_b * d)
    unit_a, unit_b = a / length_a, b / length_b
    f_a_by_a = -(f_a**2) * (2.0 * length_b * a + dot * unit_a + length_a * b)
    f_a_by_b = -(f_a**2) * (length_a**2 * unit_b + length_a * a)
    f_b_by_a = -(f_b**2) * (length_b**2 * unit_a + length_b * b)
    f_b_by_b = -(f_b**2) * (2.0 * length_a * b + dot * unit_b + length_b * a)

    cross_a, cross_b = skew(a), skew(b)  # d(a x b) = [a] db - [b] da
    hessian = np.empty((len(a), 2, 2, 3, 3))
    for row, (f, by_a, by_b) in enumerate(((f_a, f_a_by_a, f_a_by_b), (f_b, f_b_by_a, f_b_by_b))):
        hessian[:, row, 0] = -f[:, :, None] * cross_b + normal[:, :, None] * by_a[:, None, :]
        hessian[:, row, 1] = f[:, :, None] * cross_a + normal[:, :, None] * by_b[:, None, :]
    return EdgeDerivatives(np.stack((normal * f_a, normal * f_b), axis=1), hessian)


def gradient(vertices: Array, source: Array) -> Array:
    """Return the derivative of :func:`flux` by every vertex, shape (N, 3) [sr/m]."""
    by_edge = edge_derivatives(vertices, source).gradient
    total: Array = by_edge[:, 0] + np.roll(by_edge[:, 1], 1, axis=0)
    return total


def hessian(vertices: Array, source: Array) -> Array:
    """Return the second derivative of :func:`flux` by every pair of vertices, shape (N, 3, N, 3) [sr/m^2]."""
    blocks = edge_derivatives(vertices, source).hessian
    count = len(vertices)
    first = np.arange(count)
    ends = (first, np.roll(first, -1))
    total = np.zeros((count, count, 3, 3))
    for row in range(2):
        for column in range(2):
            total[ends[row], ends[column]] += blocks[:, row, column]  # each pair of ends occurs once
    return total.transpose(0, 2, 1, 3)


def unwrapped(angle: Array) -> Array:
    """Continue the flux through the face: a source just behind it, inside the swarm, has between 2 pi and 3 pi.

    The solid angle of a flat face jumps from 2 pi to -2 pi when the source passes through it. An angle below
    -pi can only belong to a source close behind the face, so it is taken as its continuation.
    """
    return np.where(angle < -np.pi, angle + FULL_SPHERE, angle)


def skew(vectors: Array) -> Array:
    """Return the matrices of the cross product, ``skew(v) @ w == cross(v, w)``; (..., 3) to (..., 3, 3)."""
    matrix = np.zeros((*vectors.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -vectors[..., 2], vectors[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = vectors[..., 2], -vectors[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -vectors[..., 1], vectors[..., 0]
    return matrix
