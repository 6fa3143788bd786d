"""The flux-guided searches on the six degrees of freedom of a rigid face, compiled: in the open and inside a fence.

:mod:`fg_gcs.plan.flux_guided` explains the method and gives it its types. Inside a fence each step starts as it does in
the open. When a vehicle would leave the fence, now or in the hold that the step's attitude would end in, the plane that
it breaks becomes an equality of the subproblem, linear in (move, turn): with the arm ``r`` of the vehicle and the
plane's normal ``e``, ``e . move + (r x e) . turn = gap``. The step is then the shortest one that meets all planes so
far, plus the best one along them in what is left of the trust region; planes are added until the step stays inside.

Both searches take

- ``rim``: leaders of the template, shape (N, 3) [m];
- ``points``: all slots, or points that enclose them, shape (P, 3) [m];
- ``sources`` and ``weights``: their positions, shape (C, 3) [m], and weights, shape (C,), whose sum is 1;
- ``depth``: of the centre of charge behind the face in the hold [m];
- ``start``: pose as :func:`fg_gcs.plan.search.pose_model.keep` writes it, shape (13,);
- ``last_scale``: of the template, to reach on the way at a bounded rate;
- ``low`` and ``high``: corners of the fence, each of shape (3,) [m];
- ``poses``: room for the path, shape (K, 13);

and return how they ended (FOUND, ON_RIM, TOO_MANY or NO_NUMBERS), the number of poses and the number of steps tried.
"""

from __future__ import annotations

import math

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.core.kernels import polygon_flux
from fg_gcs.plan.search.pose_model import centre_of, charged_flux, keep, place, pose_derivatives, turned
from fg_gcs.plan.search.steps import (
    ACCEPT,
    FOUND,
    NEAR_RIM,
    NO_NUMBERS,
    ON_RIM,
    TOO_MANY,
    TURN_RAD,
    longest_step,
    surrounds,
)
from fg_gcs.plan.search.trust_region import gain, maximise_in_ball

SCALE_SHARE = 0.3  # of a step may go into a change of scale, measured at the leaders
STALLED = 1e-6  # a trust region this small gains nothing any more
SAME = 1e-9  # metres and shares below which two poses are one
PLANES = 5  # more equalities than this leave six degrees of freedom nothing to choose
OUTSIDE_M = 1e-3  # what the subproblem's straight planes may miss by; the path is bent in millimetres, not in angstroms
CORRECTION = 0.8  # share of the trust region that meeting the planes may take
HOLD_SHARE = 0.5  # of the trust region that a plane of the hold may take
HOLD_RADII = 4.0  # from this many radii of the formation on, the attitude must be one that fits around the target


@kernel
def search(
    rim: Array, sources: Array, weights: Array, depth: float, start: Array, last_scale: float, poses: Array
) -> tuple[int, int, int]:
    """Fill ``poses`` with the path up to where the target is surrounded, and the slide to its hold.

    Arguments and results are those of both searches, see the module.
    """
    if not (_all_finite(start) and _all_finite(sources.ravel()) and start[12] > 0.0 and 0.0 < last_scale < math.inf):
        return NO_NUMBERS, 0, 0
    gyration = math.sqrt((rim * rim).sum() / rim.shape[0])
    target = centre_of(sources, weights)
    vertices = np.empty_like(rim)
    gradient, hessian = np.empty(6), np.empty((6, 6))
    centre, rotation, scale = start[:3].copy(), start[3:12].copy().reshape(3, 3), start[12]
    region, against = 1.0, False  # trust radius as a share of the largest step; turning against the flux
    flux, known = 0.0, False
    bound, count = _step_bound(centre, rotation, target, math.inf), 1
    poses[0] = start
    for tried in range(poses.shape[0] - 2):
        place(rim, centre, rotation, scale, vertices)
        if not known:
            flux = charged_flux(vertices, sources, weights)
        arrived = _surrounded(vertices, target, len(sources), flux) or _among(
            centre, rotation, target, gyration * scale
        )
        several = flux > 0.0 and len(sources) > 1  # the most flux of several sources is had in front of them
        if arrived or (region < STALLED and several):
            return FOUND, _slid(poses, count, target, depth, last_scale), tried
        against = against or region < STALLED  # a face turned away can sit on a maximum: turn against the flux
        if against and flux <= 0.0:
            rotation = _turned_round(rotation, target - centre)
            keep(poses, count, centre, rotation, scale)
            count += 1
            region, known = 1.0, False
            continue
        nearest = NEAR_RIM * gyration * scale
        if not pose_derivatives(vertices, centre, sources, weights, nearest, gradient, hessian):
            if not several:
                return ON_RIM, count, tried
            return FOUND, _slid(poses, count, target, depth, last_scale), tried  # as far as this source lets it come
        size = region * bound
        turn = min(size / (gyration * scale), TURN_RAD)
        step, predicted = _best_step(gradient, hessian, size, turn, flux > 0.0)
        next_scale = _toward(scale, last_scale, SCALE_SHARE * size / gyration)
        moved_centre = centre + step[:3]
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
            bound = _step_bound(centre, rotation, target, bound)
        else:
            region *= 0.25
    return TOO_MANY, count, poses.shape[0] - 2


