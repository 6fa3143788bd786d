from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fg_gcs.errors import PlanError
from fg_gcs.track.estimate.estimator import MOST_KEPT, OLDEST_S, Estimator, Model, Settings
from fg_gcs.track.sightings import Sighting, Verdict
from tests.track.scenes import DELAY_S, MODELS, SIGMA_M, circle, known, same, seen, turns


@pytest.mark.parametrize("model", MODELS)
def test_a_predicted_prediction_is_a_prediction(model: Model) -> None:
    rng = np.random.default_rng(4)
    estimator = Estimator(Settings(model=model))
    for k in range(50):
        estimator.add(seen(0.1 * k, circle(0.1 * k) + SIGMA_M * rng.normal(size=3)), 5.0)
    first = known(estimator, 5.0)
    for ahead_s in (0.0, 0.4, 3.0, 40.0):
        through, at_once = first.predicted(5.0 + ahead_s), known(estimator, 5.0 + ahead_s)
        for one, other in zip((*through[:6], *through.belief), (*at_once[:6], *at_once.belief), strict=True):
            assert np.asarray(one) == pytest.approx(np.asarray(other), rel=1e-9, abs=1e-9)
        moved = np.stack((through.position_enu_m, through.velocity_m_s, through.acceleration_m_s2))
        assert first.prediction.at(5.0 + ahead_s) == pytest.approx(moved, rel=1e-9, abs=1e-9)
    assert first.predicted(3.0).time_s == first.time_s


@pytest.mark.parametrize("model", MODELS)
def test_what_is_predicted_for_ever_has_a_bounded_speed(model: Model) -> None:
    rng = np.random.default_rng(4)
    estimator = Estimator(Settings(model=model))
    for k in range(50):
        estimator.add(seen(0.1 * k, circle(0.1 * k) + SIGMA_M * rng.normal(size=3)), 5.0)
    first = known(estimator, 5.0)
    late = first.predicted(1e4)
    for b, dynamics in enumerate(first.dynamics):
        before, after, rate = first.belief.means[b], late.belief.means[b], first.belief.rates_rad_s[b]
        if turns(dynamics):
            assert rate > 0.01
            assert np.linalg.norm(after[1]) <= np.linalg.norm(before[1]) + np.linalg.norm(before[2]) / rate
        elif dynamics.order == 3:
            assert after[1] == pytest.approx(before[1] + 4.0 * before[2])
            assert np.abs(after[2]).max() < 1e-9
        else:
            assert after[1] == pytest.approx(before[1])


# --- order of arrival ------------------------------------------------------------------------------------------------


def eventful(seed: int) -> list[Sighting]:
    """Six seconds with two sightings in some stamps, wild ones, and a jump."""
    rng = np.random.default_rng(seed)
    sightings = []
    for k in range(60):
        for _ in range(1 + (k % 10 == 0)):
            wild = 20.0 * (rng.random() < 0.1) + (60.0 if k > 30 else 0.0)
            sightings.append(seen(0.1 * k, circle(0.1 * k) + wild + SIGMA_M * rng.normal(size=3)))
    return sightings


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", range(10))
def test_any_order_of_arrival_gives_the_same(model: Model, seed: int) -> None:
    sightings = eventful(seed)
    rng = np.random.default_rng(seed)
    in_order, shuffled, delayed = (Estimator(Settings(model, history_s=span)) for span in (100.0, 100.0, 2.0))
    for sighting in sightings:
        in_order.add(sighting, 10.0)
    for index in rng.permutation(len(sightings)):
        shuffled.add(sightings[index], 10.0)
    for sighting in sorted(sightings, key=lambda each: each.time_s + float(rng.uniform(0.0, 1.9))):
        assert delayed.add(sighting, 10.0) is not Verdict.TOO_OLD
    for time_s in (4.5, 5.0, 6.0, 8.0):
        same(known(shuffled, time_s), known(in_order, time_s))
        same(known(delayed, time_s), known(in_order, time_s))
    for time_s in (-0.1, 0.1, 0.3, 2.0):
        one, other = shuffled.at(time_s), in_order.at(time_s)
        assert (one is None) == (other is None)
        if one is not None and other is not None:
            same(one, other)


