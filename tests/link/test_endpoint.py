import asyncio
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.errors import LinkError
from fg_gcs.link.bulk import bulk_send_of
from fg_gcs.link.clock import ticks
from fg_gcs.link.endpoint import (
    Address,
    Endpoint,
    Kind,
    Wire,
    ardupilot_endpoints,
    parse_endpoint,
    parse_networks,
    places,
    px4_endpoints,
)
from fg_gcs.link.opening import open_wire
from fg_gcs.link.udp_wire import UdpWire


@pytest.mark.parametrize(
    ("text", "endpoint"),
    [
        ("udpin:127.0.0.1:14550", Endpoint(Kind.UDP_IN, "127.0.0.1", 14550)),
        ("udpin:0.0.0.0:14550", Endpoint(Kind.UDP_IN, "0.0.0.0", 14550)),
        ("udp:14550", Endpoint(Kind.UDP_IN, "127.0.0.1", 14550)),
        ("udp://:14550", Endpoint(Kind.UDP_IN, "127.0.0.1", 14550)),
        ("udpin://127.0.0.1:14550", Endpoint(Kind.UDP_IN, "127.0.0.1", 14550)),
        ("udpout:localhost:18570", Endpoint(Kind.UDP_OUT, "localhost", 18570)),
        (" TCP:127.0.0.1:5760 ", Endpoint(Kind.TCP, "127.0.0.1", 5760)),
        ("tcpin:0.0.0.0:5760", Endpoint(Kind.TCP_IN, "0.0.0.0", 5760)),
        ("tcpin:5760", Endpoint(Kind.TCP_IN, "127.0.0.1", 5760)),
        ("serial:/dev/ttyACM0:115200", Endpoint(Kind.SERIAL, "/dev/ttyACM0", 115200)),
    ],
)
def test_accepted_forms(text: str, endpoint: Endpoint) -> None:
    assert parse_endpoint(text) == endpoint
    assert parse_endpoint(str(endpoint)) == endpoint


@pytest.mark.parametrize(
    "text", ["", "14550", "udpin", "udpin:", "udpin:host", "serial:/dev/ttyS0", "udp:a:b:1", "tcp:h:0", "tcp:h:65536"]
)
def test_other_forms_are_refused_with_the_list_of_good_ones(text: str) -> None:
    with pytest.raises(
        LinkError, match=r"udpin:HOST:PORT.*udpout:HOST:PORT.*tcp:HOST:PORT.*tcpin:HOST:PORT.*serial:DEVICE:BAUD"
    ):
        parse_endpoint(text)


@given(text=st.text())
def test_any_text_gives_an_endpoint_or_one_clear_line(text: str) -> None:
    try:
        told = str(parse_endpoint(text))
    except LinkError as error:
        told = str(error)
    assert told.isprintable()


UDP = [Endpoint(Kind.UDP_IN, "127.0.0.1", port) for port in (1, 2, 3)]


@pytest.mark.parametrize(
    ("texts", "networks"),
    [
        ([], {}),
        (["udp:1"], {"main": UDP[:1]}),
        (["udp:1", "udp:2"], {"main": UDP[:2]}),
        (["west=udp:1", "west=udp:2"], {"main": UDP[:2]}),  # the only network needs no name
        (["west=udp:1", "east=udp:2", " west = udp:3"], {"west": [UDP[0], UDP[2]], "east": [UDP[1]]}),
        (["udp:1", "east=udp:2"], {"main": [UDP[0]], "east": [UDP[1]]}),
    ],
)
def test_endpoints_of_one_name_are_one_network(texts: list[str], networks: dict[str, list[Endpoint]]) -> None:
    assert parse_networks(texts) == {name: tuple(endpoints) for name, endpoints in networks.items()}


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["West=udp:1"], "network 'West' in 'West=udp:1' is not a name of 1 to 16 of a-z, 0-9, - and _"),
        (["=udp:1"], "network '' in"),
        (["a" * 17 + "=udp:1"], "is not a name of 1 to 16"),
        (["west/1=udp:1"], "is not a name of 1 to 16"),
        (["west=east=udp:1"], "endpoint 'east=udp:1' is not of the form udpin:HOST:PORT"),
        (["west="], "endpoint '' is not of the form"),
        (["udp:1", "west=udpin:127.0.0.1:1"], "endpoint udpin:127.0.0.1:1 occurs twice"),
    ],
)
def test_networks_that_are_none_are_refused_in_one_line(texts: list[str], said: str) -> None:
    with pytest.raises(LinkError) as caught:
        parse_networks(texts)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


