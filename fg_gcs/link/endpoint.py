"""Connection strings and the sockets behind them."""

import asyncio
import errno
import re
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import Final, cast

from fg_gcs.errors import LinkError
from fg_gcs.link.bulk import Bulk, Send, bulk_send_of
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.link.kernel_filter import attach, dropped_by_system
from fg_gcs.wire.address import MAIN
from fg_gcs.wire.framing import Frames

Address = tuple[str, int]
Datagram = tuple[bytes, Address]  # what to send, and where to

FORMS: Final = "udpin:HOST:PORT (vehicles come to us), udpout:HOST:PORT (we call first) or tcp:HOST:PORT (we connect)"
FIRST_PAUSE_S: Final = 0.5  # after a connection broke, before it is made again: SITL needs longer to start
MOST_PAUSE_S: Final = 8.0  # pauses double up to here: whoever restarts a vehicle does not wait long for us to notice
STEADY_S: Final = 10.0  # a connection that lived so long was a good one: the next pause is the first again
CONNECT_S: Final = 5.0  # an attempt that a host leaves without any answer; the system itself would wait two minutes

_PATTERN: Final = re.compile(r"(?P<kind>[a-z]+):(?://)?(?:(?P<host>[^:/\s]*):)?(?P<port>\d{1,5})/?", re.IGNORECASE)
_NETWORK: Final = re.compile(r"\s*(?P<name>[^=]*?)\s*=(?P<endpoint>.*)", re.DOTALL)
_NETWORK_NAME: Final = re.compile(r"[a-z0-9_-]{1,16}")
_LOCAL: Final = "127.0.0.1"
_BUFFER_BYTES: Final = 4 << 20  # asked of the system, which gives what its settings allow
_RECEIVED_BYTES: Final = 12_500  # of a vehicle: 50 messages a second, each 1 kB of the system's memory, for 0.25 s
_SENT_BYTES: Final = 1_000  # of a vehicle: one round of setpoints
_MOST_DATAGRAM_BYTES: Final = 65536  # no datagram is longer
_MOST_AT_ONCE: Final = 64  # datagrams read before the loop looks at its timers: half a millisecond of work
_MOST_BYTES_AT_ONCE: Final = 4096  # and so much of theirs, which is a hundred short messages
_TCP_QUEUE_BYTES: Final = 64 << 10  # a second of setpoints to 20 vehicles; older ones are worth nothing


class Change(Enum):
    """What becomes of a connection on the way, in words for people."""

    LOST = "connection lost, connecting again"
    BACK = "connected again"


class Kind(Enum):
    """Who speaks first, and over what."""

    UDP_IN = "udpin"
    UDP_OUT = "udpout"
    TCP = "tcp"

    @property
    def verb(self) -> str:
        """What we do there, for people."""
        return {Kind.UDP_IN: "listening at", Kind.UDP_OUT: "calling"}.get(self, "connecting to")


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
        raise LinkError(f"endpoint {text!r} is not of the form {FORMS}")
    return Endpoint(kind, match["host"] or _LOCAL, int(match["port"]))


def parse_networks(texts: Iterable[str]) -> dict[str, tuple[Endpoint, ...]]:
    """Return the networks that texts of the form ``[NAME=]ENDPOINT`` declare, each with its endpoints, in their order.

    Endpoints of one name are one network; those without a name are the network ``main``. If there is only one network,
    it is ``main`` whatever its name: names tell networks apart.

    Raises:
        LinkError: A text is at fault, or an endpoint occurs twice; the message says what is accepted.
    """
    networks: dict[str, tuple[Endpoint, ...]] = {}
    known: set[Endpoint] = set()
    for text in texts:
        match = _NETWORK.fullmatch(text)
        name = MAIN if match is None else match["name"]
        if not _NETWORK_NAME.fullmatch(name):
            raise LinkError(f"network {name!r} in {text!r} is not a name of 1 to 16 of a-z, 0-9, - and _")
        endpoint = parse_endpoint(text if match is None else match["endpoint"])
        if endpoint in known:
            raise LinkError(f"endpoint {endpoint} occurs twice; each of them belongs to one network, once")
        known.add(endpoint)
        networks[name] = (*networks.get(name, ()), endpoint)
    if len(networks) == 1:
        (only,) = networks.values()
        return {MAIN: only}
    return networks


