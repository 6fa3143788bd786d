"""A run's report: one page that opens offline and tells people who were not there what happened."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from html import escape
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import plotly.graph_objects as go

from fg_gcs.record.evaluate.evaluation import EvaluatedRun, evaluated
from fg_gcs.record.read.run import LoggedEvent
from fg_gcs.record.report.charts import (
    acceleration_chart,
    age_chart,
    centre_chart,
    face_chart,
    lateness_chart,
    separation_chart,
    sightings_chart,
    size_chart,
    speed_chart,
    tracking_chart,
)
from fg_gcs.record.report.html import Cell, Row, chart, page, section, table
from fg_gcs.record.report.scene import scene
from fg_gcs.record.write.recorder import REPORT
from fg_gcs.wire.address import VehicleAddress, vehicles_named

# Plans keep their limits exactly, real vehicles overshoot: wind, control, velocities stamped in whole milliseconds
FLOWN_SLACK = 0.05
RATE_SLACK = 0.05  # a late tick is left out, and a rate is counted over the whole flight
ON_GROUND = ("connect", "prepare", "plan")
QUIET = {"phase", "open"}  # kinds of events that only developers read
MOST_EVENTS = 1000  # rows that a browser shows at once
SAID_BY_VEHICLE = re.compile(r"vehicle ((?:[^ /]+/)?\d{1,3}): (.*)", re.DOTALL)
TOGETHER_S = 1.0  # vehicles that say the same within this time are told in one row
ERROR, WARNING = 3, 4  # MAVLink's severities: up to 3 errors, 4 a warning

KEPT, BROKEN, NO_FIGURE = "✓", "✗", "-"


class WrittenReport(NamedTuple):
    """A report that was written."""

    path: Path
    remarks: tuple[str, ...]  # what is missing from it and why, a line each


class ChartOverTime(NamedTuple):
    """A chart over time and how to read it."""

    name: str
    title: str
    draw: Callable[[EvaluatedRun], go.Figure | None]
    note: str


CHARTS = (
    ChartOverTime(
        "speed",
        "Speed",
        speed_chart,
        "Norm of every vehicle's velocity. Good: fast, and below the dashed limit. The vertical parts of a flight may "
        "be slower, because climb and descent have limits of their own.",
    ),
    ChartOverTime(
        "acceleration",
        "Acceleration",
        acceleration_chart,
        "Change of every vehicle's velocity over a tenth of a second, while it is in the air. Good: below the dashed "
        "limit, and close to it while the swarm follows a plan: no time is wasted.",
    ),
    ChartOverTime(
        "face",
        "How well the face looks at the target",
        face_chart,
        "Coverage 1: the face could not look better at the target at this distance; 0: it looks away. Flux metric 1: "
        "the target lies in the face, which is the aim of the flight. Good: coverage rises early in the approach and "
        "stays near 1, and the flux metric is 1 throughout the hold.",
    ),
    ChartOverTime(
        "separation",
        "Smallest separation",
        separation_chart,
        "Distance between the two vehicles that are closest to each other at each time. Good: never below the dashed "
        "minimum.",
    ),
    ChartOverTime(
        "tracking",
        "Tracking error",
        tracking_chart,
        "Distance between every vehicle and its setpoint of the same instant, in the stages that follow a plan. Good: "
        "far smaller than the separation.",
    ),
    ChartOverTime(
        "lateness",
        "Lateness of setpoints",
        lateness_chart,
        "How long after its due time each round of setpoints left. Good: far below the dashed period; a round later "
        "than that is left out. Flights in virtual time are never late.",
    ),
)
TRACKING_CHARTS = (
    ChartOverTime(
        "centre",
        "How far off the target",
        centre_chart,
        "Distance of the formation's centre from its place around the target. Dark: as flown, from the true target. "
        "Coloured: as commanded, from the estimate, one colour for each of the things that the formation does. Good: "
        "it falls fast, and stays below the dashed line from the capture on.",
    ),
    ChartOverTime(
        "sightings",
        "Sightings",
        sightings_chart,
        "How far every sighting lay from the target when it was true. Good: red crosses, which were refused, lie far "
        "off, and those that were taken spread by no more than the sensor's noise.",
    ),
    ChartOverTime(
        "size",
        "Size",
        size_chart,
        "Radius of the ball that holds several targets, or one that is not seen any more, with all that is uncertain "
        "about them; and of the largest circle in the formation's face as it was flown. Good: the circle is above the "
        "ball, or on the way there. Missing where one target was seen all the time.",
    ),
    ChartOverTime(
        "age",
        "Age of what is known",
        age_chart,
        "How old the newest sighting was whenever a trajectory was planned. Good: below the dashed line; above it the "
        "target counts as lost.",
    ),
)


def write_report(folder: Path) -> WrittenReport:
    """Write ``report.html`` into a run's folder, from nothing but that folder's files.

    What is missing or damaged is left out, and the report says so. The same files give the same bytes.

    Args:
        folder: of a run, however it ended.

    Raises:
        RunError: it is not the folder of a run.
        OSError: the report cannot be written; one that was there is left as it was.
    """
    run = evaluated(folder)
    remarks, sections = list(run.remarks), []
    for what, part in _parts(run):
        try:
            sections.append(part(run))
        except Exception as error:  # absurd numbers in a damaged file; the other parts are worth having all the same
            remarks.append(f"{what}: cannot be shown: {type(error).__name__}: {error}")
    if remarks:
        missing = section("What is not here", table((), [Row((remark,), "care") for remark in remarks]))
        sections.insert(1, missing)
    path, draft = folder / REPORT, folder / f".{REPORT}.draft"
    try:
        draft.write_bytes(page(f"{run.name}: flight report", sections).encode("utf-8", "replace"))
        draft.replace(path)
    except OSError:
        draft.unlink(missing_ok=True)
        raise
    return WrittenReport(path, tuple(remarks))


def _parts(run: EvaluatedRun) -> Iterator[tuple[str, Callable[[EvaluatedRun], str]]]:
    """Yield the report's parts, each with a name for when it cannot be made."""
    yield "headline", _headline
    yield "figures", _asked_and_flown
    yield "flight", _nothing_flown
    yield "paths", _paths
    for each in CHARTS if run.followed is None else (*TRACKING_CHARTS, *CHARTS):
        yield each.name, partial(_chart, each)
    yield "timings", lambda run: section("Timings and traffic", _timings(run))
    yield "events", _diary


