"""Flux Guided (FG) path planning: the formation moves so that the target's flux through its face grows fastest.

The paper moves every leader freely and holds the edges by equality constraints [Hartley2021]_. Here the constraints are
eliminated: the formation is rigid, its six degrees of freedom are the centre and the attitude of the face, and every
iterate fulfils every edge length, diagonal and follower distance exactly, so it cannot fold. What is left of the
sequential quadratic programme is a trust-region Newton method on positions and attitudes: in each step the exact
second-order model of the flux is maximised subject to a bound on how far the leaders move, which is a 6 x 6 problem
solved to the end [More1983]_. The formation's scale is not searched for: it goes to its last value at a bounded rate.

Two things the flux alone leaves open are decided here:

- A face turned away has negative flux, which translation could only raise by fleeing. Until the flux is positive
  the centre stays and only the attitude moves.
- Exactly behind the formation the rotational gradient vanishes (a saddle). The curvature shows the way out; of its two
  equal directions the one with a positive first component is taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Formation, Pose
from fg_gcs.core.separation import Fence
from fg_gcs.errors import PlanError
from fg_gcs.plan.path.poses import Poses
from fg_gcs.plan.search.pose_model import centre_of
from fg_gcs.plan.search.rigid import furthest_outside, search, search_inside
from fg_gcs.plan.search.steps import FOUND, NO_NUMBERS, ON_RIM, TOO_MANY
from fg_gcs.plan.targets import Charges

MAX_STEPS = 400  # a plan takes some 30; beyond this something is wrong, and saying so beats hanging
SLIDE_M = 0.3  # longest part of the last slide of a bent path
MARGIN_M = 0.1  # a bent path keeps this far inside: its spline bulges between the poses
ONE = np.ones(1)  # the weight of a single source


@dataclass(frozen=True, eq=False)
class FluxPath:
    """The poses that the face passes, from its start to its hold around the target.

    The scale goes from the first pose's to the last one's along the whole way, see
    :class:`fg_gcs.plan.path.rigid_path.PosePath`; in between the poses tell the scale that the search counted with.
    """

    poses: Poses
    iterates: int  # steps of the trust-region method, refused ones included


def plan_path(
    formation: Formation,
    start: Pose,
    target: Array | Charges,
    hold_depth_m: float = 0.0,
    last_scale: float | None = None,
    fence: Fence | None = None,
) -> FluxPath:
    """Return the flux-guided path that ends with the target on the face's axis.

    Args:
        formation: slots around the face's centre.
        start: where the face is.
        target: a point source, shape (3,) [m; ENU], or several sources whose flux is summed. Several are surrounded
            at their centre of charge: the face goes where their flux is largest, and from there straight to it.
        hold_depth_m: how far the target finally lies behind the face, among the swarm, >= 0 [m].
        last_scale: scale of the formation at the end; None: it stays as it is.
        fence: the box that no vehicle may leave; where the flux would take one out, the path is bent.

    Raises:
        PlanError: target, start or scale are no numbers, the target lies on the rim, is not reached, or cannot be
            surrounded inside the fence.
    """
    if isinstance(target, Charges):
        sources, weights = target.positions_enu_m, target.weights / target.weights.sum()
    else:
        sources, weights = np.array(target, dtype=float, ndmin=2), ONE
    goal = float(start.scale if last_scale is None else last_scale)
    first = np.empty(13)
    first[:3], first[3:12], first[12] = start.centre_enu_m, np.ravel(start.rotation), start.scale
    room = np.empty((MAX_STEPS + 2, 13))
    ended, count, steps = search(formation.leaders_m, sources, weights, hold_depth_m, first, goal, room)
    poses = Poses(room[:count])
    if fence is not None and ended == FOUND and _outside_m(formation, poses, fence) > 0.0:
        ended, poses, tried = _bent(formation, sources, weights, hold_depth_m, first, goal, fence)
        steps += tried
    if ended == NO_NUMBERS:
        raise _no_numbers(start, sources, goal)
    if ended == ON_RIM:
        raise PlanError(f"the target {_place(sources[0])} lies on the rim of the formation; move either of them")
    if ended != FOUND:
        raise PlanError(f"no flux-guided path to {_place(sources[0])} within {MAX_STEPS} steps")
    return FluxPath(poses, steps)


def _bent(
    formation: Formation, sources: Array, weights: Array, depth_m: float, first: Array, last_scale: float, fence: Fence
) -> tuple[int, Poses, int]:
    """Search inside the fence: how it ended, the poses and the steps tried.

    Raises:
        PlanError: the formation does not fit around the target.
    """
    low, high = np.array(fence.low_enu_m) + MARGIN_M, np.array(fence.high_enu_m) - MARGIN_M
    room = np.empty((MAX_STEPS + 2, 13))
    ended, count, tried = search_inside(
        formation.leaders_m, formation.slots_m, sources, weights, depth_m, first, last_scale, low, high, room
    )
    if ended == TOO_MANY:
        normal = room[count - 1, 3:12:3]
        hold = room[count - 1].copy()
        hold[:3], hold[12] = centre_of(sources, weights) + depth_m * normal, last_scale
        outside_m = fence.excess_m(formation.place(Poses(hold[None])[0]))  # (V,)
        raise PlanError(
            f"the formation does not fit around the target {_place(centre_of(sources, weights))} inside the fence: in "
            f"the hold the vehicle in slot {int(outside_m.argmax()) + 1} would be {outside_m.max() + MARGIN_M:.2f} m "
            "outside; move the target or the fence by as much, or make the formation smaller"
        )
    return ended, _subdivided(room[:count]), tried


def _no_numbers(start: Pose, sources: Array, last_scale: float) -> PlanError:
    if not np.isfinite(sources).all():
        return PlanError(f"the target must be three finite numbers, got {_place(sources[0])}")
    if not (np.isfinite(start.centre_enu_m).all() and np.isfinite(start.rotation).all()):
        return PlanError("the start must have a finite centre and attitude")
    return PlanError(f"scales must be positive numbers, got {start.scale} and {last_scale}")


def _subdivided(rows: Array) -> Poses:
    """Divide the last slide into short ones: a spline through close poses hardly bulges where the slide begins."""
    if len(rows) < 2:
        return Poses(rows)
    before, hold = rows[-2:]
    parts = max(1, int(np.ceil(np.linalg.norm(hold[:3] - before[:3]) / SLIDE_M)))
    between = np.repeat(hold[None], parts - 1, axis=0)
    shares = np.arange(1, parts)[:, None] / parts
    between[:, :3] = before[:3] + shares * (hold[:3] - before[:3])
    return Poses(np.concatenate((rows[:-1], between, rows[-1:])))


def _outside_m(formation: Formation, poses: Poses, fence: Fence) -> float:
    """By how much the formation leaves the fence in any of the poses, negative inside [m]."""
    return furthest_outside(poses.rows, formation.slots_m, np.array(fence.low_enu_m), np.array(fence.high_enu_m))


def _place(point: Array) -> str:
    return "(" + ", ".join(f"{value:g}" for value in point) + ")"
