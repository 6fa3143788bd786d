"""The flux-guided search on the six degrees of freedom of a rigid face, compiled.

Everything that runs once a step lives here: flux, gradient and Hessian by small moves and turns, the exact trust-region
step, and the loop around them. :mod:`fg_gcs.plan.flux_guided` explains the method and gives it its types.
"""

from __future__ import annotations

import math

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.core.kernels import polygon_flux
from fg_gcs.plan.path.splines import cross
from fg_gcs.plan.search.trust_region import maximise_in_ball

STEP_M = 1.0  # bound on the leaders' root mean square move in one step near the target: keeps the path smooth
STEP_OF_DISTANCE = (
    0.1  # the bound grows with the distance to the target, so that 10 km take tens of steps, not thousands
)
STEP_GROWTH = 2.0  # from step to step: a spline through steps that grow gently does not swing
TURNED = 0.5  # cosine between normal and target from which on steps grow: before, long ones would go astray
TURN_RAD = 0.3  # largest turn in one step: keeps the attitude's spline true to the iterates
ACCEPT = 0.1  # least share of the predicted gain that a step must bring (any value below 1/4 converges, [More1983]_)
SURROUNDED = 0.75  # flux metric from which the last slide to the axis starts, about 0.25 radii in front of the face
NEAR_RIM = 1e-3  # closer to the rim than this share of its size the flux has no derivative
SCALE_SHARE = 0.3  # of a step may go into a change of scale, measured at the leaders

STALLED = 1e-6  # a trust region this small gains nothing any more
SAME = 1e-9  # metres and shares below which two poses are one

FOUND, ON_RIM, TOO_MANY, NO_NUMBERS = range(4)


@kernel
def search(
    rim: Array, sources: Array, weights: Array, depth: float, start: Array, last_scale: float, poses: Array
) -> tuple[int, int, int]:
    """Fill ``poses`` with the path up to where the target is surrounded, and the slide to its hold.

    Args:
        rim: leaders of the template, shape (N, 3) [m].
        sources: positions, shape (C, 3) [m].
        weights: of the sources, shape (C,), their sum is 1.
        depth: of the centre of charge behind the face in the hold [m].
        start: pose as :func:`keep` writes it, shape (13,).
        last_scale: of the template, to reach on the way at a bounded rate.
        poses: room for the path, shape (K, 13).

    Returns:
        How it ended (FOUND, ON_RIM, TOO_MANY or NO_NUMBERS), the number of poses and the number of steps tried.
    """
    if not (_all_finite(start) and _all_finite(sources.ravel()) and start[12] > 0.0 and 0.0 < last_scale < math.inf):
        return NO_NUMBERS, 0, 0
    gyration = math.sqrt((rim * rim).sum() / rim.shape[0])
    target = centre_of(sources, weights)
    vertices = np.empty_like(rim)
    gradient, hessian = np.empty(6), np.empty((6, 6))
    centre, rotation, scale = start[:3].copy(), start[3:12].copy().reshape(3, 3), start[12]
    moved_centre = np.empty(3)
    region = 1.0  # trust radius as a share of the largest step
    against = False
    flux, known = 0.0, False
    bound = step_bound(centre, rotation, target, math.inf)
    count = 1
    poses[0] = start
    for tried in range(poses.shape[0] - 2):
        place(rim, centre, rotation, scale, vertices)
        if not known:
            flux = charged_flux(vertices, sources, weights)
        if surrounded(vertices, target, len(sources), flux) or among(centre, rotation, target, gyration * scale):
            return FOUND, slid(poses, count, target, depth, last_scale), tried
        if region < STALLED:
            if flux > 0.0 and len(sources) > 1:  # the most flux of several sources is had in front of them
                return FOUND, slid(poses, count, target, depth, last_scale), tried
            against = True  # a face that looks away can sit on a maximum: turn against the flux until it looks round
        if against and flux <= 0.0:
            rotation = _turned_round(rotation, target - centre)
            keep(poses, count, centre, rotation, scale)
            count += 1
            region, known = 1.0, False
            continue
        nearest = NEAR_RIM * gyration * scale
        if not pose_derivatives(vertices, centre, sources, weights, nearest, gradient, hessian):
            if flux > 0.0 and len(sources) > 1:  # as far as this one lets the face come
                return FOUND, slid(poses, count, target, depth, last_scale), tried
            return ON_RIM, count, tried
        size = region * bound
        turn = min(size / (gyration * scale), TURN_RAD)
        step, predicted = _best_step(gradient, hessian, size, turn, flux > 0.0)
        next_scale = toward(scale, last_scale, SCALE_SHARE * size / gyration)
        for k in range(3):
            moved_centre[k] = centre[k] + step[k]
        moved_rotation = turned(rotation, step[3], step[4], step[5])
        place(rim, moved_centre, moved_rotation, scale, vertices)
        moved_flux = charged_flux(vertices, sources, weights)
        known = True
        if moved_flux - flux > ACCEPT * predicted:
            centre[:], rotation[:] = moved_centre, moved_rotation
            flux, known = moved_flux, next_scale == scale
            scale = next_scale
            keep(poses, count, centre, rotation, scale)
            count += 1
            region = min(1.0, 2.0 * region)
            bound = step_bound(centre, rotation, target, bound)
        else:
            region *= 0.25
    return TOO_MANY, count, poses.shape[0] - 2


