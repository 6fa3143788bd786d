"""One run's folder: everything that is written down while flying, closed whatever happens."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from fg_gcs.record.write.table import REPLANS, SETPOINTS, SIGHTINGS, TELEMETRY, TICKS, TRUTH, Table
from fg_gcs.record.write.tlog import TlogWriter

TLOG, EVENTS, SUMMARY, MISSION, REPORT = (
    "flight.tlog",
    "events.jsonl",
    "summary.json",
    "mission.toml",
    "report.html",
)
TABLES = ("telemetry", "setpoints", "ticks")
TRACKING_TABLES = ("sightings", "replans", "truth")  # empty where nothing moves


def make_folder(logs: Path, name: str, now: datetime) -> Path:
    """Create the folder of a run, ``<time>-<name>``; a second run within the same second gets a number.

    Raises:
        OSError: the place cannot be written.
    """
    stem = f"{now:%Y-%m-%dT%H-%M-%S}-{name}"
    for number in range(1000):
        folder = logs / (f"{stem}-{number}" if number else stem)
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise FileExistsError(f"{logs / stem}: a thousand runs in one second")


class Recorder:
    """Writes a run down; use it as a context manager. All times are seconds since the start of the run."""

    def __init__(self, folder: Path, mission_toml: str, start_s: float, epoch_s: float) -> None:
        """Begin a run.

        Args:
            folder: an empty folder of its own.
            mission_toml: the mission file's text, kept as flown.
            start_s: the clock's reading that counts as zero [s].
            epoch_s: Unix time of that instant, for the tlog [s].
        """
        self.folder = folder
        self.telemetry = Table(TELEMETRY)
        self.setpoints = Table(SETPOINTS)
        self.ticks = Table(TICKS)
        self.sightings = Table(SIGHTINGS)
        self.replans = Table(REPLANS)
        self.truth = Table(TRUTH)
        self.listener: Callable[[float, str, str], None] | None = None  # hears every event: time, kind, text
        self._start_s = start_s
        (folder / MISSION).write_text(mission_toml)
        with ExitStack() as stack:
            self._tlog = stack.enter_context(TlogWriter(folder / TLOG, epoch_s))
            self._events = stack.enter_context((folder / EVENTS).open("w"))
            self._open = stack.pop_all()

    def since_start_s(self, now_s: float) -> float:
        """Return the run's time of a reading of the clock [s]."""
        return now_s - self._start_s

    def frame(self, frame: bytes, now_s: float) -> None:
        """Log a MAVLink frame of either direction."""
        self._tlog.write(frame, now_s - self._start_s)

    def event(self, now_s: float, kind: str, text: str, **data: object) -> None:
        """Append an event: what happened, in words and in fields."""
        line = {"time_s": round(now_s - self._start_s, 4), "kind": kind, "text": text, **data}
        self._events.write(json.dumps(plain(line)) + "\n")
        self._events.flush()  # a crash must not take the last words along
        if self.listener is not None:
            self.listener(now_s - self._start_s, kind, text)

    def finish(self, summary: dict[str, object]) -> None:
        """Write the tables and the summary."""
        for name in (*TABLES, *TRACKING_TABLES):
            table: Table = getattr(self, name)
            table.save(self.folder / f"{name}.npz")
        (self.folder / SUMMARY).write_text(json.dumps(plain(summary), indent=1) + "\n")

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the files."""
        self._open.close()


def plain(value: object) -> object:
    """Return a value as strict JSON has it: no NaN or infinity, tuples as lists, paths and the like as text."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (str, bool, int)) or value is None:
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if hasattr(value, "tolist"):  # NumPy's arrays and numbers
        return plain(value.tolist())
    return [plain(item) for item in value] if isinstance(value, Iterable) else str(value)
