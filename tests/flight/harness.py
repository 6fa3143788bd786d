"""Whole flights in virtual time: the real ground station and the real simulator on one loop, joined by datagrams."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.flight.director import Director, FlightResult
from fg_gcs.flight.snapshot import RunEvent
from fg_gcs.link.clock import VirtualTimeLoop, ticks
from fg_gcs.mission import Mission, load_mission
from fg_gcs.record.read.run import RecordedRun, load_run
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.run.flying import FlyOptions
from fg_gcs.run.flying import fly as run_mission
from fg_gcs.run.observing import Observer
from sitl_mock import parse_fault, parse_impairment
from sitl_mock.host.server import Simulator, SimulatorOptions

AUTOPILOTS = ("px4", "ardupilot")
GROUND_PORT, OTHER_PORT = 14550, 14551  # ours, and another ground station's
SMALL = """
[swarm]
vehicles = 4
[formation]
shape = "hemisphere"
leaders = 3
followers = 1
edge_m = 6.0
centre_enu_m = [0.0, 0.0, 10.0]
normal_enu = [1.0, 0.0, 0.0]
[target]
position_enu_m = [-6.0, 10.0, 12.0]
[hold]
duration_s = 2.0
[limits]
speed_m_s = 8.0
acceleration_m_s2 = 4.0
separation_m = 1.5
[fence]
low_enu_m = [-30.0, -30.0, 2.0]
high_enu_m = [30.0, 30.0, 30.0]
[takeoff]
height_m = 2.5
"""
RESTING = "[target]\nposition_enu_m = [-6.0, 10.0, 12.0]\n"
CIRCLE = """[targets.motion]
kind = "circle"
centre_enu_m = [0.0, 0.0, 12.0]
radius_m = 15.0
speed_m_s = 2.0
"""
UPRIGHT = (  # who is left alone there returns
    SMALL.replace("leaders = 3\nfollowers = 1\nedge_m = 6.0", "leaders = 4\nfollowers = 0\nedge_m = 4.0")
    .replace("[0.0, 0.0, 10.0]", "[0.0, 0.0, 12.0]")
    .replace("[-6.0, 10.0, 12.0]", "[12.0, 0.0, 12.0]")
    .replace("duration_s = 2.0", "duration_s = 30.0")
)


def moving(targets: str, more: str = "") -> str:
    """Return the small mission, though wider and longer, with other targets; behind it whatever else there is to say.

    Wider, because a target that is known to half a metre shall still be well inside.
    """
    text = SMALL.replace(RESTING, targets).replace("edge_m = 6.0", "edge_m = 9.0")
    return text.replace("duration_s = 2.0", "duration_s = 12.0\ndepth_m = 0.8") + more


CIRCLING = moving(f'[[targets]]\nname = "lead"\n{CIRCLE}')


@dataclass
class Flight:
    """One flight with everything around it, as scripts and tests see it."""

    director: Director
    simulator: Simulator
    recorder: Recorder
    truth_separation_m: float = np.inf  # closest pair in the simulator's own state, airborne or not
    result: FlightResult | None = None

    async def reaches(self, stage: str) -> None:
        """Wait until the flight is in a stage."""
        async for _ in ticks(asyncio.get_running_loop().time(), 0.02):
            if self.director.journal.stage == stage:
                return

    @property
    def down_and_disarmed(self) -> bool:
        """Whether every vehicle stands on the ground, motors off: by the simulator's own state."""
        low = np.abs(self.simulator.positions_enu_m[:, 2]).max() < 0.1
        return bool(low and not self.simulator.armed.any())

    @property
    def recorded(self) -> RecordedRun:
        """Everything that was recorded so far."""
        self.recorder.flush()
        return load_run(self.recorder.folder)

    @property
    def events(self) -> str:
        """Everything that was said."""
        return (self.recorder.folder / "events.jsonl").read_text()

    @property
    def said(self) -> list[dict[str, Any]]:
        """The same as it is kept, an object for each line."""
        return [json.loads(line) for line in self.events.splitlines()]


