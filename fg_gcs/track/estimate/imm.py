"""Several models of one target's motion at once: interacting multiple models [BlomBarShalom1988]_.

Each model keeps its own mean and covariance; the sightings say which one to believe. What is believed of B models are
weights, shape (B,), that sum to 1, means, (B, order, 3), covariances, (B, 3 order, 3 order), and rates of turn, (B,).
One model alone is a plain Kalman filter. docs/derivations.md has the equations of mixing and merging.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.track.estimate.kalman import predict, steadied, turn_rate, turning, update

LEAST_WEIGHT = 1e-6  # no model is ever ruled out for good


class Belief(NamedTuple):
    """What is believed of a target after a sighting."""

    weights: Array  # (B,)
    means: Array  # (B, order, 3)
    covariances: Array  # (B, 3 order, 3 order)
    rates_rad_s: Array  # (B,) of turn


class Prediction(NamedTuple):
    """Where a target, or the centre of several, goes from a time on: the mean of B possible ways."""

    time_s: float  # [s of the flight's clock]
    weights: Array  # (B,)
    means: Array  # (B, 3, 3) position, velocity and acceleration [SI; ENU]
    eases_s: Array  # (B,) time constants by which accelerations fade; infinite where they turn
    rates_rad_s: Array  # (B,) of turn

    @classmethod
    def straight(cls, time_s: float, position_enu_m: Array, velocity_m_s: Array) -> Self:
        """Return the steady motion through a position, shape (3,), with a velocity, shape (3,)."""
        mean = np.stack((position_enu_m, velocity_m_s, np.zeros(3)))
        return cls(time_s, np.ones(1), mean[None], np.ones(1), np.zeros(1))

    @classmethod
    def centre(cls, shares: Sequence[float], parts: Sequence[Self]) -> Self:
        """Return that of the centre of several, which all begin at one time; shares sum to 1."""
        weights = [share * part.weights for share, part in zip(shares, parts, strict=True)]
        columns = (np.concatenate([part[column] for part in parts]) for column in range(2, 5))
        return cls(parts[0].time_s, np.concatenate(weights), *columns)

    def at(self, time_s: float) -> Array:
        """Return position, velocity and acceleration at a time, shape (3, 3) [s]; before the first, there."""
        passed_s = max(time_s - self.time_s, 0.0)
        carried: Array = _carried(self.weights, self.means, self.eases_s, self.rates_rad_s, passed_s)
        return carried


@kernel
def _carried(weights: Array, means: Array, eases: Array, rates: Array, step: float) -> Array:
    """Return the weighted mean of what comes of means after a step, (3, 3)."""
    total, move = np.zeros((3, 3)), np.zeros((3, 3))
    for b in range(len(weights)):
        if math.isinf(eases[b]):
            turning(step, rates[b], move)
        else:
            tau, left = eases[b], math.exp(-step / eases[b])
            move[:] = 0.0
            move[0, 0], move[0, 1], move[0, 2] = 1.0, step, tau * (step - tau * (1.0 - left))
            move[1, 1], move[1, 2], move[2, 2] = 1.0, tau * (1.0 - left), left
        for i in range(3):
            for k in range(i if i < 2 else 1, 3):
                for a in range(3):
                    total[i, a] += weights[b] * move[i, k] * means[b, k, a]
    return total


@kernel
def carried_on(means: Array, covariances: Array, rates: Array, models: Array, step: float) -> tuple[Array, Array]:
    """Return means and covariances a step later; ``models`` are densities and time constants, (B, 2)."""
    moved, spread = np.empty_like(means), np.empty_like(covariances)
    for b in range(len(means)):
        moved[b], spread[b] = predict(means[b], covariances[b], step, models[b, 0], models[b, 1], rates[b])
    return moved, spread


@kernel
def changes(leaving: Array, step: float) -> Array:
    """Return the probabilities of being in each model after a step, columns, from each before, rows; (B, B)."""
    chances = np.eye(len(leaving))
    if len(leaving) == 2:
        both = leaving[0] + leaving[1]
        changed = (1.0 - math.exp(-both * step)) / both
        for b in range(2):
            chances[b, 1 - b] = leaving[b] * changed
            chances[b, b] -= leaving[b] * changed
    return chances


@kernel
def merged(weights: Array, doubts: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Return the mean of a mixture, (order, 3), and the covariance about it, (3 order, 3 order).

    The mean is that by the weights. The covariance is that by the doubts: weights as well, but by what may have become
    of the target since they were found.
    """
    size = covariances.shape[1]
    mean, covariance = np.zeros(means.shape[1:]), np.zeros((size, size))
    for b in range(len(weights)):
        mean += weights[b] * means[b]
    for b in range(len(weights)):
        gap = (means[b] - mean).ravel()
        for row in range(size):
            for column in range(size):
                covariance[row, column] += doubts[b] * (covariances[b, row, column] + gap[row] * gap[column])
    return mean, covariance


@kernel
def _mixed(weights: Array, means: Array, covariances: Array, leaving: Array, step: float) -> tuple[Array, Array, Array]:
    """Return a belief after a step in which the target may have changed from one model to another."""
    chances = changes(leaving, step)
    expected, mixed, spread = weights @ chances, np.empty_like(means), np.empty_like(covariances)
    for b in range(len(weights)):
        shares = np.ascontiguousarray(chances[:, b]) * weights / expected[b]
        mixed[b], spread[b] = merged(shares, shares, means, covariances)
    return expected, mixed, spread


@kernel
def filtered(
    weights: Array,
    means: Array,
    covariances: Array,
    models: Array,
    leaving: Array,
    step: float,
    position: Array,
    noise: Array,
) -> tuple[Array, Array, Array, Array, float]:
    """Take a sighting a step later.

    Args:
        weights: of the models, (B,).
        means: (B, order, 3).
        covariances: (B, 3 order, 3 order).
        models: densities and time constants, (B, 2).
        leaving: rates at which targets leave each of two models for the other [1/s], (B,).
        step: since the belief [s], >= 0.
        position: seen, (3,).
        noise: of that, (3, 3).

    Returns:
        Weights, means, covariances, rates of turn, and the squared Mahalanobis distance of the sighting from the model
        that it is nearest to.
    """
    count, order = means.shape[0], means.shape[1]
    expected, before, uncertain = _mixed(weights, means, covariances, leaving, step)
    rates, distances, likely = np.zeros(count), np.empty(count), np.empty(count)
    for b in range(count):
        turns = order == 3 and math.isinf(models[b, 1])
        rates[b] = turn_rate(before[b]) if turns else 0.0
        moved, spread = predict(before[b], uncertain[b], step, models[b, 0], models[b, 1], rates[b])
        distances[b], volume = update(moved, spread, position, noise)
        likely[b] = -0.5 * (distances[b] + volume)
        if turns:
            steadied(moved, spread, step)
            rates[b] = turn_rate(moved)
        before[b], uncertain[b] = moved, spread
    expected *= np.exp(likely - likely.max())
    expected = np.maximum(expected / expected.sum(), LEAST_WEIGHT)
    return expected / expected.sum(), before, uncertain, rates, distances.min()
