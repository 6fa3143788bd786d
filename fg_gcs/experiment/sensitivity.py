"""The paper's sensitivity study: its printed rows planned again, and fresh draws from the same ranges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.experiment import ours
from fg_gcs.experiment.baseline import Progress, Stopwatch, run_paper_way
from fg_gcs.experiment.published import DRAWN_METRIC, DRAWN_TIME_S
from fg_gcs.experiment.scenes import PrintedRow, Scene, draws, printed_rows
from fg_gcs.experiment.tables import Cell, Column, ResultTable

DRAWS, SEED = 100, 2103  # as many as the paper's; the seed is arbitrary

ROWS_TEXT = (
    "The printed rows; each goes from a square whose edge is the printed separation to a square whose edge is "
    "twice the target's radius. Solving times are those of the search alone; those of *here* and *ours* belong "
    "to the machine and the run that wrote this page."
)
ROWS = (
    Column("target [m]"),
    Column("separation [m]", 0),
    Column("target radius [m]", 0),
    Column("published metric", 2),
    Column("paper's way here, metric", 3),
    Column("our metric", 4),
    Column("published [s]", 2),
    Column("paper's way here [s]", timed=True),
    Column("ours [s]", timed=True),
)
SUMMARY_TEXT = (
    "Flux metric and solving time over all printed rows, and over fresh seeded draws from the paper's ranges: "
    "targets within 100 m along every axis, separations of 5 to 20 m, radii of 2.5 to 10 m. *Separation* is the "
    "closest pair of any nine vehicles at any time, as a share of the closest pair in the formation's own shape "
    "at that size."
)
SUMMARY = (
    Column("what"),
    Column("plans", 0),
    Column("metric, mean", 4),
    Column("deviation", 4),
    Column("worst", 4),
    Column("time, mean [s]", timed=True),
    Column("deviation [s]", timed=True),
    Column("separation, worst", 4),
)


def sensitivity(
    stopwatch: Stopwatch, progress: Progress, rows: Sequence[PrintedRow] | None = None, count: int = DRAWS
) -> tuple[ResultTable, ResultTable]:
    """Plan the printed rows both ways and fresh draws our way; return the summary and the rows.

    Args:
        stopwatch: returns seconds.
        progress: told before each row.
        rows: printed rows to plan; None: all.
        count: fresh draws.
    """
    chosen = printed_rows() if rows is None else rows
    ours.search(chosen[0].scene)  # warms up
    lines: list[tuple[Cell, ...]] = []
    separations = []
    for row in chosen:
        made = row.scene
        progress(f"sensitivity: {made.name} of {len(chosen)}")
        theirs = run_paper_way(made, stopwatch)
        figures, mine_s = _ours(row.scene, stopwatch)
        separations.append(figures.separation_ratio)
        lines.append(
            (
                ",".join(f"{value:g}" for value in made.target_enu_m),
                made.edge_m,
                made.last_edge_m / 2.0,
                row.flux_metric,
                theirs.flux_metric(made),
                figures.flux_metric,
                row.solve_time_s,
                theirs.search_s,
                mine_s,
            )
        )
    progress(f"sensitivity: {count} fresh draws")
    fresh = [_ours(made, stopwatch) for made in draws(count, SEED)]
    published, here, mine = (np.array([line[i] for line in lines], dtype=float) for i in (3, 4, 5))
    solved = [np.array([line[i] for line in lines], dtype=float) for i in (6, 7, 8)]
    drawn = np.array([figures.flux_metric for figures, _ in fresh])
    drawn_s = np.array([seconds for _, seconds in fresh])
    summary = (
        ("published: its own draws", 100.0, *DRAWN_METRIC, None, *DRAWN_TIME_S, None),
        _summed("published: printed rows", published, solved[0], None),
        _summed("paper's way here: printed rows", here, solved[1], None),
        _summed("ours: printed rows", mine, solved[2], min(separations)),
        _summed("ours: fresh draws", drawn, drawn_s, min(figures.separation_ratio for figures, _ in fresh)),
    )
    return (
        ResultTable("sensitivity", "Sensitivity", SUMMARY_TEXT, SUMMARY, summary),
        ResultTable("sensitivity_rows", "Sensitivity, row by row", ROWS_TEXT, ROWS, tuple(lines)),
    )


def _ours(made: Scene, stopwatch: Stopwatch) -> tuple[ours.PathFigures, float]:
    began = stopwatch()
    ours.search(made)
    seconds = stopwatch() - began
    return ours.path_figures(made, ours.plan(made).path), seconds


def _summed(name: str, metrics: Array, seconds: Array, separation: float | None) -> tuple[Cell, ...]:
    return (
        name,
        float(len(metrics)),
        float(metrics.mean()),
        float(metrics.std()),
        float(metrics.min()),
        float(seconds.mean()),
        float(seconds.std()),
        separation,
    )
