"""Sources of sightings that come by a clock or in datagrams; from vehicles see :mod:`.vehicle_source`.

Each of them is opened before a flight and begins when tracking does; what arrives earlier is dropped. None raises
once it is open, whatever comes, and one that falls silent is simply silent.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic
from fg_gcs.link.endpoint import Address, Wire, open_wire, parse_endpoint
from fg_gcs.mission.target_tables import MovingTarget
from fg_gcs.scenario.motions import TrueMotion
from fg_gcs.scenario.sensor import Measurement
from fg_gcs.track.sightings import Sighting, Verdict, parse_datagram

OnSighting = Callable[[Sighting], None]
OnRefused = Callable[[Verdict, int], None]

WINDOW_S = 0.1  # datagrams are counted over so long: the pace of a sensor
MOST_DATAGRAMS = 100  # in that time: 20 vehicles at 50 Hz; more would cost the streamer its deadlines


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
    """

    def __init__(self, target: MovingTarget, endpoint: str, on_sighting: OnSighting, on_refused: OnRefused) -> None:
        self._target, self._endpoint = target, endpoint
        self._on_sighting, self._on_refused = on_sighting, on_refused
        self._rate_limiter = RateLimiter()
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
        """Close the port."""
        self._began_s = None
        if self._wire is not None:
            self._wire.close()

    def _receive(self, wire: Wire, address: Address, data: bytes) -> None:
        if self._began_s is None:
            return
        now_s = asyncio.get_running_loop().time()
        if self._rate_limiter.exceeded(now_s):
            self._on_refused(Verdict.FLOOD, 1)
            return
        sigma_m = self._target.sensor.sigma_m
        batch = parse_datagram(data, now_s, (self._target.name,), sigma_m, self._began_s)
        for verdict, count in batch.refused.items():
            self._on_refused(verdict, count)
        for sighting in batch.sightings:
            self._on_sighting(sighting)


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


def shifted(sighting: Sighting, began_s: float, now_s: float) -> Sighting:
    """Return a sighting whose times counted from when tracking began, by the loop's time."""
    received_s = max(began_s + sighting.received_s, now_s)  # a loop that was busy takes it later
    return sighting._replace(time_s=began_s + sighting.time_s, received_s=received_s)
