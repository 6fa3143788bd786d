"""A swarm of SITL instances: started, heard, asked until each can be armed, measured, watched, and ended."""

from __future__ import annotations

import asyncio
import math
import os
from collections.abc import AsyncIterator, Iterable, Iterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Final, NamedTuple

from fg_gcs.errors import LinkError, MissionError, VehicleError
from fg_gcs.flight.fleet import STEP_S, Script
from fg_gcs.flight.link_check import unless_doubled
from fg_gcs.flight.preparation import AT_ONCE, CHECKS_S, is_ready
from fg_gcs.link.clock import ticks
from fg_gcs.link.endpoint import parse_networks
from fg_gcs.link.router import Router
from fg_gcs.sitl.instances import Instance, SwarmOptions, check_options
from fg_gcs.sitl.processes import LOG, Processes, how_ended, keeping, last_words, refuse_taken
from fg_gcs.wire.address import MAIN, VehicleAddress, vehicles_named
from fg_gcs.wire.autopilots import MULTIROTORS, TakeOff
from fg_gcs.wire.commands import run_prearm_checks, set_message_interval, set_mode
from fg_gcs.wire.dialogue import Question
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.vehicle import Vehicle

RATE_HZ: Final = 5.0  # of positions, which show that there are some
LOOK_S: Final = 0.25  # how often it is looked how far they are: those that do the same are told of together
AGAIN_S: Final = 2.0  # a mode that was set too early is lost, and so are streams: then all is asked again
REASONS_S: Final = 12.0  # for so long what it said counts
TOGETHER_S: Final = 2.0  # reasons that it gives so soon after each other are of one look at itself
BUSY: Final = 0.95  # a share of all processors with which nothing is left for a flight
_REFUSALS: Final = ("prearm:", "arm:", "preflight fail", "arming denied")  # how texts begin that say why not


class Stage(Enum):
    """How far an instance is."""

    STARTING = "starting"
    BOOTING = "booting"
    READY = "ready"
    ENDED = "ended"


@dataclass
class Member:
    """One instance of a swarm as it is now.

    Attributes:
        instance: which.
        folder: its working folder.
        pid: of its process; 0: there is none yet.
        stage: how far it is.
        waits: why it is not ready, or how it ended, for people; empty when it is ready.
        ready_s: how long it took until it could be armed [s]; NaN before that.
        pace: of its clock, as a share of real time; NaN before it was measured.
    """

    instance: Instance
    folder: Path
    pid: int = 0
    stage: Stage = Stage.STARTING
    waits: str = "no heartbeat yet"
    ready_s: float = math.nan
    pace: float = math.nan

    @property
    def address(self) -> VehicleAddress:
        """The vehicle that it is."""
        return VehicleAddress(MAIN, self.instance.system_id)

    @property
    def log(self) -> Path:
        """What it has said."""
        return self.folder / LOG

    @property
    def name(self) -> str:
        """It as the subject of a sentence."""
        return f"instance {self.instance.number} (vehicle {self.instance.system_id})"

    def last_words(self) -> str:
        """Return what it said last, and where the rest is, in the words that follow a reason."""
        said = last_words(self.log)
        return f"{f'it said: {said}; ' if said else 'it said nothing; '}see {self.log}"


class Listener:
    """Hears what becomes of a swarm; override what you want to hear."""

    def changed(self, swarm: Swarm) -> None:
        """Take that something about its members has changed."""

    def said(self, text: str) -> None:
        """Take a line for people."""

    def ended(self, text: str) -> None:
        """Take a line about an instance that has ended after all were ready."""


class Load(NamedTuple):
    """What the machine has had to do: times of all processors since its start [ticks]."""

    busy: int  # but for what is done niced: that gives way
    all: int

    @classmethod
    def now(cls) -> Load | None:
        """Return it, where the system tells (Linux)."""
        try:
            numbers = [int(word) for word in Path("/proc/stat").read_text().splitlines()[0].split()[1:9]]
        except (OSError, ValueError, IndexError):
            return None
        return cls(
            sum(numbers) - numbers[1] - numbers[3] - numbers[4], sum(numbers)
        )  # less nice, idle, and waiting for disks


