"""The free formulation of Flux Guided planning: every leader moves, the edges of the face keep their lengths.

This is the paper's own formulation [Hartley2021]_ with what it lacks: every pair that a leader belongs to, followers
included, is kept apart, so that the face cannot fold. A leader's place is written as

    x_i = c + R (t_i + d_i),    sum d_i = 0,    sum t_i x d_i = 0

with its slot ``t_i`` and its departure ``d_i`` from the formation's shape. The two sums are the conditions of the best
fit of the template to the leaders [Kabsch1976]_, so ``c, R`` is that fit at every iterate; the followers stand in it.
The edges are constraints on ``d`` alone, and so are the distances of all pairs.

Each step is one of sequential quadratic programming in a trust region, after Byrd and Omojokun [Nocedal2006]_: the
exact second-order model of the flux, with the curvature of the edge constraints by their multipliers, is maximised
over move, turn and the tangent of the shapes that the edges allow. A pair that the step would bring too close becomes
an equality, reached by a normal step of at most 0.8 of the region. Distances are convex, so that what their
linearisation allows is allowed; what the curvature of the edges takes away again, a restoration gives back. No leader
departs further from its slot than a share of the face's size, and after a refused step the next one moves and turns
the shape as it is: what the rigid formulation reaches, this one reaches too.

What the flux alone leaves open is decided here, the first and the last as in the rigid formulation:

- A face turned away has negative flux, which could be raised by fleeing or by shrinking. Until the flux is positive
  centre and shape stay and only the attitude turns.
- Close behind the face there is a place from which every turn loses flux. If the target is among the swarm there, a
  straight slide ends the path; if it lies beyond, the face turns against the flux until it faces the target.
- Shape is a means, not an end: on the last metres, when the target is surrounded, the formation's own is restored.
- Exactly behind the formation the curvature shows the way out; of its two equal directions the one with a positive
  first component is taken.
"""

from __future__ import annotations

import math

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Formation, Pose
from fg_gcs.errors import PlanError
from fg_gcs.plan.path.leader_paths import LeaderPath
from fg_gcs.plan.search.free import restore, search
from fg_gcs.plan.search.free_model import Shape
from fg_gcs.plan.search.steps import FOUND, ON_RIM, STEP_M

MAX_STEPS = 1000  # a plan takes some 40; beyond this something is wrong, and saying so beats hanging
PAIR_SHARE = 0.95  # least distance of leaders that are no neighbours, of that in the formation's own shape: no folding
SMALLEST_SHARE = 0.97  # least distance of any pair, of the smallest in the shape: 0.95 and a reserve for the spline


def plan_leaders(formation: Formation, start: Pose, target_enu_m: Array, hold_depth_m: float = 0.0) -> LeaderPath:
    """Return the path of freely moving leaders that ends with the target on the axis, the shape restored.

    Args:
        formation: slots around the face's centre; neighbouring leaders keep their distances.
        start: where the face is, in the formation's own shape.
        target_enu_m: the point source, shape (3,) [m].
        hold_depth_m: how far the target finally lies behind the face, among the swarm, >= 0 [m].

    Raises:
        PlanError: target or start are no numbers, or the target lies on the rim or is not reached.
    """
    target = np.array(target_enu_m, dtype=float)
    centre, rotation = np.array(start.centre_enu_m, dtype=float), np.array(start.rotation, dtype=float, order="C")
    if not np.isfinite(target).all():
        raise PlanError(f"the target must be three finite numbers, got {tuple(target.tolist())}")
    if not (np.isfinite(centre).all() and np.isfinite(rotation).all() and 0.0 < start.scale < np.inf):
        raise PlanError("the start must have a finite centre and attitude, and a scale above 0")
    shape = shape_of(formation, start.scale)
    frames, departures = np.empty((MAX_STEPS + 1, 12)), np.empty((MAX_STEPS + 1, len(formation.leaders_m), 3))
    ended, count, steps = search(shape, centre, rotation, target, frames, departures)
    if ended == ON_RIM:
        raise PlanError(f"the target {tuple(target.tolist())} lies on the rim of the formation; move either of them")
    if ended != FOUND:
        raise PlanError(f"no flux-guided path to {tuple(target.tolist())} within {MAX_STEPS} steps")
    centres, rotations = frames[:count, :3], frames[:count, 3:].reshape(count, 3, 3)
    last = rotations[-1]
    slid, straightened = _slide(shape, centres[-1], target + hold_depth_m * last[:, 0], departures[count - 1])
    centres = np.concatenate((centres, slid))
    rotations = np.concatenate((rotations, np.repeat(last[None], len(slid), axis=0)))
    placed = shape.slots_m[: len(shape.edges_m)] + np.concatenate((departures[:count], straightened))
    leaders = centres[:, None, :] + np.einsum("kij,knj->kni", rotations, placed)
    poses = tuple(Pose(place, turn, start.scale) for place, turn in zip(centres, rotations, strict=True))
    return LeaderPath(leaders, poses, steps)


def shape_of(formation: Formation, scale: float) -> Shape:
    """Return the edges to hold and the pairs to keep apart."""
    slots, count = scale * formation.slots_m, len(formation.leaders_m)
    size = scale * formation.gyration_m
    distances = np.linalg.norm(slots[:count, None] - slots[None], axis=2)  # (N, V)
    first, second = np.triu_indices(count, k=1, m=len(slots))
    nearest = float(distances[first, second].min())
    neighbours = (second < count) & ((second - first == 1) | (second - first == count - 1))
    first, second = first[~neighbours], second[~neighbours]
    own = np.where(second < count, PAIR_SHARE * distances[first, second], 0.0)
    least = np.maximum(own, SMALLEST_SHARE * nearest)
    edges = distances[np.arange(count), (np.arange(count) + 1) % count]
    pairs = np.ascontiguousarray(np.stack((first, second), axis=1), dtype=np.int64)
    return Shape(slots, edges, pairs, least, size, float(np.linalg.norm(slots, axis=1).max()))


def _slide(shape: Shape, centre: Array, end: Array, departure: Array) -> tuple[Array, Array]:
    """Return centres (S, 3) and departures (S, N, 3) of the last part: straight to the hold, the shape restored."""
    way = float(np.linalg.norm(end - centre) + np.linalg.norm(departure, axis=1).max())
    steps = math.ceil(way / STEP_M) if way > 1e-9 else 0  # in place already: nothing is left to do
    shares = np.arange(1, steps + 1) / max(steps, 1)
    eased = shares**2 * (3.0 - 2.0 * shares)  # starts and ends gently
    left = (1.0 - eased)[:, None, None] * departure
    # A shape in between that cannot be restored is left out: the spline passes there without it
    exact = np.array([restore(shape, one) for one in left], dtype=bool)
    return centre + shares[exact, None] * (end - centre), left[exact]
