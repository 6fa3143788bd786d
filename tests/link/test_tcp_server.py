"""A TCP port of ours that vehicles connect to, several at once."""

from __future__ import annotations

import asyncio

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import LinkError
from fg_gcs.link.endpoint import Endpoint, Kind
from fg_gcs.link.opening import open_wire
from fg_gcs.link.router import Router
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.codec import Codec, Message
from fg_gcs.wire.framing import Sender
from tests.link.test_serial import until
from tests.link.test_tcp import fast


def free() -> int:
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


class Caller:
    """A vehicle that has connected."""

    def __init__(self, system_id: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.sender, self.codec, self.reader, self.writer = Sender(system_id, 1), Codec(), reader, writer

    @classmethod
    async def call(cls, endpoint: Endpoint, system_id: int) -> Caller:
        return cls(system_id, *await asyncio.open_connection(endpoint.host, endpoint.port))

    def beat(self) -> None:
        self.writer.write(self.sender.pack(dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 3, 3)))

    async def hears(self, kind: str) -> dialect.MAVLink_message:
        while True:
            for message in self.codec.receive(await self.reader.read(4096)):
                if message.get_type() == kind:
                    return message


def test_vehicles_that_connect_are_told_each_its_own() -> None:
    async def main() -> None:
        endpoint = Endpoint(Kind.TCP_IN, "127.0.0.1", free())
        router = await Router.open({MAIN: [endpoint]})
        callers = {number: await Caller.call(endpoint, number) for number in (1, 2, 3)}
        for caller in callers.values():
            caller.beat()
        await until(lambda: len(router.vehicles) == 3)
        for number, caller in callers.items():
            router.send_message(VehicleAddress(MAIN, number), dialect.MAVLink_ping_message(number, 13, number, 1))
            assert (await caller.hears("PING")).target_system == number
        router.close()
        assert await callers[1].reader.read() == b""
        for caller in callers.values():
            caller.writer.close()

    fast(main)


def test_a_vehicle_that_connects_anew_is_the_same_one_at_once() -> None:
    async def main() -> None:
        endpoint, address = Endpoint(Kind.TCP_IN, "127.0.0.1", free()), VehicleAddress(MAIN, 5)
        router = await Router.open({MAIN: [endpoint]})
        for number in range(3):
            caller = await Caller.call(endpoint, 5)
            caller.beat()
            await until(lambda: address in router.vehicles)
            hearing = asyncio.ensure_future(caller.hears("PING"))

            def told(hearing: asyncio.Future[Message] = hearing, number: int = number) -> bool:
                router.send_message(address, dialect.MAVLink_ping_message(number, 13, 5, 1))
                return hearing.done()

            await until(told)
            caller.writer.close()
            await caller.writer.wait_closed()
        assert router.counters.clashes == 0
        assert not router.notices
        router.close()

    fast(main)


def test_a_port_that_is_taken_is_refused_in_one_line() -> None:
    async def main() -> None:
        endpoint = Endpoint(Kind.TCP_IN, "127.0.0.1", free())
        first = await open_wire(endpoint, lambda *_: None)
        with pytest.raises(LinkError, match=f"tcpin:127.0.0.1:{endpoint.port}: port {endpoint.port} is in use"):
            await open_wire(endpoint, lambda *_: None)
        first.close()
        first.close()

    fast(main)
