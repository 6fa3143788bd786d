"""On the ground: find the vehicles, ask for their streams, learn frames and limits, set failsafes, wait until ready."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from dataclasses import replace

from fg_gcs.errors import LinkError, VehicleError
from fg_gcs.flight.fleet import STEP_S, Fleet, names, until
from fg_gcs.link.clock import ticks
from fg_gcs.link.router import Router
from fg_gcs.plan.limits import Limits
from fg_gcs.record.write.layouts import NETWORK
from fg_gcs.record.write.recorder import Recorder
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
TELEMETRY_HZ = (25.0, 10.0)  # of positions: for small swarms, and for those of more than MANY vehicles
MANY = 50


async def discover(
    router: Router, endpoints: Sequence[str], count: int, wanted_ids: Sequence[int] | None, wait_s: float
) -> list[Vehicle]:
    """Wait for the mission's vehicles, at most ``wait_s``; without wanted ids, for as many as it needs.

    Raises:
        LinkError: nobody, or too few, answered; names the endpoints tried.
    """
    start_s = asyncio.get_running_loop().time()
    async for k, late_s in ticks(start_s, STEP_S):
        heard = sorted(set(router.vehicles) & set(wanted_ids)) if wanted_ids else sorted(router.vehicles)
        if len(heard) >= count:
            return [router.vehicles[system_id] for system_id in heard[:count]]
        if k * STEP_S + late_s >= wait_s:
            break
    tried = ", ".join(endpoints)
    if not router.vehicles:
        raise LinkError(f"no vehicle answered within {wait_s:g} s at {tried}; is it running and sending there?")
    wanted = f"ids {names(wanted_ids)}" if wanted_ids else f"{count} vehicles"
    raise LinkError(f"only vehicles {names(router.vehicles)} answered within {wait_s:g} s at {tried}; needed: {wanted}")


async def prepare(fleet: Fleet, recorder: Recorder) -> None:
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
            fleet.vehicles,
            lambda vehicle: vehicle.armed or (vehicle.prearm_ok and vehicle.position_ned_m is not None),
            READY_S,
            "ready to arm",
        )
    except VehicleError as error:
        said = {text.text for vehicle in fleet.vehicles for text in vehicle.recent_texts}
        raise VehicleError(f"{error} ({'; '.join(sorted(said)) or 'they did not say why'})") from error
    flying = [vehicle.system_id for vehicle in fleet.vehicles if vehicle.armed]
    if flying:
        raise VehicleError(f"vehicles {names(flying)} are armed already: somebody is flying them; hands off")
    await fleet.ask(fleet.vehicles, lambda vehicle: [replace(request_origin(), deadline_s=READY_S)])
    recorder.event(asyncio.get_running_loop().time(), "ready", f"{len(fleet.vehicles)} vehicles ready to arm")


async def vehicle_limits(fleet: Fleet, limits: Limits, recorder: Recorder) -> Limits:
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
    lowest: dict[str, tuple[float, str, int]] = {}
    for vehicle in fleet.vehicles:
        for limit in vehicle.profile.limits:
            for name, scale in limit.names.items():
                value = vehicle.params.get(name, 0.0) * scale
                if value > 0.0:
                    lowest[limit.quantity] = min(
                        lowest.get(limit.quantity, (value, name, vehicle.system_id)), (value, name, vehicle.system_id)
                    )
    for quantity, (value, name, system_id) in lowest.items():
        if value < getattr(limits, quantity):
            text = f"{quantity} lowered to {value:g}: {name} of vehicle {system_id}"
            recorder.event(asyncio.get_running_loop().time(), "limit", text)
    return limits.lowered_to(**{quantity: value for quantity, (value, _, _) in lowest.items()})


class Failsafes:
    """What the vehicles do when we fall silent: set before arming, put back after the flight."""

    def __init__(self, fleet: Fleet, recorder: Recorder) -> None:
        """Touch nothing yet."""
        self._fleet = fleet
        self._recorder = recorder
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
        loop = asyncio.get_running_loop()
        heard = [vehicle for vehicle in self._fleet.vehicles if loop.time() - vehicle.heard_at_s < 1.0]
        await self._fleet.ask(
            heard,
            lambda vehicle: [write_parameter(name, value) for owner, name, value in self._found if owner is vehicle],
        )

    def _keep(self) -> None:
        """Let the record have every parameter that was read, as found, and those that are set for the flight."""
        kept = []
        for vehicle in self._fleet.vehicles:
            to_set = {f.name: f.wanted for f in vehicle.profile.failsafes if _to_change(vehicle, f)}
            address = {"network": NETWORK, "system_id": vehicle.system_id}
            kept.append({**address, "autopilot": vehicle.profile.name, "found": dict(vehicle.params), "set": to_set})
        self._recorder.parameters(kept)

    def _report(self) -> None:
        now_s = asyncio.get_running_loop().time()
        groups: dict[tuple[str, float, float | None, str], list[int]] = {}
        changed = {(vehicle.system_id, name): value for vehicle, name, value in self._found}
        for vehicle in self._fleet.vehicles:
            for failsafe in vehicle.profile.failsafes:
                if failsafe.name in vehicle.params:
                    value = vehicle.params[failsafe.name]
                    found = changed.get((vehicle.system_id, failsafe.name), value)
                    to = value if (vehicle.system_id, failsafe.name) in changed else None
                    groups.setdefault((failsafe.name, found, to, failsafe.reason), []).append(vehicle.system_id)
        for (name, found, to, reason), ids in groups.items():
            change = "" if to is None else f", set to {to:g} for this flight"
            kind = "found" if to is None else "failsafe"
            self._recorder.event(now_s, kind, f"{name} = {found:g}{change} on vehicles {names(ids)} ({reason})")


def _to_change(vehicle: Vehicle, failsafe: FailsafeParameter) -> bool:
    value = vehicle.params.get(failsafe.name)
    return failsafe.wanted is not None and value is not None and value != failsafe.wanted
