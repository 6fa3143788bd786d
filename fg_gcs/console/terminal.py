"""What people see of a flight in a terminal: what happens in words, a picture while it flies, the figures at its end.

The picture is made from the run's snapshots and from nothing else.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from fg_gcs.flight.snapshot import RunEvent, Snapshot, TargetSnapshot, TrackingSnapshot, VehicleSnapshot
from fg_gcs.mission import Mission
from fg_gcs.record.read.summary import RunSummary
from fg_gcs.run.observing import Observer
from fg_gcs.wire.address import vehicles_named

ON_THE_WAY = ("approach", "take-off", "land")  # stages whose end is not known, but that do not end at once
REFRESH_S = 0.25  # four pictures a second read well; each costs some milliseconds that the streamer shares
EVENT_LINES = 4  # of the terminal that the picture leaves to events, if that leaves room for some vehicles
FEWEST_LINES = 4  # for vehicles, however small the terminal is
HEIGHT = 4  # lines about tracking that are kept for it, whether there is something to say or not
GROWN = 0.005  # a change of size that shows in the two digits behind the point
BEGIN_FRAME, END_FRAME = (
    "\x1b[?2026h",
    "\x1b[?2026l",
)  # terminals show what comes between at once, or know nothing of it
HINT = "Ctrl-C: fly home; again: land apart; again: now"
SHOWN = {  # kinds of events for people, with their colours; the rest is for the log
    "simulator": "dim",
    "open": "dim",
    "vehicles": "green",
    "ready": "green",
    "limit": "yellow",
    "failsafe": "dim",
    "wander": "green",
    "plan": "green",
    "learnt": "dim",
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
COLOURS = {"lost": "red", "taken": "red", "landed": "green", "flying": "cyan", "landing": "cyan"}


class Terminal(Observer):
    """Shows a flight; use it as a context manager."""

    def __init__(self, description: str, console: Console, *, live: bool) -> None:
        """Show a moving picture when ``live``, else lines alone; the description comes first."""
        self._console = console
        self._live = Live(console=self._console, auto_refresh=False, transient=True) if live else None
        self._description = description
        self._begun = False
        self._drawn_s = -math.inf

    def __enter__(self) -> Self:
        """Begin to show with the first event: a run that never began has nothing to show."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the terminal as it was."""
        if self._live is not None and self._begun:
            with self._one_frame():
                self._live.stop()

    def event(self, event: RunEvent) -> None:
        """Print an event that is meant for people."""
        if not self._begun:
            self._begin()
        if event.kind in SHOWN:
            line = Table.grid()
            line.add_row(Text(f"{event.time_s:7.2f} s  ", "dim"), Text(event.text, SHOWN[event.kind]))
            self._say(line if self._console.is_terminal else Text(f"{event.time_s:7.2f} s  {event.text}"))

    def snapshot(self, snapshot: Snapshot) -> None:
        """Draw the picture anew, now and then."""
        if self._live is not None and snapshot.time_s - self._drawn_s >= REFRESH_S:
            self._drawn_s = snapshot.time_s
            with self._one_frame():
                self._live.update(self.picture(snapshot), refresh=True)

    def picture(self, snapshot: Snapshot) -> Group:
        """Return the picture of a moment; its height changes only with the number of vehicles."""
        middle = tracking_lines(snapshot) if snapshot.tracks else Text("")
        taken = 1 + (HEIGHT if snapshot.tracks else 1) + 1 + 1 + EVENT_LINES  # head, middle, headings, hint
        most = max(self._console.height - taken, FEWEST_LINES)
        vehicles = vehicle_lines(snapshot.vehicles, most, snapshot.networks > 1) if snapshot.vehicles else Text("")
        return Group(_head(snapshot), middle, vehicles, Text(HINT, "dim", no_wrap=True, overflow="ellipsis"))

    def _begin(self) -> None:
        self._begun = True
        if self._description:
            say(self._console, Text(self._description, "bold"))
        if self._live is not None:
            self._live.start()

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


# --- the picture -----------------------------------------------------------------------------------------------------


