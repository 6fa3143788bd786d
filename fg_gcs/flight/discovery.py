"""Who flies: the vehicles that are named, or those with the lowest addresses among the ones that qualify.

A vehicle qualifies if it is a multirotor that is heard, that nobody has armed, and that was not passed over because it
does not become ready. Which vehicle answers first does not matter.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Iterable, Mapping, Sequence

from fg_gcs.errors import LinkError
from fg_gcs.flight.fleet import STEP_S
from fg_gcs.flight.journal import Journal
from fg_gcs.link.clock import ticks
from fg_gcs.link.endpoint import Endpoint
from fg_gcs.link.router import Router
from fg_gcs.wire.address import VehicleAddress, names, vehicles_named
from fg_gcs.wire.autopilots import MULTIROTORS
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.vehicle import Vehicle

SETTLE_S = 1.2  # one heartbeat: whoever is there has been heard once by then, so that each can be named
GAP_S = 3.2  # three heartbeats: for as long a lower address, if any is free, may still come and change who flies
_NOT_NAMED = ("is not named by the mission", "are not named by the mission")
_ARMED = ("is armed already", "are armed already")
_NO_MULTIROTOR = ("is no multirotor", "are no multirotors")
_SILENT = ("is silent", "are silent")
_UNREADY = ("does not become ready to arm", "do not become ready to arm")
_NOT_NEEDED = ("is not needed", "are not needed")
_REASONS = (_NOT_NAMED, _ARMED, _NO_MULTIROTOR, _SILENT, _UNREADY, _NOT_NEEDED)  # in the order in which they are told


async def discover(
    router: Router,
    networks: Mapping[str, Sequence[Endpoint]],
    count: int,
    wanted: Sequence[VehicleAddress] | None,
    wait_s: float,
    journal: Journal,
    unready: Collection[VehicleAddress] = (),
) -> list[Vehicle]:
    """Wait for the mission's vehicles, at most ``wait_s``, and tell of every vehicle heard why it flies or not.

    Args:
        router: which hears them.
        networks: where they are to be found.
        count: how many the mission needs.
        wanted: those that it names; None: any that qualify, the lowest first. Once there are enough, vehicles are
            waited for until no more of them come.
        wait_s: how long to wait for enough of them.
        journal: where to tell who flies.
        unready: those that are passed over, unless they are named.

    Raises:
        LinkError: too few vehicles answered; names the endpoints tried.
    """
    start_s = asyncio.get_running_loop().time()
    heard, new_s = 0, 0.0
    async for k, late_s in ticks(start_s, STEP_S):
        waited_s = k * STEP_S + late_s
        if len(router.vehicles) > heard:
            heard, new_s = len(router.vehicles), waited_s
        chosen = choose(router.vehicles.values(), count, wanted, unready)
        if len(chosen) >= count:
            if wanted is not None or waited_s - new_s >= _settling_s(router.vehicles, chosen, networks):
                journal.event("who", who_flies(router.vehicles.values(), chosen, wanted, unready))
                return [router.vehicles[address] for address in chosen]
        elif waited_s >= wait_s:
            break
    tried = ", ".join(str(endpoint) for endpoints in networks.values() for endpoint in endpoints)
    if not router.vehicles:
        raise LinkError(f"no vehicle answered within {wait_s:g} s at {tried}; {_why_nobody(router)}")
    armed = [vehicle.address for vehicle in router.vehicles.values() if vehicle.armed and wanted is None]
    taken = f" (armed already: {vehicles_named(armed)})" if armed else ""
    answered = f"only {vehicles_named(router.vehicles)} answered within {wait_s:g} s at {tried}{taken}"
    raise LinkError(f"{answered}; the mission needs {names(wanted) if wanted else f'{count} of them'}")


def choose(
    heard: Iterable[Vehicle],
    count: int,
    wanted: Collection[VehicleAddress] | None,
    unready: Collection[VehicleAddress] = (),
) -> tuple[VehicleAddress, ...]:
    """Return who flies, at most ``count``: the lowest addresses of those that are named, or else that qualify."""
    qualified = (
        vehicle.address
        for vehicle in heard
        if (vehicle.address in wanted if wanted is not None else _why_not(vehicle, unready) is None)
    )
    return tuple(sorted(qualified)[:count])


def who_flies(
    heard: Iterable[Vehicle],
    chosen: Collection[VehicleAddress],
    wanted: Collection[VehicleAddress] | None,
    unready: Collection[VehicleAddress] = (),
) -> str:
    """Return the line about every vehicle heard: ``vehicles 1-9 fly; vehicle 10 is not needed``."""
    groups: dict[tuple[str, str], list[VehicleAddress]] = {reasons: [] for reasons in _REASONS}
    for vehicle in heard:
        if vehicle.address not in chosen:
            reasons = _NOT_NAMED if wanted is not None else _why_not(vehicle, unready) or _NOT_NEEDED
            groups[reasons].append(vehicle.address)
    said = [f"{vehicles_named(chosen)} {'flies' if len(chosen) == 1 else 'fly'}"]
    said += [
        f"{vehicles_named(group)} {one if len(group) == 1 else many}" for (one, many), group in groups.items() if group
    ]
    return "; ".join(said)


def _why_not(vehicle: Vehicle, unready: Collection[VehicleAddress]) -> tuple[str, str] | None:
    """Return why a vehicle that is not named does not qualify, of one and of many; None if it does."""
    if vehicle.armed:
        return _ARMED
    if vehicle.kind not in MULTIROTORS:
        return _NO_MULTIROTOR
    if vehicle.phase is Phase.LOST:
        return _SILENT
    return _UNREADY if vehicle.address in unready else None


def _why_nobody(router: Router) -> str:
    """Return what may be the reason that no vehicle was heard."""
    counters = router.counters
    refused = {"unsigned": counters.unsigned, "signed with another key": counters.forged, "too old": counters.replayed}
    told = ", ".join(f"{count} frames {how}" for how, count in refused.items() if count)
    return f"what came was refused: {told}" if told else "is it running and sending there?"


def _settling_s(
    heard: Collection[VehicleAddress], chosen: Sequence[VehicleAddress], networks: Collection[str]
) -> float:
    """Return how long nothing new must have been heard until the choice stands [s]."""
    last = chosen[-1].system_id
    return SETTLE_S if len(networks) == 1 and sum(one.system_id <= last for one in heard) == last else GAP_S
