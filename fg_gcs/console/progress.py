"""What a person sees while flying: what happens in words, a bar, and a line for every vehicle."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from fg_gcs.console.closing import say
from fg_gcs.console.tracking_lines import HEIGHT, tracking_lines
from fg_gcs.flight.director import Director
from fg_gcs.flight.journal import STAGES
from fg_gcs.link.clock import ticks
from fg_gcs.mission import Mission
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.vehicle import Vehicle

ON_THE_WAY = ("approach", "take-off", "land")  # stages that nobody knows the end of, but that do not end at once
REFRESH_S = 0.25  # four pictures a second read well; each costs some milliseconds that the streamer shares
EVENT_LINES = 4  # of the terminal that the picture leaves to events, if that leaves room for some vehicles
FEWEST_LINES = 4  # for vehicles, however small the terminal is
BEGIN_FRAME, END_FRAME = (
    "\x1b[?2026h",
    "\x1b[?2026l",
)  # terminals show what comes between at once, or know nothing of it
HINT = "Ctrl-C: fly home and land; again: land on the spot"
SHOWN = {  # kinds of events for people, with their colours; the rest is for the log
    "simulator": "dim",
    "open": "dim",
    "vehicles": "green",
    "ready": "green",
    "limit": "yellow",
    "failsafe": "dim",
    "plan": "green",
    "stage": "bold cyan",
    "notice": "yellow",
    "fault": "bold red",
    "abort": "bold red",
    "track": "cyan",
    "refused": "yellow",
    "recording": "bold red",
    "warning": "yellow",
    "error": "bold red",
}
ALARMING = (Phase.LOST, Phase.TAKEN)
COLOURS = {Phase.LOST: "red", Phase.TAKEN: "red", Phase.LANDED: "green", Phase.FLYING: "cyan", Phase.LANDING: "cyan"}


class Progress:
    """Shows a flight; use it as a context manager."""

    def __init__(self, mission: Mission, console: Console, *, live: bool) -> None:
        """Show a moving picture when ``live``, else lines alone."""
        self._console = console
        self._live = Live(console=self._console, auto_refresh=False, transient=True) if live else None
        self._mission = mission

    def __enter__(self) -> Self:
        """Begin to show."""
        if self._mission.description:
            self._say(Text(self._mission.description, "bold"))
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the terminal as it was."""
        if self._live is not None:
            with self._one_frame():
                self._live.stop()

    def event(self, time_s: float, kind: str, text: str) -> None:
        """Print an event that is meant for people."""
        if kind in SHOWN:
            line = Table.grid()
            line.add_row(Text(f"{time_s:7.2f} s  ", "dim"), Text(text, SHOWN[kind]))
            self._say(line if self._console.is_terminal else Text(f"{time_s:7.2f} s  {text}"))

    async def show(self, director: Director) -> None:
        """Keep the picture up to date: run it as a task."""
        if self._live is None:
            return
        loop = asyncio.get_running_loop()
        async for _ in ticks(loop.time(), REFRESH_S):
            with suppress(TimeoutError):  # the streamer may have stopped meanwhile
                async with asyncio.timeout(REFRESH_S):
                    await director.quiet_moment()
            with self._one_frame():
                self._live.update(self.picture(director, loop.time()), refresh=True)

    def picture(self, director: Director, now_s: float) -> Group:
        """Return the picture of a moment; its height changes only with the number of vehicles."""
        journal = director.journal
        number, share, left = STAGES.index(journal.stage), 0.0, ""
        if journal.stage_ends_s is not None:
            left_s = max(0.0, journal.stage_ends_s - now_s)
            share = 1.0 - left_s / max(journal.stage_ends_s - journal.stage_begins_s, left_s, 1e-3)
            left = f"{left_s:.0f} s left"
        elif journal.stage in ON_THE_WAY:
            left = f"{now_s - journal.stage_begins_s:.0f} s so far"
        head = Table.grid(padding=(0, 2))
        name = Text(f"{journal.stage} ({number + 1} of {len(STAGES)})", "bold cyan")
        head.add_row(name, ProgressBar(len(STAGES), number + share, width=50, complete_style="cyan"), left)
        moving = self._mission.targets is not None
        status = None if director.target_follower is None else director.target_follower.status
        middle = tracking_lines(status) if moving else Text("")
        taken = 1 + (HEIGHT if moving else 1) + 1 + 1 + EVENT_LINES  # head, middle, headings, hint
        most = max(self._console.height - taken, FEWEST_LINES)
        vehicles = vehicle_lines(director.fleet.vehicles, most) if director.fleet else Text("")
        return Group(head, middle, vehicles, Text(HINT, "dim", no_wrap=True, overflow="ellipsis"))

    def _say(self, what: RenderableType) -> None:
        with self._one_frame():
            say(self._console, what)

    @contextmanager
    def _one_frame(self) -> Iterator[None]:
        """Let the terminal show at once what is written meanwhile: the picture is wiped and drawn anew every time."""
        marks = self._live is not None and not self._console.is_dumb_terminal
        if marks:
            self._console.file.write(BEGIN_FRAME)
        yield
        if marks:
            self._console.file.write(END_FRAME)
            self._console.file.flush()


def vehicle_lines(vehicles: Sequence[Vehicle], most: int) -> Table:
    """Return a line for every vehicle, or, in ``most`` lines, those that need eyes and how many others there are.

    Args:
        vehicles: the fleet, in ascending order of system ids.
        most: lines, at least 2, without the headings.
    """
    table = Table(box=None, padding=(0, 1), header_style="dim")
    for name in ("id", "phase", "mode", "height", "speed", "battery"):
        table.add_column(name, justify="right" if name in ("id", "height", "speed", "battery") else "left")
    first = sorted(vehicles, key=lambda vehicle: vehicle.phase not in ALARMING)  # stable: else by system id
    shown = first if len(vehicles) <= most else first[: most - 1]
    for vehicle in sorted(shown, key=lambda vehicle: vehicle.system_id):
        speed = sum(part * part for part in vehicle.velocity_ned_m_s or ()) ** 0.5
        height = vehicle.height_m
        table.add_row(
            str(vehicle.system_id),
            Text(vehicle.phase.name.lower(), COLOURS.get(vehicle.phase, "")),
            vehicle.mode_name,
            "" if height is None else f"{height:.1f} m",
            f"{speed:.1f} m/s",
            "" if vehicle.battery.remaining != vehicle.battery.remaining else f"{vehicle.battery.remaining:.0%}",
        )
    rest = Counter(vehicle.phase.name.lower() for vehicle in first[len(shown) :])
    if rest:
        table.add_row("+", f"{rest.total()} more: {', '.join(f'{count} {phase}' for phase, count in rest.items())}")
    return table
