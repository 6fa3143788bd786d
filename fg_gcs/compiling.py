"""Machine code of the planner, kept in a folder whose name is the hash of every source that it comes from.

The compiler's own cache sees that a module changed, but not that a module it imports did, and code of both may be
joined into one function. So every state of the sources has a folder of its own: code that was compiled from others is
never loaded, and a process that still runs them goes on undisturbed.
"""

from __future__ import annotations

import hashlib
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

from numba import config as numba_config
from numba import njit

ROOMS = ("core", "plan", "track")  # where compiled code is
UNUSED_DAYS = 7.0  # of older folders: sources of last week rarely come back

SETTINGS: Final[Any] = numba_config  # a module whose names numba makes at run time

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def kernel(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Compile a function at its first call, or load what an earlier process compiled from the same sources."""
    return _compiled(function, nogil=False)


def long_kernel(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Compile a function that other threads run beside: for what takes longer than a setpoint may wait."""
    return _compiled(function, nogil=True)


def _compiled(function: Callable[_Arguments, _Result], *, nogil: bool) -> Callable[_Arguments, _Result]:
    others = SETTINGS.CACHE_DIR
    SETTINGS.CACHE_DIR = str(cache_folder())  # the compiler reads it while it decorates, and never again
    try:
        compiled: Callable[_Arguments, _Result] = njit(cache=True, nogil=nogil)(function)
    finally:
        SETTINGS.CACHE_DIR = others
    return compiled


@cache
def cache_folder() -> Path:
    """Return the folder of the present sources' code: beside them, or the user's own where that cannot be written."""
    digest = sources_hash(Path(__file__).parent)
    for base in (
        Path(SETTINGS.CACHE_DIR) if SETTINGS.CACHE_DIR else Path(__file__).parent / "__pycache__",
        _users_own(),
    ):
        folder = base / f"kernels-{sys.implementation.cache_tag}-{digest}"
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            probe = folder / f"writable-{time.monotonic_ns()}"
            probe.touch()
            probe.unlink()
            _drop_unused(folder)
            return folder
    return folder  # nowhere: the compiler says so


def sources_hash(package: Path) -> str:
    """Return a short hash of all sources that compiled code comes from.

    Args:
        package: folder of the package ``fg_gcs``.
    """
    digest = hashlib.sha256()
    sources = [package / "compiling.py", *(path for room in ROOMS for path in sorted((package / room).rglob("*.py")))]
    for source in sources:
        digest.update(source.relative_to(package).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def _users_own() -> Path:
    return Path.home() / ".cache" / "fg_gcs"


def _drop_unused(folder: Path) -> None:
    """Delete the folders of other sources that nothing was written to for days."""
    oldest_s = time.time() - 86400.0 * UNUSED_DAYS
    for other in folder.parent.glob("kernels-*"):
        with suppress(OSError):  # another process does the same at the same time
            if other != folder and other.stat().st_mtime < oldest_s:
                shutil.rmtree(other)
