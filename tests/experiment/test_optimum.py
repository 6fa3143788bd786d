from __future__ import annotations

import numpy as np
import pytest

from fg_gcs.experiment import ours
from fg_gcs.experiment.flights import bang_bang_s
from fg_gcs.experiment.optimum import shortest_duration_s
from fg_gcs.experiment.scenes import LIMITS, draws, scene
from fg_gcs.plan.limits import Limits
from fg_gcs.plan.path.swarm_path import LinePath


@pytest.mark.parametrize("way_m", [0.5, 3.0, 19.0, 21.0, 66.4])
def test_a_straight_line_takes_full_acceleration_and_braking(way_m: float) -> None:
    path = LinePath(np.zeros((1, 3)), np.array([[way_m, 0.0, 0.0]]))
    ramp_m = LIMITS.speed_m_s**2 / LIMITS.acceleration_m_s2
    if way_m < ramp_m:
        expected_s = 2.0 * np.sqrt(way_m / LIMITS.acceleration_m_s2)
    else:
        expected_s = way_m / LIMITS.speed_m_s + LIMITS.speed_m_s / LIMITS.acceleration_m_s2
    assert shortest_duration_s(path, LIMITS) == pytest.approx(expected_s, rel=1e-3)  # one cell at the switch


def test_no_way_takes_no_time() -> None:
    assert shortest_duration_s(LinePath(np.zeros((2, 3)), np.zeros((2, 3))), LIMITS) == 0.0


def test_our_timing_does_not_beat_the_reference_and_the_reference_not_the_straight_line() -> None:
    for made in draws(5, 3):
        planned = ours.plan(made)
        shortest_s = shortest_duration_s(planned.path, LIMITS)
        assert planned.plan.duration_s > 0.999 * shortest_s  # the reference's grid
        assert shortest_s > bang_bang_s(made)


def test_tighter_limits_take_longer() -> None:
    path = ours.plan(scene((10.0, 10.0, 10.0))).path
    times = [shortest_duration_s(path, Limits(10.0, acceleration)) for acceleration in (5.0, 4.0, 2.0, 1.0)]
    assert times == sorted(times)
    assert times[-1] > 1.9 * times[0]  # where acceleration alone binds, time goes with its root
