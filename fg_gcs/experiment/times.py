"""The paper's planning times: two flights of nine vehicles, timing included."""

from __future__ import annotations

from statistics import median

from fg_gcs.experiment import ours
from fg_gcs.experiment.baseline import Progress, Stopwatch, run_paper_way
from fg_gcs.experiment.published import PLAN_TIMES_S
from fg_gcs.experiment.scenes import scene
from fg_gcs.experiment.tables import Cell, Column, ResultTable

REPEATS = 3  # the two ways in turn, as often; medians are shown

TEXT = (
    "Time to plan for nine vehicles, from the start pose to verified trajectories: as published, and both ways "
    "in one process, in turn. Times of *here* and *ours* belong to the machine and the run that wrote this page."
)
COLUMNS = (
    Column("target [m]"),
    Column("published [s]", 2),
    Column("paper's way here [s]", timed=True),
    Column("ours [s]", timed=True),
    Column("ours: search alone [s]", timed=True),
    Column("times faster than here", timed=True),
)


def times(stopwatch: Stopwatch, progress: Progress, repeats: int = REPEATS) -> ResultTable:
    """Measure both flights."""
    rows: list[tuple[Cell, ...]] = []
    for target_m, published_s in PLAN_TIMES_S.items():
        made = scene(target_m)
        ours.plan(made)  # warms up: what is compiled, loaded or cached
        theirs_s, plan_s, search_s = [], [], []
        for repeat in range(repeats):
            progress(f"times: ({made.name}), run {repeat + 1} of {repeats}")
            theirs_s.append(run_paper_way(made, stopwatch).total_s)
            began = stopwatch()
            ours.search(made)
            found = stopwatch()
            ours.plan(made)
            search_s.append(found - began)
            plan_s.append(stopwatch() - found)
        theirs, mine = median(theirs_s), median(plan_s)
        rows.append((made.name, published_s, theirs, mine, median(search_s), theirs / mine))
    return ResultTable("times", "Planning times", TEXT, COLUMNS, tuple(rows))
