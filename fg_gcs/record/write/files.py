"""Files that grow while a run goes on, each whole after any crash; and what writes them, at once or in a thread."""

from __future__ import annotations

import errno
import os
import queue
import threading
from pathlib import Path
from typing import NamedTuple, Protocol

from fg_gcs.record.write.layouts import TableLayout

Data = bytes | bytearray

MOST_WAITING_BYTES = 16_000_000  # a dozen seconds of 250 vehicles: disks that pause for longer do not keep up
SETTLE_S = 10.0  # how long the end of a run waits for what has not been written yet
TOO_SLOW = "the disk does not keep up"


class RunFile(Protocol):
    """A file of a run.

    Attributes:
        name: within the run's folder.
        until_s: time of the last thing that is in it, since the start of the run [s].
        is_missing_some: something that belongs into it is not there.
    """

    name: str
    until_s: float
    is_missing_some: bool

    def write(self, data: Data, time_s: float) -> None:
        """Write what happened until a time [s].

        Raises:
            OSError: it cannot be written; what was in the file is still there, and readable.
        """

    def close(self) -> None:
        """Close it; may be called twice."""


class GrowingFile:
    """A file to whose end things are added; a cut one is cut back to what is whole."""

    def __init__(self, path: Path, begin: bytes = b"") -> None:
        """Create it.

        Raises:
            OSError: it cannot be created.
        """
        self.name = path.name
        self.until_s = 0.0
        self.is_missing_some = False
        self._file = path.open("wb", buffering=0)
        self._size = 0
        try:
            self._append(begin)
        except OSError:
            self.close()
            raise
        self._size = len(begin)

    def write(self, data: Data, time_s: float) -> None:
        """Add to the end."""
        try:
            self._append(data)
        except OSError:
            self._file.truncate(self._size)
            raise
        self._size += len(data)
        self.until_s = time_s

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _append(self, data: Data) -> None:
        """Write behind the last whole thing, or raise with a part of it there."""
        number, rest, place = self._file.fileno(), memoryview(data), self._size
        if os.fstat(number).st_nlink == 0:
            raise FileNotFoundError(errno.ENOENT, "the file is gone")
        while len(rest):
            written = os.pwrite(number, rest, place)
            rest, place = rest[written:], place + written


class TableFile(GrowingFile):
    """A table's ``.npy``: rows are added, then counted in its header."""

    def __init__(self, path: Path, layout: TableLayout) -> None:
        """Create it, empty.

        Raises:
            OSError: it cannot be created.
        """
        self._layout = layout
        self._begin = len(layout.header())
        super().__init__(path, layout.header())

    def write(self, data: Data, time_s: float) -> None:
        """Add packed rows; the time is that of the last."""
        super().write(data, time_s)
        rows = (self._size - self._begin) // self._layout.row_bytes
        os.pwrite(self._file.fileno(), self._layout.count(rows), self._layout.count_offset)


class Document:
    """A small file that is replaced as a whole, or not at all."""

    def __init__(self, path: Path) -> None:
        """Write nothing yet."""
        self.name = path.name
        self.until_s = 0.0
        self.is_missing_some = False
        self._path = path

    def write(self, data: Data, time_s: float) -> None:
        """Replace the file's content."""
        draft = self._path.with_name(f".{self._path.name}.draft")
        try:
            draft.write_bytes(data)
            draft.replace(self._path)
        except OSError:
            draft.unlink(missing_ok=True)
            raise
        self.until_s = time_s

    def close(self) -> None:
        """Do nothing: it is open only while it is written."""


class _Job(NamedTuple):
    file: RunFile
    data: Data
    time_s: float
    even_so: bool


class Writer:
    """Writes at once, in the order of the calls; after the first failure nothing more but what is written even so.

    Attributes:
        problem: what could not be written and why; None while all is well.
    """

    def __init__(self) -> None:
        self.problem: str | None = None

    def write(self, file: RunFile, data: Data, time_s: float, *, even_so: bool = False) -> None:
        """Write what happened until a time [s]; never raises, whatever comes."""
        self._do(_Job(file, data, time_s, even_so))

    def fail(self, problem: str) -> None:
        """Stop writing, for a reason that is told if it is the first."""
        if self.problem is None:
            self.problem = problem

    def settle(self) -> None:
        """Wait until everything is written that was asked for, though not for ever."""

    def close(self) -> None:
        """Write what is still to be written, and no more after that."""

    def _do(self, job: _Job) -> None:
        if self.problem is not None and not job.even_so:
            job.file.is_missing_some = True
            return
        try:
            job.file.write(job.data, job.time_s)
        except Exception as error:  # whatever it is, the flight goes on
            job.file.is_missing_some = True
            self.fail(f"{job.file.name} cannot be written ({_said(error)})")


class ThreadedWriter(Writer):
    """Does the same in a thread of its own, so that a slow disk holds nothing up; so much may wait and no more."""

    def __init__(self, most_waiting_bytes: int = MOST_WAITING_BYTES) -> None:
        super().__init__()
        self._most = most_waiting_bytes
        self._jobs: queue.SimpleQueue[_Job | threading.Event | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._waiting = 0
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def write(self, file: RunFile, data: Data, time_s: float, *, even_so: bool = False) -> None:
        """Let the thread write; if too much waits already, the disk does not keep up."""
        if not even_so:
            if self._waiting + len(data) > self._most:
                self.fail(TOO_SLOW)
            if self.problem is not None:
                file.is_missing_some = True
                return
        with self._lock:
            self._waiting += len(data)
        self._jobs.put(_Job(file, data, time_s, even_so))

    def settle(self) -> None:
        """Wait for the thread."""
        done = threading.Event()
        self._jobs.put(done)
        if not done.wait(SETTLE_S if self.problem is None else SETTLE_S / 10.0):
            self.fail(TOO_SLOW)

    def close(self) -> None:
        """Wait for the thread and end it; one that hangs is left behind."""
        self.settle()
        self._jobs.put(None)
        self._thread.join(SETTLE_S / 10.0)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            if isinstance(job, threading.Event):
                job.set()
                continue
            self._do(job)
            with self._lock:
                self._waiting -= len(job.data)


def _said(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error or type(error).__name__)
