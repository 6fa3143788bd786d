from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad_vec

from fg_gcs.track.estimator import Model, Settings
from fg_gcs.track.kalman import FLOOR_M2, Dynamics, passed, predict, update
from tests.track.scenes import MODELS, Array


def stepped(dynamics: Dynamics, step_s: float) -> tuple[Array, Array]:
    move, noise = np.zeros((dynamics.order, dynamics.order)), np.zeros((dynamics.order, dynamics.order))
    passed(step_s, dynamics.density, dynamics.ease_s, move, noise)
    return move, noise


@pytest.mark.parametrize("model", MODELS)
def test_noise_is_the_integral_of_its_definition(model: Model) -> None:
    dynamics = Settings(model=model).dynamics
    ease = dynamics.ease_s

    def response(after_s: float) -> Array:  # to a push at time 0
        if dynamics.order == 2:
            row = np.array([after_s, 1.0])
        else:
            left = math.exp(-after_s / ease)
            row = np.array([ease * (after_s - ease * (1.0 - left)), ease * (1.0 - left), left])
        return dynamics.density * np.outer(row, row)

    for step_s in (0.3, 1.0, 3.9, 4.1, 20.0):
        move, noise = stepped(dynamics, step_s)
        assert noise == pytest.approx(quad_vec(response, 0.0, step_s, epsrel=1e-13)[0], rel=1e-9)
        assert np.array_equal(move, np.triu(move))


@pytest.mark.parametrize("model", MODELS)
def test_two_half_steps_are_one_step(model: Model) -> None:
    dynamics = Settings(model=model).dynamics
    for step_s in (1e-6, 1e-3, 0.05, 0.1, 1.0, 3.9999, 4.0, 7.9999, 8.0001, 30.0):
        half_move, half_noise = stepped(dynamics, 0.5 * step_s)
        move, noise = stepped(dynamics, step_s)
        assert half_move @ half_move == pytest.approx(move, rel=1e-12, abs=0.0)
        assert half_move @ half_noise @ half_move.T + half_noise == pytest.approx(noise, rel=1e-12, abs=0.0)


def test_a_step_of_no_time_changes_nothing() -> None:
    mean, covariance = np.arange(9.0).reshape(3, 3), np.diag(np.arange(1.0, 10.0))
    again, spread = predict(mean, covariance, 0.0, 1.0, 4.0)
    assert np.array_equal(again, mean)
    assert np.array_equal(spread, covariance)


@pytest.mark.parametrize("model", MODELS)
def test_the_covariance_stays_one(model: Model) -> None:
    rng = np.random.default_rng(7)
    dynamics = Settings(model=model).dynamics
    mean, covariance = np.zeros((dynamics.order, 3)), np.eye(3 * dynamics.order)
    steps_s = rng.choice([0.0, 1e-6, 0.01, 0.1, 30.0, 3600.0], p=[0.1, 0.1, 0.3, 0.498, 0.001, 0.001], size=100_000)
    roots_m = rng.choice([0.0, 0.5, 1000.0], p=[0.1, 0.8, 0.1], size=(100_000, 1, 1)) * rng.normal(size=(100_000, 3, 3))
    for k, (step_s, root_m) in enumerate(zip(steps_s, roots_m, strict=True)):
        mean, covariance = predict(mean, covariance, step_s, dynamics.density, dynamics.ease_s)
        distance = update(mean, covariance, np.zeros(3), root_m @ root_m.T)
        assert distance >= 0.0
        if k % 50 == 49:
            assert np.array_equal(covariance, covariance.T)
            assert np.linalg.eigvalsh(covariance)[0] > 0.0


@pytest.mark.parametrize("model", MODELS)
def test_an_update_is_the_weighted_mean_of_what_is_known_and_what_is_seen(model: Model) -> None:
    rng = np.random.default_rng(9)
    order = Settings(model=model).dynamics.order
    for _ in range(20):
        mean, root, seen_root = (rng.normal(size=shape) for shape in ((order, 3), (3 * order, 3 * order), (3, 3)))
        covariance, noise, position = root @ root.T, seen_root @ seen_root.T, rng.normal(size=3)
        look = np.eye(3, 3 * order)
        weight = np.linalg.inv(noise + FLOOR_M2 * np.eye(3))
        information = np.linalg.inv(covariance) + look.T @ weight @ look
        expected = np.linalg.solve(information, np.linalg.solve(covariance, mean.ravel()) + look.T @ weight @ position)
        gap = position - mean[0]
        far = gap @ np.linalg.solve(covariance[:3, :3] + noise + FLOOR_M2 * np.eye(3), gap)
        assert update(mean, covariance, position, noise) == pytest.approx(far, rel=1e-6)
        assert mean.ravel() == pytest.approx(expected, rel=1e-5, abs=1e-6)
        assert covariance == pytest.approx(np.linalg.inv(information), rel=1e-4, abs=1e-6)
