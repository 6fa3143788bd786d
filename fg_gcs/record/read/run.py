"""A recorded run read back from its folder, whole or in part: what reports and replays are made of."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from fg_gcs.core.arrays import Array
from fg_gcs.errors import FgError, MissionError
from fg_gcs.mission import Mission
from fg_gcs.mission.formats.toml import parse_mission, read_positions
from fg_gcs.record.read.regular import regular
from fg_gcs.record.read.summary import RunSummary
from fg_gcs.record.read.tables import MOST_S, read_table
from fg_gcs.record.write.layouts import LAYOUTS, Columns
from fg_gcs.record.write.recorder import EVENTS, INDEX, INPUTS, MISSION, SUMMARY
from fg_gcs.wire.address import VehicleAddress

IN_FLIGHT = ("take-off", "gather", "approach", "hold", "home", "spread", "land")
STAMP_FORMAT, STAMP_LENGTH = "%Y-%m-%dT%H-%M-%S", 19  # how the name of a run's folder begins
OLD_TABLES = "telemetry.npz", "setpoints.npz"  # of versions that wrote tables at the end of a run


class RunError(FgError):
    """A folder is not that of a recorded run."""

    def __init__(self, folder: Path, found: str) -> None:
        """Say which folder, and what is there instead."""
        super().__init__(f"{folder}: not the folder of a recorded run: {found}")


class LoggedEvent(NamedTuple):
    """A line of the run's diary."""

    time_s: float
    kind: str
    text: str
    severity: int | None  # of a vehicle's own words: MAVLink's scale, 0 emergency to 7 debug


class StageBand(NamedTuple):
    """A stage of the flight as it came, even if it was cut short or flown twice."""

    stage: str
    begin_s: float
    end_s: float


@dataclass(frozen=True)
class RecordedRun:
    """What a run's folder holds; all times are seconds since the run's start."""

    name: str  # of the mission
    begun: datetime | None  # local time, None when the folder was renamed
    mission: Mission | None  # None when the mission file is not understood
    summary: RunSummary
    events: tuple[LoggedEvent, ...]
    tables: Mapping[str, Columns]  # by name, all of them; empty ones where nothing was recorded
    remarks: tuple[str, ...]  # what is missing or damaged, a line each

    @property
    def telemetry(self) -> Columns:
        """What the vehicles reported."""
        return self.tables["telemetry"]

    @property
    def setpoints(self) -> Columns:
        """What they were told."""
        return self.tables["setpoints"]

    @property
    def ticks(self) -> Columns:
        """When rounds of setpoints left."""
        return self.tables["ticks"]

    @property
    def sightings(self) -> Columns:
        """What was seen of moving targets."""
        return self.tables["sightings"]

    @property
    def replans(self) -> Columns:
        """Trajectories that were planned after moving targets."""
        return self.tables["replans"]

    @property
    def truth(self) -> Columns:
        """Where moving targets truly were."""
        return self.tables["truth"]

    @cached_property
    def last_s(self) -> float:
        """When the last thing was recorded [s]."""
        times = [float(table["time_s"].max()) for table in self.tables.values() if len(table["time_s"])]
        return max([0.0, *times, *(event.time_s for event in self.events)])

    @cached_property
    def stages(self) -> dict[str, tuple[float, float]]:
        """Begin and end of every stage [s]; of a stage that was flown twice, the second time."""
        return self.summary.spans(self.last_s)

    @cached_property
    def leaders(self) -> tuple[VehicleAddress, ...]:
        """The leaders in their winding order, heard or not; empty when there was no plan."""
        return self.summary.vehicles("leader_ids")

    @cached_property
    def target_enu_m(self) -> Array | None:
        """The target, shape (3,) [m; ENU]."""
        return self.summary.point("target_enu_m")

    @cached_property
    def bands(self) -> tuple[StageBand, ...]:
        """The stages in the air, in the order in which they were flown."""
        marks = [event for event in self.events if event.kind in ("stage", "abort")]
        last_s = max((end for _, end in self.stages.values()), default=0.0)
        ends = [*(mark.time_s for mark in marks), last_s][1:]
        return tuple(
            StageBand(mark.text, mark.time_s, max(mark.time_s, end_s))
            for mark, end_s in zip(marks, ends, strict=True)
            if mark.kind == "stage" and mark.text in IN_FLIGHT
        )

    @cached_property
    def span_s(self) -> tuple[float, float]:
        """Begin and end of the flight [s]; of all samples when no stage is known."""
        if self.bands:
            return self.bands[0].begin_s, self.bands[-1].end_s
        times = self.telemetry["time_s"]
        return (float(times.min()), float(times.max())) if len(times) else (0.0, 1.0)


