"""Lines to other programs: readers get what is sent, and none of them can hold the sender up."""

from __future__ import annotations

import asyncio
import stat
from pathlib import Path

import pytest

from fg_gcs.errors import LinkError
from fg_gcs.link.broadcast import MOST_READERS, LineBroadcast


async def connected(broadcast: LineBroadcast, count: int) -> None:
    """Wait until so many readers are known."""
    while len(broadcast._readers) < count:  # noqa: ASYNC110, SLF001 # no event says that the server has accepted
        await asyncio.sleep(0)


def test_every_reader_gets_every_line(tmp_path: Path) -> None:
    async def run() -> None:
        broadcast = await LineBroadcast.open(tmp_path, "live.sock")
        assert stat.S_IMODE(broadcast.path.stat().st_mode) == 0o600
        assert not broadcast.has_readers
        broadcast.send("before anything reads")
        readers = [await asyncio.open_unix_connection(broadcast.path) for _ in range(3)]
        await connected(broadcast, 3)
        for line in ("one", "two"):
            broadcast.send(line)
            assert [await reader.readline() for reader, _ in readers] == [line.encode() + b"\n"] * 3
        broadcast.close()
        broadcast.close()
        assert [await reader.read() for reader, _ in readers] == [b""] * 3
        assert not broadcast.path.exists()
        for _, writer in readers:
            writer.close()

    asyncio.run(run())


def test_a_reader_that_does_not_read_misses_lines_and_holds_nothing_up(tmp_path: Path) -> None:
    async def run() -> None:
        broadcast = await LineBroadcast.open(tmp_path, "live.sock")
        lazy, writer = await asyncio.open_unix_connection(broadcast.path, limit=1024)
        await connected(broadcast, 1)
        for _ in range(5000):
            broadcast.send("x" * 1000)
        assert broadcast.missed > 4000
        (reader,) = broadcast._readers  # noqa: SLF001 # what is kept for it
        assert reader.transport is not None
        assert reader.transport.get_write_buffer_size() <= 1001
        assert (await lazy.readline()).endswith(b"x\n")  # what it gets are whole lines
        broadcast.close()
        writer.close()

    asyncio.run(run())


def test_a_reader_that_has_gone_and_too_many_of_them(tmp_path: Path) -> None:
    async def run() -> None:
        broadcast = await LineBroadcast.open(tmp_path, "live.sock")
        readers = [await asyncio.open_unix_connection(broadcast.path) for _ in range(MOST_READERS + 1)]
        assert await readers[-1][0].read() == b""  # one too many is sent away
        for _, writer in readers:
            writer.close()
        while broadcast.has_readers:
            broadcast.send("into the void")
            await asyncio.sleep(0)
        broadcast.close()

    asyncio.run(run())


def test_a_path_too_long_for_a_socket_is_replaced_by_a_short_one(tmp_path: Path) -> None:
    folder = tmp_path / ("d" * 120)
    folder.mkdir()

    async def run() -> None:
        broadcast = await LineBroadcast.open(folder, "live.sock")
        assert broadcast.path.exists()
        broadcast.close()

    asyncio.run(run())


def test_a_place_that_takes_no_socket_is_an_error_in_one_line(tmp_path: Path) -> None:
    async def run() -> None:
        with pytest.raises(LinkError, match="No such file"):
            await LineBroadcast.open(tmp_path / "gone", "live.sock")

    asyncio.run(run())
