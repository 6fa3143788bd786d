"""Compiled rules of the last gate: which setpoints may leave, why is in `flight.gate`.

Rows of ``told``, shape (V, 8), are what left last for each vehicle of a fleet: position, velocity, yaw, time. A time of
`NEVER` says that nothing has left lately, and that the position is where the vehicle is reported to be. Rows of
``wanted``, shape (n, 10), are position, velocity, acceleration and yaw, ENU and SI throughout.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array

NOT_FINITE, JUMP, FENCE, NEAR, KEPT_CLEAR = 1, 2, 4, 8, 16  # reasons; a code is the sum of some
STALE, REBUILD = -1, -2  # what `judge` cannot do without

NEVER: Final = -math.inf
LARGEST: Final = 1e6  # m, m/s, m/s^2, rad: ArduCopter flies to 1e6 m and dies of 1e9 m; no flight of ours comes near
GAP_S: Final = 0.5  # what left longer ago says nothing about where a vehicle is
FIRST_M: Final = 1.0  # from where a vehicle is reported to its first setpoint: estimates wander, wind pushes
SLOW_M_S: Final = 1.0  # of a first setpoint's velocity
LEAP_M: Final = 0.01  # of rounding between motions
LEAP_M_S: Final = 0.1  # likewise
CREEP_M_S: Final = 0.02  # so slowly anybody may go anywhere that is not forbidden yet
MARGIN: Final = 2.0  # times the motions' limit of acceleration: what may leave, and what brakes
ROUNDING_M: Final = 1e-6

# Places in `bounds`
LOW, HIGH, APART, ACCELERATION, GROUND, BOUNDS = 0, 3, 6, 7, 8, 9


class Around(NamedTuple):
    """What setpoints are kept away from beside each other."""

    points: Array  # (K, 4) place [m], least distance [m]
    columns: Array  # (C, 6) ends of a segment in the plane [m], height up to which it counts [m], least distance [m]


@kernel
def judge(
    rows: NDArray[np.int_],
    wanted: Array,
    told: Array,
    now_s: float,
    bounds: Array,
    pairs: NDArray[np.int_],
    built: Array,
    points: Array,
    columns: Array,
    codes: NDArray[np.int_],
) -> int:
    """Tell how many setpoints must not leave, and fill their codes; if all may, note them as told.

    Args:
        rows: the vehicles', shape (n,).
        wanted: setpoints, shape (n, 10).
        told: see the module, shape (V, 8).
        now_s: when they would leave [s].
        bounds: `BOUNDS` numbers: corners of the fence, distance, acceleration, height below which vehicles stand.
        pairs: places of vehicles that may be near each other, shape (P, 2).
        built: where they were when that was found out, shape (n + 1, 3); last: slack [m] and greatest speed [m/s].
        points: see `Around`.
        columns: see `Around`.
        codes: filled, shape (n,).

    Returns:
        How many; `STALE`: some of ``told`` is too old; `REBUILD`: so are the pairs.
    """
    n = len(rows)
    for k in range(n):
        if now_s - told[rows[k], 7] > GAP_S and told[rows[k], 7] != NEVER:
            return STALE
    if _is_outrun(wanted, built):
        return REBUILD
    failed = 0
    for k in range(n):
        row = told[rows[k]]
        codes[k] = alone(wanted[k], row, now_s, bounds)
        if len(points) or len(columns):
            codes[k] |= around(wanted[k], row, bounds, points, columns)
    for each in range(len(pairs)):
        i, j = pairs[each, 0], pairs[each, 1]
        if is_near(wanted[i], told[rows[i]], wanted[j], told[rows[j]], bounds):
            codes[i] |= NEAR
            codes[j] |= NEAR
    for k in range(n):
        failed += codes[k] != 0
    if failed == 0:
        for k in range(n):
            note(told[rows[k]], wanted[k], now_s)
    return failed


@kernel
def near_pairs(
    wanted: Array, order: NDArray[np.int_], axis: int, bounds: Array, out: NDArray[np.int_], built: Array
) -> int:
    """Find the pairs of vehicles that may be near each other soon; a sweep along an axis.

    Args:
        wanted: setpoints, shape (n, 10).
        order: of the vehicles along the axis, shape (n,).
        axis: 0, 1 or 2.
        bounds: see `judge`.
        out: filled as far as it goes, shape (most, 2).
        built: filled, shape (n + 1, 3).

    Returns:
        How many there are.
    """
    n = len(wanted)
    slack_m = max(1.0, 0.5 * bounds[APART])
    speed = relative_speed(wanted) + 1.0
    radius = bounds[APART] + speed * speed / (4.0 * bounds[ACCELERATION]) + slack_m
    count = 0
    for first in range(n):
        i = order[first]
        for second in range(first + 1, n):
            j = order[second]
            if not wanted[j, axis] - wanted[i, axis] <= radius:  # one that is not a number comes last
                break
            x, y, z = wanted[i, 0] - wanted[j, 0], wanted[i, 1] - wanted[j, 1], wanted[i, 2] - wanted[j, 2]
            if x * x + y * y + z * z <= radius * radius:
                if count < len(out):
                    out[count, 0], out[count, 1] = i, j
                count += 1
    for k in range(n):
        for c in range(3):
            built[k, c] = wanted[k, c]
    built[n, 0], built[n, 1], built[n, 2] = slack_m, speed, 0.0
    return count


@kernel
def relative_speed(wanted: Array) -> float:
    """Twice the greatest difference of a velocity from their mean: no two differ by more [m/s]."""
    n, counted = len(wanted), 0
    x = y = z = 0.0
    for k in range(n):
        if math.isfinite(wanted[k, 3] + wanted[k, 4] + wanted[k, 5]):
            x, y, z, counted = x + wanted[k, 3], y + wanted[k, 4], z + wanted[k, 5], counted + 1
    most, share = 0.0, 1.0 / max(counted, 1)
    for k in range(n):
        u, v, w = wanted[k, 3] - x * share, wanted[k, 4] - y * share, wanted[k, 5] - z * share
        square = u * u + v * v + w * w
        if square > most:  # never of what is not a number
            most = square
    return 2.0 * math.sqrt(most)


@kernel
def _is_outrun(wanted: Array, built: Array) -> bool:
    """Say whether vehicles may have come near that were far apart: moving together brings none nearer."""
    n, counted = len(wanted), 0
    if len(built) != n + 1 or relative_speed(wanted) > built[n, 1]:
        return True
    x = y = z = 0.0
    for k in range(n):
        u, v, w = wanted[k, 0] - built[k, 0], wanted[k, 1] - built[k, 1], wanted[k, 2] - built[k, 2]
        if math.isfinite(u + v + w):
            x, y, z, counted = x + u, y + v, z + w, counted + 1
    share, most = 1.0 / max(counted, 1), 0.25 * built[n, 0] ** 2
    for k in range(n):
        u, v, w = wanted[k, 0] - built[k, 0], wanted[k, 1] - built[k, 1], wanted[k, 2] - built[k, 2]
        u, v, w = u - x * share, v - y * share, w - z * share
        if u * u + v * v + w * w > most:
            return True
    return False


# --- rules -----------------------------------------------------------------------------------------------------------


@kernel
def _goes_on(wanted: Array, row: Array, dt: float, most: float) -> bool:
    """Say whether a setpoint continues the one of a time before [s], under a limit of acceleration [m/s^2]."""
    leap, change, push = 0.0, 0.0, 0.0
    for c in range(3):
        leap += (wanted[c] - row[c] - row[3 + c] * dt) ** 2
        change += (wanted[3 + c] - row[3 + c]) ** 2
        push += wanted[6 + c] ** 2
    far, fast = 0.5 * most * dt * dt + LEAP_M, most * dt + LEAP_M_S
    goes_on: bool = leap <= far * far and change <= fast * fast and push <= most * most
    return goes_on


@kernel
def _takes_off(wanted: Array, row: Array, bounds: Array) -> bool:
    """Say whether a vehicle that got nothing lately, or that stands, is told to be right there or above."""
    first = row[7] == NEVER
    if not (first or row[2] < bounds[GROUND]):
        return False
    x, y, z = wanted[0] - row[0], wanted[1] - row[1], wanted[2] - row[2]
    speed2 = wanted[3] ** 2 + wanted[4] ** 2 + wanted[5] ** 2
    takes_off: bool = x * x + y * y <= FIRST_M**2 and z >= (-FIRST_M if first else -LEAP_M) and speed2 <= SLOW_M_S**2
    return takes_off


@kernel
def alone(wanted: Array, row: Array, now_s: float, bounds: Array) -> int:
    """Return the reasons why one setpoint must not leave that have nothing to do with others."""
    for c in range(10):
        if not abs(wanted[c]) <= LARGEST:
            return NOT_FINITE
    code = 0
    a = bounds[ACCELERATION]
    allowance_m = FIRST_M if row[7] == NEVER else 0.0
    if row[7] == NEVER or not _goes_on(wanted, row, now_s - row[7], MARGIN * a):
        code |= 0 if _takes_off(wanted, row, bounds) else JUMP
    for c in range(3):
        low, high = min(bounds[LOW + c], row[c] - allowance_m), max(bounds[HIGH + c], row[c] + allowance_m)
        below, above = wanted[c] - low, high - wanted[c]
        upwards, downwards = math.sqrt(2.0 * a * max(above, 0.0)), math.sqrt(2.0 * a * max(below, 0.0))
        if below < -ROUNDING_M or above < -ROUNDING_M or not -downwards <= _beyond(wanted[3 + c], CREEP_M_S) <= upwards:
            code |= FENCE
    return code


@kernel
def _beyond(value: float, slack: float) -> float:
    """Return a number with so much taken off its size."""
    return math.copysign(max(abs(value) - slack, 0.0), value)


@kernel
def is_near(wanted: Array, row: Array, other: Array, other_row: Array, bounds: Array) -> bool:
    """Say whether two setpoints are too near each other, or come together too fast."""
    if wanted[2] < bounds[GROUND] and other[2] < bounds[GROUND]:
        return False
    return _closes(
        (wanted[0], wanted[1], wanted[2]),
        (wanted[3], wanted[4], wanted[5]),
        (row[0], row[1], row[2]),
        (other[0], other[1], other[2]),
        (other[3], other[4], other[5]),
        (other_row[0], other_row[1], other_row[2]),
        bounds[APART],
        2.0 * bounds[ACCELERATION],
    )


@kernel
def around(wanted: Array, row: Array, bounds: Array, points: Array, columns: Array) -> int:
    """Return the reasons why a setpoint must not leave that are where others may be."""
    code, a = 0, bounds[ACCELERATION]
    x, u, p = (wanted[0], wanted[1], wanted[2]), (wanted[3], wanted[4], wanted[5]), (row[0], row[1], row[2])
    still = (0.0, 0.0, 0.0)
    for k in range(len(points)):
        q = (points[k, 0], points[k, 1], points[k, 2])
        if _closes(x, u, p, q, still, q, points[k, 3], a):
            code |= NEAR
    for k in range(len(columns)):
        if x[2] >= columns[k, 4] - ROUNDING_M:
            continue
        q, q0 = nearest_on(x, columns[k]), nearest_on(p, columns[k])
        flat, slow, before = (x[0], x[1], 0.0), (u[0], u[1], 0.0), (p[0], p[1], 0.0)
        apart = columns[k, 5]
        if p[2] >= columns[k, 4] - ROUNDING_M:  # it was above
            before, q0 = (q[0] + 1e9, q[1], 0.0), q
        if _closes(flat, slow, before, q, still, q0, apart, a):
            code |= KEPT_CLEAR
    return code


@kernel
def nearest_on(x: tuple[float, float, float], column: Array) -> tuple[float, float, float]:
    """Return the place on a column's segment that is nearest in the plane."""
    u, v = column[2] - column[0], column[3] - column[1]
    share = ((x[0] - column[0]) * u + (x[1] - column[1]) * v) / max(u * u + v * v, 1e-12)
    share = min(max(share, 0.0), 1.0)
    return (column[0] + share * u, column[1] + share * v, 0.0)


