"""Datagrams between the endpoints of one event loop, without sockets: the network of virtual time."""

import asyncio
import errno
from collections import deque
from typing import Any, Final

Address = tuple[str, int]

_FIRST_FREE_PORT: Final = 49152  # where the system's own free ports begin


class MemoryNetwork:
    """All endpoints of one loop; every datagram takes the same time and none overtakes another.

    Args:
        loop: The loop whose time counts.
        latency_s: How long a datagram takes [s].
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, latency_s: float) -> None:
        self._loop = loop
        self._latency_s = latency_s
        self._endpoints: dict[Address, MemoryTransport] = {}
        self._under_way: deque[tuple[bytes, Address, Address]] = deque()

    def open(
        self, protocol: asyncio.DatagramProtocol, local: Address | None, remote: Address | None
    ) -> "MemoryTransport":
        """Bind ``protocol`` to ``local`` (none: any free port), connected to ``remote`` if that is given.

        Raises:
            OSError: The port is taken (EADDRINUSE).
        """
        host, port = local or ("127.0.0.1", 0)
        if port == 0:
            port = next(free for free in range(_FIRST_FREE_PORT, 65536) if (host, free) not in self._endpoints)
        if (host, port) in self._endpoints:
            raise OSError(errno.EADDRINUSE, f"address already in use: {host}:{port}")
        transport = MemoryTransport(self, protocol, (host, port), remote)
        self._endpoints[host, port] = transport
        protocol.connection_made(transport)
        return transport

    def close(self, address: Address, protocol: asyncio.DatagramProtocol) -> None:
        """Free the address and tell its protocol."""
        if self._endpoints.pop(address, None) is not None:
            self._loop.call_soon(protocol.connection_lost, None)

    def send(self, data: bytes, source: Address, target: Address) -> None:
        """Deliver later; if there is no endpoint by then, the datagram is lost."""
        # The queue keeps the order: two timers of the same instant may fire in any.
        self._under_way.append((data, source, target))
        self._loop.call_later(self._latency_s, self._deliver)

    def _deliver(self) -> None:
        data, source, target = self._under_way.popleft()
        endpoint = self._endpoints.get(target)
        if endpoint is not None:
            endpoint.deliver(data, source)


class MemoryTransport(asyncio.DatagramTransport):
    """One endpoint of a `MemoryNetwork`; connected to ``remote`` it hears and reaches only that one."""

    def __init__(
        self,
        network: MemoryNetwork,
        protocol: asyncio.DatagramProtocol,
        local: Address,
        remote: Address | None,
    ) -> None:
        super().__init__({"sockname": local, "peername": remote})
        self._network, self._protocol = network, protocol
        self._local, self._remote = local, remote
        self._closing = False

    def sendto(self, data: Any, addr: Any = None) -> None:  # noqa: ANN401 - the base class's own types differ by version
        """Send a datagram; without a target, or from a closed endpoint, it is dropped."""
        target = addr or self._remote
        if target is not None and not self._closing:
            self._network.send(bytes(data), self._local, target)

    def deliver(self, data: bytes, source: Address) -> None:
        """Take a datagram from the network."""
        if self._remote is None or self._remote == source:
            self._protocol.datagram_received(data, source)

    def is_closing(self) -> bool:
        """Tell whether it was closed."""
        return self._closing

    def close(self) -> None:
        """Close it; what is under way to it is lost."""
        self._closing = True
        self._network.close(self._local, self._protocol)

    def abort(self) -> None:
        """Close it."""
        self.close()