def test_late_sightings_count_for_the_past_only_as_far_as_the_history_goes() -> None:
    estimator = Estimator(Settings(history_s=2.0))
    for k in range(50):
        assert estimator.add(seen(0.1 * k, circle(0.1 * k)), 5.0) in (Verdict.TENTATIVE, Verdict.TAKEN)
    before = known(estimator, 5.0)
    assert estimator.add(seen(2.8, circle(2.8)), 5.0) is Verdict.TOO_OLD
    same(known(estimator, 5.0), before)
    assert estimator.add(seen(2.95, circle(2.95) + 0.1), 5.0) is Verdict.TAKEN
    assert not np.array_equal(known(estimator, 5.0).position_enu_m, before.position_enu_m)
    assert known(estimator, 5.0).age_s == pytest.approx(0.1)
    assert known(estimator, 4.0).age_s == pytest.approx(0.0, abs=1e-9)


# --- wild, lost and refused ------------------------------------------------------------------------------------------


def test_there_is_no_estimate_before_sightings_agree() -> None:
    for wild in range(3):  # the first, second or third sighting is far away from the others
        estimator = Estimator(Settings())
        for k in range(4):
            assert estimator.at(0.1 * k) is None
            assert estimator.lost(0.1 * k)
            verdict = estimator.add(seen(0.1 * k, [200.0 * (k == wild), 1.0, 2.0]), 0.1 * k)
            assert verdict is (Verdict.TAKEN if k == 3 else Verdict.TENTATIVE)
        assert known(estimator, 0.4).position_enu_m == pytest.approx([0.0, 1.0, 2.0])
        assert not estimator.lost(0.4)


def test_a_new_track_believes_in_each_model_as_long_as_that_lasts() -> None:
    estimator = Estimator(Settings(steady_s=35.0, unsteady_s=5.0, agreeing_first=1))
    assert estimator.add(seen(0.0, [0.0, 1.0, 2.0]), 0.0) is Verdict.TAKEN
    assert known(estimator, 0.0).belief.weights == pytest.approx([0.875, 0.125])
    assert known(estimator, 3.0).belief.weights == pytest.approx([0.875, 0.125])


@pytest.mark.parametrize("jump_m", [8.0, 20.0, 500.0])
def test_a_target_that_jumped_is_found_again(jump_m: float) -> None:
    rng = np.random.default_rng(int(jump_m))
    estimator = Estimator(Settings())
    for k in range(100):
        time_s = 0.1 * k
        there = circle(time_s) + (jump_m if k >= 50 else 0.0)
        if k == 52:  # a wild one between those that agree
            there = there - 3.0 * jump_m
        estimator.add(seen(time_s, there + SIGMA_M * rng.normal(size=3)), time_s)
        if k >= 56:
            assert np.linalg.norm(known(estimator, time_s).position_enu_m - there) < 2.0
        if k >= 80:
            assert np.linalg.norm(known(estimator, time_s).position_enu_m - there) < 1.0


def test_a_target_that_turns_back_at_once_is_followed() -> None:
    rng = np.random.default_rng(8)
    estimator = Estimator(Settings())
    squares = []
    for k in range(150):
        time_s = 0.1 * k
        there = np.array([4.0 * (time_s if k < 80 else 16.0 - time_s), 0.0, 10.0])
        estimator.add(seen(time_s, there + SIGMA_M * rng.normal(size=3)), time_s)
        if k >= 110:
            squares.append(float(np.sum((known(estimator, time_s).position_enu_m - there) ** 2)))
    assert math.sqrt(np.mean(squares)) < 1.0


def test_a_lost_target_is_predicted_and_found_again_at_once() -> None:
    errors = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        estimator = Estimator(Settings())
        for k in range(250):
            time_s = 0.1 * k
            if 100 <= k < 180:
                assert estimator.lost(time_s) == (k > 109)
                continue
            verdict = estimator.add(seen(time_s, circle(time_s) + SIGMA_M * rng.normal(size=3)), time_s + DELAY_S)
            if k == 180:
                assert verdict is Verdict.TAKEN
                assert not estimator.lost(time_s)
            if 180 <= k < 210:
                now_s = time_s + DELAY_S
                errors.append(known(estimator, now_s).position_enu_m - circle(now_s))
        at_loss, later = known(estimator, 24.9), known(estimator, 33.0)
        growth = np.linalg.eigvalsh(later.covariance[:3, :3] - at_loss.covariance[:3, :3])
        assert growth[0] > 0.0
    assert math.sqrt(np.mean(np.sum(np.array(errors) ** 2, axis=1))) < 1.0