def _head(snapshot: Snapshot) -> Table:
    """Return the line about the stage: its name, how far the flight is, how long the stage will take."""
    number, share, left = snapshot.stages.index(snapshot.stage), 0.0, ""
    if snapshot.stage_ends_s is not None:
        left_s = max(0.0, snapshot.stage_ends_s - snapshot.time_s)
        share = 1.0 - left_s / max(snapshot.stage_ends_s - snapshot.stage_begins_s, left_s, 1e-3)
        left = f"{left_s:.0f} s left"
    elif snapshot.stage in ON_THE_WAY:
        left = f"{snapshot.time_s - snapshot.stage_begins_s:.0f} s so far"
    count = len(snapshot.stages)
    head = Table.grid(padding=(0, 2))
    name = Text(f"{snapshot.stage} ({number + 1} of {count})", "bold cyan")
    head.add_row(name, ProgressBar(count, number + share, width=50, complete_style="cyan"), left)
    return head


def vehicle_lines(vehicles: Sequence[VehicleSnapshot], most: int, networks: bool = False) -> Table:
    """Return a line for every vehicle, or, in ``most`` lines, those that need eyes and how many others there are.

    Args:
        vehicles: in ascending order of their addresses.
        most: lines, at least 2, without the headings.
        networks: there are several, so that each vehicle's is told.
    """
    table = Table(box=None, padding=(0, 1), header_style="dim")
    for name in ("id", "phase", "mode", "height", "speed", "battery", "lost", "delay"):
        table.add_column(name, justify="left" if name in ("phase", "mode") else "right")
    order = {id(vehicle): index for index, vehicle in enumerate(vehicles)}
    first = sorted(vehicles, key=lambda vehicle: not vehicle.alarming)  # stable: else by address
    shown = first if len(vehicles) <= most else first[: most - 1]
    for vehicle in sorted(shown, key=lambda vehicle: order[id(vehicle)]):
        table.add_row(
            f"{vehicle.network}/{vehicle.system_id}" if networks else str(vehicle.system_id),
            Text(vehicle.phase, COLOURS.get(vehicle.phase, "")),
            vehicle.mode,
            "" if vehicle.height_m is None else f"{vehicle.height_m:.1f} m",
            f"{vehicle.speed_m_s or 0.0:.1f} m/s",
            "" if vehicle.battery is None else f"{vehicle.battery:.0%}",
            "" if vehicle.loss_in is None else f"{max(vehicle.loss_in, vehicle.loss_out or 0.0):.0%}",
            "" if vehicle.delay_s is None else f"{1e3 * vehicle.delay_s:.0f} ms",
        )
    rest = Counter(vehicle.phase for vehicle in first[len(shown) :])
    if rest:
        table.add_row("+", f"{rest.total()} more: {', '.join(f'{count} {phase}' for phase, count in rest.items())}")
    return table


def tracking_lines(snapshot: Snapshot) -> Table:
    """Return the lines about tracking, always `HEIGHT` of them; what does not fit the terminal is cut at its edge."""
    grid = Table.grid(padding=(0, 2, 0, 0))
    status = snapshot.tracking
    rows = (
        [("target", Text("tracked in approach and hold", "dim"))] if status is None else _rows(status, snapshot.target)
    )
    for name, text in [*rows, *[("", Text())] * (HEIGHT - len(rows))]:
        text.no_wrap, text.overflow = True, "ellipsis"
        grid.add_row(Text(name, "dim"), text)
    return grid


def refused_text(refused: Mapping[str, int]) -> str:
    """Return how many were refused and why, most frequent first: ``10 gated, 2 too old``."""
    counts = sorted(refused.items(), key=lambda item: -item[1])
    return ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in counts)


def _rows(status: TrackingSnapshot, target: TargetSnapshot | None) -> list[tuple[str, Text]]:
    refused = refused_text(dict(status.refused))
    sightings = Text(f"{status.sightings}")
    if refused:
        sightings.append(f", refused: {refused}", "yellow")
    latency = "-" if status.latency_s is None else f"{1e3 * status.latency_s:.0f} ms from stamp to setpoint"
    return [
        ("target" if status.targets == 1 else "targets", _target(status, target)),
        ("formation", _formation(status, target)),
        ("sightings", sightings),
        ("latency", Text(latency)),
    ]


