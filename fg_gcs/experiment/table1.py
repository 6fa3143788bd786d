"""The paper's comparison of path lengths: least squares with two weights against flux guiding."""

from __future__ import annotations

import numpy as np

from fg_gcs.experiment import ours
from fg_gcs.experiment.baseline import Progress
from fg_gcs.experiment.baselines.least_squares import FREE_SIZE, HELD_SIZE, plan_least_squares
from fg_gcs.experiment.baselines.reference_planner import plan_leaders
from fg_gcs.experiment.published import FLUX_GUIDED, LENGTHS_M
from fg_gcs.experiment.scenes import LEADERS, scene
from fg_gcs.experiment.tables import Cell, Column, ResultTable

TEXT = (
    "Way of the four leaders together, from a 5 m square that faces +x. The published lengths stand beside "
    "targets of 40 m, but belong to these. *Here* is the paper's method written anew: least squares as printed, "
    "flux guiding by SciPy's `trust-constr`, which wanders a little differently with each version of SciPy. "
    "*Coverage* is the smallest flux of ours after the first turn, as a share of the largest possible at that "
    "distance."
)
COLUMNS = (
    Column("target [m]"),
    Column("method"),
    Column("published [m]", 0),
    Column("paper's way here [m]", 1),
    Column("ours [m]", 1),
    Column("straight line [m]", 1),
    Column("ours: flux metric", 4),
    Column("ours: coverage", 4),
)


def table1(progress: Progress) -> ResultTable:
    """Measure all lengths.

    Raises:
        PlanError: a method does not reach a target.
    """
    rows: list[tuple[Cell, ...]] = []
    for target_m, published_m in LENGTHS_M.items():
        made = scene(target_m)
        straight_m = LEADERS * float(np.linalg.norm(made.target_enu_m - made.start.centre_enu_m))
        for baseline in (FREE_SIZE, HELD_SIZE):
            progress(f"table1: {baseline.name} to ({made.name})")
            path = plan_least_squares(made.leaders_enu_m, made.target_enu_m, baseline)
            rows.append(
                (made.name, baseline.name, published_m[baseline.name], path.length_m, None, straight_m, None, None)
            )
        progress(f"table1: {FLUX_GUIDED} to ({made.name})")
        theirs = plan_leaders(made.leaders_enu_m, made.target_enu_m, made.last_edge_m)
        figures = ours.path_figures(made, ours.plan(made).path)
        rows.append(
            (
                made.name,
                FLUX_GUIDED,
                published_m[FLUX_GUIDED],
                theirs.length_m,
                figures.length_m,
                straight_m,
                figures.flux_metric,
                figures.coverage_after_facing,
            )
        )
    return ResultTable("table1", "Path lengths", TEXT, COLUMNS, tuple(rows))