def test_each_refusal_has_its_reason() -> None:
    good = seen(99.0, [1.0, 2.0, 3.0])
    lopsided = np.eye(3)
    lopsided[0, 1] = 0.1
    cases = [
        (good, Verdict.TENTATIVE),
        (good, Verdict.DUPLICATE),
        (good._replace(position_enu_m=np.zeros(2)), Verdict.MALFORMED),
        (good._replace(covariance_m2=np.eye(2)), Verdict.MALFORMED),
        (good._replace(position_enu_m=np.array([0.0, np.nan, 0.0])), Verdict.NOT_FINITE),
        (good._replace(time_s=math.inf), Verdict.NOT_FINITE),
        (good._replace(covariance_m2=np.full((3, 3), np.nan)), Verdict.BAD_COVARIANCE),
        (good._replace(covariance_m2=np.diag([1.0, 1.0, np.inf])), Verdict.BAD_COVARIANCE),
        (good._replace(covariance_m2=np.diag([1.0, 1.0, -1.0])), Verdict.BAD_COVARIANCE),
        (good._replace(covariance_m2=np.diag([1.0, 1.0, 1e9])), Verdict.BAD_COVARIANCE),
        (good._replace(covariance_m2=lopsided), Verdict.BAD_COVARIANCE),
        (good._replace(time_s=100.04), Verdict.TENTATIVE),
        (good._replace(time_s=100.06), Verdict.FUTURE),
        (good._replace(time_s=98.0), Verdict.TOO_OLD),
        (good._replace(time_s=100.0 - 1.01 * OLDEST_S), Verdict.TOO_OLD),
        (good._replace(position_enu_m=np.array([61.0, 0.0, 0.0])), Verdict.FAR),
        (good._replace(position_enu_m=np.array([1e300, 0.0, 0.0])), Verdict.FAR),
        (good._replace(position_enu_m=np.array([59.0, 0.0, 0.0])), Verdict.TENTATIVE),
        (good._replace(time_s=99.5), Verdict.TENTATIVE),  # with which the one at 100.04 s begins the track
        (good._replace(time_s=100.05), Verdict.TAKEN),
        (good._replace(time_s=100.05, position_enu_m=np.array([40.0, 0.0, 0.0])), Verdict.GATED),
    ]
    estimator = Estimator(Settings(centre_enu_m=(10.0, 0.0, 0.0), reach_m=50.0, history_s=2.0))
    for sighting, verdict in cases:
        assert estimator.add(sighting, 100.0) is verdict, sighting
    assert sum(estimator.counts.values()) == len(cases)
    assert all(estimator.counts[verdict] == [v for _, v in cases].count(verdict) for verdict in Verdict)


def test_a_flood_is_bounded_and_passes() -> None:
    estimator = Estimator(Settings())
    verdicts = [estimator.add(seen(1.0 + 1e-4 * k, [0.0, 0.0, 1e-6 * k]), 2.0) for k in range(MOST_KEPT + 50)]
    assert verdicts[MOST_KEPT:] == [Verdict.FLOOD] * 50
    assert Verdict.FLOOD not in verdicts[:MOST_KEPT]
    assert estimator.add(seen(3.5, [0.0, 0.0, 0.0]), 3.5) is Verdict.TAKEN


def test_a_caller_may_write_to_its_own_arrays() -> None:
    estimator, other = Estimator(Settings()), Estimator(Settings())
    position, covariance = np.zeros(3), np.eye(3)
    for k in range(10):
        position[0] = 0.1 * k
        estimator.add(Sighting("boat", 0.1 * k, position, covariance, 0.1 * k), 1.0)
        other.add(Sighting("boat", 0.1 * k, position.copy(), covariance, 0.1 * k), 1.0)
    for each in (estimator, other):
        each.add(Sighting("boat", 0.05, np.full(3, 0.05), covariance, 1.0), 1.0)
    same(known(estimator, 1.0), known(other, 1.0))