class Heard:
    def __init__(self) -> None:
        self.data: list[bytes] = []
        self.addresses: list[Address] = []
        self.event = asyncio.Event()

    def __call__(self, wire: Wire, address: Address, data: bytes) -> None:
        self.data.append(data)
        self.addresses.append(address)
        self.event.set()

    async def wait(self) -> None:
        async with asyncio.timeout(5.0):  # seconds of real time: loopback needs microseconds
            await self.event.wait()
        self.event.clear()


async def free_port() -> int:
    """A UDP port of the real machine that was free a moment ago."""
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        asyncio.DatagramProtocol, local_addr=("127.0.0.1", 0)
    )
    port: int = transport.get_extra_info("sockname")[1]
    transport.close()
    await asyncio.sleep(0)
    return port


def test_real_udp_sockets_talk_both_ways() -> None:
    async def main() -> None:
        port, here, there = await free_port(), Heard(), Heard()
        bound = await open_wire(Endpoint(Kind.UDP_IN, "127.0.0.1", port), here)
        calling = await open_wire(Endpoint(Kind.UDP_OUT, "127.0.0.1", port), there)
        assert (bound.remote, calling.remote) == (None, ("127.0.0.1", port))
        calling.send(b"hello", ("127.0.0.1", port))
        await here.wait()
        bound.send(b"welcome", here.addresses[0])
        await there.wait()
        assert (here.data, there.data, there.addresses) == ([b"hello"], [b"welcome"], [("127.0.0.1", port)])
        with pytest.raises(LinkError, match=f"port {port} is in use: another ground station"):
            await open_wire(Endpoint(Kind.UDP_IN, "127.0.0.1", port), here)
        bound.close()
        calling.close()
        await asyncio.sleep(0)

    asyncio.run(main())


def test_calling_where_nobody_listens_is_counted_not_raised() -> None:
    async def main() -> int:
        wire = await open_wire(Endpoint(Kind.UDP_OUT, "127.0.0.1", await free_port()), Heard())
        async with asyncio.timeout(5.0):  # seconds of real time: the refusal comes within microseconds
            async for _ in ticks(0.0, 0.001):
                wire.send(b"anybody?", ("127.0.0.1", 1))
                if wire.errors:
                    break
        wire.close()
        await asyncio.sleep(0)
        return wire.errors

    assert asyncio.run(main()) > 0


def test_tcp_talks_both_ways_and_outlives_its_partner() -> None:
    async def main() -> None:
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write((await reader.read(100)).upper())
            writer.close()
            await writer.wait_closed()
            closed.set()

        closed, heard = asyncio.Event(), Heard()
        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        wire = await open_wire(Endpoint(Kind.TCP, "127.0.0.1", port), heard)
        wire.send(b"hello", ("127.0.0.1", port))
        await heard.wait()
        assert (heard.data, heard.addresses) == ([b"HELLO"], [("127.0.0.1", port)])
        async with asyncio.timeout(5.0):  # seconds of real time
            await closed.wait()
            async for _ in ticks(0.0, 0.001):
                if wire.errors:
                    break
        wire.send(b"too late", ("127.0.0.1", port))
        assert wire.dropped == 1
        wire.close()
        server.close()
        await server.wait_closed()
        with pytest.raises(LinkError, match=f"tcp:127.0.0.1:{port}"):
            await open_wire(Endpoint(Kind.TCP, "127.0.0.1", port), heard)

    asyncio.run(main())