@dataclass
class Swarm:
    """Instances that have been started; see :func:`started`.

    Attributes:
        options: how.
        members: in the order of their numbers.
        endpoints: where they are to be heard, as ``--connect`` takes it.
        busy: share of all processors while clocks were measured, 0 to 1; NaN: not known.
        was_ready: all could be armed once.
        stopping: whoever ends now was asked to.
        others: vehicles that were heard and are none of these.
        news: set when one has ended otherwise.
    """

    options: SwarmOptions
    members: tuple[Member, ...]
    endpoints: tuple[str, ...]
    listener: Listener
    began_s: float
    busy: float = math.nan
    was_ready: bool = False
    stopping: bool = False
    others: set[VehicleAddress] = field(default_factory=set)
    news: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def alive(self) -> int:
        """How many run."""
        return sum(member.stage is not Stage.ENDED for member in self.members)

    @property
    def slowest(self) -> Member:
        """The one with the slowest clock, as far as measured."""
        return min(self.members, key=lambda member: member.pace if math.isfinite(member.pace) else math.inf)

    def settle(self, changes: Iterable[tuple[Member, Stage, str]]) -> None:
        """Take what members are now; tell of those that differ, together those that are alike."""
        told: dict[str, list[VehicleAddress]] = {}
        for member, stage, waits in changes:
            if (member.stage, member.waits) != (stage, waits):
                member.stage, member.waits = stage, waits
                told.setdefault(f"{stage.value} ({waits})" if waits else stage.value, []).append(member.address)
        for text, addresses in told.items():
            self.listener.said(f"{vehicles_named(addresses)}: {text}")
        if told:
            self.listener.changed(self)

    def has_ended(self, number: int, code: int | None) -> None:
        """Take that a process has ended."""
        if self.stopping:
            return
        member = self.members[number]
        member.stage, member.waits = Stage.ENDED, f"{how_ended(code)}; {member.last_words()}"
        self.listener.changed(self)
        if self.was_ready:
            self.listener.ended(f"{member.name} {member.waits}")
        self.news.set()


@asynccontextmanager
async def started(options: SwarmOptions, instances: Sequence[Instance], listener: Listener) -> AsyncIterator[Swarm]:
    """Start instances and wait until each can be armed and keeps pace with the clock; all end with this context.

    Raises:
        MissionError: the options are at fault, or the program is no SITL of a multirotor.
        LinkError: a port is taken, or an instance ends or is not heard while it boots.
        VehicleError: one is not ready in time, is armed already or shares its id, or the machine is too slow for them.
    """
    files = check_options(options)
    recipe = options.recipe
    endpoints = recipe.endpoints(options, [instance.number for instance in instances])
    refuse_taken((each.number, port) for each in instances for port in recipe.ports(options, each.number))
    members = tuple(Member(each, _folder(options, each)) for each in instances)
    swarm = Swarm(options, members, endpoints, listener, asyncio.get_running_loop().time())
    async with AsyncExitStack() as stack:
        router = await Router.open(parse_networks(endpoints))
        stack.callback(router.close)
        processes = await stack.enter_async_context(keeping(swarm.has_ended))
        stack.callback(setattr, swarm, "stopping", True)
        await _start(swarm, files, processes)
        await _booted(swarm, router)
        swarm.was_ready = True
        router.close()  # whoever flies them listens there
        yield swarm


def _folder(options: SwarmOptions, instance: Instance) -> Path:
    """Return the working folder of an instance, made if it was not there, without what was stored in it before.

    Raises:
        MissionError: it cannot be made.
    """
    assert options.folder is not None, "chosen by whoever starts the swarm"
    folder = options.folder.absolute() / f"{options.autopilot}-{instance.number}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in () if options.keep_parameters else options.recipe.stored:
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise MissionError(f"{folder}: {error.strerror or error}") from error
    return folder


async def _start(swarm: Swarm, files: Path, processes: Processes) -> None:
    for number, member in enumerate(swarm.members):
        await processes.start(swarm.options.recipe.start(swarm.options, files, member.instance), member.folder)
        member.pid = processes.pids.get(number, 0)
    swarm.listener.changed(swarm)


async def _booted(swarm: Swarm, router: Router) -> None:
    """Wait until every vehicle can be armed, and measure its clock then.

    Raises:
        FgError: see :func:`started`.
    """
    own: list[Vehicle] = []  # grows
    beating = asyncio.ensure_future(router.keep_alive())
    try:
        await unless_doubled(_boot(swarm, router, own), router, own)
    finally:
        beating.cancel()
        await asyncio.gather(beating, return_exceptions=True)


