from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import flux_metric
from fg_gcs.core.formation import Formation, Pose, hemisphere
from fg_gcs.core.kernels import polygon_flux
from fg_gcs.errors import PlanError
from fg_gcs.plan.flux_guided import plan_path
from fg_gcs.plan.free import PAIR_SHARE, SMALLEST_SHARE, plan_leaders, shape_of
from fg_gcs.plan.path.leader_paths import LeaderPath, LeadersPath
from fg_gcs.plan.search.free import DEPARTURE, restore
from fg_gcs.plan.search.free_model import model
from tests.plan.scenes import PAPER, START

SEPARATION = 0.95  # least share of the smallest distance in the formation's own shape, on the way from pose to pose too


def way_m(leaders: Array) -> float:
    return float(np.linalg.norm(np.diff(leaders, axis=0), axis=2).sum())


def rigid_way_m(formation: Formation, start: Pose, target: Array) -> float:
    count = len(formation.leaders_m)
    return way_m(np.array([formation.place(pose)[:count] for pose in plan_path(formation, start, target).poses]))


def edges_m(leaders: Array) -> Array:
    edges: Array = np.linalg.norm(leaders - np.roll(leaders, -1, axis=-2), axis=-1)
    return edges


def best_fit(template: Array, places: Array) -> tuple[Array, Array]:
    """Centre and attitude of the template's best fit, by an implementation that is not ours."""
    mean = template.mean(axis=0)
    turn, _ = Rotation.align_vectors(places - places.mean(axis=0), template - mean)
    return places.mean(axis=0) - turn.apply(mean), turn.as_matrix()


def holds_its_laws(formation: Formation, path: LeaderPath, target: Array) -> None:
    count, scale = len(formation.leaders_m), path.poses[0].scale
    edge = scale * edges_m(formation.leaders_m)
    own, smallest = scale * pdist(formation.leaders_m), scale * formation.smallest_separation_m
    assert np.abs(edges_m(path.leaders_m) - edge).max() <= 1e-6 * edge.min()
    for places, swarm in zip(path.leaders_m, path.swarm_m(formation), strict=True):
        assert (pdist(places) >= (PAIR_SHARE - 1e-6) * own).all()
        assert pdist(swarm).min() >= (SMALLEST_SHARE - 1e-6) * smallest
    assert LeadersPath(formation, path).closest().distance_m >= SEPARATION * smallest
    assert flux_metric(path.leaders_m[-1:], target)[0] >= 0.999
    assert path.leaders_m[-1] == pytest.approx(formation.place(path.poses[-1])[:count], abs=1e-9)


def draw_scene(seed: int) -> tuple[Formation, Pose, Array]:
    draw = np.random.default_rng(seed)
    leaders = int(draw.integers(3, 9))
    followers = (0, 1, leaders, leaders + 1)[draw.integers(4)]
    formation = hemisphere(leaders, followers, draw.uniform(3, 20))
    start = Pose(draw.normal(size=3) * 5, Rotation.random(rng=draw).as_matrix(), draw.uniform(0.5, 2.0))
    return formation, start, draw.uniform(-100, 100, 3)


def test_free_leaders_never_fold_and_fly_no_further_than_rigid_ones() -> None:
    bent = 0.0
    for seed in range(250):
        formation, start, target = draw_scene(seed)
        path = plan_leaders(formation, start, target)
        holds_its_laws(formation, path, target)
        assert way_m(path.leaders_m) <= 1.02 * rigid_way_m(formation, start, target)
        own = start.scale * pdist(formation.leaders_m)
        bent = max(bent, *(np.abs(pdist(places) / own - 1.0).max() for places in path.leaders_m))
    assert bent > 0.01  # they are free: shapes do change on the way


def test_the_papers_kind_of_rows_have_the_lengths_of_rigid_leaders() -> None:
    draw = np.random.default_rng(3)
    for _ in range(50):
        edge_m = float(draw.integers(5, 21))
        start = Pose(np.array([0.0, edge_m / 2, edge_m / 2]), np.eye(3))
        formation, target = hemisphere(4, 5, edge_m), draw.integers(-100, 101, 3).astype(float)
        path = plan_leaders(formation, start, target)
        assert way_m(path.leaders_m) == pytest.approx(rigid_way_m(formation, start, target), rel=0.02)
        assert flux_metric(path.leaders_m[-1:], target)[0] >= 0.999


