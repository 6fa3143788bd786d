"""Whether the links of a swarm are good enough to fly over: asked before arming."""

from __future__ import annotations

from collections.abc import Sequence

from fg_gcs.link.router import Router
from fg_gcs.wire.address import VehicleAddress, vehicles_named
from fg_gcs.wire.vehicle import Vehicle


def unfit_links(router: Router, vehicles: Sequence[Vehicle]) -> str | None:
    """Return in one line why these vehicles must not be armed, with its figures; None: their links are good enough.

    Two vehicles under one id come first, with the addresses that they speak from; then links that lose or delay too
    much, see `LinkQuality.unfit`, those with the same figures together.
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
    return "; ".join(lines) or None