def load_run(folder: Path) -> RecordedRun:
    """Read a run's folder; what is missing or damaged is taken as empty, and told in the remarks.

    Raises:
        RunError: it is not the folder of a run at all, or that of a version that recorded in another form.
    """
    files = (SUMMARY, EVENTS, MISSION, *(layout.file_name for layout in LAYOUTS))
    try:
        there = {path.name for path in folder.iterdir()}
    except OSError as error:
        raise RunError(folder, error.strerror or str(error)) from error
    if there.intersection(OLD_TABLES):
        raise RunError(folder, f"an older version of fg-gcs recorded it ({OLD_TABLES[0]}); that version can report it")
    if not there.intersection(files):
        raise RunError(folder, f"none of {', '.join(files[:3])} is there")
    summary = RunSummary.read(folder / SUMMARY)
    mission, unread = _mission(folder)
    events, cut = _events(folder / EVENTS)
    tables = {layout.name: read_table(folder / layout.file_name, layout) for layout in LAYOUTS}
    remarks = [*summary.remarks, unread, cut, *(table.remark for table in tables.values()), *_unrecorded(summary)]
    stem = summary.text("run") or folder.name
    begun = _begun(stem)
    return RecordedRun(
        (stem[STAMP_LENGTH + 1 :] if begun is not None else stem) or stem,
        begun,
        mission,
        summary,
        events,
        {name: table.columns for name, table in tables.items()},
        tuple(remark for remark in remarks if remark is not None),
    )


def _begun(stem: str) -> datetime | None:
    try:
        return datetime.strptime(stem[:STAMP_LENGTH], STAMP_FORMAT)
    except ValueError:
        return None


def _mission(folder: Path) -> tuple[Mission | None, str | None]:
    """Read the mission as flown, the files that it names from the copies beside it."""
    try:
        names = json.loads(regular(folder / INPUTS / INDEX).read_bytes())
    except (OSError, ValueError, RecursionError):
        names = {}

    def copy_of(path: str) -> Path:
        name = names.get(path) if isinstance(names, dict) else None
        return folder / INPUTS / Path(name if isinstance(name, str) else path).name

    try:
        text = regular(folder / MISSION).read_bytes().decode()
        return parse_mission(text, Path(MISSION), lambda path: read_positions(copy_of(path), path)), None
    except OSError as error:
        return None, f"{MISSION}: cannot be read: {error.strerror or error}"
    except UnicodeDecodeError as error:
        return None, f"not understood: {MISSION}: not a TOML file: {error}"
    except MissionError as error:  # damaged, or by the rules of another day
        return None, f"not understood: {error}"


def _events(path: Path) -> tuple[tuple[LoggedEvent, ...], str | None]:
    """Read the events of all whole lines, and say how many others there are; a crash may have cut the last."""
    try:
        lines = regular(path).read_bytes().decode("utf-8", "replace").split("\n")
    except OSError as error:
        return (), f"{path.name}: cannot be read: {error.strerror or error}"
    found = [_event(line) for line in lines if line]
    events = tuple(event for event in found if event is not None)
    others = len(found) - len(events)
    return events, f"{path.name}: {others} of {len(found)} lines are not events" if others else None


def _event(line: str) -> LoggedEvent | None:
    try:
        fields = json.loads(line)
        time_s, severity = float(fields["time_s"]), fields.get("severity")
        event = LoggedEvent(time_s, str(fields["kind"]), str(fields["text"]), severity)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        return None
    is_known = severity is None or (isinstance(severity, int) and not isinstance(severity, bool))
    return event._replace(severity=severity if is_known else None) if _is_time(time_s) else None


def _is_time(time_s: float) -> bool:
    return math.isfinite(time_s) and abs(time_s) <= MOST_S


def _unrecorded(summary: RunSummary) -> Sequence[str]:
    """Tell what the recorder itself says is missing."""
    missing = summary.table("recording_missing")
    told = [
        f"{name}: nothing after {since_s:.2f} s was recorded" for name, since_s in missing.items() if _told(since_s)
    ]
    failure = summary.table("recording_failure").get("text")
    return ([f"recording stopped: {failure}"] if isinstance(failure, str) else []) + told


def _told(since_s: object) -> bool:
    return isinstance(since_s, (int, float)) and _is_time(since_s)
