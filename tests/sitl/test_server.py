"""The simulator on (virtual) sockets: determinism, partners, hostile bytes, ports in use, the command line."""

from __future__ import annotations

import asyncio
import itertools
import random
import signal
import socket
import subprocess
import sys
from collections.abc import Awaitable, Callable
from typing import Any, cast

import pytest
from fastcrc import crc16
from pymavlink.dialects.v20 import all as dialect

from sitl_mock import profiles
from sitl_mock.host.fleet import grid
from sitl_mock.host.server import Counters, PortUnavailable, Simulator, SimulatorOptions
from tests.sitl.process import free_udp_port, simulator

Address = tuple[str, int]
STATION: Address = ("127.0.0.1", 14550)
STRANGER: Address = ("127.0.0.1", 40000)


class Wire(asyncio.DatagramTransport):
    """A socket that only remembers."""

    def __init__(self, loop: VirtualLoop, address: Address) -> None:
        super().__init__({"sockname": address})
        self._loop, self._address = loop, address

    def sendto(self, data: Any, addr: Any = None) -> None:  # noqa: ANN401  # as wide as the base class
        self._loop.sent.append((self._loop.time(), self._address, cast(Address, addr), bytes(data)))

    def is_closing(self) -> bool:
        return False

    def close(self) -> None:
        self._loop.protocols.pop(self._address, None)


