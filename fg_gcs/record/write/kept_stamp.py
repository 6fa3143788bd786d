"""The time stamp up to which our frames may be signed, on disk before any frame is.

A clock that is set back, or a machine without one, must not make us sign with stamps that were used before: vehicles
would not take them. What is on disk is a little ahead of what is used, so that a crash does no harm.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Final

from fg_gcs.wire.signing import UNITS_PER_S

RESERVE_S: Final = 20.0  # ahead of what is used: less than the minute by which others' stamps may be behind ours
KEEP_EVERY_S: Final = 8.0  # so that a writing that takes a while is no matter
NAME: Final = "signing-stamp"
_MOST_DIGITS: Final = 15  # 48 bits


class KeptStamp:
    """The file of it in a folder.

    Args:
        folder: is made if it is not there.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / NAME

    def read(self) -> int:
        """Return what is kept; 0 where nothing is, or nothing that can be read."""
        with suppress(OSError, ValueError):
            with self._path.open("rb") as file:
                text = file.read(_MOST_DIGITS + 2).decode("ascii").strip()
            if text.isdecimal() and len(text) <= _MOST_DIGITS:
                return int(text)
        return 0

    def keep(self, stamp: int) -> None:
        """Write down that stamps from now up to a little later are used; what is there is never lowered.

        Raises:
            OSError: the disk does not take it.
        """
        reserved = stamp + int(RESERVE_S * UNITS_PER_S)
        if reserved <= self.read():
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        new = self._path.with_name(f"{NAME}-{os.getpid()}.new")
        with new.open("w", encoding="ascii") as file:
            file.write(f"{reserved}\n")
            file.flush()
            os.fsync(file.fileno())
        new.replace(self._path)
