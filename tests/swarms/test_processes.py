"""Processes that are kept: none outlives whoever wanted them, whatever ends that."""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path

import pytest

from fg_gcs.errors import MissionError
from fg_gcs.sitl.instances import Start
from fg_gcs.sitl.processes import LOG, Processes, how_ended, keeping, last_words
from tests.console.test_processes import ends
from tests.swarms.standins import alive

# Its child ignores a SIGTERM, and tells its number when it does
WITH_CHILD = """#!/bin/sh
sh -c 'trap "" TERM; echo $$ > child; read forever < never' &
echo "I began" && echo "and went on"
wait
"""


def program(path: Path, text: str = WITH_CHILD) -> Start:
    path.write_text(text)
    path.chmod(0o755)
    return Start((str(path),), {}, {})


async def started(processes: Processes, folder: Path) -> list[int]:
    """Start a process that has a child; return both numbers when both run."""
    for name in ("child", "never"):
        fifo(folder / name)
    await processes.start(program(folder / "sitl"), folder)
    return [processes.pids[0], await asyncio.to_thread(number_in, folder / "child")]


def fifo(path: Path) -> Path:
    """Make a pipe in the file system: who reads waits for who writes."""
    os.mkfifo(path)
    return path


def number_in(path: Path) -> int:
    """Wait until somebody writes a number into a pipe."""
    return int(path.read_text())


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def test_all_end_with_the_context_their_children_as_well(tmp_path: Path) -> None:
    async def main() -> None:
        async with keeping(lambda number, code: None) as processes:
            pids = await started(processes, tmp_path)
            assert alive(pids) == pids
        assert not alive(pids)

    asyncio.run(main())
    assert last_words(tmp_path / LOG) == "I began | and went on"


def test_what_one_has_started_ends_with_it_and_its_end_is_told(tmp_path: Path) -> None:
    async def main() -> None:
        ended: asyncio.Queue[tuple[int, int | None]] = asyncio.Queue()
        async with keeping(lambda number, code: ended.put_nowait((number, code))) as processes:
            pids = await started(processes, tmp_path)
            os.kill(pids[0], signal.SIGKILL)
            number, code = await ended.get()
            assert (number, how_ended(code)) == (0, "was ended by SIGKILL")
            assert all(map(ends, pids))

    asyncio.run(main())


def test_none_outlives_a_keeper_that_is_killed(tmp_path: Path) -> None:
    async def main() -> None:
        ended: asyncio.Queue[tuple[int, int | None]] = asyncio.Queue()
        async with keeping(lambda number, code: ended.put_nowait((number, code))) as processes:
            pids = await started(processes, tmp_path)
            os.kill(parent_of(pids[0]), signal.SIGKILL)
            assert await ended.get() == (0, None)
            assert all(map(ends, pids))
            with pytest.raises(MissionError, match="cannot be run"):
                await processes.start(program(tmp_path / "sitl"), tmp_path)

    asyncio.run(main())


def test_a_program_that_is_none_is_told(tmp_path: Path) -> None:
    async def main() -> None:
        async with keeping(lambda number, code: None) as processes:
            with pytest.raises(MissionError, match="cannot be run: Exec format error"):
                await processes.start(program(tmp_path / "sitl", "\x7fELF no"), tmp_path)

    asyncio.run(main())


def test_last_words_are_few_and_printable(tmp_path: Path) -> None:
    log = tmp_path / LOG
    assert last_words(log) == ""
    log.write_bytes(b"\x1b[31mfirst\x1b[0m\n" * 1000 + b"a\n\n  b\t c \n\xff\n")
    assert last_words(log) == "[31mfirst [0m | a | b c | \N{REPLACEMENT CHARACTER}"
    log.write_text("x" * 5000)
    assert len(last_words(log)) < 320
    assert [how_ended(code) for code in (1, -9, None, -250)] == [
        "ended with exit code 1",
        "was ended by SIGKILL",
        "was killed",
        "was ended by signal 250",
    ]
