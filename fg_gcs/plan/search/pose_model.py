"""The model of the rigid formulation, compiled: flux, gradient and Hessian by small moves and turns of a pose."""

from __future__ import annotations

import math

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.core.kernels import polygon_flux
from fg_gcs.plan.path.splines import Vector, cross
from fg_gcs.plan.search.steps import turn_by


@kernel
def place(rim: Array, centre: Array, rotation: Array, scale: float, out: Array) -> None:
    """Fill ``out``, shape (N, 3), with the rim of the template at a pose [m; ENU]."""
    for i in range(rim.shape[0]):
        for k in range(3):
            arm = rotation[k, 0] * rim[i, 0] + rotation[k, 1] * rim[i, 1] + rotation[k, 2] * rim[i, 2]
            out[i, k] = centre[k] + scale * arm


@kernel
def turned(rotation: Array, x: float, y: float, z: float) -> Array:
    """Return the rotation turned by a rotation vector in ENU [rad]."""
    turn, product = turn_by(x, y, z), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            product[i, j] = turn[i, 0] * rotation[0, j] + turn[i, 1] * rotation[1, j] + turn[i, 2] * rotation[2, j]
    return product


@kernel
def keep(poses: Array, row: int, centre: Array, rotation: Array, scale: float) -> None:
    """Write a pose as a row: centre, rotation by rows, scale; 13 numbers."""
    poses[row, :3] = centre
    poses[row, 3:12] = rotation.ravel()
    poses[row, 12] = scale


@kernel
def centre_of(sources: Array, weights: Array) -> Array:
    """Return the centre of charge, shape (3,)."""
    centre = np.zeros(3)
    for c in range(len(sources)):
        for k in range(3):
            centre[k] += weights[c] * sources[c, k]
    return centre


@kernel
def charged_flux(vertices: Array, sources: Array, weights: Array) -> float:
    """Return the weighted sum of the sources' fluxes through a polygon [sr]."""
    total = 0.0
    for c in range(len(sources)):
        total += weights[c] * polygon_flux(vertices, sources[c])
    return total


@kernel
def pose_derivatives(
    vertices: Array,
    centre: Array,
    sources: Array,
    weights: Array,
    nearest: float,
    gradient: Array,
    hessian: Array,
) -> bool:
    """Fill the flux's derivatives by small moves and turns about the centre; False when a source is on the rim.

    The flux of a rigid face depends only on where the source stands as seen from it. A move ``d`` and a turn ``w`` of
    the face take a source from ``y``, seen from the centre, to ``exp(-[w]) (y - d)``. With the flux's gradient ``g``
    and Hessian ``H`` by ``y`` and the cross-product matrix ``[.]``, the gradient is ``(-g, g x y)``, and the Hessian's
    blocks are ``H``, ``[g] - H [y]`` and ``-[y] H [y] + (g y^T + y g^T) / 2 - g.y``.
    """
    gradient[:] = 0.0
    hessian[:] = 0.0
    source_gradient, source_hessian = np.empty(3), np.empty((3, 3))
    for c in range(len(sources)):
        if not _source_derivatives(vertices, sources[c], nearest, source_gradient, source_hessian):
            return False
        weight = weights[c]
        y = (sources[c, 0] - centre[0], sources[c, 1] - centre[1], sources[c, 2] - centre[2])
        g = (weight * source_gradient[0], weight * source_gradient[1], weight * source_gradient[2])
        inner = g[0] * y[0] + g[1] * y[1] + g[2] * y[2]
        turn = cross(g, y)
        for p in range(3):
            gradient[p] -= g[p]
            gradient[3 + p] += turn[p]
            row = (weight * source_hessian[p, 0], weight * source_hessian[p, 1], weight * source_hessian[p, 2])
            mixed = cross(y, row)  # a row of -H [y] is y x that row of H
            for q in range(3):
                hessian[p, q] += row[q]
                hessian[p, 3 + q] += mixed[q]
                hessian[3 + p, 3 + q] += 0.5 * (g[p] * y[q] + y[p] * g[q])
            hessian[3 + p, 3 + p] -= inner
        for q in range(3):  # columns of -[y] (H [y]) are y x those of -H [y]
            column = cross(y, _turned_column(source_hessian, y, q, weight))
            for p in range(3):
                hessian[3 + p, 3 + q] += column[p]
        hessian[0, 4] -= g[2]
        hessian[0, 5] += g[1]
        hessian[1, 3] += g[2]
        hessian[1, 5] -= g[0]
        hessian[2, 3] -= g[1]
        hessian[2, 4] += g[0]
    for p in range(6):
        for q in range(p):
            hessian[p, q] = hessian[q, p]
    return True


