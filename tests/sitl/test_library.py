"""The simulator as a library: beside another client, on any event loop, by that loop's clock."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

import sitl_mock
from fg_gcs.link.clock import VirtualTimeLoop
from sitl_mock import PortUnavailable, Simulator, SimulatorOptions, TargetOptions, grid

HOST = "127.0.0.1"


class Client(asyncio.DatagramProtocol):
    """Another client: notes which vehicles it receives heartbeats of."""

    def __init__(self, vehicles: int) -> None:
        self._vehicles = vehicles
        self.systems: set[int] = set()
        self.complete = asyncio.Event()

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        for message in dialect.MAVLink(None).parse_buffer(data) or []:
            if message.get_type() == "HEARTBEAT":
                self.systems.add(message.get_srcSystem())
        if len(self.systems) == self._vehicles:
            self.complete.set()


async def meet_ten(port: int) -> float:
    """Ten vehicles beside a client on the running loop; how long it took by the loop's clock [s]."""
    loop = asyncio.get_running_loop()
    transport, client = await loop.create_datagram_endpoint(lambda: Client(10), local_addr=(HOST, port))
    remote = (HOST, transport.get_extra_info("sockname")[1])
    start_s = loop.time()
    try:
        async with Simulator(SimulatorOptions(pads_enu_m=grid(10), remotes=(remote,))) as simulator:
            async with asyncio.timeout(20.0):  # 0.2 s of boot; the rest is for a machine that is busy
                await client.complete.wait()
            assert simulator.positions_enu_m.shape == (10, 3)
            assert len(set(simulator.ports)) == 10
        assert client.systems == set(range(1, 11))
        return loop.time() - start_s
    finally:
        transport.close()


def test_ten_vehicles_beside_another_client_on_real_sockets() -> None:
    asyncio.run(meet_ten(port=0))


def test_ten_vehicles_in_virtual_time() -> None:
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        assert runner.run(meet_ten(port=14550)) == pytest.approx(0.2, abs=0.02)  # the heartbeat of a quick boot


def test_ports_are_free_again_after_the_context_and_closing_twice_does_no_harm() -> None:
    async def run() -> None:
        async with Simulator(SimulatorOptions()) as simulator:
            (port,) = simulator.ports
        await simulator.close()
        async with Simulator(SimulatorOptions(port_base=port)) as again:
            assert again.ports == (port,)
            with pytest.raises(PortUnavailable, match=rf"port {port} on 127\.0\.0\.1 cannot be used: .*in use"):
                await Simulator(SimulatorOptions(port_base=port)).start()

    asyncio.run(run())


def test_a_simulator_starts_once() -> None:
    async def run() -> None:
        simulator = Simulator(SimulatorOptions())
        async with simulator:
            with pytest.raises(RuntimeError, match="started only once"):
                await simulator.start()

    asyncio.run(run())


def test_a_datagram_before_the_start_of_time_does_not_move_time() -> None:
    """A vehicle's first socket may be spoken to while the others are still being bound."""

    async def run() -> None:
        simulator = Simulator(SimulatorOptions(pads_enu_m=grid(2)))
        simulator.receive(0, 0, b"noise")
        async with simulator:
            simulator.receive(0, 0, b"noise")
        assert simulator.counters.slipped_s == 0.0
        assert simulator.counters.bad_bytes == 10

    with asyncio.Runner(loop_factory=lambda: Late(1e5)) as runner:
        runner.run(run())


class Late(asyncio.SelectorEventLoop):
    """A loop whose clock began long ago."""

    def __init__(self, start_s: float) -> None:
        self._start_s = start_s
        super().__init__()

    def time(self) -> float:
        return super().time() + self._start_s


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: SimulatorOptions(autopilot="paparazzi"), "'paparazzi' is not one of: ardupilot, px4"),
        (lambda: SimulatorOptions(pads_enu_m=grid(3), system_ids=(1, 2)), r"ids \(2\) is not .* vehicles \(3\)"),
        (lambda: SimulatorOptions(pads_enu_m=grid(2), system_ids=(7, 7)), "system id 7 belongs to 2 vehicles"),
        (lambda: SimulatorOptions(system_ids=(256,)), "no system id 256"),
        (lambda: SimulatorOptions(targets=(TargetOptions(1, "static"),)), "system id 1 belongs to 2 vehicles"),
        (lambda: SimulatorOptions(pads_enu_m=grid(256)), "no system id 256"),
        (lambda: SimulatorOptions(speed=0.0), "speed must be greater than 0"),
        (lambda: SimulatorOptions(speed=float("nan")), "speed must be greater than 0"),
        (lambda: SimulatorOptions(wind_m_s=-1.0), "wind must not be negative"),
        (lambda: SimulatorOptions(remotes=()), "at least one remote"),
    ],
)
def test_options_that_mean_nothing_are_refused_in_one_line(make: Callable[[], SimulatorOptions], said: str) -> None:
    with pytest.raises(ValueError, match=f"^[^\n]*{said}[^\n]*$"):
        make()


def test_system_ids_count_from_one_by_default() -> None:
    assert SimulatorOptions(pads_enu_m=grid(4)).system_ids == (1, 2, 3, 4)


def test_pads_of_a_grid_are_as_far_apart_as_asked() -> None:
    assert grid(0) == ()
    assert grid(5, 2.0) == ((0.0, 0.0), (2.0, 0.0), (4.0, 0.0), (0.0, 2.0), (2.0, 2.0))


def test_public_names_exist_and_importing_the_package_imports_neither_numpy_nor_pymavlink() -> None:
    for name in sitl_mock.__all__:
        assert getattr(sitl_mock, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        _ = sitl_mock.Nothing
    code = "import sys, sitl_mock, sitl_mock.__main__; sys.exit(any(m in sys.modules for m in ('numpy', 'pymavlink')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_simulator_uses_no_event_loop_of_ours() -> None:
    code = "import sys, sitl_mock; sitl_mock.Simulator; sys.exit(any(m.startswith('fg_gcs') for m in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_port_of_a_process_in_use_is_one_clear_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind((HOST, 0))
        port = taken.getsockname()[1]
        command = [sys.executable, "-m", "sitl_mock", "--port-base", str(port)]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 3
    assert run.stderr.splitlines() == [
        f"sitl_mock: port {port} on 127.0.0.1 cannot be used: Address already in use; "
        "choose another port base (0: any free ports)"
    ]


@pytest.mark.parametrize(
    "options",
    [{"seed": -1}, {"seed": 1.5}, {"pads_enu_m": ((float("nan"), 0.0),)}, {"origin_deg_m": (91.0, 0.0, 0.0)}],
    ids=str,
)
def test_options_that_mean_nothing_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"seed|pads|origin"):
        SimulatorOptions(**options)


@pytest.mark.parametrize("place", ["", "/nowhere/at/all.json"])
def test_a_truth_that_cannot_be_written_is_told_at_once(place: str) -> None:
    command = [sys.executable, "-m", "sitl_mock", "--vehicles", "1", "--port-base", "0", "--truth", place]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
    assert run.returncode == 2
    assert len(run.stderr.splitlines()) == 1
    assert "--truth" in run.stderr
