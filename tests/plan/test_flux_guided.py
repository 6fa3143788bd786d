from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import FACING, coverage, flux_metric
from fg_gcs.core.formation import Formation, Pose, hemisphere
from fg_gcs.errors import PlanError
from fg_gcs.plan.flux_guided import FluxPath, plan_path
from fg_gcs.plan.path.rigid_path import PosePath
from fg_gcs.plan.search.pose_model import charged_flux, place, pose_derivatives, turned
from fg_gcs.plan.targets import Charges
from tests.plan.scenes import PAPER, START


def rims(formation: Formation, path: FluxPath) -> Array:
    return np.array([formation.place(pose)[: len(formation.leaders_m)] for pose in path.poses])


def way_m(formation: Formation, path: FluxPath) -> float:
    return float(np.linalg.norm(np.diff(rims(formation, path), axis=0), axis=2).sum())


@pytest.mark.parametrize(
    ("target", "published_m"),
    [((10, 10, 10), 60.0), ((-10, 10, 10), 70.8), ((50, 50, 50), 345.0), ((-50, 50, 50), 354.0)],
)
def test_the_papers_lengths(target: tuple[float, float, float], published_m: float) -> None:
    path = plan_path(PAPER, START, np.array(target, dtype=float))
    assert way_m(PAPER, path) == pytest.approx(published_m, rel=0.03)


def test_every_target_ends_surrounded_and_faced_on_the_way() -> None:
    draw = np.random.default_rng(7)
    for _ in range(60):
        target = draw.uniform(-100, 100, 3)
        formation = hemisphere(int(draw.integers(3, 9)), 0, draw.uniform(3, 20))
        start = Pose(draw.normal(size=3) * 5, Rotation.random(rng=draw).as_matrix())
        path = plan_path(formation, start, target, hold_depth_m=0.1)
        rim = rims(formation, path)
        covered = coverage(rim, target)
        facing = int(np.argmax(covered >= FACING))
        assert flux_metric(rim[-1:], target)[0] >= 0.999
        assert covered[facing] >= FACING
        assert covered[facing:].min() >= FACING - 0.005


def test_every_pose_keeps_every_distance() -> None:
    path = plan_path(PAPER, START, np.array([-30.0, 20.0, 5.0]))
    for pose in path.poses:
        assert pdist(PAPER.place(pose)) == pytest.approx(pdist(PAPER.slots_m), rel=1e-9)


def test_the_hold_has_the_target_on_the_axis_as_deep_as_told() -> None:
    target = np.array([10.0, 10.0, 10.0])
    end = plan_path(PAPER, START, target, hold_depth_m=0.4).poses[-1]
    assert end.centre_enu_m - target == pytest.approx(0.4 * end.rotation[:, 0])


def test_exactly_behind_is_a_saddle_with_one_way_out() -> None:
    behind = np.array([-40.0, 2.5, 2.5])
    first, second = (plan_path(PAPER, START, behind) for _ in range(2))
    assert all(np.array_equal(a.rotation, b.rotation) for a, b in zip(first.poses, second.poses, strict=True))
    assert flux_metric(rims(PAPER, first)[-1:], behind)[0] >= 0.999
    assert way_m(PAPER, first) < 1.2 * 4 * 40.0


@pytest.mark.parametrize(
    "target",
    [
        (-2.2, 2.5, 2.5),
        (-4, 2.5, 2.5),
        (-6, 2.6, 2.5),
        (0, 30, 2.5),
        (0, 6, 2.5),
        (0.0, 2.5, 2.5),
        (1, 2.5, 2.5),
        (1, 4, 4),
        (-1, 2.5, 2.5),
        (1e4, 100, 100),
        (-1e4, 10, 20),
    ],
)
def test_hard_targets(target: tuple[float, float, float]) -> None:
    path = plan_path(PAPER, START, np.array(target))
    assert flux_metric(rims(PAPER, path)[-1:], np.array(target))[0] >= 0.999
    assert way_m(PAPER, path) <= 4 * np.linalg.norm(np.array(target) - START.centre_enu_m) + 30.0


@pytest.mark.parametrize("last", [0.1, 0.5, 3.0, 10.0])
def test_the_formation_grows_and_shrinks_on_the_way_at_a_bounded_rate(last: float) -> None:
    target = np.array([60.0, 20.0, 10.0])
    path = plan_path(PAPER, START, target, 0.1, last_scale=last)
    scales = np.array([pose.scale for pose in path.poses])
    assert scales[[0, -1]] == pytest.approx([1.0, last])
    assert (np.diff(scales) * np.sign(last - 1.0) >= 0.0).all()
    assert flux_metric(rims(PAPER, path)[-1:], target)[0] >= 0.999
    body = PosePath(PAPER.slots_m, path.poses)
    shape = pdist(PAPER.slots_m)
    for positions in body.at(np.linspace(0.0, body.length_m, 60)).position_m:
        ratio = pdist(positions) / shape
        assert ratio == pytest.approx(np.full(len(ratio), ratio[0]), rel=1e-9)
        assert min(1.0, last) - 1e-9 <= ratio[0] <= max(1.0, last) + 1e-9
    s = np.linspace(0.1, body.length_m - 0.1, 40)
    difference = (body.at(s + 1e-5).position_m - body.at(s - 1e-5).position_m) / 2e-5
    assert np.abs(difference - body.at(s).first).max() < 1e-5


