"""The commands ``experiment`` and ``bench plan``: the planner beside the paper."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as Drawn

from fg_gcs.errors import MissionError
from fg_gcs.experiment.bench import PlanBench, bench_plan
from fg_gcs.experiment.results import experiments, write_page, write_tables
from fg_gcs.experiment.tables import NOTHING, ResultTable


def experiment(name: str, out: Path) -> int:
    """Run one experiment, or all; show its tables, write them as CSV, and after all of them the page of results.

    Raises:
        MissionError: the folder cannot be written.
        PlanError: a scene has no plan.
    """
    available = experiments(time.perf_counter, tell, out)
    chosen = available if name == "all" else {name: available[name]}
    results = []
    try:
        out.mkdir(parents=True, exist_ok=True)  # before minutes of work, not after
        for run in chosen.values():
            result = run()
            results.append(result)
            for table in result.tables:
                show(table)
            for path in write_tables(result.tables, out):
                print(f"written: {path}", file=sys.stderr)
        if name == "all":
            print(f"written: {write_page(results, out)}", file=sys.stderr)
    except OSError as error:
        raise MissionError(f"--out {out}: {error.strerror or error}") from error
    return 0


def bench(*, as_json: bool) -> int:
    """Run the planner's benchmark; programs read one JSON object on the last line of stdout.

    Raises:
        PlanError: a scene has no plan.
    """
    figures = bench_plan(time.perf_counter, tell)
    print(_words(figures), file=sys.stderr)
    if as_json:
        print(json.dumps(asdict(figures)), flush=True)
    return 0


def show(table: ResultTable) -> None:
    """Draw a table for people on standard error."""
    titles = (escape(column.title) for column in table.columns)  # units in brackets are no markup
    drawn = Drawn(*titles, title=table.title, title_justify="left")
    for row in table.written():
        drawn.add_row(*(escape(cell) or NOTHING for cell in row))
    Console(stderr=True, highlight=False).print(drawn)


def tell(line: str) -> None:
    """Tell people on standard error what is being done."""
    print(line, file=sys.stderr, flush=True)


def _words(figures: PlanBench) -> str:
    lengths = ", ".join(f"({target}) {metres:.1f} m" for target, metres in figures.path_length_m.items())
    return "\n".join(
        (
            f"search       {figures.fg_time_ms_median:.2f} ms, {figures.fg_speedup_median:.0f} times as fast as the "
            f"paper's way (worst {figures.fg_speedup_worst:.0f})",
            f"whole plan   {figures.plan_time_ms_median:.2f} ms, {figures.plan_speedup_median:.0f} times as fast",
            f"flux metric  at least {figures.flux_metric_worst_rows:.5f} on the printed rows, "
            f"{figures.flux_metric_worst_draws:.5f} on random scenes",
            f"lengths      {lengths}",
            f"separation   at least {figures.separation_ratio_worst:.4f} of the formation's own",
            f"limits       speed {figures.speed_ratio_worst:.4f}, acceleration {figures.acceleration_ratio_worst:.4f} "
            "of the limit at most",
            f"duration     at most {figures.duration_ratio_worst:.4f} of the optimum; "
            f"to (40,40,40) {figures.flight_time_40_s:.2f} s",
            f"growth       64 leaders take {figures.leaders_64_ratio:.2f} times the time of 4; "
            f"1000 followers add {figures.followers_1000_ms:.1f} ms and {figures.memory_1000_mb:.0f} MB",
        )
    )
