"""Starts the built-in simulator for a flight, and another one for target vehicles.

In real time each is a process of its own, in virtual time a part of the loop. What goes wrong in them on purpose is
theirs to understand: `check_simulator` asks them before a flight begins.
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
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, AsyncExitStack, asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any, TypeVar

from fg_gcs.errors import LinkError, MissionError
from fg_gcs.link.clock import speed_of
from fg_gcs.mission.model import Mission
from fg_gcs.mission.target_tables import VehicleSource
from sitl_mock import Simulator as Simulator
from sitl_mock import SimulatorOptions, parse_fault, parse_impairment, parse_target, read_key
from sitl_mock.autopilot.profile import Manners

VIRTUAL_EPOCH_S = 1_700_000_000.0  # in virtual time there is no now; a fixed one keeps a run's files the same
READY_S = 20.0  # it needs one second; the rest is for a machine that is busy with other things
STOP_S = 5.0  # to close its sockets after its input has ended
TRUTH = "simulated.json"  # in the run's folder: what vehicles truly hit, and how close they came
OPTIONS = {"faults": "--fault", "impairments": "--impair"}
NOTHING: dict[str, Any] = {"faults": (), "impairments": ()}
MANNERS = ("strict_commands", "new_partner", "parameter_freeze")  # keys of [simulator] that the simulator calls alike


@dataclass(frozen=True)
class SimulatorWish:
    """How simulated vehicles are, as a mission and the options of a flight say together.

    Attributes:
        autopilot: which one they play.
        dynamics: how they fly.
        faults: tables of what goes wrong inside them, as the simulator reads them.
        impairments: likewise, on their links.
        signing_key: the file of the key that they have; None: they have none.
    """

    autopilot: str
    dynamics: str
    faults: tuple[Mapping[str, object], ...] = ()
    impairments: tuple[Mapping[str, object], ...] = ()
    signing_key: Path | None = None


def wish_of(
    mission: Mission,
    autopilot: str | None = None,
    dynamics: str | None = None,
    faults: Sequence[Mapping[str, object]] = (),
    impairments: Sequence[Mapping[str, object]] = (),
) -> SimulatorWish:
    """Return how a mission's simulated vehicles are, with what is given in place of, or beside, what it says itself."""
    tables = mission.simulator
    return SimulatorWish(
        autopilot or tables.autopilot,
        dynamics or tables.dynamics,
        (*tables.faults, *faults),
        (*tables.impairments, *impairments),
    )


def check_simulator(mission: Mission, wanted: SimulatorWish) -> None:
    """Let the simulator read everything that it will be asked for.

    Raises:
        MissionError: it cannot be; says which table is at fault, and how.
    """
    tables = mission.simulator
    for name, parse, own, all_tables in (
        ("faults", parse_fault, tables.faults, wanted.faults),
        ("impairments", parse_impairment, tables.impairments, wanted.impairments),
    ):
        for number, table in enumerate(all_tables, start=1):
            more = number - len(own)
            where = f"{mission.path}: [[simulator.{name}]] {number}" if more <= 0 else f"{OPTIONS[name]} {more}"
            try:
                parse(table)
                options_of(mission, replace(wanted, **{**NOTHING, name: (table,)}), 0, None)
            except ValueError as error:
                raise MissionError(f"{where}: {error}") from error
    try:
        options_of(mission, replace(wanted, **NOTHING), 0, None)
    except ValueError as error:
        raise MissionError(f"{mission.path}: [simulator]: {error}") from error


def options_of(mission: Mission, wanted: SimulatorWish, port: int, truth: Path | None) -> SimulatorOptions:
    """Return what a mission wants to be simulated, sent to a port of the loopback.

    Raises:
        ValueError: it contradicts itself; says how.
    """
    return SimulatorOptions(
        autopilot=wanted.autopilot,
        pads_enu_m=tuple((x, y) for x, y in mission.pads_enu_m().tolist()),
        system_ids=mission.swarm.ids(),
        remotes=(("127.0.0.1", port),),
        port_base=0,
        origin_deg_m=(*mission.origin_geodetic(),),
        seed=mission.simulator.seed,
        wind_m_s=mission.simulator.wind_m_s,
        noise_m=mission.simulator.noise_m if wanted.dynamics == "measured" else None,
        dynamics=wanted.dynamics,
        collisions=mission.simulator.collisions,
        manners=Manners(**{name: getattr(mission.simulator, name) for name in MANNERS}),
        faults=tuple(map(parse_fault, wanted.faults)),
        impairments=tuple(map(parse_impairment, wanted.impairments)),
        truth=truth,
        signing_key=None if wanted.signing_key is None else read_key(wanted.signing_key),
        epoch_s=VIRTUAL_EPOCH_S,
    )


def simulator_of(mission: Mission, wanted: SimulatorWish, port: int) -> Simulator:
    """Return a mission's simulator for the running loop, not yet started, whose truth can be looked at.

    Raises:
        MissionError: what is wanted contradicts itself; says how.
    """
    check_simulator(mission, wanted)
    return Simulator(options_of(mission, wanted, port, None))


