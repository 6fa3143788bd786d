"""Telemetry logs: every frame of both directions with its time, as MAVExplorer, QGroundControl and mavlogdump read."""

from __future__ import annotations

import struct
from pathlib import Path
from types import TracebackType
from typing import Self

STAMP = struct.Struct(">Q")  # microseconds since 1970, big-endian, before every frame


class TlogWriter:
    """A tlog being written; use it as a context manager."""

    def __init__(self, path: Path, epoch_s: float) -> None:
        """Create the file; ``epoch_s`` is the Unix time of time zero [s]."""
        self._file = path.open("wb")
        self._epoch_s = epoch_s

    def write(self, frame: bytes, time_s: float) -> None:
        """Append a whole frame that passed at ``time_s`` [s]."""
        self._file.write(STAMP.pack(int((self._epoch_s + time_s) * 1e6)) + frame)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self._file.close()
