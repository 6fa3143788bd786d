"""The command ``recover``: brings down what a run left flying, and puts the vehicles' own parameters back."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fg_gcs.console.codes import ExitCode
from fg_gcs.flight.snapshot import RunEvent
from fg_gcs.link.clock import make_loop
from fg_gcs.run.observing import Observer
from fg_gcs.run.recovering import Recovered, RecoverOptions, RecoverResult, recover


class _Told(Observer):
    """Tells people what happens."""

    def event(self, event: RunEvent) -> None:
        """Print it."""
        print(f"{event.time_s:8.1f} s  {event.text}", file=sys.stderr, flush=True)


def run(chosen: argparse.Namespace, connect: tuple[str, ...]) -> ExitCode:
    """Recover; show what was found and what became of it.

    Args:
        chosen: the options.
        connect: where vehicles are; empty: where they were.

    Raises:
        LinkError: nobody answered, or a port is taken.
        MissionError: a signing key cannot be had.
    """
    options = RecoverOptions(connect, chosen.wait, chosen.logs, chosen.state, tuple(chosen.signing_key or ()))
    with asyncio.Runner(loop_factory=lambda: make_loop(1.0)) as runner:
        result = runner.run(recover(options, [_Told()]))
    _show(result)
    if chosen.json:
        figures = {
            "vehicles": [each._asdict() for each in result.vehicles],
            "missing": result.missing,
            "not_down": result.not_down,
            "unreadable": result.unreadable,
            "alive": result.alive,
            "log": None if result.folder is None else str(result.folder),
        }
        print(json.dumps(figures), flush=True)
    if result.alive:
        return ExitCode.BAD_INPUT
    return ExitCode.DONE if result.in_order else ExitCode.NOT_IN_ORDER


def _show(result: RecoverResult) -> None:
    console = Console(stderr=True, highlight=False)
    if result.alive:
        text = f"fg-gcs: these vehicles belong to a run that is alive, {result.alive}; nothing is touched"
        console.print(escape(text))
        return
    titles = [name.replace("_", " ") for name in Recovered._fields]
    table = Table(*titles)
    for each in result.vehicles:
        table.add_row(*(escape(cell) if isinstance(cell, str) else "yes" if cell else "no" for cell in each))
    console.print(table)
    for name in result.unreadable:
        text = f"fg-gcs: {name} cannot be read: a vehicle may still have what was set for a flight"
        console.print(escape(f"{text}; parameters.json in that run's folder has its own values"))
    for name in result.missing:
        console.print(escape(f"vehicle {name} was not heard; what was set for a flight is still set on it"))
