"""Processes that end with this one, whatever ends it; see `fg_gcs.sitl.keeper`, which owns them."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Final

from fg_gcs.errors import LinkError, MissionError
from fg_gcs.sitl.instances import Layer, Port, Start
from fg_gcs.sitl.keeper import TERM_S

LOG: Final = "out.log"  # in the working folder of each: all that it says
KILL_S: Final = 5.0  # beyond `TERM_S`, for a machine that is busy
LAST_LINES: Final = 4
LONGEST_WORDS: Final = 300


class Processes:
    """The processes of one swarm, by the order in which they were started.

    Attributes:
        pids: of those that run.
    """

    def __init__(self, on_end: Callable[[int, int | None], None]) -> None:
        self.pids: dict[int, int] = {}
        command = [sys.executable, "-m", "fg_gcs.sitl.keeper"]
        self._keeper = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
        self._on_end = on_end
        self._started: list[asyncio.Future[None]] = []
        self._gone = asyncio.get_running_loop().create_future()

    async def start(self, start: Start, folder: Path) -> None:
        """Start a process in a folder.

        Raises:
            MissionError: it cannot be run, or its files cannot be written.
        """
        try:
            for name, text in start.texts.items():
                (folder / name).write_text(text)
        except OSError as error:
            raise MissionError(f"{folder}: {error.strerror or error}") from error
        wish = {
            "arguments": start.arguments,
            "environment": dict(start.environment),
            "folder": str(folder),
            "log": LOG,
        }
        done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._started.append(done)
        assert self._keeper.stdin is not None
        with suppress(OSError):  # it has gone: the future says so
            self._keeper.stdin.write(json.dumps(wish).encode() + b"\n")
            self._keeper.stdin.flush()
        if self._gone.done():
            self._settle(len(self._started) - 1, _gone())
        try:
            await done
        except OSError as error:
            raise MissionError(f"{start.arguments[0]} cannot be run: {error}") from error

    async def listen(self) -> None:
        """Take what the keeper tells until it has gone: run it as a task."""
        assert self._keeper.stdout is not None
        loop, reader = asyncio.get_running_loop(), asyncio.StreamReader()
        transport, _ = await loop.connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(reader, loop=loop), self._keeper.stdout
        )
        try:
            while line := await reader.readline():
                self._take(json.loads(line))
        finally:
            transport.close()
            self._has_gone()

    async def stop(self) -> None:
        """End all of them; returns when they have ended."""
        assert self._keeper.stdin is not None
        with suppress(OSError):
            self._keeper.stdin.close()
        try:
            await asyncio.wait_for(asyncio.shield(self._gone), TERM_S + KILL_S)
        finally:  # also when somebody does not want to wait any longer
            self._keeper.kill()
            self._keeper.wait()
            self._kill()

    def _take(self, told: dict[str, int | str]) -> None:
        match told:
            case {"started": int(number), "pid": int(pid)}:
                self.pids[number] = pid
                self._settle(number, None)
            case {"failed": int(number), "why": str(why)}:
                self._settle(number, OSError(why))
            case {"ended": int(number), "code": int(code)}:
                del self.pids[number]
                self._on_end(number, code)

    def _settle(self, number: int, error: OSError | None) -> None:
        future = self._started[number]
        if future.done():  # whoever asked for it has been cancelled
            return
        if error is None:
            future.set_result(None)
        else:
            future.set_exception(error)

    def _has_gone(self) -> None:
        """The keeper tells nothing any more: nothing that it kept may be left."""
        if not self._gone.done():
            self._gone.set_result(None)
        self._kill()
        for number in range(len(self._started)):
            self._settle(number, _gone())
        for number in tuple(self.pids):
            del self.pids[number]
            self._on_end(number, None)

    def _kill(self) -> None:
        for pid in self.pids.values():
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(pid, signal.SIGKILL)


def _gone() -> OSError:
    return OSError("the process that starts it has ended")


@asynccontextmanager
async def keeping(on_end: Callable[[int, int | None], None]) -> AsyncIterator[Processes]:
    """Have processes kept; all that was started ends with this context, or with our process.

    Args:
        on_end: called with the number of a process that has ended, and its exit code: negative, a signal; None: it is
            not known.
    """
    processes = Processes(on_end)
    listening = asyncio.ensure_future(processes.listen())
    try:
        yield processes
    finally:
        try:
            await processes.stop()
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)


def refuse_taken(ports: Iterable[tuple[int, Port]]) -> None:
    """Look whether ports are free that instances will bind.

    Args:
        ports: each with the number of its instance.

    Raises:
        LinkError: names one that is not.
    """
    for number, port in ports:
        kind = socket.SOCK_DGRAM if port.layer is Layer.UDP else socket.SOCK_STREAM
        with socket.socket(socket.AF_INET, kind) as probe:
            if port.layer is Layer.TCP:  # connections that have just ended are no hindrance, as for the instance
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port.number))
            except OSError as error:
                raise LinkError(
                    f"instance {number}: {port.layer.value} port {port.number} ({port.use}) is in use: is another "
                    "instance of that number running? --first-instance takes other ones"
                ) from error


def last_words(log: Path) -> str:
    """Return the last lines of a log, on one line; empty if there are none."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - 4096))
            lines = file.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return ""
    said = [" ".join("".join(c if c.isprintable() else " " for c in line).split()) for line in lines]
    text = " | ".join([line for line in said if line][-LAST_LINES:])
    return text if len(text) <= LONGEST_WORDS else f"... {text[-LONGEST_WORDS:]}"


def how_ended(code: int | None) -> str:
    """Return how a process ended, in the words that follow its name."""
    if code is None:
        return "was killed"
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"
