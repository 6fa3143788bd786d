"""The flyable path of a swarm whose leaders moved freely: a moving frame, and a shape that changes in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Formation, Pose
from fg_gcs.core.separation import closest_approach
from fg_gcs.plan.path.rigid_path import OUTLINED, attitudes_at, ball_points
from fg_gcs.plan.path.splines import rotation_spline
from fg_gcs.plan.path.swarm_path import BodyPoints, ClosestApproach, PathPoint, SwarmPath, thinned

Indices = NDArray[np.intp]

SAMPLES = 8  # in each span for the closest pair: shapes change by centimetres a span


@dataclass(frozen=True)
class LeaderPath:
    """The leaders' places from start to hold, and the frame that the followers stand in; arrays are aligned."""

    leaders_m: Array  # (K, N, 3) [m; ENU]
    poses: tuple[Pose, ...]  # (K,) best fit of the formation's shape to the leaders
    iterates: int  # steps of the trust-region method, refused ones included

    def swarm_m(self, formation: Formation) -> Array:
        """Return every vehicle's places, leaders first, shape (K, V, 3) [m; ENU]."""
        centres = np.array([pose.centre_enu_m for pose in self.poses])
        rotations = np.array([pose.rotation for pose in self.poses])
        scaled = self.poses[0].scale * formation.followers_m
        followers = centres[:, None, :] + np.einsum("kij,vj->kvi", rotations, scaled)
        return np.concatenate((self.leaders_m, followers), axis=1)


class LeadersPath:
    """Leaders on their own paths and followers in their frame, twice continuously differentiable.

    The centre runs on a cubic spline, the attitude on a rotation spline, and the leaders' departures from their slots
    on a cubic spline in the template's axes. With ``p = t + d`` and the turning rate ``w``: ``q = c + R p``, ``q' =
    c' + w x R p + R p'``, ``q'' = c'' + w' x R p + w x (w x R p) + 2 w x R p' + R p''``. So turns cost no distance
    between iterates: followers are rigid, and pairs with a leader change as little as the shape does.

    The parameter sums the moves of the vehicle that moves furthest from iterate to iterate.
    """

    def __init__(self, formation: Formation, path: LeaderPath, slot_of: Indices | None = None) -> None:
        """Take the formation that was planned for, its leaders' path and the slot of every vehicle.

        Args:
            formation: its slots, leaders first.
            path: where the leaders pass.
            slot_of: vehicle v stands in slot ``slot_of[v]``, shape (V,); without it in slot v.
        """
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
        self._attitude = (support_m, *rotation_spline(support_m, rotations[kept]))
        self._leaders = CubicSpline(support_m, slots[kept, : len(formation.leaders_m)], bc_type="natural")
        self._followers_m = slots[0, len(formation.leaders_m) :]
        self._slot_of = np.arange(slots.shape[1]) if slot_of is None else slot_of

    @property
    def knots_m(self) -> Array:
        """Where the iterates are that the splines pass through, shape (K,) [m]."""
        return self._knots_m

    @property
    def length_m(self) -> float:
        """Sum of the largest moves of a vehicle from iterate to iterate [m]."""
        return float(self._knots_m[-1])

    @property
    def vehicles(self) -> int:
        """Number of vehicles."""
        return len(self._slot_of)

    @property
    def outline(self) -> SwarmPath:
        """The leaders, and few points that enclose all followers.

        Velocity and acceleration of a follower are affine in its slot, so their norms are convex: none exceeds the
        largest of any points around all of them. Few followers are their own outline; many get the corners around a
        ball.
        """
        if len(self._followers_m) <= OUTLINED:
            return self
        corners_m = float(np.linalg.norm(self._followers_m, axis=1).max()) * ball_points()
        return BodyPoints(self, corners_m, self.vehicles - len(self._followers_m) + len(corners_m))

    def at(self, s_m: Array) -> PathPoint:
        """Return the swarm at the parameters ``s_m``, shape (S,)."""
        return PathPoint(*(np.take(one, self._slot_of, axis=1) for one in self.points_at(s_m, self._followers_m)))

    def points_at(self, s_m: Array, followers_m: Array) -> PathPoint:
        """Return the leaders and any points that stand in their frame, shape (P, 3) [m; template], in this order."""
        rotation, rates, accelerations = attitudes_at(np.asarray(s_m, dtype=float), *self._attitude)
        rate, acceleration = rates[:, None, :], accelerations[:, None, :]
        arms = np.einsum("sij,svj->svi", rotation, self._slots(s_m, followers_m))
        shape1 = np.zeros_like(arms)
        shape2 = np.zeros_like(arms)
        leaders = self._leaders.c.shape[2]
        shape1[:, :leaders] = np.einsum("sij,snj->sni", rotation, self._leaders(s_m, 1))
        shape2[:, :leaders] = np.einsum("sij,snj->sni", rotation, self._leaders(s_m, 2))
        swing = np.cross(rate, arms)
        return PathPoint(
            self._centre(s_m)[:, None, :] + arms,
            self._centre(s_m, 1)[:, None, :] + swing + shape1,
            self._centre(s_m, 2)[:, None, :]
            + np.cross(acceleration, arms)
            + np.cross(rate, swing + 2.0 * shape1)
            + shape2,
        )

    def closest(self) -> ClosestApproach:
        """Return the closest approach of any pair, the shape's change between dense samples taken as straight."""
        shares = np.arange(SAMPLES) / SAMPLES
        inner = self._knots_m[:-1, None] + np.diff(self._knots_m)[:, None] * shares
        samples = np.append(inner.ravel(), self._knots_m[-1])
        slots = self._slots(samples, self._followers_m)
        if slots.shape[1] < 2:
            return ClosestApproach(np.inf, 0.0, (0, 0))
        found = closest_approach(slots, samples)
        one, other = sorted(np.argsort(self._slot_of)[list(found.pair)].tolist())  # the vehicles in these two slots
        return ClosestApproach(found.distance_m, found.time_s, (one, other))

    def _slots(self, s_m: Array, followers_m: Array) -> Array:
        """Return all slots in the moving frame, leaders first, shape (S, V, 3) [m; template]."""
        followers = np.broadcast_to(followers_m, (len(s_m), *followers_m.shape))
        return np.concatenate((self._leaders(s_m), followers), axis=1)
