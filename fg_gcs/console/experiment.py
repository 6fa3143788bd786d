"""The commands ``experiment`` and ``bench plan``: the planner beside the paper."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as Drawn

from fg_gcs.errors import MissionError
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
