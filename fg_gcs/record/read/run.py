"""A recorded run read back from its folder, whole or in part: what reports and replays are made of."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.errors import MissionError
from fg_gcs.mission import Mission, load_mission
from fg_gcs.record.evaluate.figures import Flown, Whereabouts, flown
from fg_gcs.record.evaluate.tracking import Followed, estimated_centre, true_centre
from fg_gcs.record.write.recorder import EVENTS, MISSION, SUMMARY, TABLES
from fg_gcs.record.write.table import REPLANS, SIGHTINGS, TRUTH, Columns, Table, load

IN_FLIGHT = ("take-off", "gather", "approach", "hold", "home", "land")
STAMP_FORMAT, STAMP_LENGTH = "%Y-%m-%dT%H-%M-%S", 19  # how the name of a run's folder begins
TRACKING = (("sightings", SIGHTINGS), ("replans", REPLANS), ("truth", TRUTH))


class LoggedEvent(NamedTuple):
    """A line of the run's diary."""

    time_s: float
    kind: str
    text: str
    severity: int | None  # of a vehicle's own words: MAVLink's scale, 0 emergency to 7 debug


class Band(NamedTuple):
    """A stage of the flight as it came, even if it was cut short or flown twice."""

    stage: str
    begin_s: float
    end_s: float


@dataclass(frozen=True)
class Run:
    """What a run's folder holds; all times are seconds since the run's start."""

    name: str  # of the mission
    begun: datetime | None  # local time, None when the folder was renamed
    mission: Mission | None  # None when the mission file is no longer understood
    summary: dict[str, Any]
    events: tuple[LoggedEvent, ...]
    telemetry: Columns
    setpoints: Columns
    ticks: Columns
    sightings: Columns  # empty, like the next two, where nothing moved
    replans: Columns
    truth: Columns

    @cached_property
    def stages(self) -> dict[str, tuple[float, float]]:
        """Begin and end of every stage [s]; of a stage that was flown twice, the second time."""
        return {name: (span[0], span[1]) for name, span in self.summary.get("stages", {}).items()}

    @cached_property
    def leaders(self) -> tuple[int, ...]:
        """System ids of the leaders in their winding order, heard or not; empty when there was no plan."""
        return tuple(int(system_id) for system_id in self.summary.get("leader_ids") or ())

    @cached_property
    def target_enu_m(self) -> Array | None:
        """The target, shape (3,) [m; ENU]."""
        target = self.summary.get("target_enu_m")
        return None if target is None else np.array(target, dtype=float)

    @cached_property
    def followed(self) -> Followed | None:
        """What was tracked; None where nothing moved, or the mission file is no longer understood."""
        mission, stages = self.mission, self.stages
        if mission is None or mission.targets is None or "approach" not in stages:
            return None
        began_s, ended_s = stages["approach"]
        taken_s = self.number("capture_time_s")
        task = mission.task()
        return Followed(
            began_s,
            stages.get("hold", (0.0, ended_s))[1],
            None if taken_s is None else began_s + taken_s,
            tuple(target.weight for target in mission.targets),
            task.formation.leaders_m,
            task.hold_depth_m,
            mission.track.capture_m,
            mission.track.lost_after_s,
        )

    @cached_property
    def true_target(self) -> Whereabouts | None:
        """Where the centre of moving targets truly was, if that is known."""
        return None if self.followed is None else true_centre(self.truth, self.followed.weights)

    @cached_property
    def estimated_target(self) -> Whereabouts | None:
        """Where the centre of moving targets was believed to be."""
        return None if self.followed is None else estimated_centre(self.replans)

    @cached_property
    def series(self) -> Flown | None:
        """The flight's series, or None when there are too few samples for any."""
        standing = np.full(3, np.nan) if self.target_enu_m is None else self.target_enu_m
        target = self.true_target or self.estimated_target or Whereabouts.standing(standing)
        return flown(self.telemetry, self.setpoints, self.stages, self.leaders, target)

    @cached_property
    def bands(self) -> tuple[Band, ...]:
        """The stages in the air, in the order in which they were flown."""
        marks = [event for event in self.events if event.kind in ("stage", "abort")]
        last_s = max((end for _, end in self.stages.values()), default=0.0)
        ends = [*(mark.time_s for mark in marks), last_s][1:]
        return tuple(
            Band(mark.text, mark.time_s, max(mark.time_s, end_s))
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

    def number(self, key: str) -> float | None:
        """Return a figure of the summary, or None when it was not measured."""
        return _number(self.summary.get(key))

    def limit(self, key: str) -> float | None:
        """Return a limit that the flight was planned with, or None when there is none."""
        return _number((self.summary.get("limits") or {}).get(key))


def load_run(folder: Path) -> Run:
    """Read a run's folder; what a crash or an abort left out is taken as empty.

    Raises:
        OSError: a file cannot be read.
        ValueError: a file is not what its name says.
    """
    summary = json.loads((folder / SUMMARY).read_text())
    if not isinstance(summary, dict):
        raise ValueError(f"{SUMMARY} is not an object")
    try:
        mission = load_mission(folder / MISSION)
    except MissionError:  # an older run, by the rules of its day
        mission = None
    try:
        begun = datetime.strptime(folder.name[:STAMP_LENGTH], STAMP_FORMAT)
    except ValueError:
        begun = None
    name = folder.name[STAMP_LENGTH + 1 :] if begun is not None else folder.name
    tables = [load(folder / f"{table}.npz") for table in TABLES]
    tracking = [_load_if_there(folder / f"{name}.npz", widths) for name, widths in TRACKING]
    lines = (folder / EVENTS).read_text(errors="replace").splitlines()
    return Run(name or folder.name, begun, mission, summary, _events(lines), *tables, *tracking)


def _events(lines: Sequence[str]) -> tuple[LoggedEvent, ...]:
    """Return the events of all whole lines; a crash may have cut the last."""
    events = []
    for line in lines:
        try:
            fields = json.loads(line)
            severity = fields.get("severity")
            events.append(LoggedEvent(float(fields["time_s"]), str(fields["kind"]), str(fields["text"]), severity))
        except (ValueError, KeyError, TypeError, AttributeError):
            continue
    return tuple(events)


def _load_if_there(path: Path, columns: Mapping[str, int]) -> Columns:
    """Read a table that runs of older versions do not have."""
    return load(path) if path.exists() else Table(columns).columns()


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None
