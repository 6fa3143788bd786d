"""The flux-guided search on the six degrees of freedom of a rigid face, compiled.

Everything that runs once a step lives here: flux, gradient and Hessian by small moves and turns, the exact trust-region
step, and the loop around them. :mod:`fg_gcs.plan.flux_guided` explains the method and gives it its types.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fg_gcs.core.kernels import edge_derivatives, polygon_flux

Array = NDArray[np.float64]

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

FOUND, ON_RIM, TOO_MANY = range(3)


@njit(cache=True)
def search(
    rim: Array, target: Array, centre: Array, rotation: Array, scale: float, last_scale: float, poses: Array
) -> tuple[int, int, int]:
    """Fill ``poses`` with the path up to where the target is surrounded.

    Args:
        rim: leaders of the template, shape (N, 3) [m].
        target: shape (3,) [m].
        centre: of the face at the start, shape (3,) [m].
        rotation: template axes to ENU at the start, shape (3, 3).
        scale: of the template at the start.
        last_scale: to reach on the way, at a bounded rate.
        poses: room for the path, shape (K, 13): centre, rotation by rows, scale.

    Returns:
        How it ended (FOUND, ON_RIM or TOO_MANY), the number of poses and the number of steps tried.
    """
    gyration = math.sqrt((rim * rim).sum() / rim.shape[0])
    vertices = np.empty_like(rim)
    gradient, hessian = np.empty(6), np.empty((6, 6))
    centre, rotation = centre.copy(), rotation.copy()
    moved_centre = np.empty(3)
    region = 1.0  # trust radius as a share of the largest step
    against = False
    bound = step_bound(centre, rotation, target, math.inf)
    count = 0
    keep(poses, count, centre, rotation, scale)
    count += 1
    for tried in range(poses.shape[0] - 1):
        place(rim, centre, rotation, scale, vertices)
        flux = polygon_flux(vertices, target)
        unwrapped = flux + 4.0 * math.pi if flux < -math.pi else flux
        if unwrapped > SURROUNDED * 2.0 * math.pi or among(centre, rotation, target, gyration * scale):
            return FOUND, count, tried
        if region < STALLED:  # a face that looks away can sit on a maximum: turn against the flux until it looks round
            against = True
        if against and flux <= 0.0:
            rotation = _turned_round(rotation, target - centre)
            keep(poses, count, centre, rotation, scale)
            count += 1
            region = 1.0
            continue
        if not pose_derivatives(vertices, centre, target, NEAR_RIM * gyration * scale, gradient, hessian):
            return ON_RIM, count, tried
        size = region * bound
        turn = min(size / (gyration * scale), TURN_RAD)
        step, predicted = _best_step(gradient, hessian, size, turn, flux > 0.0)
        next_scale = toward(scale, last_scale, SCALE_SHARE * size / gyration)
        for k in range(3):
            moved_centre[k] = centre[k] + step[k]
        moved_rotation = turned(rotation, step[3], step[4], step[5])
        place(rim, moved_centre, moved_rotation, scale, vertices)
        if polygon_flux(vertices, target) - flux > ACCEPT * predicted:
            centre[:], rotation[:] = moved_centre, moved_rotation
            scale = next_scale
            keep(poses, count, centre, rotation, scale)
            count += 1
            region = min(1.0, 2.0 * region)
            bound = step_bound(centre, rotation, target, bound)
        else:
            region *= 0.25
    return TOO_MANY, count, poses.shape[0] - 1


@njit(cache=True)
def maximise_in_ball(gradient: Array, hessian: Array) -> Array:
    """Return the x with ``|x| <= 1`` that maximises ``g . x + x . H x / 2`` [More1983]_.

    In the eigenvectors of H the solution is ``x = (m I - H)^-1 g`` with the smallest multiplier ``m >= 0`` that makes
    ``m I - H`` positive semi-definite and the length one, found by Newton's iteration on the reciprocal length, which
    is nearly linear in ``m``. In the hard case (no gradient along the leading eigenvector) the rest of the length
    goes along that eigenvector, its first component that is not zero made positive.
    """
    count = len(gradient)
    values, vectors = np.linalg.eigh(hessian)
    along = np.zeros(count)  # loops instead of matrix products: calling a library costs more than six by six numbers
    size = 0.0
    for k in range(count):
        for i in range(count):
            along[k] += vectors[i, k] * gradient[i]
        size += gradient[k] * gradient[k]
    top = values[count - 1]
    size = math.sqrt(size) + max(abs(values[0]), abs(top))
    if size == 0.0:
        return np.zeros(count)
    floor = max(top, 0.0) + 1e-9 * size  # just above the pole; what it costs in length the hard case restores
    lowest = 0.0 if top < -1e-12 * size else floor
    length2 = 0.0
    for k in range(count):
        length2 += (along[k] / (lowest - values[k])) ** 2
    if length2 <= 1.0:
        inside = _combined(vectors, along, values, lowest)
        if lowest == 0.0:
            return inside
        sign = 1.0
        for k in range(count):
            if abs(vectors[k, count - 1]) > 1e-9:
                sign = 1.0 if vectors[k, count - 1] > 0.0 else -1.0
                break
        return inside + math.sqrt(1.0 - length2) * sign * vectors[:, count - 1]
    multiplier = lowest
    for _ in range(100):  # each round raises the multiplier towards the root, from below, for ever more digits
        length2, slope = 0.0, 0.0
        for k in range(count):
            part = along[k] / (multiplier - values[k])
            length2 += part * part
            slope += part * part / (multiplier - values[k])
        length = math.sqrt(length2)
        if length < 1.0 + 1e-10:
            break
        multiplier += (length - 1.0) * length2 / slope
    return _combined(vectors, along, values, multiplier)


@njit(cache=True)
def _combined(vectors: Array, along: Array, values: Array, multiplier: float) -> Array:
    """``(m I - H)^-1 g`` in the eigenvectors of H."""
    result = np.zeros(len(values))
    for k in range(len(values)):
        part = along[k] / (multiplier - values[k])
        for i in range(len(values)):
            result[i] += vectors[i, k] * part
    return result


@njit(cache=True)
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


@njit(cache=True)
def pose_derivatives(
    vertices: Array, centre: Array, target: Array, nearest: float, gradient: Array, hessian: Array
) -> bool:
    """Fill the flux's derivatives by small moves and turns about the centre; False when the target is on the rim.

    With the arm ``r`` of a vertex and the cross-product matrix ``[r]``, a turn ``w`` moves it by ``-[r] w``, so a
    block H of the vertices' Hessian adds ``H``, ``-H [r]``, ``[r] H`` and ``-[r] H [r]``. A turn also bends: the
    second-order part ``w x (w x r) / 2`` meets the gradient.
    """
    count = vertices.shape[0]
    gradient[:] = 0.0
    hessian[:] = 0.0
    edge = np.empty((14, 3))
    turned, both = np.empty((3, 3)), np.empty((3, 3))
    arms = np.empty((2, 3))
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        ax, ay, az = vertices[i, 0] - target[0], vertices[i, 1] - target[1], vertices[i, 2] - target[2]
        bx, by, bz = vertices[j, 0] - target[0], vertices[j, 1] - target[1], vertices[j, 2] - target[2]
        if _edge_distance(ax, ay, az, bx, by, bz) < nearest:
            return False
        edge_derivatives(ax, ay, az, bx, by, bz, edge)
        for k in range(3):
            arms[0, k] = vertices[i, k] - centre[k]
            arms[1, k] = vertices[j, k] - centre[k]
        for row in range(2):
            rx, ry, rz = arms[row]
            gx, gy, gz = edge[row]
            gradient[0] += gx
            gradient[1] += gy
            gradient[2] += gz
            gradient[3] += ry * gz - rz * gy
            gradient[4] += rz * gx - rx * gz
            gradient[5] += rx * gy - ry * gx
            straight = rx * gx + ry * gy + rz * gz
            for p in range(3):
                for q in range(3):
                    hessian[3 + p, 3 + q] += 0.5 * (arms[row, p] * edge[row, q] + edge[row, p] * arms[row, q])
                hessian[3 + p, 3 + p] -= straight
            for column in range(2):
                block = edge[2 + 6 * row + 3 * column : 5 + 6 * row + 3 * column]
                _times_minus_cross(block, arms[column], turned)
                _cross_times(arms[row], turned, both)
                for p in range(3):
                    for q in range(3):
                        hessian[p, q] += block[p, q]
                        hessian[p, 3 + q] += turned[p, q]
                        hessian[3 + p, 3 + q] += both[p, q]
    for p in range(6):
        for q in range(p):
            if p >= 3 > q:
                hessian[p, q] = hessian[q, p]
            else:
                mean = 0.5 * (hessian[p, q] + hessian[q, p])
                hessian[p, q] = mean
                hessian[q, p] = mean
    return True


@njit(cache=True)
def among(centre: Array, rotation: Array, target: Array, radius: float) -> bool:
    """Say whether the target lies behind the face, among the swarm: there a straight slide ends the path."""
    distance2, ahead = 0.0, 0.0
    for k in range(3):
        gap = target[k] - centre[k]
        distance2 += gap * gap
        ahead += gap * rotation[k, 0]
    return ahead <= 0.0 and distance2 < radius * radius


@njit(cache=True)
def _turned_round(rotation: Array, ahead: Array) -> Array:
    """Turn the normal towards a direction by the largest step; exactly against it, about the template's z axis."""
    x = rotation[1, 0] * ahead[2] - rotation[2, 0] * ahead[1]
    y = rotation[2, 0] * ahead[0] - rotation[0, 0] * ahead[2]
    z = rotation[0, 0] * ahead[1] - rotation[1, 0] * ahead[0]
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-6 * math.sqrt((ahead * ahead).sum()):
        return turned(rotation, TURN_RAD * rotation[0, 2], TURN_RAD * rotation[1, 2], TURN_RAD * rotation[2, 2])
    return turned(rotation, TURN_RAD * x / length, TURN_RAD * y / length, TURN_RAD * z / length)


