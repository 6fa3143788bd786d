"""Memory of the simulator's process: what it needs no more once everything is loaded goes back to the system."""

from __future__ import annotations

import ctypes
import gc
import re
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

MAPPINGS = Path("/proc/self/smaps")  # Linux
MADV_DONTNEED = 4  # Linux
FIRST_LINE = re.compile(r"(?P<begin>[0-9a-f]+)-(?P<end>[0-9a-f]+) (?P<rights>\S{4}) \S+ \S+ \d+ +(?P<file>/.*)?")


class Mapping(NamedTuple):
    """Part of the address space."""

    begin: int
    end: int


def settle() -> None:
    """Give back what was needed for loading alone, and keep garbage collections short from now on.

    Machine code comes with its compiler, 70 MB of which no page is touched again once the kernels are loaded; what is
    touched all the same is read again from its file. A collection that looked at everything that is loaded would take
    as long as several ticks. Elsewhere than on Linux nothing is given back.
    """
    gc.collect()
    gc.freeze()
    with suppress(OSError, AttributeError):  # no such file, or no such call
        _give_back(unchanged(MAPPINGS.read_text()))


def unchanged(mappings: str) -> list[Mapping]:
    """Which parts of memory are as their files are, and stay so: they can be dropped, and are read again when used.

    Args:
        mappings: as the system describes them, see proc_pid_smaps(5).
    """
    found: list[Mapping] = []
    candidate: Mapping | None = None
    for line in mappings.splitlines():
        if head := FIRST_LINE.match(line):
            of_file = head["file"] and "w" not in head["rights"] and head["rights"][-1] == "p"
            candidate = Mapping(int(head["begin"], 16), int(head["end"], 16)) if of_file else None
        elif candidate and line.split() == ["Anonymous:", "0", "kB"]:  # the loader changed nothing there
            found.append(candidate)
    return found


def _give_back(mappings: list[Mapping]) -> None:
    """Drop parts of memory that are as their files are.

    Raises:
        OSError, AttributeError: the system has no such call.
    """
    system = ctypes.CDLL(None)
    advise = system.madvise
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    for mapping in mappings:
        advise(mapping.begin, mapping.end - mapping.begin, MADV_DONTNEED)
    with suppress(AttributeError):  # of the GNU library alone
        system.malloc_trim(0)
