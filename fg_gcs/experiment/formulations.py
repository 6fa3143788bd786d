"""Both formulations of Flux Guided planning side by side: one rigid body, and leaders that move freely."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from statistics import mean, median
from typing import NamedTuple

import numpy as np

from fg_gcs.core.separation import Fence
from fg_gcs.experiment import ours
from fg_gcs.experiment.baseline import Progress, Stopwatch
from fg_gcs.experiment.scenes import LIMITS, TARGETS, Scene, draws, scene
from fg_gcs.experiment.tables import Cell, Column, ResultTable
from fg_gcs.plan.formulations import FORMULATIONS, FormulationName
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.path.swarm_path import SwarmPath
from fg_gcs.plan.trajectory import timed
from fg_gcs.plan.verification import check

SEED = 2103  # arbitrary
DRAWS = 100
REPEATS = 5  # of each scene, the formulations in turn; medians are shown

OPEN = Fence((-ours.OPEN_M,) * 3, (ours.OPEN_M,) * 3)
TEXT = (
    "The rigid formulation is the default; the free one is the paper's own, with the separation of pairs that it "
    "lacks. Both plan to the paper's targets and to fresh draws from the ranges of its sensitivity study, at one "
    "size. For the draws, lengths and times are means, and all other figures are the worst. *Coverage* is the "
    "smallest once the face has turned to the target; *separation* is the closest pair, as a share of the "
    "closest pair in the formation's own shape."
)
COLUMNS = (
    Column("target [m]"),
    Column("formulation"),
    Column("path length [m]", 1),
    Column("flux metric", 4),
    Column("coverage", 4),
    Column("separation", 4),
    Column("flight [s]", 2),
    Column("search [s]", timed=True),
    Column("whole plan [s]", timed=True),
)


class _Lap(NamedTuple):
    """One plan."""

    path: SwarmPath
    duration_s: float
    search_s: float
    plan_s: float


class _Run(NamedTuple):
    """One scene by one formulation."""

    figures: ours.PathFigures
    duration_s: float
    search_s: float
    plan_s: float


def formulations(stopwatch: Stopwatch, progress: Progress, count: int = DRAWS, repeats: int = REPEATS) -> ResultTable:
    """Plan the paper's targets and ``count`` random scenes by both formulations.

    Raises:
        PlanError: a scene has no plan.
    """
    flights = [scene(target_m) for target_m in TARGETS]
    for name in FORMULATIONS:
        _lap(flights[0], name, stopwatch)  # warms up: what is compiled, loaded or cached
    rows: list[tuple[Cell, ...]] = []
    for made in flights:
        progress(f"formulations: ({made.name})")
        rows += _rows(made.name, [_runs(made, stopwatch, repeats)])
    progress(f"formulations: {count} random scenes")
    drawn = [replace(made, last_edge_m=made.edge_m) for made in draws(count, SEED)]
    rows += _rows(f"{count} draws", [_runs(made, stopwatch, repeats) for made in drawn])
    return ResultTable("formulations", "Two formulations", TEXT, COLUMNS, tuple(rows))


def _rows(title: str, runs: Sequence[dict[FormulationName, _Run]]) -> Iterator[tuple[Cell, ...]]:
    for name in FORMULATIONS:
        chosen = [of[name] for of in runs]
        yield (
            title,
            name,
            mean(run.figures.length_m for run in chosen),
            min(run.figures.flux_metric for run in chosen),
            min(run.figures.coverage_after_facing for run in chosen),
            min(run.figures.separation_ratio for run in chosen),
            mean(run.duration_s for run in chosen),
            mean(run.search_s for run in chosen),
            mean(run.plan_s for run in chosen),
        )


def _runs(made: Scene, stopwatch: Stopwatch, repeats: int) -> dict[FormulationName, _Run]:
    """Plan a scene several times, the formulations in turn, and keep the medians of the times."""
    laps = [{name: _lap(made, name, stopwatch) for name in FORMULATIONS} for _ in range(repeats)]
    return {
        name: _Run(
            ours.path_figures(made, laps[0][name].path),
            laps[0][name].duration_s,
            median(lap[name].search_s for lap in laps),
            median(lap[name].plan_s for lap in laps),
        )
        for name in FORMULATIONS
    }


def _lap(made: Scene, name: FormulationName, stopwatch: Stopwatch) -> _Lap:
    formation = made.formation
    rules = Rules(LIMITS, ours.SEPARATION_SHARE * formation.smallest_separation_m, OPEN)
    began = stopwatch()
    searched = FORMULATIONS[name](formation, made.start, made.target_enu_m, 0.0, made.start.scale, OPEN)
    found = stopwatch()
    path = searched.swarm_path(np.arange(len(formation.slots_m)))
    plan = check([timed(path, LIMITS)], rules, made.target_enu_m)
    return _Lap(path, plan.duration_s, found - began, stopwatch() - began)
