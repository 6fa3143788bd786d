"""What is watched during flight, and what follows from it: facts in, faults out, and one table of consequences."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import Separation, closest_approach
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.rules import outside, too_close
from fg_gcs.wire.address import VehicleAddress
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.vehicle import Vehicle

FENCE_SLACK_M = 0.5  # plans may touch the fence; a vehicle's tracking error is not yet a breach
BATTERY_LOW = 0.15  # share left; real autopilots warn at 10 to 15 %
STALE_S = 0.5  # positions older than this say nothing about the distance of a pair


class Kind(Enum):
    """What can go wrong in flight."""

    LOST = "is lost: nothing is heard from it"
    TAKEN = "is taken over: something else changed its mode"
    DISARMED = "disarmed in flight"
    SEPARATION = "are closer than the minimum separation"
    FENCE = "is outside the fence"
    BATTERY = "has a low battery"


class Action(Enum):
    """What the flight does about a fault."""

    ABORT = "every vehicle that still obeys stops, flies home on checked lines and lands"
    REPORT = "it is reported, and the flight goes on"


CONSEQUENCES: dict[Kind, Action] = {
    Kind.LOST: Action.ABORT,
    Kind.TAKEN: Action.ABORT,  # whoever took it keeps it, and without it the formation verifies nothing
    Kind.DISARMED: Action.ABORT,
    Kind.SEPARATION: Action.ABORT,
    Kind.FENCE: Action.ABORT,
    Kind.BATTERY: Action.REPORT,  # simulated ones fly on at 0 %, and the way home is part of every flight
}


class Fault(NamedTuple):
    """Something that is wrong now."""

    kind: Kind
    vehicles: tuple[VehicleAddress, ...]
    text: str  # one line for people


def faults(vehicles: Sequence[Vehicle], positions_enu_m: Array, rules: Rules, now_s: float) -> list[Fault]:
    """Return what is wrong with vehicles that should be flying a plan.

    Args:
        vehicles: the fleet.
        positions_enu_m: where they are, shape (V, 3) [m].
        rules: separation and fence.
        now_s: the clock's reading [s].
    """
    found = []
    for phase, kind in ((Phase.LOST, Kind.LOST), (Phase.TAKEN, Kind.TAKEN), (Phase.LANDED, Kind.DISARMED)):
        for vehicle in vehicles:
            if vehicle.phase is phase:
                mode = f" ({vehicle.mode_name})" if kind is Kind.TAKEN else ""
                found.append(Fault(kind, (vehicle.address,), f"vehicle {vehicle.address} {kind.value}{mode}"))
    for vehicle in vehicles:
        if vehicle.battery.remaining < BATTERY_LOW:  # never true while unknown
            found.append(Fault(Kind.BATTERY, (vehicle.address,), f"vehicle {vehicle.address} {Kind.BATTERY.value}"))
    fresh = [row for row, vehicle in enumerate(vehicles) if now_s - vehicle.position_at_s < STALE_S]
    if len(fresh) > 1:
        nearest = closest_approach(positions_enu_m[None, fresh], np.zeros(1))
        if too_close(nearest.distance_m, rules.separation_m):
            found.append(_too_close([vehicles[row].address for row in fresh], nearest, rules))
    for row in fresh:
        excess_m = float(rules.fence.excess_m(positions_enu_m[row]))
        if outside(excess_m - FENCE_SLACK_M):
            address = vehicles[row].address
            found.append(Fault(Kind.FENCE, (address,), f"vehicle {address} {Kind.FENCE.value} by {excess_m:.1f} m"))
    return found


def _too_close(addresses: Sequence[VehicleAddress], nearest: Separation, rules: Rules) -> Fault:
    first, second = (addresses[index] for index in nearest.pair)
    text = f"vehicles {first} and {second} are {nearest.distance_m:.2f} m apart (minimum {rules.separation_m:.2f} m)"
    return Fault(Kind.SEPARATION, (first, second), text)