def test_a_full_way_out_drops_instead_of_growing() -> None:
    async def main() -> None:
        # Datagrams of another kind: unlike those of UDP they are kept until they are read, so that the way can be full
        ours, deaf = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        ours.setblocking(False)
        wire = UdpWire(Endpoint(Kind.UDP_OUT, "127.0.0.1", 9), Heard(), ours, bulk_send_of())
        sent = 0
        while not wire.dropped and sent < 10_000:
            wire.send(bytes(1000), ("127.0.0.1", 9))
            sent += 1
        assert 1 < sent < 10_000
        for _ in range(sent - 1):
            deaf.recv(2000)
        wire.send(b"sent", ("127.0.0.1", 9))
        assert (wire.dropped, deaf.recv(2000)) == (1, b"sent")
        wire.close()
        deaf.close()

    asyncio.run(main())


def test_buffers_that_are_too_small_for_a_swarm_are_told_with_the_setting() -> None:
    async def main() -> None:
        own = socket.socket(type=socket.SOCK_DGRAM)
        own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 100_000)
        wire = UdpWire(Endpoint(Kind.UDP_IN, "127.0.0.1", 9), Heard(), own, bulk_send_of())
        given = own.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        (line,) = wire.shortages(60)
        assert line == (
            f"udpin:127.0.0.1:9: the receive buffer holds {given / 1e3:.0f} kB, 60 vehicles need 750 kB: "
            "raise the system's net.core.rmem_max"
        )
        assert wire.shortages(4) == []
        wire.close()

    asyncio.run(main())


def test_what_waits_is_read_in_its_order_and_not_all_at_once() -> None:
    async def main() -> None:
        port, heard = await free_port(), Heard()
        bound = await open_wire(Endpoint(Kind.UDP_IN, "127.0.0.1", port), heard)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            for number in range(100):
                other.sendto(bytes([number]), ("127.0.0.1", port))
        await asyncio.sleep(0)
        await heard.wait()
        assert 0 < len(heard.data) < 100  # timers had their turn
        while len(heard.data) < 100:
            await heard.wait()
        assert heard.data == [bytes([number]) for number in range(100)]
        bound.close()
        bound.close()

    asyncio.run(main())


def test_a_host_without_an_address_is_one_clear_line() -> None:
    async def main() -> None:
        with pytest.raises(LinkError, match=r"udpin:192\.0\.2\.1:14550: "):  # TEST-NET-1: no machine has it
            await open_wire(Endpoint(Kind.UDP_IN, "192.0.2.1", 14550), Heard())

    asyncio.run(main())


def test_presets_are_where_simulated_autopilots_are() -> None:
    assert px4_endpoints(3) == ("udpin:127.0.0.1:14540", "udpin:127.0.0.1:14541", "udpin:127.0.0.1:14542")
    assert px4_endpoints(10) == px4_endpoints(11) == px4_endpoints(250)  # from the tenth on they share a port
    assert px4_endpoints(250)[-1] == "udpin:127.0.0.1:14549"
    assert ardupilot_endpoints(3) == ("tcp:127.0.0.1:5760", "tcp:127.0.0.1:5770", "tcp:127.0.0.1:5780")
    assert px4_endpoints(0) == ardupilot_endpoints(0) == ()
    mixed = parse_networks([*px4_endpoints(12), *ardupilot_endpoints(250), "east=serial:/dev/ttyS0:57600"])
    assert [len(endpoints) for endpoints in mixed.values()] == [260, 1]


@pytest.mark.parametrize(
    ("texts", "told"),
    [
        (["udp:1", "udp:2"], "listening at udpin:127.0.0.1:1, udpin:127.0.0.1:2"),
        (["tcp:1"], "connected to tcp:127.0.0.1:1"),
        (
            ["udp:1", "tcp:2", "tcpin:3", "udpout:4", "serial:/dev/ttyS0:57600"],
            "listening at udpin:127.0.0.1:1, tcpin:127.0.0.1:3; connected to tcp:127.0.0.1:2, serial:/dev/ttyS0:57600; "
            "calling udpout:127.0.0.1:4",
        ),
        (
            ["east=udp:1", "west=udp:2", "west=tcp:3"],
            "listening at east: udpin:127.0.0.1:1; west: udpin:127.0.0.1:2; connected to west: tcp:127.0.0.1:3",
        ),
    ],
)
def test_people_are_told_what_is_done_where(texts: list[str], told: str) -> None:
    assert places(parse_networks(texts)) == told
