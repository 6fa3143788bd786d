"""Several models at once: what is believed of a target is that of textbooks, and goes to the model that is right."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, multivariate_normal

from fg_gcs.core.arrays import Array
from fg_gcs.track.estimate.estimator import Estimator, Settings
from fg_gcs.track.estimate.imm import LEAST_WEIGHT, Belief, Prediction, carried_on, changes, filtered, merged
from fg_gcs.track.estimate.kalman import FLOOR_M2, Dynamics, predict, steadied, turn_rate, update
from tests.track.scenes import SIGMA_M, Motion, circle, dodging, known, seen, turns
from tests.track.test_kalman import FADING, TURNING, WHITE, stepped

BOTH = (TURNING, FADING)
LEAVING = np.array([1.0 / 30.0, 1.0 / 10.0])
STEPS_S = (0.0, 1e-6, 0.1, 1.0, 20.0)
ZERO = np.zeros(3)


class Taken(NamedTuple):
    """What a sighting led to."""

    belief: Belief
    distance: float


def table(dynamics: tuple[Dynamics, ...]) -> Array:
    return np.array([(each.density, each.ease_s) for each in dynamics])


def take(belief: Belief, dynamics: tuple[Dynamics, ...], step_s: float, position: Array, noise: Array) -> Taken:
    leaving = LEAVING[: len(dynamics)]
    *after, distance = filtered(*belief[:3], table(dynamics), leaving, step_s, position, noise)
    return Taken(Belief(*after), distance)


def believed(seed: int, count: int = 2, order: int = 3) -> Belief:
    """Models that disagree about a target at some metres a second, each by its own covariance."""
    rng = np.random.default_rng(seed)
    weights = rng.uniform(0.05, 1.0, count)
    size = np.array([[10.0], [4.0], [0.5]])[:order]
    means = size * rng.normal(size=(order, 3)) + 0.1 * size * rng.normal(size=(count, order, 3))
    roots = 0.1 * np.repeat(size[:, 0], 3)[:, None] * rng.normal(size=(count, 3 * order, 3 * order))
    return Belief(weights / weights.sum(), means, roots @ roots.swapaxes(1, 2), np.zeros(count))


def sighting(seed: int, belief: Belief) -> tuple[Array, Array]:
    rng = np.random.default_rng((seed, 1))
    root = rng.normal(size=(3, 3))
    return belief.means[0, 0] + rng.normal(size=3), root @ root.T


def plainly_merged(weights: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    rows = means.reshape(len(means), -1)
    mean = weights @ rows
    gaps = rows - mean
    covariance = np.einsum("b,bij->ij", weights, covariances) + np.einsum("b,bi,bj->ij", weights, gaps, gaps)
    return mean.reshape(means.shape[1:]), covariance


def plainly_filtered(belief: Belief, step_s: float, position: Array, noise: Array) -> Taken:
    """The same as in textbooks, by matrices, for both models [BlomBarShalom1988]_."""
    stays = expm(step_s * np.array([[-LEAVING[0], LEAVING[0]], [LEAVING[1], -LEAVING[1]]]))
    expected = belief.weights @ stays
    means, covariances, likely, distances, rates = [], [], [], [], []
    look = np.eye(3, 9)
    for b, dynamics in enumerate(BOTH):
        mean, covariance = plainly_merged(stays[:, b] * belief.weights / expected[b], belief.means, belief.covariances)
        small, driven = stepped(dynamics, step_s, turn_rate(mean) if turns(dynamics) else 0.0)
        move = np.kron(small, np.eye(3))
        mean, covariance = small @ mean, move @ covariance @ move.T + np.kron(driven, np.eye(3))
        spread = look @ covariance @ look.T + noise + FLOOR_M2 * np.eye(3)
        gap, gain = position - mean[0], covariance @ look.T @ np.linalg.inv(spread)
        likely.append(multivariate_normal(mean[0], spread).pdf(position))
        distances.append(float(gap @ np.linalg.solve(spread, gap)))
        mean, covariance = mean + (gain @ gap).reshape(3, 3), covariance - gain @ look @ covariance
        if turns(dynamics):
            steadied(mean, covariance, step_s)
        means.append(mean)
        covariances.append(covariance)
        rates.append(turn_rate(mean) if turns(dynamics) else 0.0)
    weights = expected * likely
    weights = np.maximum(weights / weights.sum(), LEAST_WEIGHT)
    after = Belief(weights / weights.sum(), np.stack(means), np.stack(covariances), np.array(rates))
    return Taken(after, min(distances))


def close(one: Belief, other: Belief, rel: float = 1e-9) -> None:
    for mine, yours in zip(one, other, strict=True):
        assert mine == pytest.approx(yours, rel=rel, abs=rel * float(np.abs(yours).max()))


# --- one sighting ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step_s", STEPS_S)
def test_a_sighting_is_taken_as_in_textbooks(step_s: float) -> None:
    for seed in range(50):
        belief = believed(seed)
        position, noise = sighting(seed, belief)
        mine, plain = take(belief, BOTH, step_s, position, noise), plainly_filtered(belief, step_s, position, noise)
        close(mine.belief, plain.belief, 1e-8)
        assert mine.distance == pytest.approx(plain.distance, rel=1e-8)


@pytest.mark.parametrize("dynamics", [WHITE, FADING, TURNING], ids=["white", "fading", "turning"])
@pytest.mark.parametrize("step_s", STEPS_S)
def test_one_model_alone_is_a_kalman_filter(dynamics: Dynamics, step_s: float) -> None:
    for seed in range(20):
        belief = believed(seed, 1, dynamics.order)
        position, noise = sighting(seed, belief)
        rate = turn_rate(belief.means[0]) if turns(dynamics) else 0.0
        mean, covariance = predict(
            belief.means[0], belief.covariances[0], step_s, dynamics.density, dynamics.ease_s, rate
        )
        distance, _ = update(mean, covariance, position, noise)
        if turns(dynamics):
            steadied(mean, covariance, step_s)
            rate = turn_rate(mean)
        taken = take(belief, (dynamics,), step_s, position, noise)
        close(taken.belief, Belief(np.ones(1), mean[None], covariance[None], np.array([rate])), 1e-12)
        assert taken.distance == pytest.approx(distance, rel=1e-12)


@pytest.mark.parametrize("dynamics", [WHITE, FADING, TURNING], ids=["white", "fading", "turning"])
def test_two_equal_models_are_one_and_their_weights_only_forget(dynamics: Dynamics) -> None:
    rng = np.random.default_rng(2)
    forgets = np.array([[-LEAVING[0], LEAVING[0]], [LEAVING[1], -LEAVING[1]]])
    for share in (1e-3, 0.2, 0.5, 0.999):
        single = believed(3, 1, dynamics.order)
        means, covariances = (np.concatenate([each, each]) for each in single[1:3])
        double = Belief(np.array([share, 1.0 - share]), means, covariances, np.zeros(2))
        for k in range(50):
            step_s = float(rng.choice(STEPS_S))
            position, noise = sighting(k, single)
            expected = double.weights @ expm(step_s * forgets)
            alone = take(single, (dynamics,), step_s, position, noise)
            paired = take(double, (dynamics, dynamics), step_s, position, noise)
            single, double = alone.belief, paired.belief
            assert double.weights == pytest.approx(expected, rel=1e-9)
            assert paired.distance == pytest.approx(alone.distance, rel=1e-6)
            for b in range(2):
                close(Belief(np.ones(1), *(each[b : b + 1] for each in double[1:])), single, 1e-6)


def test_a_turned_world_gives_a_turned_belief() -> None:
    for seed in range(20):
        belief = believed(seed)
        position, noise = sighting(seed, belief)
        turn = Rotation.random(random_state=seed).as_matrix()
        whole = np.kron(np.eye(3), turn)
        turned = belief._replace(means=belief.means @ turn.T, covariances=whole @ belief.covariances @ whole.T)
        plain = take(belief, BOTH, 0.3, position, noise)
        other = take(turned, BOTH, 0.3, turn @ position, turn @ noise @ turn.T)
        assert other.distance == pytest.approx(plain.distance, rel=1e-9)
        back = other.belief._replace(
            means=other.belief.means @ turn, covariances=whole.T @ other.belief.covariances @ whole
        )
        close(back, plain.belief)


def test_no_model_is_ever_ruled_out_and_weights_sum_to_one() -> None:
    for seed in range(200):
        rng = np.random.default_rng(seed)
        belief = believed(seed)
        belief.means[0, 0] += rng.choice([0.0, 3.0, 1e3, 1e5])  # of which one sighting says which is right
        for _ in range(5):
            position, noise = sighting(seed, belief._replace(means=belief.means[::-1]))
            belief = take(belief, BOTH, float(rng.choice(STEPS_S)), position, noise).belief
            assert belief.weights.sum() == pytest.approx(1.0, abs=1e-15)
            assert belief.weights.min() >= LEAST_WEIGHT / (1.0 + LEAST_WEIGHT) * (1.0 - 1e-12)


# --- many sightings --------------------------------------------------------------------------------------------------


def turning_weights(motion: Motion, seed: int) -> Array:
    """How much is believed in a steady turn, from 10 s on."""
    rng = np.random.default_rng(seed)
    estimator = Estimator(Settings())
    weights = []
    for k in range(600):
        estimator.add(seen(0.1 * k, motion(0.1 * k) + SIGMA_M * rng.normal(size=3)), 0.1 * k)
        if k >= 100:
            weights.append(known(estimator, 0.1 * k).belief.weights[0])
    return np.array(weights)


@pytest.mark.parametrize(
    ("motion", "least", "most"),
    [
        (lambda _: circle, 0.92, 0.96),
        (lambda _: lambda time_s: np.array([4.0 * time_s, 0.0, 10.0]), 0.92, 0.96),  # the widest turn of all
        (dodging, 0.18, 0.40),
    ],
    ids=["circle", "straight", "dodging"],
)
def test_weights_go_to_the_model_that_is_right(motion: Callable[[int], Motion], least: float, most: float) -> None:
    for seed in range(8):
        weights = turning_weights(motion(seed), seed)
        assert least < weights.mean() < most
        assert (np.median(weights) > 0.5) == (least > 0.5)


def test_numbers_that_are_hostile_leave_a_belief_that_is_one() -> None:
    gate = float(chi2.ppf(0.999, df=3))  # as the estimator's: what is farther away is looked at, but not taken
    taken = 0
    for seed in range(500):
        rng = np.random.default_rng(seed)
        far = rng.choice([0.0, 1e4, 1e7]) * rng.normal(size=3)
        means, covariances = np.zeros((2, 3, 3)), np.stack([np.diag([0.25] * 3 + [56.0] * 3 + [0.09] * 3)] * 2)
        means[:, 0] = far
        belief = Belief(np.array([0.75, 0.25]), means, covariances, np.zeros(2))
        for _ in range(30):
            root = rng.normal(size=(3, 3)) * (np.arange(3) < rng.integers(1, 4))
            noise = root @ root.T * rng.choice([0.0, 0.5, 100.0, 1e4]) ** 2
            noise *= min(1.0, 1e8 / max(float(np.abs(noise).max()), 1.0))
            position = far + rng.choice([0.0, 1.0, 100.0, 1e7]) * rng.normal(size=3)
            step_s = float(rng.choice([0.0, 1e-6, 0.1, 0.1, 30.0, 3600.0]))
            after, distance = take(belief, BOTH, step_s, position, noise)
            assert 0.0 <= distance < math.inf
            assert all(np.isfinite(each).all() for each in after)
            assert after.weights.sum() == pytest.approx(1.0, abs=1e-15)
            if distance <= gate:
                belief = after
                taken += 1
                for covariance in belief.covariances:
                    assert np.array_equal(covariance, covariance.T)
                    assert np.linalg.eigvalsh(covariance)[0] > 0.0
    assert taken > 5000


# --- what is believed without a sighting -----------------------------------------------------------------------------


def test_a_mixture_has_the_moments_of_its_parts() -> None:
    for seed in range(50):
        belief = believed(seed, 1 + seed % 3, 2 + seed % 2)
        mean, covariance = merged(belief.weights, belief.weights, belief.means, belief.covariances)
        plain_mean, plain_covariance = plainly_merged(*belief[:3])
        assert mean == pytest.approx(plain_mean, rel=1e-12)
        assert covariance == pytest.approx(plain_covariance, rel=1e-12, abs=1e-12)


def test_doubts_move_the_covariance_but_not_the_mean() -> None:
    for seed in range(50):
        belief, doubts = believed(seed), np.random.default_rng(seed).dirichlet([1.0, 1.0])
        mean, covariance = merged(belief.weights, doubts, belief.means, belief.covariances)
        gaps = belief.means.reshape(2, -1) - mean.ravel()
        plain = np.einsum("b,bij->ij", doubts, belief.covariances) + np.einsum("b,bi,bj->ij", doubts, gaps, gaps)
        assert mean == pytest.approx(plainly_merged(*belief[:3])[0], rel=1e-12)
        assert covariance == pytest.approx(plain, rel=1e-12, abs=1e-12)


def test_changes_are_those_of_a_markov_chain() -> None:
    rates = np.array([[-LEAVING[0], LEAVING[0]], [LEAVING[1], -LEAVING[1]]])
    for step_s in (*STEPS_S, 1e4):
        assert changes(LEAVING, step_s) == pytest.approx(expm(step_s * rates), abs=1e-12)
    assert np.array_equal(changes(LEAVING[:1], 5.0), np.eye(1))


def test_each_model_is_carried_on_by_itself() -> None:
    rates = np.array([0.2, 0.0])
    for seed in range(20):
        for step_s in STEPS_S:
            belief = believed(seed)
            means, covariances = carried_on(belief.means, belief.covariances, rates, table(BOTH), step_s)
            half = carried_on(belief.means, belief.covariances, rates, table(BOTH), 0.5 * step_s)
            again = carried_on(*half, rates, table(BOTH), 0.5 * step_s)
            for b, dynamics in enumerate(BOTH):
                mean, covariance = belief.means[b], belief.covariances[b]
                alone = predict(mean, covariance, step_s, dynamics.density, dynamics.ease_s, rates[b])
                for mine, plain, twice in zip(
                    (means[b], covariances[b]), alone, (again[0][b], again[1][b]), strict=True
                ):
                    assert mine == pytest.approx(plain, rel=1e-12)
                    assert twice == pytest.approx(plain, rel=1e-9, abs=1e-9 * float(np.abs(plain).max()))


def going(seed: int, time_s: float = 10.0) -> Prediction:
    """A turn, a fading acceleration, and steady motion."""
    belief = believed(seed, 3)
    eases, rates = (
        np.array([math.inf, 4.0, 1.0]),
        np.array([np.random.default_rng(seed).choice([0.0, 0.08, 1.0]), 0, 0]),
    )
    belief.means[2, 2] = 0.0
    return Prediction(time_s, belief.weights, belief.means, eases, rates)


def test_a_prediction_begins_with_its_mean_and_is_that_of_each_model() -> None:
    for seed in range(20):
        prediction = going(seed)
        start = np.einsum("b,bij->ij", prediction.weights, prediction.means)
        for time_s in (-math.inf, 0.0, 10.0):
            assert prediction.at(time_s) == pytest.approx(start)
        for ahead_s in (1e-3, 0.7, 8.0, 60.0):
            moved = np.zeros((3, 3))
            for b, dynamics in enumerate((TURNING, FADING, Dynamics(3, 1.0, 1.0))):
                moved += (
                    prediction.weights[b]
                    * stepped(dynamics, ahead_s, prediction.rates_rad_s[b])[0]
                    @ prediction.means[b]
                )
            assert prediction.at(10.0 + ahead_s) == pytest.approx(moved, rel=1e-9, abs=1e-9)


def test_velocities_and_accelerations_are_derivatives() -> None:
    step_s = 1e-4
    for seed in range(20):
        prediction = going(seed)
        for time_s in (10.1, 11.0, 13.0, 18.0, 40.0):
            before, there, after = (prediction.at(time_s + shift_s) for shift_s in (-step_s, 0.0, step_s))
            # differences of order two: what the third derivative, below 20 m/s^3, leaves is below 1e-7
            assert (after[:2] - before[:2]) / (2.0 * step_s) == pytest.approx(there[1:], rel=1e-6, abs=1e-6)


def test_the_centre_of_several_is_the_mean_of_their_ways() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        parts = [going(100 * seed + k) for k in range(1 + seed % 4)]
        shares = rng.uniform(0.1, 1.0, len(parts))
        shares /= shares.sum()
        centre = Prediction.centre(shares.tolist(), parts)
        assert centre.weights.sum() == pytest.approx(1.0)
        for time_s in (5.0, 10.0, 10.6, 18.0, 70.0):
            mean = np.einsum("c,cij->ij", shares, np.stack([part.at(time_s) for part in parts]))
            assert centre.at(time_s) == pytest.approx(mean)
    with pytest.raises(ValueError, match="zip"):
        Prediction.centre([0.5, 0.5], parts[:1])


def test_straight_motion_goes_straight() -> None:
    place, velocity = np.array([1.0, -2.0, 3.0]), np.array([4.0, 0.5, -0.1])
    prediction = Prediction.straight(5.0, place, velocity)
    for ahead_s in (0.0, 0.1, 8.0, 1000.0):
        assert prediction.at(5.0 + ahead_s) == pytest.approx(np.stack((place + ahead_s * velocity, velocity, ZERO)))
