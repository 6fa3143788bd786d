"""Our own ground station without a mission: it hears bare vehicles, records, and streams setpoints to them."""

from __future__ import annotations

import asyncio
import math
import socket
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import Fence
from fg_gcs.errors import LinkError
from fg_gcs.experiment.bare_process import bare_vehicles, free_ports
from fg_gcs.experiment.baselines.ground_stations import HEAR_S, Mavutil, Numbers
from fg_gcs.experiment.memory_bench import memory_mb
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.garbage import short_collections
from fg_gcs.flight.gate import Gate
from fg_gcs.flight.link_recorder import LinkRecorder
from fg_gcs.flight.motions import SwarmSetpoint
from fg_gcs.flight.streamer import Streamer
from fg_gcs.link.clock import ticks
from fg_gcs.link.endpoint import Endpoint, Kind
from fg_gcs.link.router import Router
from fg_gcs.link.routes import Routes
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.bare import boot_frames
from fg_gcs.wire.setpoint import SetpointRound

FLUSH_S: Final = 0.2  # as a flight does it
MOST_IDS: Final = 250  # of a network
SETPOINTS_HZ: Final = 50.0
GATE_ROUNDS: Final = 200
ANYWHERE: Final = Rules(Limits(8.0, 4.0), 1.5, Fence((-1e5, -1e5, -1e5), (1e5, 1e5, 1e5)))
BATCH: Final = 60  # messages that wait when reading begins: what the system keeps at least


class Streaming(NamedTuple):
    """One stream of setpoints, with its recording."""

    vehicles: int
    rate_hz: float
    networks: int
    position_hz: float  # of each vehicle's telemetry
    core: float  # share of a core, all threads
    late_p99_ms: float
    late_worst_ms: float
    late_ticks: int  # rounds that were left out
    memory_mb: float  # of the whole process
    right: int  # setpoints that reached the vehicle that they are for
    wrong: int  # setpoints that reached another one
    sent: int
    gate_us: float  # of a setpoint through the last gate


class Circles:
    """A motion of V vehicles that all go round in circles of their own.

    Attributes:
        rows: the fleet's rows that it moves.
        turns_from: None: headings are not limited.
    """

    turns_from = None

    def __init__(self, places_enu_m: Array) -> None:
        """Take the circles' centres, shape (V, 3) [m; ENU]."""
        self.rows: Sequence[int] = range(len(places_enu_m))
        self._places = places_enu_m

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return a point on each circle, of half a metre at 1 rad/s."""
        along = 0.5 * np.array((math.cos(now_s), math.sin(now_s), 0.0))
        velocity, acceleration = np.empty_like(self._places), np.empty_like(self._places)
        velocity[:], acceleration[:] = (-along[1], along[0], 0.0), -along
        return SwarmSetpoint(self._places + along, velocity, acceleration, np.full(len(velocity), now_s % math.pi))


class OwnStation:
    """Router, recorder and fleet as a flight has them.

    Attributes:
        recorder: of a made-up run.
        fleet: once the vehicles are heard.
    """

    def __init__(self, recorder: Recorder) -> None:
        """Record into a run's folder: `open` makes one."""
        self.recorder = recorder
        self.fleet: Fleet
        self.router: Router
        self._link_recorder = LinkRecorder(recorder)
        self._round: tuple[Routes, SetpointRound] | None = None

    @classmethod
    async def open(cls, ports: Mapping[str, int], folder: Path) -> OwnStation:
        """Listen at one port of the loopback for each network, and record into an empty folder."""
        recorder = Recorder(folder, "", asyncio.get_running_loop().time(), 1.7e9, in_thread=True)
        station = cls(recorder)
        networks = {name: [Endpoint(Kind.UDP_IN, "127.0.0.1", port)] for name, port in ports.items()}
        log = station._link_recorder
        station.router = await Router.open(networks, on_frame=log.on_frame, tap=log.tap)
        return station

    async def hear(self, system_ids: Sequence[int], wait_s: float = HEAR_S) -> None:
        """Wait until so many vehicles are known, whatever their ids are, and their frames."""
        router, count, time_s = self.router, len(system_ids), asyncio.get_running_loop().time
        async for k, _ in ticks(time_s(), FLUSH_S):
            heard = [vehicle for vehicle in router.vehicles.values() if vehicle.origin and vehicle.ground_ned_m]
            if len(heard) == count:
                break
            if k * FLUSH_S > wait_s:
                raise LinkError(f"{len(heard)} of {count} vehicles are heard within {wait_s:g} s")
        self.fleet = self._link_recorder.fleet = Fleet(router, sorted(heard, key=lambda vehicle: vehicle.address))
        self.fleet.learn_frames(None, np.zeros(2), np.zeros(3))

    async def send(self, numbers: Numbers) -> None:
        """Send each vehicle its setpoint."""
        routes = self.router.routes(tuple(self.fleet.row_of))
        if self._round is None or routes is not self._round[0]:
            self._round = routes, SetpointRound(self.fleet.system_ids, routes.senders)
        self.router.send_all(routes, self._round[1].pack(numbers))

    async def flush(self) -> None:
        """Write the record down, for ever: run it as a task."""
        async for _ in ticks(asyncio.get_running_loop().time(), FLUSH_S):
            self.recorder.flush()

    def close(self) -> None:
        """Close everything."""
        self.router.close()
        self.recorder.__exit__(None, None, None)


