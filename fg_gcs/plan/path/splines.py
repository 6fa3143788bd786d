"""Splines through places and attitudes, twice continuously differentiable, compiled.

Both are what SciPy calls ``CubicSpline(bc_type="natural")`` and ``RotationSpline``, which judge them in the tests; here
a path of forty poses takes microseconds instead of a millisecond.
"""

from __future__ import annotations

import math

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array

Vector = tuple[float, float, float]

SMALL_ANGLE2 = 1e-4  # squared angle below which series replace quotients of small numbers; their error is 1e-13
ROUNDS = 12  # of Newton's method: four are enough where no span turns by more than a right angle
SETTLED = 1e-12  # relative change of the rates at which they count as found: some roundings


@kernel
def natural_cubic(knots: Array, values: Array) -> Array:
    """Return the cubic polynomials through values whose second derivatives vanish at both ends.

    With the second derivatives ``m`` at the knots, widths ``h`` and slopes ``d`` of the chords, a continuous first
    derivative means ``h_(i-1) m_(i-1) + 2 (h_(i-1) + h_i) m_i + h_i m_(i+1) = 6 (d_i - d_(i-1))``.

    Args:
        knots: ascending, shape (K,), K >= 2.
        values: at the knots, shape (K, N).

    Returns:
        Coefficients of every span in its own parameter, which starts at 0, highest power first, shape (4, K - 1, N).
    """
    spans, columns = len(knots) - 1, values.shape[1]
    powers = np.empty((4, spans, columns))
    bends, shares = np.zeros(spans + 1), np.zeros(spans + 1)
    for n in range(columns):
        for i in range(1, spans):
            before, after = knots[i] - knots[i - 1], knots[i + 1] - knots[i]
            change = (values[i + 1, n] - values[i, n]) / after - (values[i, n] - values[i - 1, n]) / before
            pivot = 2.0 * (before + after) - before * shares[i - 1]
            shares[i] = after / pivot
            bends[i] = (6.0 * change - before * bends[i - 1]) / pivot
        for i in range(spans - 1, 0, -1):
            bends[i] -= shares[i] * bends[i + 1]
        for i in range(spans):
            h = knots[i + 1] - knots[i]
            powers[0, i, n] = (bends[i + 1] - bends[i]) / (6.0 * h)
            powers[1, i, n] = bends[i] / 2.0
            powers[2, i, n] = (values[i + 1, n] - values[i, n]) / h - h * (2.0 * bends[i] + bends[i + 1]) / 6.0
            powers[3, i, n] = values[i, n]
    return powers


@kernel
def rotation_spline(knots: Array, rotations: Array) -> tuple[Array, Array]:
    """Return a spline through attitudes with continuous turning rate and angular acceleration.

    Within span ``i`` the attitude is ``R_i exp(f)``. The rotation vector ``f`` is a cubic polynomial from 0 to the
    span's turn ``p_i``, its first derivative goes from ``w_i`` to ``A_i w_(i+1)``: the rates ``w`` in own axes, and
    ``A_i``, which makes a rotation vector's derivative of a rate. At a knot the acceleration of the span before it,
    ``J f'' + n(f, f')`` with ``J`` the inverse of ``A``, equals ``f''`` of the span after it:

        2/h_(i-1) J_(i-1) w_(i-1) + 4 (1/h_(i-1) + 1/h_i) w_i + 2/h_i A_i w_(i+1)
            = 6 (p_(i-1)/h_(i-1)^2 + p_i/h_i^2) - n(p_(i-1), A_(i-1) w_i),

    with ``n`` quadratic in the rate. At both ends the rate is the mean one of the span there.

    Args:
        knots: ascending, shape (K,), K >= 2.
        rotations: the attitudes at the knots, shape (K, 3, 3), made exactly orthogonal here.

    Returns:
        The attitudes, shape (K, 3, 3), and the coefficients of ``f`` in every span, laid out as by
        :func:`natural_cubic`, shape (4, K - 1, 3).
    """
    spans = len(knots) - 1
    attitudes, turns = _turns(rotations)
    rates = np.empty((spans + 1, 3))
    rates[0], rates[spans] = turns[0] / (knots[1] - knots[0]), turns[spans - 1] / (knots[spans] - knots[spans - 1])
    to_rate, from_rate = np.empty((spans, 3, 3)), np.empty((spans, 3, 3))
    for i in range(spans):
        _fill_jacobians(turns[i], to_rate[i], from_rate[i])
        if i > 0:
            rates[i] = turns[i] / (knots[i + 1] - knots[i])
    if spans > 1:
        _solve_rates(knots, turns, to_rate, from_rate, rates)
    powers = np.zeros((4, spans, 3))
    last = np.empty(3)
    for i in range(spans):
        h = knots[i + 1] - knots[i]
        _multiply(from_rate[i], rates[i + 1], last)
        for k in range(3):
            powers[0, i, k] = ((rates[i, k] + last[k]) * h - 2.0 * turns[i, k]) / h**3
            powers[1, i, k] = (3.0 * turns[i, k] - (2.0 * rates[i, k] + last[k]) * h) / h**2
            powers[2, i, k] = rates[i, k]
    return attitudes, powers


