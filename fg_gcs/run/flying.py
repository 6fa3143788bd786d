"""Fly a mission and keep its record: simulator, flight, tables, summary and report, without a word on the way."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import Enum
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fg_gcs.errors import FgError, LinkError, MissionError, VehicleError
from fg_gcs.flight.director import Director, FlightResult, Setup
from fg_gcs.flight.sightings.own_source import OwnSightings
from fg_gcs.flight.sightings.sighting_sources import Substitutes
from fg_gcs.flight.target_follower import warm_up
from fg_gcs.link.clock import make_loop, speed_of
from fg_gcs.link.endpoint import Endpoint, parse_networks
from fg_gcs.link.forwarding import Forwards, parse_forwards
from fg_gcs.mission.model import Mission
from fg_gcs.plan.compiled import build
from fg_gcs.record.read.run import RunError
from fg_gcs.record.report.report import write_report
from fg_gcs.record.write.kept_parameters import KeptParameters, state_folder
from fg_gcs.record.write.recorder import REPORT, Recorder, make_folder
from fg_gcs.run.observing import Audience, Observer
from fg_gcs.run.signing import key_files, keys_in, signing_with
from fg_gcs.run.simulators import (
    TRUTH,
    VIRTUAL_EPOCH_S,
    SimulatorWish,
    check_simulator,
    free_port,
    simulated,
    wish_of,
)
from fg_gcs.run.summary import read_truth, summary_of
from fg_gcs.run.swarms import heard_at, instances_of, swarm_for
from fg_gcs.scenario.motions import TrueMotion
from fg_gcs.sitl.instances import Instance, SwarmOptions
from fg_gcs.wire.address import MAIN
from fg_gcs.wire.timing import LEAST_PACE

VIRTUAL_PORT, VIRTUAL_TARGETS_PORT = 14550, 14560  # in virtual time no other program is there


Networks = Mapping[str, tuple[Endpoint, ...]]  # by name


class _Extras(NamedTuple):
    """What a flight's links have besides."""

    keys: Mapping[str, bytes]  # by network
    forwards: Forwards | None
    instances: Sequence[Instance]  # that are started for it


@dataclass(frozen=True)
class FlyOptions:
    """How a mission is flown.

    Attributes:
        connect: where vehicles are, each ``[NAME=]ENDPOINT``, NAME being a network's; empty: where the mission says, or
            else the built-in simulator is started.
        wait_s: how long to wait for the vehicles' first heartbeats [s].
        autopilot: which one the simulator plays, ``px4`` or ``ardupilot``; None: as the mission says.
        dynamics: how simulated vehicles fly, ``paper`` or ``measured``; None: as the mission says.
        faults: what goes wrong inside simulated vehicles, tables as `[[simulator.faults]]`, beside the mission's.
        impairments: likewise on their links, as `[[simulator.impairments]]`.
        motions: true motions by the names of targets, in place of the mission's; its sensors see them.
        sightings: sources of sightings by the names of targets, in place of the mission's.
        logs: the run's folder is made in here.
        knows_origin: whether the mission's origin is where it says on Earth; None: yes with the built-in simulator,
            otherwise only if the mission names one, else it is learnt from where the vehicles stand.
        snapshot_hz: how often observers get a snapshot at most, never more than 25 [Hz].
        write_report: write the report when the run has ended; :func:`fg_gcs.run.reporting.report` does it later.
        state: folder in which users' own values of parameters are kept while a flight changes them; None: the user's
            state folder, and nowhere with the built-in simulator or in virtual time: those vehicles end with the run.
        serve_snapshots: offer snapshots to other programs on a socket in the run's folder; never in virtual time.
        signing_keys: files of MAVLink 2 keys, each ``[NAME=]FILE``, NAME being a network's; nothing unsigned is taken
            in a network with a key, and the built-in simulator has it, too.
        forward: who else gets telemetry, each ``[NAME=]udpout:HOST:PORT`` or ``[NAME=]tcp:HOST:PORT``, NAME being the
            network whose vehicles it sees.
        signing_setup: vehicles do not have the keys yet: they are given them, and must sign before anything is armed.
        swarm: real SITL instances are started for the flight, as many as the mission has vehicles, in place of
            ``connect``; without a folder they have theirs in the run's.
        spacing_m: between the homes of neighbouring ones [m]; None: as the mission's pads.
        least_pace: slower clocks of real vehicles than this share of real time are not flown with; 0: any are.
    """

    connect: tuple[str, ...] = ()
    wait_s: float = 30.0
    autopilot: str | None = None
    dynamics: str | None = None
    faults: Sequence[Mapping[str, object]] = ()
    impairments: Sequence[Mapping[str, object]] = ()
    motions: Mapping[str, TrueMotion] = field(default_factory=dict)
    sightings: Mapping[str, OwnSightings] = field(default_factory=dict)
    logs: Path = Path("logs")
    knows_origin: bool | None = None
    snapshot_hz: float = 25.0
    state: Path | None = None
    serve_snapshots: bool = True
    signing_keys: tuple[str, ...] = ()
    signing_setup: bool = False
    forward: tuple[str, ...] = ()
    write_report: bool = True
    swarm: SwarmOptions | None = None
    spacing_m: float | None = None
    least_pace: float = LEAST_PACE