@kernel
def _closes(
    x: tuple[float, float, float],
    u: tuple[float, float, float],
    p: tuple[float, float, float],
    y: tuple[float, float, float],
    w: tuple[float, float, float],
    q: tuple[float, float, float],
    apart_m: float,
    a: float,
) -> bool:
    """Say whether two are nearer than may be, or come nearer faster than they could brake within their limits.

    Args:
        x: where one is told to be [m].
        u: how fast [m/s].
        p: where it was.
        y: where the other is.
        w: how fast.
        q: where it was.
        apart_m: least distance; of a pair that was nearer it is that [m].
        a: the most by which they brake together [m/s^2].
    """
    gx, gy, gz = x[0] - y[0], x[1] - y[1], x[2] - y[2]
    vx, vy, vz = u[0] - w[0], u[1] - w[1], u[2] - w[2]
    d2, w2 = gx * gx + gy * gy + gz * gz, vx * vx + vy * vy + vz * vz
    reach = apart_m + w2 / (2.0 * a)
    if d2 >= reach * reach:
        return False
    before = math.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)
    least, d = min(apart_m, before), math.sqrt(d2)
    if d < least - ROUNDING_M:
        return True
    if d == 0.0:
        return False
    closing = -(gx * vx + gy * vy + gz * vz) / d
    if closing <= CREEP_M_S:
        return False
    return closing - CREEP_M_S > fastest(w2, d, least, a)


@kernel
def fastest(speed2: float, d: float, least_m: float, a: float) -> float:
    """Return how fast two may come together, of a relative speed, that they can brake without coming too near [m/s].

    Braking by a along the relative velocity w leads on by L = w^2 / (2 a). A line touches the least distance s after T,
    T^2 = D^2 - s^2; on a steeper one the distance is s at the end of L if the cosine of its angle to the other is
    (T^2 + L^2) / (2 D L).

    Args:
        speed2: square of the relative speed [m^2/s^2].
        d: their distance [m].
        least_m: how near they may come [m].
        a: by which they brake together [m/s^2].
    """
    speed, on = math.sqrt(speed2), speed2 / (2.0 * a)
    touch2 = max(d * d - least_m * least_m, 0.0)
    if on * on >= touch2 or on == 0.0:
        return speed * math.sqrt(touch2) / d
    return speed * min((touch2 + on * on) / (2.0 * d * on), 1.0)


@kernel
def note(row: Array, left: Array, now_s: float) -> None:
    """Write down what left."""
    for c in range(6):
        row[c] = left[c]
    row[6], row[7] = left[9], now_s
