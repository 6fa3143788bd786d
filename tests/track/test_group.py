from __future__ import annotations

import math

import numpy as np
import pytest

from fg_gcs.core.formation import hemisphere
from fg_gcs.errors import PlanError
from fg_gcs.plan.targets import uncertain
from fg_gcs.track.estimate.estimator import Estimate, Settings
from fg_gcs.track.estimate.group import Group, GroupEstimate, needed_scale
from fg_gcs.track.estimate.imm import Belief

LOST_S = 1.0
MOST_M = 30.0


def estimate(seed: int, time_s: float = 10.0, age_s: float = 0.1) -> Estimate:
    """Of a target that turns, or not: the models disagree a little."""
    rng = np.random.default_rng(seed)
    root = 0.3 * rng.normal(size=(9, 9))
    position, velocity, acceleration = 5.0 * rng.normal(size=3), rng.normal(size=3), 0.1 * rng.normal(size=3)
    means = np.stack((position, velocity, acceleration)) + 0.1 * rng.normal(size=(2, 3, 3))
    share = rng.uniform(0.1, 0.9)
    belief = Belief(np.array([share, 1.0 - share]), means, np.stack([root @ root.T] * 2), np.array([0.1, 0.0]))
    return Estimate.of(time_s, belief, age_s, Settings().dynamics)


def group(*names: str, **weights: float) -> Group:
    return Group({**dict.fromkeys(names, 1.0), **weights}, LOST_S, MOST_M)


def at(of: Group, time_s: float, **estimates: Estimate | None) -> GroupEstimate:
    found = of.at(time_s, estimates)
    assert found is not None
    return found


def own_m(one: Estimate) -> float:
    return uncertain(np.zeros(3), one.covariance[:3, :3], 0.95).radius_m


def test_one_target_that_is_seen_is_a_point() -> None:
    one = estimate(1)
    found = at(group("boat"), 10.3, boat=one)
    there = one.predicted(10.3)
    assert np.array_equal(found.position_enu_m, there.position_enu_m)
    assert np.array_equal(found.velocity_m_s, there.velocity_m_s)
    assert found.prediction.time_s == 10.3
    for time_s in (10.3, 11.0, 18.0):
        assert found.prediction.at(time_s) == pytest.approx(one.prediction.at(time_s))
    assert (found.time_s, found.radius_m, found.lost, found.unseen, found.bounded) == (10.3, 0.0, (), (), False)
    assert found.age_s == pytest.approx(0.4)


def test_one_lost_target_grows_to_the_bound_and_stays_there() -> None:
    one = estimate(2)
    single = group("boat")
    radii = []
    for time_s in np.arange(10.0, 60.0, 0.25):
        found = at(single, time_s, boat=one)
        assert bool(found.lost) == (found.age_s > LOST_S)
        if found.lost:
            wanted_m = own_m(one.predicted(time_s))
            assert found.radius_m == pytest.approx(min(wanted_m, MOST_M))
            assert found.bounded == (wanted_m > MOST_M)
            radii.append(found.radius_m)
        else:
            assert found.radius_m == 0.0
    assert (np.diff(radii) >= 0.0).all()
    assert radii[0] < MOST_M
    assert radii[-1] == MOST_M


