"""TCP links that break: they come back by themselves, and nothing of the old connection is in the new one."""

from __future__ import annotations

import asyncio
import errno
import socket
from collections.abc import Awaitable, Callable
from typing import TypeVar

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import LinkError
from fg_gcs.link.clock import VirtualTimeLoop, make_loop, ticks
from fg_gcs.link.endpoint import Address, Change, Endpoint, Kind, Wire, parse_endpoint
from fg_gcs.link.kept_wire import FIRST_PAUSE_S, MOST_PAUSE_S, STEADY_S
from fg_gcs.link.opening import open_wire
from fg_gcs.link.router import Router
from fg_gcs.link.tcp_wire import CONNECT_S
from fg_gcs.wire.address import MAIN
from fg_gcs.wire.codec import Message
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.vehicle import Vehicle

FAST = 10.0  # times real time: pauses pass soon, and an attempt still has half a second on a machine that is busy
PATIENCE_S = 60.0 * FAST  # a minute of real time: loopback needs microseconds
Result = TypeVar("Result")
Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


def nothing_heard(wire: Wire, address: Address, data: bytes) -> None:
    raise AssertionError(f"heard {data!r}")


class Heard:
    """What comes from a wire, and what becomes of its connection."""

    def __init__(self) -> None:
        self.data: asyncio.Queue[bytes] = asyncio.Queue()
        self.changes: asyncio.Queue[Change] = asyncio.Queue()

    def on_data(self, wire: Wire, address: Address, data: bytes) -> None:
        self.data.put_nowait(data)

    def on_change(self, wire: Wire, change: Change) -> None:
        self.changes.put_nowait(change)


class Partner:
    """A vehicle's TCP port on this machine, which can go away and come back."""

    def __init__(self) -> None:
        self.port = 0
        self._server: asyncio.Server
        self._calls: asyncio.Queue[Streams] = asyncio.Queue()
        self._writers: list[asyncio.StreamWriter] = []

    async def come(self) -> None:
        def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            self._writers.append(writer)
            self._calls.put_nowait((reader, writer))

        self._server = await asyncio.start_server(answer, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def called(self) -> Streams:
        return await self._calls.get()

    async def go(self) -> None:
        self._server.close()
        for writer in self._writers:
            writer.close()
        self._writers.clear()
        await self._server.wait_closed()

    @property
    def endpoint(self) -> Endpoint:
        return Endpoint(Kind.TCP, "127.0.0.1", self.port)


def fast(main: Callable[[], Awaitable[Result]]) -> Result:
    async def patient() -> Result:
        async with asyncio.timeout(PATIENCE_S):
            return await main()

    with asyncio.Runner(loop_factory=lambda: make_loop(FAST)) as runner:
        return runner.run(patient())


async def nobody_else_runs() -> None:
    async for _ in ticks(0.0, 1.0):
        if asyncio.all_tasks() == {asyncio.current_task()}:
            return


def test_a_partner_that_restarts_is_found_again_as_often_as_it_does() -> None:
    async def main() -> None:
        partner, heard = Partner(), Heard()
        await partner.come()
        wire = await open_wire(partner.endpoint, heard.on_data, heard.on_change)
        for round_number in range(1, 4):
            reader, writer = await partner.called()
            wire.send(b"hello", ("127.0.0.1", partner.port))
            assert await reader.readexactly(5) == b"hello"
            writer.write(b"welcome")
            assert await heard.data.get() == b"welcome"
            await partner.go()
            assert await heard.changes.get() is Change.LOST
            wire.send(b"too late", ("127.0.0.1", partner.port))
            assert wire.dropped == round_number
            assert wire.errors >= round_number
            await partner.come()
            assert await heard.changes.get() is Change.BACK
        reader, _ = await partner.called()
        wire.close()
        assert await reader.read() == b""  # "too late" did not come either
        wire.close()
        await partner.go()
        await nobody_else_runs()
        assert heard.changes.empty()  # we closed it ourselves: no news

    fast(main)


def test_no_message_begins_in_one_connection_and_ends_in_the_next() -> None:
    sender = Sender(7, 1)
    frames = [sender.pack(dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 3, 3)) for _ in range(40)]

    async def main() -> None:
        seen: asyncio.Queue[int] = asyncio.Queue()

        def on_frame(vehicle: Vehicle, message: Message, now_s: float) -> None:
            seen.put_nowait(message.get_seq())

        partner = Partner()
        await partner.come()
        router = await Router.open({MAIN: [partner.endpoint]}, on_frame=on_frame)
        cuts = [1, 3, 9, 10, 15, len(frames[0]) - 1]
        for cut in cuts:
            _, writer = await partner.called()
            whole, halved = frames.pop(0), frames.pop(0)
            writer.write(whole + halved[:cut])
            assert await seen.get() == whole[4]
            await partner.go()
            await partner.come()
        _, writer = await partner.called()
        last = frames.pop(0)
        writer.write(halved[cut:] + last)  # the other half, should anybody wait for it
        assert await seen.get() == last[4]
        assert router.counters.frames_in == len(cuts) + 1
        assert router.counters.bad_bytes == sum(cuts) + len(halved) - cut
        told = [f"{partner.endpoint}: connection lost, connecting again", f"{partner.endpoint}: connected again"]
        assert list(router.notices) == told * len(cuts)
        router.close()
        await partner.go()
        await nobody_else_runs()

    fast(main)