@kernel
def _best_step(gradient: Array, hessian: Array, size: float, turn: float, may_move: bool) -> tuple[Array, float]:
    """Best (move, turn) in the region and the gain it predicts; a face turned away only turns."""
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
    for i in range(count):
        step[first + i] = reach[i] * unit[i]
    return step, gain(scaled_gradient, scaled_hessian, unit)


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
def _toward(value: float, goal: float, reach: float) -> float:
    """Return the value moved towards the goal by at most ``reach``."""
    return goal if abs(goal - value) <= reach else value + math.copysign(reach, goal - value)


@kernel
def search_inside(
    rim: Array,
    points: Array,
    sources: Array,
    weights: Array,
    depth: float,
    start: Array,
    last_scale: float,
    low: Array,
    high: Array,
    poses: Array,
) -> tuple[int, int, int]:
    """Fill ``poses`` with a path inside the fence up to where the target is surrounded, and the slide to its hold.

    Arguments and results are those of both searches, see the module.
    """
    target = centre_of(sources, weights)
    centre, rotation = start[:3].copy(), start[3:12].copy().reshape(3, 3)
    first_distance = math.sqrt(((target - centre) ** 2).sum())
    widest = max(start[12], last_scale) * math.sqrt((points * points).sum(axis=1).max())
    vertices = np.empty_like(rim)
    gradient, hessian = np.empty(6), np.empty((6, 6))
    region, bound, count = 1.0, _step_bound(centre, rotation, target, math.inf), 1
    poses[0] = start
    for tried in range(poses.shape[0] - 2):
        distance = math.sqrt(((target - centre) ** 2).sum())
        scale = _scale_allowed(start[12], last_scale, distance, first_distance)
        gyration = scale * math.sqrt((rim * rim).sum() / rim.shape[0])
        place(rim, centre, rotation, scale, vertices)
        flux = charged_flux(vertices, sources, weights)
        hold = target + depth * rotation[:, 0]
        arrived = _surrounded(vertices, target, len(sources), flux) or _among(centre, rotation, target, gyration)
        if arrived and _worst(points, hold, rotation, last_scale, low, high)[0] <= OUTSIDE_M:
            return FOUND, _slid(poses, count, target, depth, last_scale), tried
        if not pose_derivatives(vertices, centre, sources, weights, NEAR_RIM * gyration, gradient, hessian):
            return ON_RIM, count, tried
        size = region * bound
        turn = min(size / gyration, TURN_RAD)
        reach = np.array([size, size, size, turn, turn, turn])
        near = distance < HOLD_RADII * widest
        step, predicted, planes = _bent_step(
            gradient, hessian, reach, flux > 0.0, points, centre, rotation, scale, target, depth, near, low, high
        )
        moved_centre = centre + step[:3]
        moved_rotation = turned(rotation, step[3], step[4], step[5])
        place(rim, moved_centre, moved_rotation, scale, vertices)
        gained = charged_flux(vertices, sources, weights) - flux
        before = max(_worst(points, centre, rotation, scale, low, high)[0], OUTSIDE_M)
        inside = _worst(points, moved_centre, moved_rotation, scale, low, high)[0] <= 2.0 * before
        if inside and (gained > ACCEPT * predicted or planes > 0):  # along a plane the way may lead down for a while
            centre, rotation = moved_centre, moved_rotation
            keep(poses, count, centre, rotation, scale)
            count += 1
            region = min(1.0, 2.0 * region)
            bound = _step_bound(centre, rotation, target, bound)
        else:
            region *= 0.25
    return TOO_MANY, count, poses.shape[0] - 2


