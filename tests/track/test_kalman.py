from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad_vec

from fg_gcs.core.arrays import Array
from fg_gcs.track.estimate.estimator import Settings
from fg_gcs.track.estimate.kalman import (
    FASTEST_TURN_RAD_S,
    FLOOR_M2,
    SLOW_M_S,
    STEADY_M2_S3,
    Dynamics,
    _turned,
    passed,
    predict,
    steadied,
    turn_rate,
    turning,
    update,
)
from tests.track.scenes import turns

WHITE = Settings(model="velocity").dynamics[0]
TURNING, FADING = Settings(model="mixed").dynamics
RATES_RAD_S = (0.0, 1e-9, 1e-3, 0.08, 1.0)
# Each model of motion, and at which rates it turns
MOTIONS = [(WHITE, 0.0), (FADING, 0.0), *((TURNING, rate) for rate in RATES_RAD_S)]
NAMES = ["white", "fading", *(f"turning {rate}" for rate in RATES_RAD_S)]


def stepped(dynamics: Dynamics, step_s: float, rate: float = 0.0) -> tuple[Array, Array]:
    move, noise = np.zeros((dynamics.order, dynamics.order)), np.zeros((dynamics.order, dynamics.order))
    passed(step_s, dynamics.density, dynamics.ease_s, rate, move, noise)
    return move, noise


@pytest.mark.parametrize(("dynamics", "rate"), MOTIONS, ids=NAMES)
def test_noise_is_the_integral_of_its_definition(dynamics: Dynamics, rate: float) -> None:
    ease = dynamics.ease_s

    def response(after_s: float) -> Array:  # to a push at time 0
        if dynamics.order == 2:
            return np.array([after_s, 1.0])
        if turns(dynamics) and rate == 0.0:
            return np.array([0.5 * after_s**2, after_s, 1.0])
        if turns(dynamics):
            half = math.sin(0.5 * rate * after_s) / rate
            return np.array([2.0 * half**2, math.sin(rate * after_s) / rate, math.cos(rate * after_s)])
        left = math.exp(-after_s / ease)
        return np.array([ease * (after_s - ease * (1.0 - left)), ease * (1.0 - left), left])

    def spread(after_s: float) -> Array:
        return dynamics.density * np.outer(response(after_s), response(after_s))

    for step_s in (0.3, 0.999, 1.0, 3.9, 4.1, 20.0):
        move, noise = stepped(dynamics, step_s, rate)
        assert noise == pytest.approx(quad_vec(spread, 0.0, step_s, epsrel=1e-13)[0], rel=1e-9, abs=0.0)
        assert move[:, -1] == pytest.approx(response(step_s), rel=1e-12, abs=0.0)
        assert turns(dynamics) or np.array_equal(move, np.triu(move))


@pytest.mark.parametrize(("dynamics", "rate"), MOTIONS, ids=NAMES)
def test_two_half_steps_are_one_step(dynamics: Dynamics, rate: float) -> None:
    for step_s in (1e-6, 1e-3, 0.05, 0.1, 1.0, 1.9999, 2.0001, 3.9999, 4.0, 7.9999, 8.0001, 30.0):
        half_move, half_noise = stepped(dynamics, 0.5 * step_s, rate)
        move, noise = stepped(dynamics, step_s, rate)
        assert half_move @ half_move == pytest.approx(move, rel=1e-12, abs=0.0)
        assert half_move @ half_noise @ half_move.T + half_noise == pytest.approx(noise, rel=1e-12, abs=0.0)


@pytest.mark.parametrize(("dynamics", "rate"), MOTIONS, ids=NAMES)
def test_a_step_of_no_time_changes_nothing(dynamics: Dynamics, rate: float) -> None:
    order = dynamics.order
    mean, covariance = np.arange(3.0 * order).reshape(order, 3), np.diag(np.arange(1.0, 3.0 * order + 1.0))
    again, spread = predict(mean, covariance, 0.0, dynamics.density, dynamics.ease_s, rate)
    assert np.array_equal(again, mean)
    assert np.array_equal(spread, covariance)