class Attempts(VirtualTimeLoop):
    """Virtual time in which attempts to connect end as the test says; their times are kept."""

    def __init__(self) -> None:
        super().__init__()
        self.server = socket.create_server(("127.0.0.1", 0))
        self.answer = "accept"
        self.times_s: list[float] = []
        self.waits = asyncio.Event()

    async def sock_connect(self, sock: socket.socket, address: object) -> None:
        self.times_s.append(self.time())
        if self.answer == "refuse":
            raise ConnectionRefusedError(errno.ECONNREFUSED, "connection refused")
        if self.answer == "hang":
            self.waits.set()
            await self.create_future()
        sock.setblocking(True)  # the system accepts at once; only this loop's clock must not jump meanwhile
        sock.connect(self.server.getsockname())
        sock.setblocking(False)

    @property
    def endpoint(self) -> Endpoint:
        return Endpoint(Kind.TCP, "127.0.0.1", self.server.getsockname()[1])

    def hang_up(self) -> None:
        """Take a connection and close it."""
        connection, _ = self.server.accept()
        connection.close()


def attempting(main: Callable[[Attempts], Awaitable[Result]]) -> Result:
    loop = Attempts()
    with loop.server, asyncio.Runner(loop_factory=lambda: loop) as runner:

        async def run() -> Result:
            return await main(loop)

        return runner.run(run())


async def until(condition: Callable[[], bool]) -> float:
    loop = asyncio.get_running_loop()
    async for _ in ticks(loop.time(), 0.02):  # virtual seconds
        if condition():
            break
    return loop.time()


@pytest.mark.parametrize(("answer", "each_s"), [("refuse", 0.0), ("hang", CONNECT_S)])
def test_pauses_double_up_to_the_longest_and_begin_anew_after_a_good_connection(answer: str, each_s: float) -> None:
    async def main(loop: Attempts) -> None:
        changes: list[tuple[float, Change]] = []
        wire = await open_wire(loop.endpoint, nothing_heard, lambda _, change: changes.append((loop.time(), change)))
        await asyncio.sleep(STEADY_S)
        for lived_s, first_s in ((STEADY_S, FIRST_PAUSE_S), (0.5 * STEADY_S, MOST_PAUSE_S)):
            loop.times_s.clear()
            loop.answer = answer
            loop.hang_up()
            await until(lambda: changes[-1:] != [] and changes[-1][1] is Change.LOST)
            lost_s, errors = changes[-1][0], wire.errors
            await until(lambda: len(loop.times_s) == 8)
            loop.answer = "accept"
            wanted_s, pause_s, due_s = [], first_s, lost_s
            for _ in range(8):
                due_s += pause_s
                wanted_s.append(due_s)
                pause_s = min(2.0 * pause_s, MOST_PAUSE_S)
                due_s += each_s
            assert loop.times_s == pytest.approx(wanted_s, abs=1e-6), lived_s
            await until(lambda: changes[-1][1] is Change.BACK)
            assert wire.errors == errors + 8
            await asyncio.sleep(0.5 * STEADY_S)  # too short to count as good
        assert [change for _, change in changes] == [Change.LOST, Change.BACK] * 2
        wire.close()

    attempting(main)


@pytest.mark.parametrize("moment", ["at once", "connected", "pausing", "connecting"])
def test_closing_is_clean_at_any_moment(moment: str) -> None:
    async def main(loop: Attempts) -> None:
        changes: list[Change] = []
        wire = await open_wire(loop.endpoint, nothing_heard, lambda _, change: changes.append(change))
        if moment != "at once":
            await asyncio.sleep(1.0)
        if moment in ("pausing", "connecting"):
            loop.answer = "hang"
            loop.hang_up()
            await until(lambda: changes == [Change.LOST])
        if moment == "connecting":
            await loop.waits.wait()
        told, tried = list(changes), len(loop.times_s)
        wire.close()
        await asyncio.sleep(10.0 * MOST_PAUSE_S)
        assert asyncio.all_tasks() == {asyncio.current_task()}
        assert (changes, len(loop.times_s)) == (told, tried)
        wire.send(b"nobody hears this", ("127.0.0.1", 1))
        assert wire.dropped == 1
        wire.close()

    attempting(main)


def test_a_host_that_never_answers_is_one_clear_line() -> None:
    async def main(loop: Attempts) -> float:
        loop.answer = "hang"
        with pytest.raises(LinkError, match=rf"^tcp:127.0.0.1:\d+: no answer within {CONNECT_S:g} s$"):
            await open_wire(loop.endpoint, nothing_heard)
        return loop.time()

    assert attempting(main) == pytest.approx(CONNECT_S)


@pytest.mark.parametrize("kind", ["tcp", "udpin", "udpout"])
@pytest.mark.parametrize("host", ["a..b", "x" * 70])
def test_a_name_that_no_host_can_have_is_one_clear_line(kind: str, host: str) -> None:
    with pytest.raises(LinkError, match=f"^{kind}:{host}:5760: there is no host called '{host}'$"):
        asyncio.run(open_wire(parse_endpoint(f"{kind}:{host}:5760"), nothing_heard))