@kernel
def _scale_allowed(first: float, last: float, distance: float, first_distance: float) -> float:
    """Scale at least as large as the path's will be here, see :class:`fg_gcs.plan.path.rigid_path.PosePath`.

    A formation that grows is counted as grown from the start. One that shrinks does so along its whole way, of which
    it has gone at least the share that it came nearer, as the rest of it is nearly straight.
    """
    if last >= first or first_distance == 0.0:
        return max(first, last)
    x = min(max(1.0 - distance / first_distance, 0.0), 1.0)
    return first + (last - first) * x * x * x * (10.0 + x * (6.0 * x - 15.0))


@kernel
def _bent_step(
    gradient: Array,
    hessian: Array,
    reach: Array,
    may_move: bool,
    points: Array,
    centre: Array,
    rotation: Array,
    scale: float,
    target: Array,
    depth: float,
    near: bool,
    low: Array,
    high: Array,
) -> tuple[Array, float, int]:
    """Best step that stays inside, the gain it predicts, and the number of planes it runs along."""
    g, h = gradient * reach, hessian * np.outer(reach, reach)
    if not may_move:  # a face turned away turns; planes may still push it
        g[:3] = 0.0
        h[:3, :] = 0.0
        h[:, :3] = 0.0
        h[0, 0], h[1, 1], h[2, 2] = -1.0, -1.0, -1.0
    rows, gaps = np.zeros((PLANES, 6)), np.zeros(PLANES)
    ids = np.full(PLANES, -1)
    planes = 0
    unit = maximise_in_ball(g, h)
    for _ in range(4 * PLANES):
        step = reach * unit
        moved_centre = centre + step[:3]
        moved_rotation = turned(rotation, step[3], step[4], step[5])
        outside, point, axis, sign = _worst(points, moved_centre, moved_rotation, scale, low, high)
        holding = False
        if near and outside <= OUTSIDE_M:  # what matters now comes first
            hold = target + depth * moved_rotation[:, 0]
            later, point2, axis2, sign2 = _worst(points, hold, moved_rotation, scale, low, high)
            outside, point, axis, sign, holding = later, point2, axis2, sign2, True
        if outside <= OUTSIDE_M:
            break
        identity = ((point * 3 + axis) * 2 + (1 if sign > 0 else 0)) * 2 + (1 if holding else 0)
        known = -1
        for k in range(planes):
            if ids[k] == identity:
                known = k
        if known >= 0 and holding:
            break  # it asks for as much already as a step gives
        elif known >= 0:
            gaps[known] += outside  # the plane is straight, the turn is not: ask for what is missing
        elif planes == PLANES:
            break
        else:
            corner = (points[point], axis, sign, holding)
            gaps[planes] = _plane(rows[planes], reach, corner, (centre, rotation, scale), target, depth, (low, high))
            ids[planes] = identity
            planes += 1
        unit = _along_planes(g, h, rows[:planes] * reach, gaps[:planes])
    return reach * unit, gain(g, h, unit), planes


@kernel
def _plane(
    row: Array,
    reach: Array,
    corner: tuple[Array, int, float, bool],
    pose: tuple[Array, Array, float],
    target: Array,
    depth: float,
    fence: tuple[Array, Array],
) -> float:
    """Fill a row with how a step takes a point towards a side of the fence; return how far it has to, at least [m].

    Args:
        row: filled, shape (6,).
        reach: of a step, shape (6,).
        corner: a point of the template, shape (3,) [m]; the axis and the sign (1: the low one) of the side; whether
            the point is meant in the hold, not on the way.
        pose: the present centre, shape (3,) [m], rotation, shape (3, 3), and scale.
        target: centre of charge, shape (3,) [m].
        depth: of it behind the face in the hold [m].
        fence: its low and its high corner, each of shape (3,) [m].
    """
    (point, axis, sign, holding), (centre, rotation, scale), (low, high) = corner, pose, fence
    arm = scale * (rotation @ point)
    if holding:
        arm = arm + depth * rotation[:, 0]
    normal = np.zeros(3)
    normal[axis] = sign
    if not holding:
        row[:3] = normal
    row[3:] = np.cross(arm, normal)
    place_now = (target if holding else centre) + arm
    edge = low[axis] if sign > 0 else high[axis]
    gap: float = sign * (edge - place_now[axis])
    if holding:  # the hold is still to come: its attitude is taken up in turns that leave room for the rest
        gap = min(gap, HOLD_SHARE * math.sqrt(((row * reach) ** 2).sum()))
    return gap


