"""TCP connections: one that we make, to a vehicle's port, and those that vehicles make, to ours."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Iterable
from typing import Final, cast

from fg_gcs.link.endpoint import Address, Datagram, Endpoint, OnData, Wire
from fg_gcs.link.kept_wire import Connection, KeptWire

CONNECT_S: Final = 5.0  # an attempt that a host leaves without any answer; the system itself would wait two minutes
QUEUE_BYTES: Final = 64 << 10  # a second of setpoints to 20 vehicles; older ones are worth nothing
MOST_CONNECTIONS: Final = 256  # at one port of ours: more vehicles than a network has ids for are none


class _Stream(Connection, asyncio.Protocol):
    """A connection that we have made.

    Args:
        wire: Hears of all that happens.
    """

    def __init__(self, wire: KeptWire) -> None:
        super().__init__()
        self._transport: asyncio.Transport
        self._wire = wire

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the transport (asyncio calls this)."""
        self._transport = cast("asyncio.Transport", transport)
        self._wire.connected(self)

    def data_received(self, data: bytes) -> None:
        """Hand in bytes (asyncio calls this)."""
        self._wire.received(data)

    def eof_received(self) -> None:
        """End at once (asyncio calls this): whoever has stopped talking is not waited for to listen."""
        self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell of the end (asyncio calls this)."""
        self._wire.disconnected(self)

    def write(self, data: bytes) -> bool:
        """Send bytes, unless too many wait already; tell whether they will leave."""
        return _write(self._transport, data)

    def close(self) -> None:
        """End it when all that waits has left."""
        self._transport.close()


class TcpWire(KeptWire):
    """A TCP connection that we make: `fg_gcs.link.opening.open_wire` makes one."""

    async def _connect(self) -> Connection:
        loop, (host, port) = asyncio.get_running_loop(), (self.endpoint.host, self.endpoint.port)
        try:
            async with asyncio.timeout(CONNECT_S):
                return (await loop.create_connection(lambda: _Stream(self), host, port))[1]
        except TimeoutError as error:
            raise TimeoutError(errno.ETIMEDOUT, f"no answer within {CONNECT_S:g} s") from error


class _Caller(asyncio.Protocol):
    """A connection that somebody else has made."""

    def __init__(self, wire: TcpServerWire) -> None:
        self.transport: asyncio.Transport
        self.address: Address
        self._wire = wire

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the transport (asyncio calls this)."""
        self.transport = cast("asyncio.Transport", transport)
        self.address = transport.get_extra_info("peername")[:2]
        self._wire.called(self)

    def data_received(self, data: bytes) -> None:
        """Hand in bytes (asyncio calls this)."""
        self._wire.received(self, data)

    def eof_received(self) -> None:
        """End at once (asyncio calls this)."""
        self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell of the end (asyncio calls this)."""
        self._wire.ended(self)


class TcpServerWire(Wire):
    """A TCP port of ours, to which vehicles connect, as many as there are; each is an address of its own."""

    def __init__(self, endpoint: Endpoint, on_data: OnData) -> None:
        super().__init__(endpoint, on_data)
        self._callers: dict[Address, _Caller] = {}
        self._server: asyncio.Server | None = None

    async def open(self) -> None:
        """Listen.

        Raises:
            OSError: The port is taken, or the host is not this machine.
            UnicodeError: No host can have this name.
        """
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Caller(self), self.endpoint.host, self.endpoint.port)

    def called(self, caller: _Caller) -> None:
        """Take a connection (it calls this); one too many is ended."""
        if len(self._callers) >= MOST_CONNECTIONS:
            caller.transport.abort()
            self.errors += 1
        else:
            self._callers[caller.address] = caller

    def received(self, caller: _Caller, data: bytes) -> None:
        """Hand in bytes (a connection calls this)."""
        if self._callers.get(caller.address) is caller:
            self._on_data(self, caller.address, data)

    def ended(self, caller: _Caller) -> None:
        """Forget a connection (it calls this)."""
        if self._callers.get(caller.address) is caller:
            del self._callers[caller.address]

    def reaches(self, address: Address) -> bool:
        """Tell whether a connection from there stands."""
        return address in self._callers

    def send_all(self, datagrams: Iterable[Datagram]) -> None:
        """Send whole frames, unless too much is waiting already or the connection has ended."""
        for data, address in datagrams:
            caller = self._callers.get(address)
            if caller is None or not _write(caller.transport, data):
                self.dropped += 1

    def close(self) -> None:
        """Close the port and all connections; may be called twice."""
        if self._server is not None:
            self._server.close()
        for caller in tuple(self._callers.values()):
            caller.transport.close()
        self._callers.clear()


def _write(transport: asyncio.Transport, data: bytes) -> bool:
    if transport.is_closing() or transport.get_write_buffer_size() > QUEUE_BYTES:
        return False
    transport.write(data)
    return True
