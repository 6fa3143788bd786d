"""Event loops that run in virtual, scaled or real time, and ticks with absolute deadlines.

The loop is the clock: everything asks ``asyncio.get_running_loop().time()``, so a whole flight runs unchanged in a
test, where time jumps to the next timer and nothing waits.
"""

import asyncio
import math
import selectors
from collections.abc import AsyncGenerator, Callable
from typing import Final, TypeVar, TypeVarTuple

from fg_gcs.errors import FgError
from fg_gcs.link.memory import MemoryNetwork

LOOK_EVERY: Final = 16  # rounds of virtual time: some milliseconds of a person's
HORIZON_S: Final = 1e5  # no flight lasts a day; past half a year a float is coarser than asyncio's clock resolution

_Protocol = TypeVar("_Protocol", bound=asyncio.BaseProtocol)
_Result = TypeVar("_Result")
_Arguments = TypeVarTuple("_Arguments")


class NothingToWaitFor(FgError):
    """In virtual time every task waits for something that no timer and no datagram will ever bring."""

    def __init__(self, now_s: float) -> None:
        self.now_s = now_s
        super().__init__(f"virtual time stands still at {now_s:.3f} s: every task waits and no timer is set")


class VirtualTimeOver(FgError):
    """Virtual time ran past `HORIZON_S`: something ticks on while what it ticks for never ends."""

    def __init__(self) -> None:
        super().__init__(f"virtual time ran past {HORIZON_S:g} s: something ticks on for ever")


class _JumpingSelector(selectors.SelectSelector):
    """Instead of waiting, tells the loop how far to jump."""

    def __init__(self, jump: Callable[[float | None], None]) -> None:
        super().__init__()
        self._jump = jump
        self._rounds = 0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self._rounds += 1
        # Signals still come through the loop's own pipe; to ask the system in each round takes longer than most rounds
        ready = [] if timeout is not None and self._rounds % LOOK_EVERY else super().select(0)
        if not ready and (timeout is None or timeout > 0):
            self._jump(timeout)
        return ready


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """Time jumps to the next timer as soon as nothing is ready to run: instant and the same every time.

    Datagram endpoints live in memory; see `MemoryNetwork`. Executor jobs run at once in the loop's own thread, because
    time could not know how long to wait for another one.

    Args:
        latency_s: How long a datagram takes [s]. Not zero, as nowhere: an answer never comes before the question left.
    """

    def __init__(self, latency_s: float = 0.001) -> None:
        self._now_s = 0.0
        super().__init__(_JumpingSelector(self._jump))
        self._network = MemoryNetwork(self, latency_s)

    def time(self) -> float:
        """Virtual time since the loop was made [s]."""
        return self._now_s

    def _jump(self, seconds: float | None) -> None:
        if seconds is None:
            raise NothingToWaitFor(self._now_s)
        self._now_s += seconds
        if self._now_s > HORIZON_S:
            raise VirtualTimeOver

    def settle(self) -> None:
        """Deliver all datagrams that are under way now."""
        self._network.settle()

    def stand_still(self, seconds: float) -> None:
        """Let time go on without anything that runs on this loop, as if its process were stopped."""
        self._jump(seconds)

    async def create_datagram_endpoint(
        self,
        protocol_factory: Callable[[], _Protocol],
        local_addr: tuple[str, int] | str | None = None,
        remote_addr: tuple[str, int] | str | None = None,
        **options: object,
    ) -> tuple[asyncio.DatagramTransport, _Protocol]:
        """Open an endpoint in memory; port 0 takes the next free one, the options of real sockets mean nothing.

        Raises:
            OSError: The port is taken (EADDRINUSE).
            TypeError: Not a datagram protocol, or an address that is not (host, port).
        """
        protocol = protocol_factory()
        if isinstance(local_addr, str) or isinstance(remote_addr, str):
            raise TypeError("virtual time has (host, port) addresses only")
        if not isinstance(protocol, asyncio.DatagramProtocol):
            raise TypeError(f"not a datagram protocol: {protocol!r}")
        return self._network.open(protocol, local_addr, remote_addr), protocol

    def run_in_executor(
        self, executor: object, func: Callable[[*_Arguments], _Result], *args: *_Arguments
    ) -> asyncio.Future[_Result]:
        """Run ``func`` now and return its finished future."""
        future: asyncio.Future[_Result] = self.create_future()
        try:
            future.set_result(func(*args))
        except Exception as error:  # whatever it is belongs to whoever awaits the future
            future.set_exception(error)
        return future


class _ScaledSelector(selectors.SelectSelector):
    """Waits ``speed`` times shorter. Not epoll: that one rounds waits up to whole milliseconds."""

    def __init__(self, speed: float) -> None:
        super().__init__()
        self._speed = speed

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        return super().select(None if timeout is None else timeout / self._speed)


class ScaledTimeLoop(asyncio.SelectorEventLoop):
    """Real sockets, and a clock that runs ``speed`` times as fast as the one on the wall.

    Args:
        speed: Positive and finite.

    Attributes:
        speed: How many times as fast.
    """

    def __init__(self, speed: float) -> None:
        self.speed = speed
        super().__init__(_ScaledSelector(speed))

    def time(self) -> float:
        """Scaled monotonic time [s]."""
        return super().time() * self.speed


def make_loop(speed: float) -> asyncio.AbstractEventLoop:
    """Return the loop for a speed: 1 real time, above or below scaled real time, infinity virtual time.

    Raises:
        ValueError: Not a positive number.
    """
    if not speed > 0.0:
        raise ValueError(f"speed must be a positive number, not {speed}")
    return VirtualTimeLoop() if math.isinf(speed) else ScaledTimeLoop(speed)


def speed_of(loop: asyncio.AbstractEventLoop) -> float:
    """Return how fast a loop's time runs: 1 for any loop in real time, infinity for virtual time."""
    if isinstance(loop, VirtualTimeLoop):
        return math.inf
    return loop.speed if isinstance(loop, ScaledTimeLoop) else 1.0


async def ticks(start_s: float, period_s: float) -> AsyncGenerator[tuple[int, float], None]:
    """Yield (k, lateness_s) at ``start_s + k * period_s`` of the running loop's time, for ever.

    Deadlines are absolute, so nothing drifts; a tick that is already past when its turn comes is skipped, never queued.

    Args:
        start_s: When tick 0 is due [s of loop time]; past ticks are skipped.
        period_s: Time between ticks [s], positive.
    """
    loop = asyncio.get_running_loop()
    k = max(0, math.ceil((loop.time() - start_s) / period_s))
    while True:
        due_s = start_s + k * period_s
        await asyncio.sleep(max(0.0, due_s - loop.time()))
        yield k, max(0.0, loop.time() - due_s)  # a timer may fire early, by the clock's resolution
        k = max(k + 1, math.ceil((loop.time() - start_s) / period_s))