numbers = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-100.0, 100.0)


@given(st.lists(st.tuples(numbers, *[numbers] * 3, *[numbers] * 3), max_size=12))
@settings(max_examples=200, deadline=None)
def test_numbers_never_raise_nor_leave_an_estimate_that_is_not_finite(rows: list[tuple[float, ...]]) -> None:
    estimator = Estimator(Settings(agreeing_first=1))
    for time_s, *rest in rows:
        sighting = Sighting("boat", time_s, np.array(rest[:3]), np.diag(rest[3:]), 100.0)
        estimator.add(sighting, 100.0)
    estimate = estimator.at(200.0)
    if estimate is not None:
        assert np.isfinite(estimate.position_enu_m).all()
        assert np.linalg.eigvalsh(estimate.covariance)[0] > 0.0


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"confidence": 1.0}, "confidence"),
        ({"ease_s": 0.0}, "ease_s"),
        ({"history_s": math.inf}, "history_s"),
        ({"reach_m": math.nan}, "reach_m"),
        ({"agreeing_first": 0}, "agreeing_first"),
        ({"centre_enu_m": (0.0, math.nan, 0.0)}, "centre_enu_m"),
        ({"model": "jerk"}, "mixed, velocity, acceleration"),
        ({"turning_m2_s5": 0.0}, "turning_m2_s5"),
        ({"steady_s": math.inf}, "steady_s"),
        ({"unsteady_s": -1.0}, "unsteady_s"),
    ],
)
def test_settings_that_no_filter_can_work_with_are_refused(wrong: dict[str, Any], word: str) -> None:
    with pytest.raises(PlanError, match=word):
        Settings(**wrong)


def test_the_velocity_model_knows_no_acceleration() -> None:
    estimator = Estimator(Settings(model="velocity"))
    for k in range(20):
        estimator.add(seen(0.1 * k, circle(0.1 * k)), 2.0)
    estimate = known(estimator, 2.0)
    assert estimate.covariance.shape == (6, 6)
    assert not estimate.acceleration_m_s2.any()
    assert not estimate.prediction.at(5.0)[2].any()
    assert np.linalg.norm(estimate.velocity_m_s) == pytest.approx(4.0, rel=0.1)


def test_what_is_wild_across_a_flat_covariance_is_gated() -> None:
    for seed in range(50):
        rng = np.random.default_rng(seed)
        estimator = Estimator(Settings())
        for k in range(40):
            estimator.add(seen(0.1 * k, circle(0.1 * k) + SIGMA_M * rng.normal(size=3)), 0.1 * k)
        way = rng.normal(size=3)
        across = np.cross(way, rng.normal(size=3))
        wild = circle(4.0) + 100.0 * across / np.linalg.norm(across)
        noise = 9.9e3**2 * np.outer(way, way) / (way @ way)
        assert estimator.add(Sighting("boat", 4.0, wild, noise, 4.0), 4.0) is Verdict.GATED
        assert np.linalg.norm(known(estimator, 4.0).position_enu_m - circle(4.0)) < 1.0


def test_flat_covariances_never_raise_nor_leave_what_is_no_number() -> None:
    for seed in range(1000):
        rng = np.random.default_rng(seed)
        estimator, time_s = Estimator(Settings(agreeing_first=1)), 0.0
        for _ in range(12):
            way = rng.choice([-1.0, 0.0, 1.0, 1.0, 0.5, rng.normal()], size=3)
            noise = np.outer(way, way) * rng.choice([0.0, 1e2, 1e6, 9e7])
            noise *= min(1.0, 1e8 / max(float(np.abs(noise).max()), 1.0))
            time_s += float(rng.choice([0.0, 0.0, 0.1, 30.0, 3600.0]))
            position = rng.normal(size=3) * rng.choice([0.0, 1.0, 1e3])
            estimator.add(Sighting("boat", time_s, position, noise, time_s), time_s)
            estimate = estimator.at(time_s)
            if estimate is not None:
                assert np.isfinite(estimate.position_enu_m).all()
                assert np.linalg.eigvalsh(estimate.covariance)[0] > 0.0
