import asyncio
import random
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import LinkError
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.link.endpoint import Endpoint, Kind
from fg_gcs.link.peers import MOST_STRANGERS
from fg_gcs.link.router import Direction, Router
from fg_gcs.wire import commands
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.autopilots import ARDUPILOT, PX4, AutopilotProfile
from fg_gcs.wire.codec import Codec, Message
from fg_gcs.wire.framing import Frames, Sender
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.setpoint import NUMBERS, SetpointRound
from fg_gcs.wire.vehicle import LOST_AFTER_S, Vehicle

PORT = 14550
GROUND = Endpoint(Kind.UDP_IN, "127.0.0.1", PORT)
Result = TypeVar("Result")


class Fake(asyncio.DatagramProtocol):
    """An autopilot's link: says what the test wants and remembers what it hears."""

    def __init__(self, system_id: int, profile: AutopilotProfile = PX4) -> None:
        self.sender, self.codec, self.profile = Sender(system_id, 1), Codec(), profile
        self.heard: list[Message] = []
        self.transport: asyncio.DatagramTransport
        self.target: tuple[str, int] | None = None

    @classmethod
    async def start(cls, system_id: int, profile: AutopilotProfile = PX4, *, local: int | None = None) -> "Fake":
        loop = asyncio.get_running_loop()
        there, here = ("127.0.0.1", PORT), None if local is None else ("127.0.0.1", local)
        made = await loop.create_datagram_endpoint(
            lambda: cls(system_id, profile), local_addr=here, remote_addr=there if local is None else None
        )
        made[1].transport = made[0]
        return made[1]

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.target = addr
        self.heard += self.codec.receive(data)

    def say(self, message: Message) -> None:
        self.transport.sendto(self.sender.pack(message), self.target)

    def beat(self, mode: int = 0) -> None:
        self.say(dialect.MAVLink_heartbeat_message(2, self.profile.autopilot, 1, mode, 3, 3))

    def names(self) -> list[str]:
        return [message.get_type() for message in self.heard]


def at(system_id: int, network: str = MAIN) -> VehicleAddress:
    return VehicleAddress(network, system_id)


def virtually(main: Callable[[], Awaitable[Result]]) -> Result:
    async def run() -> Result:
        return await main()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(run())


async def settle(seconds: float = 0.01) -> None:
    await asyncio.sleep(seconds)  # virtual seconds


def test_each_message_leaves_once_to_its_own_vehicle() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        fakes = [await Fake.start(system_id) for system_id in (1, 2, 3)]
        for fake in fakes:
            fake.beat()
        await settle()
        assert sorted(router.vehicles) == [at(1), at(2), at(3)]
        for system_id in (1, 2, 3):
            for _ in range(system_id):
                numbers = np.full((1, NUMBERS), float(system_id))
                routes = router.routes((at(system_id),))
                router.send_all(routes, SetpointRound([system_id], routes.senders).pack(numbers))
        router.send_message(at(2), commands.heartbeat())
        await settle()
        for system_id, fake in zip((1, 2, 3), fakes, strict=True):
            setpoints = [message for message in fake.heard if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
            assert [(m.target_system, m.x) for m in setpoints] == [(system_id, float(system_id))] * system_id
            assert [m.get_seq() for m in fake.heard] == list(range(len(fake.heard)))
        assert [len(fake.heard) for fake in fakes] == [1, 3, 3]
        assert router.counters.frames_out == 7
        router.close()

    virtually(main)


def test_a_vehicle_that_was_never_heard_costs_a_count() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        router.send_message(at(9), commands.heartbeat())
        assert (router.counters.unroutable, router.counters.frames_out) == (1, 0)
        with pytest.raises(KeyError):
            router.routes((at(9),))
        router.close()

    virtually(main)


def test_only_autopilots_become_vehicles() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        ground, fake = await Fake.start(255), await Fake.start(1)
        ground.say(commands.heartbeat())
        second = await Fake.start(254)
        second.say(commands.heartbeat())
        fake.say(
            dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0)
        )  # PX4 sends telemetry before its first heartbeat
        await settle()
        assert router.vehicles == {}
        fake.sender.component_id = 154
        camera = Sender(1, 154)
        fake.transport.sendto(camera.pack(dialect.MAVLink_heartbeat_message(30, 12, 0, 0, 3, 3)))
        await settle()
        assert router.vehicles == {}
        assert router.counters.frames_in == 4
        router.close()

    virtually(main)


