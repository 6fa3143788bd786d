"""Sources of sightings that come by a clock or in datagrams; from vehicles see :mod:`.vehicle_source`.

Each of them is opened before a flight and begins when tracking does; what arrives earlier is dropped. None raises
once it is open, whatever comes, and one that falls silent is simply silent.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import Protocol

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic
from fg_gcs.flight.sightings.senders import SenderClocks, Senders, SightingQueue
from fg_gcs.link.endpoint import Address, Wire, parse_endpoint
from fg_gcs.link.opening import open_wire
from fg_gcs.mission.target_tables import MovingTarget
from fg_gcs.scenario.motions import TrueMotion
from fg_gcs.scenario.sensor import Measurement
from fg_gcs.track.sightings import MOST_LINES, Sighting, Verdict, parse_datagram

OnSighting = Callable[[Sighting], None]
OnRefused = Callable[[Verdict, int], None]

LINES_AT_ONCE = 16  # of a datagram that are read before others have their turn: half a millisecond
MOST_WAITING = 1000  # sightings that wait, or groups of lines; more are a flood
BELIEVED_S = 5.0  # by so much a sender's clock, together with all delays, may be behind ours
AHEAD_S = 0.05  # and by so much ahead: clocks that are set by a network are closer


class SightingSource(Protocol):
    """One way by which sightings come in."""

    async def open(self) -> None:
        """Get ready.

        Raises:
            LinkError: a port is taken.
        """

    def begin(self, began_s: float, origin: Geodetic) -> None:
        """Let sightings come from now on, a time of the running loop [s]; the origin is that of ENU."""

    def truth(self, target: str, time_s: Array) -> Array | None:
        """Return where one of its targets truly was at loop times, (T,) [s] to (T, 3) [m; ENU], if that is known."""

    def known_until_s(self) -> float:
        """Return the loop's time up to which :meth:`truth` says nothing else any more [s]."""

    def close(self) -> None:
        """Let no more come; may be called twice."""


class TimedSource:
    """Sightings that come by the clock: of a made-up target, or of a recording.

    Args:
        measurements: in the order of arrival; times count from when tracking begins.
        on_sighting: gets the sightings, by the loop's time.
        motion: how the target truly moves, if that is known.
    """

    def __init__(self, measurements: Iterator[Measurement], on_sighting: OnSighting, motion: TrueMotion | None) -> None:
        self._measurements = measurements
        self._on_sighting = on_sighting
        self._motion = motion
        self._began_s = 0.0
        self._timer: asyncio.TimerHandle | None = None

    async def open(self) -> None:
        """Do nothing: there is nothing to open."""

    def begin(self, began_s: float, origin: Geodetic) -> None:
        """Let the clock run."""
        self._began_s = began_s
        self._wait()

    def truth(self, target: str, time_s: Array) -> Array | None:
        """Return where the made-up target was, (T,) [s] to (T, 3) [m; ENU]; None for a recording."""
        return None if self._motion is None else self._motion.at(np.asarray(time_s) - self._began_s)[0]

    def known_until_s(self) -> float:
        """Return infinity: a made-up way is known from the start."""
        return math.inf

    def close(self) -> None:
        """Stop the clock."""
        if self._timer is not None:
            self._timer.cancel()

    def _wait(self) -> None:
        measurement = next(self._measurements, None)
        if measurement is not None:
            loop = asyncio.get_running_loop()
            self._timer = loop.call_at(self._began_s + measurement.received_s, self._arrive, measurement.sighting)

    def _arrive(self, sighting: Sighting | None) -> None:
        self._wait()  # first: whoever gets the sighting may close us
        if sighting is not None:
            self._on_sighting(shifted(sighting, self._began_s, asyncio.get_running_loop().time()))