def places(networks: Mapping[str, Sequence[Endpoint]]) -> str:
    """Return what we do at endpoints to hear vehicles, for people: ``listening at A, B; connecting to C``.

    With several networks each endpoint's network is told: ``listening at east: A; west: B``.
    """
    by_verb: dict[str, dict[str, list[str]]] = {}
    for name, endpoints in networks.items():
        for endpoint in endpoints:
            by_verb.setdefault(endpoint.kind.verb, {}).setdefault(name, []).append(str(endpoint))
    told = []
    for verb, by_name in by_verb.items():
        texts = {name: ", ".join(listed) for name, listed in by_name.items()}
        named = (f"{name}: {text}" for name, text in texts.items()) if len(networks) > 1 else texts.values()
        told.append(f"{verb} {'; '.join(named)}")
    return "; ".join(told)


def in_rows(frames: Frames) -> list[bytes]:
    """Return frames that stand in an array, each by itself."""
    rows: list[bytes] = frames.view(f"V{frames.shape[1]}").ravel().tolist()
    return rows


OnData = Callable[["Wire", Address, bytes], None]
OnChange = Callable[["Wire", Change], None]


class Wire(ABC):
    """One open endpoint: hands in bytes with the address they came from, takes bytes for an address; never raises.

    Attributes:
        endpoint: What it was opened for.
        remote: The one partner of a connected endpoint, None for ``udpin``.
        dropped: Messages not sent because the way out is full or closed.
        errors: Errors the system reported (a refused port, a broken connection, a vain attempt at another).
    """

    def __init__(self, endpoint: Endpoint, on_data: OnData) -> None:
        self.endpoint = endpoint
        self.remote: Address | None = None
        self.dropped = 0
        self.errors = 0
        self._on_data = on_data

    def send(self, data: bytes, address: Address) -> None:
        """Send whole frames to ``address``."""
        self.send_all(((data, address),))

    @abstractmethod
    def send_all(self, datagrams: Iterable[Datagram]) -> None:
        """Send whole frames, to the address of each; what the way out does not take is dropped."""

    def round_to(self, addresses: Sequence[Address]) -> Callable[[Frames], None]:
        """Return what sends a round of frames, the one in row n to the n-th of these addresses, as `send_all` does."""
        return lambda frames: self.send_all(zip(in_rows(frames), addresses, strict=True))

    def shortages(self, vehicles: int) -> list[str]:
        """Return what is too small for so many vehicles, a line for people each."""
        return []

    def admit_only(self, known: Collection[Address] | None, share: float) -> bool:
        """Let the system drop what comes from elsewhere, but for a share of the heartbeats; tell whether it can.

        Args:
            known: Where everything is taken from; None: from everywhere.
            share: Of the heartbeats, 0 to 1.
        """
        return False

    @property
    def unread(self) -> int:
        """Datagrams that the system has dropped before they were read, as far as it tells."""
        return 0

    @abstractmethod
    def close(self) -> None:
        """Close it."""


