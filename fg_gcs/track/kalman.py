"""The filter's arithmetic: models of motion, prediction by exactly integrated noise, and update by a position.

Means have shape (order, 3), derivatives by rows: position, velocity and, with order 3, acceleration [SI; ENU].
Covariances have shape (3 order, 3 order), in blocks of three in the same order. Compiled code is cached beside the
source.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

FLOOR_M2 = 1e-4  # added to every variance: no sensor of positions is better than a centimetre, and none may say so


class Dynamics(NamedTuple):
    """A model of motion, the same along each axis: white noise, integrated twice or faded and then integrated twice."""

    order: int  # 2: position and velocity; 3: acceleration, too
    density: float  # of the white noise: [m^2/s^3] that of the acceleration, or [m^2/s^5] of what drives it
    ease_s: float  # time constant by which an acceleration fades; infinite if there is none


@njit(cache=True)
def _faded(x: float, doubled: float, linear: float, constant: float, first: int) -> float:
    """Return ``sum over n >= first of (-x)^n (doubled 2^n + linear n + constant) / n!`` for x >= 0.

    All integrals over fading accelerations are such sums; as a whole exponential function they cancel for small x.
    """
    if x < 1.0:
        total, term, power = 0.0, 1.0, 1.0
        for n in range(first + 24):  # 2^n / n! of the last is below 1e-16 of the first
            if n >= first:
                total += term * (doubled * power + linear * n + constant)
            term *= -x / (n + 1)
            power *= 2.0
        return total
    total, term, power = doubled * math.exp(-2.0 * x) + (constant - linear * x) * math.exp(-x), 1.0, 1.0
    for n in range(first):
        total -= term * (doubled * power + linear * n + constant)
        term *= -x / (n + 1)
        power *= 2.0
    return total


@njit(cache=True)
def passed(step: float, density: float, ease: float, move: Array, noise: Array) -> None:
    """Fill in what a step does along one axis: transition and exactly integrated noise, each (order, order)."""
    order = len(move)
    move[0, 1] = step
    if order == 2:
        noise[0, 0], noise[0, 1], noise[1, 1] = step**3 / 3.0, step**2 / 2.0, step
    else:
        x = step / ease
        move[0, 2] = ease**2 * _faded(x, 0.0, 0.0, 1.0, 2)
        move[1, 2] = -ease * _faded(x, 0.0, 0.0, 1.0, 1)
        noise[0, 0] = 0.5 * ease**5 * _faded(x, -1.0, 4.0, 0.0, 5)
        noise[0, 1] = 0.5 * ease**4 * _faded(x, 1.0, -2.0, -2.0, 4)
        noise[0, 2] = 0.5 * ease**3 * _faded(x, -1.0, 2.0, 0.0, 3)
        noise[1, 1] = 0.5 * ease**3 * _faded(x, -1.0, 0.0, 4.0, 3)
        noise[1, 2] = 0.5 * ease**2 * _faded(x, 1.0, 0.0, -2.0, 2)
        noise[2, 2] = 0.5 * ease * _faded(x, -1.0, 0.0, 0.0, 1)
    for i in range(order):
        move[i, i] = 1.0 if i < 2 else math.exp(-step / ease)
        for k in range(i, order):
            noise[i, k] *= density
            noise[k, i] = noise[i, k]


@njit(cache=True)
def predict(mean: Array, covariance: Array, step: float, density: float, ease: float) -> tuple[Array, Array]:
    """Return mean, (order, 3), and covariance, (3 order, 3 order), a step later."""
    order, size = len(mean), len(covariance)
    move, noise = np.zeros((order, order)), np.zeros((order, order))
    passed(step, density, ease, move, noise)
    moved, half, spread = np.zeros((order, 3)), np.zeros((size, size)), np.zeros((size, size))
    for i in range(order):
        for k in range(i, order):  # the transition is upper triangular, and the same along each axis
            for a in range(3):
                moved[i, a] += move[i, k] * mean[k, a]
                for column in range(size):
                    half[3 * i + a, column] += move[i, k] * covariance[3 * k + a, column]
    for i in range(order):
        for a in range(3):
            for k in range(i, order):
                for row in range(size):
                    spread[row, 3 * i + a] += move[i, k] * half[row, 3 * k + a]
            for k in range(order):
                spread[3 * i + a, 3 * k + a] += noise[i, k]
    return moved, spread


@njit(cache=True)
def update(mean: Array, covariance: Array, position: Array, noise: Array) -> float:
    """Update mean and covariance in place by a measured position; return its squared Mahalanobis distance.

    In Joseph's form, which keeps the covariance positive definite for any gain, made symmetric again.
    """
    size = len(covariance)
    s, seen, gap, gain = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros((size, 3))
    for a in range(3):
        gap[a] = position[a] - mean[0, a]
        for b in range(3):
            seen[a, b] = noise[a, b] + (FLOOR_M2 if a == b else 0.0)
            s[a, b] = covariance[a, b] + seen[a, b]
    inverse = np.zeros((3, 3))
    for a in range(3):  # by cofactors: indices that go round take care of the signs
        for b in range(3):
            c, d, e, f = (b + 1) % 3, (b + 2) % 3, (a + 1) % 3, (a + 2) % 3
            inverse[a, b] = s[c, e] * s[d, f] - s[c, f] * s[d, e]
    determinant = s[0, 0] * inverse[0, 0] + s[0, 1] * inverse[1, 0] + s[0, 2] * inverse[2, 0]
    distance = 0.0
    for a in range(3):
        for b in range(3):
            inverse[a, b] /= determinant
            distance += gap[a] * inverse[a, b] * gap[b]
            for row in range(size):
                gain[row, b] += covariance[row, a] * inverse[a, b]
    kept = covariance.copy()
    for row in range(size):
        for a in range(3):
            mean[row // 3, row % 3] += gain[row, a] * gap[a]
            for column in range(size):
                kept[row, column] -= gain[row, a] * covariance[a, column]
    for row in range(size):
        for column in range(row + 1):
            covariance[row, column] = 0.5 * (kept[row, column] + kept[column, row])
            for a in range(3):
                covariance[row, column] -= 0.5 * (kept[row, a] * gain[column, a] + kept[column, a] * gain[row, a])
                for b in range(3):
                    covariance[row, column] += gain[row, a] * seen[a, b] * gain[column, b]
            covariance[column, row] = covariance[row, column]
    return distance
