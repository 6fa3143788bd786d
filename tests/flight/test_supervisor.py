"""Tasks of a flight: what raises, hangs or ends by itself is told and started again, and the flight hears of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from fg_gcs.flight.journal import Journal
from fg_gcs.flight.policy import Fault, FaultKind
from fg_gcs.flight.supervisor import Duty, Hung, Supervisor
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.record.write.recorder import Recorder

FIRST, AGAIN = FaultKind.STREAMER, FaultKind.STREAMER_AGAIN
Work = Callable[[], Coroutine[Any, Any, None]]


def watched(folder: Path, work: Work, seconds: float, turned_s: Callable[[], float]) -> tuple[Supervisor, list[Fault]]:
    """Let a task do its duty for a while."""
    reported: list[Fault] = []

    async def run() -> Supervisor:
        loop = asyncio.get_running_loop()
        with Recorder(folder, "", loop.time(), 0.0) as recorder:
            async with Supervisor(reported.append, Journal(recorder, loop.time)) as supervisor:
                supervisor.start(Duty("worker", work, turned_s, 0.2, FIRST, AGAIN))
                await asyncio.sleep(seconds)
        return supervisor

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(run()), reported


def always() -> float:
    return asyncio.get_running_loop().time()


@pytest.mark.parametrize("error", [KeyError("x"), ZeroDivisionError(), asyncio.InvalidStateError()])
def test_what_raises_is_started_again_at_once_and_told(error: Exception, tmp_path: Path) -> None:
    starts: list[float] = []

    async def work() -> None:
        starts.append(always())
        await asyncio.sleep(1.0)
        if len(starts) < 3:
            raise error
        await asyncio.sleep(99.0)

    supervisor, reported = watched(tmp_path, work, 5.0, always)
    assert starts == pytest.approx([0.0, 1.0, 2.5], abs=0.02)  # the second time it waits half a second
    assert [fault.kind for fault in reported] == [FIRST, AGAIN]
    assert [name for name, _ in supervisor.deaths] == ["worker"] * 2


def test_what_hangs_is_ended_and_started_again(tmp_path: Path) -> None:
    turned = [0.0]
    ended: list[float] = []

    async def work() -> None:
        try:
            for _ in range(10):
                turned[0] = always()
                await asyncio.sleep(0.1)
            await asyncio.Event().wait()
        finally:
            ended.append(always())

    supervisor, reported = watched(tmp_path, work, 1.6, lambda: turned[0])
    assert ended[0] == pytest.approx(1.2, abs=0.1)  # the last sign of life at 0.9, the watchdog's 0.2 s, and a look
    assert reported[0].kind is FIRST
    assert isinstance(supervisor.deaths[0][1], Hung)


def test_what_ends_by_itself_is_a_death_too(tmp_path: Path) -> None:
    async def work() -> None:
        await asyncio.sleep(0.1)

    _, reported = watched(tmp_path, work, 0.15, always)
    assert [fault.kind for fault in reported] == [FIRST]


def test_what_is_cancelled_is_a_death_too_and_is_started_again(tmp_path: Path) -> None:
    starts: list[float] = []

    async def work() -> None:
        starts.append(always())
        await asyncio.sleep(0.1)
        if len(starts) == 1:
            raise asyncio.CancelledError
        await asyncio.sleep(99.0)

    _, reported = watched(tmp_path, work, 1.0, always)
    assert len(starts) == 2
    assert [fault.kind for fault in reported] == [FIRST]


def test_what_raises_inside_goes_on_as_it_is(tmp_path: Path) -> None:
    async def run() -> None:
        loop = asyncio.get_running_loop()
        with Recorder(tmp_path, "", loop.time(), 0.0) as recorder:
            async with Supervisor(lambda fault: None, Journal(recorder, loop.time)) as supervisor:
                supervisor.start(Duty("worker", lambda: asyncio.sleep(99.0), always, 0.2, FIRST, AGAIN))
                raise KeyError("mine")

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner, pytest.raises(KeyError, match="mine"):
        runner.run(run())
