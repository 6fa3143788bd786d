"""The last words of a flight: what came of it, and where its report lies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress

from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from fg_gcs.console.tracking_lines import refused_text
from fg_gcs.mission import Mission


def say(console: Console, what: RenderableType, *, whole: bool = False) -> None:
    """Print; a terminal gets lines wrapped between words, unless they are to stay whole."""
    console.print(what, soft_wrap=whole or not console.is_terminal)


def closing(console: Console, summary: Mapping[str, object], mission: Mission) -> None:
    """Print what came of the flight; nobody may be there any more to read it.

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
        say(console, Text.assemble(("report  ", "dim"), str(summary["report"])), whole=True)  # to be copied, or clicked


def closing_lines(summary: Mapping[str, object], mission: Mission) -> list[tuple[str, str]]:
    """Return names and values of what people want to know of a flight."""

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
    if mission.targets is not None:
        lines += _tracking_lines(summary, figure)
    for key, name in (("bad_bytes", "bytes that were no MAVLink"), ("unknown_messages", "unknown messages")):
        if summary[key]:
            lines.append((name, f"{summary[key]} dropped"))
    if summary["lost_vehicles"]:
        lines.append(("lost", f"vehicles {summary['lost_vehicles']}"))
    return lines


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