class OtherStation(asyncio.DatagramProtocol):
    """A second ground station on the vehicles' second link; open it with :meth:`open`."""

    def __init__(self) -> None:
        self.addresses: dict[int, tuple[str, int]] = {}
        self.acknowledgements = 0
        self._packer = dialect.MAVLink(None, srcSystem=250, srcComponent=190)
        self._transport: asyncio.DatagramTransport | None = None

    @classmethod
    async def open(cls) -> OtherStation:
        loop = asyncio.get_running_loop()
        _, station = await loop.create_datagram_endpoint(cls, local_addr=("127.0.0.1", OTHER_PORT))
        return station

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.DatagramTransport)
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.addresses[data[5]] = addr  # byte 5 of a MAVLink 2 frame is the sender's system id
        self.acknowledgements += int.from_bytes(data[7:10], "little") == dialect.MAVLINK_MSG_ID_COMMAND_ACK

    def command_mode(self, system_id: int, mode: int) -> None:
        main, sub = (mode >> 16 & 0xFF, mode >> 24) if mode > 0xFFFF else (mode, 0)
        command = dialect.MAVLink_command_long_message(system_id, 1, 176, 0, 1, main, sub, 0, 0, 0, 0)
        assert self._transport is not None
        self._transport.sendto(bytes(command.pack(self._packer)), self.addresses[system_id])


Script = Callable[[Flight], Awaitable[None]]
Table = Mapping[str, object]  # as `[[simulator.faults]]` and `[[simulator.impairments]]` have it


def mission_of(folder: Path, text: str = SMALL) -> Mission:
    path = folder / "mission.toml"
    path.write_text(text)
    return load_mission(path)


def fly(
    folder: Path,
    autopilot: str,
    script: Script | None = None,
    mission: Mission | None = None,
    wind_m_s: float = 0.0,
    *,
    faults: Sequence[Table] = (),
    impairments: Sequence[Table] = (),
    ours: bool = True,
    shared: bool = False,
    state: Path | None = None,
    loop: Callable[[], asyncio.AbstractEventLoop] = VirtualTimeLoop,
) -> Flight:
    """Fly a mission in virtual time while a script interferes.

    Not ``ours``: where on Earth it is has to be learnt. ``shared``: the vehicles have a link to another station too.
    ``state``: where what outlives a run is kept.
    """
    chosen = mission or mission_of(folder)
    options = SimulatorOptions(
        autopilot=autopilot,
        pads_enu_m=tuple((x, y) for x, y in chosen.pads_enu_m().tolist()),
        system_ids=chosen.swarm.ids(),
        remotes=tuple(("127.0.0.1", port) for port in ((GROUND_PORT, OTHER_PORT) if shared else (GROUND_PORT,))),
        wind_m_s=wind_m_s,
        dynamics=chosen.simulator.dynamics,
        noise_m=chosen.simulator.noise_m,
        collisions=chosen.simulator.collisions,
        faults=tuple(map(parse_fault, faults)),
        impairments=tuple(map(parse_impairment, impairments)),
    )
    with asyncio.Runner(loop_factory=loop) as runner:
        return runner.run(_fly(chosen, folder, options, script, (ours, state)))


async def _fly(
    mission: Mission, folder: Path, simulated: SimulatorOptions, script: Script | None, known: tuple[bool, Path | None]
) -> Flight:
    ours, state = known
    simulator = Simulator(simulated)
    await simulator.start()
    beside = _Beside(simulator, script)
    options = FlyOptions(
        (f"udpin:127.0.0.1:{GROUND_PORT}",),
        wait_s=5.0,
        logs=folder,
        knows_origin=ours,
        write_report=False,
        state=state,
    )
    try:
        result = await asyncio.wait_for(run_mission(mission, options, [beside]), 300.0)
    finally:
        await beside.end()
        await simulator.close()
    if result.error is not None:
        raise result.error
    assert beside.flight is not None
    beside.flight.result = result.flight
    return beside.flight


class _Beside(Observer):
    """Runs a script, and watches the truth, while the flight is on."""

    def __init__(self, simulator: Simulator, script: Script | None) -> None:
        self.flight: Flight | None = None
        self._simulator, self._script = simulator, script
        self._tasks: list[asyncio.Future[None]] = []

    def started(self, director: Director) -> None:
        self.flight = Flight(director, self._simulator, director.journal.recorder)
        self._tasks.append(asyncio.ensure_future(_watch_truth(self.flight)))
        if self._script is not None:
            self._tasks.append(asyncio.ensure_future(self._script(self.flight)))

    def event(self, event: RunEvent) -> None:
        if event.kind == "stage":
            self._simulator.begin_stage(event.text)

    async def end(self) -> None:
        """Stop both; a script that failed fails the test."""
        for task in self._tasks:
            if task.done():
                task.result()
            task.cancel()
        with suppress(asyncio.CancelledError):
            await asyncio.gather(*self._tasks)


async def _watch_truth(flight: Flight) -> None:
    first, second = np.triu_indices(len(flight.simulator.armed), k=1)
    async for _ in ticks(asyncio.get_running_loop().time(), 0.05):
        places = flight.simulator.positions_enu_m
        closest = float(np.linalg.norm(places[first] - places[second], axis=1).min())
        flight.truth_separation_m = min(flight.truth_separation_m, closest)
