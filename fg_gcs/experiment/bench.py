"""The planner's benchmark: the paper's way against ours in one process, in turn, and what a plan promises, measured.

Speeds come as ratios of medians within one run; a ratio survives a change of machine better than a time does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import NamedTuple

import numpy as np

from fg_gcs.core.formation import Formation, hemisphere
from fg_gcs.experiment import ours
from fg_gcs.experiment.baseline import Progress, Stopwatch, run_paper_way
from fg_gcs.experiment.optimum import shortest_duration_s
from fg_gcs.experiment.scenes import EDGE_M, LEADERS, LIMITS, TARGETS, Scene, draws, printed_rows, scene
from fg_gcs.plan.flux_guided import plan_path

SEED = 2103  # arbitrary
FLOWN = (40.0, 40.0, 40.0)  # the flight whose time is told
SCALING = (50.0, 50.0, 50.0)  # the flight on which growth is measured
MANY_LEADERS, MANY_FOLLOWERS = 64, 1000


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
    separation_ratio_worst: float
    speed_ratio_worst: float
    acceleration_ratio_worst: float
    duration_ratio_worst: float
    flight_time_40_s: float
    leaders_64_ratio: float
    followers_1000_ms: float


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
    drawn = [ours.path_figures(made, ours.plan(made).path) for made in draws(chosen.draws, SEED)]
    progress("growth with leaders and followers")
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
        separation_ratio_worst=min(figures.separation_ratio for figures in drawn),
        speed_ratio_worst=promises.speed,
        acceleration_ratio_worst=promises.acceleration,
        duration_ratio_worst=promises.duration,
        flight_time_40_s=ours.plan(scene(FLOWN)).plan.duration_s,
        leaders_64_ratio=_leaders_ratio(stopwatch, chosen.quick_repeats),
        followers_1000_ms=_followers_ms(stopwatch, chosen.repeats),
    )


def _races(scenes: Sequence[Scene], repeats: int, stopwatch: Stopwatch, progress: Progress) -> list[_Race]:
    races = []
    for number, made in enumerate(scenes, start=1):
        progress(f"the paper's way against ours: {made.name} ({number} of {len(scenes)})")
        laps = []
        for _ in range(repeats):
            theirs = run_paper_way(made, stopwatch)
            mine_s = _seconds(partial(ours.search, made), stopwatch)
            plan_s = _seconds(partial(ours.plan, made), stopwatch)
            laps.append((theirs.search_s, theirs.total_s, mine_s, plan_s))
        races.append(_Race(*np.median(laps, axis=0).tolist()))
    return races


def _promises(plans: Sequence[ours.Planned]) -> _Promises:
    ratios = [ours.limit_ratios(each.plan) for each in plans]
    durations = [each.plan.duration_s / shortest_duration_s(each.path, LIMITS) for each in plans]
    return _Promises(max(each.speed for each in ratios), max(each.acceleration for each in ratios), max(durations))


def _leaders_ratio(stopwatch: Stopwatch, repeats: int) -> float:
    """Time of the search for 64 leaders over that for 4 on the same circle."""
    made = scene(SCALING)
    radius_m = EDGE_M / np.sqrt(2.0)
    rims = [hemisphere(count, 0, float(2.0 * radius_m * np.sin(np.pi / count))) for count in (LEADERS, MANY_LEADERS)]
    laps = [
        [_seconds(partial(plan_path, rim, made.start, made.target_enu_m), stopwatch) for rim in rims]
        for _ in range(repeats)
    ]
    few_s, many_s = np.median(laps, axis=0)
    return float(many_s / few_s)


def _followers_ms(stopwatch: Stopwatch, repeats: int) -> float:
    """Milliseconds that 1000 followers on a lattice behind the face add to a whole plan."""
    made = scene(SCALING)
    side = round(MANY_FOLLOWERS ** (1.0 / 3.0))
    axis = EDGE_M * np.arange(side)
    lattice = np.stack(np.meshgrid(-EDGE_M - axis, axis - axis.mean(), axis - axis.mean()), axis=-1).reshape(-1, 3)
    bare = hemisphere(LEADERS, 0, EDGE_M)
    crowded = Formation(bare.leaders_m, lattice)
    laps = []
    for _ in range(repeats + 1):
        laps.append([_seconds(partial(ours.plan_formation, made, each), stopwatch) for each in (bare, crowded)])
    few_s, many_s = np.median(laps[1:], axis=0)  # the first warms up
    return float(1e3 * (many_s - few_s))


def _seconds(run: Callable[[], object], stopwatch: Stopwatch) -> float:
    began = stopwatch()
    run()
    return stopwatch() - began
