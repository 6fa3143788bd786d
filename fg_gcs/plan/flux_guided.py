"""Flux Guided (FG) path planning: the formation moves so that the target's flux through its face grows fastest.

The paper moves every leader freely and holds the edges by equality constraints [Hartley2021]_. Here the constraints are
eliminated: the formation is rigid, its six degrees of freedom are the centre and the attitude of the face, and every
iterate fulfils every edge length, diagonal and follower distance exactly, so it cannot fold. What is left of the
sequential quadratic programme is a trust-region Newton method on positions and attitudes: in each step the exact
second-order model of the flux is maximised subject to a bound on how far the leaders move, which is a 6 x 6 problem
solved to the end [More1983]_. The formation's scale is not searched for: it goes to its last value at a bounded rate.

Two things the flux alone leaves open are decided here:

- A face that looks away has negative flux, which translation could only raise by fleeing. Until the flux is positive
  the centre stays and only the attitude moves.
- Exactly behind the formation the rotational gradient vanishes (a saddle). The curvature shows the way out; of its two
  equal directions the one with a positive first component is taken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.formation import Formation, Pose
from fg_gcs.core.separation import Fence
from fg_gcs.errors import PlanError
from fg_gcs.plan.fenced_search import search_inside
from fg_gcs.plan.rigid_search import FOUND, ON_RIM, TOO_MANY, search

Array = NDArray[np.float64]

MAX_STEPS = 400  # a plan takes some 30; beyond this something is wrong, and saying so beats hanging
SLIDE_M = 0.3  # longest part of the last slide of a bent path
MARGIN_M = 0.1  # a bent path keeps this far inside: its spline bulges between the poses
SAME = 1e-9  # metres, radians and shares below which two poses are one


@dataclass(frozen=True)
class FluxPath:
    """The poses that the face passes, from its start to its hold around the target.

    The scale goes from the first pose's to the last one's along the whole way, see
    :class:`fg_gcs.plan.rigid_path.PosePath`; in between the poses tell the scale that the search counted with.
    """

    poses: tuple[Pose, ...]
    iterates: int  # steps of the trust-region method, refused ones included


def plan_path(
    formation: Formation,
    start: Pose,
    target_enu_m: Array,
    hold_depth_m: float = 0.0,
    last_scale: float | None = None,
    fence: Fence | None = None,
) -> FluxPath:
    """Return the flux-guided path that ends with the target on the face's axis.

    Args:
        formation: slots around the face's centre.
        start: where the face is.
        target_enu_m: the point source, shape (3,) [m].
        hold_depth_m: how far the target finally lies behind the face, among the swarm, >= 0 [m].
        last_scale: scale of the formation at the end; None: it stays as it is.
        fence: the box that no vehicle may leave; where the flux would take one out, the path is bent.

    Raises:
        PlanError: target, start or scale are no numbers, the target lies on the rim, is not reached, or cannot be
            surrounded inside the fence.
    """
    target = np.array(target_enu_m, dtype=float)
    goal = start.scale if last_scale is None else last_scale
    _check_numbers(start, target, goal)
    first = np.concatenate((start.centre_enu_m, np.ravel(start.rotation), [start.scale])).astype(float)
    room = np.empty((MAX_STEPS + 1, 13))
    centre, rotation = first[:3].copy(), first[3:12].copy().reshape(3, 3)
    ended, count, steps = search(formation.leaders_m, target, centre, rotation, start.scale, goal, room)
    poses = _poses(start, room, count, target, hold_depth_m, goal)
    if fence is not None and ended == FOUND and _outside_m(formation, poses, fence) > 0.0:
        low, high = np.array(fence.low_enu_m) + MARGIN_M, np.array(fence.high_enu_m) - MARGIN_M
        points = formation.slots_m
        ended, count, tried = search_inside(formation.leaders_m, points, target, hold_depth_m, first, low, high, room)
        steps += tried
        poses = _subdivided(_poses(start, room, count, target, hold_depth_m, goal))
        if ended == TOO_MANY:
            least_m = _outside_m(formation, poses[-1:], fence) + MARGIN_M
            raise PlanError(
                f"the formation does not fit around the target {_place(target)} inside the fence: it would be "
                f"{least_m:.2f} m outside; move the target or the fence by as much, or make the formation smaller"
            )
    if ended == ON_RIM:
        raise PlanError(f"the target {_place(target)} lies on the rim of the formation; move either of them")
    if ended != FOUND:
        raise PlanError(f"no flux-guided path to {_place(target)} within {MAX_STEPS} steps")
    return FluxPath(tuple(poses), steps)


def _check_numbers(start: Pose, target: Array, last_scale: float) -> None:
    if not all(map(math.isfinite, target.tolist())):
        raise PlanError(f"the target must be three finite numbers, got {_place(target)}")
    if not all(map(math.isfinite, (*start.centre_enu_m, *start.rotation.ravel().tolist()))):
        raise PlanError("the start must have a finite centre and attitude")
    if not (0.0 < start.scale < np.inf and 0.0 < last_scale < np.inf):
        raise PlanError(f"scales must be positive numbers, got {start.scale} and {last_scale}")


def _poses(start: Pose, room: Array, count: int, target: Array, depth_m: float, scale: float) -> list[Pose]:
    """The poses that a search wrote, and the hold that follows them."""
    rows = room[1:count].copy()
    poses = [start, *map(Pose, rows[:, :3], rows[:, 3:12].reshape(-1, 3, 3), rows[:, 12].tolist())]
    hold = Pose(target + depth_m * poses[-1].rotation[:, 0], poses[-1].rotation, scale)
    return [*poses, hold] if _differ(poses[-1], hold) else poses


def _subdivided(poses: list[Pose]) -> list[Pose]:
    """Divide the last slide into short ones: a spline through close poses hardly bulges where the slide begins."""
    if len(poses) < 2:
        return poses
    before, hold = poses[-2:]
    parts = int(np.ceil(np.linalg.norm(hold.centre_enu_m - before.centre_enu_m) / SLIDE_M))
    shares = np.linspace(0.0, 1.0, max(parts, 1) + 1)[1:-1]
    between = [before.centre_enu_m + share * (hold.centre_enu_m - before.centre_enu_m) for share in shares]
    return [*poses[:-1], *(Pose(centre, hold.rotation, before.scale) for centre in between), hold]


def _outside_m(formation: Formation, poses: Sequence[Pose], fence: Fence) -> float:
    """By how much the formation leaves the fence in any of the poses, negative inside [m]."""
    return max(float(fence.excess_m(formation.place(pose)).max()) for pose in poses)


def _place(point: Array) -> str:
    return "(" + ", ".join(f"{value:g}" for value in point) + ")"


def _differ(one: Pose, other: Pose) -> bool:
    return bool(
        abs(one.scale - other.scale) > SAME
        or np.abs(one.centre_enu_m - other.centre_enu_m).max() > SAME
        or np.abs(one.rotation - other.rotation).max() > SAME
    )
