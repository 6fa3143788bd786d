"""The users' own values of parameters that a flight changes, on disk before they are changed.

A run that ends puts them back and forgets them. One that crashed, or was killed, leaves them here: the next run, or
`fg-gcs recover`, puts them back, and only where the value is still the one that was set.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final

STATE: Final = "fg-gcs"  # in the user's state folder
MOST_BYTES: Final = 65_536  # of one file: it has a handful of parameters


@dataclass(frozen=True)
class Kept:
    """One vehicle's parameters.

    Attributes:
        network: the vehicle's.
        system_id: likewise.
        uid: of its hardware, "" where it tells none.
        endpoint: where it was heard, as `--connect` takes it.
        autopilot: its profile's name.
        found: the user's own values by name.
        set: what they were set to.
        run: folder of the run.
        lock: name of the file that the run holds while it is alive.
    """

    network: str
    system_id: int
    uid: str
    endpoint: str
    autopilot: str
    found: Mapping[str, float]
    set: Mapping[str, float] = field(default_factory=dict)
    run: str = ""
    lock: str = ""

    def may_be(self, uid: str) -> bool:
        """Say whether it may be of the hardware with an identity, which is "" of one that tells none."""
        return not (self.uid and uid) or self.uid == uid

    @property
    def name(self) -> str:
        """Its file's name: one vehicle has one."""
        return re.sub(r"[^A-Za-z0-9.-]+", "_", f"{self.uid}-{self.network}-{self.endpoint}-{self.system_id}") + ".json"


def state_folder() -> Path:
    """Return where this program keeps what outlives a run, by the XDG base directory specification."""
    base = os.environ.get("XDG_STATE_HOME", "")
    return (Path(base) if base.startswith("/") else Path.home() / ".local" / "state") / STATE


class KeptParameters:
    """A folder of what is kept; open it with ``with``, so that others see that its run is alive.

    Args:
        folder: is made if it is not there.

    Raises:
        OSError: it cannot be used.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        _sweep(folder)
        self.lock = f"run-{os.getpid()}-{id(self):x}.lock"
        self._held: IO[bytes] = (folder / self.lock).open("wb")
        fcntl.flock(self._held, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def __enter__(self) -> KeptParameters:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """The run has ended; once is enough."""
        with suppress(OSError):
            (self.folder / self.lock).unlink()
        self._held.close()

    def keep(self, kept: Kept) -> None:
        """Write one vehicle's down, so that it survives whatever happens next.

        Raises:
            OSError: the disk does not take it.
        """
        path = self.folder / kept.name
        new = path.with_suffix(".new")
        with new.open("w", encoding="utf-8") as file:
            json.dump(asdict(kept), file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)

    def forget(self, kept: Kept) -> None:
        """One vehicle has its own values again."""
        with suppress(OSError):
            (self.folder / kept.name).unlink()

    def left(self) -> list[Kept]:
        """Return what runs have left that are not alive any more; what cannot be read is passed over."""
        return [kept for kept in read_kept(self.folder) if not is_alive(self.folder, kept)]


def read_kept(folder: Path) -> list[Kept]:
    """Return all that is kept in a folder; what cannot be read is passed over, see :func:`unreadable`."""
    return [kept for path in sorted(folder.glob("*.json")) if (kept := _read(path)) is not None]


def unreadable(folder: Path) -> list[Path]:
    """Return the files of a folder in which something was kept, but cannot be read any more."""
    return [path for path in sorted(folder.glob("*.json")) if _read(path) is None]


def last_sign_s(folder: Path, kept: Kept) -> float:
    """Return when the run that keeps it, or one that brings its vehicle down, gave its last sign of life [s; Unix].

    A run writes into its own folder several times a second; that may be gone, and what is kept is not.
    """
    newest_s = 0.0
    for place in (folder / kept.name, Path(kept.run)):
        with suppress(OSError):
            for path in (place, *(place.iterdir() if place.is_dir() else ())):
                newest_s = max(newest_s, path.stat().st_mtime)
    return newest_s


def give_sign(folder: Path, kept: Kept) -> None:
    """Let others know that its vehicle is being brought down."""
    with suppress(OSError):
        os.utime(folder / kept.name)


def is_alive(folder: Path, kept: Kept) -> bool:
    """Say whether the run that keeps it still goes on."""
    try:
        with (folder / Path(kept.lock).name).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _sweep(folder: Path) -> None:
    """Remove the locks of runs that were killed."""
    for path in folder.glob("run-*.lock"):
        with suppress(OSError), path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()


def _read(path: Path) -> Kept | None:
    with suppress(OSError, ValueError, TypeError, KeyError):
        if path.stat().st_size <= MOST_BYTES:
            return _kept(json.loads(path.read_text(encoding="utf-8")))
    return None


def _kept(fields: Mapping[str, Any]) -> Kept:
    """Read one; raises whatever is wrong with it."""
    found, set_ = ({str(name): float(value) for name, value in dict(fields[key]).items()} for key in ("found", "set"))
    network, uid, endpoint, autopilot = (str(fields[key]) for key in ("network", "uid", "endpoint", "autopilot"))
    run, lock = str(fields["run"]), str(fields["lock"])
    return Kept(network, int(fields["system_id"]), uid, endpoint, autopilot, found, set_, run, lock)
