"""Starts the built-in simulator for a flight, and another one for target vehicles.

In real time each is a process of its own, in virtual time a part of the loop.
"""

from __future__ import annotations

import asyncio
import json
import math
import selectors
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, AsyncExitStack, asynccontextmanager, contextmanager
from pathlib import Path
from typing import IO, Any

from fg_gcs.errors import LinkError
from fg_gcs.link.clock import speed_of
from fg_gcs.mission.model import Mission
from fg_gcs.mission.target_tables import VehicleSource

READY_S = 20.0  # it needs one second; the rest is for a machine that is busy with other things
STOP_S = 5.0  # to close its sockets after its input has ended


def free_port() -> int:
    """Return a UDP port of the loopback that is not in use now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@asynccontextmanager
async def simulated(
    mission: Mission, autopilot: str | None, port: int, targets_port: int, folder: Path
) -> AsyncIterator[None]:
    """Run all that a mission has simulated: its vehicles, and its target vehicles.

    In virtual time they share the running loop; otherwise each is a process of its own, as fast as the loop's time.

    Args:
        mission: whose.
        autopilot: which one the vehicles play, ``px4`` or ``ardupilot``; None: they are real.
        port: of the loopback, where the vehicles come.
        targets_port: likewise, of the target vehicles.
        folder: the processes' own words go here.

    Raises:
        LinkError: a simulator did not start; says why.
    """
    speed = speed_of(asyncio.get_running_loop())
    async with AsyncExitStack() as stack:
        if math.isinf(speed):
            if autopilot is not None:
                await stack.enter_async_context(simulator_in_loop(mission, autopilot, port))
            await stack.enter_async_context(targets_in_loop(mission, targets_port))
        else:
            if autopilot is not None:
                log = folder / "simulator.log"
                await _beside(stack, simulator_process(mission, autopilot, port, speed, log))
            await _beside(stack, targets_process(mission, targets_port, speed, folder / "targets.log"))
        yield


async def _beside(stack: AsyncExitStack, process: AbstractContextManager[None]) -> None:
    """Enter a context of the stack whose beginning and end take a while, without holding the loop up."""
    await asyncio.to_thread(process.__enter__)

    async def leave(*error: Any) -> None:  # noqa: ANN401 - what any context manager is told
        await asyncio.to_thread(process.__exit__, *error)

    stack.push_async_exit(leave)


@contextmanager
def simulator_process(mission: Mission, autopilot: str, port: int, speed: float, log: Path) -> Iterator[None]:
    """Run the simulator beside us; it ends with this context, or with our process, whatever ends that.

    It has a session of its own: a Ctrl-C in the terminal is for the ground station, which still needs the vehicles.

    Raises:
        LinkError: it did not start; says why.
    """
    with _process(_arguments(mission, autopilot, port, speed), log):
        yield


@contextmanager
def targets_process(mission: Mission, port: int, speed: float, log: Path) -> Iterator[None]:
    """Run the mission's simulated target vehicles beside us, likewise; nothing if it has none.

    Args:
        mission: whose targets; they move from now on.
        port: of the loopback, where they come.
        speed: of their time.
        log: what they say goes here.

    Raises:
        LinkError: it did not start; says why.
    """
    targets = _targets(mission)
    if not targets:
        yield
        return
    options = {**_common(mission, port, speed), "vehicles": 0}
    with _process([*_options(options), *(f"--target={json.dumps(target)}" for target in targets)], log):
        yield


@contextmanager
def _process(arguments: Sequence[str], log: Path) -> Iterator[None]:
    """Run a simulator of its own.

    Raises:
        LinkError: it did not start; says why.
    """
    command = [sys.executable, "-m", "sitl_mock", "--with-parent", *arguments]
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
    from sitl_mock.host.server import Simulator, SimulatorOptions

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


@asynccontextmanager
async def targets_in_loop(mission: Mission, port: int) -> AsyncIterator[None]:
    """Run the mission's simulated target vehicles on the running event loop; nothing if it has none."""
    from sitl_mock.host.server import Simulator, SimulatorOptions
    from sitl_mock.host.targets import parse_target

    targets = tuple(parse_target(json.dumps(target)) for target in _targets(mission))
    if not targets:
        yield
        return
    simulator = Simulator(
        SimulatorOptions(
            pads_enu_m=(),
            system_ids=(),
            remotes=(("127.0.0.1", port),),
            origin_deg_m=(*mission.origin_geodetic(),),
            targets=targets,
        )
    )
    await simulator.start()
    try:
        yield
    finally:
        await simulator.close()


def _targets(mission: Mission) -> list[dict[str, object]]:
    """The simulated target vehicles in the simulator's words; both call the keys of motions the same."""
    found = []
    for target in mission.targets or ():
        source = target.source
        if isinstance(source, VehicleSource) and source.simulated and target.motion is not None:
            own = {
                "system_id": source.system_id,
                "rate_hz": target.sensor.rate_hz,
                "follow_target": source.message == "FOLLOW_TARGET",
            }
            found.append(own | target.motion.model_dump(mode="json"))
    return found


def _arguments(mission: Mission, autopilot: str, port: int, speed: float) -> list[str]:
    pads = " ".join(f"{x:.6f},{y:.6f}" for x, y in mission.pads_enu_m())
    values = {
        **_common(mission, port, speed),
        "vehicles": mission.swarm.vehicles,
        "autopilot": autopilot,
        "pads": pads,
        "system-ids": ",".join(str(system_id) for system_id in mission.swarm.ids()),
        "seed": mission.simulator.seed,
        "wind": mission.simulator.wind_m_s,
    }
    return _options(values)


def _common(mission: Mission, port: int, speed: float) -> dict[str, object]:
    return {
        "remote": f"127.0.0.1:{port}",
        "port-base": 0,
        "origin": ",".join(repr(float(number)) for number in mission.origin_geodetic()),
        "speed": speed,
    }


def _options(values: Mapping[str, object]) -> list[str]:
    return [f"--{name}={value}" for name, value in values.items()]


def _first_line(stream: IO[bytes], timeout_s: float) -> bytes:
    """Return the first line of a pipe; empty when it ends or says nothing in time."""
    deadline_s = time.monotonic() + timeout_s
    with selectors.DefaultSelector() as selector:
        selector.register(stream, selectors.EVENT_READ)
        return stream.readline() if selector.select(max(0.0, deadline_s - time.monotonic())) else b""