@pytest.mark.parametrize(("target", "most_m"), [((50, 50, 50), 340.0), ((-50, 50, 50), 349.0)])
def test_the_papers_lengths(target: tuple[float, float, float], most_m: float) -> None:
    assert way_m(plan_leaders(PAPER, START, np.array(target, dtype=float)).leaders_m) <= most_m


@pytest.mark.parametrize(
    "target",
    [
        (-40, 2.5, 2.5),  # exactly behind
        (-4, 2.5, 2.5),  # behind, so close that every turn loses
        (-3.2, 2.5, 2.5),  # the same, among the swarm
        (-1, 2.5, 2.5),  # just behind, among the swarm
        (0, 30, 2.5),  # in the leaders' plane
        (0, 6, 2.5),
        (0, 2.5, 2.5),  # in the face
        (0, 0, 0),  # at a leader's place
        (1, 4, 4),  # near
        (3, 5, 5),
        (1e4, 100, 100),
        (-1e4, 10, 20),
    ],
)
def test_hard_targets(target: tuple[float, float, float]) -> None:
    place = np.array(target, dtype=float)
    path = plan_leaders(PAPER, START, place)
    holds_its_laws(PAPER, path, place)
    assert way_m(path.leaders_m) <= 4 * np.linalg.norm(place - START.centre_enu_m) + 30.0


@pytest.mark.parametrize("outline", ["rectangle", "stops on the sides", "arrow"])
def test_faces_that_are_no_regular_polygons(outline: str) -> None:
    side = np.array([(0, -5, -5), (0, 0, -5), (0, 5, -5), (0, 5, 0), (0, 5, 5), (0, 0, 5), (0, -5, 5), (0, -5, 0)])
    rims = {
        "rectangle": np.array([(0, -9, -3), (0, 9, -3), (0, 9, 3), (0, -9, 3)]),
        "stops on the sides": side,  # three leaders on one line
        "arrow": np.array([(0, -6, -6), (0, 0, -2), (0, 6, -6), (0, 0, 8)]),  # not convex
    }
    formation = Formation(rims[outline].astype(float), np.array([(-5.0, 0.0, 0.0), (-5.0, 5.0, 0.0)]))
    for seed in range(30):
        draw = np.random.default_rng(seed)
        start = Pose(draw.normal(size=3) * 5, Rotation.random(rng=draw).as_matrix())
        target = start.centre_enu_m + draw.normal(size=3) * draw.choice([8.0, 60.0])
        path = plan_leaders(formation, start, target)
        holds_its_laws(formation, path, target)
        in_place = np.array([formation.place(pose)[: len(formation.leaders_m)] for pose in path.poses])
        departed_m = np.linalg.norm(path.leaders_m - in_place, axis=2).max()
        assert departed_m <= 1.05 * DEPARTURE * formation.gyration_m  # exact edges may take a little more


def test_followers_stand_in_the_best_fit_of_the_template() -> None:
    path = plan_leaders(PAPER, START, np.array([-10.0, 10.0, 10.0]))
    for places, pose in zip(path.leaders_m, path.poses, strict=True):
        centre, rotation = best_fit(PAPER.leaders_m, places)
        assert centre == pytest.approx(pose.centre_enu_m, abs=1e-8)
        assert rotation == pytest.approx(pose.rotation, abs=1e-7)


def test_the_same_question_has_the_same_answer() -> None:
    for target in (np.array([-40.0, 2.5, 2.5]), np.array([-10.0, 10.0, 10.0])):
        first, second = (plan_leaders(PAPER, START, target) for _ in range(2))
        assert first.leaders_m.tobytes() == second.leaders_m.tobytes()


def test_the_hold_is_as_deep_as_told_and_in_place_already_is_an_empty_path() -> None:
    target = np.array([10.0, 10.0, 10.0])
    end = plan_leaders(PAPER, START, target, hold_depth_m=0.4).poses[-1]
    assert end.centre_enu_m - target == pytest.approx(0.4 * end.rotation[:, 0])
    here = plan_leaders(PAPER, START, START.centre_enu_m)
    assert (here.leaders_m.shape, here.iterates) == ((1, 4, 3), 0)
    still = LeadersPath(PAPER, here)
    assert still.length_m == 0.0
    assert still.at(np.zeros(1)).position_m[0] == pytest.approx(PAPER.place(START))
    assert still.closest().distance_m == pytest.approx(PAPER.smallest_separation_m)


