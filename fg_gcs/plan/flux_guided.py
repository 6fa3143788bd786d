"""Flux Guided (FG) path planning: the formation moves so that the target's flux through its face grows fastest.

The paper moves every leader freely and holds the edges by equality constraints [Hartley2021]_. Here the constraints are
eliminated: the formation is rigid, its six degrees of freedom are the centre and the attitude of the face, and every
iterate fulfils every edge length, diagonal and follower distance exactly, so it cannot fold. What is left of the
sequential quadratic programme is a trust-region Newton method on positions and attitudes: in each step the exact
second-order model of the flux is maximised subject to a bound on how far the leaders move, which is a 6 x 6 problem
solved to the end [More1983]_.

Two things the flux alone leaves open are decided here:

- A face that looks away has negative flux, which translation could only raise by fleeing. Until the flux is positive
  the centre stays and only the attitude moves.
- Exactly behind the formation the rotational gradient vanishes (a saddle). The curvature shows the way out; of its two
  equal directions the one with a positive first component is taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fg_gcs.core import solid_angle
from fg_gcs.core.formation import Formation, Pose
from fg_gcs.errors import PlanError

Array = NDArray[np.float64]

STEP_M = 1.0  # bound on the leaders' root mean square move in one step near the target: keeps the path smooth
STEP_OF_DISTANCE = (
    0.1  # the bound grows with the distance to the target, so that 10 km take tens of steps, not thousands
)
STEP_GROWTH = 2.0  # from step to step: a spline through steps that grow gently does not swing
TURNED = 0.5  # cosine between normal and target from which on steps grow: before, long ones would go astray
TURN_RAD = 0.3  # largest turn in one step: keeps the attitude's spline true to the iterates
ACCEPT = 0.1  # least share of the predicted gain that a step must bring (any value below 1/4 converges, [More1983]_)
SURROUNDED = 0.75  # flux metric from which the last slide to the axis starts, about 0.25 radii in front of the face
MAX_ITERATES = 500  # a plan takes some 30; beyond this something is wrong, and saying so beats hanging
NEAR_RIM = 1e-3  # closer to the rim than this share of its size the flux has no derivative


@dataclass(frozen=True)
class FluxPath:
    """The poses that the face passes, from its start to its hold around the target."""

    poses: tuple[Pose, ...]
    iterates: int  # steps of the trust-region method, refused ones included


def plan_path(formation: Formation, start: Pose, target_enu_m: Array, hold_depth_m: float = 0.0) -> FluxPath:
    """Return the flux-guided path that ends with the target on the face's axis.

    Args:
        formation: slots around the face's centre.
        start: where the face is.
        target_enu_m: the point source, shape (3,) [m].
        hold_depth_m: how far the target finally lies behind the face, among the swarm, >= 0 [m].

    Raises:
        PlanError: the target is not finite, lies on the rim, or is not reached.
    """
    target = np.asarray(target_enu_m, dtype=float)
    if not np.isfinite(target).all():
        raise PlanError(f"the target must be three finite numbers, got {tuple(target)}")
    search = _Search(formation, target)
    poses, pose = [start], start
    region = 1.0  # trust radius as a share of the largest step
    bound_m = STEP_M
    for iterate in range(MAX_ITERATES):
        if search.surrounds(pose):
            end = search.hold(pose, hold_depth_m)
            return FluxPath((*poses, end) if _differ(poses[-1], end) else tuple(poses), iterate)
        step, predicted = search.best_step(pose, region * bound_m)
        moved = search.apply(pose, step)
        gained = search.flux(moved) - search.flux(pose)
        if gained > ACCEPT * predicted:
            pose = moved
            poses.append(pose)
            region = min(1.0, 2.0 * region)
            bound_m = search.step_bound_m(pose, bound_m)
        else:
            region *= 0.25
    raise PlanError(f"no flux-guided path to {tuple(target)} within {MAX_ITERATES} steps")


class _Search:
    """The flux of one target through one rim as a function of the pose, and its best steps."""

    def __init__(self, formation: Formation, target_enu_m: Array) -> None:
        self._rim_m = formation.leaders_m
        self._gyration_m = formation.gyration_m
        self._target = target_enu_m

    def surrounds(self, pose: Pose) -> bool:
        """Say whether the target lies so close to the face, inside its rim, that a straight slide ends the path."""
        return float(solid_angle.unwrapped(np.array(self.flux(pose)))) > SURROUNDED * solid_angle.HALF_SPHERE

    def hold(self, pose: Pose, depth_m: float) -> Pose:
        """Return the last pose: the present attitude, the target on the axis and so far behind the face."""
        return Pose(self._target + depth_m * pose.rotation[:, 0], pose.rotation)

    def step_bound_m(self, pose: Pose, last_m: float) -> float:
        """Largest move of the leaders in one step, root mean square [m]; long when the face looks at a far target."""
        ahead = self._target - pose.centre_enu_m
        distance = float(np.linalg.norm(ahead))
        turned = float(ahead @ pose.rotation[:, 0]) > TURNED * distance
        return max(STEP_M, min(STEP_OF_DISTANCE * distance, STEP_GROWTH * last_m)) if turned else STEP_M

    def flux(self, pose: Pose) -> float:
        return float(solid_angle.flux(pose.centre_enu_m + self._rim_m @ pose.rotation.T, self._target))

    def apply(self, pose: Pose, step: Array) -> Pose:
        """Return the pose moved by (dx, dy, dz, turn vector), ENU [m, rad]."""
        turn = Rotation.from_rotvec(step[3:]).as_matrix()
        return Pose(pose.centre_enu_m + step[:3], turn @ pose.rotation)

    def best_step(self, pose: Pose, size_m: float) -> tuple[Array, float]:
        """Return the step of at most ``size_m`` that maximises the second-order model, and the gain it predicts."""
        gradient, hessian = self._derivatives(pose)
        turn_rad = min(size_m / self._gyration_m, TURN_RAD)
        scale = np.array([size_m] * 3 + [turn_rad] * 3)
        free = slice(None) if self.flux(pose) > 0.0 else slice(3, None)
        step = np.zeros(6)
        scaled_gradient = (scale * gradient)[free]
        scaled_hessian = (hessian * np.outer(scale, scale))[free, free]
        unit = maximise_in_ball(scaled_gradient, scaled_hessian)
        step[free] = scale[free] * unit
        return step, float(scaled_gradient @ unit + 0.5 * unit @ scaled_hessian @ unit)

    def _derivatives(self, pose: Pose) -> tuple[Array, Array]:
        """Flux gradient (6,) and Hessian (6, 6) by small moves and turns of the rigid rim [sr per m, rad]."""
        arms = self._rim_m @ pose.rotation.T
        vertices = pose.centre_enu_m + arms
        if np.linalg.norm(vertices - self._target, axis=1).min() < NEAR_RIM * self._gyration_m:
            raise PlanError(f"the target {tuple(self._target)} lies on the rim of the formation; move either of them")
        by_edge = solid_angle.edge_derivatives(vertices, self._target)
        jacobian = np.empty((len(arms), 3, 6))  # d vertex / d (move, turn)
        jacobian[:, :, :3] = np.eye(3)
        jacobian[:, :, 3:] = -solid_angle.skew(arms)
        ends = np.stack((jacobian, np.roll(jacobian, -1, axis=0)), axis=1)  # (N, 2, 3, 6)
        gradient = np.einsum("enk,enkd->d", by_edge.gradient, ends)
        hessian = np.einsum("enka,enmkl,emlb->ab", ends, by_edge.hessian, ends, optimize=True)
        # A turn bends: p(w) = p + w x arm + w x (w x arm) / 2, so the gradient meets the second-order term
        at_vertex = by_edge.gradient[:, 0] + np.roll(by_edge.gradient[:, 1], 1, axis=0)
        outer = np.einsum("nk,nl->kl", arms, at_vertex)
        hessian[3:, 3:] += 0.5 * (outer + outer.T) - np.trace(outer) * np.eye(3)
        return gradient, 0.5 * (hessian + hessian.T)


def maximise_in_ball(gradient: Array, hessian: Array) -> Array:
    """Return the x with ``|x| <= 1`` that maximises ``g . x + x . H x / 2`` [More1983]_.

    In the eigenvectors of H the solution is ``x = (m I - H)^-1 g`` with the smallest multiplier ``m >= 0`` that makes
    ``m I - H`` positive semi-definite and the length one. In the hard case (no gradient along the leading eigenvector)
    the rest of the length goes along that eigenvector, its first component that is not zero made positive.
    """
    values, vectors = np.linalg.eigh(hessian)
    along = vectors.T @ gradient
    top = values[-1]
    size = float(np.linalg.norm(gradient) + np.abs(values).max())
    if size == 0.0:
        return np.zeros_like(gradient)

    def at(multiplier: float) -> Array:
        step: Array = along / (multiplier - values)
        return step

    if top < -1e-12 * size and np.linalg.norm(at(0.0)) <= 1.0:
        return np.asarray(vectors @ at(0.0))
    floor = max(top, 0.0) + 1e-9 * size  # just above the pole; what it costs in length the hard case restores
    low, high = floor, floor + float(np.linalg.norm(gradient)) + size
    if np.linalg.norm(at(floor)) < 1.0:
        inside = at(floor)
        leading = vectors[:, -1] * np.sign(vectors[np.flatnonzero(np.abs(vectors[:, -1]) > 1e-9)[0], -1])
        rest = np.sqrt(1.0 - inside @ inside)
        return np.asarray(vectors @ inside + rest * leading)
    for _ in range(100):  # bisection on a monotone function; the length is good to 1e-9 long before
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.linalg.norm(at(middle)) > 1.0 else (low, middle)
        if high - low < 1e-12 * high:
            break
    return np.asarray(vectors @ at(high))


def _differ(one: Pose, other: Pose) -> bool:
    return bool(
        np.linalg.norm(one.centre_enu_m - other.centre_enu_m) > 1e-9
        or np.abs(one.rotation - other.rotation).max() > 1e-12
    )