def _target(status: TrackingSnapshot, known: TargetSnapshot | None) -> Text:
    if known is None:
        return Text(f"not seen yet, home in {status.patience_s:.0f} s", "yellow")
    if _all_lost(status, known):
        text = Text(f"LOST, seen {known.age_s:.1f} s ago, home in {status.patience_s:.0f} s", "bold red")
        return text.append(f", believed {_place(known)}", "default")
    speed_m_s = math.hypot(*known.velocity_enu_m_s)
    text = Text("seen", "green").append(f" {known.age_s:.1f} s ago, {speed_m_s:.1f} m/s {_place(known)}", "default")
    if known.lost or known.unseen:
        missing = [
            f"{', '.join(names)} {what}"
            for names, what in ((known.lost, "LOST"), (known.unseen, "not seen yet"))
            if names
        ]
        return Text(f"{'; '.join(missing)}; ", "bold red").append_text(text)
    return text


def _formation(status: TrackingSnapshot, known: TargetSnapshot | None) -> Text:
    size = f", size x {status.growth:.2f}" if abs(status.growth - 1.0) > GROWN else ""
    if known is None or _all_lost(status, known):
        what = "waiting for the target" if known is None or status.rests else "going on as predicted"
        return Text(f"{what}{size}", "yellow")
    off = "-" if status.error_m is None else f"{status.error_m:.1f} m off"
    text = Text(f"{status.mode}, ", "cyan").append(off, "green" if status.caught else "yellow")
    if known.too_wide:
        text.append(", targets too wide to surround", "yellow")
    return text.append(size if status.caught else f"{size}, home in {status.patience_s:.0f} s unless caught", "default")


def _all_lost(status: TrackingSnapshot, known: TargetSnapshot) -> bool:
    return len(known.lost) + len(known.unseen) == status.targets


def _place(known: TargetSnapshot) -> str:
    east, north, up = known.position_enu_m
    sides = "E" if east >= 0.0 else "W", "N" if north >= 0.0 else "S"
    return f"at {abs(east):.0f} {sides[0]}, {abs(north):.0f} {sides[1]}, {up:.0f} m up"


# --- the end ---------------------------------------------------------------------------------------------------------


class PatientConsole(Console):
    """A console that takes it calmly when what it writes to has gone: the flight goes on without."""

    def on_broken_pipe(self) -> None:
        """Do nothing, where rich would end the program."""


def say(console: Console, what: RenderableType, *, whole: bool = False) -> None:
    """Print; a terminal gets lines wrapped between words, unless they are to stay whole."""
    console.print(what, soft_wrap=whole or not console.is_terminal)


def closing(console: Console, summary: Mapping[str, object], mission: Mission) -> None:
    """Print what came of the flight; there may be no terminal any more.

    Args:
        console: where to.
        summary: the run's figures by the names of the command line's JSON.
        mission: what was flown.
    """
    aborted = Text(f"Flight aborted: {summary['reason']}", "bold red")
    grid = Table.grid(padding=(0, 2, 0, 0))
    for name, value in closing_lines(summary, mission):
        grid.add_row(Text(name, "dim"), Text(value, overflow="fold"))
    with suppress(OSError):
        say(console, Text())
        say(console, Text("Flight completed", "bold green") if summary["completed"] else aborted)
        say(console, grid)
        if summary["report"] is not None:  # to be copied, or clicked
            say(console, Text.assemble(("report  ", "dim"), str(summary["report"])), whole=True)


