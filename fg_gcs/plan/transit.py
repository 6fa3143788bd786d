"""Between pads and formation: who goes where, on straight lines that verifiably keep apart.

All vehicles fly straight lines in step, so a pair's relative position runs along a line too and its closest approach
has a closed form. When starts and ends are assigned to each other by the least sum of squared distances, two vehicles
never come closer than ``1/sqrt(2)`` of the smaller spacing at the ends ([Turpin2014]_). The formation may be tighter
than that allows: then it is first opened about its centre, just as far as the lines need. Opening a formation brings no
pair closer.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import Separation, closest_approach
from fg_gcs.errors import PlanError
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.path.swarm_path import LinePath
from fg_gcs.plan.rules import too_close
from fg_gcs.plan.trajectory import Trajectory, timed

Indices = NDArray[np.intp]

CLEARANCE = 1.2  # lines are planned this many times wider than the minimum: room for tracking errors in flight
OPENINGS = np.arange(1.0, 4.01, 0.1)  # factors tried; beyond four the pads, not the formation, are too tight
NOTHING: Array = np.empty((0, 3))
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
    slot_of, wide = _open_out(slots_m, start_m, rules, NOTHING)
    ends = slots_m[slot_of]
    return Transit(_lines((start_m, wide[slot_of], ends), rules.limits), slot_of)


def scatter(formation_m: Array, goals_m: Array, rules: Rules, obstacles_m: Array = NOTHING) -> Transit:
    """Return the way from a formation to scattered places, shapes (V, 3) and (V, 3) [m; ENU].

    Args:
        formation_m: where everybody is.
        goals_m: where to go; who goes where is chosen here.
        rules: limits, separation and fence.
        obstacles_m: what stands still and is kept away from, shape (O, 3) [m].

    Raises:
        PlanError: no opening of the formation makes the lines collision-free.
    """
    vehicle_of, wide = _open_out(formation_m, goals_m, rules, obstacles_m)
    goal_of = np.argsort(vehicle_of)
    return Transit(_lines((formation_m, wide, goals_m[goal_of]), rules.limits), goal_of)


def _open_out(formation_m: Array, places_m: Array, rules: Rules, obstacles_m: Array) -> tuple[Indices, Array]:
    """Return which formation member each place belongs to, and the formation opened as far as the lines need.

    An opened formation that would leave the fence is shifted back inside; a shift changes no distance in it.
    """
    centre = formation_m.mean(axis=0)
    needed_m = CLEARANCE * rules.separation_m
    low, high = np.array(rules.fence.low_enu_m), np.array(rules.fence.high_enu_m)
    for opening in OPENINGS:
        wide = centre + opening * (formation_m - centre)
        wide = wide + np.maximum(low - wide.min(axis=0), 0.0) - np.maximum(wide.max(axis=0) - high, 0.0)
        _, member_of = linear_sum_assignment(cdist(places_m, wide, "sqeuclidean"))
        far = _closest(places_m, wide[member_of], obstacles_m)
        near = _closest(wide, formation_m, obstacles_m)  # opening parts every pair, but may run into an obstacle
        if not (too_close(far.distance_m, needed_m) or too_close(near.distance_m, rules.separation_m)):
            return member_of, wide
    raise PlanError(
        f"no straight lines between pads and formation keep {needed_m:.2f} m apart (with the widest opening they come "
        f"within {min(far, near).distance_m:.2f} m); place the pads or the slots further apart"
    )


def _closest(start_m: Array, end_m: Array, obstacles_m: Array) -> Separation:
    """Closest approach of vehicles that fly straight and in step, and of them and what stands still."""
    moves = np.stack((np.concatenate((start_m, obstacles_m)), np.concatenate((end_m, obstacles_m))))
    if moves.shape[1] < 2:
        return Separation(np.inf, 0.0, (0, 0))
    return closest_approach(moves, np.array([0.0, 1.0]))


def _lines(places: tuple[Array, ...], limits: Limits) -> tuple[Trajectory, ...]:
    """Trajectories from place to place with a rest at each; moves of nothing are left out."""
    moves = [(a, b) for a, b in pairwise(places) if np.abs(a - b).max() > SAME_PLACE_M]
    return tuple(timed(LinePath(a, b), limits) for a, b in moves or [(places[0], places[-1])])
