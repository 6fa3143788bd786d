"""How a swarm comes down by itself when its ground station is gone: on the spot, or home at heights of their own.

Without us every vehicle brakes and lands where it is, which is safe where nobody is above another. In an upright
formation somebody is. There each returns instead: all hover, climb together, each to a height of its own, fly home on
straight lines, wait above their pads until all have arrived, and come down onto them. Heights go by the order of the
vehicles' heights in the formation, from the lowest to the highest, so that nobody climbs through another one. What
comes of it is computed from many moments of a flight.
They return only where landing brings two too near to each other from some moment on: it is the simpler thing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np

from fg_gcs.compiling import long_kernel
from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import Fence
from fg_gcs.plan.verification import CheckedPlan

MOMENTS: Final = 120  # of a flight, at which its station may be gone; fewer of a large swarm
MOST_PAIRS: Final = 60_000  # of vehicles and moments together
STEP_S: Final = 0.25
BRAKES_M_S2: Final = 2.0  # what vehicles brake by without setpoints: ArduCopter's default
SINK_M_S, SLOW_SINK_M_S = 1.5, 0.7  # speeds of a landing above and below HIGH_M: PX4's, ArduPilot's are no higher
HIGH_M: Final = 7.5
CLIMB_M_S: Final = 2.5
CRUISE_M_S: Final = 5.0  # PX4's; ArduCopter's is 10
SLOWEST: Final = 2.0  # times slower some may be: that is waited for
WAITED_S: Final = (5.0, 60.0)  # that vehicles wait above their pads, at least and at most
ABOVE_M: Final = 2.0  # that the lowest return is above the highest point of the flight
LEVELS: Final = (1.1, 1.5)  # times the separation between two returns: autopilots' heights are off by some decimetres
ON_GROUND_M: Final = 0.3
LEAST_M: Final = 0.8  # two vehicles come no closer by themselves: half a metre, and what they drift by


class Vanished(NamedTuple):
    """What becomes of a swarm whose station is gone, from any of some moments of a flight on.

    Attributes:
        closest_m: that two of its vehicles come to each other [m].
        pair: those two, by their rows.
        stage: in which part of the flight the station is gone then.
        after_s: how long after the beginning of that part [s].
        bad: share of the moments from which two come closer than they may, 0 to 1.
    """

    closest_m: float
    pair: tuple[int, int]
    stage: str
    after_s: float
    bad: float


class ByThemselves(NamedTuple):
    """What vehicles do that hear nothing any more.

    Attributes:
        vanished: what comes of it.
        landing: what came of it if they all landed where they are.
        heights_m: at which each returns, shape (V,) [m; above the ground]; None: they land where they are.
        waits_s: how long each waits above its pad before it comes down [s].
    """

    vanished: Vanished
    landing: Vanished
    heights_m: Array | None = None
    waits_s: float = 0.0


def by_themselves(
    parts: Mapping[str, CheckedPlan], pads_enu_m: Array, fence: Fence, separation_m: float, least_m: float = LEAST_M
) -> ByThemselves:
    """Return how a swarm best comes down by itself.

    Args:
        parts: of the flight, by their names; vehicles are around the target at the end of the ``approach``.
        pads_enu_m: where the vehicles stand, shape (V, 3) [m; ENU].
        fence: whose ceiling returns stay under.
        separation_m: between vehicles that fly as planned [m].
        least_m: that two of them may come to each other here [m].
    """
    moments = _moments(parts)
    landing = _vanished(moments, _landing(moments.stops), least_m)
    if landing.bad == 0.0:
        return ByThemselves(landing, landing)
    found = [ByThemselves(landing, landing)]
    for heights_m in _heights(parts["approach"], moments.stops, fence, separation_m):
        ways_m = np.linalg.norm(moments.stops[..., :2] - pads_enu_m[:, :2], axis=-1)
        arrive_s = np.maximum(heights_m - moments.stops[..., 2], 0.0) / CLIMB_M_S + ways_m / CRUISE_M_S
        spread_s = SLOWEST * float((arrive_s.max(axis=1) - arrive_s.min(axis=1)).max())
        waits_s = min(WAITED_S[0] + spread_s, WAITED_S[1])
        returning = _vanished(moments, _returning(moments.stops, pads_enu_m, heights_m, waits_s), least_m)
        found.append(ByThemselves(returning, landing, heights_m, waits_s))
    return min(found, key=lambda each: each.vanished.bad)  # of those that are equally good the first


def _heights(approach: CheckedPlan, stops: Array, fence: Fence, separation_m: float) -> Iterator[Array]:
    """Yield heights to return at that may do, shape (V,) [m]: all above the whole flight, or as low as each can."""
    last = approach.sample(np.array([approach.duration_s])).position_m[0]
    order = np.argsort(last[:, 2], kind="stable")
    ceiling_m, most_m, least_m = fence.high_enu_m[2], LEVELS[1] * separation_m, LEVELS[0] * separation_m
    own_m = stops[..., 2].max(axis=0)
    heights_m, lowest_m = np.empty(len(order)), float(own_m.max()) + ABOVE_M
    step_m = min(most_m, (ceiling_m - lowest_m) / max(len(order) - 1, 1))
    if step_m >= least_m:
        heights_m[order] = lowest_m + step_m * np.arange(len(order))
        yield heights_m
    heights_m, below_m = np.empty(len(order)), -np.inf
    for row in order.tolist():
        heights_m[row] = below_m = max(own_m[row], below_m + least_m)
    if below_m <= ceiling_m:
        yield heights_m


class _Moments(NamedTuple):
    """Moments of a flight, and where vehicles come to rest that hear nothing any more from then on."""

    stages: tuple[str, ...]  # T of them
    after_s: Array  # (T,)
    stops: Array  # (T, V, 3) [m]


def _moments(parts: Mapping[str, CheckedPlan]) -> _Moments:
    vehicles = parts["approach"].sample(np.zeros(1)).position_m.shape[1]
    count = max(3, min(MOMENTS, MOST_PAIRS // max(1, vehicles * (vehicles - 1) // 2)))
    whole_s = sum(part.duration_s for part in parts.values())
    stages, after_s, stops = [], [], []
    for name, part in parts.items():
        moments = np.linspace(0.0, part.duration_s, 2 + int(count * part.duration_s / whole_s))
        sample = part.sample(moments)
        speeds = np.linalg.norm(sample.velocity_m_s, axis=-1, keepdims=True)
        stops.append(sample.position_m + sample.velocity_m_s * speeds / (2.0 * BRAKES_M_S2))
        stages += [name] * len(moments)
        after_s.append(moments)
    return _Moments(tuple(stages), np.concatenate(after_s), np.concatenate(stops))


def _landing(stops: Array) -> list[Array]:
    """Return where vehicles are that land where they have come to rest, step by step, (T, V, 3) each [m]."""
    places, steps = stops.copy(), [stops]
    while (places[..., 2] > 0.0).any():
        places = places.copy()
        places[..., 2] -= STEP_S * np.where(places[..., 2] > HIGH_M, SINK_M_S, SLOW_SINK_M_S)
        places[..., 2] = np.maximum(places[..., 2], 0.0)
        steps.append(places)
    return steps


def _returning(stops: Array, pads_enu_m: Array, heights_m: Array, waits_s: float) -> list[Array]:
    """Return likewise where they are that return, each at a height of its own."""
    places, steps = stops.copy(), [stops]
    waited_s = np.zeros(stops.shape[:2])
    while (waited_s <= waits_s).any():
        places = places.copy()
        low = places[..., 2] < heights_m - 0.1
        places[..., 2] = np.where(low, np.minimum(places[..., 2] + STEP_S * CLIMB_M_S, heights_m), places[..., 2])
        way = pads_enu_m[:, :2] - places[..., :2]
        left_m = np.linalg.norm(way, axis=-1)
        share = np.where(low, 0.0, np.minimum(STEP_S * CRUISE_M_S / np.maximum(left_m, 1e-9), 1.0))
        places[..., :2] += share[..., None] * way
        waited_s += STEP_S * (~low & (left_m < 1.0))
        steps.append(places)
    return steps + _landing(places)


def _vanished(moments: _Moments, steps: list[Array], least_m: float) -> Vanished:
    """Return how near vehicles come."""
    nearest = _nearest_pairs(np.ascontiguousarray(np.stack(steps, axis=2)))
    moment = int(nearest[:, 0].argmin())
    closest_m, first, second = nearest[moment].tolist()
    bad = float((nearest[:, 0] < least_m).mean())
    stage, after_s = moments.stages[moment], float(moments.after_s[moment])
    return Vanished(closest_m, (int(first), int(second)), stage, after_s, bad)


@long_kernel
def _nearest_pairs(ways: Array) -> Array:
    """Return the least distance of two ways, not both on the ground, and whose they are.

    Args:
        ways: of every vehicle from every moment on, shape (T, V, S, 3) [m; above the ground].

    Returns:
        Distance [m] and both rows for each moment, shape (T, 3).
    """
    vehicles, steps = ways.shape[1], ways.shape[2]
    nearest = np.zeros((len(ways), 3))
    for moment in range(len(ways)):
        least = np.inf
        for first in range(vehicles):
            for second in range(first + 1, vehicles):
                way, other = ways[moment, first], ways[moment, second]
                for j in range(steps):
                    if way[j, 2] > ON_GROUND_M or other[j, 2] > ON_GROUND_M:
                        square = 0.0
                        for k in range(3):
                            square += (way[j, k] - other[j, k]) ** 2
                        if square < least:
                            least = square
                            nearest[moment, 1], nearest[moment, 2] = first, second
        nearest[moment, 0] = math.sqrt(least)
    return nearest