def test_in_place_already_is_an_empty_path() -> None:
    path = plan_path(PAPER, START, START.centre_enu_m)
    assert (len(path.poses), path.iterates) == (1, 0)


@pytest.mark.parametrize("target", [(0.0, 2.5, 0.0), (1e-10, 2.5, 0.0), (0.0, 0.0, 2.5)])
def test_a_target_on_an_edge_is_refused_or_reached_but_never_a_crash(target: tuple[float, float, float]) -> None:
    try:
        path = plan_path(PAPER, START, np.array(target))
    except PlanError as error:
        said = str(error)
    else:
        said = f"reached with {flux_metric(rims(PAPER, path)[-1:], np.array(target))[0]:.3f}"
    assert "rim" in said or said == "reached with 1.000"


@pytest.mark.parametrize("target", [(np.nan, 0, 0), (np.inf, 0, 0)])
def test_targets_that_are_none_are_refused(target: tuple[float, float, float]) -> None:
    with pytest.raises(PlanError, match="finite"):
        plan_path(PAPER, START, np.array(target))


def test_derivatives_by_move_and_turn_are_finite_differences_for_one_source_and_several() -> None:
    step, wide = 1e-4, 2e-3
    for seed in range(30):
        draw = np.random.default_rng(seed)
        rim = hemisphere(int(draw.integers(3, 8)), 0, 5.0).leaders_m
        sources = draw.normal(size=(1 + seed % 3, 3)) * 6.0 + np.array([8.0, 0.0, 0.0])
        weights = draw.uniform(0.5, 2.0, len(sources))
        centre, rotation = draw.normal(size=3), Rotation.random(rng=draw).as_matrix()
        vertices = np.empty_like(rim)

        def flux_at(change: Array) -> float:
            place(rim, centre + change[:3], turned(rotation, *change[3:].tolist()), 1.0, vertices)  # noqa: B023 (used within the loop)
            return float(charged_flux(vertices, sources, weights))  # noqa: B023 (as above)

        place(rim, centre, rotation, 1.0, vertices)
        gradient, hessian = np.empty(6), np.empty((6, 6))
        assert pose_derivatives(vertices.copy(), centre, sources, weights, 1e-3, gradient, hessian)
        moves = step * np.eye(6)
        slope = np.array([flux_at(move) - flux_at(-move) for move in moves]) / (2 * step)
        assert slope == pytest.approx(gradient, abs=1e-6 * np.abs(gradient).max())

        def bends(span: float) -> Array:
            ways = span * np.eye(6)
            rows = [[flux_at(a + b) - flux_at(a - b) - flux_at(b - a) + flux_at(-a - b) for a in ways] for b in ways]
            return np.array(rows) / (4 * span**2)

        # A second difference of a short step has half the digits; two of long steps cancel each other's leading error
        bend = (4.0 * bends(wide) - bends(2.0 * wide)) / 3.0
        assert bend == pytest.approx(hessian, abs=1e-6 * np.abs(hessian).max())


def test_one_charge_is_a_point_whatever_its_weight() -> None:
    target = np.array([30.0, -20.0, 10.0])
    one, other = (
        plan_path(PAPER, START, target, 0.2),
        plan_path(PAPER, START, Charges(target[None], np.array([7.0])), 0.2),
    )
    assert np.array_equal(one.poses.rows, other.poses.rows)


def test_several_charges_end_with_their_centre_on_the_axis_and_the_face_towards_them_on_the_way() -> None:
    for seed in range(40):
        draw = np.random.default_rng(seed)
        charges = Charges(draw.uniform(-60, 60, 3) + draw.normal(size=(5, 3)) * 3.0, draw.uniform(0.5, 2.0, 5))
        middle = charges.centre_enu_m
        path = plan_path(PAPER, START, charges, 0.2, last_scale=3.0)
        end = path.poses[-1]
        assert end.centre_enu_m == pytest.approx(middle + 0.2 * end.rotation[:, 0])
        assert flux_metric(rims(PAPER, path)[-1:], middle)[0] >= 0.999
        covered = coverage(rims(PAPER, path), middle)
        assert covered[int(np.argmax(covered >= FACING)) :].min() >= 0.8  # it looks at the charges, not at their middle


def test_the_flux_of_several_charges_only_grows_until_the_last_slide() -> None:
    charges = Charges(np.array([(40.0, 5.0, 0.0), (42.0, -4.0, 6.0), (37.0, 1.0, -5.0)]), np.array([1.0, 1.0, 2.0]))
    path = plan_path(PAPER, START, charges)
    flux = [charges.flux(rim) for rim in rims(PAPER, path)[:-1]]
    assert (np.diff(flux) > 0.0).all()