def test_profile_phase_and_messages_are_handed_on() -> None:
    async def main() -> None:
        seen: list[tuple[int, str, float]] = []
        taps: list[tuple[Direction, bytes]] = []

        def on_frame(vehicle: Vehicle, message: Message, now_s: float) -> None:
            seen.append((vehicle.system_id, message.get_type(), now_s))

        def tap(direction: Direction, frames: Sequence[bytes] | Frames, _now_s: float) -> None:
            taps.extend((direction, bytes(frame)) for frame in frames)

        router = await Router.open({MAIN: [GROUND]}, on_frame=on_frame, tap=tap)
        copter, plane = await Fake.start(5, ARDUPILOT), await Fake.start(6, PX4)
        copter.beat(ARDUPILOT.streaming_mode)
        plane.beat()
        unknown = bytes([0xFD, 1, 0, 0, 0, 6, 1, 154, 1, 0, 7, 0, 0])
        plane.transport.sendto(unknown)
        await settle()
        beating = asyncio.create_task(router.keep_alive())
        await settle()
        beating.cancel()
        assert [vehicle.profile for vehicle in router.vehicles.values()] == [ARDUPILOT, PX4]
        assert router.vehicles[at(5)].mode_name == "GUIDED"
        assert seen == [(5, "HEARTBEAT", 0.001), (6, "HEARTBEAT", 0.001)]
        assert [direction for direction, _ in taps] == [Direction.IN] * 3 + [Direction.OUT] * 4
        assert taps[2][1] == unknown
        assert router.counters.unknown_messages == 1
        router.close()

    virtually(main)


def test_heartbeats_go_once_to_each_vehicle_and_wake_those_we_call() -> None:
    async def main() -> None:
        sleeping = await Fake.start(7, local=18570)
        router = await Router.open({MAIN: [GROUND, Endpoint(Kind.UDP_OUT, "127.0.0.1", 18570)]})
        waking = [await Fake.start(system_id) for system_id in (1, 2)]
        for fake in waking:
            fake.beat()
        stranger = await Fake.start(3)
        stranger.transport.sendto(b"no MAVLink at all")
        await settle()
        async with asyncio.TaskGroup() as tasks:
            beating = tasks.create_task(router.keep_alive())
            await settle(1.2)
            beating.cancel()
        assert [fake.names() for fake in waking] == [["TIMESYNC", "HEARTBEAT"] * 3] * 2
        assert sleeping.names() == ["HEARTBEAT"] * 3
        assert stranger.heard == []
        sleeping.beat()
        await settle()
        assert sorted(router.vehicles) == [at(1), at(2), at(7)]
        beating = asyncio.create_task(router.keep_alive())
        await settle()
        beating.cancel()
        assert sleeping.names()[3:] == ["TIMESYNC", "HEARTBEAT"]  # once, though it speaks now and is called as well
        router.close()

    virtually(main)


def test_many_heartbeats_hold_nobody_up() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        for system_id in range(1, 201):
            (await Fake.start(system_id)).beat()
        await settle()
        loop, between = asyncio.get_running_loop(), list[int]()

        def due() -> None:
            between.append(router.counters.frames_out)

        beating = asyncio.create_task(router.keep_alive())
        loop.call_at(loop.time(), due)
        await settle()
        beating.cancel()
        # Half of so many are asked for their time in the first period, and all get a heartbeat
        assert between[0] < 100 < router.counters.frames_out == 300
        router.close()

    virtually(main)