def _chart(what: ChartOverTime, run: EvaluatedRun) -> str:
    return chart(what.name, what.title, what.draw(run), what.note)


def _asked_and_flown(run: EvaluatedRun) -> str:
    planned = "Planned: verified before take-off."
    if run.followed is not None:
        planned = "Moving targets are not planned for before take-off; every trajectory is verified before it is flown."
    return section(
        "What was asked, what was flown",
        table(("", "asked", "planned", "flown", ""), _figures(run)),
        f"{planned} Flown: measured from the vehicles' own telemetry; since they overshoot a "
        f"little, up to {100 * FLOWN_SLACK:g} % above a speed or acceleration limit counts as kept. Separation has no "
        "slack.",
    )


def _nothing_flown(run: EvaluatedRun) -> str:
    if run.series is not None:
        return ""
    return section(
        "Flight", "", "The vehicles sent too few positions to draw charts over time; most likely none took off."
    )


def _paths(run: EvaluatedRun) -> str:
    return chart(
        "paths",
        "Paths",
        scene(run),
        "Solid: flown, leaders in colour, the way home thin. Dotted: planned; hidden under the flown path when all is "
        "well. The yellow face is spanned by the leaders; it should look at the target during the approach and contain "
        "it in the end. Drag to rotate, scroll to zoom, click the legend to hide or show.",
        style="",
    )


def _diary(run: EvaluatedRun) -> str:
    if not run.events:
        return ""
    return section("What happened", table(("time [s]", "kind", "what"), _events(run.events), style="events"))


def _headline(run: EvaluatedRun) -> str:
    summary = run.summary
    completed = summary.is_true("completed")
    reason = summary.text("reason") or "no reason was written down"
    lost = summary.vehicles("lost")
    outcome = "Completed" if completed else f"Aborted: {reason}"
    description = "" if run.mission is None else run.mission.description
    begin_s, end_s = run.span_s
    facts = [
        f"{run.begun:%A, %d %B %Y, %H:%M:%S}" if run.begun else "",
        f"{_landed(run)} vehicles landed and disarmed" if _landed(run) != NO_FIGURE else "",
        f"{end_s - begin_s:.0f} s from take-off to landing" if run.bands else "no vehicle took off",
        f"lost: {vehicles_named(lost)}" if lost else "",
    ]
    return (
        f'<header class="{"good" if completed else "bad"}"><h1>{escape(run.name)}</h1>\n'
        f'<p class="about">{escape(description)}</p>\n<div class="outcome">{escape(outcome)}</div>\n'
        f"<p>{escape(' · '.join(fact for fact in facts if fact))}</p></header>"
    )