@kernel
def turning(angle2: float) -> tuple[float, float, float, float, float]:
    """Return what exponential and rates of a rotation vector need of its squared angle.

    These are ``s = sin(a)/a``, ``b = (1 - cos a)/a^2``, ``d = (a - sin a)/a^3``, and the derivatives of ``b`` and ``d``
    by the squared angle. With them ``exp(f) = 1 + s [f] + b [f]^2``, and the turning rate in own axes is ``f' - b f x
    f' + d f x (f x f')``, the right Jacobian of rotations.
    """
    if angle2 < SMALL_ANGLE2:
        return (
            1.0 - angle2 / 6.0 * (1.0 - angle2 / 20.0),
            0.5 - angle2 / 24.0 * (1.0 - angle2 / 30.0),
            1.0 / 6.0 - angle2 / 120.0 * (1.0 - angle2 / 42.0),
            -1.0 / 24.0 + angle2 / 360.0,
            -1.0 / 120.0 + angle2 / 2520.0,
        )
    angle = math.sqrt(angle2)
    sine, cosine = math.sin(angle), math.cos(angle)
    return (
        sine / angle,
        (1.0 - cosine) / angle2,
        (angle - sine) / (angle * angle2),
        (angle * sine - 2.0 * (1.0 - cosine)) / (2.0 * angle2 * angle2),
        (3.0 * sine - 2.0 * angle - angle * cosine) / (2.0 * angle2 * angle2 * angle),
    )


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Return ``a x b``."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def mix(p: float, a: Vector, q: float, b: Vector) -> Vector:
    """Return ``p a + q b``."""
    return p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2]


@kernel
def _solve_rates(knots: Array, turns: Array, to_rate: Array, from_rate: Array, rates: Array) -> None:
    """Fill the rates between the two ends by Newton's method, each step of it by block elimination.

    ``n`` is quadratic in the rates, ``n(w) = N(w, w)``. About the last rates ``w`` it is ``2 N(w, v) - n(w)`` of the
    next ones ``v``, so the blocks on the diagonal gain ``2 N(w, .)`` and the right side is ``n(w)`` more.
    """
    spans = len(turns)
    inverse, shares, eliminated = np.empty((3, 3)), np.zeros((spans, 3, 3)), np.empty((spans, 3))
    block, quadratic, known, carried = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    eliminated[0] = rates[0]
    for _ in range(ROUNDS):
        for i in range(1, spans):
            before, after = knots[i] - knots[i - 1], knots[i + 1] - knots[i]
            _fill_quadratic(turns[i - 1], from_rate[i - 1], rates[i], quadratic)
            _matrix_product(to_rate[i - 1], shares[i - 1], block)
            for j in range(3):
                for k in range(3):
                    block[j, k] = 2.0 * quadratic[j, k] - 2.0 / before * block[j, k]
                block[j, j] += 4.0 / before + 4.0 / after
            _invert(block, inverse)
            _matrix_product(inverse, from_rate[i], shares[i])
            _multiply(to_rate[i - 1], eliminated[i - 1], carried)
            _multiply(quadratic, rates[i], known)
            for k in range(3):
                known[k] += 6.0 * (turns[i - 1, k] / before**2 + turns[i, k] / after**2) - 2.0 / before * carried[k]
                for j in range(3):
                    shares[i, j, k] *= 2.0 / after
            _multiply(inverse, known, eliminated[i])
        change = 0.0
        for i in range(spans - 1, 0, -1):
            _multiply(shares[i], rates[i + 1], carried)
            for k in range(3):
                rate = eliminated[i, k] - carried[k]
                change = max(change, abs(rate - rates[i, k]) / (1.0 + abs(rate)))
                rates[i, k] = rate
        if change < SETTLED:
            break


@kernel
def _turns(rotations: Array) -> tuple[Array, Array]:
    """Attitudes made exactly orthogonal, (K, 3, 3), and the rotation vectors from each to the next, (K - 1, 3)."""
    count = len(rotations)
    attitudes, turns = np.empty((count, 3, 3)), np.empty((count - 1, 3))
    a, b, c, d = 1.0, 0.0, 0.0, 0.0  # the attitude before as a quaternion, real part first
    for i in range(count):
        w, x, y, z = _quaternion(rotations[i])
        r = attitudes[i]
        r[0, 0], r[0, 1], r[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
        r[1, 0], r[1, 1], r[1, 2] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
        r[2, 0], r[2, 1], r[2, 2] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
        if i > 0:
            real = a * w + b * x + c * y + d * z
            e, f, g = a * x - b * w - c * z + d * y, a * y + b * z - c * w - d * x, a * z - b * y + c * x - d * w
            turns[i - 1, 0], turns[i - 1, 1], turns[i - 1, 2] = _turn((real, e, f, g))
        a, b, c, d = w, x, y, z
    return attitudes, turns


@kernel
def _quaternion(r: Array) -> tuple[float, float, float, float]:
    """The unit quaternion of a rotation, real part first; each branch divides by the largest of the four parts."""
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    if trace >= max(r[0, 0], r[1, 1], r[2, 2]):
        w, x, y, z = 1.0 + trace, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    elif r[0, 0] >= max(r[1, 1], r[2, 2]):
        w, x, y, z = r[2, 1] - r[1, 2], 1.0 - trace + 2.0 * r[0, 0], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2]
    elif r[1, 1] >= r[2, 2]:
        w, x, y, z = r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], 1.0 - trace + 2.0 * r[1, 1], r[2, 1] + r[1, 2]
    else:
        w, x, y, z = r[1, 0] - r[0, 1], r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], 1.0 - trace + 2.0 * r[2, 2]
    length = math.sqrt(w * w + x * x + y * y + z * z)
    return w / length, x / length, y / length, z / length


