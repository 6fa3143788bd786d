"""Opens the socket, or the device, of an endpoint."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from fg_gcs.errors import LinkError
from fg_gcs.link.bulk import bulk_send_of
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.link.endpoint import Endpoint, Kind, OnChange, OnData, Wire
from fg_gcs.link.kept_wire import KeptWire
from fg_gcs.link.serial_wire import SerialWire
from fg_gcs.link.tcp_wire import TcpServerWire, TcpWire
from fg_gcs.link.udp_wire import MemoryWire, UdpWire, udp_socket

_KEPT: Final[Mapping[Kind, type[KeptWire]]] = MappingProxyType({Kind.TCP: TcpWire, Kind.SERIAL: SerialWire})


async def open_wire(endpoint: Endpoint, on_data: OnData, on_change: OnChange | None = None) -> Wire:
    """Open the socket, or the device, of an endpoint.

    A TCP connection that stood once is made again whenever it breaks, and a device opened again that was unplugged,
    after pauses that double, see `fg_gcs.link.kept_wire`; on the way nothing is raised, and what is sent meanwhile is
    dropped.

    No address is shared (SO_REUSEADDR, SO_REUSEPORT): a second ground station must not steal the first one's datagrams.

    Args:
        endpoint: What to open.
        on_data: Gets the wire, the sender's address and the bytes; must not raise.
        on_change: Gets the wire and what became of its connection, before any bytes of a new one; must not raise.

    Raises:
        LinkError: The port is taken, the connection is refused, no host has that name, or there is no such device.
    """
    loop = asyncio.get_running_loop()
    try:
        if endpoint.kind in _KEPT:
            kept = _KEPT[endpoint.kind](endpoint, on_data, on_change)
            await kept.open()
            return kept
        if endpoint.kind is Kind.TCP_IN:
            server = TcpServerWire(endpoint, on_data)
            await server.open()
            return server
        if not isinstance(loop, VirtualTimeLoop):
            return UdpWire(endpoint, on_data, await udp_socket(endpoint), bulk_send_of())
        address = (endpoint.host, endpoint.port)
        local, remote = (address, None) if endpoint.kind is Kind.UDP_IN else (None, address)
        made = await loop.create_datagram_endpoint(
            lambda: MemoryWire(endpoint, on_data), local_addr=local, remote_addr=remote
        )
        return made[1]
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise LinkError(f"{endpoint}: port {endpoint.port} is in use: another ground station?") from error
        if error.errno == errno.ECONNREFUSED:
            raise LinkError(f"{endpoint}: nothing listens there; it must be started first") from error
        if error.errno == errno.EBUSY and endpoint.kind is Kind.SERIAL:
            raise LinkError(f"{endpoint}: the device is in use: another ground station?") from error
        raise LinkError(f"{endpoint}: {error.strerror or error}") from error
    except UnicodeError as error:  # what the system's own encoding of host names refuses
        raise LinkError(f"{endpoint}: there is no host called {endpoint.host!r}") from error
