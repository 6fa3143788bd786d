from __future__ import annotations

import numpy as np
import pytest

from fg_gcs.core import solid_angle
from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Formation, Pose, hemisphere
from fg_gcs.errors import PlanError
from fg_gcs.plan.targets import Charges, Target, centre_of_charge, uncertain

RIM_FORMATION = hemisphere(5, 0, 4.0)
RIM = RIM_FORMATION.leaders_m


def test_one_charge_has_the_flux_of_a_point_whatever_its_weight() -> None:
    place = np.array([3.0, 1.0, -2.0])
    for weight in (1e-3, 1.0, 70.0):
        charge = Charges(place[None], np.array([weight]))
        assert charge.flux(RIM) == pytest.approx(float(solid_angle.flux(RIM, place)), rel=1e-12)


def test_fluxes_add_by_weight_and_the_gradient_is_theirs() -> None:
    for seed in range(20):
        draw = np.random.default_rng(seed)
        positions, weights = draw.normal(size=(4, 3)) * 8, draw.uniform(0.1, 3.0, 4)
        charges = Charges(positions, weights)
        each = [float(solid_angle.flux(RIM, position)) for position in positions]
        assert charges.flux(RIM) == pytest.approx(float(weights @ each / weights.sum()))
        assert Charges(positions, 7.0 * weights).flux(RIM) == pytest.approx(charges.flux(RIM))
        way = draw.normal(size=RIM.shape)
        slope = (charges.flux(RIM + 1e-6 * way) - charges.flux(RIM - 1e-6 * way)) / 2e-6
        assert float((charges.gradient(RIM) * way).sum()) == pytest.approx(slope, rel=1e-5, abs=1e-7)


def test_the_charges_cannot_be_changed_from_outside() -> None:
    positions = np.ones((2, 3))
    charges = Charges(positions, np.ones(2))
    positions[:] = 0.0
    assert (charges.positions_enu_m == 1.0).all()
    with pytest.raises(ValueError, match="read-only"):
        charges.weights[0] = 2.0


def test_the_centre_of_charge_has_the_papers_square_with_every_target_inside_its_circle() -> None:
    for seed in range(50):
        positions = np.random.default_rng(seed).normal(200.0, 100.0, (10, 3))
        target = centre_of_charge(positions)
        distances = np.linalg.norm(positions - target.centre_enu_m, axis=1)
        edge = 2.0 * target.radius_m  # of the square around the circle
        assert target.centre_enu_m == pytest.approx(positions.mean(axis=0))
        assert edge == pytest.approx((2.0 * distances.max() + 10.0) / np.sqrt(2.0))
        assert distances.max() < edge / np.sqrt(2.0)


def test_a_single_target_keeps_the_clearance() -> None:
    assert 2.0 * centre_of_charge([[1.0, 2.0, 3.0]]).radius_m == pytest.approx(10.0 / np.sqrt(2.0))


def test_heavier_targets_pull_the_centre_and_the_furthest_one_sets_the_size() -> None:
    positions, weights = np.array([(0.0, 0.0, 0.0), (8.0, 0.0, 0.0)]), [3.0, 1.0]
    target = centre_of_charge(positions, weights)
    assert target.centre_enu_m.tolist() == [2.0, 0.0, 0.0]
    assert 2.0 * target.radius_m == pytest.approx((2.0 * 6.0 + 10.0) / np.sqrt(2.0))
    assert len(target.sources.positions_enu_m) == 1
    doubled = centre_of_charge([positions[0]] * 3 + [positions[1]])
    assert (doubled.centre_enu_m.tolist(), doubled.radius_m) == (target.centre_enu_m.tolist(), target.radius_m)


def test_one_source_is_a_point_and_several_are_charges() -> None:
    point = Target.ball((1.0, 2.0, 3.0)).source
    assert isinstance(point, np.ndarray)
    assert point.tolist() == [1.0, 2.0, 3.0]
    charges = Charges(np.eye(3), np.ones(3))
    assert Target(charges, 4.0).source is charges


def test_radii_add_up_and_the_face_gets_an_inscribed_circle_of_their_sum() -> None:
    for leaders in (3, 4, 6):
        formation = hemisphere(leaders, 1, 5.0)
        target = Target.ball((1.0, 2.0, 3.0), 2.5).wider(1.5).wider(0.25)
        scale = target.last_scale(formation)
        rim = formation.place(Pose(np.zeros(3), np.eye(3), scale))[:leaders]
        assert np.linalg.norm(rim + np.roll(rim, 1, axis=0), axis=1) / 2.0 == pytest.approx(4.25)
        assert target.last_scale(formation, 7.0) == scale


