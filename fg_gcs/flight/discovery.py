"""Who flies: the vehicles that are named, or those with the lowest addresses among the ones that qualify.

A vehicle qualifies if it is a multirotor that nobody has armed. Which vehicle answers first does not matter.
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
from fg_gcs.wire.vehicle import Vehicle

SETTLE_S = 1.2  # one heartbeat: whoever is there has been heard once by then, so that each can be named
GAP_S = 3.2  # three heartbeats: for as long a lower address, if any is free, may still come and change who flies


async def discover(
    router: Router,
    networks: Mapping[str, Sequence[Endpoint]],
    count: int,
    wanted: Sequence[VehicleAddress] | None,
    wait_s: float,
    journal: Journal,
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

    Raises:
        LinkError: too few vehicles answered; names the endpoints tried.
    """
    start_s = asyncio.get_running_loop().time()
    heard, new_s = 0, 0.0
    async for k, late_s in ticks(start_s, STEP_S):
        waited_s = k * STEP_S + late_s
        if len(router.vehicles) > heard:
            heard, new_s = len(router.vehicles), waited_s
        chosen = choose(router.vehicles.values(), count, wanted)
        if len(chosen) >= count:
            if wanted is not None or waited_s - new_s >= _settling_s(router.vehicles, chosen, networks):
                journal.event("who", who_flies(router.vehicles.values(), chosen, wanted))
                return [router.vehicles[address] for address in chosen]
        elif waited_s >= wait_s:
            break
    tried = ", ".join(str(endpoint) for endpoints in networks.values() for endpoint in endpoints)
    if not router.vehicles:
        raise LinkError(f"no vehicle answered within {wait_s:g} s at {tried}; is it running and sending there?")
    armed = [vehicle.address for vehicle in router.vehicles.values() if vehicle.armed and wanted is None]
    taken = f" (armed already: {vehicles_named(armed)})" if armed else ""
    answered = f"only {vehicles_named(router.vehicles)} answered within {wait_s:g} s at {tried}{taken}"
    raise LinkError(f"{answered}; the mission needs {names(wanted) if wanted else f'{count} of them'}")


def choose(
    heard: Iterable[Vehicle], count: int, wanted: Collection[VehicleAddress] | None
) -> tuple[VehicleAddress, ...]:
    """Return who flies, at most ``count``: the lowest addresses of those that are named, or else that qualify."""
    qualified = (
        vehicle.address for vehicle in heard if (_qualifies(vehicle) if wanted is None else vehicle.address in wanted)
    )
    return tuple(sorted(qualified)[:count])


def who_flies(
    heard: Iterable[Vehicle], chosen: Collection[VehicleAddress], wanted: Collection[VehicleAddress] | None
) -> str:
    """Return the line about every vehicle heard: ``vehicles 1-9 fly; vehicle 10 is not needed``."""
    left = [vehicle for vehicle in heard if vehicle.address not in chosen]
    groups = {
        ("is not named by the mission", "are not named by the mission"): [v for v in left if wanted is not None],
        ("is armed already", "are armed already"): [v for v in left if wanted is None and v.armed],
        ("is no multirotor", "are no multirotors"): [
            v for v in left if wanted is None and not v.armed and v.kind not in MULTIROTORS
        ],
        ("is not needed", "are not needed"): [v for v in left if wanted is None and _qualifies(v)],
    }
    said = [f"{vehicles_named(chosen)} {'flies' if len(chosen) == 1 else 'fly'}"]
    said += [
        f"{vehicles_named(vehicle.address for vehicle in group)} {one if len(group) == 1 else many}"
        for (one, many), group in groups.items()
        if group
    ]
    return "; ".join(said)


def _qualifies(vehicle: Vehicle) -> bool:
    return vehicle.kind in MULTIROTORS and not vehicle.armed


def _settling_s(
    heard: Collection[VehicleAddress], chosen: Sequence[VehicleAddress], networks: Collection[str]
) -> float:
    """Return how long nothing new must have been heard until the choice stands [s]."""
    last = chosen[-1].system_id
    return SETTLE_S if len(networks) == 1 and sum(one.system_id <= last for one in heard) == last else GAP_S
