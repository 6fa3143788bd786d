import asyncio
import contextlib
import errno
import itertools
import math
from collections.abc import Awaitable, Callable
from typing import TypeVar

import pytest

from fg_gcs.link.clock import NothingToWaitFor, ScaledTimeLoop, VirtualTimeLoop, VirtualTimeOver, make_loop, ticks

Result = TypeVar("Result")


def virtually(main: Callable[[], Awaitable[Result]]) -> Result:
    async def run() -> Result:
        return await main()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(run())


def test_a_day_passes_at_once() -> None:
    async def main() -> float:
        await asyncio.sleep(86400.0)
        return asyncio.get_running_loop().time()

    assert virtually(main) == pytest.approx(86400.0)


def test_timers_fire_in_order_at_their_time() -> None:
    async def main() -> list[tuple[float, int]]:
        loop, fired = asyncio.get_running_loop(), list[tuple[float, int]]()

        def fire(name: int) -> None:
            fired.append((loop.time(), name))

        for name, delay_s in enumerate((0.3, 0.1, 2.5, 0.2)):
            loop.call_later(delay_s, fire, name)
        await asyncio.sleep(3.0)
        return fired

    fired = virtually(main)
    assert [name for _, name in fired] == [1, 3, 0, 2]
    assert [at_s for at_s, _ in fired] == pytest.approx([0.1, 0.2, 0.3, 2.5])


def test_waiting_for_what_never_comes_is_an_error() -> None:
    async def main() -> None:
        await asyncio.sleep(1.5)
        await asyncio.get_running_loop().create_future()

    with pytest.raises(NothingToWaitFor, match=r"1\.500 s"):
        virtually(main)


def test_ticking_on_for_ever_is_an_error() -> None:
    async def main() -> None:
        async for _ in ticks(0.0, 100.0):
            pass

    with pytest.raises(VirtualTimeOver, match="for ever"):
        virtually(main)


def test_executor_jobs_take_no_virtual_time() -> None:
    async def main() -> tuple[int, float]:
        total = await asyncio.to_thread(sum, [1, 2, 3])
        with pytest.raises(ZeroDivisionError):
            await asyncio.to_thread(divmod, 1, 0)
        return total, asyncio.get_running_loop().time()

    assert virtually(main) == (6, 0.0)


class Recorder(asyncio.DatagramProtocol):
    def __init__(self) -> None:
        self.heard: list[tuple[float, bytes, tuple[str, int]]] = []
        self.lost = False

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.heard.append((asyncio.get_running_loop().time(), data, addr))

    def connection_lost(self, exc: Exception | None) -> None:
        self.lost = True


async def endpoint(
    local: int | None = None, remote: int | None = None
) -> tuple[asyncio.DatagramTransport, Recorder, int]:
    transport, protocol = await asyncio.get_running_loop().create_datagram_endpoint(
        Recorder,
        local_addr=None if local is None else ("127.0.0.1", local),
        remote_addr=None if remote is None else ("127.0.0.1", remote),
    )
    return transport, protocol, transport.get_extra_info("sockname")[1]


def test_datagrams_arrive_in_order_after_the_latency() -> None:
    async def main() -> list[tuple[float, bytes, tuple[str, int]]]:
        _, receiver, _ = await endpoint(local=14550)
        sender, _, port = await endpoint(remote=14550)
        for number in range(100):
            sender.sendto(bytes([number]))
        await asyncio.sleep(0.5)
        assert {address for _, _, address in receiver.heard} == {("127.0.0.1", port)}
        return receiver.heard

    heard = virtually(main)
    assert [data[0] for _, data, _ in heard] == list(range(100))
    assert {at_s for at_s, _, _ in heard} == {0.001}


def test_addresses_behave_as_those_of_sockets() -> None:
    async def main() -> None:
        first, hears_all, _ = await endpoint(local=14550)
        with pytest.raises(OSError, match="in use") as caught:
            await endpoint(local=14550)
        assert caught.value.errno == errno.EADDRINUSE
        second, hears_first_only, port = await endpoint(remote=14550)
        third, hears_nothing, other_port = await endpoint(local=0)
        assert len({14550, port, other_port}) == 3
        assert second.get_extra_info("peername") == ("127.0.0.1", 14550)
        third.sendto(b"stranger", ("127.0.0.1", port))  # connected elsewhere: does not hear this
        third.sendto(b"nobody", ("127.0.0.1", 9))
        third.sendto(b"nowhere")
        first.sendto(b"partner", ("127.0.0.1", port))
        await asyncio.sleep(0.1)
        assert [data for _, data, _ in hears_first_only.heard] == [b"partner"]
        assert hears_all.heard == hears_nothing.heard == []
        second.sendto(b"too late")
        first.close()
        first.close()
        assert first.is_closing()
        first.sendto(b"closed", ("127.0.0.1", port))
        await asyncio.sleep(0.1)
        assert hears_all.heard == []
        assert hears_all.lost
        assert len(hears_first_only.heard) == 1
        await endpoint(local=14550)  # free again

    virtually(main)


