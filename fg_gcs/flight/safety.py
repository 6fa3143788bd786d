"""What is watched during flight: facts in, findings and faults out; what follows from them says the policy."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from fg_gcs.core.arrays import Array
from fg_gcs.flight.located import POSITION_SIGMA_M, Located
from fg_gcs.flight.policy import Fault, FaultKind
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.rules import outside, too_close
from fg_gcs.wire.address import VehicleAddress, vehicles_named
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.vehicle import Vehicle

FENCE_SLACK_M: Final = 0.5  # plans may touch the fence; a vehicle's tracking error is not yet a breach
STALE_S: Final = 0.5  # positions older than this say nothing about the distance of a pair
SPARE_S: Final = 0.5  # on top of a vehicle's own time-out, before it is given up
OUTAGE_S: Final = 2.2  # a link that is out for two seconds is waited for, whatever the vehicle's own time-out is
ASKED_S: Final = 0.1  # between two requests for a vehicle's time, by whose answers it is known to hear us
MOST_ASKED_HZ: Final = 1000.0  # of all vehicles together: answers of a large swarm would take more than flying it
LAG_S: Final = 0.8  # of the way that a vehicle flies in so much time it may be behind: PX4 with its default drag
FAILSAFE_WORDS: Final = ("failsafe",)  # in the texts in which autopilots tell of their own
FAILSAFE_S: Final = 3.0  # such a text tells of a mode that changed no longer before

_ONE: Final[Mapping[FaultKind, str]] = MappingProxyType(
    {
        FaultKind.SILENT: "is silent",
        FaultKind.LOST: "is lost: nothing is heard from it",
        FaultKind.STUCK: "does not tell where it is any more",
        FaultKind.UNANSWERED: "does not seem to hear us",
        FaultKind.OFF_COURSE: "is off its course",
        FaultKind.DEAF: "does not fly where it is told to",
        FaultKind.TAKEN: "is taken over: something else changed its mode",
        FaultKind.OWN_FAILSAFE: "has a failsafe of its own",
        FaultKind.DISARMED: "disarmed in flight",
        FaultKind.FENCE: "is outside the fence",
        FaultKind.ORIGIN: "has a local frame that moves: it has gone",
        FaultKind.BATTERY: "has a low battery",
    }
)
_MANY: Final[Mapping[FaultKind, str]] = MappingProxyType(
    {
        FaultKind.SILENT: "are silent",
        FaultKind.LOST: "are lost: nothing is heard from them",
        FaultKind.STUCK: "do not tell where they are any more",
        FaultKind.UNANSWERED: "do not seem to hear us",
        FaultKind.OFF_COURSE: "are off their course",
        FaultKind.DEAF: "do not fly where they are told to",
        FaultKind.TAKEN: "are taken over: something else changed their modes",
        FaultKind.OWN_FAILSAFE: "have failsafes of their own",
        FaultKind.DISARMED: "disarmed in flight",
        FaultKind.FENCE: "are outside the fence",
        FaultKind.ORIGIN: "have local frames that move: they have gone",
        FaultKind.BATTERY: "have low batteries",
    }
)


class Bounds(NamedTuple):
    """From when on something is a fault."""

    silent_s: float = 0.5  # without a message, or without a position [s]
    off_course_m: float = 1.5  # distance from where a vehicle is told to be [m]
    battery_low: float = 0.15  # share left; real autopilots warn at 10 to 15 %


class Picture(NamedTuple):
    """The fleet at one instant; rows are those of the fleet."""

    vehicles: Sequence[Vehicle]
    rows: Sequence[int]  # of the vehicles that fly for us: they are looked at, others are nobody's alarm
    located: Located  # where they are now, with age and uncertainty
    told_enu_m: Array  # (V, 3) where they are told to be; NaN: nothing is streamed [m]
    told_speed_m_s: Array  # (V,) the greatest that they were told to fly at within the last second [m/s]
    now_s: float

    @property
    def positions_enu_m(self) -> Array:
        """Where they are now, shape (V, 3) [m]."""
        return self.located.position_enu_m


class Finding(NamedTuple):
    """One vehicle, or pair of vehicles, with which something is wrong now."""

    kind: FaultKind
    vehicles: tuple[VehicleAddress, ...]
    detail: str = ""  # what is told of it beside its kind
    size: float = 0.0  # distance outside the fence, of the pair, from the course, or of a frame's way [m]; share left


def findings(picture: Picture, rules: Rules, bounds: Bounds) -> list[Finding]:
    """Return what is wrong with vehicles that should be flying a plan.

    Args:
        picture: the fleet now.
        rules: separation and fence.
        bounds: of silence, courses and batteries.
    """
    found = [finding for row in picture.rows for finding in _of_one(picture, row, bounds)]
    rows = np.array(picture.rows, dtype=int)
    fresh = rows[picture.located.age_s[rows] < STALE_S].tolist()
    places = picture.positions_enu_m[fresh]
    unsure_m = picture.located.sigma_m[fresh] - POSITION_SIGMA_M  # by age: what is noise in every sample stays
    for (first, second), distance_m in _close_pairs(places, rules.separation_m):
        if distance_m + unsure_m[first] + unsure_m[second] >= rules.separation_m:
            continue
        pair = picture.vehicles[fresh[first]].address, picture.vehicles[fresh[second]].address
        found.append(Finding(FaultKind.SEPARATION, pair, size=distance_m))
    for row, excess_m in zip(fresh, (rules.fence.excess_m(places) - unsure_m).tolist(), strict=True):
        if outside(excess_m - FENCE_SLACK_M):
            found.append(Finding(FaultKind.FENCE, (picture.vehicles[row].address,), size=excess_m))
    return found


def _of_one(picture: Picture, row: int, bounds: Bounds) -> Iterator[Finding]:
    """Yield what is wrong with one vehicle by itself."""
    vehicle, now_s = picture.vehicles[row], picture.now_s
    address = (vehicle.address,)
    silent_s = now_s - vehicle.heard_at_s
    delay_s = delay_of(vehicle)
    error_m = float(np.linalg.norm(picture.told_enu_m[row] - picture.positions_enu_m[row]))
    given_up_s = max(vehicle.stream_timeout_s + SPARE_S, OUTAGE_S)
    patient_s = unanswered_s(vehicle, bounds.silent_s, len(picture.vehicles))
    if silent_s > given_up_s + delay_s:
        yield Finding(FaultKind.LOST, address)
        return
    if silent_s > bounds.silent_s + delay_s:
        yield Finding(FaultKind.SILENT, address)
    elif picture.located.age_s[row] > given_up_s + delay_s:
        yield Finding(FaultKind.LOST, address)
    elif picture.located.age_s[row] > bounds.silent_s + delay_s:
        yield Finding(FaultKind.STUCK, address)
    elif now_s - vehicle.timing.heard_us_s > patient_s:  # never true while not known
        deaf = now_s - vehicle.timing.heard_us_s > given_up_s - bounds.silent_s + patient_s
        yield Finding(FaultKind.DEAF if deaf else FaultKind.UNANSWERED, address, size=error_m)
    if vehicle.phase is Phase.TAKEN:
        kind = FaultKind.OWN_FAILSAFE if tells_of_failsafe(vehicle, now_s) else FaultKind.TAKEN
        yield Finding(kind, address, vehicle.mode_name)
    elif vehicle.phase is Phase.LANDED:
        yield Finding(FaultKind.DISARMED, address)
    elif error_m > bounds.off_course_m + LAG_S * picture.told_speed_m_s[row]:  # never true while not known
        yield Finding(FaultKind.OFF_COURSE, address, size=error_m)
    if vehicle.battery.remaining < bounds.battery_low:  # never true while unknown
        yield Finding(FaultKind.BATTERY, address, size=vehicle.battery.remaining)


def delay_of(vehicle: Vehicle) -> float:
    """Return how long its messages take on their way, as far as that is known [s]."""
    quality = vehicle.timing.quality
    delay_s = quality.delay_s + quality.jitter_s
    return delay_s if math.isfinite(delay_s) else 0.0


def asked_s(swarm: int) -> float:
    """Return the time between two requests for one vehicle's time in a swarm of so many [s]."""
    return max(ASKED_S, swarm / MOST_ASKED_HZ)


