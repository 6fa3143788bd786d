"""The process that owns the SITL processes: it ends them when its standard input ends, whatever ends that.

``python -m fg_gcs.sitl.keeper`` reads lines of JSON, each a process to start: ``arguments``, ``environment``,
``folder`` and ``log``. It answers with lines of JSON: ``{"started": N, "pid": P}`` or ``{"failed": N, "why": ...}``
for the N-th of them, and ``{"ended": N, "code": C}`` when one has ended.

The console may be killed, or its terminal closed: the pipe ends all the same. A keeper that is itself killed takes the
processes with it, where the system has PR_SET_PDEATHSIG (Linux); elsewhere the console ends them, which sees that.
Each process leads a group of its own, so that what it has started ends with it, and Ctrl-C in the terminal is not for
it. Only what makes itself a session of its own, from inside, escapes.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import select
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

TERM_S: Final = 5.0  # both autopilots end within 2 s of a SIGTERM
_PR_SET_PDEATHSIG: Final = 1


class Keeper:
    """Starts processes, tells when they end, and ends those that are left."""

    def __init__(self) -> None:
        self._processes: dict[int, subprocess.Popen[bytes]] = {}
        self._count = 0

    def start(self, wish: dict[str, Any]) -> None:
        """Start a process, and tell what came of it."""
        number, self._count = self._count, self._count + 1
        folder = Path(wish["folder"])
        try:
            with (folder / wish["log"]).open("wb") as log:
                process = subprocess.Popen(
                    wish["arguments"],
                    cwd=folder,
                    env={**os.environ, **wish["environment"]},
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                    preexec_fn=_end_with_parent,  # sound, as this process has one thread
                )
        except (OSError, subprocess.SubprocessError) as error:
            _tell(failed=number, why=getattr(error, "strerror", None) or str(error))
            return
        self._processes[number] = process
        _tell(started=number, pid=process.pid)

    def look(self) -> None:
        """Tell of those that have ended; nothing of their groups is left then."""
        for number, process in list(self._processes.items()):
            if _has_ended(process):
                _send(process.pid, signal.SIGKILL)
                del self._processes[number]
                _tell(ended=number, code=process.wait())

    def end(self, woken: int) -> None:
        """End all: they are asked to, and killed if they do not.

        Args:
            woken: readable when one of them has ended.
        """
        for process in self._processes.values():
            _send(process.pid, signal.SIGTERM)
        deadline_s = time.monotonic() + TERM_S
        self.look()
        while self._processes:
            if _wait([woken], deadline_s - time.monotonic()):
                os.read(woken, 1 << 16)
            else:
                for process in self._processes.values():
                    _send(process.pid, signal.SIGKILL)
                deadline_s = math.inf
            self.look()


def main() -> None:
    """Keep processes until standard input ends, or until a SIGTERM."""
    keeper, rest, ended = Keeper(), b"", False

    def end(*_: object) -> None:
        nonlocal ended
        ended = True

    woken, wakes = os.pipe()
    for number in (woken, wakes):
        os.set_blocking(number, False)
    signal.set_wakeup_fd(wakes, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)  # it wakes us
    signal.signal(signal.SIGTERM, end)
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    while not ended:
        ready = _wait([0, woken], math.inf)
        if woken in ready:
            os.read(woken, 1 << 16)
        if 0 in ready:
            data = os.read(0, 1 << 16)
            ended = ended or not data
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                keeper.start(json.loads(line))
        keeper.look()
    keeper.end(woken)


def _wait(files: list[int], seconds: float) -> list[int]:
    """Wait until some files are readable, at most so long [s]; return which."""
    return select.select(files, [], [], None if math.isinf(seconds) else max(seconds, 0.0))[0]


def _has_ended(process: subprocess.Popen[bytes]) -> bool:
    """Tell whether a process has ended; not reaped yet it keeps its number, so that no other group can have that."""
    if hasattr(os, "waitid"):  # macOS has none
        return os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    return process.poll() is not None


def _tell(**what: object) -> None:
    with suppress(OSError):  # nobody is there any more; the pipe's end says the rest
        os.write(1, json.dumps(what).encode() + b"\n")


def _send(group: int, number: signal.Signals) -> None:
    with suppress(ProcessLookupError, PermissionError):  # macOS says the latter of groups that are only zombies
        os.killpg(group, number)


def _end_with_parent() -> None:
    """Let the system kill this process when its parent dies, where it can; between fork and exec."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)  # what is ignored stays so for programs that are started
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


if __name__ == "__main__":
    main()
