"""The way home from anywhere, past whatever has to be kept clear: direct, around, or over the top."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.distance import cdist

from fg_gcs.core.arrays import Array
from fg_gcs.errors import PlanError
from fg_gcs.plan.keep_clear import Column, keeps_clear
from fg_gcs.plan.landing import clearings_m, grid_m, part, spacing_m
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.path.swarm_path import LinePath
from fg_gcs.plan.rules import too_close
from fg_gcs.plan.trajectory import timed
from fg_gcs.plan.transit import CLEARANCE, IN_PLACE, Transit, assigned, closest_in_step, free_places, scatter

ASIDE_M = (3.0, 8.0)  # lengths of moves of the whole formation that are tried
HIGHER_M = 0.5  # above what has to be passed over


def plan_home(position_enu_m: Array, tops_enu_m: Array, rules: Rules, columns: Sequence[Column] = ()) -> Transit:
    """Return the way from anywhere to the places above the pads, shapes (V, 3) and (G, 3) with G >= V [m; ENU].

    Pads on which something may come down are left out; where too few are left, there are other places beside them.
    Where something has to be kept clear, ways are sought around and above it as well: the whole formation moves aside
    first, or all part, climb above it, cross and descend.

    Args:
        position_enu_m: where everybody rests.
        tops_enu_m: where to go; who goes where is chosen here.
        rules: limits, separation and fence.
        columns: what is kept clear.

    Raises:
        PlanError: no collision-free lines lead there.
    """
    if not columns:
        return scatter(position_enu_m, tops_enu_m, rules)
    goals_m = _places(tops_enu_m, len(position_enu_m), rules, columns)
    problems = []
    for clear_m in clearings_m(rules):
        for way in (_around, _over):
            try:
                return way(position_enu_m, goals_m, rules, columns, clear_m)
            except PlanError as problem:
                problems.append(str(problem))
    raise PlanError("; ".join(dict.fromkeys(problems)))


def _places(tops_m: Array, count: int, rules: Rules, columns: Sequence[Column]) -> Array:
    """Return the places above pads, and others about them if too few pads are clear, shape (G, 3) [m]."""
    if free_places(tops_m, rules.separation_m, columns).sum() >= count:
        return tops_m
    box = np.array(rules.fence.low_enu_m[:2]), np.array(rules.fence.high_enu_m[:2])
    grid = grid_m(tops_m[:, :2].mean(axis=0), 1.5 * spacing_m(rules), 4 * len(tops_m), box)
    grid = grid[cdist(grid, tops_m[:, :2]).min(axis=1) >= 1.5 * spacing_m(rules)]
    return np.concatenate((tops_m, np.column_stack((grid, np.full(len(grid), tops_m[:, 2].max())))))


def _around(position_m: Array, goals_m: Array, rules: Rules, columns: Sequence[Column], clear_m: float) -> Transit:
    """Go straight, or after a move of the whole formation aside.

    Raises:
        PlanError: no such lines are clear.
    """
    return scatter(position_m, goals_m, rules, columns, clear_m, _asides_m())


def _asides_m() -> Array:
    """Moves of a whole formation that may lead around columns, the shortest first, (S, 3) [m]."""
    turns = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    flat = np.stack((np.cos(turns), np.sin(turns), np.zeros(8)), axis=1)
    return np.concatenate((IN_PLACE, *(length_m * flat for length_m in ASIDE_M)))


def _over(position_m: Array, goals_m: Array, rules: Rules, columns: Sequence[Column], clear_m: float) -> Transit:
    """Part, climb above everything that is kept clear, cross there, descend onto the places above the pads.

    Crossing lines of vehicles that are d apart come no closer than d / sqrt(2) ([Turpin2014]_), so they part by as
    much more.

    Raises:
        PlanError: there is no room for it.
    """
    free = free_places(goals_m, clear_m, columns)
    goals = goals_m[free]
    pieces = part(position_m, rules, columns, np.sqrt(2.0) * spacing_m(rules))
    parted = pieces[-1].sample(np.array([pieces[-1].duration_s])).position_m[0] if pieces else position_m
    height_m = max(column.top_m for column in columns) + rules.separation_m + HIGHER_M
    if height_m > rules.fence.high_enu_m[2]:
        raise PlanError(f"the ceiling of the fence is lower than {height_m:.1f} m")
    high = parted.copy()
    high[:, 2] = np.maximum(high[:, 2], height_m)
    goal_of = assigned(high, goals)
    above = goals[goal_of]
    above[:, 2] = high[:, 2]
    moves = ((parted, high), (high, above), (above, goals[goal_of]))
    needed_m = CLEARANCE * rules.separation_m
    for start, end in moves:
        if too_close(closest_in_step(start, end).distance_m, needed_m):
            raise PlanError(f"the lines come closer than {needed_m:.2f} m")
        if not keeps_clear(start, end, columns, clear_m):
            raise PlanError("the lines run into what has to be kept clear")
    lines = tuple(timed(LinePath(start, end), rules.limits) for start, end in moves)
    return Transit(pieces + lines, np.flatnonzero(free)[goal_of])