@kernel
def _along_planes(g: Array, h: Array, rows: Array, gaps: Array) -> Array:
    """Shortest point of ``rows y = gaps`` in the ball, plus the best step along the rows in what is left of it."""
    u, values, vt = np.linalg.svd(np.ascontiguousarray(rows), True)
    rank = 0
    for k in range(len(values)):
        rank += 1 if values[k] > 1e-9 * values[0] else 0
    normal = np.zeros(6)
    for k in range(rank):
        normal += vt[k] * ((u[:, k] * gaps).sum() / values[k])
    length = math.sqrt((normal * normal).sum())
    if length > CORRECTION:
        normal *= CORRECTION / length
        length = CORRECTION
    free = 6 - rank
    if free == 0:
        return normal
    along = np.ascontiguousarray(vt[rank:])  # (free, 6)
    left = math.sqrt(1.0 - length * length)
    reduced = left * (along @ (g + h @ normal))
    curved = left * left * (along @ h @ along.T)
    step: Array = normal + left * (along.T @ maximise_in_ball(reduced, curved))
    return step


@kernel
def _worst(
    points: Array, centre: Array, rotation: Array, scale: float, low: Array, high: Array
) -> tuple[float, int, int, float]:
    """By how much a point is furthest outside, which point, which axis, and the sign of the way back."""
    outside, point, axis, sign = -math.inf, 0, 0, 1.0
    for i in range(points.shape[0]):
        for k in range(3):
            arm = rotation[k, 0] * points[i, 0] + rotation[k, 1] * points[i, 1] + rotation[k, 2] * points[i, 2]
            value = centre[k] + scale * arm
            if low[k] - value > outside:
                outside, point, axis, sign = low[k] - value, i, k, 1.0
            if value - high[k] > outside:
                outside, point, axis, sign = value - high[k], i, k, -1.0
    return outside, point, axis, sign


@kernel
def furthest_outside(poses: Array, points: Array, low: Array, high: Array) -> float:
    """Return by how much a point of the body leaves the box in any pose, negative inside [m].

    Args:
        poses: shape (K, 13), as :func:`fg_gcs.plan.search.pose_model.keep` writes them.
        points: of the body, shape (P, 3) [m; template].
        low: lower corner of the box, shape (3,) [m].
        high: upper corner, shape (3,) [m].
    """
    outside = -math.inf
    for row in range(len(poses)):
        rotation = poses[row, 3:12].copy().reshape(3, 3)
        outside = max(outside, _worst(points, poses[row, :3], rotation, poses[row, 12], low, high)[0])
    return outside


@kernel
def _slid(poses: Array, count: int, target: Array, depth: float, last_scale: float) -> int:
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
def _surrounded(vertices: Array, target: Array, sources: int, flux: float) -> bool:
    """Say whether the last slide may start: a source in the centre of charge would send nearly all that it can.

    ``flux`` is that of the sources; of a single one it is the one wanted.
    """
    return surrounds(flux if sources == 1 else polygon_flux(vertices, target))


@kernel
def _among(centre: Array, rotation: Array, target: Array, radius: float) -> bool:
    """Say whether the target lies behind the face, among the swarm: there a straight slide ends the path."""
    distance2, ahead = _seen(centre, rotation, target)
    return ahead <= 0.0 and distance2 < radius * radius


@kernel
def _step_bound(centre: Array, rotation: Array, target: Array, last: float) -> float:
    """Largest move of the leaders in one step, root mean square [m]."""
    distance2, ahead = _seen(centre, rotation, target)
    return longest_step(math.sqrt(distance2), ahead, last)


@kernel
def _seen(centre: Array, rotation: Array, target: Array) -> tuple[float, float]:
    """Squared distance of the target from the face's centre [m^2], and how far it lies ahead along the normal [m]."""
    distance2, ahead = 0.0, 0.0
    for k in range(3):
        gap = target[k] - centre[k]
        distance2 += gap * gap
        ahead += gap * rotation[k, 0]
    return distance2, ahead


@kernel
def _all_finite(values: Array) -> bool:
    for value in values:  # noqa: SIM110 (the compiler takes a plain loop sooner than a generator)
        if not math.isfinite(value):
            return False
    return True
