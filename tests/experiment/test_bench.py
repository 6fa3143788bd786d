from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import asdict

import numpy as np
import pytest

from fg_gcs.core.formation import Pose
from fg_gcs.experiment import ours
from fg_gcs.experiment.bench import Size, bench_plan
from fg_gcs.experiment.scenes import LIMITS, draws, scene
from fg_gcs.plan.limits import Limits
from fg_gcs.plan.path.swarm_path import LinePath
from fg_gcs.plan.trajectory import timed

KEYS = [
    "fg_speedup_median",
    "fg_speedup_worst",
    "plan_speedup_median",
    "fg_time_ms_median",
    "plan_time_ms_median",
    "flux_metric_worst_rows",
    "flux_metric_worst_draws",
    "path_length_m",
    "separation_ratio_worst",
    "speed_ratio_worst",
    "acceleration_ratio_worst",
    "duration_ratio_worst",
    "flight_time_40_s",
    "leaders_64_ratio",
    "followers_1000_ms",
    "memory_1000_mb",
]


def counting() -> Callable[[], float]:
    """Return a stopwatch that advances by one second with each look: everything takes one second."""
    looks = itertools.count()
    return lambda: float(next(looks))


def test_the_bench_holds_exactly_its_keys_and_takes_its_time_from_the_stopwatch() -> None:
    told: list[str] = []
    size = Size(targets=((10.0, 10.0, 10.0),), rows=1, draws=3, repeats=1, quick_repeats=1)
    figures = asdict(bench_plan(counting(), told.append, size))
    assert list(figures) == KEYS
    assert list(figures["path_length_m"]) == ["10,10,10"]
    assert figures["fg_speedup_median"] == figures["fg_speedup_worst"] == figures["leaders_64_ratio"] == 1.0
    assert figures["plan_speedup_median"] == 2.0  # the paper's way looks at its watch once more in between
    assert figures["fg_time_ms_median"] == figures["plan_time_ms_median"] == 1000.0
    assert figures["followers_1000_ms"] == 0.0
    assert 0.0 < figures["memory_1000_mb"] <= 200.0
    assert min(figures["flux_metric_worst_rows"], figures["flux_metric_worst_draws"]) >= 0.999
    assert figures["duration_ratio_worst"] >= 0.999  # nothing beats the reference by more than its grid
    assert any("paper's way" in line for line in told)


def test_the_separation_ratio_counts_at_the_size_of_the_moment() -> None:
    made = scene((10.0, 10.0, 10.0))
    formation = made.formation
    swarm = np.stack([formation.place(Pose(np.full(3, shift), np.eye(3), scale)) for shift, scale in ((0, 1), (9, 3))])
    assert ours.separation_ratio(swarm, formation) == pytest.approx(1.0)
    swarm[1, -1] = swarm[1, 4]  # the last follower on the first
    assert ours.separation_ratio(swarm, formation) == 0.0


def test_path_figures_are_those_of_a_rigid_formation() -> None:
    for made in draws(4, 11):
        planned = ours.plan(made)
        figures = ours.path_figures(made, planned.path)
        assert figures.length_m >= 4.0 * 0.99 * np.linalg.norm(made.target_enu_m - made.start.centre_enu_m)
        assert figures.separation_ratio == pytest.approx(1.0)
        assert 0.9 < figures.coverage_after_facing <= 1.0


def test_limit_ratios_see_the_norms() -> None:
    slanted = timed(LinePath(np.zeros((1, 3)), np.array([[30.0, 40.0, 0.0]])), LIMITS)
    ratios = ours.limit_ratios(slanted)
    assert ratios == pytest.approx((1.0, 1.0), abs=5e-3)  # the polygon inside the disc of accelerations
    tighter = ours.limit_ratios(slanted, Limits(LIMITS.speed_m_s / 2.0, LIMITS.acceleration_m_s2 / 4.0))
    assert tighter == pytest.approx((2.0 * ratios.speed, 4.0 * ratios.acceleration))
