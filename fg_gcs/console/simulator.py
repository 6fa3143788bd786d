"""Starts the built-in simulator for a flight: a process of its own in real time, a part of the loop in virtual time."""

from __future__ import annotations

import selectors
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import IO

from fg_gcs.errors import LinkError
from fg_gcs.mission.model import Mission

READY_S = 20.0  # it needs one second; the rest is for a machine that is busy with other things
STOP_S = 5.0  # to close its sockets after its input has ended


def free_port() -> int:
    """Return a UDP port of the loopback that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@contextmanager
def simulator_process(mission: Mission, autopilot: str, port: int, speed: float, log: Path) -> Iterator[None]:
    """Run the simulator beside us; it ends with this context, or with our process, whatever ends that.

    It has a session of its own: a Ctrl-C in the terminal is for the ground station, which still needs the vehicles.

    Raises:
        LinkError: it did not start; says why.
    """
    command = [sys.executable, "-m", "sitl_mock", "--with-parent", *_arguments(mission, autopilot, port, speed)]
    with log.open("w") as errors:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, start_new_session=True
        )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        if not _first_line(process.stdout, READY_S).startswith(b"ready"):
            said = log.read_text().strip().splitlines()
            raise LinkError(f"the simulator did not start: {said[-1] if said else 'it said nothing'}")
        yield
    finally:
        process.stdin.close()
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()


@asynccontextmanager
async def simulator_in_loop(mission: Mission, autopilot: str, port: int) -> AsyncIterator[None]:
    """Run the simulator on the running event loop: in virtual time both share one clock and one thread."""
    from sitl_mock.server import Simulator, SimulatorOptions

    simulator = Simulator(
        SimulatorOptions(
            autopilot=autopilot,
            pads_enu_m=tuple((x, y) for x, y in mission.pads_enu_m().tolist()),
            system_ids=mission.swarm.ids(),
            remotes=(("127.0.0.1", port),),
            port_base=0,
            origin_deg_m=(*mission.origin_geodetic(),),
            seed=mission.simulator.seed,
            wind_m_s=mission.simulator.wind_m_s,
        )
    )
    await simulator.start()
    try:
        yield
    finally:
        await simulator.close()


def _arguments(mission: Mission, autopilot: str, port: int, speed: float) -> list[str]:
    pads = " ".join(f"{x:.6f},{y:.6f}" for x, y in mission.pads_enu_m())
    values: dict[str, object] = {
        "vehicles": mission.swarm.vehicles,
        "autopilot": autopilot,
        "remote": f"127.0.0.1:{port}",
        "port-base": 0,
        "pads": pads,
        "origin": ",".join(repr(float(number)) for number in mission.origin_geodetic()),
        "system-ids": ",".join(str(system_id) for system_id in mission.swarm.ids()),
        "seed": mission.simulator.seed,
        "speed": speed,
        "wind": mission.simulator.wind_m_s,
    }
    return [f"--{name}={value}" for name, value in values.items()]


def _first_line(stream: IO[bytes], timeout_s: float) -> bytes:
    """Return the first line of a pipe; empty when it ends or says nothing in time."""
    deadline_s = time.monotonic() + timeout_s
    with selectors.DefaultSelector() as selector:
        selector.register(stream, selectors.EVENT_READ)
        return stream.readline() if selector.select(max(0.0, deadline_s - time.monotonic())) else b""