def _figures(run: EvaluatedRun) -> Iterator[Row]:
    number, moves = run.number, run.followed is not None
    vehicles, landed = _vehicles(run), number("vehicles_landed")
    all_landed = None if vehicles is None or landed is None else landed == vehicles
    yield _row("Vehicles landed and disarmed", _text(vehicles, "", 0), "", _landed(run), all_landed)
    for name, key, unit in (("speed", "speed_m_s", "m/s"), ("acceleration", "acceleration_m_s2", "m/s²")):
        flown, limit = number(f"flown_peak_{key}"), run.summary.limit(key)
        planned = "" if moves else _text(number(f"peak_{key}"), unit)
        yield _row(f"Highest {name}", _text(limit, unit, None, "≤ "), planned, _text(flown, unit), *_kept(flown, limit))
    flown, limit = number("flown_min_separation_m"), number("separation_m")
    far_enough = None if flown is None or limit is None else flown >= limit
    planned = "" if moves else _text(number("min_separation_m"), "m")
    yield _row("Smallest separation", _text(limit, "m", None, "≥ "), planned, _text(flown, "m"), far_enough)
    true_m = number("true_min_separation_m")
    if true_m is not None:
        truly = None if limit is None else true_m >= limit
        yield _row("Smallest true separation in the air", _text(limit, "m", None, "≥ "), "", _text(true_m, "m"), truly)
    yield from _fault_figures(run)
    for hit in run.summary.incidents:
        yield _row("Hit", "nothing", "", hit, kept=False)
    planned, held = _text(number("flux_metric"), "", 3), _text(number("flown_flux_metric"), "", 3)
    planned = "" if moves else planned
    yield _row("Flux metric at the hold (1 is best)", "", planned, held)
    yield _row("Tracking error, root mean square", "", "", _text(number("tracking_rms_m"), "m", 3))
    yield _row("Tracking error, largest", "", "", _text(number("tracking_max_m"), "m", 3))
    if run.followed is not None:
        yield from _tracking_figures(run)
    rate, asked = number("setpoint_rate_hz"), None if run.mission is None else run.mission.stream.rate_hz
    often = None if rate is None or asked is None else rate >= asked * (1.0 - RATE_SLACK)
    yield _row("Setpoints for the vehicle served worst", _text(asked, "Hz", None), "", _text(rate, "Hz", 1), often)
    late, period = number("setpoint_late_p99_ms"), None if asked is None else 1e3 / asked
    timely = None if late is None or period is None else late < period
    yield _row("Lateness of 99 % of the setpoints", _text(period, "ms", None, "< "), "", _text(late, "ms"), timely)


def _fault_figures(run: EvaluatedRun) -> Iterator[Row]:
    """What was computed of vehicles that hear nothing any more, one of them or all."""
    least = None if run.mission is None else run.mission.limits.fault_least_m
    for name, key in (
        ("Smallest separation if a vehicle stops hearing us", "min_fault_separation_m"),
        ("Smallest separation if this program is gone", "vanished_separation_m"),
    ):
        planned = run.number(key)
        if planned is not None:
            yield _row(name, _text(least, "m", None, "≥ "), _text(planned, "m"), "")


def _tracking_figures(run: EvaluatedRun) -> Iterator[Row]:
    for name, key, unit, digits in (
        ("Time until the target was caught", "capture_time_s", "s", 1),
        ("Centre off the true target, root mean square", "centre_error_rms_m", "m", 2),
        ("Centre off the true target, 95 % of the time below", "centre_error_p95_m", "m", 2),
        ("Share of the time after the capture with a flux metric of 0.9", "flux_metric_share", "", 3),
        ("Smallest coverage on the way, once it faces the target", "coverage_min_after_facing", "", 3),
        ("Trajectories planned", "replans", "", 0),
        ("Planning one, 99 % of them in less than", "replan_p99_ms", "ms", 1),
        ("From a sighting's arrival to its setpoint, 99 % in less than", "sensed_to_setpoint_p99_ms", "ms", 1),
        ("From a sighting's stamp to its setpoint, 99 % in less than", "stamp_to_setpoint_p99_ms", "ms", 1),
        ("Sightings", "sightings", "", 0),
    ):
        yield _row(name, "", "", _text(run.number(key), unit, digits))
    for again in run.found_again_s:
        yield _row("Lost, and found again within", "", "", "never" if again is None else _text(again, "s", 1))
    for reason, count in run.summary.table("sightings_rejected").items():
        yield _row(f"Sightings refused: {str(reason).replace('_', ' ')}", "", "", str(count))


def _row(name: str, asked: str, planned: str, flown: str, kept: bool | None = None, remark: str = "") -> Row:
    mark = Cell("") if kept is None else Cell(f"{KEPT if kept else BROKEN} {remark}".strip(), "yes" if kept else "no")
    return Row((name, asked, planned, flown, mark))


def _kept(flown: float | None, limit: float | None) -> tuple[bool | None, str]:
    """Say whether a flown peak counts as within its limit, and by how much it lies above."""
    if flown is None or limit is None:
        return None, ""
    excess = flown / limit - 1.0
    return excess <= FLOWN_SLACK, f"{100 * excess:.1f} % above" if excess > 0.0005 else ""  # less does not show


