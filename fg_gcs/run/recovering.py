"""After a run that did not end: brings its vehicles down, puts their own parameters back, prints nothing."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from fg_gcs.core.separation import Fence
from fg_gcs.errors import FgError, LinkError
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.journal import Journal
from fg_gcs.flight.recovery import Recovery
from fg_gcs.flight.snapshot import RunEvent
from fg_gcs.link.clock import speed_of, ticks
from fg_gcs.link.endpoint import Endpoint, parse_networks
from fg_gcs.link.router import Router
from fg_gcs.mission import load_mission
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.record.write.kept_parameters import (
    Kept,
    KeptParameters,
    give_sign,
    is_alive,
    last_sign_s,
    read_kept,
    state_folder,
    unreadable,
)
from fg_gcs.record.write.recorder import MISSION, Recorder, make_folder
from fg_gcs.run.observing import Observer
from fg_gcs.run.signing import key_files, keys_in, signing_with
from fg_gcs.run.simulators import VIRTUAL_EPOCH_S
from fg_gcs.wire.address import MAIN
from fg_gcs.wire.commands import request_version, write_parameter
from fg_gcs.wire.dialogue import Question
from fg_gcs.wire.params import same
from fg_gcs.wire.reading import ReadParameters, Wanted
from fg_gcs.wire.vehicle import Vehicle

DEFAULT: Final = "udpin:127.0.0.1:14550"
HEARD_S: Final = 2.5  # how long a vehicle has for its next heartbeat, twice
OTHERS_S: Final = 15.0  # after a run's last sign of life its vehicles follow nobody's setpoints but another station's
SIGN_S: Final = 1.0  # between two signs of life of ours
ANYWHERE_M: Final = 1e6
GENTLE: Final = Rules(  # where the mission of the run cannot be read any more
    Limits(2.0, 1.0, climb_m_s=1.0, descent_m_s=1.0),
    1.5,
    Fence((-ANYWHERE_M, -ANYWHERE_M, -ANYWHERE_M), (ANYWHERE_M, ANYWHERE_M, ANYWHERE_M)),
)


@dataclass(frozen=True)
class RecoverOptions:
    """How to recover.

    Attributes:
        connect: where vehicles are; empty: where the runs that did not end had them, or else the usual port.
        wait_s: how long to wait for their heartbeats [s].
        logs: the folder of what is done is made in here.
        state: where parameters are kept; None: in the user's own state folder.
        signing_keys: files of MAVLink 2 keys, each ``[NAME=]FILE``, as the run had them.
    """

    connect: tuple[str, ...] = ()
    wait_s: float = 5.0
    logs: Path = Path("logs")
    state: Path | None = None
    signing_keys: tuple[str, ...] = ()


class Recovered(NamedTuple):
    """What became of one vehicle."""

    vehicle: str
    autopilot: str
    ours: bool  # its parameters are kept: a run that did not end has changed them
    was: str  # mode, and whether it was armed
    now: str
    parameters: str  # what became of them


@dataclass
class RecoverResult:
    """What came of it.

    Attributes:
        vehicles: that were heard, ours or not.
        missing: names of vehicles of which parameters are kept and that were not heard.
        not_down: how many of ours are not known to be on the ground, motors off.
        unreadable: files in which parameters were kept, but that cannot be read: nobody knows of what.
        alive: folder of the run that still goes on, so that nothing was touched; else empty.
        folder: of the record; None: nothing was done.
    """

    vehicles: list[Recovered] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    not_down: int = 0
    unreadable: list[str] = field(default_factory=list)
    alive: str = ""
    folder: Path | None = None

    @property
    def in_order(self) -> bool:
        """Whether nothing is left to do."""
        return not (self.missing or self.not_down or self.unreadable or self.alive)


async def recover(options: RecoverOptions | None = None, observers: Sequence[Observer] = ()) -> RecoverResult:
    """Find the vehicles of runs that did not end, bring them down, and put their own parameters back.

    Only vehicles of which parameters are kept are touched, and only while no run that keeps them is alive.

    Args:
        options: how.
        observers: hear of events; nothing else of them is called.

    Raises:
        LinkError: no vehicle answered, or a port is taken: by another ground station that is alive, for example.
        MissionError: a signing key cannot be had.
    """
    chosen = options or RecoverOptions()
    state = chosen.state or state_folder()
    kept = read_kept(state)
    alive = next((one for one in kept if is_alive(state, one)), None)
    if alive is not None:
        return RecoverResult(alive=alive.run)
    networks = parse_networks(chosen.connect or sorted({_endpoint(one) for one in kept}) or (DEFAULT,))
    keys = keys_in(key_files(chosen.signing_keys, networks))
    loop = asyncio.get_running_loop()
    folder = make_folder(chosen.logs, "recover", datetime.now())
    virtual = math.isinf(speed_of(loop))
    async with AsyncExitStack() as stack:
        recorder = stack.enter_context(Recorder(folder, "", loop.time(), time.time(), {}, in_thread=not virtual))
        recorder.listeners.extend(_heard_by(observer) for observer in observers)
        parameters = stack.enter_context(KeptParameters(state))
        journal = Journal(recorder, loop.time)
        epoch_s = VIRTUAL_EPOCH_S if virtual else time.time()
        warn = partial(journal.event, "warning")
        signing = await stack.enter_async_context(signing_with(keys, epoch_s, state, warn))
        router = await Router.open(networks, signing=signing)
        stack.callback(router.close)
        beating = asyncio.ensure_future(router.keep_alive())
        stack.callback(beating.cancel)
        result = await _recovered(router, kept, parameters, journal, chosen.wait_s, networks)
        result.folder = folder
        result.unreadable = [str(path) for path in unreadable(state)]
        recorder.finish({"mission": "recover", "completed": result.in_order})
    return result


async def _recovered(
    router: Router,
    kept: Sequence[Kept],
    parameters: KeptParameters,
    journal: Journal,
    wait_s: float,
    networks: Mapping[str, Sequence[Endpoint]],
) -> RecoverResult:
    """Do it all with the vehicles that a router hears.

    Raises:
        LinkError: none.
    """
    await _listen(router, len(kept), wait_s)
    if not router.vehicles:
        tried = ", ".join(str(endpoint) for endpoints in networks.values() for endpoint in endpoints)
        raise LinkError(f"no vehicle answered within {wait_s:g} s at {tried}")
    vehicles = [router.vehicles[address] for address in sorted(router.vehicles)]
    known = {one.system_id for one in kept if one.uid}
    asked = [vehicle for vehicle in vehicles if vehicle.system_id in known]
    await Fleet(router, vehicles).ask(asked, _only(request_version()))  # is it the hardware that is meant?
    own = {vehicle.address: one for vehicle in vehicles if (one := _kept_of(vehicle, kept, router)) is not None}
    was = {vehicle.address: _state(vehicle) for vehicle in vehicles}
    others = {
        vehicle.address
        for vehicle in vehicles
        if vehicle.address in own and _is_flown(vehicle, parameters.folder, own[vehicle.address])
    }
    own = {address: one for address, one in own.items() if address not in others}
    up = [vehicle for vehicle in vehicles if vehicle.armed and vehicle.address in own]
    signs = asyncio.ensure_future(_give_signs(parameters.folder, [own[vehicle.address] for vehicle in up]))
    try:
        left = await Recovery(router, up, _rules(own.values()), journal).run() if up else ()
    finally:
        signs.cancel()
    result = RecoverResult(not_down=len(left) + len(others))
    for vehicle in vehicles:
        mine = own.get(vehicle.address)
        what = "another ground station flies it: left alone" if vehicle.address in others else "not ours: left alone"
        if mine is not None:
            what = await _put_back(router, vehicle, mine, parameters, journal)
        name, autopilot = str(vehicle.address), vehicle.profile.name
        result.vehicles.append(
            Recovered(name, autopilot, mine is not None, was[vehicle.address], _state(vehicle), what)
        )
    heard = {one.name for vehicle in vehicles if (one := _kept_of(vehicle, kept, router)) is not None}
    result.missing = sorted(f"{one.system_id} ({one.endpoint})" for one in kept if one.name not in heard)
    return result


def _is_flown(vehicle: Vehicle, folder: Path, kept: Kept) -> bool:
    """Say whether somebody else flies a vehicle: it follows setpoints, or waits for them, long after its run ended.

    By itself it does so for a second (PX4), or until it misses heartbeats for ten (ArduPilot).
    """
    follows = vehicle.armed and vehicle.mode == vehicle.profile.streaming_mode
    return follows and time.time() - last_sign_s(folder, kept) > OTHERS_S


async def _give_signs(folder: Path, kept: Sequence[Kept]) -> None:
    """Let others know that these vehicles are being brought down, for ever: our heartbeats keep them in their mode."""
    async for _ in ticks(asyncio.get_running_loop().time(), SIGN_S):
        for one in kept:
            give_sign(folder, one)


async def _listen(router: Router, count: int, wait_s: float) -> None:
    """Wait for heartbeats: until as many vehicles are heard as are ours, and a little for others."""
    loop = asyncio.get_running_loop()
    began_s, enough_s = loop.time(), math.inf
    async for _ in ticks(began_s, 0.05):
        if len(router.vehicles) >= max(count, 1):
            enough_s = min(enough_s, loop.time())
        if loop.time() - enough_s > HEARD_S or loop.time() - began_s > wait_s:
            return


async def _put_back(router: Router, vehicle: Vehicle, kept: Kept, parameters: KeptParameters, journal: Journal) -> str:
    """Give a vehicle its own values back where those that were set are still there; say what became of them."""
    if vehicle.armed:
        return "kept: it is not known to be down"
    fleet = Fleet(router, [vehicle])
    said = []
    try:
        await fleet.ask([vehicle], _only(ReadParameters(tuple(Wanted((name,), needed=True) for name in kept.set))))
        for name, value in kept.set.items():
            now = vehicle.params[name]
            if not same(now, value):
                said.append(f"{name} is {now:g}, not the {value:g} that was set: left alone")
                continue
            own = kept.found[name]
            await fleet.ask([vehicle], _only(write_parameter(name, own)))
            said.append(f"{name} = {own:g} again")
    except (FgError, KeyError) as error:
        return f"kept: {error}"
    parameters.forget(kept)
    text = "; ".join(said)
    journal.event("recover", f"vehicle {vehicle.address}: {text}")
    return text


def _only(request: Question) -> Callable[[Vehicle], Iterable[Question]]:
    """A script of one request."""
    return lambda _: [request]


def _kept_of(vehicle: Vehicle, kept: Sequence[Kept], router: Router) -> Kept | None:
    """Return what is kept of a vehicle, and not of other hardware; of several with its id that of where it is heard."""
    alike = [one for one in kept if one.system_id == vehicle.system_id and one.autopilot == vehicle.profile.name]
    alike = [one for one in alike if one.may_be(vehicle.uid)]
    if len(alike) > 1:
        here = router.endpoint_of(vehicle.address)
        alike = [one for one in alike if one.endpoint == here]
    return alike[0] if len(alike) == 1 else None


def _rules(kept: Iterable[Kept]) -> Rules:
    """Return the rules of the mission that was flown, or gentle ones if it cannot be read any more."""
    for one in kept:
        with suppress(FgError, OSError):
            return load_mission(Path(one.run) / MISSION).task().rules
    return GENTLE


def _endpoint(kept: Kept) -> str:
    """Return where a vehicle was, as `--connect` takes it."""
    return kept.endpoint if kept.network == MAIN else f"{kept.network}={kept.endpoint}"


def _state(vehicle: Vehicle) -> str:
    where = "armed" if vehicle.armed else "disarmed"
    return f"{vehicle.mode_name}, {where}{', in the air' if vehicle.airborne and vehicle.armed else ''}"


def _heard_by(observer: Observer) -> Callable[[float, str, str], None]:
    def heard(time_s: float, kind: str, text: str) -> None:
        observer.event(RunEvent(time_s, kind, text))

    return heard