async def _boot(swarm: Swarm, router: Router, own: list[Vehicle]) -> None:
    """Ask the vehicles of a swarm until all are ready, then measure.

    Raises:
        FgError: see :func:`started`.
    """
    loop, scripts = asyncio.get_running_loop(), _Scripts(router)
    ready_s, looked_s, before = math.nan, -math.inf, Load.now()
    async for _ in ticks(loop.time(), STEP_S):
        now_s = loop.time()
        scripts.step(own, now_s)
        if now_s < looked_s + LOOK_S:
            continue
        looked_s = now_s
        swarm.settle(list(_looked(swarm, router, own, now_s)))
        _refuse(swarm, router, now_s - swarm.began_s)
        _tell_others(swarm, router)
        if any(member.stage is not Stage.READY for member in swarm.members):
            ready_s = math.nan
            continue
        if math.isnan(ready_s):
            ready_s, before = now_s, Load.now()
            watching = f"; watching their clocks for {swarm.options.watch_s:g} s" if swarm.options.watch_s else ""
            swarm.listener.said(f"all can be armed{watching}")
        for member in swarm.members:
            member.pace = router.vehicles[member.address].timing.pace(ready_s)
        known = all(math.isfinite(member.pace) for member in swarm.members)
        watched_s = now_s - ready_s
        if watched_s >= swarm.options.watch_s and (known or watched_s >= 2.0 * swarm.options.watch_s):
            break
    if swarm.options.watch_s:
        swarm.busy = _busy(before, Load.now())
        judge(swarm)


def _tell_others(swarm: Swarm, router: Router) -> None:
    """Tell what the router says, and which vehicles are heard that are none of a swarm, once each."""
    others = set(router.vehicles) - {member.address for member in swarm.members} - swarm.others
    if others:
        swarm.others |= others
        verb = "is" if len(others) == 1 else "are"
        swarm.listener.said(f"{vehicles_named(others)} {verb} heard there as well, from somewhere else")
    while router.notices:
        swarm.listener.said(router.notices.popleft())


def _looked(swarm: Swarm, router: Router, own: list[Vehicle], now_s: float) -> Iterator[tuple[Member, Stage, str]]:
    """Yield what members are by what their vehicles say."""
    for member in swarm.members:
        vehicle = router.vehicles.get(member.address)
        if member.stage is Stage.ENDED or vehicle is None:
            continue
        if vehicle not in own:
            own.append(vehicle)
        waits = _waits_for(vehicle, now_s)
        if not waits and math.isnan(member.ready_s):
            member.ready_s = now_s - swarm.began_s
        yield member, Stage.BOOTING if waits else Stage.READY, waits


def _waits_for(vehicle: Vehicle, now_s: float) -> str:
    """Return what keeps a vehicle from being armed, for people; empty: nothing does."""
    if vehicle.phase is Phase.LOST:
        return "silent"
    streams_by_command = vehicle.profile.take_off is TakeOff.BY_COMMAND
    if streams_by_command and vehicle.mode != vehicle.profile.streaming_mode:
        return "mode not set yet"
    if is_ready(vehicle):
        return ""
    said = [text for text in vehicle.recent_texts if text.text.lower().startswith(_REFUSALS)]
    since_s = max(now_s - REASONS_S, said[-1].at_s - TOGETHER_S) if said else now_s
    if reasons := {text.text for text in said if text.at_s > since_s}:
        return "; ".join(sorted(reasons))
    return "no position yet" if vehicle.prearm_ok else "checks not passed yet"


class _Scripts:
    """What vehicles are asked while they boot, again and again until they are ready."""

    def __init__(self, router: Router) -> None:
        self._router = router
        self._scripts: dict[VehicleAddress, tuple[Script, float]] = {}
        self._checked_s: dict[VehicleAddress, float] = {}

    def step(self, vehicles: Iterable[Vehicle], now_s: float) -> None:
        """Ask what is to be asked now."""
        for vehicle in vehicles:
            address = vehicle.address
            script, began_s = self._scripts.get(address, (None, -math.inf))
            if script is None or (script.done and now_s - began_s > AGAIN_S and _waits_for(vehicle, now_s)):
                script = Script(vehicle, _questions(vehicle), AT_ONCE)
                self._scripts[address] = script, now_s
            for message in script.step(now_s):
                self._router.send_message(address, message)
            if not vehicle.prearm_ok and now_s - self._checked_s.setdefault(address, now_s) > CHECKS_S:
                self._checked_s[address] = now_s
                self._router.send_message(address, run_prearm_checks(vehicle))


