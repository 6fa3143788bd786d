"""WGS84, ENU, NED and yaw: the only place where signs flip.

Plans and files use ENU metres from the mission origin (x east, y north, z up). Each vehicle reports and obeys NED
metres from an origin of its own, as its autopilot lays it over the Earth: :class:`LocalFrames`, learnt on the ground,
join the two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array

# WGS84 defining constants (NIMA TR8350.2)
SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)
DERIVED_OVER_M: Final = 100.0  # to each side of the place that frames are joined for: about as far as swarms spread


class Geodetic(NamedTuple):
    """A place on the WGS84 ellipsoid; the altitude may be above sea level, as long as all are."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


Vector = tuple[float, float, float]


class Globe(Protocol):
    """How an autopilot lays its local frame over the Earth."""

    def local_m(self, place: Geodetic, origin: Geodetic) -> tuple[float, float]:
        """Return where a place lies in the local frame of an origin: northwards and eastwards [m]."""


class EquirectangularGlobe(NamedTuple):
    """North by the difference of latitudes, east by that of longitudes at the latitude between: ArduPilot's.

    `Location::get_distance_NE` of [ArduPilot], with a sphere of 0.011131884502 m per 1e-7 degrees.
    """

    radius_m: float

    def local_m(self, place: Geodetic, origin: Geodetic) -> tuple[float, float]:
        """Return where a place lies in the local frame of an origin: northwards and eastwards [m]."""
        between = math.cos(math.radians(0.5 * (place.latitude_deg + origin.latitude_deg)))
        north = math.radians(place.latitude_deg - origin.latitude_deg)
        return self.radius_m * north, self.radius_m * math.radians(_turn_deg(place, origin)) * between


class EquidistantGlobe(NamedTuple):
    """Azimuthal equidistant: lengths and directions from the origin are those on a sphere: PX4's.

    `MapProjection::project` of [PX4], with a sphere of 6371 km; the formula is of [Snyder1987], chapter 25.
    """

    radius_m: float

    def local_m(self, place: Geodetic, origin: Geodetic) -> tuple[float, float]:
        """Return where a place lies in the local frame of an origin: northwards and eastwards [m]."""
        latitude, at, turn = (
            math.radians(angle) for angle in (place.latitude_deg, origin.latitude_deg, _turn_deg(place, origin))
        )
        aside = math.cos(latitude) * math.sin(turn)
        # sin(latitude - at), and what curvature adds: differences of what is nearly the same lose digits
        ahead = math.sin(latitude - at) + math.sin(at) * math.cos(latitude) * 2.0 * math.sin(0.5 * turn) ** 2
        chord = math.hypot(aside, ahead)
        angle = math.atan2(
            chord, math.sin(at) * math.sin(latitude) + math.cos(at) * math.cos(latitude) * math.cos(turn)
        )
        scale = self.radius_m * (angle / chord if chord > 0.0 else 1.0)
        return scale * ahead, scale * aside


def _turn_deg(place: Geodetic, origin: Geodetic) -> float:
    """Return the difference of longitudes, the short way round [deg]."""
    return (place.longitude_deg - origin.longitude_deg + 180.0) % 360.0 - 180.0


class Seen(NamedTuple):
    """A vehicle's own frame as it is to be joined to the mission's.

    Attributes:
        globe: How it is laid over the Earth.
        origin: Where it has its zero.
        zero_up_m: Height of its zero in the mission's [m; up].
    """

    globe: Globe
    origin: Geodetic
    zero_up_m: float


class LocalFrames:
    """The own NED frames of V vehicles, seen from the mission's origin.

    An autopilot takes the Earth for a sphere, and lays its local frame over that, whose north is the meridian's at its
    own origin: its metres are up to 0.3 % longer or shorter than true ones, and turned. Over the few hundred metres of
    a swarm that is an affine map, exact to a millimetre near the place that it is made for.

    Attributes:
        origins_enu_m: Where they read (0, 0, 0), shape (V, 3) [m; ENU].
        axes: Metres eastwards and northwards (rows) per local metre eastwards and northwards (columns), shape
            (V, 2, 2).
        inverse: Local metres per metre, likewise.
        rows: Each vehicle's origin and axes as plain numbers: x, y, z, and the axes row by row.
    """

    def __init__(self, origins_enu_m: Array, axes: Array) -> None:
        self.origins_enu_m, self.axes = origins_enu_m, axes
        self.inverse: Array = np.linalg.inv(axes).astype(float)
        self.rows: list[list[float]] = np.column_stack((origins_enu_m, axes.reshape(-1, 4))).tolist()

    @classmethod
    def joined(cls, frames: Sequence[Seen], origin: Geodetic, around_enu_m: Array) -> LocalFrames:
        """Join vehicles' frames to the mission's.

        Args:
            frames: The vehicles' own.
            origin: Of the mission.
            around_enu_m: Where it has to be exact: where vehicles fly together, shape (3,) [m; ENU].
        """
        moves = [np.zeros(3), *(sign * DERIVED_OVER_M * axis for axis in np.eye(3)[:2] for sign in (1.0, -1.0))]
        places = [geodetic_from_enu(around_enu_m + move, origin) for move in moves]
        local = np.array(  # (V, 5, 2): eastwards, northwards
            [[seen.globe.local_m(place, seen.origin)[::-1] for place in places] for seen in frames]
        ).reshape(-1, 5, 2)
        derivative = np.stack((local[:, 1] - local[:, 2], local[:, 3] - local[:, 4]), axis=2) / (2.0 * DERIVED_OVER_M)
        axes: Array = np.linalg.inv(derivative).astype(float)
        flat = np.asarray(around_enu_m)[:2] - np.einsum("vij,vj->vi", axes, local[:, 0])
        return cls(np.column_stack((flat, [seen.zero_up_m for seen in frames])), axes)

    @classmethod
    def parallel(cls, origins_enu_m: Array) -> LocalFrames:
        """Return frames that are the mission's but for their origins, shape (V, 3) [m; ENU]."""
        return cls(np.asarray(origins_enu_m, dtype=float), np.tile(np.eye(2), (len(origins_enu_m), 1, 1)))

    def enu_m(self, local_enu_m: Array) -> Array:
        """Return mission positions of local ones whose axes are swapped already, shape (V, 3) each [m; ENU]."""
        places: Array = self.origins_enu_m + local_enu_m
        places[:, :2] = self.origins_enu_m[:, :2] + np.einsum("vij,vj->vi", self.axes, local_enu_m[:, :2])
        return places

    def one_enu_m(self, row: int, position_ned_m: Vector) -> Vector:
        """Return one vehicle's mission position of a local one [m], as plain numbers: thousands come in a second."""
        x, y, z, ee, en, ne, nn = self.rows[row]
        north, east, down = position_ned_m
        return (x + ee * east + en * north, y + ne * east + nn * north, z - down)

    def moved(self, row: int, by_enu_m: Array) -> LocalFrames:
        """Return the frames with the origin of one of them moved, shape (3,) [m; ENU]."""
        origins = self.origins_enu_m.copy()
        origins[row] += by_enu_m
        return LocalFrames(origins, self.axes)


