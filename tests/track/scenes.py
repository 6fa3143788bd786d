from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.track.estimate.estimator import Estimate, Estimator, Model
from fg_gcs.track.estimate.kalman import Dynamics
from fg_gcs.track.sightings import Sighting, isotropic

Motion = Callable[[float], Array]

SIGMA_M = 0.5
NOISE_M2 = isotropic(SIGMA_M)
DELAY_S = 0.1
SINGLE: tuple[Model, ...] = ("velocity", "acceleration")  # one linear filter each: only of those is the law exact
MODELS: tuple[Model, ...] = ("mixed", *SINGLE)


def turns(dynamics: Dynamics) -> bool:
    """Whether a target's acceleration turns with its velocity."""
    return dynamics.order == 3 and math.isinf(dynamics.ease_s)


def seen(time_s: float, position: object, sigma_m: float = SIGMA_M) -> Sighting:
    return Sighting("boat", time_s, np.array(position, dtype=float), isotropic(sigma_m), time_s + DELAY_S)


def known(estimator: Estimator, time_s: float) -> Estimate:
    estimate = estimator.at(time_s)
    assert estimate is not None
    return estimate


def same(one: Estimate, other: Estimate) -> None:
    assert one.time_s == other.time_s
    assert one.age_s == other.age_s
    for mine, yours in zip((*one[1:5], *one.belief), (*other[1:5], *other.belief), strict=True):
        assert np.array_equal(np.asarray(mine), np.asarray(yours))


def circle(time_s: float) -> Array:
    """4 m/s on a radius of 50 m."""
    angle = 4.0 / 50.0 * time_s
    return np.array([50.0 * math.cos(angle), 50.0 * math.sin(angle), 10.0])


def eight(time_s: float) -> Array:
    """A lemniscate of Gerono, 60 m long, at most 5 m/s."""
    angle = 5.0 / (30.0 * math.sqrt(2.0)) * time_s
    return np.array([30.0 * math.sin(angle), 15.0 * math.sin(2.0 * angle), 10.0])


def tight_eight(time_s: float) -> Array:
    """A lemniscate of Bernoulli, 60 m long, at most 1.5 m/s^2: at its ends, which it passes at 3.9 m/s."""
    angle = math.sqrt(1.5 / 90.0) * time_s
    below = 1.0 + math.sin(angle) ** 2
    return np.array([30.0 * math.cos(angle), 30.0 * math.sin(angle) * math.cos(angle), 10.0 * below]) / below


def dodging(seed: int) -> Motion:
    """A new acceleration of 1 m/s^2 in a random direction every second, less where the speed would exceed 5 m/s."""
    rng = np.random.default_rng(seed)
    positions, velocities = [np.array([0.0, 0.0, 10.0])], [np.zeros(3)]
    for _ in range(100):
        push = rng.normal(size=3)
        end = velocities[-1] + push / np.linalg.norm(push)
        end *= min(1.0, 5.0 / float(np.linalg.norm(end)))
        positions.append(positions[-1] + 0.5 * (velocities[-1] + end))
        velocities.append(end)

    def at(time_s: float) -> Array:
        second = int(time_s)
        part = time_s - second
        bend = velocities[second + 1] - velocities[second]
        there: Array = positions[second] + part * velocities[second] + 0.5 * part**2 * bend
        return there

    return at
