"""Between pads and formation: who goes where, on straight lines that verifiably keep apart.

All vehicles fly straight lines in step, so a pair's relative position runs along a line too and its closest approach
has a closed form. When starts and ends are assigned to each other by the least sum of squared distances, two vehicles
never come closer than ``1/sqrt(2)`` of the smaller spacing at the ends ([Turpin2014]_). The formation may be tighter
than that allows: then it is first opened about its centre, just as far as the lines need. Opening a formation brings no
pair closer.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import Separation, closest_approach
from fg_gcs.errors import PlanError
from fg_gcs.plan.keep_clear import Column, clearances_m, keeps_clear
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.path.swarm_path import LinePath
from fg_gcs.plan.rules import too_close
from fg_gcs.plan.trajectory import Trajectory, timed

Indices = NDArray[np.intp]

CLEARANCE = 1.2  # lines are planned this many times wider than the minimum: room for tracking errors in flight
OPENINGS = np.arange(1.0, 4.01, 0.1)  # factors tried; beyond four the pads, not the formation, are too tight
ROOMS = (1.0, 0.5, 0.0)  # shares of the room for wander that lines keep, tried in their order
IN_PLACE: Array = np.zeros((1, 3))
SAME_PLACE_M = 1e-3  # a move shorter than this is none


class Transit(NamedTuple):
    """A collision-free way between two sets of places."""

    pieces: tuple[Trajectory, ...]
    goal_of: Indices  # (V,) vehicle v ends at place goal_of[v]


def gather(start_m: Array, slots_m: Array, rules: Rules) -> Transit:
    """Return the way from scattered places into a formation, shapes (V, 3) and (V, 3) [m; ENU].

    Raises:
        PlanError: no opening of the formation makes the lines collision-free.
    """
    slot_of, wide, _ = _open_out(slots_m, start_m, rules, ((), 0.0), IN_PLACE)
    ends = slots_m[slot_of]
    return Transit(_lines((start_m, wide[slot_of], ends), rules.limits), slot_of)


def scatter(
    formation_m: Array,
    goals_m: Array,
    rules: Rules,
    columns: Sequence[Column] = (),
    clear_m: float | None = None,
    shifts_m: Array = IN_PLACE,
) -> Transit:
    """Return the way from a formation to scattered places, shapes (V, 3) and (G, 3) with G >= V [m; ENU].

    Args:
        formation_m: where everybody is.
        goals_m: where to go; who goes where is chosen here, and of more places than vehicles the nearest.
        rules: limits, separation and fence.
        columns: what is kept clear on the way and at its end.
        clear_m: by how much; None: by the separation [m].
        shifts_m: by how much the opened formation may be moved before it parts, tried in their order, shape (S, 3) [m].

    Raises:
        PlanError: no opening of the formation makes the lines collision-free.
    """
    clear_m = rules.separation_m if clear_m is None else clear_m
    free = free_places(goals_m, clear_m, columns)
    if free.sum() < len(formation_m):
        raise PlanError(
            f"{len(formation_m)} vehicles have {int(free.sum())} places to go to: the others are where a vehicle that "
            "nobody commands may come down"
        )
    vehicle_of, wide, place_of = _open_out(formation_m, goals_m[free], rules, (columns, clear_m), shifts_m)
    goal_of = np.empty(len(formation_m), dtype=np.intp)
    goal_of[vehicle_of] = np.flatnonzero(free)[place_of]
    return Transit(_lines((formation_m, wide, goals_m[goal_of]), rules.limits), goal_of)


def free_places(places_m: Array, clear_m: float, columns: Sequence[Column]) -> NDArray[np.bool_]:
    """Say which places, shape (G, 3), are clear of all columns down to the ground: from there vehicles land [m]."""
    ground = places_m * (1.0, 1.0, 0.0)
    free = np.ones(len(places_m), dtype=bool)
    for column in columns:
        free &= clearances_m(ground, ground, column, clear_m) >= clear_m
    return free


def assigned(start_m: Array, goals_m: Array) -> Indices:
    """Return a goal for each start by the least sum of squared distances, shapes (V, 3) and (G, 3) to (V,).

    Raises:
        PlanError: there are fewer goals than starts.
    """
    if len(goals_m) < len(start_m):
        raise PlanError(f"{len(start_m)} vehicles have {len(goals_m)} places to go to")
    _, goal_of = linear_sum_assignment(cdist(start_m, goals_m, "sqeuclidean"))
    return goal_of


def _open_out(
    formation_m: Array, places_m: Array, rules: Rules, kept_clear: tuple[Sequence[Column], float], shifts_m: Array
) -> tuple[Indices, Array, Indices]:
    """Return pairs of a formation's member and a place, and the formation opened and moved as far as the lines need.

    An opened formation that would leave the fence is shifted back inside; a shift changes no distance in it.
    """
    centre = formation_m.mean(axis=0)
    least_m = CLEARANCE * rules.separation_m
    low, high = np.array(rules.fence.low_enu_m), np.array(rules.fence.high_enu_m)
    closest = Separation(np.inf, 0.0, (0, 0))
    rooms_m = sorted({max(least_m, rules.separation_m + share * rules.room_m) for share in ROOMS}, reverse=True)
    for needed_m, shift_m in product(rooms_m, shifts_m):
        for opening in OPENINGS:
            wide = centre + shift_m + opening * (formation_m - centre)
            wide = wide + np.maximum(low - wide.min(axis=0), 0.0) - np.maximum(wide.max(axis=0) - high, 0.0)
            place_of, member_of = linear_sum_assignment(cdist(places_m, wide, "sqeuclidean"))
            far = closest_in_step(places_m[place_of], wide[member_of])
            near = closest_in_step(wide, formation_m)  # opening parts every pair
            closest = min(far, near)
            clear = keeps_clear(formation_m, wide, *kept_clear, leads_on=True) and keeps_clear(
                wide[member_of], places_m[place_of], *kept_clear
            )
            if clear and not (too_close(far.distance_m, needed_m) or too_close(near.distance_m, rules.separation_m)):
                return member_of, wide, place_of
    blocked = ", or runs into where a vehicle that nobody commands may be" if kept_clear[0] else ""
    raise PlanError(
        f"no straight lines between pads and formation keep {least_m:.2f} m apart (with the widest opening they come "
        f"within {closest.distance_m:.2f} m{blocked}); place the pads or the slots further apart"
    )


def closest_in_step(start_m: Array, end_m: Array) -> Separation:
    """Closest approach of vehicles that fly straight and in step."""
    if len(start_m) < 2:
        return Separation(np.inf, 0.0, (0, 0))
    return closest_approach(np.stack((start_m, end_m)), np.array([0.0, 1.0]))


def _lines(places: tuple[Array, ...], limits: Limits) -> tuple[Trajectory, ...]:
    """Trajectories from place to place with a rest at each; moves of nothing are left out."""
    moves = [(a, b) for a, b in pairwise(places) if np.abs(a - b).max() > SAME_PLACE_M]
    return tuple(timed(LinePath(a, b), limits) for a, b in moves or [(places[0], places[-1])])
