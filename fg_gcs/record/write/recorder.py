"""One run's folder: everything is written down while it happens, and nothing that goes wrong here stops a flight."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from fg_gcs.record.write.files import Document, GrowingFile, RunFile, TableFile, ThreadedWriter, Writer
from fg_gcs.record.write.layouts import LAYOUTS, TableLayout
from fg_gcs.record.write.tlog import stamped

TLOG, EVENTS, SUMMARY, MISSION, PARAMETERS, REPORT = (
    "flight.tlog",
    "events.jsonl",
    "summary.json",
    "mission.toml",
    "parameters.json",
    "report.html",
)
INPUTS, INDEX = "inputs", "index.json"  # files that the mission names, and which name each of them has there
BALLAST, BALLAST_BYTES = ".ballast", 131_072  # given up when the disk is full: room for the last event and the summary
MOST_BUFFERED_BYTES = 262_144  # of a file, until it is written without being asked to
UNFINISHED = "the run did not come to its end"

Time = TypeVar("Time", float, NDArray[np.float64])
Listener = Callable[[float, str, str], None]  # hears every event: time since the start [s], kind, text


class RecordingFailure(NamedTuple):
    """Why nothing is recorded any more."""

    text: str
    since_s: float  # since the start of the run


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


class Buffer:
    """What happened since a file was last written."""

    def __init__(self, file: RunFile, writer: Writer) -> None:
        """Collect for a file."""
        self._file = file
        self._writer = writer
        self._data = bytearray()
        self._time_s = 0.0

    def add(self, data: bytes, time_s: float) -> None:
        """Add what happened at a time since the start of the run [s]."""
        if self._writer.problem is not None:  # nothing is kept of what can never be written
            self._file.is_missing_some = True
            return
        self._data += data
        self._time_s = time_s
        if len(self._data) >= MOST_BUFFERED_BYTES:
            self.flush()

    def flush(self) -> None:
        """Hand everything to the writer."""
        if self._data:
            data, self._data = self._data, bytearray()
            self._writer.write(self._file, data, self._time_s)


class TableRecorder:
    """A table that grows, row by row or by many rows at once."""

    def __init__(self, layout: TableLayout, buffer: Buffer, writer: Writer) -> None:
        """Collect rows of a layout."""
        self._layout = layout
        self._buffer = buffer
        self._writer = writer

    def append(self, row: Sequence[float | str | bytes]) -> None:
        """Add a row, the time first; one that does not fit ends the recording."""
        try:
            self._buffer.add(self._layout.pack(row), float(row[0]))
        except Exception as error:  # a fault of ours, but none that a flight has to suffer for
            self._fail(error)

    def rows(self, count: int) -> NDArray[np.void]:
        """Return so many rows to fill in by the columns' names and to `extend` the table by, shape (count,)."""
        return np.empty(count, self._layout.dtype)

    def extend(self, rows: NDArray[np.void]) -> None:
        """Add rows in the order of their times; if they do not fit, recording ends."""
        if not len(rows):
            return
        try:
            if rows.dtype != self._layout.dtype:
                raise TypeError(f"they are of type {rows.dtype}")
            self._buffer.add(rows.tobytes(), float(rows[-1]["time_s"]))
        except Exception as error:  # likewise
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self._writer.fail(f"{self._layout.file_name}: a row does not fit its columns ({error})")


