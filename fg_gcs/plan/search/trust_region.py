"""The trust-region subproblem, compiled: the best step of a quadratic model inside a ball [More1983]_."""

from __future__ import annotations

import math

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array

ON_SPHERE = 1e-9  # relative error of the step's length: far below what a step is accepted by
AT_POLE = 1e-10  # share of the matrices' size within which a multiplier is at the largest eigenvalue
ROUNDS = 200  # some four are needed, some forty in the hard case
TOWARDS_LOW = 0.01  # least share of its bracket by which a multiplier leaves the lower end


@kernel
def maximise_in_ball(gradient: Array, hessian: Array) -> Array:
    """Return the x with ``|x| <= 1`` that maximises ``g . x + x . H x / 2`` [More1983]_.

    The solution is ``x = (m I - H)^-1 g`` with the smallest multiplier ``m >= 0`` that makes ``m I - H`` positive
    definite and the length at most one. It is found by Newton's iteration on the reciprocal length, which is nearly
    linear in ``m``, inside a bracket that every Cholesky factorisation narrows. In the hard case (hardly any gradient
    along the leading eigenvector) the multiplier is the largest eigenvalue, and the rest of the length goes along its
    eigenvector, whose first component that is not zero is made positive.

    Args:
        gradient: g, shape (n,), finite.
        hessian: H, symmetric, shape (n, n), finite.
    """
    count = len(gradient)
    low, high = _bracket(gradient, hessian)
    size = high
    step, root = np.zeros(count), np.empty((count, count))
    if size == 0.0:
        return step
    multiplier = low
    for _ in range(ROUNDS):
        following = -1.0
        if _factored(hessian, multiplier, root):
            length, following = _solved(root, gradient, multiplier, step)
            if abs(length - 1.0) <= ON_SPHERE or (length < 1.0 and multiplier == 0.0):
                return step
            if length > 1.0:
                low = multiplier
            elif multiplier - low <= 2.0 * AT_POLE * size:
                return _lengthened(root, step)
            else:
                high = multiplier
        else:
            low = multiplier
        if not low < following < high:  # Newton's iteration left the bracket, or had no ground to start from
            following = max(math.sqrt(low * high), low + TOWARDS_LOW * (high - low))
        multiplier = following
    return step


@kernel
def gain(gradient: Array, hessian: Array, step: Array) -> float:
    """Return what the quadratic model promises of a step, ``g . x + x . H x / 2``."""
    promised = 0.0
    for i in range(len(step)):
        promised += gradient[i] * step[i]
        for j in range(len(step)):
            promised += 0.5 * step[i] * hessian[i, j] * step[j]
    return promised


@kernel
def _bracket(gradient: Array, hessian: Array) -> tuple[float, float]:
    """Bounds of the multiplier: by the diagonal, and by the row sums that bound every eigenvalue."""
    count = len(gradient)
    squares, largest, top = 0.0, 0.0, 0.0
    for i in range(count):
        squares += gradient[i] * gradient[i]
        top = max(top, hessian[i, i])
        row = 0.0
        for j in range(count):
            row += abs(hessian[i, j])
        largest = max(largest, row)
    length = math.sqrt(squares)
    return max(top, length - largest), (length + largest) * (1.0 + AT_POLE)  # above the pole, not on it


@kernel
def _factored(hessian: Array, multiplier: float, root: Array) -> bool:
    """Fill the lower triangle with the Cholesky root of ``m I - H``; False where that is not positive definite."""
    count = len(root)
    for i in range(count):
        for j in range(i + 1):
            value = (multiplier if i == j else 0.0) - hessian[i, j]
            for k in range(j):
                value -= root[i, k] * root[j, k]
            if i > j:
                root[i, j] = value / root[j, j]
            elif value <= 0.0:
                return False
            else:
                root[i, i] = math.sqrt(value)
    return True


@kernel
def _solved(root: Array, gradient: Array, multiplier: float, step: Array) -> tuple[float, float]:
    """Fill the step for a multiplier; return its length and Newton's next multiplier."""
    count = len(root)
    step[:] = gradient
    _divide(root, step)
    _divide_transposed(root, step)
    length2 = 0.0
    for i in range(count):
        length2 += step[i] * step[i]
    slope = 0.0  # of the length by the multiplier, squares of root^-1 step
    half = step.copy()
    _divide(root, half)
    for i in range(count):
        slope += half[i] * half[i]
    length = math.sqrt(length2)
    if slope == 0.0:  # no gradient: every length is that of the hard case
        return length, -1.0
    return length, multiplier + (length - 1.0) * length2 / slope


@kernel
def _lengthened(root: Array, step: Array) -> Array:
    """Bring a step to length one along the leading eigenvector, found by inverse iteration."""
    count = len(step)
    leading = np.ones(count)
    for i in range(count):
        leading[i] += i / count  # no symmetry of the model's is one of the first guess
    for _ in range(4):  # each multiplies what is not the eigenvector by some 1e-10
        _divide(root, leading)
        _divide_transposed(root, leading)
        leading /= math.sqrt((leading * leading).sum())
    for i in range(count):
        if abs(leading[i]) > 1e-9:
            leading *= math.copysign(1.0, leading[i])
            break
    along = (leading * step).sum()
    rest = 1.0 - (step * step).sum()
    longest: Array = step + (math.sqrt(along * along + rest) - along) * leading
    return longest


@kernel
def _divide(root: Array, vector: Array) -> None:
    """``vector = root^-1 vector`` for a lower triangle."""
    for i in range(len(vector)):
        value = vector[i]
        for k in range(i):
            value -= root[i, k] * vector[k]
        vector[i] = value / root[i, i]


@kernel
def _divide_transposed(root: Array, vector: Array) -> None:
    """``vector = root^-T vector`` for a lower triangle."""
    for i in range(len(vector) - 1, -1, -1):
        value = vector[i]
        for k in range(i + 1, len(vector)):
            value -= root[k, i] * vector[k]
        vector[i] = value / root[i, i]
