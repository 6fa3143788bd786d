from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from fg_gcs.core.coverage import FACING, coverage, flux_metric
from fg_gcs.core.formation import Formation, Pose, hemisphere
from fg_gcs.errors import PlanError
from fg_gcs.plan.flux_guided import FluxPath, plan_path
from fg_gcs.plan.rigid_path import PosePath
from fg_gcs.plan.rigid_search import maximise_in_ball
from tests.plan.scenes import PAPER, START

Array = NDArray[np.float64]


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


def test_maximise_in_ball_beats_every_random_point_and_stays_inside() -> None:
    for seed in range(100):
        draw = np.random.default_rng(seed)
        matrix = draw.normal(size=(6, 6))
        hessian = matrix + matrix.T
        gradient = draw.normal(size=6) * draw.choice([0.0, 1e-3, 1.0, 1e3])
        if seed % 3 == 0:  # no gradient along the leading eigenvector: the hard case
            leading = np.linalg.eigh(hessian)[1][:, -1]
            gradient -= (gradient @ leading) * leading
        best = maximise_in_ball(gradient, hessian)
        assert np.linalg.norm(best) <= 1.0 + 1e-6
        points = draw.normal(size=(3000, 6))
        points /= np.maximum(np.linalg.norm(points, axis=1), 1.0)[:, None]
        values = points @ gradient + 0.5 * np.einsum("ni,ij,nj->n", points, hessian, points)
        value = best @ gradient + 0.5 * best @ hessian @ best
        assert value >= values.max() - 1e-6 * (1 + abs(value))
