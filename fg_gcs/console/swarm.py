"""The command ``swarm``: starts SITL instances, shows what each waits for, and watches them until it is stopped."""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import shlex
import signal
import sys
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from fg_gcs.console.codes import ExitCode
from fg_gcs.console.nonblocking import unhurried_errors
from fg_gcs.console.terminal import PatientConsole, say
from fg_gcs.core.frames import Geodetic
from fg_gcs.errors import MissionError, VehicleError
from fg_gcs.link.clock import make_loop
from fg_gcs.mission.model import DEFAULT_ORIGIN
from fg_gcs.sitl.instances import Instance, SwarmOptions, numbered
from fg_gcs.sitl.layout import Layout, homes, places, read_places
from fg_gcs.sitl.swarm import Listener, Member, Stage, Swarm, started

FOLDER: Final = Path("sitl")
COLOURS: Final = {Stage.STARTING: "dim", Stage.BOOTING: "yellow", Stage.READY: "green", Stage.ENDED: "bold red"}
SPACING_M: Final = 6.0  # as missions for real vehicles have it


def options_of(chosen: argparse.Namespace, autopilot: str) -> SwarmOptions:
    """Return how instances are to be started, by the options of ``swarm`` or of ``fly --swarm``.

    Raises:
        MissionError: one of them is at fault.
    """
    if chosen.binary is None:
        raise MissionError(f"no SITL program of {autopilot} is named: --binary PATH does that")
    options = SwarmOptions(
        autopilot,
        chosen.binary,
        folder=chosen.folder,
        files=_files(chosen, autopilot),
        model=chosen.model,
        parameters=tuple(map(_parameter, chosen.param or ())),
        keep_parameters=chosen.keep_parameters,
    )
    for name in ("port", "base_port", "heartbeat_s", "ready_s"):
        if getattr(chosen, name) is not None:
            options = replace(options, **{name: getattr(chosen, name)})
    return replace(options, least_pace=0.0, watch_s=0.0) if chosen.slow_machine_ok else options


def run(chosen: argparse.Namespace) -> ExitCode:
    """Start a swarm, and stay until it is stopped or until none of its instances is left.

    Raises:
        FgError: it cannot be started, or does not become ready, see :func:`fg_gcs.sitl.swarm.started`.
    """
    options = options_of(chosen, chosen.autopilot)
    options = replace(options, folder=options.folder or FOLDER)
    instances = _instances(chosen)
    with ExitStack() as stack:
        console = PatientConsole(file=unhurried_errors(stack), highlight=False)
        board = stack.enter_context(_Board(console))
        with asyncio.Runner(loop_factory=lambda: make_loop(1.0)) as runner:
            return runner.run(_until_stopped(options, instances, board, as_json=chosen.json))


async def _until_stopped(options: SwarmOptions, instances: list[Instance], board: _Board, *, as_json: bool) -> ExitCode:
    """Do it; every way to be asked to stop ends the instances."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, stop.set)
    work = asyncio.ensure_future(_watched(options, instances, board, as_json=as_json))
    stopped = asyncio.ensure_future(stop.wait())
    await asyncio.wait((work, stopped), return_when=asyncio.FIRST_COMPLETED)
    if not work.done():
        board.said("ending all instances")
        for number in (signal.SIGINT, signal.SIGTERM):  # asked again, they are not waited for
            loop.remove_signal_handler(number)
        work.cancel()
    stopped.cancel()
    try:
        code = await work
    except asyncio.CancelledError:
        code = ExitCode.DONE if board.was_ready else ExitCode.ABORTED
    except VehicleError as error:
        board.close()
        print(f"fg-gcs: {error}", file=sys.stderr)
        code = ExitCode.ABORTED
        _tell(as_json, ready=False, reason=str(error), exit_code=int(code))
        return code
    _tell(as_json, ready=board.was_ready, ended=True, exit_code=int(code))
    return code


async def _watched(options: SwarmOptions, instances: list[Instance], board: _Board, *, as_json: bool) -> ExitCode:
    """Start the swarm, and watch it for as long as one of its instances runs."""
    async with started(options, instances, board) as swarm:
        board.was_ready = True
        board.close()
        took_s = max(member.ready_s for member in swarm.members)
        board.said(f"ready {took_s:.1f} s after the start; to fly, in another terminal:")
        board.said(f"  fg-gcs fly MISSION {_connect(swarm)}", whole=True)
        board.said("Ctrl-C ends all instances")
        _tell(as_json, **_figures(swarm))
        while swarm.alive:
            await swarm.news.wait()
            swarm.news.clear()
        board.said("no instance is left")
    return ExitCode.ABORTED


class _Board(Listener):
    """Shows a swarm that boots: a table that is rewritten in place, or, where that cannot be, a line a change.

    Attributes:
        was_ready: all could be armed.
    """

    def __init__(self, console: Console) -> None:
        self.was_ready = False
        self._console = console
        live = console.is_terminal and not console.is_dumb_terminal
        self._live = Live(console=console, auto_refresh=False, transient=True) if live else None

    def __enter__(self) -> _Board:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Show the table no more; lines are shown still."""
        if self._live is not None:
            with suppress(OSError):
                self._live.stop()
            self._live = None

    def changed(self, swarm: Swarm) -> None:
        """Draw the table anew."""
        if self._live is not None:
            self._live.update(table_of(swarm), refresh=True)

    def ended(self, text: str) -> None:
        """Print a line about an instance that has ended."""
        self.said(text)

    def said(self, text: str, *, whole: bool = False) -> None:
        """Print a line."""
        with suppress(OSError):
            say(self._console, Text(text), whole=whole)