def test_silence_is_noticed_by_the_task() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        fake = await Fake.start(1)
        fake.beat()
        async with asyncio.TaskGroup() as tasks:
            beating = tasks.create_task(router.keep_alive())
            await settle(LOST_AFTER_S + 1.5)
            assert router.vehicles[at(1)].phase is Phase.LOST
            beating.cancel()
        router.close()

    virtually(main)


def test_two_vehicles_with_one_system_id_do_not_mix() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        first, second = await Fake.start(1, PX4), await Fake.start(1, PX4)
        first.beat(PX4.modes["LOITER"])
        await settle()
        for _ in range(3):
            second.beat(PX4.land_mode)
        await settle()
        assert router.vehicles[at(1)].mode == PX4.modes["LOITER"]
        router.send_message(at(1), commands.heartbeat())
        await settle()
        assert (len(first.heard), len(second.heard)) == (1, 0)
        assert router.counters.clashes == 3
        assert len(router.notices) == 1
        assert "system id 1" in router.notices[0]
        router.close()

    virtually(main)


def test_a_vehicle_that_restarts_on_another_port_is_found_again() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        before, after = await Fake.start(1), await Fake.start(1)
        before.beat()
        await settle(LOST_AFTER_S + 0.1)
        routes = router.routes((at(1),))
        assert router.routes((at(1),)) is routes
        after.say(dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0))
        await settle()
        assert router.counters.clashes == 1  # only a heartbeat claims a system id
        after.beat()
        await settle()
        router.send_message(at(1), commands.heartbeat())
        assert router.routes((at(1),)) is not routes
        router.send_all(router.routes((at(1),)), SetpointRound([1], [after.sender]).pack(np.ones((1, NUMBERS))))
        await settle()
        assert (len(before.heard), len(after.heard)) == (0, 2)
        router.close()

    virtually(main)


def test_a_taken_port_is_one_clear_line_and_leaves_nothing_open() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        other = Endpoint(Kind.UDP_IN, "127.0.0.1", PORT + 1)
        with pytest.raises(LinkError, match="port 14550 is in use: another ground station"):
            await Router.open({MAIN: [other, GROUND]})
        (await Router.open({MAIN: [other]})).close()
        router.close()

    virtually(main)


def test_hostile_datagrams_neither_raise_nor_disturb() -> None:
    async def main() -> None:
        draw = random.Random(7)
        router = await Router.open({MAIN: [GROUND]})
        honest, hostile = await Fake.start(1), await Fake.start(2)
        honest.beat(PX4.modes["LOITER"])
        frame = bytearray(honest.sender.pack(commands.heartbeat()))
        for _ in range(300):
            hostile.transport.sendto(draw.randbytes(draw.randrange(300)))
            damaged = bytearray(frame)
            damaged[draw.randrange(len(frame))] ^= 1 << draw.randrange(8)
            hostile.transport.sendto(bytes(damaged))
        await settle()
        honest.beat(PX4.land_mode)
        await settle()
        assert list(router.vehicles) == [at(1)]
        assert router.vehicles[at(1)].mode == PX4.land_mode
        assert router.counters.bad_bytes > 10_000
        router.close()

    virtually(main)


class Stranger(asyncio.DatagramProtocol):
    """A port that sends whatever it is told to."""

    transport: asyncio.DatagramTransport

    @classmethod
    async def start(cls) -> "Stranger":
        made = await asyncio.get_running_loop().create_datagram_endpoint(cls, remote_addr=("127.0.0.1", PORT))
        made[1].transport = made[0]
        return made[1]


GARBAGE = {
    "one byte": b"x",
    "false starts": b"\xfe\0" * 700,
    "text": b"nothing " * 150,
    "frames of no autopilot": Sender(77, 154).pack(dialect.MAVLink_heartbeat_message(30, 12, 0, 0, 3, 3)) * 50,
    "a broken heartbeat": b"\xfd\x09\0\0\0\x01\x01\0\0\0" + bytes(11),
}