# --- turns -----------------------------------------------------------------------------------------------------------


def on_a_circle(rate: float, radius_m: float, seed: int) -> tuple[Array, Array]:
    """Centre, shape (3,), and state, shape (3, 3), of a point that goes round in a plane of any attitude."""
    rng = np.random.default_rng(seed)
    out, along = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
    centre = 10.0 * rng.normal(size=3)
    state = (centre + radius_m * out, radius_m * rate * along, -radius_m * rate**2 * out)
    return centre, np.stack(state)


@pytest.mark.parametrize(("rate", "radius_m"), [(1e-3, 5000.0), (0.08, 50.0), (0.3, 10.0), (1.0, 3.0)])
def test_what_goes_round_stays_on_its_circle(rate: float, radius_m: float) -> None:
    for seed in range(5):
        centre, state = on_a_circle(rate, radius_m, seed)
        move = np.zeros((3, 3))
        turning(0.1, rate, move)
        small, at_once = state, np.zeros((3, 3))
        for k in range(1, 1001):  # 100 s
            small = move @ small
            turning(0.1 * k, rate, at_once)
            for there in (small, at_once @ state):
                assert np.linalg.norm(there[0] - centre) == pytest.approx(radius_m, rel=1e-9)
                assert np.linalg.norm(there[1]) == pytest.approx(rate * radius_m, rel=1e-9)
                assert there[2] == pytest.approx(-(rate**2) * (there[0] - centre), abs=1e-9)
        angle = rate * 100.0
        turned = math.cos(angle) * state[1] + math.sin(angle) / rate * state[2]
        assert small[1] == pytest.approx(turned, abs=1e-9)


@pytest.mark.parametrize("rate", [1e-3, 0.08, 1.0])
def test_a_turn_keeps_its_energy_whatever_it_begins_with(rate: float) -> None:
    rng = np.random.default_rng(3)
    move = np.zeros((3, 3))
    for _ in range(50):
        state = rng.normal(size=(3, 3))
        turning(float(rng.uniform(0.0, 1e4)), rate, move)
        later = move @ state
        energies = [rate**2 * each[1] @ each[1] + each[2] @ each[2] for each in (state, later)]
        assert energies[1] == pytest.approx(energies[0], rel=1e-9)  # so that speeds are bounded


def test_the_rate_is_that_of_a_circle_bounded_and_none_for_what_stands_or_goes_straight() -> None:
    for seed in range(20):
        _, state = on_a_circle(0.08, 50.0, seed)
        slow = 16.0 / (16.0 + SLOW_M_S**2)  # what hardly moves has no turn: at 4 m/s that takes 1.5 %
        assert turn_rate(state) == pytest.approx(0.08 * slow)
    assert turn_rate(on_a_circle(5.0, 10.0, 0)[1]) == FASTEST_TURN_RAD_S
    assert turn_rate(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [3.0, 2.0, 1.0]])) == 0.0
    assert turn_rate(np.array([[9.0, 9.0, 9.0], [4.0, 2.0, 0.0], [2.0, 1.0, 0.0]])) == 0.0


@pytest.mark.parametrize("terms", [(1.5, -2.0, 0.25, 2), (-0.5, 1.0, -0.25, 1), (0.5, 0.0, -0.25, 1)])
def test_the_two_ways_to_a_turns_sums_agree(terms: tuple[float, float, float, int]) -> None:
    linear, single, double, first = terms
    for x in (0.5, 0.7, 0.9, 0.99, 1.0 - 1e-9, float(np.nextafter(1.0, 0.0))):  # by the series, below 1
        closed = (linear * x + single * math.sin(x) + double * math.sin(2.0 * x)) / x ** (2 * first + 1)
        assert _turned(x, *terms) == pytest.approx(closed, rel=1e-13 / x**5)  # what the closed form loses to rounding
    below, at_one = _turned(float(np.nextafter(1.0, 0.0)), *terms), _turned(1.0, *terms)
    assert below == pytest.approx(at_one, rel=1e-14)


