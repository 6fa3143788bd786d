"""Connection strings and the sockets behind them."""

import asyncio
import errno
import re
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Final, cast

from fg_gcs.errors import LinkError

Address = tuple[str, int]

FORMS: Final = "udpin:HOST:PORT (vehicles come to us), udpout:HOST:PORT (we call first), tcp:HOST:PORT (we connect)"

_PATTERN: Final = re.compile(r"(?P<kind>[a-z]+):(?://)?(?:(?P<host>[^:/\s]*):)?(?P<port>\d{1,5})/?", re.IGNORECASE)
_LOCAL: Final = "127.0.0.1"
_RECEIVE_BYTES: Final = 4 << 20  # nine vehicles send 3,300 datagrams a second; a planner may block the loop for one
_TCP_QUEUE_BYTES: Final = 64 << 10  # a second of setpoints to 20 vehicles; older ones are worth nothing


class Kind(Enum):
    """Who speaks first, and over what."""

    UDP_IN = "udpin"
    UDP_OUT = "udpout"
    TCP = "tcp"


_KINDS: Final = {"udp": Kind.UDP_IN, "udpin": Kind.UDP_IN, "udpout": Kind.UDP_OUT, "tcp": Kind.TCP}


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Where vehicles are to be found.

    Attributes:
        kind: Who speaks first, and over what.
        host: The host to bind, or to call.
        port: The port to bind, or to call.
    """

    kind: Kind
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.kind.value}:{self.host}:{self.port}"


def parse_endpoint(text: str) -> Endpoint:
    """Return the endpoint that a connection string names; the host may be left out (127.0.0.1).

    Raises:
        LinkError: Not a connection string; the message lists the forms.
    """
    match = _PATTERN.fullmatch(text.strip())
    kind = _KINDS.get(match["kind"].lower()) if match else None
    if match is None or kind is None or not 0 < int(match["port"]) < 65536:
        raise LinkError(f"endpoint {text!r} is none of: {FORMS}")
    return Endpoint(kind, match["host"] or _LOCAL, int(match["port"]))


class Wire(ABC):
    """One open endpoint: hands in bytes with the address they came from, takes bytes for an address; never raises.

    Attributes:
        endpoint: What it was opened for.
        remote: The one partner of a connected endpoint, None for ``udpin``.
        dropped: Messages not sent because the way out is full or closed.
        errors: Errors the system reported (a refused port, a broken connection).
    """

    def __init__(self, endpoint: Endpoint, on_data: Callable[["Wire", Address, bytes], None]) -> None:
        self.endpoint = endpoint
        self.remote: Address | None = None
        self.dropped = 0
        self.errors = 0
        self._on_data = on_data

    @abstractmethod
    def send(self, data: bytes, address: Address) -> None:
        """Send whole frames to ``address``."""

    @abstractmethod
    def close(self) -> None:
        """Close it."""


class UdpWire(Wire, asyncio.DatagramProtocol):
    """A UDP socket; connected to its partner for ``udpout``."""

    _transport: asyncio.DatagramTransport
    _full = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the transport (asyncio calls this)."""
        self._transport = cast("asyncio.DatagramTransport", transport)  # not a subclass of it before Python 3.12
        self.remote = transport.get_extra_info("peername")
        own_socket = transport.get_extra_info("socket")
        if own_socket is not None:
            own_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Hand in a datagram (asyncio calls this)."""
        self._on_data(self, addr, data)

    def error_received(self, exc: Exception) -> None:
        """Count what the system reports, such as a partner that is not there yet (asyncio calls this)."""
        self.errors += 1

    def pause_writing(self) -> None:
        """Drop from now on (asyncio calls this)."""
        self._full = True

    def resume_writing(self) -> None:
        """Send again (asyncio calls this)."""
        self._full = False

    def send(self, data: bytes, address: Address) -> None:
        """Send one datagram."""
        if self._full:
            self.dropped += 1
        else:
            self._transport.sendto(data, None if self.remote else address)

    def close(self) -> None:
        """Close the socket."""
        self._transport.close()


class TcpWire(Wire, asyncio.Protocol):
    """A TCP connection that we opened."""

    _transport: asyncio.Transport
    _open = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the transport (asyncio calls this)."""
        self._transport = cast("asyncio.Transport", transport)
        self._open = True
        self.remote = (self.endpoint.host, self.endpoint.port)

    def data_received(self, data: bytes) -> None:
        """Hand in bytes (asyncio calls this)."""
        self._on_data(self, (self.endpoint.host, self.endpoint.port), data)

    def connection_lost(self, exc: Exception | None) -> None:
        """Count the end of the connection (asyncio calls this)."""
        self.errors += self._open
        self._open = False

    def send(self, data: bytes, address: Address) -> None:
        """Send whole frames, unless too much is waiting already."""
        if not self._open or self._transport.get_write_buffer_size() > _TCP_QUEUE_BYTES:
            self.dropped += 1
        else:
            self._transport.write(data)

    def close(self) -> None:
        """Close the connection."""
        self._open = False
        self._transport.close()


async def open_wire(endpoint: Endpoint, on_data: Callable[[Wire, Address, bytes], None]) -> Wire:
    """Open the socket of an endpoint.

    No address is shared (SO_REUSEADDR, SO_REUSEPORT): a second ground station must not steal the first one's datagrams.

    Args:
        endpoint: What to open.
        on_data: Gets the wire, the sender's address and the bytes; must not raise.

    Raises:
        LinkError: The port is taken, or nobody listens.
    """
    loop = asyncio.get_running_loop()
    address = (endpoint.host, endpoint.port)
    try:
        if endpoint.kind is Kind.TCP:
            return (await loop.create_connection(lambda: TcpWire(endpoint, on_data), *address))[1]
        local, remote = (address, None) if endpoint.kind is Kind.UDP_IN else (None, address)
        made = await loop.create_datagram_endpoint(
            lambda: UdpWire(endpoint, on_data), local_addr=local, remote_addr=remote
        )
        return made[1]
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise LinkError(f"{endpoint}: port {endpoint.port} is in use: another ground station?") from error
        raise LinkError(f"{endpoint}: {error.strerror or error}") from error
