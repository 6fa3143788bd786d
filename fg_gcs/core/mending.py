"""Compiled changes of the last gate: the nearest setpoints that may leave, and the brake; why is in `flight.gate`."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fg_gcs.compiling import kernel
from fg_gcs.core.admissible import (
    ACCELERATION,
    APART,
    BOUNDS,
    FENCE,
    HIGH,
    KEPT_CLEAR,
    LEAP_M,
    LEAP_M_S,
    LOW,
    MARGIN,
    NEAR,
    NEVER,
    NOT_FINITE,
    ROUNDING_M,
    Around,
    alone,
    around,
    fastest,
    is_near,
    judge,
    near_pairs,
    nearest_on,
    note,
    relative_speed,
)
from fg_gcs.core.arrays import Array

UNCHANGED, CHANGED, BRAKED, HELD_BACK = 0, 1, 2, 3  # what became of a setpoint
CHANGE_M: Final = 0.5  # a setpoint that would have to be changed by more is braked instead
TIGHT: Final = 0.99  # share of a bound of continuity that changes take up, so that they pass it
SWEEPS: Final = 6  # of changing setpoints that others' changes concern
MOST_PLANES: Final = 48
PROJECTIONS: Final = 300  # rounds of them; one plane needs two
EXACT_M: Final = 1e-9
# Places in `notes`
STATUS, CODE, CHANGE_BY, OTHER, DISTANCE, NOTES = 0, 1, 2, 3, 4, 5


@kernel
def mend(
    rows: NDArray[np.int_],
    wanted: Array,
    told: Array,
    now_s: float,
    bounds: Array,
    points: Array,
    columns: Array,
    out: Array,
    notes: Array,
) -> None:
    """Change setpoints until all may leave, each as little as it can; what cannot be changed is braked, or held back.

    Pairs are looked at all of them, and what left is noted as told.

    Args:
        rows: see `judge`, as the others.
        wanted: shape (n, 10).
        told: shape (V, 8).
        now_s: [s].
        bounds: `BOUNDS` numbers.
        points: see `Around`.
        columns: see `Around`.
        out: filled with what may leave, shape (n, 10); of what is held back where the vehicle is.
        notes: filled, shape (n, `NOTES`): what became of it, its code, by how much its position is changed [m], whose
            setpoint was nearest (-1: nobody's) and how near [m].
    """
    n = len(rows)
    braked, codes = np.empty(10), np.zeros(n, np.int64)
    for k in range(n):
        out[k] = wanted[k]
        notes[k, STATUS], notes[k, CODE], notes[k, CHANGE_BY] = UNCHANGED, 0, 0.0
        notes[k, OTHER], notes[k, DISTANCE] = -1, math.inf
    for sweep in range(SWEEPS):
        _judge_all(rows, out, told, now_s, bounds, points, columns, codes, notes)
        if not codes.any():
            break
        new = out.copy()
        args = (rows, out, told, now_s, bounds, points, columns)
        for k in range(n):
            if codes[k] == 0 or notes[k, STATUS] == HELD_BACK:
                continue
            notes[k, CODE] = int(notes[k, CODE]) | codes[k]
            row = told[rows[k]]
            tries = notes[k, STATUS] < BRAKED and sweep < SWEEPS - 2 and row[7] != NEVER and not codes[k] & NOT_FINITE
            if tries and _change(k, wanted[k], CHANGE_M, new[k], *args):
                notes[k, STATUS] = CHANGED
                continue
            notes[k, STATUS] = HELD_BACK if row[7] == NEVER else BRAKED
            _brake(braked, row, now_s, bounds, int(notes[k, CODE]))
            if row[7] == NEVER or not _change(k, braked, math.inf, new[k], *args):
                new[k] = braked
        for k in range(n):
            out[k] = new[k]
    for k in range(n):
        if notes[k, STATUS] != UNCHANGED:
            notes[k, CHANGE_BY] = math.sqrt(_square(out[k], wanted[k]))
        if notes[k, STATUS] != HELD_BACK:
            note(told[rows[k]], out[k], now_s)


@kernel
def _judge_all(
    rows: NDArray[np.int_],
    wanted: Array,
    told: Array,
    now_s: float,
    bounds: Array,
    points: Array,
    columns: Array,
    codes: NDArray[np.int_],
    notes: Array,
) -> None:
    """Fill the codes of setpoints, of all pairs; note the nearest of those that are too near."""
    n = len(rows)
    for k in range(n):
        codes[k] = alone(wanted[k], told[rows[k]], now_s, bounds)
        codes[k] |= around(wanted[k], told[rows[k]], bounds, points, columns)
    reach = bounds[APART] + relative_speed(wanted) ** 2 / (4.0 * bounds[ACCELERATION])
    reach2 = reach * reach
    for i in range(n):
        for j in range(i + 1, n):
            if _square(wanted[i], wanted[j]) > reach2:
                continue
            if is_near(wanted[i], told[rows[i]], wanted[j], told[rows[j]], bounds):
                d = math.sqrt(_square(wanted[i], wanted[j]))
                for k, other in ((i, j), (j, i)):
                    codes[k] |= NEAR
                    if d < notes[k, DISTANCE]:
                        notes[k, OTHER], notes[k, DISTANCE] = other, d


@kernel
def _square(first: Array, second: Array) -> float:
    square: float = (first[0] - second[0]) ** 2 + (first[1] - second[1]) ** 2 + (first[2] - second[2]) ** 2
    return square


@kernel
def _brake(out: Array, row: Array, now_s: float, bounds: Array, code: int) -> None:
    """Go on from what left last, slower, until it is at rest; where there is nothing to go on from, be there."""
    a = bounds[ACCELERATION] * (MARGIN if code & (FENCE | NEAR | KEPT_CLEAR) else 1.0)
    dt = 0.0 if row[7] == NEVER else now_s - row[7]
    speed = math.sqrt(row[3] ** 2 + row[4] ** 2 + row[5] ** 2)
    lasts = min(speed / a, dt)
    left = 1.0 - a * lasts / speed if speed > 0.0 else 0.0
    rests = left <= 1e-9
    for c in range(3):
        out[c] = row[c] + 0.5 * (1.0 + left) * row[3 + c] * lasts
        out[3 + c] = 0.0 if rests else left * row[3 + c]
        out[6 + c] = 0.0 if rests else -a * row[3 + c] / speed
    out[9] = row[6]


@kernel
def _change(
    k: int,
    wanted: Array,
    most_m: float,
    new: Array,
    rows: NDArray[np.int_],
    out: Array,
    told: Array,
    now_s: float,
    bounds: Array,
    points: Array,
    columns: Array,
) -> bool:
    """Fill a setpoint with the one nearest to a wanted one that may leave, if there is one within a distance [m].

    Nearest means: the position first, then the velocity. What a position is kept from is a plane across the way to the
    other, at its least distance, on the side on which the vehicle was; of what a pair may come nearer, each gets the
    share by which it does.
    """
    row = told[rows[k]]
    dt = now_s - row[7]
    a = bounds[ACCELERATION]
    most = MARGIN * a
    normals, offsets = np.empty((MOST_PLANES, 3)), np.empty(MOST_PLANES)
    p, v = row[:3], row[3:6]
    radius = TIGHT * (0.5 * most * dt * dt + LEAP_M)
    centre = p + v * dt
    if math.sqrt(((wanted[:3] - centre) ** 2).sum()) - radius > most_m:
        return False
    brakes = math.isinf(most_m)  # then what breaks a rule the least has to do
    count = _planes(k, rows, wanted, out, told, bounds, points, columns, normals, offsets)
    x = new[:3]
    if count < 0 or not (nearest(wanted[:3], normals[:count], offsets[:count], centre, radius, x) or brakes):
        return False
    if math.sqrt(_square(x, wanted)) > most_m:
        return False
    count = _speed_planes(k, rows, wanted, x, out, told, bounds, points, columns, normals, offsets)
    slower = TIGHT * (most * dt + LEAP_M_S)
    if count < 0 or not (nearest(wanted[3:6], normals[:count], offsets[:count], v, slower, new[3:6]) or brakes):
        return False
    size = 0.0
    for c in range(3):
        new[6 + c] = (new[3 + c] - v[c]) / dt if dt > 0.0 else 0.0
        size += new[6 + c] ** 2
    scale = min(1.0, TIGHT * most / max(math.sqrt(size), 1e-9))
    for c in range(3):
        new[6 + c] *= scale
    new[9] = wanted[9]
    return True


@kernel
def nearest(point: Array, normals: Array, offsets: Array, centre: Array, radius: float, out: Array) -> bool:
    """Find the point nearest to another one that is in a ball and on the right side of planes: a small QP.

    Dykstra's projections ([BoyleDykstra1986]_) lead to it from any start.

    Args:
        point: shape (3,).
        normals: of the planes, of length 1, shape (M, 3).
        offsets: n x >= b on their right sides, shape (M,).
        centre: of the ball, shape (3,).
        radius: of the ball.
        out: filled, shape (3,).

    Returns:
        Whether there is one.
    """
    planes = len(offsets)
    pushes, pull = np.zeros(planes), np.zeros(3)  # what each projection has done
    x0, x1, x2 = point[0], point[1], point[2]
    for _ in range(PROJECTIONS):
        b0, b1, b2 = x0, x1, x2
        for m in range(planes):
            n0, n1, n2 = normals[m, 0], normals[m, 1], normals[m, 2]
            along = n0 * x0 + n1 * x1 + n2 * x2 - pushes[m]
            push = max(offsets[m] - along, 0.0)
            step = push - pushes[m]
            x0, x1, x2 = x0 + step * n0, x1 + step * n1, x2 + step * n2
            pushes[m] = push
        y0, y1, y2 = x0 - pull[0] - centre[0], x1 - pull[1] - centre[1], x2 - pull[2] - centre[2]
        size = math.sqrt(y0 * y0 + y1 * y1 + y2 * y2)
        share = 1.0 if size <= radius else radius / size
        x0, x1, x2 = centre[0] + share * y0, centre[1] + share * y1, centre[2] + share * y2
        pull[0], pull[1], pull[2] = (share - 1.0) * y0, (share - 1.0) * y1, (share - 1.0) * y2
        if abs(x0 - b0) + abs(x1 - b1) + abs(x2 - b2) < EXACT_M:
            break
    out[0], out[1], out[2] = x0, x1, x2
    for m in range(planes):
        if not normals[m, 0] * x0 + normals[m, 1] * x1 + normals[m, 2] * x2 >= offsets[m] - 0.5 * ROUNDING_M:
            return False
    return True


@kernel
def _add(count: int, x: float, y: float, z: float, offset: float, normals: Array, offsets: Array) -> int:
    """Add a plane; return how many there are, -1: too many."""
    if count < 0 or count >= MOST_PLANES:
        return -1
    normals[count, 0], normals[count, 1], normals[count, 2], offsets[count] = x, y, z, offset
    return count + 1


@kernel
def _add_face(count: int, axis: int, sign: float, offset: float, normals: Array, offsets: Array) -> int:
    """Add a plane across an axis."""
    count = _add(count, 0.0, 0.0, 0.0, offset, normals, offsets)
    if count > 0:
        normals[count - 1, axis] = sign
    return count


@kernel
def _planes(
    k: int,
    rows: NDArray[np.int_],
    wanted: Array,
    out: Array,
    told: Array,
    bounds: Array,
    points: Array,
    columns: Array,
    normals: Array,
    offsets: Array,
) -> int:
    """Fill planes that a position is on the right side of; return how many."""
    p = told[rows[k]]
    own = math.sqrt(_square(wanted, p)) + CHANGE_M
    count = 0
    for c in range(3):
        count = _add_face(count, c, 1.0, min(bounds[LOW + c], p[c]), normals, offsets)
        count = _add_face(count, c, -1.0, -max(bounds[HIGH + c], p[c]), normals, offsets)
    for j in range(len(rows)):
        q = told[rows[j]]
        before = math.sqrt(_square(p, q))
        theirs = math.sqrt(_square(out[j], q))
        if j == k or not before - own - theirs < bounds[APART] or before == 0.0:
            continue
        n0, n1, n2 = (p[0] - q[0]) / before, (p[1] - q[1]) / before, (p[2] - q[2]) / before
        room = before - min(bounds[APART], before)
        ours = -(n0 * (out[k, 0] - p[0]) + n1 * (out[k, 1] - p[1]) + n2 * (out[k, 2] - p[2]))
        comes = n0 * (out[j, 0] - q[0]) + n1 * (out[j, 1] - q[1]) + n2 * (out[j, 2] - q[2])
        may = _share(room, ours, comes)
        count = _add(count, n0, n1, n2, n0 * p[0] + n1 * p[1] + n2 * p[2] - may, normals, offsets)
    for j in range(len(points)):
        before = math.sqrt(_square(p, points[j]))
        if before - own < points[j, 3] and before > 0.0:
            n0, n1, n2 = (p[0] - points[j, 0]) / before, (p[1] - points[j, 1]) / before, (p[2] - points[j, 2]) / before
            offset = n0 * points[j, 0] + n1 * points[j, 1] + n2 * points[j, 2] + min(points[j, 3], before)
            count = _add(count, n0, n1, n2, offset, normals, offsets)
    for j in range(len(columns)):
        if p[2] >= columns[j, 4] - ROUNDING_M:  # above it stays
            q = nearest_on((wanted[0], wanted[1], 0.0), columns[j])
            if math.hypot(wanted[0] - q[0], wanted[1] - q[1]) < columns[j, 5] + CHANGE_M:
                count = _add(count, 0.0, 0.0, 1.0, columns[j, 4], normals, offsets)
            continue
        q = nearest_on((p[0], p[1], 0.0), columns[j])
        before = math.hypot(p[0] - q[0], p[1] - q[1])
        if before - own < columns[j, 5] and before > 0.0:
            n0, n1 = (p[0] - q[0]) / before, (p[1] - q[1]) / before
            count = _add(count, n0, n1, 0.0, n0 * q[0] + n1 * q[1] + min(columns[j, 5], before), normals, offsets)
    return count


@kernel
def _share(room: float, ours: float, theirs: float) -> float:
    """Return by how much one of a pair may come nearer, of the room that both have."""
    if ours + theirs > room and ours > 0.0 and theirs > 0.0:
        return room * ours / (ours + theirs)
    return max(room - theirs, 0.0)


@kernel
def _speed_planes(
    k: int,
    rows: NDArray[np.int_],
    wanted: Array,
    x: Array,
    out: Array,
    told: Array,
    bounds: Array,
    points: Array,
    columns: Array,
    normals: Array,
    offsets: Array,
) -> int:
    """Fill planes that a velocity is on the right side of, at a position; return how many."""
    p, a = told[rows[k]], bounds[ACCELERATION]
    u0, u1, u2 = wanted[3], wanted[4], wanted[5]
    count = 0
    for c in range(3):
        low, high = x[c] - min(bounds[LOW + c], p[c]), max(bounds[HIGH + c], p[c]) - x[c]
        count = _add_face(count, c, 1.0, -math.sqrt(2.0 * a * max(low, 0.0)), normals, offsets)
        count = _add_face(count, c, -1.0, -math.sqrt(2.0 * a * max(high, 0.0)), normals, offsets)
    for j in range(len(rows)):
        if j == k:
            continue
        w0, w1, w2 = u0 - out[j, 3], u1 - out[j, 4], u2 - out[j, 5]
        square = w0 * w0 + w1 * w1 + w2 * w2
        d = math.sqrt(_square(x, out[j]))
        if not d < bounds[APART] + square / (4.0 * a) + CHANGE_M or d == 0.0:
            continue
        n0, n1, n2 = (x[0] - out[j, 0]) / d, (x[1] - out[j, 1]) / d, (x[2] - out[j, 2]) / d
        closing = -(n0 * w0 + n1 * w1 + n2 * w2)
        least = min(bounds[APART], math.sqrt(_square(p, told[rows[j]])))
        most = fastest(square, d, least, 2.0 * a)
        comes = n0 * out[j, 3] + n1 * out[j, 4] + n2 * out[j, 5]
        may = _share(most, closing - comes, comes)
        count = _add(count, n0, n1, n2, -may, normals, offsets)
    speed2 = u0 * u0 + u1 * u1 + u2 * u2
    for j in range(len(points)):
        d = math.sqrt(_square(x, points[j]))
        if d < points[j, 3] + speed2 / (2.0 * a) + CHANGE_M and d > 0.0:
            n0, n1, n2 = (x[0] - points[j, 0]) / d, (x[1] - points[j, 1]) / d, (x[2] - points[j, 2]) / d
            closing = -(n0 * u0 + n1 * u1 + n2 * u2)
            least = min(points[j, 3], math.sqrt(_square(p, points[j])))
            most = fastest(speed2, d, least, a)
            count = _add(count, n0, n1, n2, -most, normals, offsets)
    for j in range(len(columns)):
        q = nearest_on((x[0], x[1], 0.0), columns[j])
        d = math.hypot(x[0] - q[0], x[1] - q[1])
        flat2 = u0 * u0 + u1 * u1
        if x[2] < columns[j, 4] - ROUNDING_M and d < columns[j, 5] + flat2 / (2.0 * a) + CHANGE_M and d > 0.0:
            q0 = nearest_on((p[0], p[1], 0.0), columns[j])
            n0, n1 = (x[0] - q[0]) / d, (x[1] - q[1]) / d
            closing = -(n0 * u0 + n1 * u1)
            least = min(columns[j, 5], math.hypot(p[0] - q0[0], p[1] - q0[1]))
            most = fastest(flat2, d, least, a)
            count = _add(count, n0, n1, 0.0, -most, normals, offsets)
    return count


def build() -> None:
    """Compile everything, or load what an earlier process compiled."""
    rows, codes = np.arange(2), np.zeros(2, dtype=np.int64)
    wanted, told, bounds = np.zeros((2, 10)), np.zeros((2, 8)), np.ones(BOUNDS)
    wanted[1, 0] = 9.0
    pairs, built = np.zeros((4, 2), dtype=np.int64), np.zeros((3, 3))
    around = Around(np.zeros((1, 4)), np.zeros((1, 6)))
    near_pairs(wanted, rows, 0, bounds, pairs, built)
    judge(rows, wanted, told, 0.1, bounds, pairs[:1], built, *around, codes)
    mend(rows, wanted, told, 0.1, bounds, *around, np.zeros((2, 10)), np.zeros((2, NOTES)))
