"""The flyable path of a swarm whose leaders moved freely: a moving frame, and a shape that changes in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from fg_gcs.core.formation import Formation
from fg_gcs.core.separation import closest_approach
from fg_gcs.plan.free import LeaderPath
from fg_gcs.plan.paths import Approach, PathPoint, thinned

Array = NDArray[np.float64]

LOOKS = 8  # at each span for the closest pair: shapes change by centimetres a span, so that eight looks miss nothing


class LeadersPath:
    """Leaders on their own paths and followers in their frame, twice continuously differentiable.

    The centre runs on a cubic spline, the attitude on a rotation spline, and the leaders' departures from their slots
    on a cubic spline in the template's axes. With ``p = t + d`` and the turning rate ``w``: ``q = c + R p``, ``q' =
    c' + w x R p + R p'``, ``q'' = c'' + w' x R p + w x (w x R p) + 2 w x R p' + R p''``. So turns cost no distance
    between iterates: followers are rigid, and pairs with a leader change as little as the shape does.

    The parameter sums the moves of the vehicle that moves furthest from iterate to iterate.
    """

    def __init__(self, formation: Formation, path: LeaderPath) -> None:
        """Take the formation that was planned for and its leaders' path."""
        places = path.swarm_m(formation)  # (K, V, 3)
        moves_m = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1)
        ways_m = np.concatenate(([0.0], np.cumsum(moves_m)))
        kept = thinned(ways_m)
        self._knots_m = ways_m[kept]
        centres = np.array([pose.centre_enu_m for pose in path.poses])
        rotations = np.array([pose.rotation for pose in path.poses])
        slots = np.einsum("kji,kvj->kvi", rotations, places - centres[:, None, :])  # back into the template's axes
        # A path of one place has no length, but a spline needs two places for it
        support_m = self._knots_m if self.length_m > 0.0 else np.array([0.0, 1.0])
        self._centre = CubicSpline(support_m, centres[kept], bc_type="natural")
        self._attitude = RotationSpline(support_m, Rotation.from_matrix(rotations[kept]))
        self._leaders = CubicSpline(support_m, slots[kept, : len(formation.leaders_m)], bc_type="natural")
        self._followers_m = slots[0, len(formation.leaders_m) :]

    @property
    def knots_m(self) -> Array:
        """Where the iterates are that the splines pass through, shape (K,) [m]."""
        return self._knots_m

    @property
    def length_m(self) -> float:
        """Sum of the largest moves of a vehicle from iterate to iterate [m]."""
        return float(self._knots_m[-1])

    def at(self, s_m: Array) -> PathPoint:
        """Return the swarm at the parameters ``s_m``, shape (S,)."""
        rotation = self._attitude(s_m).as_matrix()  # (S, 3, 3)
        rate = np.einsum("sij,sj->si", rotation, self._attitude(s_m, 1))[:, None, :]  # from own axes to ENU
        growth = np.einsum("sij,sj->si", rotation, self._attitude(s_m, 2))[:, None, :]
        arms = np.einsum("sij,svj->svi", rotation, self._slots(s_m))
        bend = np.zeros_like(arms)
        second_bend = np.zeros_like(arms)
        leaders = self._leaders.c.shape[2]
        bend[:, :leaders] = np.einsum("sij,snj->sni", rotation, self._leaders(s_m, 1))
        second_bend[:, :leaders] = np.einsum("sij,snj->sni", rotation, self._leaders(s_m, 2))
        swing = np.cross(rate, arms)
        return PathPoint(
            self._centre(s_m)[:, None, :] + arms,
            self._centre(s_m, 1)[:, None, :] + swing + bend,
            self._centre(s_m, 2)[:, None, :]
            + np.cross(growth, arms)
            + np.cross(rate, swing + 2.0 * bend)
            + second_bend,
        )

    def closest(self) -> Approach:
        """Return the closest approach of any pair, the shape's change between dense samples taken as straight."""
        shares = np.arange(LOOKS) / LOOKS
        inner = self._knots_m[:-1, None] + np.diff(self._knots_m)[:, None] * shares
        samples = np.append(inner.ravel(), self._knots_m[-1])
        slots = self._slots(samples)
        if slots.shape[1] < 2:
            return Approach(np.inf, 0.0, (0, 0))
        found = closest_approach(slots, samples)
        return Approach(found.distance_m, found.time_s, found.pair)

    def _slots(self, s_m: Array) -> Array:
        """Return all vehicles in the moving frame, shape (S, V, 3) [m; template]."""
        followers = np.broadcast_to(self._followers_m, (len(s_m), *self._followers_m.shape))
        return np.concatenate((self._leaders(s_m), followers), axis=1)