@kernel
def slid(poses: Array, count: int, target: Array, depth: float, last_scale: float) -> int:
    """Write the hold behind ``count`` poses, a straight slide away from the last one, if it differs; return the count.

    ``poses`` must have room for it.
    """
    last, hold = poses[count - 1], poses[count]
    hold[3:12] = last[3:12]
    hold[12] = last_scale
    most = abs(last_scale - last[12])
    for k in range(3):
        hold[k] = target[k] + depth * last[3 + 3 * k]
        most = max(most, abs(hold[k] - last[k]))
    return count + 1 if most > SAME else count


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
def surrounded(vertices: Array, target: Array, sources: int, flux: float) -> bool:
    """Say whether the last slide may start: a source in the centre of charge would send nearly all that it can.

    ``flux`` is that of the sources; of a single one it is the one wanted. A source that has just passed the face has
    the flux of the other half sphere, with the other sign.
    """
    own = flux if sources == 1 else polygon_flux(vertices, target)
    unwrapped = own + 4.0 * math.pi if own < -math.pi else own
    return unwrapped > SURROUNDED * 2.0 * math.pi


@kernel
def _all_finite(values: Array) -> bool:
    for value in values:  # noqa: SIM110 (the compiler takes a plain loop sooner than a generator)
        if not math.isfinite(value):
            return False
    return True


@kernel
def _best_step(gradient: Array, hessian: Array, size: float, turn: float, may_move: bool) -> tuple[Array, float]:
    """Best (move, turn) in the region and the gain it predicts; a face that looks away only turns."""
    first = 0 if may_move else 3
    count = 6 - first
    reach = np.empty(count)
    scaled_gradient, scaled_hessian = np.empty(count), np.empty((count, count))
    for i in range(count):
        reach[i] = size if first + i < 3 else turn
        scaled_gradient[i] = gradient[first + i] * reach[i]
    for i in range(count):
        for j in range(count):
            scaled_hessian[i, j] = hessian[first + i, first + j] * reach[i] * reach[j]
    unit = maximise_in_ball(scaled_gradient, scaled_hessian)
    step = np.zeros(6)
    predicted = 0.0
    for i in range(count):
        step[first + i] = reach[i] * unit[i]
        predicted += scaled_gradient[i] * unit[i]
        for j in range(count):
            predicted += 0.5 * unit[i] * scaled_hessian[i, j] * unit[j]
    return step, predicted


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
            column = cross(
                y,
                (
                    weight
                    * (
                        y[(q + 1) % 3] * source_hessian[0, (q + 2) % 3]
                        - y[(q + 2) % 3] * source_hessian[0, (q + 1) % 3]
                    ),
                    weight
                    * (
                        y[(q + 1) % 3] * source_hessian[1, (q + 2) % 3]
                        - y[(q + 2) % 3] * source_hessian[1, (q + 1) % 3]
                    ),
                    weight
                    * (
                        y[(q + 1) % 3] * source_hessian[2, (q + 2) % 3]
                        - y[(q + 2) % 3] * source_hessian[2, (q + 1) % 3]
                    ),
                ),
            )
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
def among(centre: Array, rotation: Array, target: Array, radius: float) -> bool:
    """Say whether the target lies behind the face, among the swarm: there a straight slide ends the path."""
    distance2, ahead = 0.0, 0.0
    for k in range(3):
        gap = target[k] - centre[k]
        distance2 += gap * gap
        ahead += gap * rotation[k, 0]
    return ahead <= 0.0 and distance2 < radius * radius