async def stream(count: int, rate_hz: float, networks: int, position_hz: float, duration_s: float) -> Streaming:
    """Stream setpoints to bare vehicles in real time, and measure what that takes.

    Args:
        count: vehicles, spread over the networks.
        rate_hz: of the setpoints [Hz].
        networks: how many.
        position_hz: of each vehicle's telemetry; heartbeats come once a second in any case [Hz].
        duration_s: how long [s].

    Raises:
        LinkError: not all vehicles are heard.
    """
    names = [f"net{number}" for number in range(networks)] if networks > 1 else ["main"]
    ports = dict(zip(names, free_ports(networks), strict=True))
    shares = [count // networks + (number < count % networks) for number in range(networks)]
    remotes = {port: range(1, share + 1) for port, share in zip(ports.values(), shares, strict=True)}
    loop = asyncio.get_running_loop()
    with TemporaryDirectory(prefix="fg-gcs-bench-") as place:
        station = await OwnStation.open(ports, Path(place))
        try:
            with bare_vehicles(remotes, max(position_hz, 1.0)) as vehicles, short_collections():
                await station.hear(range(count))
                vehicles.set_position_hz(position_hz)
                streamer = Streamer(station.fleet, station.recorder, rate_hz, Gate(station.fleet, ANYWHERE))
                streamer.motion = Circles(station.fleet.positions_enu_m())
                streamer.engage(streamer.motion.rows)
                tasks = [asyncio.create_task(each) for each in (station.router.keep_alive(), station.flush())]
                await asyncio.sleep(1.0)  # of heartbeats and of what it takes to begin
                before = station.router.counters.frames_out
                began_s, cpu_s = loop.time(), time.process_time()
                tasks.append(asyncio.create_task(streamer.run()))
                await asyncio.sleep(duration_s)
                core = (time.process_time() - cpu_s) / (loop.time() - began_s)
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
                sent = station.router.counters.frames_out - before
                await asyncio.sleep(0.5)  # until what is under way has come
                right, wrong = vehicles.deliveries()
            station.recorder.settle()
            late_s = np.load(Path(place) / "ticks.npy")["late_s"]
            return Streaming(
                count,
                rate_hz,
                networks,
                position_hz,
                core,
                1e3 * float(np.percentile(late_s, 99.0)),
                1e3 * float(late_s.max()),
                streamer.late_ticks,
                memory_mb("VmRSS"),
                right,
                wrong,
                sent,
                gate_us(station.fleet),
            )
        finally:
            station.close()


def gate_us(fleet: Fleet) -> float:
    """Return what the last gate takes for a setpoint of a swarm of which each flies its own circle [us]."""
    gate, rows, places = Gate(fleet, ANYWHERE), np.arange(len(fleet.vehicles)), fleet.positions_enu_m()
    phases, radius_m, taken_s = 2.4 * fleet.system_ids, 0.4, list[float]()
    for turn in range(GATE_ROUNDS):
        angle = phases + turn / SETPOINTS_HZ
        along = radius_m * np.stack((np.cos(angle), np.sin(angle), np.zeros(len(rows))), axis=1)
        across = radius_m * np.stack((-np.sin(angle), np.cos(angle), np.zeros(len(rows))), axis=1)
        numbers = np.column_stack((places + along, across, -along, np.zeros(len(rows))))
        began_s = time.perf_counter()
        gate.passed(rows, numbers, turn / SETPOINTS_HZ)
        taken_s.append(time.perf_counter() - began_s)
    if gate.counts.total:
        raise RuntimeError(f"setpoints that nothing is wrong with do not pass: {gate.counts}")
    return 1e6 * median(taken_s) / len(rows)


async def telemetry_us(race_s: float, *, others: bool) -> tuple[float, float | None]:
    """Return what a position message takes that is read into state and recorded, and read by mavutil alone [us].

    Args:
        race_s: how long they take turns [s].
        others: whether mavutil takes part.
    """
    port, their_port = free_ports(2)
    frames = [boot_frames(system_id) for system_id in range(1, BATCH + 1)]
    loop, ours, theirs = asyncio.get_running_loop(), list[float](), list[float]()
    mavutil = Mavutil(their_port) if others else None
    with TemporaryDirectory(prefix="fg-gcs-bench-") as place, socket.socket(type=socket.SOCK_DGRAM) as vehicles:
        station = await OwnStation.open({"main": port}, Path(place))
        for each in frames:
            for frame in each.values():
                vehicles.sendto(frame, ("127.0.0.1", port))
            await asyncio.sleep(0)
        await station.hear(range(BATCH))
        end_s = loop.time() + race_s
        while loop.time() < end_s:
            for each in frames:
                vehicles.sendto(each["position"], ("127.0.0.1", port))
            wanted = station.router.counters.frames_in + BATCH
            began_s = time.perf_counter()
            async for _ in ticks(loop.time(), 1e-6):  # as fast as the loop goes round
                if station.router.counters.frames_in >= wanted:
                    break
            ours.append(time.perf_counter() - began_s)
            if mavutil is not None:
                for each in frames:
                    vehicles.sendto(each["position"], ("127.0.0.1", their_port))
                began_s = time.perf_counter()
                mavutil.receive(BATCH)
                theirs.append(time.perf_counter() - began_s)
            station.recorder.flush()
        station.close()
    if mavutil is not None:
        mavutil.close()
    return 1e6 * median(ours) / BATCH, 1e6 * median(theirs) / BATCH if theirs else None
