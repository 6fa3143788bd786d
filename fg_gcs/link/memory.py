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
        self._under_way: deque[tuple[float, bytes, Address, Address]] = deque()  # by the times when they arrive
        self._is_timed = False  # a timer is set for the first of them

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
        due_s = self._loop.time() + self._latency_s
        self._under_way.append((due_s, data, source, target))
        if not self._is_timed:
            self._is_timed = True
            self._loop.call_at(due_s, self._deliver)

    def settle(self) -> None:
        """Deliver all that is under way now; what is sent in answer takes its time."""
        for _ in range(len(self._under_way)):
            _, data, source, target = self._under_way.popleft()
            endpoint = self._endpoints.get(target)
            if endpoint is not None:
                endpoint.deliver(data, source)

    def _deliver(self) -> None:
        """Deliver all that is due: one timer for all datagrams of one instant, because timers cost more than they."""
        under_way, endpoints = self._under_way, self._endpoints
        due_s = under_way[0][0] if under_way else 0.0  # none where everything was settled meanwhile
        try:
            while under_way and under_way[0][0] <= due_s:
                _, data, source, target = under_way.popleft()
                endpoint = endpoints.get(target)
                if endpoint is not None:
                    endpoint.deliver(data, source)
        finally:  # whatever a receiver raises is told by the loop, and the others get theirs
            self._is_timed = bool(under_way)
            if under_way:
                self._loop.call_at(under_way[0][0], self._deliver)


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
