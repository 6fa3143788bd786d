from __future__ import annotations

from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from fg_gcs.core import solid_angle
from fg_gcs.core.formation import hemisphere
from fg_gcs.errors import PlanError
from fg_gcs.plan.targets import Charges, PointTarget, centre_of_charge, edge_for_radius_m, uncertain

Array = NDArray[np.float64]

RIM = hemisphere(5, 0, 4.0).leaders_m


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
        distances = np.linalg.norm(positions - np.array(target.position_enu_m), axis=1)
        edge = edge_for_radius_m(target.radius_m)
        assert target.position_enu_m == pytest.approx(positions.mean(axis=0))
        assert edge == pytest.approx((2.0 * distances.max() + 10.0) / np.sqrt(2.0))
        assert distances.max() < edge / np.sqrt(2.0)


def test_a_single_target_keeps_the_clearance() -> None:
    assert edge_for_radius_m(centre_of_charge([[1.0, 2.0, 3.0]]).radius_m) == pytest.approx(10.0 / np.sqrt(2.0))


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
        share = (np.linalg.norm(places - target.position_enu_m, axis=1) <= target.radius_m).mean()
        assert share >= confidence - noise
        assert not exact or share <= confidence + noise


def test_certainty_has_no_radius_and_a_larger_confidence_a_larger_one() -> None:
    assert uncertain([1, 2, 3], np.zeros((3, 3)), 0.9) == PointTarget((1.0, 2.0, 3.0), 0.0)
    radii = [uncertain([0, 0, 0], np.diag([1.0, 2.0, 0.0]), share).radius_m for share in (0.1, 0.5, 0.9, 0.999)]
    assert (np.diff(radii) > 0).all()
    assert radii[1] == pytest.approx(np.sqrt(2.0 * 2.365974))  # median of chi-square with three degrees: printed tables


def test_the_inscribed_circle_of_the_face_is_the_target() -> None:
    assert edge_for_radius_m(2.5) == pytest.approx(5.0)  # the paper's l = 2 r
    for leaders in range(3, 20):
        rim = hemisphere(leaders, 0, edge_for_radius_m(7.0, leaders)).leaders_m
        middles = 0.5 * (rim + np.roll(rim, -1, axis=0))
        assert np.linalg.norm(middles, axis=1) == pytest.approx(7.0)


@pytest.mark.parametrize("place", [(np.nan, 0, 0), (0, np.inf, 0), (1, 2), "abc", None])
def test_places_that_are_none_are_refused(place: object) -> None:
    with pytest.raises(PlanError):
        centre_of_charge(np.array([place], dtype=object))
    with pytest.raises(PlanError):
        uncertain(np.array(place, dtype=object), np.eye(3), 0.9)
    with pytest.raises(PlanError):
        PointTarget(cast("tuple[float, float, float]", place))


@pytest.mark.parametrize("radius", [-1.0, np.nan, np.inf])
def test_radii_that_are_none_are_refused(radius: float) -> None:
    with pytest.raises(PlanError, match="radius"):
        PointTarget((0.0, 0.0, 0.0), radius)
    with pytest.raises(PlanError, match="radius"):
        edge_for_radius_m(radius)


def test_no_face_has_two_leaders_and_none_has_no_size() -> None:
    with pytest.raises(PlanError, match="3 leaders"):
        edge_for_radius_m(1.0, 2)
    with pytest.raises(PlanError, match="radius"):
        edge_for_radius_m(0.0)


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


def test_no_targets_have_no_centre() -> None:
    with pytest.raises(PlanError, match="at least one"):
        centre_of_charge(np.empty((0, 3)))
