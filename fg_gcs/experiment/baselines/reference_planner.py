"""The paper's way to a plan, as a baseline: general tools from end to end [Hartley2021]_.

SciPy's ``trust-constr`` maximises the flux of four free leaders under equal edge lengths, its gradient taken by
central differences. The iterates are the path; they are thinned, followers are placed from the leaders' frame, and
every vehicle is timed by itself with one box per axis for its speed and one for its acceleration. The paper states
the limits as norms; boxes let the norms grow by up to ``sqrt(3)``.

Nothing else uses this module than comparisons; speeds elsewhere are quoted against it.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Formation
from fg_gcs.errors import PlanError
from fg_gcs.plan.limits import Limits

DIFFERENCE_M = 1e-6  # half the span of the central difference: the cube root of the rounding error times some metres
TOLERANCE = 1e-8  # of gradient and step; the flux changes by 1e-5 a step far away, so larger ones stop on the way
MAX_ITERATES = 1000  # SciPy's own default; a plan takes 50 to 700
THINNED_M = 3.0  # iterates closer than this to the one kept before are dropped


class PaperPath(NamedTuple):
    """What the optimiser passed."""

    leaders_enu_m: Array  # (K, 4, 3), the start first [m]
    edge_m: float  # that the constraints ask for [m]

    @property
    def length_m(self) -> float:
        """Way of all leaders together [m]."""
        return float(np.linalg.norm(np.diff(self.leaders_enu_m, axis=0), axis=2).sum())


class PaperPlan(NamedTuple):
    """Every vehicle's own timing; toppra's trajectories have no types."""

    vehicles: tuple[Any, ...]  # each is called with times (T,) and the order of the derivative

    @property
    def duration_s(self) -> float:
        """Until the last vehicle has arrived [s]."""
        return float(max(each.duration for each in self.vehicles))

    def norms(self, time_s: Array, order: int) -> Array:
        """Return the norms of the velocities (order 1) or accelerations (2), shape (T, V) [m/s or m/s^2]."""
        inside = [np.clip(time_s, 0.0, each.duration) for each in self.vehicles]
        values = [np.linalg.norm(each(at, order), axis=1) for each, at in zip(self.vehicles, inside, strict=True)]
        return np.stack(values, axis=1)


def plan_leaders(leaders_enu_m: Array, target_enu_m: Array, edge_m: float) -> PaperPath:
    """Return the iterates of ``trust-constr`` from four leaders to a target.

    Args:
        leaders_enu_m: where the leaders start, in winding order, shape (4, 3) [m]; their edges may differ
                from ``edge_m``.
        target_enu_m: the point source, shape (3,) [m].
        edge_m: length that the constraints hold every edge to, from the first iterate on [m].
    """
    from scipy.optimize import SR1, NonlinearConstraint, minimize

    start = np.array(leaders_enu_m, dtype=float)
    iterates = [start]

    def loss(places: Array) -> float:
        return -face_flux(places.reshape(4, 3), target_enu_m)

    def gradient(places: Array) -> Array:
        return central_gradient(loss, places)

    def keep(places: Array, _state: object) -> bool:
        iterates.append(places.reshape(4, 3).copy())
        return False

    curvature: Any = _edge_curvature  # the stubs leave out the multipliers, its second argument
    edges = NonlinearConstraint(_squared_edges, edge_m**2, edge_m**2, jac=_edge_slopes, hess=curvature)
    run: Any = minimize  # the stubs know neither this method's callback nor its options
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # SR1 skips an update where the flux is linear; it goes on well
        run(
            loss,
            start.ravel(),
            jac=gradient,
            hess=SR1(),
            method="trust-constr",
            constraints=[edges],
            callback=keep,
            options={"maxiter": MAX_ITERATES, "gtol": TOLERANCE, "xtol": TOLERANCE},
        )
    return PaperPath(np.array(iterates), edge_m)


def plan_swarm(path: PaperPath, formation: Formation, limits: Limits) -> PaperPlan:
    """Thin the path, place the followers, and time every vehicle by itself.

    Raises:
        PlanError: toppra finds no timing for a vehicle.
    """
    import toppra
    from toppra import algorithm, constraint

    logging.getLogger("toppra").setLevel(logging.ERROR)  # its warnings come back as one error below
    places = place_followers(thinned(path.leaders_enu_m), formation, path.edge_m)
    knots = np.linspace(0.0, 1.0, len(places))
    boxes = [
        constraint.JointVelocityConstraint(np.full((3, 2), limits.speed_m_s) * (-1.0, 1.0)),
        constraint.JointAccelerationConstraint(np.full((3, 2), limits.acceleration_m_s2) * (-1.0, 1.0)),
    ]
    timed = []
    for vehicle in range(places.shape[1]):
        spline = toppra.SplineInterpolator(knots, places[:, vehicle])
        trajectory = algorithm.TOPPRA(boxes, spline, parametrizer="ParametrizeConstAccel").compute_trajectory()
        if trajectory is None:
            raise PlanError(f"the paper's way: no timing of vehicle {vehicle + 1} keeps the boxes")
        timed.append(trajectory)
    return PaperPlan(tuple(timed))


def face_flux(leaders: Array, target: Array) -> float:
    """Return the flux through the two triangles of a face of four leaders, shapes (4, 3) and (3,) [sr]."""
    rays = target - leaders
    return _triangle_flux(rays[0], rays[1], rays[2]) + _triangle_flux(rays[0], rays[2], rays[3])


def central_gradient(function: Callable[[Array], float], places: Array) -> Array:
    """Return the gradient of a function of one vector by central differences, shape of ``places``."""
    gradient = np.empty_like(places)
    for index in range(len(places)):
        move = np.zeros_like(places)
        move[index] = DIFFERENCE_M
        gradient[index] = (function(places + move) - function(places - move)) / (2.0 * DIFFERENCE_M)
    return gradient


def thinned(iterates: Array) -> Array:
    """Drop iterates within ``THINNED_M`` of the one kept before; both ends stay; (K, 4, 3) to (k, 4, 3)."""
    centres = iterates.mean(axis=1)
    kept = [0]
    for index in range(1, len(iterates) - 1):
        far = np.linalg.norm(centres[index] - centres[kept[-1]]) >= THINNED_M
        if far and np.linalg.norm(centres[-1] - centres[index]) >= THINNED_M:
            kept.append(index)
    return iterates[[*kept, len(iterates) - 1]]


def place_followers(leaders: Array, formation: Formation, edge_m: float) -> Array:
    """Return all vehicles, the followers from the leaders' frame by vector algebra; (K, 4, 3) to (K, V, 3) [m]."""
    normal = np.cross(leaders[:, 2] - leaders[:, 0], leaders[:, 3] - leaders[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = leaders[:, 1] - leaders[:, 0]
    along -= np.einsum("kc,kc->k", along, normal)[:, None] * normal
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    frame = np.stack((normal, along, np.cross(normal, along)), axis=2)  # (K, 3, 3) template axes to ENU
    template_m = float(np.linalg.norm(formation.leaders_m[1] - formation.leaders_m[0]))
    arms = np.einsum("kcd,vd->kvc", frame, formation.followers_m * (edge_m / template_m))
    return np.concatenate((leaders, leaders.mean(axis=1, keepdims=True) + arms), axis=1)


def _triangle_flux(first: Array, second: Array, third: Array) -> float:
    one, two, three = (math.sqrt(ray @ ray) for ray in (first, second, third))
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = first.tolist(), second.tolist(), third.tolist()
    top = (ay * bz - az * by) * cx + (az * bx - ax * bz) * cy + (ax * by - ay * bx) * cz
    bottom = one * two * three + (first @ second) * three + (first @ third) * two + (second @ third) * one
    return 2.0 * math.atan2(top, bottom)


def _squared_edges(places: Array) -> Array:
    edges = _edges(places)
    return np.asarray((edges * edges).sum(axis=1))


def _edge_slopes(places: Array) -> Array:
    """Jacobian of the squared edge lengths, shape (4, 12)."""
    edges = _edges(places)
    slopes = np.zeros((4, 4, 3))
    index = np.arange(4)
    slopes[index, index] = -2.0 * edges
    slopes[index, (index + 1) % 4] = 2.0 * edges
    return slopes.reshape(4, 12)


def _edge_curvature(_places: Array, weights: Array) -> Array:
    """Hessian of the weighted sum of the squared edge lengths, shape (12, 12); it is constant."""
    differences = np.roll(np.eye(4), 1, axis=1) - np.eye(4)
    return np.asarray(np.kron(2.0 * differences.T @ (weights[:, None] * differences), np.eye(3)), dtype=float)


def _edges(places: Array) -> Array:
    leaders = places.reshape(4, 3)
    return np.roll(leaders, -1, axis=0) - leaders