# --- steady speed ----------------------------------------------------------------------------------------------------


def doubtful(rng: np.random.Generator) -> tuple[Array, Array]:
    """A mean that moves, and a covariance of any scales."""
    mean = rng.normal(size=(3, 3)) * np.array([[10.0], [4.0], [1.0]])
    scales = np.repeat(10.0 ** rng.uniform(-2.0, 4.0, 3) * np.array([1.0, 0.1, 0.01]), 3)
    root = rng.normal(size=(9, 9)) * scales[:, None]
    return mean, root @ root.T


def along(mean: Array) -> tuple[float, Array]:
    """The acceleration along the velocity, and its derivative, (9,), by the whole mean."""
    speed = float(np.linalg.norm(mean[1]))
    way = mean[1] / speed
    push = float(way @ mean[2])
    return push, np.concatenate((np.zeros(3), (mean[2] - push * way) / speed, way))


def test_the_slope_of_the_speed_s_change_is_its_derivative() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        mean, _ = doubtful(rng)
        steps = 1e-5 * np.eye(9).reshape(9, 3, 3)
        differences = [(along(mean + step)[0] - along(mean - step)[0]) / 2e-5 for step in steps]
        assert along(mean)[1] == pytest.approx(np.array(differences), rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("step_s", [1e-6, 0.01, 0.1, 1.0, 3600.0])
def test_steadying_is_the_update_by_a_linearised_measurement(step_s: float) -> None:
    rng = np.random.default_rng(11)
    taken = 0
    for _ in range(300):
        mean, covariance = doubtful(rng)
        before = mean.copy(), covariance.copy()
        steadied(mean, covariance, step_s)
        if np.linalg.norm(before[0][1]) < SLOW_M_S:
            assert np.array_equal(mean, before[0])
            assert np.array_equal(covariance, before[1])
            continue
        taken += 1
        push, slope = along(before[0])
        gain = before[1] @ slope / (slope @ before[1] @ slope + STEADY_M2_S3 / step_s)
        kept = np.eye(9) - np.outer(gain, slope)
        expected = kept @ before[1] @ kept.T + STEADY_M2_S3 / step_s * np.outer(gain, gain)
        unit = np.sqrt(np.diag(before[1]))  # of each row: tolerances are shares of what was doubtful
        assert (mean.ravel() + gain * push - before[0].ravel()) / unit == pytest.approx(np.zeros(9), abs=1e-10)
        assert covariance / np.outer(unit, unit) == pytest.approx(expected / np.outer(unit, unit), abs=1e-12)
        assert np.array_equal(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance / np.outer(unit, unit))[0] > 0.0
    assert taken > 250


def test_a_target_that_stands_and_a_step_of_no_time_steady_nothing() -> None:
    rng = np.random.default_rng(12)
    for speed_m_s, step_s in ((0.0, 0.1), (0.99 * SLOW_M_S, 0.1), (4.0, 0.0)):
        mean, covariance = doubtful(rng)
        mean[1] *= speed_m_s / np.linalg.norm(mean[1])
        again, spread = mean.copy(), covariance.copy()
        steadied(again, spread, step_s)
        assert np.array_equal(again, mean)
        assert np.array_equal(spread, covariance)


def test_two_half_steps_steady_as_much_as_one() -> None:
    rng = np.random.default_rng(13)
    for step_s in (0.01, 0.1, 1.0, 10.0):
        for _ in range(50):
            mean, covariance = doubtful(rng)
            mean[1] *= 1.0 + SLOW_M_S / np.linalg.norm(mean[1])
            mean[2] -= along(mean)[0] * mean[1] / np.linalg.norm(mean[1])  # steady: where slopes are taken stays
            once, twice = covariance.copy(), covariance.copy()
            steadied(mean, once, step_s)
            for _ in range(2):
                steadied(mean, twice, 0.5 * step_s)
            unit = np.sqrt(np.diag(covariance))
            assert twice / np.outer(unit, unit) == pytest.approx(once / np.outer(unit, unit), abs=1e-12)
            _, slope = along(mean)
            gained = 1.0 / (slope @ once @ slope) - 1.0 / (slope @ covariance @ slope)
            assert gained == pytest.approx(step_s / STEADY_M2_S3, rel=1e-6)


# --- updates ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("dynamics", "rate"), MOTIONS, ids=NAMES)
def test_the_covariance_stays_one(dynamics: Dynamics, rate: float) -> None:
    rng = np.random.default_rng(7)
    mean, covariance = np.zeros((dynamics.order, 3)), np.eye(3 * dynamics.order)
    steps_s = rng.choice([0.0, 1e-6, 0.01, 0.1, 30.0, 3600.0], p=[0.1, 0.1, 0.3, 0.498, 0.001, 0.001], size=100_000)
    roots_m = rng.choice([0.0, 0.5, 1000.0], p=[0.1, 0.8, 0.1], size=(100_000, 1, 1)) * rng.normal(size=(100_000, 3, 3))
    for k, (step_s, root_m) in enumerate(zip(steps_s, roots_m, strict=True)):
        mean, covariance = predict(mean, covariance, step_s, dynamics.density, dynamics.ease_s, rate)
        distance, _ = update(mean, covariance, np.zeros(3), root_m @ root_m.T)
        assert distance >= 0.0
        if k % 50 == 49:
            assert np.array_equal(covariance, covariance.T)
            assert np.linalg.eigvalsh(covariance)[0] > 0.0


@pytest.mark.parametrize("order", [2, 3])
def test_an_update_is_the_weighted_mean_of_what_is_known_and_what_is_seen(order: int) -> None:
    rng = np.random.default_rng(9)
    for _ in range(20):
        mean, root, seen_root = (rng.normal(size=shape) for shape in ((order, 3), (3 * order, 3 * order), (3, 3)))
        covariance, noise, position = root @ root.T, seen_root @ seen_root.T, rng.normal(size=3)
        look = np.eye(3, 3 * order)
        weight = np.linalg.inv(noise + FLOOR_M2 * np.eye(3))
        information = np.linalg.inv(covariance) + look.T @ weight @ look
        expected = np.linalg.solve(information, np.linalg.solve(covariance, mean.ravel()) + look.T @ weight @ position)
        gap = position - mean[0]
        far = gap @ np.linalg.solve(covariance[:3, :3] + noise + FLOOR_M2 * np.eye(3), gap)
        volume = np.linalg.slogdet(covariance[:3, :3] + noise + FLOOR_M2 * np.eye(3))[1]
        assert update(mean, covariance, position, noise) == pytest.approx((far, volume), rel=1e-6, abs=1e-9)
        assert mean.ravel() == pytest.approx(expected, rel=1e-5, abs=1e-6)
        assert covariance == pytest.approx(np.linalg.inv(information), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("sigma_m", [100.0, 1e3, 9.9e3])
def test_an_update_by_a_flat_covariance_is_right(sigma_m: float) -> None:
    for seed in range(200):
        rng = np.random.default_rng(seed)
        mean, root, way, gap = np.zeros((3, 3)), rng.normal(size=(9, 9)), rng.normal(size=3), rng.normal(size=3)
        covariance = 0.01 * root @ root.T
        noise = sigma_m**2 * np.outer(way, way) / (way @ way)
        values, vectors = np.linalg.eigh(covariance[:3, :3] + noise + FLOOR_M2 * np.eye(3))
        far = float(np.sum((vectors.T @ gap) ** 2 / values))
        distance, _ = update(mean, covariance, gap, noise)
        assert distance == pytest.approx(far, rel=1e-3)  # 1e8 / 1e-2 of 1e-16 is lost at most, and some more
        assert np.linalg.eigvalsh(covariance)[0] > 0.0