@pytest.mark.parametrize("seed", range(20))
def test_several_targets_are_inside_the_ball_around_their_weighted_centre(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [f"boat{k}" for k in range(2 + seed % 4)]
    weights = {name: float(rng.uniform(0.5, 3.0)) for name in names}
    estimates = {name: estimate(100 * seed + k, 10.0 + 0.1 * k) for k, name in enumerate(names)}
    found = at(group(**weights), 10.5, **estimates)
    there = {name: each.predicted(10.5) for name, each in estimates.items()}
    total = sum(weights.values())
    for mine, field in ((found.position_enu_m, "position_enu_m"), (found.velocity_m_s, "velocity_m_s")):
        mean = sum((weights[name] * getattr(there[name], field) for name in names), np.zeros(3)) / total
        assert mine == pytest.approx(mean)
    for time_s in (10.5, 11.0, 18.0):
        ways = [weights[name] * estimates[name].prediction.at(time_s) for name in names]
        assert found.prediction.at(time_s) == pytest.approx(sum(ways, np.zeros((3, 3))) / total)
    reaches_m = [
        float(np.linalg.norm(each.position_enu_m - found.position_enu_m)) + own_m(each) for each in there.values()
    ]
    assert found.radius_m == pytest.approx(max(reaches_m))
    assert found.age_s == pytest.approx(max(each.age_s for each in there.values()))


def test_order_and_size_of_weights_change_nothing() -> None:
    one, other = estimate(3), estimate(4)
    plain = at(group(boat=1.0, car=2.0), 10.5, boat=one, car=other)
    for again in (
        at(group(car=2e307, boat=1e307), 10.5, boat=one, car=other),
        at(group(boat=1.0, car=2.0), 10.5, car=other, boat=one),
    ):
        assert again.position_enu_m == pytest.approx(plain.position_enu_m)
        assert again.radius_m == pytest.approx(plain.radius_m)


def test_targets_that_were_never_seen_are_told_and_do_not_count() -> None:
    of = group("boat", "car", "van")
    assert of.at(10.0, {}) is None
    assert of.at(10.0, {"boat": None, "ship": estimate(5)}) is None
    found = at(of, 10.0, boat=estimate(6), car=None, ship=estimate(5))
    assert found.unseen == ("car", "van")
    assert np.array_equal(found.position_enu_m, estimate(6).position_enu_m)
    assert found.radius_m == pytest.approx(own_m(estimate(6)))


def test_lost_ones_are_named_and_still_count() -> None:
    fresh, stale = estimate(7), estimate(8, age_s=2.0)
    found = at(group("boat", "car"), 10.0, boat=stale, car=fresh)
    assert found.lost == ("boat",)
    assert found.position_enu_m == pytest.approx(0.5 * (fresh.position_enu_m + stale.position_enu_m))


def test_the_scale_fits_the_ball_and_its_clearance_into_the_face() -> None:
    formation = hemisphere(5, 6, 3.0)
    inscribed_m = formation.inscribed_radius_m
    for radius_m in (0.1, 2.0, 20.0):
        scale = needed_scale(inscribed_m, radius_m, 1.5, 1.0)
        assert scale >= 1.5
        assert scale * inscribed_m >= radius_m + 1.0 - 1e-12
        assert scale == 1.5 or scale * inscribed_m == pytest.approx(radius_m + 1.0)
    assert needed_scale(inscribed_m, 0.0, 1.5, 1.0) == 1.5
    assert needed_scale(0.0, 0.0) == 1.0
    with pytest.raises(PlanError, match="no circle"):
        needed_scale(0.0, 1.0)


@pytest.mark.parametrize(
    ("weights", "lost_after_s", "most_m", "confidence"),
    [
        ({}, 1.0, 1.0, 0.95),
        ({"boat": 0.0}, 1.0, 1.0, 0.95),
        ({"boat": math.nan}, 1.0, 1.0, 0.95),
        ({"boat": math.inf}, 1.0, 1.0, 0.95),
        ({"boat": 1.0}, 0.0, 1.0, 0.95),
        ({"boat": 1.0}, 1.0, -1.0, 0.95),
        ({"boat": 1.0}, 1.0, math.inf, 0.95),
        ({"boat": 1.0}, 1.0, 1.0, 1.0),
    ],
)
def test_groups_that_make_no_sense_are_refused(
    weights: dict[str, float], lost_after_s: float, most_m: float, confidence: float
) -> None:
    with pytest.raises(PlanError):
        Group(weights, lost_after_s, most_m, confidence)