@kernel
def _turned_column(hessian: Array, y: Vector, q: int, weight: float) -> Vector:
    """Return column ``q`` of ``-H [y]``, weighted."""
    i, j = (q + 1) % 3, (q + 2) % 3
    return (
        weight * (y[i] * hessian[0, j] - y[j] * hessian[0, i]),
        weight * (y[i] * hessian[1, j] - y[j] * hessian[1, i]),
        weight * (y[i] * hessian[2, j] - y[j] * hessian[2, i]),
    )


@kernel
def _source_derivatives(
    vertices: Array, source: Array, nearest: float, source_gradient: Array, source_hessian: Array
) -> bool:
    """Fill gradient (3,) and Hessian (3, 3) of the flux by the source's place; False when it is on the rim.

    An edge from ``a`` to ``b``, as the source sees them, adds ``-n f`` to the gradient with ``n = a x b``, ``f = S / (P
    D)``, ``S = |a| + |b|``, ``P = |a| |b|`` and ``D = P + a.b`` (the field of a straight current, by Biot and Savart).
    With the unit vectors' sum ``q``: ``D' = S q``, so that the derivative of ``f`` by both ends together is ``q / (P D)
    - f (P'/P + S q / D)``, and that of ``n`` along a move ``d`` is ``(a - b) x d``.
    """
    source_gradient[:] = 0.0
    source_hessian[:] = 0.0
    last = len(vertices) - 1
    ax, ay, az = vertices[last, 0] - source[0], vertices[last, 1] - source[1], vertices[last, 2] - source[2]
    la = math.sqrt(ax * ax + ay * ay + az * az)
    for i in range(last + 1):
        bx, by, bz = vertices[i, 0] - source[0], vertices[i, 1] - source[1], vertices[i, 2] - source[2]
        lb = math.sqrt(bx * bx + by * by + bz * bz)
        ex, ey, ez = bx - ax, by - ay, bz - az
        total, product, dot = la + lb, la * lb, ax * bx + ay * by + az * bz
        edge2 = ex * ex + ey * ey + ez * ez
        # Nobody outside this ellipse around the edge is near it
        if (total - 2.0 * nearest) ** 2 <= edge2 and _edge_distance(ax, ay, az, bx, by, bz) < nearest:
            return False
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        # Near the edge the plain sum cancels; the other branch is the same by its conjugate
        d = product + dot if dot >= 0.0 else (nx * nx + ny * ny + nz * nz) / (product - dot)
        whole = 1.0 / (product * d)
        f = total * whole
        by_a = whole - f * (1.0 / la + total / d)  # shares of the two unit vectors in the derivative of f, times P
        by_b = whole - f * (1.0 / lb + total / d)
        ua, ub = by_a / la, by_b / lb
        fx, fy, fz = ua * ax + ub * bx, ua * ay + ub * by, ua * az + ub * bz
        source_gradient[0] -= nx * f
        source_gradient[1] -= ny * f
        source_gradient[2] -= nz * f
        source_hessian[0, 0] += nx * fx
        source_hessian[0, 1] += nx * fy + f * ez
        source_hessian[0, 2] += nx * fz - f * ey
        source_hessian[1, 0] += ny * fx - f * ez
        source_hessian[1, 1] += ny * fy
        source_hessian[1, 2] += ny * fz + f * ex
        source_hessian[2, 0] += nz * fx + f * ey
        source_hessian[2, 1] += nz * fy - f * ex
        source_hessian[2, 2] += nz * fz
        ax, ay, az, la = bx, by, bz, lb
    for p in range(3):
        for q in range(p):
            mean = 0.5 * (
                source_hessian[p, q] + source_hessian[q, p]
            )  # around the whole rim it is symmetric, but for rounding
            source_hessian[p, q], source_hessian[q, p] = mean, mean
    return True


@kernel
def _edge_distance(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> float:
    """Distance of the origin from the straight line between two points."""
    dx, dy, dz = bx - ax, by - ay, bz - az
    share = -(ax * dx + ay * dy + az * dz) / max(dx * dx + dy * dy + dz * dz, 1e-300)
    share = min(max(share, 0.0), 1.0)
    x, y, z = ax + share * dx, ay + share * dy, az + share * dz
    return math.sqrt(x * x + y * y + z * z)
