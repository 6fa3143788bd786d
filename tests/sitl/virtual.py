"""A simulator on a loop of virtual time, and a ground station that counts what becomes of datagrams."""

from __future__ import annotations

import asyncio
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.link.clock import VirtualTimeLoop
from sitl_mock import Simulator, SimulatorOptions

STATION = ("127.0.0.1", 14550)


class Listener(asyncio.DatagramProtocol):
    """Everything that the simulator sends to one port: time, sender's port, bytes."""

    transport: Any

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.heard: list[tuple[float, int, bytes]] = []

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        self.heard.append((self.loop.time(), addr[1], data))

    def send(self, message: Any, port: int, sequence: int = 0) -> None:  # noqa: ANN401 - pymavlink has no types
        mav = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        mav.seq = sequence
        self.transport.sendto(bytes(message.pack(mav)), ("127.0.0.1", port))

    def messages(self, kind: str, port: int, since_s: float = 0.0) -> list[tuple[float, Any]]:
        """Good messages of a vehicle, with the times at which they came."""
        found = []
        for time_s, sender, data in self.heard:
            if sender == port and time_s >= since_s:
                parser = dialect.MAVLink(None)  # nothing of a damaged datagram spoils the next one
                parser.robust_parsing = True
                found += [(time_s, m) for m in parser.parse_buffer(data) or () if m.get_type() == kind]
        return found


class World:
    """A simulator that runs for as long as it is told.

    Args:
        options: of the simulator; its vehicles listen on 18570 and on.
    """

    def __init__(self, options: SimulatorOptions) -> None:
        self.loop = VirtualTimeLoop()
        self.simulator = Simulator(options)
        self.station = Listener(self.loop)
        self.loop.run_until_complete(self._open())

    async def _open(self) -> None:
        await self.loop.create_datagram_endpoint(lambda: self.station, local_addr=STATION)
        await self.simulator.start()

    async def listener(self, port: int) -> Listener:
        """Another client."""
        other = Listener(self.loop)
        await self.loop.create_datagram_endpoint(lambda: other, local_addr=("127.0.0.1", port))
        return other

    def other(self, port: int) -> Listener:
        return self.loop.run_until_complete(self.listener(port))

    def run(self, seconds: float) -> None:
        self.loop.run_until_complete(asyncio.sleep(seconds))

    def close(self) -> None:
        self.loop.run_until_complete(self.simulator.close())
        self.loop.close()


def heartbeat() -> Any:  # noqa: ANN401 - pymavlink has no types
    """A ground station's."""
    return dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def command(number: int, *parameters: float, system: int = 1) -> Any:  # noqa: ANN401 - pymavlink has no types
    """COMMAND_LONG to an autopilot."""
    filled = (*parameters, *(0.0,) * (7 - len(parameters)))
    return dialect.MAVLink_command_long_message(system, 1, number, 0, *filled)