def free_port() -> int:
    """Return a UDP port of the loopback that is not in use now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


class Simulators:
    """The simulators that a flight has running, as far as it has to do with them.

    Attributes:
        truth: the file that says, once the vehicles' simulator has ended, what they truly hit; None: they are real.
    """

    def __init__(self, truth: Path | None) -> None:
        self.truth = truth
        self._tell: Callable[[str], None] | None = None

    def begin_stage(self, stage: str) -> None:
        """Let faults and impairments know that the flight has come to a stage."""
        if self._tell is not None:
            self._tell(stage)

    def listen(self, tell: Callable[[str], None]) -> None:
        """Tell stages to a simulator from now on."""
        self._tell = tell


@asynccontextmanager
async def simulated(
    mission: Mission, wanted: SimulatorWish | None, port: int, targets_port: int, folder: Path
) -> AsyncIterator[Simulators]:
    """Run all that a mission has simulated: its vehicles, and its target vehicles.

    In virtual time they share the running loop; otherwise each is a process of its own, as fast as the loop's time.

    Args:
        mission: whose.
        wanted: how the vehicles are; None: they are real.
        port: of the loopback, where the vehicles come.
        targets_port: likewise, of the target vehicles.
        folder: the processes' own words go here, and the truth.

    Raises:
        LinkError: a simulator did not start; says why.
    """
    speed = speed_of(asyncio.get_running_loop())
    simulators = Simulators(None if wanted is None else folder / TRUTH)
    async with AsyncExitStack() as stack:
        if math.isinf(speed):
            if wanted is not None:
                options = options_of(mission, wanted, port, folder / TRUTH)
                simulator = await stack.enter_async_context(Simulator(options))
                simulators.listen(simulator.begin_stage)
            await stack.enter_async_context(targets_in_loop(mission, targets_port))
        else:
            if wanted is not None:
                log = folder / "simulator.log"
                arguments = _arguments(mission, wanted, port, speed, folder / TRUTH)
                process = await _beside(stack, _process(arguments, log))
                simulators.listen(partial(_tell_stage, process))
            await _beside(stack, targets_process(mission, targets_port, speed, folder / "targets.log"))
        yield simulators


def _tell_stage(process: subprocess.Popen[bytes], stage: str) -> None:
    """Tell a simulator's process of a stage; one that has ended hears nothing."""
    assert process.stdin is not None
    with suppress(OSError, ValueError):
        process.stdin.write(f"stage {stage}\n".encode())
        process.stdin.flush()


Entered = TypeVar("Entered")


async def _beside(stack: AsyncExitStack, process: AbstractContextManager[Entered]) -> Entered:
    """Enter a context of the stack whose beginning and end take a while, without holding the loop up."""
    entered = await asyncio.to_thread(process.__enter__)

    async def leave(*error: Any) -> None:  # noqa: ANN401 - what any context manager is told
        await asyncio.to_thread(process.__exit__, *error)

    stack.push_async_exit(leave)
    return entered


@contextmanager
def targets_process(mission: Mission, port: int, speed: float, log: Path) -> Iterator[None]:
    """Run the mission's simulated target vehicles beside us; nothing if it has none.

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
def _process(arguments: Sequence[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a simulator of its own; it ends with this context, or with our process, whatever ends that.

    It has a session of its own: a Ctrl-C in the terminal is for the ground station, which still needs the vehicles.

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
        yield process
    finally:
        with suppress(OSError):  # what was not told yet, a process that has ended need not know
            process.stdin.close()
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()


@asynccontextmanager
async def targets_in_loop(mission: Mission, port: int) -> AsyncIterator[None]:
    """Run the mission's simulated target vehicles on the running event loop; nothing if it has none."""
    targets = tuple(parse_target(json.dumps(target)) for target in _targets(mission))
    if not targets:
        yield
        return
    options = SimulatorOptions(
        pads_enu_m=(),
        system_ids=(),
        remotes=(("127.0.0.1", port),),
        origin_deg_m=(*mission.origin_geodetic(),),
        targets=targets,
    )
    async with Simulator(options):
        yield


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


def _arguments(mission: Mission, wanted: SimulatorWish, port: int, speed: float, truth: Path) -> list[str]:
    pads = " ".join(f"{x:.6f},{y:.6f}" for x, y in mission.pads_enu_m())
    values = {
        **_common(mission, port, speed),
        "vehicles": mission.swarm.vehicles,
        "autopilot": wanted.autopilot,
        "pads": pads,
        "system-ids": ",".join(str(system_id) for system_id in mission.swarm.ids()),
        "seed": mission.simulator.seed,
        "wind": mission.simulator.wind_m_s,
        "dynamics": wanted.dynamics,
        "truth": truth,
    }
    switches = [f"--{name.replace('_', '-')}" for name in MANNERS if getattr(mission.simulator, name)]
    if mission.simulator.noise_m is not None and wanted.dynamics == "measured":
        values["noise"] = mission.simulator.noise_m
    if wanted.signing_key is not None:
        values["signing-key"] = wanted.signing_key.absolute()
    if not mission.simulator.collisions:
        switches.append("--harmless")
    faults = [f"--fault={json.dumps(fault)}" for fault in wanted.faults]
    return [*_options(values), *switches, *faults, *(f"--impair={json.dumps(each)}" for each in wanted.impairments)]


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