@pytest.mark.parametrize("garbage", GARBAGE.values(), ids=GARBAGE)
def test_a_flood_of_strangers_locks_nobody_out_and_is_counted(garbage: bytes) -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        for number in range(3000):
            (await Stranger.start()).transport.sendto(garbage)
            if number % 10 == 0:
                await settle()
        late = await Fake.start(1)
        late.beat(PX4.modes["LOITER"])
        await settle()
        assert router.vehicles[at(1)].mode == PX4.modes["LOITER"]
        late.beat(PX4.land_mode)
        await settle()
        assert router.vehicles[at(1)].mode == PX4.land_mode
        counters = router.counters
        assert counters.refused > 0 or 3000 * len(garbage) < 64e3
        assert counters.bad_bytes + 21 * counters.frames_in <= 3000 * min(len(garbage), 34) + 64e3 + 32e3 * 4
        assert len(router.notices) == (counters.refused > 0)
        router.close()

    virtually(main)


def test_after_a_flood_strangers_are_read_again() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        stranger = await Stranger.start()
        for _ in range(100):
            stranger.transport.sendto(b"\xfe\0" * 700)
        await settle(5.0)
        refused = router.counters.refused
        assert refused > 0
        stranger.transport.sendto(b"hello" + Sender(9, 1).pack(dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 3, 3)))
        await settle()
        assert list(router.vehicles) == [at(9)]
        assert router.counters.refused == refused
        router.close()

    virtually(main)


def test_a_vehicle_that_sends_too_much_is_heard_no_more_than_it_may_and_holds_nobody_up() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        mad, sane = await Fake.start(1), await Fake.start(2)
        mad.beat()
        sane.beat()
        await settle()
        for _ in range(40):
            mad.transport.sendto(b"\xfe\0" * 32_000)
            sane.beat(PX4.land_mode)
        await settle()
        assert router.vehicles[at(2)].mode == PX4.land_mode
        counters = router.counters
        assert counters.refused == 32
        assert any("too much comes from vehicle 1 at" in line for line in router.notices)
        await settle(0.3)
        assert router.counters.bad_bytes == 512_000  # read in slices, to the end
        router.close()

    virtually(main)


def test_a_parameter_list_that_comes_at_once_is_heard_whole() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        fake = await Fake.start(1)
        fake.beat()
        await settle()
        for number in range(1350):
            fake.say(dialect.MAVLink_param_value_message(f"P{number}".encode(), 1.0, 9, 1350, number))
        await settle(0.1)
        assert len(router.vehicles[at(1)].params) == 1350
        assert router.counters.refused == 0
        router.close()

    virtually(main)


def test_when_only_some_count_others_are_strangers_and_still_vehicles() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        ours, foreign = await Fake.start(1), await Fake.start(2)
        for fake in (ours, foreign):
            fake.beat()
        await settle()
        router.count_only([at(1)])
        for _ in range(100):
            foreign.transport.sendto(b"\xfe\0" * 700)
            ours.transport.sendto(b"\xfe\0" * 70)
        for _ in range(2 * MOST_STRANGERS):
            (await Stranger.start()).transport.sendto(b"x")
        await settle()
        assert router.counters.refused > 50
        foreign.beat(PX4.land_mode)
        ours.beat(PX4.land_mode)
        await settle()
        assert [router.vehicles[at(system_id)].mode for system_id in (1, 2)] == [PX4.land_mode] * 2
        router.send_message(at(2), commands.heartbeat())
        await settle()
        assert len(foreign.heard) == 1
        assert router.doubled == {}
        router.close()

    virtually(main)


def test_two_that_are_alive_under_one_id_are_named_with_both_addresses() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        first, second = await Fake.start(1), await Fake.start(1)
        for _ in range(3):
            for fake in (first, second):
                fake.beat()
                await settle()
        (line,) = router.doubled.values()
        for fake in (first, second):
            host, port = fake.transport.get_extra_info("sockname")
            assert f"{host}:{port}" in line
        await settle(20.0)
        first.beat()
        await settle()
        assert router.doubled == {}  # the other one has gone
        router.close()

    virtually(main)