class VirtualLoop(asyncio.SelectorEventLoop):
    """Time jumps to the next timer; sockets live in memory."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0
        self.sent: list[tuple[float, Address, Address, bytes]] = []
        self.protocols: dict[Address, asyncio.DatagramProtocol] = {}

    def time(self) -> float:
        return self.now_s

    def run_until_s(self, end_s: float) -> None:
        """Let virtual time pass by small fixed steps, each with all that is due."""
        while self.now_s < end_s:
            self.now_s = round(self.now_s + 0.001, 6)
            self.run_until_complete(asyncio.sleep(0))

    async def create_datagram_endpoint(  # type: ignore[override]  # the few arguments that the simulator uses
        self, factory: Callable[[], asyncio.DatagramProtocol], local_addr: Address
    ) -> tuple[Wire, asyncio.DatagramProtocol]:
        free = (port for port in itertools.count(50000) if (local_addr[0], port) not in self.protocols)
        port = local_addr[1] or next(free)
        if (local_addr[0], port) in self.protocols:
            raise OSError(98, "Address already in use")
        wire, protocol = Wire(self, (local_addr[0], port)), factory()
        self.protocols[local_addr[0], port] = protocol
        protocol.connection_made(wire)
        return wire, protocol


def options(autopilot: str, vehicles: int = 2, **more: Any) -> SimulatorOptions:  # noqa: ANN401  # any of its fields
    return SimulatorOptions(autopilot, grid(vehicles, 3.0), tuple(range(1, vehicles + 1)), **more)


def frame(message: Any, sequence: int = 0) -> bytes:  # noqa: ANN401  # pymavlink has no types
    mav = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    mav.seq = sequence
    return bytes(message.pack(mav))


def fly(autopilot: str, seed: int, speed: float = 1.0) -> list[tuple[float, Address, Address, bytes]]:
    """Five seconds of commands and setpoints in wind; all datagrams."""
    loop = VirtualLoop()
    try:
        sim = Simulator(options(autopilot, seed=seed, wind_m_s=4.0, speed=speed, port_base=18570))
        loop.run_until_complete(sim.start())
        vehicle = loop.protocols["127.0.0.1", 18570]
        mode = 6 if autopilot == "px4" else 4
        setpoint = dialect.MAVLink_set_position_target_local_ned_message
        for k in range(50):
            loop.run_until_s(2.0 + 0.1 * k)
            vehicle.datagram_received(frame(setpoint(0, 1, 1, 1, 0x9F8, 1, 2, -3, 0, 0, 0, 0, 0, 0, 0, 0)), STATION)
            if k == 0:
                for command in ((511, 32, 2e4), (176, 1, mode), (400, 1, 0)):
                    long = dialect.MAVLink_command_long_message(1, 1, command[0], 0, *command[1:], 0, 0, 0, 0, 0)
                    vehicle.datagram_received(frame(long), STATION)
        loop.run_until_complete(sim.close())
        assert not loop.protocols
        return loop.sent
    finally:
        loop.close()


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_same_seed_same_bytes(autopilot: str) -> None:
    flight = fly(autopilot, seed=1)
    assert flight == fly(autopilot, seed=1)
    assert len(flight) > 100


def test_other_seed_other_bytes() -> None:
    assert fly("px4", seed=1) != fly("px4", seed=2)


def test_speed_scales_time() -> None:
    def heartbeats(speed: float) -> int:
        return sum(data[7:10] == b"\0\0\0" and source[1] == 18570 for _, source, _, data in fly("px4", 1, speed))

    assert heartbeats(4.0) == pytest.approx(4 * heartbeats(1.0), abs=4)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_partner(autopilot: str) -> None:
    """PX4 talks to its first sender for good; ArduPilot never hears anybody but its remote."""
    loop = VirtualLoop()
    sim = Simulator(options(autopilot, vehicles=1, port_base=18570))
    loop.run_until_complete(sim.start())
    loop.run_until_s(2.0)
    assert {to for *_, to, _ in loop.sent} == {STATION}
    vehicle = loop.protocols["127.0.0.1", 18570]
    arm = frame(dialect.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    vehicle.datagram_received(arm, STRANGER)
    vehicle.datagram_received(arm, STATION)
    loop.sent.clear()
    loop.run_until_s(4.0)
    assert {to for *_, to, _ in loop.sent} == {STRANGER if autopilot == "px4" else STATION}
    assert sim.armed.tolist() == [True]
    assert sim.counters.dropped == (0 if autopilot == "px4" else 1)
    loop.run_until_complete(sim.close())
    loop.close()


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_hostile_bytes_are_dropped_and_counted(autopilot: str) -> None:
    """300 random buffers and 300 good frames with flipped bits; then everything still works."""
    generator = random.Random(5)
    loop = VirtualLoop()
    sim = Simulator(options(autopilot, vehicles=1, port_base=18570))
    loop.run_until_complete(sim.start())
    vehicle = loop.protocols["127.0.0.1", 18570]
    good = frame(dialect.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    for k in range(300):
        loop.run_until_s(0.01 * k)
        vehicle.datagram_received(generator.randbytes(generator.randrange(300)), STATION)
        flipped = bytearray(good)
        flipped[generator.randrange(len(flipped))] ^= 1 << generator.randrange(8)
        vehicle.datagram_received(bytes(flipped), STATION)
    assert sim.counters.bad_bytes > 10_000
    if autopilot == "ardupilot":
        set_guided = dialect.MAVLink_command_long_message(1, 1, 176, 0, 1, 4, 0, 0, 0, 0, 0)
        vehicle.datagram_received(frame(set_guided), STATION)
    vehicle.datagram_received(good, STATION)
    assert sim.armed.tolist() == [True]
    loop.run_until_complete(sim.close())
    loop.close()


def test_every_message_with_wild_fields_is_survived() -> None:
    """Well-formed frames of every kind the vehicles listen to, with any numbers in them."""
    generator = random.Random(6)
    loop = VirtualLoop()
    for autopilot in ("px4", "ardupilot"):
        sim = Simulator(options(autopilot, vehicles=1, port_base=18570))
        known = {*profiles.strategy(autopilot).dialect.messages, "COMMAND_LONG", "COMMAND_INT"}
        loop.run_until_complete(sim.start())
        loop.run_until_s(loop.now_s + 2.0)
        vehicle = loop.protocols["127.0.0.1", 18570]
        for kind in dialect.mavlink_map.values():
            if kind.msgname not in known:
                continue
            for _ in range(40):
                length = kind.unpacker.size
                # Zeros often mean something ("no", "all", "answer me"): half of the bytes are.
                payload = bytearray(b if generator.random() < 0.5 else 0 for b in generator.randbytes(length))
                if "target_system" in kind.fieldnames:
                    offset = kind.ordered_fieldnames.index("target_system")
                    payload[sum(kind.lengths[i] * _size(kind, i) for i in range(offset))] = 1
                vehicle.datagram_received(_framed(kind, bytes(payload)), STATION)
                loop.run_until_s(loop.now_s + 0.02)
        loop.run_until_complete(sim.close())
    loop.close()


def _size(kind: Any, index: int) -> int:  # noqa: ANN401  # pymavlink has no types
    code = [c for c in kind.native_format.decode() if c.isalpha()][index]
    return {"b": 1, "B": 1, "c": 1, "h": 2, "H": 2, "i": 4, "I": 4, "f": 4, "q": 8, "Q": 8, "d": 8}[code]


def _framed(kind: Any, payload: bytes) -> bytes:  # noqa: ANN401  # pymavlink has no types
    body = bytes((len(payload), 0, 0, 0, 255, 190)) + int(kind.id).to_bytes(3, "little") + payload
    crc = crc16.mcrf4xx(body + bytes((kind.crc_extra,)))
    return b"\xfd" + body + crc.to_bytes(2, "little")


def test_two_remotes_are_two_links() -> None:
    loop = VirtualLoop()
    remotes = (STATION, ("127.0.0.1", 14540))
    sim = Simulator(options("px4", remotes=remotes, port_base=18570))
    loop.run_until_complete(sim.start())
    assert sorted(port for _, port in loop.protocols) == [14580, 14581, 18570, 18571]
    loop.run_until_s(2.0)
    assert {(source[1], to) for _, source, to, _ in loop.sent} == {
        (18570, STATION),
        (18571, STATION),
        (14580, remotes[1]),
        (14581, remotes[1]),
    }
    loop.run_until_complete(sim.close())
    loop.close()


def test_long_stall_slips_instead_of_racing() -> None:
    loop = VirtualLoop()
    sim = Simulator(options("px4", vehicles=1, port_base=18570))
    loop.run_until_complete(sim.start())
    loop.run_until_s(1.0)
    loop.now_s += 30.0
    loop.run_until_s(loop.now_s + 0.1)
    assert sim.fleet.time_s == pytest.approx(1.6, abs=0.05)  # 0.5 s are made up
    assert sim.counters.slipped_s == pytest.approx(29.5, abs=0.05)
    loop.run_until_complete(sim.close())
    loop.close()


def test_ticks_are_as_late_as_the_loop_and_left_out_ones_are_counted() -> None:
    loop = VirtualLoop()
    sim = Simulator(options("px4", vehicles=1, port_base=18570))
    loop.run_until_complete(sim.start())
    loop.run_until_s(1.0)
    assert sim.lateness.left_out == 0
    assert sim.lateness.worst_s == pytest.approx(0.0, abs=1e-3)
    loop.now_s += 0.055
    loop.run_until_s(loop.now_s + 0.1)
    assert sim.lateness.left_out == 4  # of 1.01 to 1.05 s all but the first, which begins late
    assert sim.lateness.worst_s == pytest.approx(0.046, abs=1e-3)
    assert sim.lateness.ticks == 115
    loop.run_until_complete(sim.close())
    loop.close()


def test_any_port_is_none_of_those_that_others_are_heard_at() -> None:
    loop = VirtualLoop()
    remotes = (("127.0.0.1", 50001), ("127.0.0.1", 50002))
    sim = Simulator(options("px4", remotes=remotes))
    loop.run_until_complete(sim.start())
    assert len(loop.protocols) == 4
    assert not set(remotes) & set(loop.protocols)
    loop.run_until_complete(sim.close())
    loop.close()


def on_real_sockets(run: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(cast(Any, run()))


def test_port_in_use_leaves_nothing_open() -> None:
    async def start() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", 0))
            port = taken.getsockname()[1]
            sim = Simulator(options("px4", port_base=port - 1))
            with pytest.raises(PortUnavailable, match=str(port)):
                await sim.start()
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as freed:
                freed.bind(("127.0.0.1", port - 1))

    on_real_sockets(start)


def test_truth_is_readable() -> None:
    async def look() -> None:
        sim = Simulator(options("px4", vehicles=3))
        await sim.start()
        assert len(set(sim.ports)) == 3
        assert sim.positions_enu_m.tolist() == [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]]
        assert sim.velocities_enu_m_s.tolist() == [[0.0, 0.0, 0.0]] * 3
        assert sim.armed.tolist() == [False] * 3
        assert sim.counters == Counters(0, 0, 0, 0, 0.0)
        await sim.close()

    on_real_sockets(look)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--vehicles", "0"], "nothing to simulate"),
        (
            [
                "--vehicles",
                "0",
                "--lockstep",
                "--target",
                '{"system_id": 9, "kind": "static", "position_enu_m": [0, 0, 9]}',
            ],
            "in lockstep there must be at least one vehicle",
        ),
        (["--vehicles", "2", "--pads", "0,0"], "the number of pads (1) is not the number of vehicles (2)"),
        (["--system-ids", "1,1", "--vehicles", "2"], "system id 1 belongs to 2 vehicles"),
        (
            ["--system-ids", "1,2,3", "--vehicles", "2"],
            "the number of system ids (3) is not the number of vehicles (2)",
        ),
        (["--remote", "8.8.8.8:14550"], "127.0.0.1:PORT only"),
        (["--origin", "1,2"], "LAT,LON,ALT"),
        (["--speed", "nan"], "not a number"),
        (["--autopilot", "paparazzi"], "invalid choice"),
    ],
)
def test_bad_options_are_one_clear_line_and_exit_2(arguments: list[str], words: str) -> None:
    run = subprocess.run([sys.executable, "-m", "sitl_mock", *arguments], capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert words in run.stderr.splitlines()[-1]


def test_terminated_process_ends_well() -> None:
    port = free_udp_port()
    command = [sys.executable, "-m", "sitl_mock", "--autopilot", "ardupilot", "--remote", f"127.0.0.1:{port}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready vehicles=1 autopilot=ardupilot ports=")
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == 0  # 10 s: milliseconds on any machine that is not standing still


def test_mavutil_connects() -> None:
    """pymavlink's own client: waits for a heartbeat, reads a parameter."""
    mavutil = pytest.importorskip("pymavlink.mavutil")
    port = free_udp_port()
    with simulator("--remote", f"127.0.0.1:{port}", "--system-ids", "7"):
        link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=255)
        try:
            assert link.wait_heartbeat(timeout=10) is not None
            assert (link.target_system, link.flightmode) == (7, "LOITER")
            link.param_fetch_one("MPC_XY_VEL_MAX")
            assert link.recv_match(type="PARAM_VALUE", blocking=True, timeout=10).param_value == 12.0
        finally:
            link.close()