class Recorder:
    """Writes a run down; use it as a context manager. All times are seconds since the start of the run.

    Once it is made, nothing here raises, whatever becomes of the disk: when something cannot be written, recording
    ends with one event, and what is missing from when on stands in the summary.

    Attributes:
        folder: of the run.
        failure: why nothing is recorded any more, None while all is well.
        listeners: hear every event, even those that cannot be written any more.
    """

    def __init__(
        self,
        folder: Path,
        mission_toml: str,
        start_s: float,
        epoch_s: float,
        inputs: Mapping[str, bytes] | None = None,
        *,
        in_thread: bool = False,
    ) -> None:
        """Begin a run.

        Args:
            folder: an empty folder of its own.
            mission_toml: the mission file's text, kept as flown.
            start_s: the clock's reading that counts as zero [s].
            epoch_s: Unix time of that instant, for the tlog [s].
            inputs: the files that the mission names, by the paths as it has them.
            in_thread: a thread writes, so that a slow disk delays nothing; otherwise whoever records does.

        Raises:
            OSError: a file cannot be created: nothing has been flown yet.
        """
        self.folder = folder
        self.failure: RecordingFailure | None = None
        self.listeners: list[Listener] = []
        self._start_s, self._epoch_s = start_s, epoch_s
        self._now_s = 0.0  # the last time that anything was recorded
        self._known: dict[str, object] = {"completed": False, "reason": UNFINISHED, "run": folder.name}
        _keep_inputs(folder, mission_toml, inputs or {})
        self._files: list[RunFile] = []
        try:
            (folder / BALLAST).write_bytes(bytes(BALLAST_BYTES))
            for layout in LAYOUTS:
                self._files.append(TableFile(folder / layout.file_name, layout))
            self._files.append(GrowingFile(folder / TLOG))
            self._files.append(GrowingFile(folder / EVENTS))
        except OSError:
            self._close_files()
            raise
        self._summary, self._parameters = Document(folder / SUMMARY), Document(folder / PARAMETERS)
        self._writer = ThreadedWriter() if in_thread else Writer()
        *buffered, self._events = self._files
        self._buffers = [Buffer(file, self._writer) for file in buffered]
        tables = [
            TableRecorder(layout, buffer, self._writer) for layout, buffer in zip(LAYOUTS, self._buffers, strict=False)
        ]
        self.telemetry, self.setpoints, self.ticks, self.sightings, self.replans, self.truth = tables
        self._frames = self._buffers[-1]
        self._files += [self._summary, self._parameters]
        self._is_closed = False
        self.know()

    def since_start_s(self, now_s: Time) -> Time:
        """Return the run's time of a reading of the clock, or of many [s]."""
        return now_s - self._start_s

    def unix_s(self, now_s: float) -> float:
        """Return the Unix time of a reading of the clock [s]."""
        return self._epoch_s + now_s - self._start_s

    def frames(self, frames: Sequence[bytes] | NDArray[np.uint8], now_s: float) -> None:
        """Log whole MAVLink frames of either direction that passed at one time, see `stamped`."""
        self._now_s = now_s - self._start_s
        try:
            self._frames.add(stamped(frames, self._epoch_s + self._now_s), self._now_s)
        except Exception as error:  # as `guard`, which costs as much as all this
            self._writer.fail(f"frames cannot be recorded ({type(error).__name__}: {error})")

    def event(self, now_s: float, kind: str, text: str, **data: object) -> None:
        """Append an event: what happened, in words and in fields; it is written at once."""
        self._now_s = now_s - self._start_s
        self._tell(kind, text, data)
        self._check()

    def know(self, **known: object) -> None:
        """Add to what the summary says if the run does not come to its end."""
        self._known |= known
        self._write_summary(self._known)

    def parameters(self, vehicles: Sequence[Mapping[str, object]]) -> None:
        """Keep the vehicles' parameters as found and as set, one object a vehicle."""
        with self.guard("parameters"):
            self._writer.write(self._parameters, _json({"vehicles": vehicles}), self._now_s)

    @contextmanager
    def guard(self, what: str) -> Iterator[None]:
        """Let nothing that goes wrong inside, where something is put together for the record, get any further."""
        try:
            yield
        except Exception as error:
            self._writer.fail(f"{what} cannot be recorded ({type(error).__name__}: {error})")

    def flush(self) -> None:
        """Write what has happened so far; to be called a few times a second."""
        for buffer in self._buffers:
            buffer.flush()
        self._check()

    def settle(self) -> None:
        """Write what has happened so far and wait until it is written: what is read after that is complete."""
        self.flush()
        self._writer.settle()
        self._check()

    def finish(self, summary: Mapping[str, object]) -> dict[str, object]:
        """Write the summary of a run that has come to its end; return it with what it says of the recording."""
        self._known = {**summary, **{key: value for key, value in self._known.items() if key not in summary}}
        self.settle()
        self._write_summary(self._known)
        self.settle()
        return self._told(self._known)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the files; a run that raised has its reason in the summary."""
        if error is not None:
            self._known |= {"completed": False, "reason": str(error) or type(error).__name__}
        self.settle()
        if error is not None:
            self._write_summary(self._known)
        self._writer.close()
        self._is_closed = True
        self._writer.fail("the run is over")
        self._close_files()

    # --- within --------------------------------------------------------------------------------------------------

    def _tell(self, kind: str, text: str, data: Mapping[str, object], *, even_so: bool = False) -> None:
        with self.guard("event"):
            line = {"time_s": round(self._now_s, 4), "kind": kind, "text": text, **data}
            until_s = self._events.until_s if even_so else self._now_s
            self._writer.write(self._events, _line(line), until_s, even_so=even_so)
        for listener in list(self.listeners):
            try:
                listener(self._now_s, kind, text)
            except Exception as error:  # nobody who only listens ends a flight
                self.listeners.remove(listener)
                self._tell("warning", f"a listener failed and hears no more: {error!r}", {})

    def _check(self) -> None:
        """Tell once that recording has ended, and give up the ballast for that."""
        if self._writer.problem is None or self.failure is not None or self._is_closed:
            return
        self.failure = RecordingFailure(self._writer.problem, self._now_s)
        with suppress(OSError):
            (self.folder / BALLAST).unlink(missing_ok=True)
        text = f"recording stopped: {self.failure.text}; the flight goes on"
        self._tell("recording", text, {}, even_so=True)
        self._write_summary(self._known)

    def _write_summary(self, summary: Mapping[str, object]) -> None:
        with self.guard("summary"):
            data = _json(self._told(summary))
            self._writer.write(self._summary, data, self._now_s, even_so=self.failure is not None)

    def _told(self, summary: Mapping[str, object]) -> dict[str, object]:
        """Return a summary as JSON has it, with what is missing in the folder."""
        others = [file for file in self._files if file is not self._summary]  # whoever reads this has the newest
        missing = {file.name: file.until_s for file in others if file.is_missing_some}
        recording = {
            "recording_complete": self.failure is None,
            "recording_failure": None if self.failure is None else self.failure._asdict(),
            "recording_missing": missing,  # by file: from when on something is not there [s]
        }
        plained = plain({**summary, **recording})
        assert isinstance(plained, dict)
        return plained

    def _close_files(self) -> None:
        for file in self._files:
            with suppress(OSError):
                file.close()
        with suppress(OSError):
            (self.folder / BALLAST).unlink(missing_ok=True)


def _keep_inputs(folder: Path, mission_toml: str, inputs: Mapping[str, bytes]) -> None:
    """Copy what a run is made from into its folder."""
    (folder / MISSION).write_text(mission_toml)
    if not inputs:
        return
    place = folder / INPUTS
    place.mkdir()
    names = {path: f"{number}-{PurePosixPath(path).name}"[:200] for number, path in enumerate(inputs, start=1)}
    for path, data in inputs.items():
        (place / names[path]).write_bytes(data)
    (place / INDEX).write_bytes(_json(names))


def _json(value: object) -> bytes:
    return (json.dumps(plain(value), indent=1) + "\n").encode()


def _line(value: object) -> bytes:
    return (json.dumps(plain(value)) + "\n").encode()


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
