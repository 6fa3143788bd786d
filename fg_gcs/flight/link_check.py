"""Whether the links of a swarm are good enough to fly over: asked before arming."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Coroutine, Sequence
from typing import Final

from fg_gcs.errors import VehicleError
from fg_gcs.flight.fleet import STEP_S
from fg_gcs.link.clock import ticks
from fg_gcs.link.router import Router
from fg_gcs.wire.address import VehicleAddress, vehicles_named
from fg_gcs.wire.vehicle import Vehicle

DOUBLED_S: Final = 3.0  # two vehicles that have had one id for so long have it for good


async def unless_doubled(work: Coroutine[object, object, None], router: Router, vehicles: Sequence[Vehicle]) -> None:
    """Do something with vehicles, and give it up when one of them shares its id: who answers is then anybody's guess.

    Raises:
        VehicleError: two vehicles have one id; names the addresses that they speak from.
    """
    loop, job = asyncio.get_running_loop(), asyncio.ensure_future(work)
    since_s = loop.time()
    try:
        async for _ in ticks(since_s, STEP_S):
            if job.done():
                return job.result()
            twice = [line for address, line in router.doubled.items() if router.vehicles[address] in vehicles]
            if not twice:
                since_s = loop.time()
            elif loop.time() - since_s > DOUBLED_S:
                raise VehicleError("; ".join(twice))
    finally:
        job.cancel()
        await asyncio.gather(job, return_exceptions=True)


def unfit_links(router: Router, vehicles: Sequence[Vehicle], least_pace: float = 0.0) -> str | None:
    """Return in one line why these vehicles must not be armed, with its figures; None: their links are good enough.

    Two vehicles under one id come first, with the addresses that they speak from; then links that lose or delay too
    much, see `LinkQuality.unfit`, those with the same figures together; then clocks that run slower than a share of
    real time: a machine that starves simulators.
    """
    doubled = router.doubled
    twice = [doubled[vehicle.address] for vehicle in vehicles if vehicle.address in doubled]
    by_reason: dict[str, list[VehicleAddress]] = {}
    for vehicle in vehicles:
        reason = vehicle.timing.quality.unfit()
        if reason is not None:
            by_reason.setdefault(reason, []).append(vehicle.address)
    bad = [f"{vehicles_named(addresses)} ({reason})" for reason, addresses in by_reason.items()]
    lines = [*twice, *([f"the link is too bad to fly over: {', '.join(bad)}"] if bad else [])]
    slowest = min(vehicles, key=_pace)
    if _pace(slowest) < least_pace:
        lines.append(
            f"the machine is too slow for these simulators: the clock of vehicle {slowest.address} runs at "
            f"{_pace(slowest):.3f} of real time (least {least_pace:g}); fly fewer, or all the same with "
            "--slow-machine-ok"
        )
    return "; ".join(lines) or None


def _pace(vehicle: Vehicle) -> float:
    """Return how fast a vehicle's clock goes; infinite where it is not known."""
    pace = vehicle.timing.pace()
    return math.inf if math.isnan(pace) else pace
