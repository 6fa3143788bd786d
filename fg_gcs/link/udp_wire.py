"""UDP: a socket of our own for real time, an endpoint of the network in memory for virtual time."""

from __future__ import annotations

import asyncio
import errno
import socket
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from typing import Final, cast

from fg_gcs.link.bulk import Bulk, Send
from fg_gcs.link.endpoint import Address, Datagram, Endpoint, Kind, OnData, Wire
from fg_gcs.link.kernel_filter import attach, dropped_by_system
from fg_gcs.wire.framing import Frames

_BUFFER_BYTES: Final = 4 << 20  # asked of the system, which gives what its settings allow
_RECEIVED_BYTES: Final = 12_500  # of a vehicle: 50 messages a second, each 1 kB of the system's memory, for 0.25 s
_SENT_BYTES: Final = 1_000  # of a vehicle: one round of setpoints
_MOST_DATAGRAM_BYTES: Final = 65536  # no datagram is longer
_MOST_AT_ONCE: Final = 64  # datagrams read before the loop looks at its timers: half a millisecond of work
_MOST_BYTES_AT_ONCE: Final = 4096  # and so much of theirs, which is a hundred short messages


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


async def udp_socket(endpoint: Endpoint) -> socket.socket:
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