def _timings(run: EvaluatedRun) -> str:
    milliseconds = [
        ("Searching the path", _text(run.number("plan_time_s"), "ms", 1, scale=1e3)),
        ("Timing and verifying it", _text(run.number("timing_time_s"), "ms", 1, scale=1e3)),
    ]
    vehicles, samples = _vehicles(run), len(run.telemetry["time_s"])
    times = run.telemetry["time_s"]
    telemetry_hz = None
    if vehicles and samples > 1 and times[-1] > times[0]:
        telemetry_hz = samples / vehicles / float(times[-1] - times[0])
    traffic = [
        ("Positions from each vehicle", _text(telemetry_hz, "Hz", 1)),
        ("Setpoints for the vehicle served worst", _text(run.number("setpoint_rate_hz"), "Hz", 1)),
        ("Rounds of setpoints left out, being late", _text(run.number("late_ticks"), "", 0)),
        *_gated(run),
        ("MAVLink frames received", _text(run.number("frames_in"), "", 0)),
        ("MAVLink frames sent", _text(run.number("frames_out"), "", 0)),
        ("Bytes that were no MAVLink", _text(run.number("bad_bytes"), "", 0)),
        ("Messages of unknown kind", _text(run.number("unknown_messages"), "", 0)),
    ]
    before = [(f"Stage: {name}", f"{e - b:.2f} s") for name, (b, e) in run.stages.items() if name in ON_GROUND]
    stages = [(f"Stage: {band.stage}", f"{band.end_s - band.begin_s:.2f} s") for band in run.bands]
    columns = (table((), [Row(pair) for pair in pairs]) for pairs in (milliseconds + before + stages, traffic))
    return f'<div class="columns">{"".join(f"<div>{column}</div>" for column in columns)}</div>'


def _gated(run: EvaluatedRun) -> Iterator[tuple[str, str]]:
    """Yield a line of what the last gate has done, if anything."""
    counts = {name: count for name, count in run.summary.table("gate").items() if isinstance(count, int) and count}
    if counts:
        done = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())
        yield "Setpoints that did not pass the last gate", done


def _events(events: Sequence[LoggedEvent]) -> Iterator[Row]:
    """Yield the diary's rows: what matters in colour, and what many vehicles say at once in one row."""
    told = [event for event in events if event.kind not in QUIET]
    rows = [row for _, group in groupby(told, _gist) for row in _told(list(group))]
    yield from rows[:MOST_EVENTS]
    if len(rows) > MOST_EVENTS:
        yield Row(("", "", f"and {len(rows) - MOST_EVENTS} more in events.jsonl"))


def _gist(event: LoggedEvent) -> tuple[str, str]:
    said = SAID_BY_VEHICLE.fullmatch(event.text)
    return event.kind, said[2] if said else event.text


def _told(events: Sequence[LoggedEvent]) -> Iterator[Row]:
    """Yield rows for events of the same kind and words, one for those that came within a second."""
    while events:
        first = events[0]
        together = [event for event in events if event.time_s - first.time_s <= TOGETHER_S]
        said = [SAID_BY_VEHICLE.fullmatch(event.text) for event in together]
        vehicles = {VehicleAddress.labelled(match[1]) for match in said if match}
        text = f"{vehicles_named(vehicles)}: {_gist(first)[1]}" if len(vehicles) > 1 else first.text
        yield Row((f"{first.time_s:.2f}", first.kind, text), _weight(first))
        events = events[len(together) :]


def _weight(event: LoggedEvent) -> str:
    severity = event.severity if isinstance(event.severity, int) else ERROR + WARNING
    if event.kind in ("fault", "abort", "error", "recording") or severity <= ERROR:
        return "fault"
    if event.kind in ("warning", "notice", "limit") or severity <= WARNING:
        return "care"
    return "stage" if event.kind == "stage" else ""


def _vehicles(run: EvaluatedRun) -> float | None:
    """Return how many vehicles were asked for; the summary of a run without a plan does not know."""
    planned = run.number("vehicles")
    return planned if planned is not None or run.mission is None else float(run.mission.swarm.vehicles)


def _landed(run: EvaluatedRun) -> str:
    landed, vehicles = run.number("vehicles_landed"), _vehicles(run)
    if landed is None:
        return NO_FIGURE
    return f"{landed:.0f} of {vehicles:.0f}" if vehicles is not None else f"{landed:.0f}"


def _text(value: float | None, unit: str, digits: int | None = 2, sign: str = "", scale: float = 1.0) -> str:
    """Return a figure for people; without digits as short as it is."""
    if value is None:
        return NO_FIGURE
    figure = f"{value * scale:g}" if digits is None else f"{value * scale:.{digits}f}"
    return f"{sign}{figure} {unit}".strip()
