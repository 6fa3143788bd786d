"""Verified landing: from any formation vehicles part on lines that keep apart, until each can come straight down."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Pose, facing, hemisphere
from fg_gcs.core.separation import Fence, closest_approach
from fg_gcs.errors import PlanError
from fg_gcs.plan.keep_clear import Column, clearances_m, keeps_clear
from fg_gcs.plan.landing import part, spacing_m
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.transit import scatter
from fg_gcs.plan.way_home import plan_home

RULES = Rules(Limits(8.0, 4.0), 1.5, Fence((-60.0, -60.0, 2.0), (60.0, 60.0, 60.0)))


def formation(normal: Array, edge_m: float = 5.0, leaders: int = 4, followers: int = 5) -> Array:
    return hemisphere(leaders, followers, edge_m).place(Pose(np.array([5.0, -3.0, 20.0]), facing(normal)))


def flown(places: Array, columns: tuple[Column, ...] = (), rules: Rules = RULES) -> Array:
    """Positions while they part, shape (T, V, 3)."""
    pieces = part(places, rules, columns)
    if not pieces:
        return places[None]
    return np.concatenate([p.sample(np.linspace(0.0, p.duration_s, 300)).position_m for p in pieces])


def apart_m(places: Array) -> float:
    flat = places * (1.0, 1.0, 0.0)
    return closest_approach(np.stack((flat, flat)), np.array([0.0, 1.0])).distance_m


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda n: np.linalg.norm(n) > 0.1),
    st.integers(3, 12),
    st.integers(0, 2),
    st.floats(4.6, 15.0),
)
def test_from_any_formation_everybody_can_come_straight_down(
    normal: tuple[float, ...], leaders: int, more: int, edge_m: float
) -> None:
    places = formation(np.array(normal), edge_m, leaders, (0, 1, leaders)[more])
    positions = flown(places)
    at_first = closest_approach(places[None], np.zeros(1)).distance_m
    closest = closest_approach(positions, np.arange(float(len(positions)))).distance_m
    assert closest >= min(RULES.separation_m, at_first) - 1e-3
    assert apart_m(positions[-1]) >= spacing_m(RULES) - 1e-6
    assert np.allclose(positions[-1, :, 2], places[:, 2])


def test_those_that_stand_straight_above_each_other_part() -> None:
    tower = np.column_stack((np.zeros(9), np.zeros(9), 5.0 + 1.6 * np.arange(9)))
    assert apart_m(flown(tower)[-1]) >= spacing_m(RULES) - 1e-6


def test_who_can_land_already_is_not_moved() -> None:
    assert part(np.array([[0.0, 0.0, 5.0], [3.0, 0.0, 8.0]]), RULES) == ()
    assert part(np.array([[0.0, 0.0, 5.0]]), RULES) == ()


def test_where_there_is_no_room_it_is_said() -> None:
    small = Rules(RULES.limits, 1.5, Fence((-1.0, -1.0, 2.0), (1.0, 1.0, 30.0)))
    tower = np.column_stack((np.zeros(9), np.zeros(9), 5.0 + 1.6 * np.arange(9)))
    with pytest.raises(PlanError, match=r"no room in the fence for 9 places 2\.00 m apart to land"):
        part(tower, small)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_where_a_vehicle_may_come_down_nobody_goes(seed: int) -> None:
    """Whoever is below it gets out of its way, straight; nobody crosses it, and nobody ends in it."""
    draw = np.random.default_rng(seed)
    normal = draw.normal(size=3)
    everybody = formation(normal, float(draw.uniform(4.8, 9.0)))
    gone = int(draw.integers(9))
    left = np.delete(everybody, gone, axis=0)
    start = everybody[gone, :2]
    end = start + draw.uniform(-4.0, 4.0, 2) * float(draw.integers(2))
    column = Column((start[0], start[1]), (end[0], end[1]), float(everybody[gone, 2]) + 1.0, 0.3)
    positions = flown(left, (column,))
    inside = _distances(positions, column)
    needed = np.minimum(inside[0], RULES.separation_m + column.radius_m)
    below = left[:, 2] < column.top_m + RULES.separation_m
    assert (inside >= np.minimum(needed, 0.5 * RULES.separation_m) - 1e-3)[:, below].all()
    assert (inside[-1] >= 0.5 * RULES.separation_m + column.radius_m - 1e-3).all()
    assert apart_m(positions[-1]) >= spacing_m(RULES) - 1e-6


def _distances(positions: Array, column: Column) -> Array:
    start, end = np.array(column.start_enu_m), np.array(column.end_enu_m)
    shares = np.linspace(0.0, 1.0, 400)[:, None]
    line = start + shares * (end - start)
    gaps = positions[:, :, None, :2] - line
    distances: Array = np.linalg.norm(gaps, axis=3).min(axis=2)
    return distances


@pytest.mark.parametrize("seed", range(16))
def test_the_way_home_leads_around_where_a_vehicle_may_come_down(seed: int) -> None:
    draw = np.random.default_rng(seed)
    normal = draw.normal(size=3)
    everybody = formation(normal, float(draw.uniform(6.0, 9.0)))
    gone = int(draw.integers(9))
    left = np.delete(everybody, gone, axis=0)
    ticks = 4.0 * np.arange(3)
    tops = np.array([(x, y, 3.0) for x in ticks for y in ticks])
    column = Column(tuple(everybody[gone, :2]), tuple(everybody[gone, :2]), float(everybody[gone, 2]) + 1.0, 0.3)
    way = plan_home(left, tops, RULES, (column,))
    assert len(set(way.goal_of.tolist())) == 8
    here = left
    for piece in way.pieces:
        positions = piece.sample(np.linspace(0.0, piece.duration_s, 300)).position_m
        below = positions[:, :, 2] < column.top_m + RULES.separation_m - 1e-6
        inside = _distances(positions, column)
        needed = np.minimum(inside[0], RULES.separation_m + column.radius_m)
        assert (inside >= np.minimum(needed, 0.5 * RULES.separation_m) - 1e-3)[below].all()
        assert closest_approach(positions, np.arange(300.0)).distance_m >= RULES.separation_m - 1e-3
        here = positions[-1]
    assert np.allclose(here[way.goal_of < 9], tops[way.goal_of[way.goal_of < 9]], atol=1e-6)
    assert (_distances(here[None], column) >= 0.5 * RULES.separation_m + column.radius_m - 1e-3).all()
    assert apart_m(here) >= spacing_m(RULES) - 1e-6


def test_a_place_in_a_column_is_nobodys_goal() -> None:
    tops = np.array([[0.0, 0.0, 3.0], [5.0, 0.0, 3.0], [10.0, 0.0, 3.0], [15.0, 0.0, 3.0]])
    start = tops + np.array([0.0, 8.0, 5.0])
    column = Column((5.0, 0.0), (5.0, 0.0), 0.5, 0.3)
    way = scatter(start[:3], tops, RULES, (column,))
    assert 1 not in way.goal_of.tolist()
    with pytest.raises(PlanError, match="4 vehicles have 3 places to go to"):
        scatter(start, tops, RULES, (column,))


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-9.0, 9.0), min_size=10, max_size=10))
def test_clearance_is_that_of_dense_samples(numbers: list[float]) -> None:
    a, b, c, d = (np.array(numbers[i : i + 2]) for i in (0, 2, 4, 6))
    start, end = np.append(a, 1.0)[None], np.append(b, 2.0)[None]
    column = Column(tuple(c), tuple(d), 5.0, 0.25)
    shares = np.linspace(0.0, 1.0, 1500)[:, None]
    sampled = _distances((start + shares[:, None] * (end - start)).reshape(1, -1, 3), column).min() - 0.25
    exact = float(clearances_m(start, end, column, 1.0)[0])
    assert exact == pytest.approx(sampled, abs=0.05)
    assert exact <= sampled + 1e-9
    assert clearances_m(start + 10.0, end + 10.0, column, 1.0)[0] == np.inf
    assert keeps_clear(start, end, (), 1.0)