def _questions(vehicle: Vehicle) -> Iterator[Question]:
    profile = vehicle.profile
    for stream in profile.streams(RATE_HZ):
        if stream.needed and vehicle.message_at_s.get(stream.message_id) is None:
            yield set_message_interval(stream.message_id, stream.rate_hz)
    if profile.take_off is TakeOff.BY_COMMAND and vehicle.mode != profile.streaming_mode:
        yield set_mode(profile.streaming_mode)


def _refuse(swarm: Swarm, router: Router, waited_s: float) -> None:
    """Give a swarm up that will not become ready.

    Raises:
        FgError: see :func:`started`.
    """
    options, members = swarm.options, swarm.members
    for member in members:
        vehicle = router.vehicles.get(member.address)
        if member.stage is Stage.ENDED:
            what = "" if vehicle else f"; is {options.binary} a SITL of {options.recipe.profile.name}?"
            raise LinkError(f"while booting {member.name} {member.waits}{what}")
        if vehicle is None:
            continue
        if vehicle.profile is not options.recipe.profile:
            raise MissionError(
                f"{member.name} speaks as {vehicle.profile.name}; swarm {options.autopilot} starts "
                f"{options.recipe.profile.name}"
            )
        if vehicle.kind and vehicle.kind not in MULTIROTORS:
            raise MissionError(
                f"{member.name} is no multirotor (MAV_TYPE {vehicle.kind}): {options.binary} or --model is another "
                "vehicle's; only what hovers can be flown"
            )
        if vehicle.armed:
            raise VehicleError(f"{member.name} is armed already: another ground station flies a vehicle of that id")
    silent = [member for member in members if member.stage is Stage.STARTING]
    if silent and waited_s > options.heartbeat_s:
        named = vehicles_named(member.address for member in silent)
        raise LinkError(
            f"no heartbeat of {named} within {options.heartbeat_s:g} s: is {options.binary} a SITL? "
            f"{silent[0].name}: {silent[0].last_words()}"
        )
    waiting = [member for member in members if member.stage is not Stage.READY]
    if waiting and waited_s > options.ready_s:
        by_reason: dict[str, list[VehicleAddress]] = {}
        for member in waiting:
            by_reason.setdefault(member.waits, []).append(member.address)
        groups = (f"{vehicles_named(addresses)} ({waits})" for waits, addresses in by_reason.items())
        raise VehicleError(
            f"not ready to arm within {options.ready_s:g} s: {', '.join(groups)}; set what they ask for by --param, "
            f"or wait longer by --ready-within; see {waiting[0].log}"
        )


def _busy(before: Load | None, after: Load | None) -> float:
    """Return the share of all processors that was used between two moments; NaN: not known."""
    if before is None or after is None or after.all <= before.all:
        return math.nan
    return (after.busy - before.busy) / (after.all - before.all)


def judge(swarm: Swarm) -> None:
    """Say how fast clocks run, and refuse those that are too slow.

    Raises:
        VehicleError: one is.
    """
    slowest, busy = swarm.slowest, "" if math.isnan(swarm.busy) else f", processors {100.0 * swarm.busy:.0f} % busy"
    if math.isnan(slowest.pace):
        swarm.listener.said(f"how fast their clocks run is not known{busy}")
        return
    text = f"the slowest clock (vehicle {slowest.instance.system_id}) runs at {slowest.pace:.3f} of real time{busy}"
    if slowest.pace < swarm.options.least_pace:
        raise VehicleError(
            f"the machine is too slow for so many instances ({len(swarm.members)}): {text}; at least "
            f"{swarm.options.least_pace:g} is needed. Start fewer, or fly all the same with --slow-machine-ok"
        )
    swarm.listener.said(text)
    if swarm.busy > BUSY:
        swarm.listener.said(f"of the {os.cpu_count()} processors nothing is left for a flight; start fewer")
