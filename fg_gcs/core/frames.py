"""WGS84, ENU, NED and yaw: the only place where signs flip.

Plans and files use ENU metres from the mission origin (x east, y north, z up). Each vehicle reports and obeys NED
metres from an origin of its own, so one :class:`LocalFrame` a vehicle, learnt on the ground, joins the two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array

# WGS84 defining constants (NIMA TR8350.2)
SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)


class Geodetic(NamedTuple):
    """A place on the WGS84 ellipsoid; the altitude may be above sea level, as long as all are."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


Vector = tuple[float, float, float]


@dataclass(frozen=True)
class LocalFrame:
    """A vehicle's own NED frame, seen from the mission origin.

    Its methods take one vector as plain floats: a position report has no use for arrays, and thousands come
    in a second. :func:`swap_ned_enu` is the same for arrays.
    """

    origin_enu_m: Vector  # where the vehicle reads (0, 0, 0)

    def enu_from_ned(self, position_ned_m: Vector) -> Vector:
        """Return the mission position of a local one [m]."""
        north, east, down = position_ned_m
        x, y, z = self.origin_enu_m
        return (x + east, y + north, z - down)

    def ned_from_enu(self, position_enu_m: Vector) -> Vector:
        """Return the local position of a mission one [m]."""
        east, north, up = position_enu_m
        x, y, z = self.origin_enu_m
        return (north - y, east - x, z - up)


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
