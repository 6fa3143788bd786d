"""Compiled kernels of the flux through a polygon: what :mod:`fg_gcs.core.solid_angle` defines, for hot loops.

The formulas are those of the module above; a test holds both against each other. Compiled code is cached beside the
source, so only the first process after an installation waits for the compiler.
"""

from __future__ import annotations

import math

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array


@kernel
def polygon_flux(vertices: Array, source: Array) -> float:
    """Return the flux of a unit source through a polygon; vertices (N, 3) [m], source (3,) [m], result [sr].

    A source in the plane of a fan triangle counts as in front of it, as in the reference.
    """
    total = 0.0
    ax, ay, az = vertices[0, 0] - source[0], vertices[0, 1] - source[1], vertices[0, 2] - source[2]
    a = math.sqrt(ax * ax + ay * ay + az * az)
    bx, by, bz = vertices[1, 0] - source[0], vertices[1, 1] - source[1], vertices[1, 2] - source[2]
    b = math.sqrt(bx * bx + by * by + bz * bz)
    for i in range(2, vertices.shape[0]):
        cx, cy, cz = vertices[i, 0] - source[0], vertices[i, 1] - source[1], vertices[i, 2] - source[2]
        c = math.sqrt(cx * cx + cy * cy + cz * cz)
        triple = (by * az - bz * ay) * cx + (bz * ax - bx * az) * cy + (bx * ay - by * ax) * cz
        ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        least = 1e-9 * math.sqrt(nx * nx + ny * ny + nz * nz) * max(a, b)
        if abs(triple) < least:
            triple = least
        bottom = (
            a * b * c
            + (ax * bx + ay * by + az * bz) * c
            + (ax * cx + ay * cy + az * cz) * b
            + (bx * cx + by * cy + bz * cz) * a
        )
        total += 2.0 * math.atan2(triple, bottom)
        bx, by, bz, b = cx, cy, cz, c
    return total


@kernel
def edge_derivatives(ax: float, ay: float, az: float, bx: float, by: float, bz: float, out: Array) -> None:
    """Fill ``out`` with one edge's derivatives by its ends; both given as seen from the source [m].

    Rows 0 and 1 of ``out``, shape (14, 3), are the gradient by a and by b; rows 2..4, 5..7, 8..10 and 11..13 are the
    Hessian blocks aa, ab, ba and bb (row of the block: component of the gradient).
    """
    la = math.sqrt(ax * ax + ay * ay + az * az)
    lb = math.sqrt(bx * bx + by * by + bz * bz)
    dot = ax * bx + ay * by + az * bz
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    # Near the edge the plain sum cancels; the other branch is the same by its conjugate
    d = la * lb + dot if dot >= 0.0 else (nx * nx + ny * ny + nz * nz) / (la * lb - dot)
    fa, fb = 1.0 / (la * d), 1.0 / (lb * d)
    n = (nx, ny, nz)
    a = (ax, ay, az)
    b = (bx, by, bz)
    for k in range(3):
        out[0, k] = n[k] * fa
        out[1, k] = n[k] * fb
    for j in range(3):  # column: derivative by component j
        fa_a = -fa * fa * (2.0 * lb * a[j] + dot * a[j] / la + la * b[j])
        fa_b = -fa * fa * (la * la * b[j] / lb + la * a[j])
        fb_a = -fb * fb * (lb * lb * a[j] / la + lb * b[j])
        fb_b = -fb * fb * (2.0 * la * b[j] + dot * b[j] / lb + lb * a[j])
        for i in range(3):
            out[2 + i, j] = n[i] * fa_a
            out[5 + i, j] = n[i] * fa_b
            out[8 + i, j] = n[i] * fb_a
            out[11 + i, j] = n[i] * fb_b
    # n = a x b, so dn = [a] db - [b] da with the cross-product matrices [.]
    out[2, 1] += fa * bz
    out[2, 2] -= fa * by
    out[3, 0] -= fa * bz
    out[3, 2] += fa * bx
    out[4, 0] += fa * by
    out[4, 1] -= fa * bx
    out[8, 1] += fb * bz
    out[8, 2] -= fb * by
    out[9, 0] -= fb * bz
    out[9, 2] += fb * bx
    out[10, 0] += fb * by
    out[10, 1] -= fb * bx
    out[5, 1] -= fa * az
    out[5, 2] += fa * ay
    out[6, 0] += fa * az
    out[6, 2] -= fa * ax
    out[7, 0] -= fa * ay
    out[7, 1] += fa * ax
    out[11, 1] -= fb * az
    out[11, 2] += fb * ay
    out[12, 0] += fb * az
    out[12, 2] -= fb * ax
    out[13, 0] -= fb * ay
    out[13, 1] += fb * ax
