"""What is watched during flight, and what follows from it: facts in, faults out, and one table of consequences."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from fg_gcs.core.arrays import Array
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.rules import outside, too_close
from fg_gcs.wire.address import VehicleAddress, vehicles_named
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


OF_MANY: dict[Kind, str] = {  # in the words for several vehicles, where they differ
    Kind.LOST: "are lost: nothing is heard from them",
    Kind.TAKEN: "are taken over: something else changed their modes",
    Kind.FENCE: "are outside the fence",
    Kind.BATTERY: "have low batteries",
}
BY_PHASE: dict[Phase, Kind] = {Phase.LOST: Kind.LOST, Phase.TAKEN: Kind.TAKEN, Phase.LANDED: Kind.DISARMED}


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


class Finding(NamedTuple):
    """One vehicle, or pair of vehicles, with which something is wrong now."""

    kind: Kind
    vehicles: tuple[VehicleAddress, ...]
    detail: str = ""  # what is told of it beside its kind
    size_m: float = 0.0  # distance outside the fence, or of the pair


class Fault(NamedTuple):
    """What is wrong in one way, with one vehicle or with many."""

    kind: Kind
    vehicles: tuple[VehicleAddress, ...]  # ascending
    text: str  # one line for people


def findings(
    vehicles: Sequence[Vehicle], positions_enu_m: Array, position_at_s: Array, rules: Rules, now_s: float
) -> list[Finding]:
    """Return what is wrong with vehicles that should be flying a plan.

    Args:
        vehicles: the fleet.
        positions_enu_m: where they are, shape (V, 3) [m].
        position_at_s: when they were there, shape (V,) [s].
        rules: separation and fence.
        now_s: the clock's reading [s].
    """
    found = [
        Finding(BY_PHASE[vehicle.phase], (vehicle.address,), vehicle.mode_name)
        for vehicle in vehicles
        if vehicle.phase in BY_PHASE
    ]
    found += [
        Finding(Kind.BATTERY, (vehicle.address,))
        for vehicle in vehicles
        if vehicle.battery.remaining < BATTERY_LOW  # never true while unknown
    ]
    fresh = np.flatnonzero(now_s - position_at_s < STALE_S).tolist()
    places = positions_enu_m[fresh]
    for (first, second), distance_m in _close_pairs(places, rules.separation_m):
        pair = vehicles[fresh[first]].address, vehicles[fresh[second]].address
        found.append(Finding(Kind.SEPARATION, pair, size_m=distance_m))
    for row, excess_m in zip(fresh, rules.fence.excess_m(places).tolist(), strict=True):
        if outside(excess_m - FENCE_SLACK_M):
            found.append(Finding(Kind.FENCE, (vehicles[row].address,), size_m=excess_m))
    return found


def faults(found: Iterable[Finding], rules: Rules) -> list[Fault]:
    """Return findings of one kind as one fault: a swarm that has one fault gives one line.

    Args:
        found: see :func:`findings`.
        rules: separation and fence.
    """
    by_kind: dict[Kind, list[Finding]] = {kind: [] for kind in Kind}
    for finding in found:
        by_kind[finding.kind].append(finding)
    return [
        Fault(kind, tuple(sorted({address for one in of_kind for address in one.vehicles})), _text(of_kind, rules))
        for kind, of_kind in by_kind.items()
        if of_kind
    ]


def _close_pairs(places_m: Array, separation_m: float) -> Iterator[tuple[tuple[int, int], float]]:
    """Yield the pairs that are closer than the minimum, and their distances [m]; places of shape (V, 3), all finite."""
    if len(places_m) < 2:
        return
    pairs = cKDTree(places_m).query_pairs(separation_m, output_type="ndarray")
    distances_m = np.linalg.norm(places_m[pairs[:, 0]] - places_m[pairs[:, 1]], axis=1)
    for (first, second), distance_m in sorted(zip(map(tuple, pairs.tolist()), distances_m.tolist(), strict=True)):
        if too_close(distance_m, separation_m):
            yield (first, second), distance_m


def _text(found: Sequence[Finding], rules: Rules) -> str:
    """Return the line that tells of findings of one kind."""
    kind, addresses = found[0].kind, sorted({address for one in found for address in one.vehicles})
    if kind is Kind.SEPARATION:
        worst = min(found, key=lambda one: one.size_m)
        first, second = worst.vehicles
        text = f"vehicles {first} and {second} are {worst.size_m:.2f} m apart (minimum {rules.separation_m:.2f} m)"
        others = len(found) - 1
        pairs = "one other pair" if others == 1 else f"{others} other pairs"
        return f"{text}; with {pairs} of {vehicles_named(addresses)} it is likewise" if others else text
    text = f"{vehicles_named(addresses)} {kind.value if len(addresses) == 1 else OF_MANY.get(kind, kind.value)}"
    match kind:
        case Kind.TAKEN:
            return f"{text} ({', '.join(sorted({one.detail for one in found}))})"
        case Kind.FENCE:
            return f"{text} by {'' if len(found) == 1 else 'up to '}{max(one.size_m for one in found):.1f} m"
    return text