class Outcome(Enum):
    """How a run ended."""

    COMPLETED = "completed"
    ABORTED = "aborted; what still obeyed was brought down"
    NOT_FLOWN = "the mission cannot be flown: nothing was armed"
    NO_ANSWER = "too few vehicles answered, or a port is taken"
    FAILED = "a fault of this program"


@dataclass(frozen=True)
class RunResult:
    """What came of a run.

    Attributes:
        outcome: how it ended.
        reason: why it was not completed, in one line; empty if it was.
        summary: its figures by the names of the command line's JSON.
        folder: where its record is.
        flight: what the flight knows of itself, its plan included.
        error: what ended it, where an exception did.
    """

    outcome: Outcome
    reason: str
    summary: Mapping[str, object]
    folder: Path
    flight: FlightResult = field(repr=False)
    error: Exception | None = None

    @property
    def completed(self) -> bool:
        """Whether everything was flown as planned."""
        return self.outcome is Outcome.COMPLETED

    @property
    def report(self) -> Path | None:
        """The report, if one could be written."""
        path = self.folder / REPORT
        return path if path.exists() else None

    @property
    def in_order(self) -> bool:
        """Whether the record is complete, no task died, and every vehicle is down, motors off, and has hit nothing.

        What simulated vehicles hit is known from the truth; of others it is not known.
        """
        hit = self.summary["collisions"] or self.summary["ground_strikes"]
        died, up = self.summary["tasks_died"], self.summary["vehicles_not_down"]
        return self.summary["recording_complete"] is True and not (up or hit or died)