def table_of(swarm: Swarm) -> Table:
    """Return the table of a swarm's instances."""
    table = Table(box=None, padding=(0, 1), header_style="dim")
    for name in ("instance", "vehicle", "process", "state", "after", "why it waits"):
        table.add_column(name, justify="left" if name in ("state", "why it waits") else "right", no_wrap=True)
    for member in swarm.members:
        table.add_row(
            str(member.instance.number),
            str(member.instance.system_id),
            str(member.pid or ""),
            Text(member.stage.value, COLOURS[member.stage]),
            "" if math.isnan(member.ready_s) else f"{member.ready_s:.1f} s",
            Text(member.waits, overflow="ellipsis"),
        )
    return table


def _connect(swarm: Swarm) -> str:
    """Return the options of ``fly`` that find a swarm."""
    numbers = [member.instance.number for member in swarm.members]
    if swarm.options.autopilot == "px4" and numbers == list(range(len(numbers))):
        return f"--px4 {len(numbers)}"
    return " ".join(f"--connect {shlex.quote(endpoint)}" for endpoint in swarm.endpoints)


def _figures(swarm: Swarm) -> dict[str, object]:
    """Return what programs want to know of a swarm that is ready."""
    pace = swarm.slowest.pace
    return {
        "ready": True,
        "connect": swarm.endpoints,
        "instances": [_instance_figures(member) for member in swarm.members],
        "least_pace": None if math.isnan(pace) else round(pace, 4),
        "processors_busy": None if math.isnan(swarm.busy) else round(swarm.busy, 3),
    }


def _instance_figures(member: Member) -> dict[str, object]:
    home = member.instance.home
    return {
        "instance": member.instance.number,
        "system_id": member.instance.system_id,
        "pid": member.pid,
        "ready_s": round(member.ready_s, 2),
        "home": [round(home.latitude_deg, 8), round(home.longitude_deg, 8), round(home.altitude_m, 3)],
        "log": str(member.log),
    }


def _tell(as_json: bool, **what: object) -> None:
    if as_json:
        with suppress(BrokenPipeError):
            print(json.dumps(what), flush=True)


def _instances(chosen: argparse.Namespace) -> list[Instance]:
    """Return the instances that were asked for.

    Raises:
        MissionError: they cannot be.
    """
    count, layout = chosen.vehicles, chosen.layout
    known = {each.value: each for each in Layout}
    spacing_m = SPACING_M if chosen.spacing is None else chosen.spacing
    places_m = places(known[layout], count, spacing_m) if layout in known else read_places(Path(layout), count)
    first_id = chosen.first_id if chosen.first_id is not None else (chosen.first_instance or 0) + 1
    first = chosen.first_instance
    if first is None:  # PX4's ids follow from its numbers
        first = first_id - 1 if chosen.autopilot == "px4" else 0
    home = DEFAULT_ORIGIN if chosen.home is None else Geodetic(*chosen.home)
    numbers, ids = range(first, first + count), range(first_id, first_id + count)
    return numbered(numbers, ids, homes(places_m, home), chosen.autopilot)


def _files(chosen: argparse.Namespace, autopilot: str) -> Path | None:
    """Return what the program needs beside itself, if it is named.

    Raises:
        MissionError: it is named for the other autopilot.
    """
    own, other = ("px4_etc", "defaults") if autopilot == "px4" else ("defaults", "px4_etc")
    if getattr(chosen, other) is not None:
        raise MissionError(f"--{other.replace('_', '-')} is not for {autopilot}; use --{own.replace('_', '-')}")
    found: Path | None = getattr(chosen, own)
    return found


def _parameter(text: str) -> tuple[str, float]:
    """Return the name and the value of ``NAME=VALUE``.

    Raises:
        MissionError: it is not of that form.
    """
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError as error:
        raise MissionError(f"--param {text}: not of the form NAME=VALUE, VALUE being a number") from error