@kernel
def rotation_vector(rotation: Array) -> Vector:
    """Return the rotation vector of a rotation, shape (3, 3), the short way round [rad]."""
    return _turn(_quaternion(rotation))


@kernel
def _turn(quaternion: tuple[float, float, float, float]) -> Vector:
    """The rotation vector of a unit quaternion, real part first, the short way round."""
    w, x, y, z = quaternion
    length = math.sqrt(x * x + y * y + z * z)
    sign = 1.0 if w >= 0.0 else -1.0
    stretch = sign * 2.0 * math.atan2(length, abs(w)) / length if length > 0.0 else 0.0
    return stretch * x, stretch * y, stretch * z


@kernel
def _fill_jacobians(f: Array, to_rate: Array, from_rate: Array) -> None:
    """Fill ``1 - b [f] + d [f]^2``, which makes a rate of a rotation vector's derivative, and its inverse."""
    angle2 = f[0] * f[0] + f[1] * f[1] + f[2] * f[2]
    s, b, d, _, _ = turning(angle2)
    inverse = (1.0 - 0.5 * s / b) / angle2 if angle2 > SMALL_ANGLE2 else 1.0 / 12.0 + angle2 / 720.0
    for j in range(3):
        for k in range(3):
            skew = 0.0 if j == k else (f[3 - j - k] if (k - j) % 3 == 2 else -f[3 - j - k])  # of the matrix [f]
            square = f[j] * f[k] - angle2 * (j == k)
            to_rate[j, k] = (j == k) - b * skew + d * square
            from_rate[j, k] = (j == k) + 0.5 * skew + inverse * square


@kernel
def _fill_quadratic(f: Array, from_rate: Array, rate: Array, out: Array) -> None:
    """Fill the matrix ``N(w, .)`` of a span's end: the part of the angular acceleration that is quadratic in the rate.

    In the rotation vector's derivative ``g = A w`` it is ``2 (f.g) (-b' f x g + d' f x (f x g)) + d g x (f x g)``, of
    which the matrix is half the derivative by ``g``, times ``A``.
    """
    _, _, d, b1, d1 = turning(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    f1, half = np.empty(3), np.empty((3, 3))
    _multiply(from_rate, rate, f1)
    v, g = (f[0], f[1], f[2]), (f1[0], f1[1], f1[2])
    along = v[0] * g[0] + v[1] * g[1] + v[2] * g[2]
    own = cross(v, g)
    bent = mix(-b1, own, d1, cross(v, own))
    for k in range(3):
        unit = (1.0 * (k == 0), 1.0 * (k == 1), 1.0 * (k == 2))
        other = cross(v, unit)
        other_bent = mix(-b1, other, d1, cross(v, other))
        swing = mix(1.0, cross(g, other), 1.0, cross(unit, own))
        for j in range(3):
            half[j, k] = v[k] * bent[j] + along * other_bent[j] + 0.5 * d * swing[j]
    _matrix_product(half, from_rate, out)


@kernel
def _matrix_product(a: Array, b: Array, out: Array) -> None:
    for j in range(3):
        for k in range(3):
            out[j, k] = a[j, 0] * b[0, k] + a[j, 1] * b[1, k] + a[j, 2] * b[2, k]


@kernel
def _multiply(matrix: Array, vector: Array, out: Array) -> None:
    for k in range(3):
        out[k] = matrix[k, 0] * vector[0] + matrix[k, 1] * vector[1] + matrix[k, 2] * vector[2]


@kernel
def _invert(m: Array, out: Array) -> None:
    """Fill the inverse of a 3 x 3 matrix: its cofactors over its determinant."""
    for j in range(3):
        for k in range(3):
            a, b, c, d = (j + 1) % 3, (j + 2) % 3, (k + 1) % 3, (k + 2) % 3
            out[k, j] = m[a, c] * m[b, d] - m[a, d] * m[b, c]
    determinant = m[0, 0] * out[0, 0] + m[0, 1] * out[1, 0] + m[0, 2] * out[2, 0]
    for j in range(3):
        for k in range(3):
            out[j, k] /= determinant