def closing_lines(summary: Mapping[str, object], mission: Mission) -> list[tuple[str, str]]:
    """Return names and values of what people want to know of a flight."""

    def figure(key: str, unit: str, digits: int = 2) -> str:
        value = summary.get(key)
        return f"{value:.{digits}f}{unit}" if isinstance(value, float) else "-"

    speed, acceleration = figure("flown_peak_speed_m_s", " m/s"), figure("flown_peak_acceleration_m_s2", " m/s^2")
    closest = f"{figure('flown_min_separation_m', ' m')} by the vehicles' own estimates"
    if isinstance(summary.get("true_min_separation_m"), float):
        closest += f", truly {figure('true_min_separation_m', ' m')}"
    lines = [
        ("landed and disarmed", f"{summary['vehicles_landed']} of {mission.swarm.vehicles} vehicles"),
        ("flux metric at the hold", figure("flown_flux_metric", "", 3)),
        ("closest pair", f"{closest} (minimum {mission.limits.separation_m:.2f} m)"),
        ("highest speed", f"{speed} ({_limit(summary, mission, 'speed_m_s')})"),
        ("highest acceleration", f"{acceleration} ({_limit(summary, mission, 'acceleration_m_s2')})"),
        ("tracking error", f"{figure('tracking_rms_m', ' m')} rms, {figure('tracking_max_m', ' m')} worst"),
        (
            "setpoints",
            f"{figure('setpoint_rate_hz', ' Hz', 1)} a vehicle, "
            f"99 % less than {figure('setpoint_late_p99_ms', ' ms', 1)} late",
        ),
    ]
    if mission.targets is not None:
        lines += _tracking_lines(summary, figure)
    for key, name in (
        ("bad_bytes", "bytes that were no MAVLink"),
        ("unknown_messages", "unknown messages"),
        ("refused", "datagrams of floods"),
        ("unsigned", "frames without a signature"),
        ("forged", "frames signed with another key"),
        ("replayed", "frames that came again, or too late"),
        ("not_forwarded", "frames that a receiver missed"),
        ("commands_dropped", "commands of other programs"),
    ):
        if summary.get(key):
            lines.append((name, f"{summary[key]} dropped"))
    lines += [("hit", text) for text in RunSummary(summary).incidents]
    if summary.get("recording_complete") is False:
        lines.append(("recording", f"incomplete, and so are these figures: {summary['recording_failure']}"))
    if summary.get("vehicles_not_down"):
        lines.append(("not known to be down", vehicles_named(RunSummary(summary).vehicles("vehicles_not_down"))))
    if summary["lost"]:
        lines.append(("lost", vehicles_named(RunSummary(summary).vehicles("lost"))))
    return lines


def _limit(summary: Mapping[str, object], mission: Mission, name: str) -> str:
    """Return the limit that was in force, and whose it is."""
    own: float = getattr(mission.limits, name)
    limits = summary.get("limits")
    in_force = limits.get(name, own) if isinstance(limits, dict) else own
    whose = "the vehicles' own" if in_force < own else "the mission's"
    return f"limit {in_force:g}, {whose}"


def _tracking_lines(summary: Mapping[str, object], figure: Callable[[str, str, int], str]) -> list[tuple[str, str]]:
    caught = summary["capture_time_s"] is not None
    lines = [("caught after", figure("capture_time_s", " s", 1) if caught else "never")]
    if summary["centre_error_rms_m"] is not None:  # nobody knows where a real target truly was
        off = figure("centre_error_rms_m", " m", 2), figure("centre_error_p95_m", " m", 2)
        lines.append(("centre off the target", f"{off[0]} rms, 95 % below {off[1]}"))
    share, rejected = summary["flux_metric_share"], summary["sightings_rejected"]
    if isinstance(share, float):
        lines.append(("target held", f"{100.0 * share:.1f} % of the time after that"))
    refused = refused_text(rejected) if isinstance(rejected, dict) else ""
    lines.append(("sightings", f"{summary['sightings']}, refused: {refused or 'none'}"))
    for name, key, before in (
        ("trajectories planned", "replan_p99_ms", f"{summary['replans']}, "),
        ("arrival to setpoint", "sensed_to_setpoint_p99_ms", ""),
        ("stamp to setpoint", "stamp_to_setpoint_p99_ms", ""),
    ):
        if summary[key] is not None:
            lines.append((name, f"{before}99 % in less than {figure(key, ' ms', 1)}"))
    return lines