class DatagramSource:
    """JSON lines about one target, on a port of its own.

    Args:
        target: whose.
        endpoint: where.
        on_sighting: gets the sightings.
        on_refused: gets the reasons why lines gave none, and how many.
        tell: gets lines for people about senders.
        unix_s: turns the loop's time into Unix time [s]; None: stamps by Unix time are refused.
    """

    def __init__(
        self,
        target: MovingTarget,
        endpoint: str,
        on_sighting: OnSighting,
        on_refused: OnRefused,
        tell: Callable[[str], None],
        unix_s: Callable[[float], float] | None,
    ) -> None:
        self._target, self._endpoint = target, endpoint
        self._on_refused, self._unix_s = on_refused, unix_s
        self._senders, self._clocks = Senders(), SenderClocks(tell)
        self._queue = SightingQueue(on_sighting)
        self._unread: deque[tuple[Address, float, bytes]] = deque()  # sender, when it came, and some lines
        self._handle: asyncio.Handle | None = None
        self._wire: Wire | None = None
        self._began_s: float | None = None

    async def open(self) -> None:
        """Open the port.

        Raises:
            LinkError: it is taken.
        """
        self._wire = await open_wire(parse_endpoint(self._endpoint), self._receive)

    def begin(self, began_s: float, origin: Geodetic) -> None:
        """Read datagrams from now on."""
        self._began_s = began_s

    def truth(self, target: str, time_s: Array) -> Array | None:
        """Return nothing: only the world knows."""
        return None

    def known_until_s(self) -> float:
        """Return infinity: nothing will ever be known."""
        return math.inf

    def close(self) -> None:
        """Close the port; what is not read yet is not read any more."""
        self._began_s = None
        self._unread.clear()
        self._queue.close()
        if self._handle is not None:
            self._handle.cancel()
        if self._wire is not None:
            self._wire.close()

    def _receive(self, wire: Wire, address: Address, data: bytes) -> None:
        if self._began_s is None:
            return
        now_s = asyncio.get_running_loop().time()
        promising = data[:1] == b"{" and self._target.name.encode() in data
        if self._senders.exceeded(address, promising, now_s) or len(self._queue) + len(self._unread) > MOST_WAITING:
            self._on_refused(Verdict.FLOOD, 1)
            return
        lines = [line for line in data.split(b"\n", MOST_LINES) if line.strip()]
        if len(lines) > MOST_LINES:
            self._on_refused(Verdict.FLOOD, 1 + lines.pop().count(b"\n"))
        for start in range(0, len(lines), LINES_AT_ONCE):
            self._unread.append((address, now_s, b"\n".join(lines[start : start + LINES_AT_ONCE])))
        if self._handle is None:
            self._read()

    def _read(self) -> None:
        """Read some lines; more in the turns that follow."""
        self._handle = None
        if self._began_s is None or not self._unread:
            return
        address, received_s, lines = self._unread.popleft()
        batch = parse_datagram(
            lines,
            received_s,
            (self._target.name,),
            self._target.sensor.sigma_m,
            self._began_s,
            None if self._unix_s is None else partial(self._age_s, address, self._unix_s(received_s)),
        )
        if batch.sightings:
            self._senders.sent_sightings(address, len(batch.sightings), received_s)
        for verdict, count in batch.refused.items():
            self._on_refused(verdict, count)
        if self._unread:
            self._handle = asyncio.get_running_loop().call_soon(self._read)
        self._queue.put(batch.sightings)

    def _age_s(self, address: Address, unix_s: float, stamp_unix_s: float) -> float:
        """Return how old a sighting is by its sender's Unix time [s]; a clock that is not set is corrected."""
        wrong_s = self._clocks.offset_s(address, self._target.name, stamp_unix_s, unix_s)
        if -AHEAD_S <= wrong_s <= BELIEVED_S:
            return unix_s - stamp_unix_s
        how = "ahead of" if wrong_s < 0.0 else "behind"
        what = f"are stamped by a clock {abs(wrong_s):.1f} s {how} ours: that is taken off"
        self._clocks.tell_once(address, self._target.name, what)
        return unix_s - stamp_unix_s - wrong_s


def shifted(sighting: Sighting, began_s: float, now_s: float) -> Sighting:
    """Return a sighting whose times counted from when tracking began, by the loop's time."""
    received_s = max(began_s + sighting.received_s, now_s)  # a loop that was busy takes it later
    return sighting._replace(time_s=began_s + sighting.time_s, received_s=received_s)