async def fly(mission: Mission, options: FlyOptions | None = None, observers: Sequence[Observer] = ()) -> RunResult:
    """Fly a mission on the running loop, whatever its time is: real, scaled or virtual.

    Cancelling it is :meth:`Director.interrupt`: first home, then a verified landing, then landing at once.

    Args:
        mission: what to fly, see :func:`fg_gcs.mission.load_mission`.
        options: how; without them by the built-in simulator.
        observers: hear of what happens; what they raise ends nothing, but the time that they take is the flight's.

    Returns:
        What came of it; also when no vehicle answered, when there is no plan, and after a fault of this program.

    Raises:
        MissionError: the options are at fault, or no folder can be made for the record; nothing was begun.
    """
    chosen = options or FlyOptions()
    instances = instances_of(mission, chosen.swarm, chosen.spacing_m)
    if chosen.swarm is not None:
        if chosen.connect:
            raise MissionError("--swarm starts the vehicles: leave --connect, --px4 and --ardupilot out")
        chosen = replace(chosen, connect=heard_at(chosen.swarm, instances))
    networks = _networks(mission, chosen)
    forwards = _forwards(mission, chosen, networks)
    files = key_files(chosen.signing_keys, networks or (MAIN,))
    keys = keys_in(files)
    if chosen.signing_setup and not keys:
        raise MissionError("--signing-setup: there is no key to give to vehicles; name one by --signing-key")
    wish = None
    if networks and (chosen.faults or chosen.impairments or chosen.dynamics):
        raise MissionError("dynamics, faults and impairments are the built-in simulator's: fly without --connect")
    if not networks:
        wish = wish_of(mission, chosen.autopilot, chosen.dynamics, chosen.faults, chosen.impairments)
        wish = replace(wish, signing_key=None if chosen.signing_setup else files.get(MAIN))
        check_simulator(mission, wish)
    loop = asyncio.get_running_loop()
    await asyncio.to_thread(prepare, mission)
    folder = _folder(mission, chosen)
    virtual = math.isinf(speed_of(loop))
    epoch_s = VIRTUAL_EPOCH_S if virtual else time.time()
    async with AsyncExitStack() as stack:
        recorder = stack.enter_context(_recorder(folder, mission, loop.time(), epoch_s, in_thread=not virtual))
        recorder.know(mission=str(mission.path))
        audience = await stack.enter_async_context(
            Audience.open(observers, recorder, folder if chosen.serve_snapshots and not virtual else None)
        )
        extras = _Extras(keys, forwards, instances)
        director, error = await _flown(mission, chosen, networks, wish, extras, recorder, audience)
        result = await asyncio.to_thread(_finished, mission, chosen, director, error, recorder, loop.time())
    if isinstance(error, asyncio.CancelledError):
        raise error
    return result


def fly_blocking(
    mission: Mission,
    options: FlyOptions | None = None,
    observers: Sequence[Observer] = (),
    *,
    speed: float = 1.0,
) -> RunResult:
    """Fly a mission on a loop of its own and wait for its end; see :func:`fly`.

    Args:
        mission: what to fly.
        options: how.
        observers: hear of what happens.
        speed: of time; 1 is real time, infinity virtual time: as fast as it can be computed, simulator only.

    Raises:
        MissionError: see :func:`fly`.
        ValueError: the speed is not a positive number.
    """
    with asyncio.Runner(loop_factory=lambda: make_loop(speed)) as runner:
        return runner.run(fly(mission, options, (_OwnLoop(), *observers)))


def prepare(mission: Mission) -> None:
    """Load, or compile, all code that the mission needs, so that nothing in flight waits for it.

    :func:`fly` does it by itself; it takes half a minute once after installation, see
    :func:`fg_gcs.plan.compiled.is_built`.

    Raises:
        FgError: the mission's numbers are absurd, or a file of its targets is wrong; the loader refuses those.
    """
    build({mission.plan.formulation})
    if mission.targets is not None:
        warm_up(mission)


class _OwnLoop(Observer):
    """On a loop that is the flight's own, an exception in any callback is a fault that ends the flight."""

    def started(self, director: Director) -> None:
        """Hear of exceptions in callbacks."""
        asyncio.get_running_loop().set_exception_handler(lambda _, context: director.fail(context))


def _networks(mission: Mission, options: FlyOptions) -> Networks:
    """Return where vehicles are that are there already; none: the simulator is to be started.

    Raises:
        MissionError: an option is at fault.
    """
    if options.autopilot not in (None, "px4", "ardupilot"):
        raise MissionError(f"autopilot {options.autopilot!r}; accepted: px4 or ardupilot")
    for name in ("wait_s", "snapshot_hz"):
        if not 0.0 < getattr(options, name) < math.inf:
            raise MissionError(f"{name} = {getattr(options, name)}; accepted: a number above 0")
    for name, accepted in (("connect", "endpoints"), ("forward", "endpoints"), ("signing_keys", "files")):
        if isinstance(getattr(options, name), str):
            raise MissionError(f"{name} = {getattr(options, name)!r}; accepted: a tuple of {accepted}")
    unknown = {*options.motions, *options.sightings} - {target.name for target in mission.targets or ()}
    if unknown:
        raise MissionError(f"{mission.path}: no target is called {sorted(unknown)[0]!r}, so it can have no source")
    for target, motion in options.motions.items():
        _check_motion(target, motion)
    what = "--connect" if options.connect else f"{mission.path}: [networks]"
    try:
        return parse_networks(options.connect or mission.connections())
    except LinkError as error:
        raise MissionError(f"{what}: {error}") from error


