"""Telemetry for other programs, over sockets in memory and real ones; what they say to vehicles."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Sequence

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import LinkError
from fg_gcs.link.endpoint import Endpoint, Kind, parse_endpoint
from fg_gcs.link.forwarding import HELD_S, TOGETHER_BYTES, Forwards, parse_forwards
from fg_gcs.link.router import Direction, Router
from fg_gcs.wire.address import MAIN
from fg_gcs.wire.codec import Codec, Message
from fg_gcs.wire.framing import Frames, Sender
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.signing import Signing, Stamps, stamp_of
from tests.link.test_router import GROUND, Fake, at, settle, virtually
from tests.link.test_serial import until
from tests.link.test_tcp import fast

RECEIVER = parse_endpoint("udpout:127.0.0.1:14560")
OTHER = parse_endpoint("udpout:127.0.0.1:14561")
LAND = dialect.MAVLink_command_long_message(1, 1, 21, 0, 0, 0, 0, 0, 0, 0, 0)


class Program(asyncio.DatagramProtocol):
    """Another ground station's socket."""

    def __init__(self, signing: Signing | None = None) -> None:
        self.datagrams: list[bytes] = []
        self.sender = Sender(250, 190, None if signing is None else signing.signature(0))
        self.transport: asyncio.DatagramTransport
        self.address: tuple[str, int] | None = None

    @classmethod
    async def start(cls, endpoint: Endpoint = RECEIVER, signing: Signing | None = None) -> Program:
        loop = asyncio.get_running_loop()
        made = await loop.create_datagram_endpoint(lambda: cls(signing), local_addr=(endpoint.host, endpoint.port))
        made[1].transport = made[0]
        return made[1]

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.datagrams.append(data)
        self.address = addr

    def say(self, *messages: Message) -> None:
        for message in messages:
            self.transport.sendto(self.sender.pack(message), self.address)

    def sees(self) -> list[str]:
        return [frame.get_type() for data in self.datagrams for frame in Codec(datagrams=True).receive(data)]


def flown_by(system_id: int, router: Router, phase: Phase) -> None:
    router.vehicles[at(system_id)].phase = phase


def test_every_frame_of_vehicles_passes_as_it_came_and_no_other() -> None:
    async def main() -> None:
        heard: list[bytes] = []

        def tap(direction: Direction, frames: Sequence[bytes] | Frames, now_s: float) -> None:
            if direction is Direction.IN:
                heard.extend(bytes(frame) for frame in frames)

        router = await Router.open({MAIN: [GROUND]}, tap=tap, forwards=Forwards({MAIN: [RECEIVER, OTHER]}, False))
        programs = [await Program.start(endpoint) for endpoint in (RECEIVER, OTHER)]
        fakes, stranger = [await Fake.start(number) for number in (1, 2)], await Fake.start(77)
        for fake in fakes:
            fake.beat()
        await settle()
        heard.clear()
        for number in range(100):
            for fake in fakes:
                fake.say(dialect.MAVLink_local_position_ned_message(number, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0))
        camera = Sender(1, 100)
        fakes[0].transport.sendto(camera.pack(dialect.MAVLink_heartbeat_message(30, 8, 0, 0, 3, 3)))
        stranger.say(dialect.MAVLink_system_time_message(1, 2))
        await settle(0.1)
        for program in programs:
            frames = [frame.raw for data in program.datagrams for frame in Codec(datagrams=True).receive(data)]
            assert frames[2:] == [raw for raw in heard if raw[5] != 77]
            assert len(frames) == 2 + 201
            assert all(len(data) <= TOGETHER_BYTES for data in program.datagrams)
            assert len(program.datagrams) < 20
        assert (router.counters.forwarded, router.counters.not_forwarded) == (2 * 203, 0)
        router.close()
        router.close()

    virtually(main)


def test_a_frame_waits_no_longer_than_it_may() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]}, forwards=Forwards({MAIN: [RECEIVER]}, False))
        program, fake = await Program.start(), await Fake.start(1)
        fake.beat()
        await settle(HELD_S + 0.01)
        assert program.sees() == ["HEARTBEAT"]
        router.close()

    virtually(main)