def test_one_that_comes_back_on_another_port_is_no_second_one() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        before, after = await Fake.start(1), await Fake.start(1)
        before.beat()
        for _ in range(10):
            await settle(1.0)
            after.beat()
        await settle()
        assert router.doubled == {}
        router.close()

    virtually(main)


def test_two_under_one_id_behind_one_address_are_named() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        fake, other = await Fake.start(1), Sender(1, 1)
        beating = asyncio.create_task(router.keep_alive())
        for k in range(150):
            fake.beat()
            fake.transport.sendto(other.pack(dialect.MAVLink_heartbeat_message(2, 12, 1, k, 3, 3)))
            await settle(0.04)
        beating.cancel()
        (line,) = router.doubled.values()
        assert "two vehicles have the system id 1, both at 127.0.0.1:" in line
        assert line in router.notices
        router.close()

    virtually(main)


def test_delay_and_loss_are_measured_through_the_sockets() -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [GROUND]})
        fake, asked = await Fake.start(1), 0
        beating = asyncio.create_task(router.keep_alive())
        for k in range(500):
            if k % 50 == 0:
                fake.beat()
            fake.say(dialect.MAVLink_local_position_ned_message(round(1e3 * (70.0 + k * 0.02)), 0, 0, 0, 0, 0, 0))
            questions = [message for message in fake.heard if message.get_type() == "TIMESYNC"]
            for question in questions[asked:]:
                now_s = asyncio.get_running_loop().time()
                fake.say(dialect.MAVLink_timesync_message(round(1e9 * (70.0 + now_s)), question.ts1))
            asked = len(questions)
            if k % 4 == 3:
                fake.sender.next_sequence()  # one of five is lost
            await settle(0.02)
        beating.cancel()
        quality = router.vehicles[at(1)].timing.quality
        assert quality.loss_in == pytest.approx(0.2, abs=0.03)
        assert quality.loss_out == pytest.approx(0.0, abs=0.2)
        assert quality.offset_s == pytest.approx(-70.0, abs=0.02)
        assert quality.delay_s < 0.03
        assert quality.unfit() is None
        router.close()

    virtually(main)


def test_the_same_system_id_in_two_networks_is_two_vehicles() -> None:
    async def main() -> None:
        seen: list[VehicleAddress] = []
        endpoints = {"west": [GROUND], "east": [Endpoint(Kind.UDP_IN, "127.0.0.1", PORT + 1)]}
        router = await Router.open(endpoints, on_frame=lambda vehicle, _message, _now_s: seen.append(vehicle.address))
        west, east = await Fake.start(7, PX4), await Fake.start(7, ARDUPILOT)
        west.beat(PX4.modes["LOITER"])
        await settle()
        loop = asyncio.get_running_loop()
        east.transport, _ = await loop.create_datagram_endpoint(lambda: east, remote_addr=("127.0.0.1", PORT + 1))
        for _ in range(2):
            east.beat(ARDUPILOT.land_mode)
        await settle()
        assert seen == [at(7, "west"), at(7, "east"), at(7, "east")]
        assert router.vehicles[at(7, "west")].mode == PX4.modes["LOITER"]
        assert router.vehicles[at(7, "east")].mode == ARDUPILOT.land_mode
        assert router.counters.clashes == 0
        for _ in range(3):
            router.send_message(at(7, "east"), commands.heartbeat())
        router.send_message(at(7, "west"), commands.heartbeat())
        router.send_message(at(7), commands.heartbeat())
        await settle()
        assert [message.get_seq() for message in west.heard] == [0]
        assert [message.get_seq() for message in east.heard] == [0, 1, 2]
        assert router.counters.unroutable == 1
        router.close()

    virtually(main)


def test_two_vehicles_with_one_id_in_one_of_several_networks_are_told_with_its_name() -> None:
    async def main() -> None:
        router = await Router.open({"west": [GROUND], "east": []})
        for _ in range(2):
            (await Fake.start(7)).beat()
            await settle()
        assert router.counters.clashes == 1
        assert "two vehicles have the system id west/7" in router.notices[0]
        router.close()

    virtually(main)