def _forwards(mission: Mission, options: FlyOptions, networks: Networks) -> Forwards | None:
    """Return who else gets telemetry; None: nobody.

    Raises:
        MissionError: an option is at fault.
    """
    try:
        receivers = parse_forwards(options.forward, networks or {MAIN: ()})
    except LinkError as error:
        raise MissionError(f"--forward: {error}") from error
    return Forwards(receivers, mission.swarm.forward_commands) if receivers else None


def _check_motion(target: str, motion: TrueMotion) -> None:
    """Refuse a motion whose answers are no positions and velocities, before anything is armed."""
    try:
        found = [np.asarray(each, dtype=float) for each in motion.at(np.array([0.0, 1.0]))]
    except Exception as error:  # whatever a motion of one's own does wrong
        raise MissionError(f"the motion of {target} fails: {error!r}") from error
    if [each.shape for each in found] != [(2, 3), (2, 3)] or not all(np.isfinite(each).all() for each in found):
        shapes = " and ".join(str(each.shape) for each in found)
        raise MissionError(
            f"the motion of {target} returns arrays of shapes {shapes} for 2 times; accepted: position and velocity, "
            "finite, each of shape (2, 3)"
        )


def _folder(mission: Mission, options: FlyOptions) -> Path:
    try:
        return make_folder(options.logs, mission.name, datetime.now())
    except OSError as error:
        raise MissionError(f"--logs {options.logs}: {error.strerror or error}") from error


def _recorder(folder: Path, mission: Mission, start_s: float, epoch_s: float, *, in_thread: bool) -> Recorder:
    try:
        return Recorder(folder, mission.text, start_s, epoch_s, mission.files(), in_thread=in_thread)
    except OSError as error:
        raise MissionError(f"--logs {folder.parent}: {error.strerror or error}") from error


async def _flown(
    mission: Mission,
    options: FlyOptions,
    networks: Networks,
    wish: SimulatorWish | None,
    extras: _Extras,
    recorder: Recorder,
    audience: Audience,
) -> tuple[Director, Exception | asyncio.CancelledError | None]:
    """Fly; return the flight's handle, and the exception that ended it if one did."""
    loop = asyncio.get_running_loop()
    async with AsyncExitStack() as stack:
        try:
            setup = await stack.enter_async_context(_surroundings(mission, options, networks, wish, extras, recorder))
        except FgError as error:  # the simulator did not start
            recorder.event(loop.time(), "error", str(error))
            return Director(mission, Setup(networks, 0.0, True, time.perf_counter), recorder), error
        director = Director(mission, setup, recorder)
        try:
            audience.watch(director, options.snapshot_hz)
            await _unhurt(director)
        except FgError as error:
            recorder.event(loop.time(), "error", str(error))
            return director, error
        except asyncio.CancelledError as error:  # the vehicles are down, and the caller wants no more of this
            return director, error
        except Exception as error:  # a bug: the vehicles are down, and the record is kept for whoever mends it
            recorder.event(loop.time(), "error", f"internal error: {error!r}")
            return director, error
    return director, None


async def _unhurt(director: Director) -> None:
    """Fly; being cancelled is being asked to stop: the first time by flying home, the second time by landing.

    Raises:
        CancelledError: it was cancelled, and the flight has ended.
    """
    flight = asyncio.ensure_future(director.fly())
    cancelled: asyncio.CancelledError | None = None
    while not flight.done():
        try:
            await asyncio.shield(flight)
        except asyncio.CancelledError as error:
            if flight.done():
                raise
            cancelled = error
            director.interrupt("cancelled")
    flight.result()
    if cancelled is not None:
        raise cancelled