def rotate_ned_enu(vector: Vector) -> Vector:
    """Turn the components of a direction, such as a velocity, from NED to ENU or back."""
    first, second, third = vector
    return (second, first, -third)


def swap_ned_enu(vector: Array) -> Array:
    """Turn NED components into ENU ones or back, shape (..., 3): swap the first two, negate the third."""
    given = np.asarray(vector, dtype=float)
    swapped = np.empty_like(given)
    swapped[..., 0], swapped[..., 1] = given[..., 1], given[..., 0]
    np.negative(given[..., 2], out=swapped[..., 2])
    return swapped


@kernel
def yaw_from_enu(east: float, north: float) -> float:
    """Return the heading of a direction, clockwise from north [rad; [-pi, pi]]."""
    return math.atan2(east, north)


@kernel
def turned_towards(before_rad: Array, wanted_rad: Array, most_rad: float) -> Array:
    """Return headings turned towards wanted ones the short way, by no more than an angle.

    Args:
        before_rad: where they point, shape (V,) [rad].
        wanted_rad: where they are to point, shape (V,) [rad]; one that is no number leads to none.
        most_rad: angle, >= 0 [rad].

    Returns:
        Headings, shape (V,) [rad; [-pi, pi)].
    """
    turned = np.empty(len(before_rad))
    for v in range(len(before_rad)):
        shortest = (wanted_rad[v] - before_rad[v] + math.pi) % (2.0 * math.pi) - math.pi
        if math.isfinite(shortest):
            shortest = min(max(shortest, -most_rad), most_rad)
        turned[v] = (before_rad[v] + shortest + math.pi) % (2.0 * math.pi) - math.pi
    return turned


def enu_from_geodetic(place: Geodetic, origin: Geodetic) -> Array:
    """Return where a place lies from the origin, shape (3,) [m; ENU], exact through Earth-centred coordinates."""
    return _axes(origin) @ (_earth_centred(place) - _earth_centred(origin))


def geodetic_from_enu(position_enu_m: Array, origin: Geodetic) -> Geodetic:
    """Return the place of an ENU position [deg, deg, m]; the inverse of :func:`enu_from_geodetic`.

    Newton's iteration on the forward map with the local radii of curvature; three rounds reach a nanometre within
    100 km.
    """
    place = origin
    for _ in range(4):
        rest = _axes(place) @ (_axes(origin).T @ position_enu_m + _earth_centred(origin) - _earth_centred(place))
        latitude = np.radians(place.latitude_deg)
        w2 = 1.0 - ECCENTRICITY2 * np.sin(latitude) ** 2
        normal = SEMI_MAJOR_M / np.sqrt(w2)
        meridian = normal * (1.0 - ECCENTRICITY2) / w2
        place = Geodetic(
            place.latitude_deg + float(np.degrees(rest[1] / (meridian + place.altitude_m))),
            place.longitude_deg + float(np.degrees(rest[0] / ((normal + place.altitude_m) * np.cos(latitude)))),
            place.altitude_m + float(rest[2]),
        )
    return place


def _earth_centred(place: Geodetic) -> Array:
    latitude, longitude = np.radians(place.latitude_deg), np.radians(place.longitude_deg)
    normal = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY2 * np.sin(latitude) ** 2)
    return np.array(
        [
            (normal + place.altitude_m) * np.cos(latitude) * np.cos(longitude),
            (normal + place.altitude_m) * np.cos(latitude) * np.sin(longitude),
            (normal * (1.0 - ECCENTRICITY2) + place.altitude_m) * np.sin(latitude),
        ]
    )


def _axes(place: Geodetic) -> Array:
    latitude, longitude = np.radians(place.latitude_deg), np.radians(place.longitude_deg)
    east = [-np.sin(longitude), np.cos(longitude), 0.0]
    up = [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
    return np.array([east, np.cross(up, east), up])