class UdpWire(Wire):
    """A UDP socket; connected to its partner for ``udpout``.

    The socket is our own and not one of asyncio's transports: those hand in one datagram for each round of the loop,
    and queue what the system does not take, while an old setpoint is worth nothing.

    Args:
        endpoint: What it was opened for.
        on_data: Gets the wire, the sender's address and the bytes.
        own: Open, and not blocking; the wire closes it.
        bulk_send: The system's call for many datagrams; None: it has none.
    """

    def __init__(self, endpoint: Endpoint, on_data: OnData, own: socket.socket, bulk_send: Send | None) -> None:
        super().__init__(endpoint, on_data)
        self._socket = own
        self._bulk_send = bulk_send if own.family == socket.AF_INET else None
        self._unread = 0
        self._loop = asyncio.get_running_loop()
        if endpoint.kind is Kind.UDP_OUT:
            self.remote = own.getpeername()
        self._loop.add_reader(own, self._receive)

    def send_all(self, datagrams: Iterable[Datagram]) -> None:
        """Send datagrams."""
        send, sendto, connected = self._socket.send, self._socket.sendto, self.remote is not None
        for data, address in datagrams:
            try:
                if connected:
                    send(data)
                else:
                    sendto(data, address)
            except OSError as error:  # such as a partner that is not there yet
                self._failed(error)

    def round_to(self, addresses: Sequence[Address]) -> Callable[[Frames], None]:
        """Return what sends a round of frames to these addresses: in one call, if the system has it."""
        if self._bulk_send is None:
            return super().round_to(addresses)
        bulk = Bulk(self._bulk_send, None if self.remote is not None else addresses, len(addresses))

        def send(frames: Frames) -> None:
            for error in bulk.send(self._socket.fileno(), frames):
                self._failed(OSError(error, ""))

        return send

    def shortages(self, vehicles: int) -> list[str]:
        """Return which buffers are smaller than so many vehicles need, and the setting that allows larger ones."""
        found = []
        for what, option, each_bytes, setting in (
            ("receive", socket.SO_RCVBUF, _RECEIVED_BYTES, "net.core.rmem_max"),
            ("send", socket.SO_SNDBUF, _SENT_BYTES, "net.core.wmem_max"),
        ):
            given, needed = self._socket.getsockopt(socket.SOL_SOCKET, option), vehicles * each_bytes
            if given < needed:
                found.append(
                    f"{self.endpoint}: the {what} buffer holds {given / 1e3:.0f} kB, {vehicles} vehicles need "
                    f"{needed / 1e3:.0f} kB: raise the system's {setting}"
                )
        return found

    def admit_only(self, known: Collection[Address] | None, share: float) -> bool:
        """Let the system drop what comes from elsewhere, see `fg_gcs.link.kernel_filter`."""
        return attach(self._socket, known, share)

    @property
    def unread(self) -> int:
        """Datagrams that the system has dropped: of strangers in a flood, or for want of room."""
        if self._socket.fileno() >= 0:
            self._unread = dropped_by_system(self._socket)
        return self._unread

    def close(self) -> None:
        """Close the socket; may be called twice."""
        self._unread = self.unread
        if self._socket.fileno() >= 0:
            self._loop.remove_reader(self._socket)
            self._socket.close()

    def _receive(self) -> None:
        """Hand in what waits (the loop calls this)."""
        receive, hand_in, left = self._socket.recvfrom, self._on_data, _MOST_BYTES_AT_ONCE
        try:
            for _ in range(_MOST_AT_ONCE):
                data, address = receive(_MOST_DATAGRAM_BYTES)
                hand_in(self, address, data)
                left -= len(data)
                if left <= 0 or self._socket.fileno() < 0:  # enough, or closed by what came
                    return
        except BlockingIOError:
            return
        except OSError as error:
            self._failed(error)

    def _failed(self, error: OSError) -> None:
        if error.errno in (errno.EAGAIN, errno.ENOBUFS):
            self.dropped += 1
        else:
            self.errors += 1


class MemoryWire(Wire, asyncio.DatagramProtocol):
    """An endpoint of the network of virtual time."""

    _transport: asyncio.DatagramTransport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the transport (the network calls this)."""
        self._transport = cast("asyncio.DatagramTransport", transport)
        self.remote = transport.get_extra_info("peername")

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Hand in a datagram (the network calls this)."""
        self._on_data(self, addr, data)

    def send_all(self, datagrams: Iterable[Datagram]) -> None:
        """Send datagrams."""
        for data, address in datagrams:
            self._transport.sendto(data, address)

    def close(self) -> None:
        """Close the endpoint."""
        self._transport.close()


class _Stream(asyncio.Protocol):
    """One TCP connection from its beginning to its end.

    Args:
        wire: Hears of all that happens.
    """

    def __init__(self, wire: "TcpWire") -> None:
        self.transport: asyncio.Transport
        self.ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._wire = wire

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the transport (asyncio calls this)."""
        self.transport = cast("asyncio.Transport", transport)
        self._wire.connected(self)

    def data_received(self, data: bytes) -> None:
        """Hand in bytes (asyncio calls this)."""
        self._wire.received(data)

    def eof_received(self) -> None:
        """End at once (asyncio calls this): whoever has stopped talking is not waited for to listen."""
        self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell of the end (asyncio calls this)."""
        self.ended.set_result(None)
        self._wire.disconnected(self)


