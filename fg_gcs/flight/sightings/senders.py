"""Those who send sightings: how much of each is read, what their clocks show, and how sightings are handed in."""

from __future__ import annotations

import asyncio
import heapq
import math
from collections.abc import Callable, Iterable
from itertools import count
from typing import Final

from fg_gcs.link.endpoint import Address
from fg_gcs.track.sightings import Sighting
from fg_gcs.wire.timing import BootClock

WINDOW_S: Final = 0.1  # datagrams are counted over so long: the pace of a sensor
MOST_DATAGRAMS: Final = 100  # in that time: 20 vehicles at 50 Hz; more would cost the streamer its deadlines
MOST_SENDERS: Final = 32  # that have sent sightings are remembered; the one that sent fewest goes first
IN_ORDER_AT_ONCE: Final = 8  # sightings handed in before others have their turn: half a millisecond of filtering
LATE_AT_ONCE: Final = 1  # and so many that are older than the newest: the filter takes all newer ones again
BEHIND_S: Final = 1.0  # a sender whose sightings come so much later than they once did is told of


class RateLimiter:
    """Counts datagrams, so that a flood of them does not cost more than counting."""

    def __init__(self) -> None:
        self._since_s = -math.inf
        self._count = 0

    def exceeded(self, now_s: float) -> bool:
        """Count one more, and say whether they have become too many."""
        if now_s - self._since_s >= WINDOW_S:
            self._since_s, self._count = now_s, 0
        self._count += 1
        return self._count > MOST_DATAGRAMS


class _Sender:
    """One that has sent sightings."""

    def __init__(self) -> None:
        self.limiter = RateLimiter()
        self.sightings = 0


class Senders:
    """Lets a flood of strangers keep nobody from being heard.

    Each sender that has sent sightings has a limit of its own. Others share two: one for datagrams that look like
    sightings, so that a new sender is heard, and one for all else.
    """

    def __init__(self) -> None:
        self._known: dict[Address, _Sender] = {}
        self._promising, self._others = RateLimiter(), RateLimiter()

    def exceeded(self, address: Address, promising: bool, now_s: float) -> bool:
        """Count a datagram, and say whether it is one too many.

        Args:
            address: Its sender's.
            promising: It looks like a sighting.
            now_s: Loop time [s].
        """
        known = self._known.get(address)
        limiter = known.limiter if known is not None else self._promising if promising else self._others
        return limiter.exceeded(now_s)

    def sent_sightings(self, address: Address, number: int, now_s: float) -> None:
        """Take note that a sender has sent so many sightings in a datagram that came at a loop time [s]."""
        known = self._known.get(address)
        if known is None:
            if len(self._known) >= MOST_SENDERS:
                del self._known[min(self._known, key=lambda each: self._known[each].sightings)]
            known = self._known[address] = _Sender()
            known.limiter.exceeded(now_s)  # this datagram counts
        known.sightings += number


class SenderClocks:
    """The clocks of senders that stamp what they say.

    Args:
        tell: Gets a line for people about a sender that falls behind.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._clocks: dict[tuple[Address, str], tuple[BootClock, float]] = {}  # and when it was used [s]
        self._told: set[tuple[Address, str]] = set()

    def offset_s(self, address: Address, target: str, stamp_s: float, now_s: float) -> float:
        """Take a stamp; return our time less the sender's, as if the least delay so far were none [s].

        Args:
            address: The sender's.
            target: Whose sightings it sends.
            stamp_s: By the sender's clock [s].
            now_s: When that came, by ours [s].
        """
        key = (address, target)
        clock, at_s = self._clocks.pop(key) if key in self._clocks else (BootClock(), now_s)
        if len(self._clocks) >= MOST_SENDERS:
            del self._clocks[next(iter(self._clocks))]
        self._clocks[key] = clock, now_s
        clock.roll(now_s - at_s)
        clock.stamped(stamp_s, now_s)
        late_s = now_s - stamp_s - clock.offset_s
        if late_s > BEHIND_S:
            self.tell_once(
                address, target, f"come {late_s:.1f} s later than they did: they count from when they were true"
            )
        return clock.offset_s

    def tell_once(self, address: Address, target: str, what: str) -> None:
        """Tell people of a sender, once, and of a bounded number of them."""
        if (address, target) not in self._told and len(self._told) < MOST_SENDERS:
            self._told.add((address, target))
            self._tell(f"sightings of {target} from {address[0]}:{address[1]} {what}")


class SightingQueue:
    """Hands sightings in, the oldest first and a few in each turn of the loop.

    So a filter that takes them along their stamps seldom has to begin again, whatever the order they come in.

    Args:
        on_sighting: Gets them.
    """

    def __init__(self, on_sighting: Callable[[Sighting], None]) -> None:
        self._on_sighting = on_sighting
        self._waiting: list[tuple[float, int, Sighting]] = []  # a heap
        self._numbers = count()
        self._newest_s = -math.inf
        self._handle: asyncio.Handle | None = None

    def put(self, sightings: Iterable[Sighting]) -> None:
        """Hand in the first of them now, the others soon."""
        for sighting in sightings:
            heapq.heappush(self._waiting, (sighting.time_s, next(self._numbers), sighting))
        if self._handle is None:
            self._hand_in()

    def __len__(self) -> int:
        """Return how many wait."""
        return len(self._waiting)

    def close(self) -> None:
        """Hand in no more."""
        self._waiting.clear()
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def _hand_in(self) -> None:
        self._handle, left = None, IN_ORDER_AT_ONCE
        while self._waiting and left > 0:
            time_s, _, sighting = heapq.heappop(self._waiting)
            left -= IN_ORDER_AT_ONCE // LATE_AT_ONCE if time_s < self._newest_s else 1
            self._newest_s = max(self._newest_s, time_s)
            self._on_sighting(sighting)  # whoever gets it may close us
        if self._waiting and self._handle is None:
            self._handle = asyncio.get_running_loop().call_soon(self._hand_in)