@njit(cache=True)
def _edge_distance(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> float:
    """Distance of the origin from the straight line between two points."""
    dx, dy, dz = bx - ax, by - ay, bz - az
    share = -(ax * dx + ay * dy + az * dz) / max(dx * dx + dy * dy + dz * dz, 1e-300)
    share = min(max(share, 0.0), 1.0)
    x, y, z = ax + share * dx, ay + share * dy, az + share * dz
    return math.sqrt(x * x + y * y + z * z)


@njit(cache=True)
def _times_minus_cross(matrix: Array, arm: Array, out: Array) -> None:
    """``out = -matrix @ [arm]``."""
    x, y, z = arm
    for p in range(3):
        out[p, 0] = -(matrix[p, 1] * z - matrix[p, 2] * y)
        out[p, 1] = -(matrix[p, 2] * x - matrix[p, 0] * z)
        out[p, 2] = -(matrix[p, 0] * y - matrix[p, 1] * x)


@njit(cache=True)
def _cross_times(arm: Array, matrix: Array, out: Array) -> None:
    """``out = [arm] @ matrix``."""
    x, y, z = arm
    for q in range(3):
        out[0, q] = y * matrix[2, q] - z * matrix[1, q]
        out[1, q] = z * matrix[0, q] - x * matrix[2, q]
        out[2, q] = x * matrix[1, q] - y * matrix[0, q]


@njit(cache=True)
def place(rim: Array, centre: Array, rotation: Array, scale: float, out: Array) -> None:
    """Fill ``out``, shape (N, 3), with the rim of the template at a pose [m; ENU]."""
    for i in range(rim.shape[0]):
        for k in range(3):
            arm = rotation[k, 0] * rim[i, 0] + rotation[k, 1] * rim[i, 1] + rotation[k, 2] * rim[i, 2]
            out[i, k] = centre[k] + scale * arm


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def toward(value: float, goal: float, reach: float) -> float:
    """Return the value moved towards the goal by at most ``reach``."""
    return goal if abs(goal - value) <= reach else value + math.copysign(reach, goal - value)


@njit(cache=True)
def keep(poses: Array, row: int, centre: Array, rotation: Array, scale: float) -> None:
    """Write a pose as a row: centre, rotation by rows, scale; 13 numbers."""
    poses[row, :3] = centre
    poses[row, 3:12] = rotation.ravel()
    poses[row, 12] = scale
