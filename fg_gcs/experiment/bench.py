"""The planner's benchmark: the paper's way against ours in one process, in turn, and what a plan promises, measured.

Speeds come as ratios of medians within one run; a ratio survives a change of machine better than a time does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import NamedTuple

import numpy as np

from fg_gcs.experiment import ours
from fg_gcs.experiment.baseline import Progress, Stopwatch, run_paper_way, seconds
from fg_gcs.experiment.optimum import shortest_duration_s
from fg_gcs.experiment.scaling import followers_ms, leaders_ratio, memory_mb
from fg_gcs.experiment.scenes import LIMITS, TARGETS, Scene, draws, printed_rows, scene

SEED = 2103  # arbitrary
FLOWN = (40.0, 40.0, 40.0)  # the flight whose time is told


@dataclass(frozen=True)
class Size:
    """How much is measured; the default is the benchmark, tests take less."""

    targets: tuple[tuple[float, float, float], ...] = TARGETS
    rows: int = 50  # printed rows
    draws: int = 1000  # random scenes for flux metric and separation
    repeats: int = 3  # runs of the two ways in turn
    quick_repeats: int = 31  # runs of what takes milliseconds


@dataclass(frozen=True)
class PlanBench:
    """The figures, by the names of the command line's JSON."""

    fg_speedup_median: float
    fg_speedup_worst: float
    plan_speedup_median: float
    fg_time_ms_median: float
    plan_time_ms_median: float
    flux_metric_worst_rows: float
    flux_metric_worst_draws: float
    path_length_m: dict[str, float]  # by target
    separation_ratio_worst: float  # of both formulations
    speed_ratio_worst: float
    acceleration_ratio_worst: float
    duration_ratio_worst: float
    flight_time_40_s: float
    leaders_64_ratio: float
    followers_1000_ms: float
    memory_1000_mb: float


class _Race(NamedTuple):
    """Medians of one scene [s]."""

    their_search: float
    their_plan: float
    our_search: float
    our_plan: float


class _Promises(NamedTuple):
    """Worst ratios over some plans."""

    speed: float
    acceleration: float
    duration: float


def bench_plan(stopwatch: Stopwatch, progress: Progress, size: Size | None = None) -> PlanBench:
    """Measure everything.

    Args:
        stopwatch: returns seconds.
        progress: told what is being measured.
        size: how much; None: all of it.

    Raises:
        PlanError: a scene has no plan.
    """
    chosen = size or Size()
    flights = [scene(target_m) for target_m in chosen.targets]
    rows = [row.scene for row in printed_rows()[: chosen.rows]]
    progress("warming up: what is compiled, loaded or cached")
    run_paper_way(scene(TARGETS[-2]), stopwatch)
    for made in (*flights, *rows):
        ours.plan(made)
    races = _races((*flights, *rows), chosen.repeats, stopwatch, progress)
    progress("limits at 1 kHz, and durations against a fine grid")
    plans = [ours.plan(made) for made in (*flights, *rows)]
    promises = _promises(plans)
    metrics = [ours.path_figures(each.scene, each.path) for each in plans]
    progress(f"{chosen.draws} random scenes")
    scenes = draws(chosen.draws, SEED)
    drawn = [ours.path_figures(made, ours.plan(made).path) for made in scenes]
    progress(f"{chosen.draws} random scenes with freely moving leaders")
    freed = [ours.free_separation_ratio(made) for made in scenes]
    progress("scaling with leaders and followers")
    speedups = [race.their_search / race.our_search for race in races]
    return PlanBench(
        fg_speedup_median=median(speedups),
        fg_speedup_worst=min(speedups),
        plan_speedup_median=median(race.their_plan / race.our_plan for race in races),
        fg_time_ms_median=1e3 * median(race.our_search for race in races),
        plan_time_ms_median=1e3 * median(race.our_plan for race in races),
        flux_metric_worst_rows=min(figures.flux_metric for figures in metrics[len(flights) :]),
        flux_metric_worst_draws=min(figures.flux_metric for figures in drawn),
        path_length_m={made.name: each.length_m for made, each in zip(flights, metrics, strict=False)},
        separation_ratio_worst=min(*(figures.separation_ratio for figures in drawn), *freed),
        speed_ratio_worst=promises.speed,
        acceleration_ratio_worst=promises.acceleration,
        duration_ratio_worst=promises.duration,
        flight_time_40_s=ours.plan(scene(FLOWN)).plan.duration_s,
        leaders_64_ratio=leaders_ratio(stopwatch, chosen.quick_repeats),
        followers_1000_ms=followers_ms(stopwatch, chosen.repeats),
        memory_1000_mb=memory_mb(),
    )


def _races(scenes: Sequence[Scene], repeats: int, stopwatch: Stopwatch, progress: Progress) -> list[_Race]:
    races = []
    for number, made in enumerate(scenes, start=1):
        progress(f"the paper's way against ours: {made.name} ({number} of {len(scenes)})")
        laps = []
        for _ in range(repeats):
            theirs = run_paper_way(made, stopwatch)
            mine_s = seconds(partial(ours.search, made), stopwatch)
            plan_s = seconds(partial(ours.plan, made), stopwatch)
            laps.append((theirs.search_s, theirs.total_s, mine_s, plan_s))
        races.append(_Race(*np.median(laps, axis=0).tolist()))
    return races


def _promises(plans: Sequence[ours.Planned]) -> _Promises:
    ratios = [ours.limit_ratios(each.plan) for each in plans]
    durations = [each.plan.duration_s / shortest_duration_s(each.path, LIMITS) for each in plans]
    return _Promises(max(each.speed for each in ratios), max(each.acceleration for each in ratios), max(durations))