def test_a_point_leaves_the_formation_at_its_size() -> None:
    assert Target.ball((1.0, 2.0, 3.0)).last_scale(RIM_FORMATION, 1.3) == 1.3


def test_a_face_beside_its_centre_covers_no_ball() -> None:
    aside = Formation(RIM + np.array([0.0, 9.0, 0.0]), np.empty((0, 3)))
    with pytest.raises(PlanError, match="no circle fits"):
        Target.ball((1.0, 2.0, 3.0), 1.0).last_scale(aside)


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.99])
def test_an_uncertain_target_lies_in_the_ball_as_often_as_stated(confidence: float) -> None:
    count = 40_000
    noise = 3.0 * np.sqrt(confidence * (1 - confidence) / count)  # three standard deviations of the count
    for spread, exact in ((np.diag([4.0, 4.0, 4.0]), True), (np.diag([9.0, 1.0, 0.25]), False)):
        draw = np.random.default_rng(1)
        turn = np.linalg.qr(draw.normal(size=(3, 3)))[0]
        covariance = turn @ spread @ turn.T
        target = uncertain([5.0, 6.0, 7.0], 0.5 * (covariance + covariance.T), confidence)
        places = draw.multivariate_normal([5.0, 6.0, 7.0], covariance, count, method="eigh")
        share = (np.linalg.norm(places - target.centre_enu_m, axis=1) <= target.radius_m).mean()
        assert share >= confidence - noise
        assert not exact or share <= confidence + noise


def test_certainty_has_no_radius_and_a_larger_confidence_a_larger_one() -> None:
    known = uncertain([1, 2, 3], np.zeros((3, 3)), 0.9)
    assert (known.centre_enu_m.tolist(), known.radius_m) == ([1.0, 2.0, 3.0], 0.0)
    radii = [uncertain([0, 0, 0], np.diag([1.0, 2.0, 0.0]), share).radius_m for share in (0.1, 0.5, 0.9, 0.999)]
    assert (np.diff(radii) > 0).all()
    assert radii[1] == pytest.approx(np.sqrt(2.0 * 2.365974))  # median of chi-square with three degrees: printed tables


@pytest.mark.parametrize("place", [(np.nan, 0, 0), (0, np.inf, 0), (1, 2), "abc", None])
def test_places_that_are_none_are_refused(place: object) -> None:
    with pytest.raises(PlanError):
        centre_of_charge(np.array([place], dtype=object))
    with pytest.raises(PlanError):
        uncertain(np.array(place, dtype=object), np.eye(3), 0.9)
    with pytest.raises(PlanError):
        Target.ball(np.array(place, dtype=object))


@pytest.mark.parametrize("radius", [-1.0, np.nan, np.inf])
def test_radii_that_are_none_are_refused(radius: float) -> None:
    with pytest.raises(PlanError, match="radius"):
        Target.ball((0.0, 0.0, 0.0), radius)


@pytest.mark.parametrize(
    ("positions", "weights"),
    [
        (np.empty((0, 3)), []),
        (np.zeros((2, 3)), [1.0]),
        (np.zeros((2, 3)), [1.0, 0.0]),
        (np.zeros((2, 3)), [1.0, -1.0]),
        (np.zeros((2, 3)), [1.0, np.nan]),
        (np.zeros((2, 2)), [1.0, 1.0]),
        (np.full((1, 3), np.nan), [1.0]),
    ],
)
def test_charges_without_a_flux_are_refused(positions: Array, weights: list[float]) -> None:
    with pytest.raises(PlanError):
        Charges(positions, np.array(weights))


@pytest.mark.parametrize(
    ("covariance", "confidence", "said"),
    [
        (np.diag([1.0, 1.0, -0.1]), 0.9, "semi-definite"),
        (np.array([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]]), 0.9, "symmetric"),
        (np.full((3, 3), np.nan), 0.9, "finite"),
        (np.eye(2), 0.9, "shape"),
        (np.eye(3), 0.0, "confidence"),
        (np.eye(3), 1.0, "confidence"),
        (np.eye(3), 1.5, "confidence"),
        (np.eye(3), np.nan, "confidence"),
    ],
)
def test_what_is_no_covariance_or_confidence_is_refused(covariance: Array, confidence: float, said: str) -> None:
    with pytest.raises(PlanError, match=said):
        uncertain([0, 0, 0], covariance, confidence)


def test_absurd_distances_are_refused() -> None:
    with pytest.raises(PlanError, match="radius"):
        centre_of_charge([[1e300, 0.0, 0.0], [-1e300, 0.0, 0.0]])


def test_no_targets_have_no_centre() -> None:
    with pytest.raises(PlanError, match="at least one"):
        centre_of_charge(np.empty((0, 3)))
