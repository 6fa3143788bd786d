"""The command ``fly``: what people see of a flight, and how they stop it."""

from __future__ import annotations

import asyncio
import gc
import json
import math
import signal
import sys
import traceback
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

from fg_gcs.console.codes import ExitCode
from fg_gcs.console.nonblocking import unhurried_errors
from fg_gcs.console.plan import tell_if_not_built
from fg_gcs.console.terminal import PatientConsole, Terminal, closing
from fg_gcs.errors import MissionError
from fg_gcs.flight.director import Director
from fg_gcs.mission import load_mission
from fg_gcs.run.flying import FlyOptions, Outcome, RunResult, fly_blocking, prepare
from fg_gcs.run.observing import Observer

CODES = {
    Outcome.COMPLETED: ExitCode.DONE,
    Outcome.ABORTED: ExitCode.ABORTED,
    Outcome.NOT_FLOWN: ExitCode.BAD_INPUT,
    Outcome.NO_ANSWER: ExitCode.NO_ANSWER,
    Outcome.FAILED: ExitCode.INTERNAL_ERROR,
}


@dataclass(frozen=True)
class Manner:
    """How the command shows a flight."""

    speed: float = 1.0  # of time; infinite: virtual time
    json: bool = False


def fly(path: Path, options: FlyOptions, manner: Manner) -> ExitCode:
    """Fly a mission file, show it to people, and return the exit code.

    Raises:
        MissionError: the file or the options are at fault; nothing was begun.
        PlanError: the mission's numbers are absurd; likewise.
    """
    mission = load_mission(path)
    virtual = math.isinf(manner.speed)
    if virtual and (options.connect or mission.connections()):
        what = "--connect" if options.connect else "[networks]"
        raise MissionError(f"--speed max: only the built-in simulator lives in virtual time; leave {what} out")
    tell_if_not_built([mission])
    prepare(mission)
    gc.collect()
    gc.freeze()  # what is loaded by now stays: a full collection in flight would take tens of milliseconds
    result: RunResult | None = None
    with suppress(BrokenPipeError), ExitStack() as stack:  # a reader that has gone changes no exit code
        console = PatientConsole(file=sys.stderr if virtual else unhurried_errors(stack), highlight=False)
        terminal = stack.enter_context(Terminal(mission.description, console, live=not virtual and console.is_terminal))
        result = fly_blocking(mission, options, (terminal, _Signals()), speed=manner.speed)
        if result.outcome in (Outcome.COMPLETED, Outcome.ABORTED):
            stack.callback(closing, console, result.summary, mission)  # below the picture, which has gone by then
    if result is None:
        return ExitCode.ABORTED
    with suppress(BrokenPipeError):
        if manner.json:
            print(json.dumps(dict(result.summary)), flush=True)
        tell_error(result)
    return code_of(result)


def tell_error(result: RunResult) -> None:
    """Tell people of an error."""
    if result.outcome is Outcome.FAILED and result.error is not None:
        traceback.print_exception(result.error)
        print("fg-gcs: internal error; the lines above belong into a bug report", file=sys.stderr)
    elif result.error is not None:
        print(f"fg-gcs: {result.reason}", file=sys.stderr)


def code_of(result: RunResult) -> ExitCode:
    """Return the exit code that says how a run ended."""
    code = CODES[result.outcome]
    return ExitCode.NOT_IN_ORDER if code in (ExitCode.DONE, ExitCode.ABORTED) and not result.in_order else code


class _Signals(Observer):
    """Every way to be asked to stop leads home; asked again, all land apart, then at once."""

    def started(self, director: Director) -> None:
        """Listen to the signals that ask a program to end."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            loop.add_signal_handler(number, director.interrupt, f"stopped by {number.name}")
