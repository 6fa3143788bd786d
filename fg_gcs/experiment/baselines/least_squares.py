"""The least-squares baseline (LS) of the paper, for comparison only: every leader moves freely, in small steps.

In each step the moves ``d`` of the leaders minimise ``d . d + alpha (phi_r - J d)^2 + beta |M_1 d|^2``, where ``J``
is the gradient of the flux, ``phi_r`` a reference for its change, and ``M_1`` takes the differences of neighbouring
leaders' moves axis by axis, so that ``beta`` holds the formation's size [Hartley2021]_. Setting the derivative to
zero gives ``(1 + alpha J^T J + beta M_1^T M_1) d = alpha J^T phi_r``. The rank-one term comes out by the
Sherman-Morrison formula, so the matrix in front of it is inverted once.

What the paper leaves open is read as the published lengths ask for, which this reproduces to 0.1 m where they are
known to that digit: ``phi_r = exp(0.1 flux)``, evaluated again in each step; the sign of the flux stays that of the
first face, so a formation whose target is behind it turns first; and the path holds the iterates before the one that
comes near enough.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.kernels import edge_derivatives, polygon_flux
from fg_gcs.errors import PlanError

ALPHA = 1000.0  # weight of the flux in the paper's experiments
REFERENCE_RATE = 0.1  # phi_r = exp(rate * flux)
MAX_STEPS = 20_000  # beta = 400 with the target behind takes 7600; beyond this it runs away
LOST_FACTOR = 10.0  # a face this many times further from its target than at the start does not come back


class Baseline(NamedTuple):
    """One of the paper's two settings: the weight of the size, and how near to the target the path ends."""

    name: str
    beta: float
    stop_m: float  # distance of the face's centre from the target [m]


FREE_SIZE = Baseline("LS beta=0", 0.0, 7.0)
HELD_SIZE = Baseline("LS beta=400", 400.0, 1.0)


class LeastSquaresPath(NamedTuple):
    """The iterates of the baseline."""

    leaders_enu_m: Array  # (K, N, 3), the start first [m]
    end_enu_m: Array  # (N, 3) the iterate that came near enough; the published lengths do not count it [m]

    @property
    def length_m(self) -> float:
        """Way of all leaders together, as published: without the step that fulfils the stop [m]."""
        return float(np.linalg.norm(np.diff(self.leaders_enu_m, axis=0), axis=2).sum())


def plan_least_squares(
    leaders_enu_m: Array, target_enu_m: Array, baseline: Baseline, max_steps: int = MAX_STEPS
) -> LeastSquaresPath:
    """Return the baseline's path to a target.

    Args:
        leaders_enu_m: where the leaders start, in winding order, shape (N, 3) [m].
        target_enu_m: the point source, shape (3,) [m].
        baseline: weight of the size, and the stop.
        max_steps: gives up after as many.

    Raises:
        PlanError: the path runs away from the target, or does not come near it within ``max_steps``.
    """
    leaders, target = np.array(leaders_enu_m, dtype=float), np.array(target_enu_m, dtype=float)
    held = np.asarray(np.linalg.inv(np.eye(leaders.size) + baseline.beta * _size_term(len(leaders))), dtype=float)
    lost_m = LOST_FACTOR * max(_distance_m(leaders, target), baseline.stop_m)
    iterates = [leaders]
    for _ in range(max_steps):
        leaders = leaders + _step(leaders, target, held)
        distance_m = _distance_m(leaders, target)
        if distance_m < baseline.stop_m:
            return LeastSquaresPath(np.array(iterates), leaders)
        if not distance_m < lost_m:
            break
        iterates.append(leaders)
    raise PlanError(
        f"{baseline.name}: no path to {tuple(target.tolist())}: the face is still "
        f"{distance_m:.1f} m away after {len(iterates)} steps"
    )


def _step(leaders: Array, target: Array, held: Array) -> Array:
    """Solve the linear problem; ``held`` is the inverse of ``1 + beta M_1^T M_1``, shape (3 N, 3 N)."""
    gradient = _flux_gradient(leaders, target).ravel()
    reference = np.exp(REFERENCE_RATE * polygon_flux(leaders, target))
    direction = held @ gradient
    move: Array = (ALPHA * reference / (1.0 + ALPHA * gradient @ direction)) * direction
    return move.reshape(leaders.shape)


def _flux_gradient(leaders: Array, target: Array) -> Array:
    gradient = np.zeros_like(leaders)
    room = np.empty((14, 3))  # the first two rows are one edge's gradient; the Hessian comes along
    rays = (leaders - target).tolist()
    for edge, ((ax, ay, az), (bx, by, bz)) in enumerate(zip(rays, rays[1:] + rays[:1], strict=True)):
        edge_derivatives(ax, ay, az, bx, by, bz, room)
        gradient[edge] += room[0]
        gradient[(edge + 1) % len(rays)] += room[1]
    return gradient


def _size_term(count: int) -> Array:
    """Return ``M_1^T M_1`` for leaders whose coordinates follow each other, shape (3 N, 3 N)."""
    differences = np.eye(count) - np.roll(np.eye(count), 1, axis=1)  # M_2: a leader's move minus the next one's
    return np.asarray(np.kron(differences.T @ differences, np.eye(3)), dtype=float)


def _distance_m(leaders: Array, target: Array) -> float:
    return float(np.linalg.norm(leaders.mean(axis=0) - target))