@pytest.mark.parametrize(
    ("formation", "start", "target", "said"),
    [
        (PAPER, START, (np.nan, 0, 0), "finite"),
        (PAPER, START, (np.inf, 0, 0), "finite"),
        (PAPER, Pose(np.array([np.nan, 0, 0]), np.eye(3)), (9, 9, 9), "start"),
        (PAPER, Pose(np.zeros(3), np.eye(3), 0.0), (9, 9, 9), "scale"),
        (PAPER, START, (-0.002, -0.001, -0.001), "rim"),
        (PAPER, START, (0, 2.5, 0), "rim"),
    ],
)
def test_what_has_no_plan_is_refused(formation: Formation, start: Pose, target: tuple[float, ...], said: str) -> None:
    with pytest.raises(PlanError, match=said):
        plan_leaders(formation, start, np.array(target))


def test_the_flown_path_passes_the_iterates_with_exact_derivatives() -> None:
    plan = plan_leaders(PAPER, START, np.array([-10.0, 10.0, 10.0]))
    path = LeadersPath(PAPER, plan)
    places = plan.swarm_m(PAPER)
    assert path.knots_m[0] == 0.0
    assert path.knots_m[-1] == path.length_m
    assert path.at(path.knots_m[[0, -1]]).position_m == pytest.approx(places[[0, -1]], abs=1e-9)
    knots = path.at(path.knots_m).position_m
    for knot in knots:  # each is one of the iterates
        assert np.abs(places - knot).max(axis=(1, 2)).min() < 1e-9
    step = 1e-5 * path.length_m
    s_m = np.random.default_rng(0).uniform(step, path.length_m - step, 60)
    s_m = s_m[np.abs(s_m[:, None] - path.knots_m).min(axis=1) > step]  # third derivatives jump at knots
    before, here, after = (path.at(s_m + shift) for shift in (-step, 0.0, step))
    assert here.first == pytest.approx((after.position_m - before.position_m) / (2 * step), abs=1e-6)
    assert here.second == pytest.approx((after.first - before.first) / (2 * step), abs=1e-5)
    beside = 1e-9 * path.length_m
    left, right = (path.at(path.knots_m[1:-1] + side) for side in (-beside, beside))
    assert left.second == pytest.approx(right.second, abs=1e-5)


@pytest.mark.parametrize("seed", range(12))
def test_the_model_is_the_flux_to_second_order_along_shapes_that_keep_their_edges(seed: int) -> None:
    draw = np.random.default_rng(seed)
    leaders = int(draw.integers(3, 8))
    shape = shape_of(hemisphere(leaders, 0, 5.0), 1.0)
    departure = 0.05 * draw.normal(size=(leaders, 3))
    assert restore(shape, departure)
    source = draw.uniform(4.0, 20.0) * Rotation.random(rng=draw).apply([1.0, 0.0, 0.0])
    slots = shape.slots_m[:leaders]
    gradient, hessian, basis = model(shape, departure, slots + departure, source)

    def moved(way: Array) -> float:
        bent = departure + (basis @ way[6:]).reshape(-1, 3)
        assert restore(shape, bent)
        places = way[:3] + Rotation.from_rotvec(way[3:6]).apply(slots + bent)
        return float(polygon_flux(places, source))

    way = draw.normal(size=2 * leaders)
    step = 3e-4  # m and rad: rounding over its square and what the third order leaves are both below the tolerance
    ahead, here, behind = (moved(share * step * way) for share in (1.0, 0.0, -1.0))
    assert gradient @ way == pytest.approx((ahead - behind) / (2 * step), rel=1e-5, abs=1e-6)
    assert way @ hessian @ way == pytest.approx((ahead - 2 * here + behind) / step**2, rel=1e-4, abs=1e-4)


def test_no_pair_may_come_much_closer_than_the_closest_of_the_shape_neighbours_included() -> None:
    rim = hemisphere(5, 0, 4.0).leaders_m
    far = Formation(rim, np.array([[-50.0, 0.0, 0.0]]))  # so the closest pair are two neighbours on the rim
    for scale in (1.0, 1.7):
        shape = shape_of(far, scale)
        for (first, second), least_m in zip(shape.pairs.tolist(), shape.least_m, strict=True):
            apart_m = float(np.linalg.norm(shape.slots_m[first] - shape.slots_m[second]))
            assert (second - first) % 5 not in (1, 4) or second == 5
            own_m = PAIR_SHARE * apart_m if second < 5 else 0.0
            assert least_m == pytest.approx(max(own_m, SMALLEST_SHARE * 4.0 * scale))
        assert shape.edges_m == pytest.approx(np.full(5, 4.0 * scale))
        assert len(shape.pairs) == 5 + 5  # diagonals of the pentagon, and every leader with the follower
