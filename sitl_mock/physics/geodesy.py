"""WGS84 and the simulator's flat world: latitude, longitude, height <-> ENU metres at an origin."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sitl_mock.physics.arrays import Array

SEMI_MAJOR_M = 6378137.0  # WGS84
FLATTENING = 1.0 / 298.257223563  # WGS84
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)
ITERATIONS = 6  # height and latitude agree to below a nanometre after five, for any height in the air


@dataclass(frozen=True, slots=True)
class Geodetic:
    """A point: degrees, and metres above the ellipsoid (the simulator takes it for sea level)."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


def _ecef_m(point: Geodetic) -> tuple[float, float, float]:
    latitude, longitude = math.radians(point.latitude_deg), math.radians(point.longitude_deg)
    normal_m = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY2 * math.sin(latitude) ** 2)
    across_m = (normal_m + point.altitude_m) * math.cos(latitude)
    return (
        across_m * math.cos(longitude),
        across_m * math.sin(longitude),
        (normal_m * (1.0 - ECCENTRICITY2) + point.altitude_m) * math.sin(latitude),
    )


def _geodetic(x_m: float, y_m: float, z_m: float) -> Geodetic:
    across_m = math.hypot(x_m, y_m)
    latitude = math.atan2(z_m, across_m * (1.0 - ECCENTRICITY2))
    normal_m = SEMI_MAJOR_M
    for _ in range(ITERATIONS):
        normal_m = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY2 * math.sin(latitude) ** 2)
        latitude = math.atan2(z_m + ECCENTRICITY2 * normal_m * math.sin(latitude), across_m)
    # Along the radius at the latitude: sound at the poles too, where across / cos is 0 / 0.
    height_m = (
        across_m * math.cos(latitude)
        + z_m * math.sin(latitude)
        - SEMI_MAJOR_M * math.sqrt(1.0 - ECCENTRICITY2 * math.sin(latitude) ** 2)
    )
    return Geodetic(math.degrees(latitude), math.degrees(math.atan2(y_m, x_m)), height_m)


def _axes(point: Geodetic) -> Array:
    """North, east and down at a point, the rows of (3, 3), in Earth-centred coordinates."""
    latitude, longitude = math.radians(point.latitude_deg), math.radians(point.longitude_deg)
    sin_b, cos_b, sin_l, cos_l = math.sin(latitude), math.cos(latitude), math.sin(longitude), math.cos(longitude)
    return np.array(
        [[-sin_b * cos_l, -sin_b * sin_l, cos_b], [-sin_l, cos_l, 0.0], [-cos_b * cos_l, -cos_b * sin_l, -sin_b]]
    )


class World:
    """The tangent plane at an origin.

    Args:
        origin: where NED (0, 0, 0) is.
    """

    def __init__(self, origin: Geodetic) -> None:
        self.origin = origin
        self._origin_m = _ecef_m(origin)
        latitude, longitude = math.radians(origin.latitude_deg), math.radians(origin.longitude_deg)
        self._sin_latitude, self._cos_latitude = math.sin(latitude), math.cos(latitude)
        self._sin_longitude, self._cos_longitude = math.sin(longitude), math.cos(longitude)

    def geodetic(self, north_m: float, east_m: float, down_m: float) -> Geodetic:
        """The point at NED metres from the origin."""
        sin_b, cos_b = self._sin_latitude, self._cos_latitude
        sin_l, cos_l = self._sin_longitude, self._cos_longitude
        outwards_m = -sin_b * north_m - cos_b * down_m  # in the meridian plane, away from the axis
        return _geodetic(
            self._origin_m[0] + cos_l * outwards_m - sin_l * east_m,
            self._origin_m[1] + sin_l * outwards_m + cos_l * east_m,
            self._origin_m[2] + cos_b * north_m - sin_b * down_m,
        )

    def geodetic_rows(self, ned_m: Array) -> Array:
        """Latitude, longitude [deg] and altitude [m] (V, 3) of points (V, 3) at NED metres from the origin."""
        north_m, east_m, down_m = ned_m.T
        sin_b, cos_b = self._sin_latitude, self._cos_latitude
        sin_l, cos_l = self._sin_longitude, self._cos_longitude
        outwards_m = -sin_b * north_m - cos_b * down_m
        x_m = self._origin_m[0] + cos_l * outwards_m - sin_l * east_m
        y_m = self._origin_m[1] + sin_l * outwards_m + cos_l * east_m
        z_m = self._origin_m[2] + cos_b * north_m - sin_b * down_m
        across_m = np.hypot(x_m, y_m)
        latitude = np.arctan2(z_m, across_m * (1.0 - ECCENTRICITY2))
        for _ in range(ITERATIONS):
            normal_m = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY2 * np.sin(latitude) ** 2)
            latitude = np.arctan2(z_m + ECCENTRICITY2 * normal_m * np.sin(latitude), across_m)
        sin, cos = np.sin(latitude), np.cos(latitude)
        height_m = across_m * cos + z_m * sin - SEMI_MAJOR_M * np.sqrt(1.0 - ECCENTRICITY2 * sin**2)
        return np.stack((np.degrees(latitude), np.degrees(np.arctan2(y_m, x_m)), height_m), axis=1)

    def local_axes(self, radius_m: float, north_m: float, east_m: float, down_m: float) -> Array:
        """How an autopilot's local frame shows true metres, at a place: local N, E (rows) per N, E of the world (2, 2).

        An autopilot takes the Earth for a sphere of `radius_m` (ArduPilot 6378.1 km, PX4 6371 km): its local north is
        that times a difference of latitudes, its east that times a difference of longitudes and the cosine of the
        latitude. True lengths go by WGS84's radii of curvature, in the meridian M and across it N: the scales are R/M
        and R/N. Meridians converge, so that a local north at another longitude is turned.
        """
        here = self.geodetic(north_m, east_m, down_m)
        shape = 1.0 - ECCENTRICITY2 * math.sin(math.radians(here.latitude_deg)) ** 2
        across_m = SEMI_MAJOR_M / math.sqrt(shape)
        meridian_m = across_m * (1.0 - ECCENTRICITY2) / shape
        scales = np.array([[radius_m / (meridian_m + here.altitude_m)], [radius_m / (across_m + here.altitude_m)]])
        turned: Array = scales * (_axes(here) @ _axes(self.origin).T)[:2, :2]
        return turned

    def ned_m(self, point: Geodetic) -> tuple[float, float, float]:
        """NED metres from the origin to a point."""
        x_m, y_m, z_m = (a - b for a, b in zip(_ecef_m(point), self._origin_m, strict=True))
        sin_b, cos_b = self._sin_latitude, self._cos_latitude
        sin_l, cos_l = self._sin_longitude, self._cos_longitude
        outwards_m = cos_l * x_m + sin_l * y_m
        return (
            -sin_b * outwards_m + cos_b * z_m,
            -sin_l * x_m + cos_l * y_m,
            -cos_b * outwards_m - sin_b * z_m,
        )