class TcpWire(Wire):
    """A TCP connection that we open, and open again whenever it breaks: `open_wire` makes one.

    Every connection begins with whole frames in both directions; what was under way in the one before is lost.
    """

    def __init__(self, endpoint: Endpoint, on_data: OnData, on_change: OnChange | None) -> None:
        super().__init__(endpoint, on_data)
        self.remote = (endpoint.host, endpoint.port)
        self._on_change = on_change
        self._stream: _Stream | None = None  # the present connection
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

    def connected(self, stream: _Stream) -> None:
        """Take a connection that stands (the stream calls this)."""
        self._stream = stream
        if self._broken:
            self._tell(Change.BACK)

    def received(self, data: bytes) -> None:
        """Hand in bytes (the stream calls this)."""
        if not self._closed and self.remote is not None:
            self._on_data(self, self.remote, data)

    def disconnected(self, stream: _Stream) -> None:
        """Take the end of a connection (the stream calls this)."""
        if stream is self._stream:
            self._stream, self._broken = None, True
            self.errors += not self._closed
            self._tell(Change.LOST)

    def send_all(self, datagrams: Iterable[Datagram]) -> None:
        """Send whole frames, unless too much is waiting already or there is no connection now."""
        transport = None if self._stream is None else self._stream.transport
        for data, _ in datagrams:
            if transport is None or transport.is_closing() or transport.get_write_buffer_size() > _TCP_QUEUE_BYTES:
                self.dropped += 1
            else:
                transport.write(data)

    def close(self) -> None:
        """Close the connection, or give up one that is being made; may be called twice."""
        self._closed = True
        if self._keeper is not None:
            self._keeper.cancel()
        if self._stream is not None:
            self._stream.transport.close()

    def _tell(self, change: Change) -> None:
        if self._on_change is not None and not self._closed:
            self._on_change(self, change)

    async def _connect(self) -> _Stream:
        loop, (host, port) = asyncio.get_running_loop(), (self.endpoint.host, self.endpoint.port)
        try:
            async with asyncio.timeout(CONNECT_S):
                return (await loop.create_connection(lambda: _Stream(self), host, port))[1]
        except TimeoutError as error:
            raise TimeoutError(errno.ETIMEDOUT, f"no answer within {CONNECT_S:g} s") from error

    async def _keep(self, stream: _Stream) -> None:
        """Wait for the end of every connection and make another, for ever: the wire's own task."""
        loop, pause_s = asyncio.get_running_loop(), FIRST_PAUSE_S
        while True:
            began_s, ended = loop.time(), stream.ended
            await ended
            if loop.time() - began_s >= STEADY_S:
                pause_s = FIRST_PAUSE_S
            while stream.ended is ended:
                await asyncio.sleep(pause_s)
                pause_s = min(2.0 * pause_s, MOST_PAUSE_S)
                try:
                    stream = await self._connect()
                except OSError:
                    self.errors += 1


async def open_wire(endpoint: Endpoint, on_data: OnData, on_change: OnChange | None = None) -> Wire:
    """Open the socket of an endpoint.

    A TCP connection that stood once is made again whenever it breaks, after pauses that double from `FIRST_PAUSE_S` up
    to `MOST_PAUSE_S`; on the way nothing is raised, and what is sent meanwhile is dropped.

    No address is shared (SO_REUSEADDR, SO_REUSEPORT): a second ground station must not steal the first one's datagrams.

    Args:
        endpoint: What to open.
        on_data: Gets the wire, the sender's address and the bytes; must not raise.
        on_change: Gets the wire and what became of its connection, before any bytes of a new one; must not raise.

    Raises:
        LinkError: The port is taken, the connection is refused, or no host has that name.
    """
    loop = asyncio.get_running_loop()
    try:
        if endpoint.kind is Kind.TCP:
            wire = TcpWire(endpoint, on_data, on_change)
            await wire.open()
            return wire
        if not isinstance(loop, VirtualTimeLoop):
            return UdpWire(endpoint, on_data, await _udp_socket(endpoint), bulk_send_of())
        address = (endpoint.host, endpoint.port)
        local, remote = (address, None) if endpoint.kind is Kind.UDP_IN else (None, address)
        made = await loop.create_datagram_endpoint(
            lambda: MemoryWire(endpoint, on_data), local_addr=local, remote_addr=remote
        )
        return made[1]
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise LinkError(f"{endpoint}: port {endpoint.port} is in use: another ground station?") from error
        raise LinkError(f"{endpoint}: {error.strerror or error}") from error
    except UnicodeError as error:  # what the system's own encoding of host names refuses
        raise LinkError(f"{endpoint}: there is no host called {endpoint.host!r}") from error


async def _udp_socket(endpoint: Endpoint) -> socket.socket:
    """Return a socket that is bound, or connected, to an endpoint.

    Raises:
        OSError: It cannot be, by any of the addresses that the host has.
    """
    found = await asyncio.get_running_loop().getaddrinfo(endpoint.host, endpoint.port, type=socket.SOCK_DGRAM)
    refusal = OSError(errno.EADDRNOTAVAIL, "the host has no address")
    for family, kind, protocol, _, address in found:
        try:
            own = socket.socket(family, kind, protocol)
        except OSError as error:
            refusal = error
            continue
        try:
            own.setblocking(False)
            for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
                with suppress(OSError):  # some systems refuse what others cut: see `UdpWire.shortages`
                    own.setsockopt(socket.SOL_SOCKET, option, _BUFFER_BYTES)
            if endpoint.kind is Kind.UDP_IN:
                own.bind(address)
            else:
                own.connect(address)
        except OSError as error:
            own.close()
            refusal = error
        else:
            return own
    raise refusal
