"""Time-optimal timing of a swarm's path under norm limits: the one place that knows toppra [Pham2018]_.

With path speed ``s'`` and path acceleration ``s''`` a vehicle moves at ``q' s'`` and accelerates by
``q' s'' + q'' s'^2``. In ``u = s''`` and ``x = s'^2`` all limits are linear or bounds:

- the speed norm is exact: ``x <= speed^2 / |q'|^2``; climb and descent bound ``x`` through ``q'_z`` alike;
- the acceleration lies in the plane of ``q'`` and ``q''``. With ``e1`` along ``q'`` and ``e2`` across it, its norm is
  bounded by a regular polygon inside the disc: ``cos(k) (|q'| u + b1 x) + sin(k) b2 x <= a cos(half a side)`` for the
  directions ``k`` of the half plane that it can lie in. With 32 sides around the loss is 0.5 %.

All vehicles share ``u`` and ``x``, so one joint problem keeps the formation in step.
"""

from __future__ import annotations

import logging
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fg_gcs.errors import PlanError
from fg_gcs.plan.limits import Limits
from fg_gcs.plan.paths import SwarmPath

Array = NDArray[np.float64]

GRID_M = 0.1  # spacing of the grid along the path; halving it shortens the paper's flights by less than 0.5 %
GRID_POINTS = (60, 400)  # fewer make the bang-bang switch coarse, more cost time without gain
DIRECTIONS = 17  # half of a polygon of 32 sides, both ends included


class Timing(NamedTuple):
    """Path speed at grid points; between them the path acceleration is constant."""

    s_m: Array  # (S,) ascending from 0
    speed: Array  # (S,) ds/dt >= 0 [m/s]
    time_s: Array  # (S,) ascending from 0


class _Path(Protocol):
    """What toppra asks of a path."""

    dof: int
    path_interval: Array


def time_optimal(path: SwarmPath, limits: Limits) -> Timing:
    """Return the fastest timing of a path from rest to rest.

    Raises:
        PlanError: no timing keeps the limits; the text says where the path stops being passable.
    """
    import toppra.algorithm as algorithm  # it loads matplotlib (0.5 s), so not before a plan is timed

    if path.length_m == 0.0:  # everybody is where it should be: nothing to do, in no time
        return Timing(np.zeros(2), np.zeros(2), np.zeros(2))
    logging.getLogger("toppra").setLevel(logging.ERROR)  # its warnings come back below as one error with a reason
    grid = _grid(path)
    instance = algorithm.TOPPRA(
        [_constraint(path, grid, limits)], _Interval(grid), gridpoints=grid, solver_wrapper="seidel"
    )
    _, speed, _ = instance.compute_parameterization(0.0, 0.0)
    if speed is None or not np.isfinite(speed).all():
        reachable = instance.compute_feasible_sets()[:, 1]
        worst = int(np.nanargmin(np.where(np.isfinite(reachable), reachable, -1.0)))
        raise PlanError(f"the path cannot be timed under the limits: it is too sharp at {grid[worst]:.1f} m of its way")
    mean = 0.5 * (speed[:-1] + speed[1:])
    steps = np.diff(grid) / np.maximum(mean, np.finfo(float).tiny)
    time_s = np.concatenate(([0.0], np.cumsum(steps)))
    if not np.isfinite(time_s).all() or time_s[-1] > 1e6:  # eleven days: the timing came to a stand on the way
        raise PlanError("the path cannot be timed under the limits: the swarm would come to a stand on the way")
    return Timing(grid, np.asarray(speed), time_s)


def warm_up() -> None:
    """Load toppra now, so that the first plan of a process is as quick as the next."""
    import toppra.algorithm  # noqa: F401 # loading is all that is wanted


def _grid(path: SwarmPath) -> Array:
    """Grid points, the path's knots among them: within a cell everything is smooth, shape (S,) [m]."""
    knots = path.knots_m
    spacing_m = path.length_m / np.clip(path.length_m / GRID_M, *GRID_POINTS)
    cells = np.ceil(np.diff(knots) / spacing_m).astype(int)
    starts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(knots, knots[1:], cells, strict=False)]
    return np.concatenate((*starts, knots[-1:]))


class _Interval:
    """A path as toppra's solver sees it: only its range counts, the constraint has the derivatives."""

    def __init__(self, grid: Array) -> None:
        self.dof = 1
        self.path_interval = grid[[0, -1]]


def _constraint(path: SwarmPath, grid: Array, limits: Limits) -> object:
    """Build toppra's constraint object; its base class lives in the module that is imported late."""
    from toppra.constraint import DiscretizationType, LinearConstraint
    from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate

    _, first, second = path.at(grid)
    rows_u, rows_x = _acceleration_rows(first, second)
    bound = limits.acceleration_m_s2 * np.cos(np.pi / (2 * (DIRECTIONS - 1)))
    identity = np.eye(rows_u.shape[1])
    ceiling = np.stack((np.zeros(len(grid)), _squared_speed_bound(first, limits)), axis=1)
    parameters = canlinear_colloc_to_interpolate(
        rows_u,
        rows_x,
        np.zeros_like(rows_u),
        identity,
        np.full(len(identity), bound),
        ceiling,
        None,
        grid,
        identical=True,
    )  # in this helper the last two come back swapped
    a, b, c, f, g, x_bound, u_bound = parameters

    class NormLimits(LinearConstraint):  # type: ignore[misc] # toppra ships no types
        def __init__(self) -> None:
            super().__init__()
            self.identical = True
            self.set_discretization_type(DiscretizationType.Interpolation)

        def compute_constraint_params(self, _path: _Path, _grid: Array) -> tuple[Array | None, ...]:
            return a, b, c, f, g, u_bound, x_bound

    return NormLimits()


def _acceleration_rows(first: Array, second: Array) -> tuple[Array, Array]:
    """Coefficients of u and x in every polygon row; (S, V, 3) twice to (S, V * DIRECTIONS) twice."""
    length = np.linalg.norm(first, axis=2)
    along = np.einsum("svk,svk->sv", first, second) / np.maximum(length, 1e-12)  # a vehicle at rest has q' = 0
    across = np.sqrt(np.maximum(np.einsum("svk,svk->sv", second, second) - along**2, 0.0))
    angle = np.linspace(0.0, np.pi, DIRECTIONS)
    rows_u = length[:, :, None] * np.cos(angle)
    rows_x = along[:, :, None] * np.cos(angle) + across[:, :, None] * np.sin(angle)
    return rows_u.reshape(len(first), -1), rows_x.reshape(len(first), -1)


def _squared_speed_bound(first: Array, limits: Limits) -> Array:
    """Largest squared path speed that no vehicle's speed, climb or descent limit forbids; (S, V, 3) to (S,)."""
    needs = np.stack(
        (
            np.linalg.norm(first, axis=2) / limits.speed_m_s,
            first[:, :, 2] / limits.climb_m_s,
            -first[:, :, 2] / limits.descent_m_s,
        )
    )
    bound: Array = 1.0 / np.maximum(needs.max(axis=(0, 2)), 1e-9) ** 2
    return bound
