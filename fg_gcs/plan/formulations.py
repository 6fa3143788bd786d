"""The two formulations of Flux Guided planning behind one interface: rigid and free.

``rigid`` moves the formation as one body; it can change its size, face several charges and bend its path inside a
fence. ``free`` is the paper's own: every leader moves, and only the edges of the face keep their lengths
[Hartley2021]_. Whatever comes after the search, timing, verification and flight, knows paths of swarms alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Formation, Pose
from fg_gcs.core.separation import Fence
from fg_gcs.errors import PlanError
from fg_gcs.plan.flux_guided import FluxPath, plan_path
from fg_gcs.plan.free import plan_leaders
from fg_gcs.plan.path.leader_paths import LeaderPath, LeadersPath
from fg_gcs.plan.path.rigid_path import PosePath
from fg_gcs.plan.path.swarm_path import SwarmPath
from fg_gcs.plan.rules import outside
from fg_gcs.plan.targets import Charges

Indices = NDArray[np.intp]

FormulationName = Literal["rigid", "free"]

SAME_SCALE = 1e-9  # scales nearer than this are one
ROTATION = 1e-6  # how far an attitude's columns may be from orthonormal: attitudes are computed, not typed
FENCE_STEP_M = (
    0.1  # between samples of a path that are held against the fence; the verification after timing samples more densely
)
INSTEAD = 'use formulation = "rigid" ([plan])'


class SearchedPath(Protocol):
    """What a search found, before anybody knows which vehicle stands where."""

    @property
    def iterates(self) -> int:
        """Steps of the search, refused ones included."""

    def swarm_path(self, goal_of: Indices) -> SwarmPath:
        """Return the path of the vehicles, vehicle v in slot ``goal_of[v]``, shape (V,)."""


class Formulation(Protocol):
    """A way to search for the path of a formation that surrounds a target."""

    def __call__(
        self,
        formation: Formation,
        start: Pose,
        source: Array | Charges,
        hold_depth_m: float,
        last_scale: float,
        fence: Fence,
    ) -> SearchedPath:
        """Return the path that ends with the target on the face's axis.

        Args:
            formation: slots around the face's centre.
            start: where the face is.
            source: a point, shape (3,) [m; ENU], or several charges.
            hold_depth_m: how far the target, or the charges' centre, finally lies behind the face, >= 0 [m].
            last_scale: scale of the formation at the end, > 0.
            fence: the box that no vehicle may leave.

        Raises:
            PlanError: there is no such path, or the formulation cannot do this; then it says which can.
        """


@dataclass(frozen=True)
class RigidPath:
    """A path along which the formation keeps its shape."""

    formation: Formation
    found: FluxPath

    @property
    def iterates(self) -> int:
        """Steps of the search, refused ones included."""
        return self.found.iterates

    def swarm_path(self, goal_of: Indices) -> SwarmPath:
        """Return the path of the vehicles, vehicle v in slot ``goal_of[v]``, shape (V,)."""
        return PosePath(self.formation.slots_m[goal_of], self.found.poses)


@dataclass(frozen=True)
class FreePath:
    """A path on which leaders leave their slots and return to them."""

    formation: Formation
    found: LeaderPath

    @property
    def iterates(self) -> int:
        """Steps of the search, refused ones included."""
        return self.found.iterates

    def swarm_path(self, goal_of: Indices) -> SwarmPath:
        """Return the path of the vehicles, vehicle v in slot ``goal_of[v]``, shape (V,)."""
        return LeadersPath(self.formation, self.found, goal_of)


def rigid(
    formation: Formation, start: Pose, source: Array | Charges, hold_depth_m: float, last_scale: float, fence: Fence
) -> RigidPath:
    """Search with the formation as one body, see :class:`Formulation`.

    Raises:
        PlanError: there is no such path.
    """
    _check_start(start)
    return RigidPath(formation, plan_path(formation, start, source, hold_depth_m, last_scale=last_scale, fence=fence))


def free(
    formation: Formation, start: Pose, source: Array | Charges, hold_depth_m: float, last_scale: float, fence: Fence
) -> FreePath:
    """Search with every leader moving by itself, see :class:`Formulation`.

    Raises:
        PlanError: there is no such path, the formation would have to change its size, there are several charges, or the
            path leaves the fence.
    """
    _check_start(start)
    if isinstance(source, Charges):
        raise PlanError(f"the free formulation is guided by one source, not by {len(source.weights)}; {INSTEAD}")
    if not abs(last_scale - start.scale) <= SAME_SCALE:
        raise PlanError(
            f"the free formulation cannot change the formation's size, but the target needs it {last_scale:.2f} times "
            f"the template's; {INSTEAD}"
        )
    found = plan_leaders(formation, start, source, hold_depth_m)
    outside_m = _outside_m(formation, found, fence)
    if outside(outside_m):
        raise PlanError(
            f"the free formulation's path would be {outside_m:.2f} m outside the fence and it cannot bend it; {INSTEAD}"
        )
    return FreePath(formation, found)


def _outside_m(formation: Formation, found: LeaderPath, fence: Fence) -> float:
    """By how much a free path leaves the fence, negative inside [m]."""
    places = found.swarm_m(formation)  # (K, V, 3)
    longest_m = float(np.linalg.norm(np.diff(places, axis=0), axis=2).max(initial=0.0))
    outside_m = float(fence.excess_m(places).max())
    if outside_m < -longest_m:  # between two places the spline bulges by less than their distance
        return outside_m
    path = LeadersPath(formation, found)
    samples_m = np.linspace(0.0, path.length_m, 2 + int(path.length_m / FENCE_STEP_M))
    return float(fence.excess_m(path.at(samples_m).position_m).max())


FORMULATIONS: Final[Mapping[FormulationName, Formulation]] = MappingProxyType({"rigid": rigid, "free": free})


def _check_start(start: Pose) -> None:
    centre, rotation = np.asarray(start.centre_enu_m), np.asarray(start.rotation)
    if centre.shape != (3,) or rotation.shape != (3, 3) or not np.isfinite(centre).all():
        raise PlanError("the start must have a finite centre of three numbers and an attitude of three by three")
    if not (np.abs(rotation.T @ rotation - np.eye(3)).max() <= ROTATION and np.linalg.det(rotation) > 0.0):
        raise PlanError("the start's attitude must be a rotation: orthonormal, right-handed, finite")