def unanswered_s(vehicle: Vehicle, silent_s: float, swarm: int) -> float:
    """Return how long a vehicle that hears us may leave requests for its time without an answer [s].

    Args:
        vehicle: with what is known of its link.
        silent_s: the least [s].
        swarm: how many vehicles are asked, see :func:`asked_s`.
    """
    return max(silent_s, asked_s(swarm) * vehicle.timing.quality.misses) + 2.0 * delay_of(vehicle)


def tells_of_failsafe(vehicle: Vehicle, now_s: float) -> bool:
    """Say whether a vehicle tells that a failsafe of its own has changed its mode."""
    return any(
        word in text.text.lower()
        for text in vehicle.recent_texts
        if now_s - text.at_s < FAILSAFE_S
        for word in FAILSAFE_WORDS
    )


def faults(found: Iterable[Finding], rules: Rules, now_s: float = 0.0) -> list[Fault]:
    """Return findings of one kind as one fault: a swarm that has one fault gives one line.

    Args:
        found: see :func:`findings`.
        rules: separation and fence.
        now_s: since when it is so [s].
    """
    by_kind: dict[FaultKind, list[Finding]] = {kind: [] for kind in FaultKind}
    for finding in found:
        by_kind[finding.kind].append(finding)
    return [
        Fault(
            kind,
            tuple(sorted({address for one in of_kind for address in one.vehicles})),
            _text(of_kind, rules),
            now_s,
            (min if kind in (FaultKind.SEPARATION, FaultKind.BATTERY) else max)(one.size for one in of_kind),
        )
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
    if kind is FaultKind.SEPARATION:
        worst = min(found, key=lambda one: one.size)
        first, second = worst.vehicles
        text = f"vehicles {first} and {second} are {worst.size:.2f} m apart (minimum {rules.separation_m:.2f} m)"
        others = len(found) - 1
        pairs = "one other pair" if others == 1 else f"{others} other pairs"
        return f"{text}; with {pairs} of {vehicles_named(addresses)} it is likewise" if others else text
    text = f"{vehicles_named(addresses)} {(_ONE if len(addresses) == 1 else _MANY)[kind]}"
    match kind:
        case FaultKind.TAKEN | FaultKind.OWN_FAILSAFE:
            return f"{text} ({', '.join(sorted({one.detail for one in found}))})"
        case FaultKind.ORIGIN:
            return f"{text} {'' if len(found) == 1 else 'up to '}{max(one.size for one in found):.1f} m"
        case FaultKind.FENCE | FaultKind.OFF_COURSE:
            return f"{text} by {'' if len(found) == 1 else 'up to '}{max(one.size for one in found):.1f} m"
    return text