@asynccontextmanager
async def _surroundings(
    mission: Mission,
    options: FlyOptions,
    networks: Networks,
    wish: SimulatorWish | None,
    extras: _Extras,
    recorder: Recorder,
) -> AsyncIterator[Setup]:
    """Start what has to be simulated; yield how the flight is connected to it.

    Raises:
        LinkError: the simulator did not start.
    """
    loop = asyncio.get_running_loop()
    virtual = math.isinf(speed_of(loop))
    port, targets_port = (VIRTUAL_PORT, VIRTUAL_TARGETS_PORT) if virtual else (free_port(), free_port())
    own = wish is not None
    if wish is not None:
        text = f"starting {mission.swarm.vehicles} simulated {wish.autopilot} vehicles"
        recorder.event(loop.time(), "simulator", text)
    folder = None if options.state is None and (own or virtual) else options.state or state_folder()

    def warn(text: str) -> None:
        recorder.event(loop.time(), "warning", text)

    async with (
        swarm_for(options.swarm, extras.instances, recorder),
        simulated(mission, wish, port, targets_port, recorder.folder) as simulators,
        signing_with(
            extras.keys, VIRTUAL_EPOCH_S if virtual else time.time(), folder, warn, sets_up=options.signing_setup
        ) as signing,
    ):

        def told(_: float, kind: str, text: str) -> None:
            if kind == "stage":
                simulators.begin_stage(text)

        recorder.listeners.append(told)
        kept = _kept(folder, warn)
        yield Setup(
            parse_networks([f"udpin:127.0.0.1:{port}"]) if own else networks,
            options.wait_s,
            own if options.knows_origin is None else options.knows_origin,
            time.perf_counter,
            Substitutes(f"udpin:127.0.0.1:{targets_port}", options.motions, options.sightings),
            kept,
            signing,
            extras.forwards,
            0.0 if own else options.least_pace,
        )
        if kept is not None:
            kept.close()


def _kept(folder: Path | None, warn: Callable[[str], None]) -> KeptParameters | None:
    """Open where users' own parameters are kept; None where nothing has to outlive the run, or the disk refuses."""
    if folder is None:
        return None
    try:
        return KeptParameters(folder)
    except OSError as error:
        warn(f"{folder}: {error.strerror or error}")
        return None


def _finished(
    mission: Mission,
    options: FlyOptions,
    director: Director,
    ended_by: Exception | asyncio.CancelledError | None,
    recorder: Recorder,
    now_s: float,
) -> RunResult:
    """Write summary and report; return what came of the run."""
    flight = director.result
    error = ended_by if isinstance(ended_by, Exception) else None
    truth = read_truth(recorder.folder / TRUTH)
    for text in truth.told:
        recorder.event(now_s, "truth", text)
    if flight.completed and truth.told:  # whatever the telemetry says
        flight.completed, flight.reason = False, truth.told[0]
    reason = flight.reason if error is None else str(error) or repr(error)
    summary = recorder.finish(summary_of(mission, flight, recorder, reason) | truth.figures)
    if options.write_report:
        try:
            write_report(recorder.folder)
        except (OSError, RunError) as problem:  # the disk is full, or the folder is gone
            recorder.event(now_s, "warning", f"the report cannot be written: {problem}")
            summary = {**summary, "report": None}
    return RunResult(_outcome(flight, error), reason, summary, recorder.folder, flight, error)


def _outcome(flight: FlightResult, error: Exception | None) -> Outcome:
    match error:
        case None:
            return Outcome.COMPLETED if flight.completed else Outcome.ABORTED
        case LinkError():
            return Outcome.NO_ANSWER
        case VehicleError():  # before anything was armed
            return Outcome.ABORTED
        case FgError():
            return Outcome.NOT_FLOWN
        case _:
            return Outcome.FAILED