@kernel
def _turned_round(rotation: Array, ahead: Array) -> Array:
    """Turn the normal towards a direction by the largest step; exactly against it, about the template's z axis."""
    x = rotation[1, 0] * ahead[2] - rotation[2, 0] * ahead[1]
    y = rotation[2, 0] * ahead[0] - rotation[0, 0] * ahead[2]
    z = rotation[0, 0] * ahead[1] - rotation[1, 0] * ahead[0]
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-6 * math.sqrt((ahead * ahead).sum()):
        return turned(rotation, TURN_RAD * rotation[0, 2], TURN_RAD * rotation[1, 2], TURN_RAD * rotation[2, 2])
    return turned(rotation, TURN_RAD * x / length, TURN_RAD * y / length, TURN_RAD * z / length)


@kernel
def _edge_distance(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> float:
    """Distance of the origin from the straight line between two points."""
    dx, dy, dz = bx - ax, by - ay, bz - az
    share = -(ax * dx + ay * dy + az * dz) / max(dx * dx + dy * dy + dz * dz, 1e-300)
    share = min(max(share, 0.0), 1.0)
    x, y, z = ax + share * dx, ay + share * dy, az + share * dz
    return math.sqrt(x * x + y * y + z * z)


@kernel
def place(rim: Array, centre: Array, rotation: Array, scale: float, out: Array) -> None:
    """Fill ``out``, shape (N, 3), with the rim of the template at a pose [m; ENU]."""
    for i in range(rim.shape[0]):
        for k in range(3):
            arm = rotation[k, 0] * rim[i, 0] + rotation[k, 1] * rim[i, 1] + rotation[k, 2] * rim[i, 2]
            out[i, k] = centre[k] + scale * arm


@kernel
def turned(rotation: Array, x: float, y: float, z: float) -> Array:
    """The rotation turned by a rotation vector in ENU, by Rodrigues' formula."""
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-24:  # a turn of a picoradian is none
        return rotation.copy()
    angle = math.sqrt(angle2)
    s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    turn = np.empty((3, 3))
    turn[0, 0], turn[0, 1], turn[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    turn[1, 0], turn[1, 1], turn[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    turn[2, 0], turn[2, 1], turn[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)
    product = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            product[i, j] = turn[i, 0] * rotation[0, j] + turn[i, 1] * rotation[1, j] + turn[i, 2] * rotation[2, j]
    return product


@kernel
def step_bound(centre: Array, rotation: Array, target: Array, last: float) -> float:
    """Largest move of the leaders in one step, root mean square; long when the face looks at a far target [m]."""
    distance2, ahead = 0.0, 0.0
    for k in range(3):
        gap = target[k] - centre[k]
        distance2 += gap * gap
        ahead += gap * rotation[k, 0]
    distance = math.sqrt(distance2)
    if ahead <= TURNED * distance:
        return STEP_M
    return max(STEP_M, min(STEP_OF_DISTANCE * distance, STEP_GROWTH * last))


@kernel
def toward(value: float, goal: float, reach: float) -> float:
    """Return the value moved towards the goal by at most ``reach``."""
    return goal if abs(goal - value) <= reach else value + math.copysign(reach, goal - value)


@kernel
def keep(poses: Array, row: int, centre: Array, rotation: Array, scale: float) -> None:
    """Write a pose as a row: centre, rotation by rows, scale; 13 numbers."""
    poses[row, :3] = centre
    poses[row, 3:12] = rotation.ravel()
    poses[row, 12] = scale
