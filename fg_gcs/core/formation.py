"""Formation template: leaders on the rim of the face, followers behind it, placed by centre, attitude and scale.

Template axes: x along the face's normal (towards the target), y and z in the face. The origin is the centre of the
face. The normal follows the winding of the leaders by the right-hand rule.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from fg_gcs.core.arrays import Array

SAME_PLACE = 1e-6  # of the formation's size: slots nearer than this are one place


class Pose(NamedTuple):
    """Where a formation is, and how large."""

    centre_enu_m: Array  # (3,) centre of the face
    rotation: Array  # (3, 3) template axes to ENU; the first column is the face's normal
    scale: float = 1.0  # times the template


@dataclass(frozen=True)
class Formation:
    """Slots of a swarm around the centre of its face; the arrays are read-only."""

    leaders_m: Array  # (N, 3) rim of the face in its winding order, N >= 3, x = 0
    followers_m: Array  # (M, 3) slots behind the face, x <= 0

    def __post_init__(self) -> None:
        """Refuse shapes that have no face.

        Raises:
            ValueError: fewer than three leaders, leaders out of one plane or on one line, two slots in one place, or
                values not finite.
        """
        leaders = np.array(self.leaders_m, dtype=float).reshape(-1, 3)
        followers = np.array(self.followers_m, dtype=float).reshape(-1, 3)
        if len(leaders) < 3:
            raise ValueError(f"a face needs at least 3 leaders, got {len(leaders)}")
        if not (np.isfinite(leaders).all() and np.isfinite(followers).all()):
            raise ValueError("every slot needs finite coordinates")
        area_vector = 0.5 * np.cross(leaders, np.roll(leaders, -1, axis=0)).sum(axis=0)
        size = float(np.linalg.norm(leaders, axis=1).max())
        if area_vector[0] < 1e-6 * size**2:  # thinner than a millionth of its size is a line, not a face
            raise ValueError("the leaders must wind around the face's normal (x) and enclose an area")
        if np.abs(leaders[:, 0]).max() > 1e-9 * size:  # rounding of a decimal file, no more
            raise ValueError("the leaders must lie in the plane of the face (x = 0)")
        slots = np.concatenate((leaders, followers))
        same = cKDTree(slots).query_pairs(SAME_PLACE * float(np.abs(slots).max()))
        if same:
            first, second = (slot + 1 for slot in min(same))
            raise ValueError(
                f"slots {first} and {second} lie in one place (counted from 1, leaders first); every vehicle needs a "
                "slot of its own"
            )
        for name, array in (("leaders_m", leaders), ("followers_m", followers)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def slots_m(self) -> Array:
        """All slots, leaders first, shape (V, 3) [m; template]."""
        return np.concatenate((self.leaders_m, self.followers_m))

    @property
    def smallest_separation_m(self) -> float:
        """Distance of the closest pair of slots at scale one [m]."""
        return float(pdist(self.slots_m).min())

    @property
    def gyration_m(self) -> float:
        """Root mean square distance of the leaders from the centre of the face [m]."""
        return float(np.sqrt((self.leaders_m**2).sum(axis=1).mean()))

    @property
    def inscribed_radius_m(self) -> float:
        """Radius at scale one of the largest circle around the centre that fits into the face [m].

        It is the distance of the nearest edge; 0 if the centre lies outside the face.
        """
        begins = self.leaders_m[:, 1:]
        ends = np.roll(begins, -1, axis=0)
        edges = ends - begins
        shares = np.clip(-(begins * edges).sum(axis=1) / (edges**2).sum(axis=1), 0.0, 1.0)
        nearest_m = np.linalg.norm(begins + shares[:, None] * edges, axis=1).min()
        crossed = begins[:, 0] * ends[:, 1] - begins[:, 1] * ends[:, 0]
        turned_rad = np.arctan2(crossed, (begins * ends).sum(axis=1)).sum()  # a whole turn if the centre lies inside
        return float(nearest_m) if turned_rad > np.pi else 0.0

    def place(self, pose: Pose) -> Array:
        """Return every vehicle's position, shape (V, 3) [m; ENU]."""
        placed: Array = pose.centre_enu_m + pose.scale * self.slots_m @ pose.rotation.T
        return placed


def hemisphere(leaders: int, followers: int, edge_m: float) -> Formation:
    """Return the paper's hemisphere for any number of leaders [Hartley2021]_.

    The leaders are a regular polygon with the given edge on the rim, radius ``r``. Behind it, one follower stands
    behind every leader on the circle of radius ``r sqrt(3)/2`` at depth ``r/2``, and one at the pole at depth ``r``.

    Args:
        leaders: number of vehicles on the rim, >= 3.
        followers: 0 for a bare rim, 1 for the pole alone, ``leaders`` for the circle, ``leaders + 1`` for both.
        edge_m: distance of neighbouring leaders [m], > 0.

    Raises:
        ValueError: the shape has no such slots.
    """
    if leaders < 3 or not edge_m > 0.0:
        raise ValueError(f"a hemisphere needs at least 3 leaders and an edge above 0 m, got {leaders} and {edge_m}")
    if followers not in (0, 1, leaders, leaders + 1):
        raise ValueError(
            f"a hemisphere of {leaders} leaders has 0, 1, {leaders} or {leaders + 1} followers, got {followers}"
        )
    radius = edge_m / (2.0 * np.sin(np.pi / leaders))
    angles = -np.pi / 2 - np.pi / leaders + 2.0 * np.pi * np.arange(leaders) / leaders  # lower edge level
    rim = np.stack((np.zeros(leaders), radius * np.cos(angles), radius * np.sin(angles)), axis=1)
    circle = rim * np.sqrt(0.75) - np.array([radius / 2.0, 0.0, 0.0])
    pole = np.array([[-radius, 0.0, 0.0]])
    behind = [circle] * (followers >= leaders) + [pole] * (followers in (1, leaders + 1))
    return Formation(rim, np.concatenate(behind) if behind else np.empty((0, 3)))


def facing(normal_enu: Array, up_enu: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Array:
    """Return the attitude whose normal is given and whose z axis leans towards ``up_enu``, shape (3, 3).

    A normal along ``up_enu`` leaves the lean open; then z leans north, or east where the normal runs along both.

    Raises:
        ValueError: the normal has no direction.
    """
    length = float(np.linalg.norm(normal_enu))
    if not length > 0.0 or not np.isfinite(length):
        raise ValueError("the normal of the face needs a direction: three finite numbers, not all 0")
    x = np.asarray(normal_enu, dtype=float) / length
    for candidate in (np.asarray(up_enu, dtype=float), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])):
        y = np.cross(candidate, x)
        if np.linalg.norm(y) > 1e-3:  # a thousandth of a radian: below it the lean is noise
            y /= np.linalg.norm(y)
            return np.stack((x, y, np.cross(x, y)), axis=1)
    raise AssertionError("one of three different directions always differs from the normal")


def rolled(rotation: Array, roll_rad: float) -> Array:
    """Return an attitude turned about its own normal, shape (3, 3): counter-clockwise as seen from the target [rad]."""
    sin, cos = math.sin(roll_rad), math.cos(roll_rad)
    turned: Array = rotation @ np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
    return turned