def test_commands_are_dropped_counted_and_told_once_unless_the_mission_allows_them() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]}, forwards=Forwards({MAIN: [RECEIVER]}, False))
        program, fake = await Program.start(), await Fake.start(1)
        fake.beat()
        await settle(0.1)
        flown_by(1, router, Phase.FLYING)
        program.say(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), LAND, LAND)
        program.say(dialect.MAVLink_param_request_list_message(1, 1))
        await settle(0.1)
        assert fake.heard == []
        assert router.counters.commands_dropped == 3
        assert list(router.notices) == [
            "udpout:127.0.0.1:14560: what it says to vehicles is not passed on: the mission does not allow it "
            "([swarm] forward_commands)"
        ]
        assert router.vehicles[at(1)].phase is Phase.FLYING
        router.close()

    virtually(main)


def test_what_the_mission_allows_reaches_its_vehicle_alone_which_is_theirs_then() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]}, forwards=Forwards({MAIN: [RECEIVER]}, True))
        program, fakes = await Program.start(), [await Fake.start(number) for number in (1, 2)]
        for number, fake in enumerate(fakes, start=1):
            fake.beat()
            await settle()
            flown_by(number, router, Phase.FLYING)
        await settle(0.1)
        program.say(dialect.MAVLink_param_request_list_message(1, 1))
        await settle(0.1)
        assert fakes[0].names() == ["PARAM_REQUEST_LIST"]
        assert router.vehicles[at(1)].phase is Phase.FLYING  # it was only asked
        program.say(LAND, LAND)
        await settle(0.1)
        assert fakes[0].names() == ["PARAM_REQUEST_LIST", "COMMAND_LONG", "COMMAND_LONG"]
        assert [message.get_srcSystem() for message in fakes[0].heard] == [250] * 3
        assert [router.vehicles[at(number)].phase for number in (1, 2)] == [Phase.TAKEN, Phase.FLYING]
        assert fakes[1].heard == []
        assert (router.counters.commands_passed, router.counters.commands_dropped) == (3, 0)
        assert list(router.notices) == [
            "vehicle 1 is somebody else's from now on: COMMAND_LONG came for it from udpout:127.0.0.1:14560"
        ]
        router.close()

    virtually(main)


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (dialect.MAVLink_command_long_message(9, 1, 21, 0, 0, 0, 0, 0, 0, 0, 0), "there is no vehicle 9"),
        (dialect.MAVLink_command_long_message(0, 1, 21, 0, 0, 0, 0, 0, 0, 0, 0), "it is for all vehicles at once"),
        (dialect.MAVLink_setup_signing_message(1, 1, [7] * 32, 5), "keys are given over links of their own"),
    ],
)
def test_some_things_reach_nobody_whatever_the_mission_says(message: Message, said: str) -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]}, forwards=Forwards({MAIN: [RECEIVER]}, True))
        program, fake = await Program.start(), await Fake.start(1)
        fake.beat()
        await settle(0.1)
        program.say(message)
        await settle(0.1)
        assert fake.heard == []
        assert router.counters.commands_dropped == 1
        assert router.notices[0].endswith(said)
        router.close()

    virtually(main)


def test_in_a_network_with_a_key_only_what_is_signed_with_it_reaches_a_vehicle() -> None:
    def signing(key: bytes) -> Signing:
        return Signing(key, Stamps(lambda: 0.0, stamp_of(1.7e9)))

    async def main() -> None:
        ours, key = signing(bytes([1]) * 32), bytes([1]) * 32
        router = await Router.open({MAIN: [GROUND]}, signing={MAIN: ours}, forwards=Forwards({MAIN: [RECEIVER]}, True))
        program, fake = await Program.start(signing=signing(key)), await Fake.start(1)
        fake.sender = Sender(1, 1, signing(key).signature(4))
        fake.beat()
        await settle(0.1)
        assert program.sees() == ["HEARTBEAT"]  # with its signature, so that the program can judge it as well
        assert program.datagrams[0][2] == 1
        frame = program.sender.pack(LAND)
        for data in (frame, frame, Sender(250, 190).pack(LAND)):
            program.transport.sendto(data, program.address)
        await settle(0.1)
        assert [message.get_msgbuf() for message in fake.heard] == [frame]
        assert (router.counters.commands_passed, router.counters.commands_dropped) == (1, 2)
        assert (router.counters.replayed, router.counters.unsigned) == (1, 1)
        router.close()

    virtually(main)


