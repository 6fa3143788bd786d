"""On the ground: find the vehicles, ask for their streams, learn frames and limits, set failsafes, wait until ready."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from fg_gcs.errors import LinkError, VehicleError
from fg_gcs.flight.fleet import STEP_S, Fleet, NotInTime, until
from fg_gcs.flight.journal import Journal
from fg_gcs.link.clock import ticks
from fg_gcs.link.endpoint import Endpoint
from fg_gcs.link.router import Router
from fg_gcs.plan.limits import Limits
from fg_gcs.wire.address import VehicleAddress, names, vehicles_named
from fg_gcs.wire.autopilots import FailsafeParameter, TakeOff
from fg_gcs.wire.commands import (
    Request,
    read_parameter,
    request_origin,
    set_message_interval,
    set_mode,
    write_parameter,
)
from fg_gcs.wire.vehicle import Vehicle

READY_S = 90.0  # ArduCopter needs 41 s from its boot until it can arm; twice that for a slow machine
TELEMETRY_HZ = (25.0, 20.0)  # of positions: for small swarms, and for those of more than MANY vehicles
MANY = 50


async def discover(
    router: Router,
    networks: Mapping[str, Sequence[Endpoint]],
    count: int,
    wanted: Sequence[VehicleAddress] | None,
    wait_s: float,
) -> list[Vehicle]:
    """Wait for the mission's vehicles, at most ``wait_s``; without wanted ones, for as many as it needs.

    Raises:
        LinkError: too few vehicles answered; names the endpoints tried.
    """
    start_s = asyncio.get_running_loop().time()
    async for k, late_s in ticks(start_s, STEP_S):
        heard = [address for address in wanted or router.vehicles if address in router.vehicles]
        if len(heard) >= count:
            return [router.vehicles[address] for address in sorted(heard)[:count]]
        if k * STEP_S + late_s >= wait_s:
            break
    tried = ", ".join(str(endpoint) for endpoints in networks.values() for endpoint in endpoints)
    if not router.vehicles:
        raise LinkError(f"no vehicle answered within {wait_s:g} s at {tried}; is it running and sending there?")
    answered = f"only {vehicles_named(router.vehicles)} answered within {wait_s:g} s at {tried}"
    raise LinkError(f"{answered}; the mission needs {names(wanted) if wanted else f'{count} of them'}")


async def prepare(fleet: Fleet, journal: Journal) -> None:
    """Get every vehicle ready to arm, its streams flowing and its origin known.

    ArduPilot's readiness counts for its present mode only, so it is put into its streaming mode first.

    Raises:
        VehicleError: a vehicle refused something needed, or is not ready in time; says why as far as it told.
    """

    def script(vehicle: Vehicle) -> Iterator[Request]:
        rate_hz = TELEMETRY_HZ[len(fleet.vehicles) > MANY]
        for stream in vehicle.profile.streams(rate_hz):
            yield set_message_interval(stream.message_id, stream.rate_hz, optional=not stream.needed)
        if vehicle.profile.take_off is TakeOff.BY_COMMAND:
            yield set_mode(vehicle.profile.streaming_mode)

    await fleet.ask(fleet.vehicles, script)
    try:
        await until(
            lambda: [vehicle for vehicle in fleet.vehicles if not (vehicle.armed or _ready(vehicle))],
            READY_S,
            "become ready to arm",
        )
    except NotInTime as error:
        raise VehicleError(not_ready(error.waiting)) from error
    armed = [vehicle.address for vehicle in fleet.vehicles if vehicle.armed]
    if armed:
        raise VehicleError(f"armed already, by another ground station: {vehicles_named(armed)}")
    await fleet.ask(fleet.vehicles, lambda vehicle: [replace(request_origin(), deadline_s=READY_S)])
    journal.event("ready", f"{len(fleet.vehicles)} vehicles are ready to arm")


def _ready(vehicle: Vehicle) -> bool:
    return vehicle.prearm_ok and vehicle.position_ned_m is not None


def not_ready(waiting: Sequence[Vehicle]) -> str:
    """Return which vehicles are not ready, together with those that give the same reasons."""
    by_reason: dict[str, list[VehicleAddress]] = {}
    for vehicle in waiting:
        reasons = "; ".join(sorted({text.text for text in vehicle.recent_texts})) or "no reason given"
        by_reason.setdefault(reasons, []).append(vehicle.address)
    groups = (f"{vehicles_named(addresses)} ({reasons})" for reasons, addresses in by_reason.items())
    return f"not ready to arm within {READY_S:g} s: {', '.join(groups)}"


async def vehicle_limits(fleet: Fleet, limits: Limits, journal: Journal) -> Limits:
    """Return the mission's limits, lowered to what the vehicles' own parameters allow.

    Jerk is among them where an autopilot shapes streamed setpoints by it. ArduCopter does in GUIDED: whatever the mask,
    targets pass the position controller's input shaping, whose jerk is ``PSC_JERK_XY``; plans beyond it are flown with
    a lag and overshot (measured, see docs/autopilots). ``WPNAV_JERK`` shapes its own waypoint legs only. PX4 shapes
    nothing in OFFBOARD: setpoints go straight to the position controller, and ``MPC_JERK_MAX`` and ``MPC_JERK_AUTO``
    belong to its manual and automatic modes.

    Raises:
        VehicleError: never for an unknown parameter: firmwares differ; its limit then stays the mission's.
    """

    def script(vehicle: Vehicle) -> Iterator[Request]:
        for limit in vehicle.profile.limits:
            for name in limit.names:
                if not any(known in vehicle.params for known in limit.names):
                    # ArduPilot meets an unknown name with silence; a known one it answers within 0.1 s
                    yield replace(read_parameter(name, optional=True), resend_s=0.3, deadline_s=1.0)

    await fleet.ask(fleet.vehicles, script)
    lowest: dict[str, tuple[float, str, VehicleAddress]] = {}
    for vehicle in fleet.vehicles:
        for limit in vehicle.profile.limits:
            for name, scale in limit.names.items():
                value = vehicle.params.get(name, 0.0) * scale
                if value > 0.0:
                    own = value, name, vehicle.address
                    lowest[limit.quantity] = min(lowest.get(limit.quantity, own), own)
    for quantity, (value, name, address) in lowest.items():
        if value < getattr(limits, quantity):
            text = f"{quantity} lowered to {value:g} by {name} of vehicle {address}"
            journal.event("limit", text)
    return limits.lowered_to(**{quantity: value for quantity, (value, _, _) in lowest.items()})


class Failsafes:
    """What the vehicles do when we fall silent: set before arming, put back after the flight."""

    def __init__(self, fleet: Fleet, journal: Journal) -> None:
        """Touch nothing yet."""
        self._fleet = fleet
        self._journal = journal
        self._found: list[tuple[Vehicle, str, float]] = []

    async def set(self) -> None:
        """Read every failsafe parameter, change those that are unsafe for a swarm, and say what was found and changed.

        Raises:
            VehicleError: a vehicle keeps its unsafe value.
        """
        vehicles = self._fleet.vehicles
        await self._fleet.ask(
            vehicles, lambda vehicle: [read_parameter(f.name, optional=True) for f in vehicle.profile.failsafes]
        )
        self._found = [
            (vehicle, failsafe.name, vehicle.params[failsafe.name])
            for vehicle in vehicles
            for failsafe in vehicle.profile.failsafes
            if _to_change(vehicle, failsafe)
        ]
        self._keep()  # before anything is changed: whatever happens, what was found can be looked up
        await self._fleet.ask(
            vehicles,
            lambda vehicle: [
                write_parameter(failsafe.name, failsafe.wanted)
                for failsafe in vehicle.profile.failsafes
                if failsafe.wanted is not None and _to_change(vehicle, failsafe)
            ],
        )
        self._report()

    async def put_back(self) -> None:
        """Restore what was found on the vehicles that still answer.

        Raises:
            VehicleError: a vehicle does not take its old value back.
        """
        now_s = self._journal.time()
        heard = [vehicle for vehicle in self._fleet.vehicles if now_s - vehicle.heard_at_s < 1.0]
        await self._fleet.ask(
            heard,
            lambda vehicle: [write_parameter(name, value) for owner, name, value in self._found if owner is vehicle],
        )

    def _keep(self) -> None:
        """Let the record have every parameter that was read, as found, and those that are set for the flight."""
        kept = []
        for vehicle in self._fleet.vehicles:
            to_set = {f.name: f.wanted for f in vehicle.profile.failsafes if _to_change(vehicle, f)}
            address = vehicle.address._asdict()
            kept.append({**address, "autopilot": vehicle.profile.name, "found": dict(vehicle.params), "set": to_set})
        self._journal.recorder.parameters(kept)

    def _report(self) -> None:
        groups: dict[tuple[str, float, float | None, str], list[VehicleAddress]] = {}
        changed = {(vehicle.address, name): value for vehicle, name, value in self._found}
        for vehicle in self._fleet.vehicles:
            for failsafe in vehicle.profile.failsafes:
                if failsafe.name in vehicle.params:
                    value = vehicle.params[failsafe.name]
                    found = changed.get((vehicle.address, failsafe.name), value)
                    to = value if (vehicle.address, failsafe.name) in changed else None
                    groups.setdefault((failsafe.name, found, to, failsafe.reason), []).append(vehicle.address)
        for (name, found, to, reason), addresses in groups.items():
            change = "" if to is None else f", set to {to:g} for this flight"
            kind = "found" if to is None else "failsafe"
            self._journal.event(kind, f"{name} = {found:g}{change} on {vehicles_named(addresses)} ({reason})")


def _to_change(vehicle: Vehicle, failsafe: FailsafeParameter) -> bool:
    value = vehicle.params.get(failsafe.name)
    return failsafe.wanted is not None and value is not None and value != failsafe.wanted
