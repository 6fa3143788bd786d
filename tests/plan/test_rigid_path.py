"""The compiled splines against SciPy's, and the path of a rigid formation made of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation, RotationSpline

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Pose
from fg_gcs.plan.path.rigid_path import PosePath
from fg_gcs.plan.path.splines import natural_cubic, rotation_spline
from fg_gcs.plan.path.swarm_path import KNOT_M, thinned
from tests.plan.scenes import PAPER, START


def drawn_knots(draw: np.random.Generator, count: int) -> Array:
    return np.cumsum(draw.uniform(0.2, 3.0, count))


def drawn_attitudes(draw: np.random.Generator, count: int, turn_rad: float) -> Rotation:
    """Attitudes with turns of one size about any axes."""
    axes = draw.normal(size=(count, 3))
    turns = turn_rad * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    chain = [Rotation.from_rotvec(draw.normal(size=3))]
    for turn in turns[1:]:
        chain.append(chain[-1] * Rotation.from_rotvec(turn))
    return Rotation.from_matrix(np.stack([each.as_matrix() for each in chain]))


def body(knots: Array, attitudes: Array) -> PosePath:
    """A path whose parameter is the way of a slot a metre off the axis of nothing but turns."""
    return PosePath(
        np.eye(3), [Pose(np.array([knot, 0.0, 0.0]), each) for knot, each in zip(knots, attitudes, strict=True)]
    )


@pytest.mark.parametrize("count", [2, 3, 4, 40])
def test_the_cubic_spline_is_scipys_natural_one(count: int) -> None:
    draw = np.random.default_rng(count)
    knots, values = drawn_knots(draw, count), draw.normal(size=(count, 3))
    theirs = CubicSpline(knots, values, bc_type="natural").c
    assert natural_cubic(knots, values) == pytest.approx(theirs, abs=1e-10)


@pytest.mark.parametrize("turn_rad", [1e-6, 0.01, 0.3, 1.0, 1.5])
@pytest.mark.parametrize("count", [2, 3, 5, 40])
def test_the_rotation_spline_is_scipys_where_that_converges(count: int, turn_rad: float) -> None:
    draw = np.random.default_rng(count)
    knots, rotations = drawn_knots(draw, count), drawn_attitudes(draw, count, turn_rad)
    attitudes, turns = rotation_spline(knots, rotations.as_matrix())
    theirs = RotationSpline(knots, rotations)
    assert attitudes == pytest.approx(rotations.as_matrix(), abs=1e-12)
    assert turns == pytest.approx(theirs.interpolator.c, abs=1e-6 * turn_rad)


@pytest.mark.parametrize("turn_rad", [0.0, 1e-3, 0.3, 2.0, 3.1])
def test_rate_and_growth_are_continuous_however_far_a_span_turns(turn_rad: float) -> None:
    """SciPy's own stops before it has converged where spans turn by two radians and more."""
    for seed in range(5):
        draw = np.random.default_rng(seed)
        attitudes = drawn_attitudes(draw, 9, turn_rad).as_matrix()
        path = body(np.cumsum(draw.uniform(1.0, 3.0, 9)), attitudes)
        inner = path.knots_m[1:-1]
        before, after = path.at(inner * (1.0 - 1e-15) - 1e-12), path.at(inner)
        for one, other in zip(before, after, strict=True):
            assert np.abs(one - other).max() < 1e-9 * (1.0 + np.abs(other).max())
        arms = path.at(path.knots_m).position_m - path.at(path.knots_m).position_m.mean(axis=1, keepdims=True)
        own = np.eye(3) - np.eye(3).mean(axis=0)
        assert arms == pytest.approx(np.einsum("kij,vj->kvi", attitudes, own), abs=1e-9)


def test_attitudes_with_rounding_are_made_orthogonal() -> None:
    rough = np.round(drawn_attitudes(np.random.default_rng(1), 6, 0.5).as_matrix(), 4)
    attitudes, _ = rotation_spline(np.arange(6.0), rough)
    assert attitudes @ np.swapaxes(attitudes, 1, 2) == pytest.approx(np.broadcast_to(np.eye(3), (6, 3, 3)), abs=1e-12)
    assert attitudes == pytest.approx(rough, abs=1e-3)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_half_turns_about_any_axis_are_met(axis: int) -> None:
    """There the real part of the quaternion vanishes, so that each axis takes a way of its own."""
    turned = Rotation.from_rotvec(np.pi * np.eye(3)[axis]).as_matrix()
    path = body(np.array([0.0, 2.0]), np.stack((np.eye(3), turned)))
    ends = path.at(np.array([0.0, path.length_m])).position_m
    assert ends[0] == pytest.approx(np.eye(3))
    assert ends[1] == pytest.approx(turned.T + np.array([2.0, 0.0, 0.0]), abs=1e-9)


def test_places_may_come_in_any_order() -> None:
    path = body(np.arange(9.0), drawn_attitudes(np.random.default_rng(2), 9, 0.4).as_matrix())
    places = np.linspace(-0.1, path.length_m + 0.1, 50)
    order = np.random.default_rng(3).permutation(50)
    for sorted_ones, shuffled in zip(path.at(places), path.at(places[order]), strict=True):
        assert (sorted_ones[order] == shuffled).all()


def test_the_closest_pair_is_that_of_all_pairs_at_the_smallest_scale() -> None:
    for seed in range(20):
        draw = np.random.default_rng(seed)
        slots = draw.normal(size=(int(draw.integers(2, 200)), 3))
        scale = float(draw.uniform(0.5, 2.0))
        found = PosePath(slots, [START, Pose(np.array([5.0, 0.0, 0.0]), START.rotation, scale)]).closest()
        one, other = found.pair
        assert one < other
        assert found.distance_m == pytest.approx(pdist(slots).min() * min(1.0, scale))
        assert found.distance_m == pytest.approx(np.linalg.norm(slots[one] - slots[other]) * min(1.0, scale))


def test_a_single_pose_is_a_path_without_length() -> None:
    path = PosePath(PAPER.slots_m, [START])
    assert path.length_m == 0.0
    assert path.at(np.zeros(1)).position_m[0] == pytest.approx(PAPER.place(START))


def test_thinned_places_are_apart_and_keep_both_ends() -> None:
    ways = np.cumsum(np.random.default_rng(4).uniform(0.0, 0.3, 60))
    kept = thinned(ways)
    assert kept[0] == 0
    assert kept[-1] == 59
    assert np.diff(ways[kept]).min() >= KNOT_M
    assert thinned(np.zeros(1)) == [0, 0]
