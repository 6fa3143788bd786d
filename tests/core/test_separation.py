from __future__ import annotations

import numpy as np
import pytest

from fg_gcs.core.separation import Fence, closest_approach, smallest_over_time


def test_two_vehicles_that_pass_each_other_between_samples() -> None:
    positions = np.array([[(0, 0, 0), (10, 1, 0)], [(10, 0, 0), (0, 1, 0)]], dtype=float)
    found = closest_approach(positions, np.array([2.0, 4.0]))
    assert found.distance_m == pytest.approx(1.0)
    assert found.time_s == pytest.approx(3.0)
    assert found.pair == (0, 1)


def test_straight_motion_is_exact_and_sampling_denser_never_finds_less() -> None:
    for seed in range(20):
        draw = np.random.default_rng(seed)
        times = np.linspace(0.0, 5.0, 9)
        corners = np.cumsum(draw.normal(size=(9, 6, 3)) * 3, axis=0)
        dense_times = np.linspace(0.0, 5.0, 4001)
        dense = np.stack(
            [[np.interp(dense_times, times, corners[:, v, k]) for k in range(3)] for v in range(6)]
        ).transpose(2, 0, 1)
        coarse, fine = closest_approach(corners, times), smallest_over_time(dense).min()
        assert coarse.distance_m == pytest.approx(fine, abs=5e-3)
        assert coarse.distance_m <= fine + 1e-9


def test_many_vehicles_are_searched_in_blocks_without_missing_the_seam() -> None:
    draw = np.random.default_rng(1)
    positions = draw.normal(size=(300, 200, 3)) * 100  # 19,900 pairs: a hundred rows a block
    found = closest_approach(positions, np.arange(300.0))
    assert found.distance_m <= smallest_over_time(positions).min()
    first, second = found.pair
    alone = closest_approach(positions[:, [first, second]], np.arange(300.0))
    assert alone.distance_m == pytest.approx(found.distance_m)


def test_one_instant_is_enough() -> None:
    assert closest_approach(np.array([[(0.0, 0, 0), (3.0, 4.0, 0)]]), np.zeros(1)).distance_m == pytest.approx(5.0)


def test_the_fence_says_by_how_much() -> None:
    fence = Fence((-1.0, -2.0, 3.0), (1.0, 2.0, 9.0))
    assert fence.excess_m(np.array([(0, 0, 4), (0, 0, 2.5), (3, 0, 5), (0, 0, 11.0)])) == pytest.approx([-1, 0.5, 2, 2])
