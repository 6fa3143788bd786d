"""Which vehicles came how close: every pair by brute force, and motions that only meet between their ends."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sitl_mock.physics.arrays import Array
from sitl_mock.physics.constants import load_physics
from sitl_mock.physics.encounters import closest_pair, pairs_within
from sitl_mock.physics.swarm import Swarm

PHYSICS = load_physics()


def brute_force(start_m: Array, end_m: Array) -> dict[tuple[int, int], float]:
    """Least distance of each pair, from many samples and the exact minimum of the quadratic."""
    found = {}
    for i, j in itertools.combinations(range(len(start_m)), 2):
        from_m, way_m = start_m[i] - start_m[j], (end_m[i] - end_m[j]) - (start_m[i] - start_m[j])
        shares = [0.0, 1.0]
        if way_m @ way_m > 0.0:
            shares.append(float(np.clip(-(from_m @ way_m) / (way_m @ way_m), 0.0, 1.0)))
        found[i, j] = min(float(np.linalg.norm(from_m + share * way_m)) for share in shares)
    return found


@given(st.integers(0, 2**32 - 1), st.integers(2, 12), st.floats(0.1, 8.0), st.sampled_from([0.0, 0.1, 5.0]))
def test_pairs_are_those_of_brute_force(seed: int, vehicles: int, limit_m: float, way_m: float) -> None:
    random = np.random.default_rng(seed)
    start_m = random.uniform(-5.0, 5.0, (vehicles, 3))
    end_m = start_m + way_m * random.standard_normal((vehicles, 3))
    expected = brute_force(start_m, end_m)
    close = {(i, j): d for i, j, d in pairs_within(start_m, end_m, limit_m)}
    assert set(close) == {pair for pair, distance in expected.items() if distance < limit_m}
    assert all(close[pair] == pytest.approx(expected[pair], abs=1e-9) for pair in close)
    marked = random.random(vehicles) < 0.7
    counted = {pair: d for pair, d in expected.items() if marked[list(pair)].all()}
    first, second, distance_m = closest_pair(start_m, end_m, marked)
    if counted:
        assert distance_m == pytest.approx(min(counted.values()), abs=1e-9)
        assert counted[first, second] == pytest.approx(distance_m, abs=1e-9)
    else:
        assert (first, second, distance_m) == (-1, -1, math.inf)


def test_vehicles_that_pass_each_other_within_a_step_meet() -> None:
    """Head on at 100 m/s each: 1 m apart before and after, together in between."""
    swarm = Swarm(PHYSICS, np.array([(0.0, 0.0, -20.0), (1.0, 0.1, -20.0), (50.0, 0.0, -20.0)]), 0.0, generator())
    swarm.velocity_m_s[:2, 0] = 100.0, -100.0
    before_m = swarm.position_m.copy()
    swarm.step()
    assert np.linalg.norm(swarm.position_m[0] - swarm.position_m[1]) > 0.9
    (pair,) = swarm.pairs_within(0.5)
    assert pair[:2] == (0, 1)
    assert pair.distance_m == pytest.approx(0.1, abs=1e-9)
    assert swarm.closest_pair(np.array([True, True, True])) == pair
    assert swarm.closest_pair(np.array([True, False, False])) is None
    far = swarm.closest_pair(np.array([True, False, True]))
    assert far is not None
    assert far[:2] == (0, 2)
    np.testing.assert_allclose(before_m[2, :2], swarm.position_m[2, :2])


def generator() -> np.random.Generator:
    return np.random.default_rng(0)
