from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from fg_gcs.track.estimator import Estimator, Model, Settings
from fg_gcs.track.kalman import FLOOR_M2
from fg_gcs.track.sightings import Verdict
from tests.track.scenes import (
    DELAY_S,
    MODELS,
    NOISE_M2,
    SIGMA_M,
    Array,
    Motion,
    circle,
    dodging,
    eight,
    known,
    seen,
    tight_eight,
)
from tests.track.test_kalman import stepped


class Run:
    """A motion watched for a minute: root mean square errors of predictions, and outliers that were taken."""

    def __init__(self, motion: Motion, seed: int, drop: float = 0.0, outliers: float = 0.0) -> None:
        rng = np.random.default_rng(seed)
        estimator = Estimator(Settings())
        squares: list[list[float]] = []
        self.wild_taken = 0
        for k in range(600):
            time_s = 0.1 * k
            error, way = SIGMA_M * rng.normal(size=3), rng.normal(size=3)
            wild, dropped = rng.random() < outliers, rng.random() < drop
            position = motion(time_s) + error + wild * 20.0 * way / np.linalg.norm(way)
            if not dropped:
                verdict = estimator.add(seen(time_s, position), time_s + DELAY_S)
                self.wild_taken += wild and verdict is Verdict.TAKEN
            if time_s >= 3.0:
                aheads = (DELAY_S, 0.5, DELAY_S + 0.5)
                gaps = [known(estimator, time_s + s).position_enu_m - motion(time_s + s) for s in aheads]
                squares.append([float(gap @ gap) for gap in gaps])
        self.now_m, self.half_second_m, self.half_second_from_now_m = np.sqrt(np.mean(squares, axis=0)).tolist()


@pytest.mark.parametrize(
    ("motions", "now_m", "half_second_m"),
    [
        ([circle] * 8, 0.40, 0.55),
        ([eight] * 8, 0.50, 0.75),
        ([tight_eight] * 8, 0.50, 0.95),
        ([dodging(seed) for seed in range(8)], 0.60, 1.0),
    ],
    ids=["circle", "eight", "tight eight", "dodging"],
)
def test_errors_stay_below_the_stated_ones(motions: list[Motion], now_m: float, half_second_m: float) -> None:
    clean = [Run(motion, seed) for seed, motion in enumerate(motions)]
    hard = [Run(motion, seed, drop=0.3, outliers=0.05) for seed, motion in enumerate(motions)]
    error_m = math.sqrt(np.mean([run.now_m**2 for run in clean]))
    assert error_m <= now_m
    assert math.sqrt(np.mean([run.half_second_from_now_m**2 for run in clean])) <= half_second_m
    assert math.sqrt(np.mean([run.now_m**2 for run in hard])) <= 1.5 * error_m
    assert not any(run.wild_taken for run in hard)


def simulated(model: Model, seed: int, steps: int) -> tuple[Array, Array, Array]:
    """Stamps (K,), true states (K, order, 3) and measured positions (K, 3) of the filter's own model."""
    rng = np.random.default_rng(seed)
    dynamics = Settings(model=model).dynamics
    times, states, measured = [0.0], [np.zeros((dynamics.order, 3))], [SIGMA_M * rng.normal(size=3)]
    for _ in range(steps):
        step_s = rng.uniform(0.02, 0.3)
        move, noise = stepped(dynamics, step_s)
        states.append(move @ states[-1] + np.linalg.cholesky(noise) @ rng.normal(size=(dynamics.order, 3)))
        times.append(times[-1] + step_s)
        measured.append(states[-1][0] + math.sqrt(SIGMA_M**2 + FLOOR_M2) * rng.normal(size=3))
    return np.array(times), np.array(states), np.array(measured)


@pytest.mark.parametrize("model", MODELS)
def test_errors_and_innovations_are_as_large_as_their_covariances_say(model: Model) -> None:
    runs, steps, looks = 50, 150, (60, 90, 120, 150)
    size = 3 * Settings(model=model).dynamics.order
    errors, innovations = dict.fromkeys(looks, 0.0), 0.0
    for seed in range(runs):
        times, states, measured = simulated(model, seed, steps)
        estimator = Estimator(Settings(model=model, confidence=1.0 - 1e-9))
        for k, (time_s, position) in enumerate(zip(times, measured, strict=True)):
            if k > 50:
                before = known(estimator, time_s)
                gap = position - before.position_enu_m
                spread = before.covariance[:3, :3] + NOISE_M2 + FLOOR_M2 * np.eye(3)
                innovations += float(gap @ np.linalg.solve(spread, gap))
            estimator.add(seen(time_s, position), time_s)
            if k in looks:
                after = known(estimator, time_s)
                rows = (after.position_enu_m, after.velocity_m_s, after.acceleration_m_s2)[: size // 3]
                error = (np.stack(rows) - states[k]).ravel()
                errors[k] += float(error @ np.linalg.solve(after.covariance, error))
    for total in errors.values():
        assert chi2.ppf(0.001, runs * size) < total < chi2.ppf(0.999, runs * size)
    count = 3 * runs * (steps - 50)
    assert chi2.ppf(0.001, count) < innovations < chi2.ppf(0.999, count)


def test_one_clean_sighting_in_a_thousand_is_outside_the_gate() -> None:
    gated = total = 0
    for seed in range(20):
        times, _, measured = simulated("acceleration", seed, 1000)
        estimator = Estimator(Settings(reach_m=1e6))
        verdicts = [estimator.add(seen(t, z), t) for t, z in zip(times, measured, strict=True)][10:]
        gated += verdicts.count(Verdict.GATED)
        total += len(verdicts)
    assert 0.0005 * total < gated < 0.0016 * total