def test_only_host_and_port_and_datagrams_exist_in_memory() -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        with pytest.raises(TypeError, match="host, port"):
            await loop.create_datagram_endpoint(Recorder, local_addr="/tmp/socket")
        with pytest.raises(TypeError, match="datagram protocol"):
            await loop.create_datagram_endpoint(asyncio.Protocol, local_addr=("127.0.0.1", 1))

    virtually(main)


def test_the_same_program_gives_the_same_history() -> None:
    async def main() -> list[tuple[float, bytes, tuple[str, int]]]:
        _, receiver, _ = await endpoint(local=14550)

        async def talk(name: int, period_s: float) -> None:
            transport, _, _ = await endpoint(remote=14550)
            async for k, _ in ticks(0.0, period_s):
                transport.sendto(bytes([name, k % 256]))

        talkers = [asyncio.create_task(talk(name, period_s)) for name, period_s in enumerate((0.02, 0.05, 0.02, 0.01))]
        await asyncio.sleep(5.0)
        for talker in talkers:
            talker.cancel()
        return receiver.heard

    histories = [virtually(main) for _ in range(3)]
    assert len(histories[0]) > 1000
    assert histories[0] == histories[1] == histories[2]


def collect(
    count: int, start_s: float, stalls: dict[int, float], period_s: float = 0.05
) -> list[tuple[int, float, float]]:
    """Ticks as (k, lateness, time); after tick k the consumer blocks for ``stalls[k]`` seconds."""

    async def main() -> list[tuple[int, float, float]]:
        loop, seen = asyncio.get_running_loop(), list[tuple[int, float, float]]()
        async with contextlib.aclosing(ticks(start_s, period_s)) as clock:
            async for k, lateness_s in clock:
                seen.append((k, lateness_s, loop.time()))
                if len(seen) == count:
                    break
                await asyncio.sleep(stalls.get(k, 0.0))
        return seen

    return virtually(main)


def test_ticks_keep_absolute_deadlines() -> None:
    seen = collect(20_000, 0.5, {})
    assert [k for k, _, _ in seen] == list(range(20_000))
    assert max(abs(time_s - (0.5 + 0.05 * k)) for k, _, time_s in seen) < 1e-9
    assert max(lateness_s for _, lateness_s, _ in seen) < 1e-9


def test_a_stall_skips_ticks_and_leaves_no_drift() -> None:
    seen = collect(8, 0.0, {3: 0.17})
    assert [k for k, _, _ in seen] == [0, 1, 2, 3, 7, 8, 9, 10]
    assert all(time_s == pytest.approx(0.05 * k) for k, _, time_s in seen)


def test_ticks_that_are_past_already_are_skipped() -> None:
    assert [k for k, _, _ in collect(2, -1.02, {})] == [21, 22]


def test_lateness_is_told() -> None:
    async def main() -> list[float]:
        loop, told = asyncio.get_running_loop(), list[float]()
        due_s = itertools.count()

        async def watch() -> None:
            async with contextlib.aclosing(ticks(0.0, 1.0)) as clock:
                async for _, lateness_s in clock:
                    told.append(lateness_s)
                    if next(due_s) == 3:
                        return

        await watch()
        assert loop.time() == 3.0
        return told

    assert virtually(main) == [0.0] * 4


def test_scaled_time_runs_faster_than_the_wall_clock() -> None:
    async def main() -> float:
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        await asyncio.sleep(10.0)
        return loop.time() - began_s

    with asyncio.Runner(loop_factory=lambda: make_loop(1000.0)) as runner:  # 10 ms of wall time
        assert runner.run(main()) >= 10.0 - 1e-6


def test_make_loop_chooses_by_speed() -> None:
    for speed, kind in ((1.0, ScaledTimeLoop), (0.5, ScaledTimeLoop), (math.inf, VirtualTimeLoop)):
        loop = make_loop(speed)
        assert isinstance(loop, kind)
        loop.close()
    for speed in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="speed must be a positive number"):
            make_loop(speed)
