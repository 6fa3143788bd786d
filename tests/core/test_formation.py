from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from fg_gcs.core.formation import Formation, Pose, facing, hemisphere


def test_the_papers_hemisphere() -> None:
    formation = hemisphere(4, 5, 5.0)
    radius = 5.0 / np.sqrt(2.0)
    placed = formation.place(Pose(np.array([0.0, 2.5, 2.5]), facing(np.array([1.0, 0.0, 0.0]))))
    assert placed[:4] == pytest.approx(np.array([(0, 0, 0), (0, 5, 0), (0, 5, 5), (0, 0, 5)], dtype=float))
    assert np.linalg.norm(formation.slots_m, axis=1) == pytest.approx(np.full(9, radius))
    assert formation.followers_m[:, 0] == pytest.approx([-radius / 2] * 4 + [-radius])
    assert formation.smallest_separation_m == pytest.approx(0.518 * radius, rel=1e-3)


@pytest.mark.parametrize("leaders", [3, 4, 5, 8, 64])
def test_any_number_of_leaders_has_equal_edges_on_one_sphere(leaders: int) -> None:
    for followers in (0, 1, leaders, leaders + 1):
        formation = hemisphere(leaders, followers, 2.0)
        edges = np.linalg.norm(formation.leaders_m - np.roll(formation.leaders_m, 1, axis=0), axis=1)
        assert edges == pytest.approx(np.full(leaders, 2.0))
        assert len(formation.slots_m) == leaders + followers
        radii = np.linalg.norm(formation.slots_m, axis=1)
        assert radii == pytest.approx(np.full(len(radii), radii[0]))


def test_placing_keeps_all_distances_and_scales_them() -> None:
    formation = hemisphere(5, 6, 4.0)
    for seed in range(10):
        draw = np.random.default_rng(seed)
        pose = Pose(draw.normal(size=3) * 50, Rotation.random(rng=draw).as_matrix(), 1.7)
        assert pdist(formation.place(pose)) == pytest.approx(1.7 * pdist(formation.slots_m))


def test_facing_is_a_rotation_that_looks_where_it_is_told() -> None:
    for direction in ((1, 0, 0), (0, 0, 1), (0, 0, -1), (-3, 0.1, 0), (1e-9, 0, 5), (2, -1, 2), (0.1, 3, -0.2)):
        attitude = facing(np.array(direction, dtype=float))
        assert attitude.T @ attitude == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(attitude) == pytest.approx(1.0)
        assert attitude[:, 0] == pytest.approx(np.array(direction) / np.linalg.norm(direction))


def test_facing_leans_as_far_towards_up_as_the_normal_lets_it() -> None:
    for seed in range(20):
        normal, up = np.random.default_rng(seed).normal(size=(2, 3))
        attitude = facing(normal, tuple(up))
        upright = float(up @ attitude[:, 0])
        assert up @ attitude[:, 2] == pytest.approx(np.sqrt(up @ up - upright**2))
        assert up @ attitude[:, 1] == pytest.approx(0.0, abs=1e-12)


def test_a_normal_along_up_takes_north_for_it_and_one_along_north_east() -> None:
    for sign in (1.0, -1.0):
        assert facing(np.array([0.0, 0.0, sign]))[:, 2] == pytest.approx([0.0, 1.0, 0.0])
        assert facing(np.array([0.0, sign, 0.0]), (0.0, 1.0, 0.0))[:, 2] == pytest.approx([1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("leaders", "complaint"),
    [
        ([(0, 0, 0), (0, 1, 0)], "at least 3"),
        ([(0, 0, 0), (0, 1, 0), (0, 2, 0)], "enclose an area"),
        ([(0, 0, 0), (0, 0, 1), (0, 1, 0)], "wind around"),
        ([(0, 0, 0), (0, 1, 0), (1, 1, 1)], "plane of the face"),
        ([(0, 0, 0), (0, np.nan, 0), (0, 1, 1)], "finite"),
        ([(0, 0, 0), (0, np.inf, 0), (0, 1, 1)], "finite"),
        ([(0, 1, 1), (0, 1, 1), (0, 1, 1)], "enclose an area"),
        ([(0, -1, -1), (0, 1, -1), (0, 1, -1), (0, 0, 1)], "slots 2 and 3 lie in one place"),
        ([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, 0, 0), (0, -1, -1)], "slots 1 and 5 lie in one place"),
    ],
)
def test_shapes_without_a_face_are_refused(leaders: list[tuple[float, float, float]], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Formation(np.array(leaders, dtype=float), np.empty((0, 3)))


@pytest.mark.parametrize(("follower", "pair"), [(0, "1 and 10"), (5, "6 and 10"), (8, "9 and 10")])
def test_no_two_vehicles_have_one_slot(follower: int, pair: str) -> None:
    formation = hemisphere(4, 5, 5.0)
    beside = formation.slots_m[follower] - np.array([1e-7, 0.0, 0.0])
    with pytest.raises(ValueError, match=f"slots {pair} lie in one place"):
        Formation(formation.leaders_m, np.concatenate((formation.followers_m, beside[None])))


def test_the_inscribed_circle_is_the_largest_around_the_centre() -> None:
    for leaders in (3, 4, 7, 40):
        middles = hemisphere(leaders, 0, 4.0).leaders_m + np.roll(hemisphere(leaders, 0, 4.0).leaders_m, 1, axis=0)
        assert hemisphere(leaders, 0, 4.0).inscribed_radius_m == pytest.approx(np.linalg.norm(middles, axis=1) / 2.0)
    for rim, radius_m in (
        ([(-4, -1), (4, -1), (4, 2), (-4, 2)], 1.0),  # the nearest of different edges
        ([(-6, -6), (0, -2), (6, -6), (0, 8)], 2.0),  # a corner that points inwards
        ([(1, 1), (3, 1), (3, 3), (1, 3)], 0.0),  # the centre lies outside
    ):
        places = np.array([(0, y, z) for y, z in rim], dtype=float)
        formation = Formation(places, np.empty((0, 3)))
        assert formation.inscribed_radius_m == pytest.approx(radius_m)
        turn = Rotation.from_euler("x", 40.0, degrees=True)
        assert Formation(turn.apply(places), np.empty((0, 3))).inscribed_radius_m == pytest.approx(radius_m)


def test_slots_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        hemisphere(4, 5, 5.0).leaders_m[0, 0] = 1.0
