"""The filter's arithmetic: models of motion, prediction by exactly integrated noise, and update by a position.

Three models: white acceleration; an acceleration that fades [Singer1970]_; and one that turns with the velocity, so
that the target goes round in a steady turn in any plane [BestNorton1997]_. docs/derivations.md has the equations.

Means have shape (order, 3), derivatives by rows: position, velocity and, with order 3, acceleration [SI; ENU].
Covariances have shape (3 order, 3 order), in blocks of three in the same order. Compiled code is cached beside the
source.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array

FLOOR_M2 = 1e-4  # added to every variance: no sensor of positions is better than a centimetre, and none may say so
SLOW_M_S = 0.5  # a target that hardly moves has no turn
FASTEST_TURN_RAD_S = 1.0  # once round in six seconds: what seems to turn faster is noise
STEADY_M2_S3 = 0.001  # how exactly the speed in a turn is steady: 0.1 m/s^2 along the way, believed anew each 0.1 s


class Dynamics(NamedTuple):
    """A model of motion, the same along each axis and driven by white noise."""

    order: int  # 2: position and velocity; 3: acceleration, too
    density: float  # of the white noise: [m^2/s^3] that of the acceleration, or [m^2/s^5] of what drives it
    ease_s: float  # time constant by which an acceleration fades; infinite: there is none, or it turns
    lasts_s: float = math.inf  # mean time for which a target moves so


@kernel
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


@kernel
def _turned(x: float, linear: float, single: float, double: float, first: int) -> float:
    """Return ``(linear x + single sin x + double sin 2x) / x^(2 first + 1)``, whose lower powers vanish, for x >= 0.

    All integrals over turning accelerations are such sums; for small x they cancel, and the series is used.
    """
    if x >= 1.0:
        return (linear * x + single * math.sin(x) + double * math.sin(2.0 * x)) / x ** (2 * first + 1)
    total, term, power = 0.0, 1.0, 2.0
    for k in range(first + 12):  # 2^(2k+1) / (2k+1)! of the last is below 1e-16 of the first
        if k >= first:
            total += term * (single + double * power)
            term *= x * x
        term /= -(2 * k + 2) * (2 * k + 3)
        power *= 4.0
    return total


@kernel
def turn_rate(mean: Array) -> float:
    """Return how fast velocity and acceleration of a mean, (3, 3), turn each other [rad/s]."""
    cross = np.cross(mean[1], mean[2])
    rate: float = math.sqrt(cross @ cross) / (mean[1] @ mean[1] + SLOW_M_S**2)
    return min(rate, FASTEST_TURN_RAD_S)


@kernel
def turning(step: float, rate: float, move: Array) -> None:
    """Fill in the transition of a steady turn along one axis, (3, 3) [BestNorton1997]_; without a rate it bends."""
    x = rate * step
    half = math.sin(0.5 * x) / (0.5 * x) if x > 0.0 else 1.0
    whole = math.sin(x) / x if x > 0.0 else 1.0
    move[0, 0], move[0, 1], move[0, 2] = 1.0, step * whole, 0.5 * (step * half) ** 2
    move[1, 0], move[1, 1], move[1, 2] = 0.0, math.cos(x), step * whole
    move[2, 0], move[2, 1], move[2, 2] = 0.0, -rate * math.sin(x), math.cos(x)


@kernel
def passed(step: float, density: float, ease: float, rate: float, move: Array, noise: Array) -> None:
    """Fill in what a step does along one axis: transition and exactly integrated noise, each (order, order)."""
    order = len(move)
    if order == 2:
        move[0, 0], move[0, 1], move[1, 1] = 1.0, step, 1.0
        noise[0, 0], noise[0, 1], noise[1, 1] = step**3 / 3.0, step**2 / 2.0, step
    elif math.isinf(ease):
        turning(step, rate, move)
        x = rate * step
        noise[0, 0] = step**5 * _turned(x, 1.5, -2.0, 0.25, 2)
        noise[0, 1] = 0.5 * move[0, 2] ** 2
        noise[0, 2] = step**3 * _turned(x, -0.5, 1.0, -0.25, 1)
        noise[1, 1] = step**3 * _turned(x, 0.5, 0.0, -0.25, 1)
        noise[1, 2] = 0.5 * move[0, 1] ** 2
        noise[2, 2] = 0.5 * (step + move[0, 1] * move[1, 1])
    else:
        move[0, 0], move[0, 1], move[1, 1] = 1.0, step, 1.0
        x = step / ease
        move[0, 2] = ease**2 * _faded(x, 0.0, 0.0, 1.0, 2)
        move[1, 2] = -ease * _faded(x, 0.0, 0.0, 1.0, 1)
        noise[0, 0] = 0.5 * ease**5 * _faded(x, -1.0, 4.0, 0.0, 5)
        noise[0, 1] = 0.5 * ease**4 * _faded(x, 1.0, -2.0, -2.0, 4)
        noise[0, 2] = 0.5 * ease**3 * _faded(x, -1.0, 2.0, 0.0, 3)
        noise[1, 1] = 0.5 * ease**3 * _faded(x, -1.0, 0.0, 4.0, 3)
        noise[1, 2] = 0.5 * ease**2 * _faded(x, 1.0, 0.0, -2.0, 2)
        noise[2, 2] = 0.5 * ease * _faded(x, -1.0, 0.0, 0.0, 1)
        move[2, 2] = math.exp(-x)
    for i in range(order):
        for k in range(i, order):
            noise[i, k] *= density
            noise[k, i] = noise[i, k]


@kernel
def predict(
    mean: Array, covariance: Array, step: float, density: float, ease: float, rate: float
) -> tuple[Array, Array]:
    """Return mean, (order, 3), and covariance, (3 order, 3 order), a step later; the rate is that of a turn."""
    order, size = len(mean), len(covariance)
    move, noise = np.zeros((order, order)), np.zeros((order, order))
    passed(step, density, ease, rate, move, noise)
    moved, half, spread = np.zeros((order, 3)), np.zeros((size, size)), np.zeros((size, size))
    for i in range(order):
        for k in range(order):  # the transition is the same along each axis
            for a in range(3):
                moved[i, a] += move[i, k] * mean[k, a]
                for column in range(size):
                    half[3 * i + a, column] += move[i, k] * covariance[3 * k + a, column]
    for i in range(order):
        for a in range(3):
            for k in range(order):
                for row in range(size):
                    spread[row, 3 * i + a] += move[i, k] * half[row, 3 * k + a]
            for k in range(order):
                spread[3 * i + a, 3 * k + a] += noise[i, k]
    return moved, spread


@kernel
def update(mean: Array, covariance: Array, position: Array, noise: Array) -> tuple[float, float]:
    """Update mean and covariance in place by a measured position.

    Returns its squared Mahalanobis distance and the logarithm of the determinant of the covariance of that distance. In
    Joseph's form, which keeps the covariance positive definite for any gain, made symmetric again.
    """
    size = len(covariance)
    s, seen, gap, gain = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros((size, 3))
    for a in range(3):
        gap[a] = position[a] - mean[0, a]
        for b in range(3):
            seen[a, b] = noise[a, b] + (FLOOR_M2 if a == b else 0.0)
            s[a, b] = covariance[a, b] + seen[a, b]
    root, far, white = np.zeros((3, 3)), np.zeros(3), np.zeros((size, 3))
    for a in range(3):  # Cholesky: unlike an inverse by cofactors right for flat covariances, too
        for b in range(a + 1):
            left = s[a, b]
            for c in range(b):
                left -= root[a, c] * root[b, c]
            root[a, b] = math.sqrt(max(left, FLOOR_M2)) if a == b else left / root[b, b]
    distance, volume = 0.0, 0.0
    for a in range(3):
        volume += 2.0 * math.log(root[a, a])
        far[a] = gap[a]
        for b in range(a):
            far[a] -= root[a, b] * far[b]
        far[a] /= root[a, a]
        distance += far[a] * far[a]
        for row in range(size):
            white[row, a] = covariance[row, a]
            for b in range(a):
                white[row, a] -= root[a, b] * white[row, b]
            white[row, a] /= root[a, a]
    for row in range(size):
        for a in range(2, -1, -1):
            gain[row, a] = white[row, a]
            for b in range(a + 1, 3):
                gain[row, a] -= root[b, a] * gain[row, b]
            gain[row, a] /= root[a, a]
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
    return distance, volume


@kernel
def steadied(mean: Array, covariance: Array, step: float) -> None:
    """Update mean, (3, 3), and covariance, (9, 9), in place by the knowledge that the speed in a turn is steady.

    A pseudo-measurement: no acceleration along the velocity [AlouaniBlair1993]_. Its variance shrinks with
    the step that passed, so that more sightings do not make it more certain.
    """
    speed = math.sqrt(mean[1] @ mean[1])
    if speed < SLOW_M_S or step <= 0.0:
        return
    way = mean[1] / speed
    along = way @ mean[2]
    gradient, seen = np.zeros(9), np.zeros(9)
    for a in range(3):
        gradient[3 + a] = (mean[2, a] - along * way[a]) / speed
        gradient[6 + a] = way[a]
    for row in range(9):
        for column in range(3, 9):
            seen[row] += covariance[row, column] * gradient[column]
    variance = STEADY_M2_S3 / step
    spread = variance
    for row in range(3, 9):
        spread += gradient[row] * seen[row]
    for row in range(9):
        mean[row // 3, row % 3] -= seen[row] / spread * along
        for column in range(row + 1):
            covariance[row, column] -= seen[row] * seen[column] / spread
            covariance[column, row] = covariance[row, column]
