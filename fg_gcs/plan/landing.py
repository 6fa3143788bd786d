"""Verified landing from anywhere: vehicles part until the air below each is clear of the others, then all come down.

Landing itself is the autopilots': straight down, each at its own speed. Two vehicles that are far enough apart
horizontally keep apart whatever those are, so that is what parting has to bring about, on lines that are verified as
those of any plan.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import Fence
from fg_gcs.errors import PlanError
from fg_gcs.plan.keep_clear import Column, keeps_clear
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.path.swarm_path import LinePath
from fg_gcs.plan.rules import ROUNDING, too_close
from fg_gcs.plan.trajectory import Trajectory, timed
from fg_gcs.plan.transit import CLEARANCE, SAME_PLACE_M, closest_in_step

DRIFT_M = 0.5  # how far a vehicle may drift while it lands: real PX4 wanders by 0.3 m, and two may do so
ROUNDS = 400  # of pushing apart; a formation of nine needs some ten
PUSH = 0.55  # share of what is missing that each of a pair is moved by: a little more than half, so that it ends
MOST_STOPS = 8  # on the way to where vehicles land
WIDENINGS = (1.0, 1.3, 1.7, 2.2, 3.0)  # of the spacing of the grids that are tried when pushing apart does not do


def spacing_m(rules: Rules) -> float:
    """Return how far apart vehicles are to be horizontally before they land [m]."""
    return max(CLEARANCE * rules.separation_m, rules.separation_m + max(DRIFT_M, rules.room_m))


def part(
    position_enu_m: Array, rules: Rules, columns: Sequence[Column] = (), apart_m: float | None = None
) -> tuple[Trajectory, ...]:
    """Return how vehicles part, so that each can come straight down; nothing if they can already.

    Args:
        position_enu_m: where they rest, shape (V, 3) [m; ENU].
        rules: limits, separation and fence; heights stay as they are, outside the fence as well.
        columns: what is kept clear; where nothing else is possible, by less than the separation.
        apart_m: how far apart they are to be horizontally; None: as far as landing needs [m].

    Raises:
        PlanError: there are no places in the fence, or no lines to them that keep apart.
    """
    if apart_m is None:
        if rules.room_m > DRIFT_M:
            with suppress(PlanError):
                return part(position_enu_m, rules, columns, spacing_m(rules))
        apart_m = spacing_m(replace(rules, room_m=0.0))
    needed_m = apart_m
    if _is_parted(position_enu_m, needed_m, columns, rules.separation_m):
        return ()
    now = closest_in_step(position_enu_m, position_enu_m).distance_m
    least_m = min(rules.separation_m, now)  # a pair that is too close already must part, and come no closer
    is_room = False
    for clear_m in clearings_m(rules) if columns else (rules.separation_m,):
        for trail in _trails(position_enu_m, needed_m, rules, columns, clear_m):
            if not _is_parted(trail[-1], needed_m, columns, clear_m):
                continue
            is_room = True
            stops = _shortened(trail, columns, clear_m, least_m)
            if stops is not None:
                return tuple(timed(LinePath(start, end), rules.limits) for start, end in pairwise(stops))
    count = len(position_enu_m)
    if not is_room:
        raise PlanError(f"there is no room in the fence for {count} places {needed_m:.2f} m apart to land")
    raise PlanError(f"no straight lines to {count} places to land keep {least_m:.2f} m apart")


def clearings_m(rules: Rules) -> tuple[float, ...]:
    """Return how far what has to be kept clear is kept away from, the best first [m]; its own radius comes on top."""
    return rules.separation_m, 0.5 * rules.separation_m


def _shortened(trail: Sequence[Array], columns: Sequence[Column], clear_m: float, least_m: float) -> list[Array] | None:
    """Return places from the first of a trail to its last, as few as lines between them allow; None: there are none."""
    stops, at = [trail[0]], 0
    while at < len(trail) - 1:
        ahead = len(trail) - 1
        while ahead > at and not _leads(trail[at], trail[ahead], columns, clear_m, least_m, ahead < len(trail) - 1):
            ahead = at + (ahead - at) // 2
        if ahead == at or len(stops) > MOST_STOPS:
            return None
        at = ahead
        stops.append(trail[at])
    return stops


def _leads(
    start_m: Array, end_m: Array, columns: Sequence[Column], clear_m: float, least_m: float, leads_on: bool
) -> bool:
    """Say whether straight lines keep apart and clear."""
    if too_close(closest_in_step(start_m, end_m).distance_m, least_m):
        return False
    return keeps_clear(start_m, end_m, columns, clear_m, leads_on=leads_on)


def with_room(rules: Rules, position_enu_m: Array) -> Rules:
    """Return rules that vehicles keep where they are, shape (V, 3): who is outside the fence has to come down too."""
    low = np.minimum(rules.fence.low_enu_m, position_enu_m.min(axis=0)).tolist()
    high = np.maximum(rules.fence.high_enu_m, position_enu_m.max(axis=0)).tolist()
    now_m = closest_in_step(position_enu_m, position_enu_m).distance_m
    return Rules(rules.limits, min(rules.separation_m, now_m), Fence(tuple(low), tuple(high)))


def _is_parted(places_m: Array, needed_m: float, columns: Sequence[Column], clear_m: float) -> bool:
    """Say whether every vehicle can come straight down."""
    flat = places_m * (1.0, 1.0, 0.0)
    closest = closest_in_step(flat, flat).distance_m
    return closest >= needed_m * (1.0 - ROUNDING) and keeps_clear(flat, flat, columns, clear_m)


def _trails(
    position_m: Array, needed_m: float, rules: Rules, columns: Sequence[Column], clear_m: float
) -> Iterator[Sequence[Array]]:
    """Yield ways to sets of places, the ones that are near first, as places on them, each of shape (V, 3) [m]."""
    low, high = np.array(rules.fence.low_enu_m[:2]), np.array(rules.fence.high_enu_m[:2])
    low, high = np.minimum(low, position_m[:, :2].min(axis=0)), np.maximum(high, position_m[:, :2].max(axis=0))
    for turn_rad in (0.0, 1.0, 2.0):
        yield _pushed_apart(position_m, needed_m, (low, high), columns, clear_m, turn_rad)
    for widening in WIDENINGS:
        yield position_m, _on_grid(position_m, widening * needed_m, (low, high), columns, clear_m)
    # Each in a direction of its own, the higher the further: for those that stand above each other
    order = np.argsort(np.argsort(position_m[:, 2]))
    turns = 2.0 * np.pi * order / len(position_m)
    reach_m = needed_m / (2.0 * np.sin(np.pi / max(len(position_m), 3)))
    ring = position_m[:, :2].mean(axis=0) + reach_m * np.stack((np.cos(turns), np.sin(turns)), axis=1)
    yield position_m, np.column_stack((np.clip(ring, low, high), position_m[:, 2]))


def _pushed_apart(
    position_m: Array,
    needed_m: float,
    box: tuple[Array, Array],
    columns: Sequence[Column],
    clear_m: float,
    turn_rad: float,
) -> list[Array]:
    """Places on the way of pushing all pairs apart that are too close, and all out of the columns."""
    places, count = position_m.copy(), len(position_m)
    turns = turn_rad + 2.0 * np.pi * np.arange(count) * 0.381966  # golden angle: no two directions alike
    own_way = np.stack((np.cos(turns), np.sin(turns)), axis=1)
    trail, wanted_m = [places.copy()], needed_m * 1.02
    for _ in range(ROUNDS):
        gaps = places[:, None, :2] - places[None, :, :2]
        distances = np.linalg.norm(gaps, axis=2)
        alike = distances < SAME_PLACE_M
        gaps[alike] = (own_way[:, None] - own_way[None, :])[alike]
        ways = gaps / np.maximum(np.linalg.norm(gaps, axis=2), SAME_PLACE_M)[..., None]
        missing = np.maximum(wanted_m - distances, 0.0)
        np.fill_diagonal(missing, 0.0)
        moves = PUSH * (missing[..., None] * ways).sum(axis=1)
        outwards = _out_of(places, own_way, columns, clear_m * 1.05)
        inside = np.linalg.norm(outwards, axis=1) > SAME_PLACE_M
        moves[inside] *= 0.2  # first of all out of the columns
        moves += outwards
        if not moves.any():
            break
        places[:, :2] = np.clip(places[:, :2] + moves, *box)
        trail.append(places.copy())
    return trail


def _out_of(places_m: Array, own_way: Array, columns: Sequence[Column], clear_m: float) -> Array:
    """Moves that lead out of the columns, shape (V, 2) [m]."""
    moves = np.zeros((len(places_m), 2))
    for column in columns:
        start, end = np.array(column.start_enu_m), np.array(column.end_enu_m)
        way = end - start
        share = np.clip((places_m[:, :2] - start) @ way / max(float(way @ way), SAME_PLACE_M**2), 0.0, 1.0)
        gaps = places_m[:, :2] - start - share[:, None] * way
        distances = np.linalg.norm(gaps, axis=1)
        gaps[distances < SAME_PLACE_M] = own_way[distances < SAME_PLACE_M]
        missing = np.maximum(clear_m + column.radius_m - distances, 0.0)
        moves += missing[:, None] * gaps / np.linalg.norm(gaps, axis=1)[:, None]
    return moves


def _on_grid(
    position_m: Array, step_m: float, box: tuple[Array, Array], columns: Sequence[Column], clear_m: float
) -> Array:
    """Places of a square grid about the swarm, each vehicle's as near as it can be without crossings, shape (V, 3)."""
    grid = grid_m(position_m[:, :2].mean(axis=0), step_m, len(position_m), box)
    points = np.column_stack((grid, np.zeros(len(grid))))
    grid = grid[[keeps_clear(point[None], point[None], columns, clear_m) for point in points]]
    if len(grid) < len(position_m):
        return position_m
    vehicle, place = linear_sum_assignment(cdist(position_m[:, :2], grid, "sqeuclidean"))
    return np.column_stack((grid[place[np.argsort(vehicle)]], position_m[:, 2]))


def grid_m(centre_m: Array, step_m: float, count: int, box: tuple[Array, Array]) -> Array:
    """Return places of a square grid about a centre, inside a box, more than a number of them, shape (P, 2) [m]."""
    half = int(np.ceil(np.sqrt(count))) + 1
    ticks = step_m * np.arange(-half, half + 1)
    grid = np.stack(np.meshgrid(centre_m[0] + ticks, centre_m[1] + ticks), axis=-1).reshape(-1, 2)
    inside: Array = grid[((grid >= box[0]) & (grid <= box[1])).all(axis=1)]
    return inside
