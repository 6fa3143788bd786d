"""Connections that are made again whenever they break: of TCP, and of serial devices that are unplugged."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Final

from fg_gcs.link.endpoint import Change, Datagram, Endpoint, OnChange, OnData, Wire

FIRST_PAUSE_S: Final = 0.5  # after a connection broke, before it is made again: SITL needs longer to start
MOST_PAUSE_S: Final = 8.0  # pauses double up to here: whoever restarts a vehicle does not wait long for us to notice
STEADY_S: Final = 10.0  # a connection that lived so long was a good one: the next pause is the first again


class Connection(ABC):
    """One connection from its beginning to its end.

    Attributes:
        ended: Done when it has ended.
    """

    def __init__(self) -> None:
        self.ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    @abstractmethod
    def write(self, data: bytes) -> bool:
        """Send bytes, unless too many wait already; tell whether they will leave."""

    @abstractmethod
    def close(self) -> None:
        """End it; may be called twice."""


class KeptWire(Wire):
    """A connection that we make, and make again whenever it breaks.

    Every connection begins with whole frames in both directions; what was under way in the one before is lost.
    """

    def __init__(self, endpoint: Endpoint, on_data: OnData, on_change: OnChange | None) -> None:
        super().__init__(endpoint, on_data)
        self.remote = (endpoint.host, endpoint.port)
        self._on_change = on_change
        self._connection: Connection | None = None  # the present one
        self._broken = False  # there was one before
        self._closed = False
        self._keeper: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Connect, and stay connected from then on until `close`.

        Raises:
            OSError: The connection is refused, or there is no answer.
            UnicodeError: No host can have this name.
        """
        self._keeper = asyncio.create_task(self._keep(await self._connect()), name=f"keep {self.endpoint}")

    def connected(self, connection: Connection) -> None:
        """Take a connection that stands (the connection calls this)."""
        self._connection = connection
        if self._broken:
            self._tell(Change.BACK)

    def received(self, data: bytes) -> None:
        """Hand in bytes (the connection calls this)."""
        if not self._closed and self.remote is not None:
            self._on_data(self, self.remote, data)

    def disconnected(self, connection: Connection) -> None:
        """Take the end of a connection (the connection calls this)."""
        if not connection.ended.done():
            connection.ended.set_result(None)
        if connection is self._connection:
            self._connection, self._broken = None, True
            self.errors += not self._closed
            self._tell(Change.LOST)

    def send_all(self, datagrams: Iterable[Datagram]) -> None:
        """Send whole frames, unless too much is waiting already or there is no connection now."""
        connection = self._connection
        for data, _ in datagrams:
            if connection is None or not connection.write(data):
                self.dropped += 1

    def close(self) -> None:
        """Close the connection, or give up one that is being made; may be called twice."""
        self._closed = True
        if self._keeper is not None:
            self._keeper.cancel()
        if self._connection is not None:
            self._connection.close()

    @abstractmethod
    async def _connect(self) -> Connection:
        """Make a connection, which tells of itself by `connected`.

        Raises:
            OSError: It cannot be made.
        """

    def _tell(self, change: Change) -> None:
        if self._on_change is not None and not self._closed:
            self._on_change(self, change)

    async def _keep(self, connection: Connection) -> None:
        """Wait for the end of every connection and make another, for ever: the wire's own task."""
        loop, pause_s = asyncio.get_running_loop(), FIRST_PAUSE_S
        while True:
            began_s, ended = loop.time(), connection.ended
            await ended
            if loop.time() - began_s >= STEADY_S:
                pause_s = FIRST_PAUSE_S
            while connection.ended is ended:
                await asyncio.sleep(pause_s)
                pause_s = min(2.0 * pause_s, MOST_PAUSE_S)
                try:
                    connection = await self._connect()
                except OSError:
                    self.errors += 1
