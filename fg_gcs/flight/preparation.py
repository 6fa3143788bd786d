"""On the ground: ask for the vehicles' streams, wait until they are ready, learn origins and limits, set failsafes."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

from fg_gcs.errors import VehicleError
from fg_gcs.flight.fleet import Fleet, NotDone, NotInTime, until
from fg_gcs.flight.journal import Journal
from fg_gcs.link.clock import ticks
from fg_gcs.plan.limits import Limits
from fg_gcs.wire.address import VehicleAddress, vehicles_named
from fg_gcs.wire.autopilots import AutopilotProfile, TakeOff
from fg_gcs.wire.commands import request_origin, request_version, run_prearm_checks, set_message_interval, set_mode
from fg_gcs.wire.dialogue import Question
from fg_gcs.wire.reading import ReadParameters, Wanted
from fg_gcs.wire.vehicle import Vehicle

READY_S = 90.0  # ArduCopter needs 41 s from its boot until it can arm; twice that for a slow machine
PAIRING_S = 1.0  # four positions on Earth come in that
TELEMETRY_HZ = (25.0, 20.0)  # of positions: for small swarms, and for those of more than MANY vehicles
MANY = 50
CHECKS_S = 5.0  # how often a vehicle is asked what keeps it from being armed
AT_ONCE = 8  # questions to one vehicle at a time: streams and parameters tell themselves apart by ids and names


async def prepare(fleet: Fleet, journal: Journal) -> None:
    """Get every vehicle ready to arm, its streams flowing, its origin and its limits and failsafes known.

    Readiness counts for the present mode only. So ArduPilot is put into its streaming mode first. PX4 still stands in
    that after a flight that its own failsafe ended, and is never ready there without setpoints; nor is it in the mode
    for landing, in which it stays when it was told to land once more after it had landed (measured): it is put into the
    mode that it waits in.

    Raises:
        NotDone: a vehicle refused something needed, does not tell a parameter (that of a limit may be unknown to its
            firmware, but not a failsafe that we set), or is not ready in time; says why as far as it told.
        VehicleError: somebody else has armed one.
    """

    def streams(vehicle: Vehicle) -> Iterator[Question]:
        yield ReadParameters(parameters_of(vehicle.profile))
        rate_hz = TELEMETRY_HZ[len(fleet.vehicles) > MANY]
        for stream in vehicle.profile.streams(rate_hz):
            yield set_message_interval(stream.message_id, stream.rate_hz, optional=not stream.needed)
        yield request_version()

    def mode(vehicle: Vehicle) -> Iterator[Question]:
        profile = vehicle.profile
        if profile.take_off is TakeOff.BY_COMMAND:
            yield set_mode(profile.streaming_mode)
        elif vehicle.mode != profile.waiting_mode and not vehicle.prearm_ok:
            yield set_mode(profile.waiting_mode)

    await fleet.ask(fleet.vehicles, streams, AT_ONCE)
    _refuse_armed(fleet)
    await fleet.ask(fleet.vehicles, mode)
    asking = asyncio.ensure_future(_ask_why(fleet))
    try:
        await until(lambda: _unready(fleet), READY_S, "become ready to arm")
    except NotInTime as error:
        raise NotDone(error.vehicles, not_ready(error.vehicles)) from error
    finally:
        asking.cancel()
    with suppress(NotInTime):  # without it frames are taken to lie where they are told to
        await until(lambda: [v for v in fleet.vehicles if v.pairing is None], PAIRING_S, "tell where they are on Earth")
    _refuse_armed(fleet)
    await fleet.ask(fleet.vehicles, lambda vehicle: [replace(request_origin(), deadline_s=READY_S)])
    journal.event("ready", f"{len(fleet.vehicles)} vehicles are ready to arm")


def _unready(fleet: Fleet) -> list[Vehicle]:
    return [vehicle for vehicle in fleet.vehicles if not (vehicle.armed or is_ready(vehicle))]


async def _ask_why(fleet: Fleet) -> None:
    """Ask vehicles that are not ready what keeps them from it, now and then; PX4 does not say it by itself."""
    async for _ in ticks(asyncio.get_running_loop().time() + CHECKS_S, CHECKS_S):
        for vehicle in _unready(fleet):
            fleet.router.send_message(vehicle.address, run_prearm_checks(vehicle))


def parameters_of(profile: AutopilotProfile) -> tuple[Wanted, ...]:
    """Return the parameters that must be known before a vehicle flies."""
    limits = (Wanted(tuple(limit.names), needed=False) for limit in profile.limits)
    return (*limits, *(Wanted((one.name,), needed=one.wanted is not None) for one in profile.failsafes))


def _refuse_armed(fleet: Fleet) -> None:
    """Leave alone what somebody else has armed.

    Raises:
        VehicleError: names the vehicles.
    """
    armed = [vehicle.address for vehicle in fleet.vehicles if vehicle.armed]
    if armed:
        raise VehicleError(f"armed already, by another ground station: {vehicles_named(armed)}")


def is_ready(vehicle: Vehicle) -> bool:
    """Tell whether a vehicle can be armed in its present mode, as far as it tells, and knows where it is."""
    return vehicle.prearm_ok and vehicle.position_ned_m is not None


def not_ready(waiting: Sequence[Vehicle]) -> str:
    """Return which vehicles are not ready, together with those that give the same reasons."""
    by_reason: dict[str, list[VehicleAddress]] = {}
    for vehicle in waiting:
        reasons = "; ".join(sorted({text.text for text in vehicle.recent_texts})) or "no reason given"
        by_reason.setdefault(reasons, []).append(vehicle.address)
    groups = (f"{vehicles_named(addresses)} ({reasons})" for reasons, addresses in by_reason.items())
    return f"not ready to arm within {READY_S:g} s: {', '.join(groups)}"


def vehicle_limits(fleet: Fleet, limits: Limits, journal: Journal) -> Limits:
    """Return the mission's limits, lowered to what the vehicles' own parameters allow, as `prepare` has read them.

    Where a firmware has no such parameter the limit stays the mission's.

    Jerk is among them where an autopilot shapes streamed setpoints by it. ArduCopter does in GUIDED: whatever the mask,
    targets pass the position controller's input shaping, whose jerk is ``PSC_JERK_XY``; plans beyond it are flown with
    a lag and overshot (measured, see docs/autopilots). ``WPNAV_JERK`` shapes its own waypoint legs only. PX4 shapes
    nothing in OFFBOARD: setpoints go straight to the position controller, and ``MPC_JERK_MAX`` and ``MPC_JERK_AUTO``
    belong to its manual and automatic modes.
    """
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
