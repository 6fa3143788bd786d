from __future__ import annotations

import numpy as np
import pytest

from fg_gcs.core.formation import hemisphere
from fg_gcs.core.separation import Fence, closest_approach
from fg_gcs.errors import PlanError
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.transit import CLEARANCE, Transit, gather, scatter
from tests.plan.scenes import LIMITS, START, compiled, task, tops

RULES = Rules(LIMITS, 1.5, Fence((-99.0, -99.0, -99.0), (99.0, 99.0, 99.0)))


def closest_m(way: Transit) -> float:
    least = np.inf
    for piece in way.pieces:
        times = np.linspace(0.0, piece.duration_s, 400)
        least = min(least, closest_approach(piece.sample(times).position_m, times).distance_m)
    return float(least)


@pytest.mark.parametrize("seed", range(25))
def test_random_pads_are_joined_to_random_formations_without_a_close_call(seed: int) -> None:
    draw = np.random.default_rng(seed)
    formation = hemisphere(int(draw.integers(3, 8)), 0, 2.2)
    slots = formation.place(START) + draw.normal(size=3) * 10
    count = len(slots)
    cells = draw.permutation(36)[:count]
    pads = np.stack((cells % 6 * 3.0, cells // 6 * 3.0, np.full(count, 4.0)), axis=1)
    there = gather(pads, slots, RULES)
    back = scatter(slots, pads, RULES)
    for way, ends in ((there, slots), (back, pads)):
        assert sorted(way.goal_of) == list(range(count))
        last = way.pieces[-1].sample(np.array([way.pieces[-1].duration_s])).position_m[0]
        assert last == pytest.approx(ends[way.goal_of], abs=1e-9)
        assert closest_m(way) >= CLEARANCE * 1.5 - 1e-3


def test_a_tight_formation_is_opened_first() -> None:
    flight = compiled(task(separation_m=1.5))
    assert flight.gather.separation.distance_m >= 1.8
    assert len(flight.home.pieces) == 2  # open, then fly


def test_pads_too_tight_for_any_line_are_refused_with_a_reason() -> None:
    with pytest.raises(PlanError, match="place the pads or the slots further apart"):
        compiled(above=tops(spacing_m=1.6))


def test_nobody_moves_when_everybody_is_there_already() -> None:
    slots = hemisphere(4, 0, 8.0).place(START)
    way = gather(slots, slots, RULES)
    assert list(way.goal_of) == [0, 1, 2, 3]
    assert way.pieces[0].duration_s == pytest.approx(0.0, abs=1e-6)
