"""The paper's several targets: one source at their mean, and a formation that grows to hold them all."""

from __future__ import annotations

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.experiment import ours
from fg_gcs.experiment.baseline import Progress, Stopwatch, run_paper_way
from fg_gcs.experiment.scenes import LEADERS, crowd
from fg_gcs.experiment.tables import Column, ResultTable

SEED = 2103  # arbitrary; the paper prints none

TEXT = (
    "Ten targets drawn from N(200, 100) m along every axis, seeded. The source of flux stands at their mean, and "
    "the square grows from 5 m to `(2 d_max + 10 m) / sqrt(2)`. The paper publishes a figure of this case, but "
    "no numbers. *Held* counts the targets inside the ball whose great circle passes through the leaders."
)
COLUMNS = (
    Column("what"),
    Column("last edge [m]", 1),
    Column("path length [m]", 1),
    Column("flux metric", 4),
    Column("targets held", 0),
    Column("flight [s]", 1),
    Column("search [s]", timed=True),
)


def multi(stopwatch: Stopwatch, progress: Progress, seed: int = SEED) -> ResultTable:
    """Plan for several targets both ways.

    Raises:
        PlanError: ours has no plan.
    """
    made, targets = crowd(seed)
    progress("multi: the paper's way")
    theirs = run_paper_way(made, stopwatch)
    progress("multi: ours")
    ours.search(made)  # warms up
    began = stopwatch()
    ours.search(made)
    seconds = stopwatch() - began
    planned = ours.plan(made)
    figures = ours.path_figures(made, planned.path)
    end_m = planned.plan.sample(np.array([planned.plan.duration_s])).position_m[0, :LEADERS]
    rows = (
        (
            "paper's way here",
            float(np.linalg.norm(np.diff(theirs.path.leaders_enu_m[-1][:2], axis=0))),
            theirs.path.length_m,
            theirs.flux_metric(made),
            _held(theirs.path.leaders_enu_m[-1], targets),
            None if theirs.plan is None else theirs.plan.duration_s,
            theirs.search_s,
        ),
        (
            "ours",
            made.last_edge_m,
            figures.length_m,
            figures.flux_metric,
            _held(end_m, targets),
            planned.plan.duration_s,
            seconds,
        ),
    )
    return ResultTable("multi", "Several targets", TEXT, COLUMNS, rows)


def _held(leaders_m: Array, targets_m: Array) -> float:
    centre = leaders_m.mean(axis=0)
    radius_m = np.linalg.norm(leaders_m - centre, axis=1).mean()
    return float((np.linalg.norm(targets_m - centre, axis=1) <= radius_m).sum())