def test_a_program_that_talks_too_much_is_not_read() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]}, forwards=Forwards({MAIN: [RECEIVER]}, True))
        program, fake = await Program.start(), await Fake.start(1)
        fake.beat()
        await settle(0.1)
        program.say(*[LAND] * 5000)
        await settle(0.1)
        assert 1000 < len(fake.heard) < 2000
        assert len(fake.heard) + router.counters.commands_dropped == 5000
        router.close()

    virtually(main)


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def test_mavutil_sees_all_vehicles() -> None:
    """The reading side of MAVProxy and of many loggers."""

    async def main() -> None:
        port, ground = free_port(socket.SOCK_DGRAM), Endpoint(Kind.UDP_IN, "127.0.0.1", free_port(socket.SOCK_DGRAM))
        seen: dict[int, list[int]] = {1: [], 2: []}
        receiver = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", dialect="all")
        forwards = Forwards({MAIN: [Endpoint(Kind.UDP_OUT, "127.0.0.1", port)]}, False)
        router = await Router.open({MAIN: [ground]}, forwards=forwards)
        vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        senders = {number: Sender(number, 1) for number in seen}
        for sender in senders.values():
            heartbeat = dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 3, 3)
            vehicle.sendto(sender.pack(heartbeat), (ground.host, ground.port))
        await until(lambda: len(router.vehicles) == 2)
        for count in range(200):
            for sender in senders.values():
                position = dialect.MAVLink_local_position_ned_message(count, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0)
                vehicle.sendto(sender.pack(position), (ground.host, ground.port))
            await asyncio.sleep(0.001)

        def all_seen() -> bool:
            while (message := receiver.recv_msg()) is not None:
                if message.get_type() == "LOCAL_POSITION_NED":
                    seen[message.get_srcSystem()].append(message.time_boot_ms)
            return sum(map(len, seen.values())) == 400

        await until(all_seen)
        assert seen == {number: list(range(200)) for number in seen}
        receiver.close()
        vehicle.close()
        router.close()

    fast(main)


def test_a_receiver_that_reads_nothing_holds_nothing_up() -> None:
    """A TCP program that stands still: what it does not take is dropped, and every frame of ours leaves at once."""

    async def main() -> None:
        loop, stuck = asyncio.get_running_loop(), socket.create_server(("127.0.0.1", 0))
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        ground = Endpoint(Kind.UDP_IN, "127.0.0.1", free_port(socket.SOCK_DGRAM))
        forwards = Forwards({MAIN: [Endpoint(Kind.TCP, "127.0.0.1", stuck.getsockname()[1])]}, False)
        router = await Router.open({MAIN: [ground]}, forwards=forwards)
        vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        vehicle.connect((ground.host, ground.port))
        sender = Sender(1, 1)
        vehicle.send(sender.pack(dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 3, 3)))
        await until(lambda: router.vehicles)
        text = dialect.MAVLink_statustext_message(6, b"x" * 50)
        began_s = loop.time()
        while not router.counters.not_forwarded:
            for _ in range(50):
                vehicle.send(sender.pack(text))
            router.send_message(at(1), text)
            await asyncio.sleep(0.02)
        assert loop.time() - began_s < 600.0
        assert router.counters.dropped == 0
        router.close()
        vehicle.close()
        stuck.close()

    fast(main)


MAIN_ONLY = {MAIN: [GROUND]}
TWO = {"east": [GROUND], "west": [parse_endpoint("tcp:5760")]}


@pytest.mark.parametrize(
    ("texts", "networks", "found"),
    [
        ([], MAIN_ONLY, {}),
        (["udpout:127.0.0.1:14560", "west=udpout:14561"], MAIN_ONLY, {MAIN: [RECEIVER, OTHER]}),
        (["west=udpout:14560", " east = tcp:5762"], TWO, {"west": [RECEIVER], "east": [parse_endpoint("tcp:5762")]}),
    ],
)
def test_receivers_belong_to_networks(
    texts: list[str], networks: dict[str, list[Endpoint]], found: dict[str, list[Endpoint]]
) -> None:
    assert parse_forwards(texts, networks) == found


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("udpout:14560", r"names no network; accepted: NAME=ENDPOINT with east or west"),
        ("north=udpout:14560", r"names no network; accepted: NAME=ENDPOINT with east or west"),
        ("east=udpin:14560", r"is not of the form \[NAME=\]udpout:HOST:PORT or \[NAME=\]tcp:HOST:PORT"),
        ("east=serial:/dev/ttyS0:57600", r"is not of the form \[NAME=\]udpout"),
        ("east=udpout:14550", r"vehicles are heard at port 14550; another program needs another one"),
        ("west=tcp:5760", r"vehicles are heard at port 5760"),
        ("east=14550", r"is not of the form udpin"),
    ],
)
def test_other_receivers_are_refused_in_one_line(text: str, said: str) -> None:
    with pytest.raises(LinkError, match=said):
        parse_forwards([text], TWO)
