"""What a person sees while flying: what happens in words, a bar, and a line for every vehicle."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress
from types import TracebackType
from typing import Self

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from fg_gcs.flight.director import Director
from fg_gcs.flight.journal import STAGES
from fg_gcs.flight.tracking import Status
from fg_gcs.link.clock import ticks
from fg_gcs.mission import Mission
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.vehicle import Vehicle

REFRESH_S = 0.25  # four pictures a second read well; each costs some milliseconds that the streamer shares
MOST_LINES = 24  # vehicles shown one by one; more do not fit a terminal
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
    "warning": "yellow",
    "error": "bold red",
}
COLOURS = {Phase.LOST: "red", Phase.TAKEN: "red", Phase.LANDED: "green", Phase.FLYING: "cyan", Phase.LANDING: "cyan"}


class Progress:
    """Shows a flight on standard error; use it as a context manager."""

    def __init__(self, mission: Mission, *, live: bool) -> None:
        """Show a moving picture when ``live``, else lines alone."""
        self._console = Console(stderr=True, highlight=False, soft_wrap=True)
        self._live = Live(console=self._console, auto_refresh=False, transient=True) if live else None
        self._mission = mission

    def __enter__(self) -> Self:
        """Begin to show."""
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the terminal as it was."""
        if self._live is not None:
            self._live.stop()

    def event(self, time_s: float, kind: str, text: str) -> None:
        """Print an event that is meant for people."""
        if kind in SHOWN:
            self._console.print(Text(f"{time_s:7.2f} s  ", "dim") + Text(text, SHOWN[kind]))

    async def show(self, director: Director) -> None:
        """Keep the picture up to date: run it as a task."""
        if self._live is None:
            return
        loop = asyncio.get_running_loop()
        async for _ in ticks(loop.time(), REFRESH_S):
            with suppress(TimeoutError):  # the streamer may have stopped meanwhile
                async with asyncio.timeout(REFRESH_S):
                    await director.quiet_moment()
            self._live.update(self._picture(director, loop.time()), refresh=True)

    def closing(self, summary: dict[str, object]) -> None:
        """Print what came of the flight and where its report lies."""
        done = summary["completed"]
        self._console.print()
        self._console.print(
            Text("Flight completed", "bold green") if done else Text(f"Flight aborted: {summary['reason']}", "bold red")
        )
        grid = Table.grid(padding=(0, 2))
        for name, value in _closing_lines(summary, self._mission):
            grid.add_row(Text(name, "dim"), Text(value, overflow="fold"))
        self._console.print(grid)

    def _picture(self, director: Director, now_s: float) -> Group:
        journal = director.journal
        number, share, left = STAGES.index(journal.stage), 0.0, ""
        if journal.stage_ends_s is not None:
            left_s = max(0.0, journal.stage_ends_s - now_s)
            share = 1.0 - left_s / max(journal.stage_ends_s - journal.stage_begins_s, left_s, 1e-3)
            left = f"{left_s:.0f} s left"
        head = Table.grid(padding=(0, 2))
        name = Text(f"{journal.stage} ({number + 1} of {len(STAGES)})", "bold cyan")
        head.add_row(name, ProgressBar(len(STAGES), number + share, width=50), left)
        status = None if director.pursuit is None else director.pursuit.status
        tracking = Text("") if status is None else Text(_tracking_line(status), "cyan")
        return Group(head, tracking, _vehicles(director.fleet.vehicles) if director.fleet else Text(""))


def _tracking_line(status: Status) -> str:
    """Say how the tracking goes."""
    off = f"{status.error_m:.1f} m off" if math.isfinite(status.error_m) else "nothing known of it yet"
    refused = f", {status.refused} sightings refused" if status.refused else ""
    return f"{status.mode.value}: {off}, last seen {status.age_s:.1f} s ago{refused}"


def _vehicles(vehicles: tuple[Vehicle, ...]) -> Table:
    table = Table(box=None, padding=(0, 1), header_style="dim")
    for name in ("id", "phase", "mode", "height", "speed", "battery"):
        table.add_column(name, justify="right" if name in ("id", "height", "speed", "battery") else "left")
    for vehicle in vehicles[:MOST_LINES]:
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
    if len(vehicles) > MOST_LINES:
        table.add_row("", f"and {len(vehicles) - MOST_LINES} more", "", "", "", "")
    return table


def _closing_lines(summary: dict[str, object], mission: Mission) -> list[tuple[str, str]]:
    def figure(key: str, unit: str, digits: int = 2) -> str:
        value = summary.get(key)
        return f"{value:.{digits}f}{unit}" if isinstance(value, float) else "-"

    speed, acceleration = figure("flown_peak_speed_m_s", " m/s"), figure("flown_peak_acceleration_m_s2", " m/s^2")
    lines = [
        ("landed and disarmed", f"{summary['vehicles_landed']} of {mission.swarm.vehicles} vehicles"),
        ("flux metric at the hold", figure("flown_flux_metric", "", 3)),
        ("closest pair", f"{figure('flown_min_separation_m', ' m')} (minimum {mission.limits.separation_m:.2f} m)"),
        ("highest speed", f"{speed} (limit {mission.limits.speed_m_s:g})"),
        ("highest acceleration", f"{acceleration} (limit {mission.limits.acceleration_m_s2:g})"),
        ("tracking error", f"{figure('tracking_rms_m', ' m')} rms, {figure('tracking_max_m', ' m')} worst"),
        (
            "setpoints",
            f"{figure('setpoint_rate_hz', ' Hz', 1)} a vehicle, "
            f"99 % less than {figure('setpoint_late_p99_ms', ' ms', 1)} late",
        ),
    ]
    if summary["replans"]:
        rejected = summary["sightings_rejected"]
        count = sum(rejected.values()) if isinstance(rejected, dict) else 0
        off = f"{figure('centre_error_rms_m', ' m')} rms, 95 % below {figure('centre_error_p95_m', ' m')}"
        reaction = figure("sensed_to_setpoint_p99_ms", " ms", 1)
        lines += [
            ("caught after", figure("capture_time_s", " s", 1)),
            ("centre off the target", off),
            ("target held", f"{figure('flux_metric_share', '', 3)} of the time after that"),
            ("sightings", f"{summary['sightings']}, {count} of them refused"),
            ("rides planned", f"{summary['replans']}, 99 % in less than {figure('replan_p99_ms', ' ms', 1)}"),
            ("sighting to setpoint", f"99 % in less than {reaction}, without the sensor's own delay"),
        ]
    for key, name in (("bad_bytes", "bytes that were no MAVLink"), ("unknown_messages", "unknown messages")):
        if summary[key]:
            lines.append((name, f"{summary[key]} dropped"))
    if summary["lost_vehicles"]:
        lines.append(("lost", f"vehicles {summary['lost_vehicles']}"))
    return [*lines, ("report", str(summary["report"]))]
