"""What all vehicles of a fleet keep in arrays, one row each, so that telemetry is made for many at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl_mock.physics.arrays import Array
from sitl_mock.physics.geodesy import World
from sitl_mock.physics.reference import Vec3


class VehicleTable:
    """V vehicles.

    Args:
        pads_ned_m: (V, 3) where they stand at the start; world NED.
        origin_errors_m: (V, 3) each one's local origin minus its pad.
        world: where they are.
        earth_radius_m: of the sphere that their local frames are on.

    Attributes:
        origin_ned_m: (V, 3) where each one's local frame has its zero; world.
        told_origin_error_m: (V, 3) by how much GPS_GLOBAL_ORIGIN is wrong.
        home_ned_m: (V, 3) where each one was armed; world.
        positioned: (V,) whether each one's estimator has a position.
        gps_fixed: (V,) whether each one's receiver has satellites.
        clock_zero_s: (V,) simulated time at which each one's own clock read zero [s].
        clock_rate: (V,) seconds of each one's own clock per second of simulated time.
    """

    def __init__(self, pads_ned_m: Array, origin_errors_m: Array, world: World, earth_radius_m: float) -> None:
        vehicles = len(pads_ned_m)
        self.origin_ned_m = pads_ned_m + origin_errors_m
        self.told_origin_error_m = np.zeros((vehicles, 3))
        self._origin_errors_m = origin_errors_m
        self.home_ned_m = pads_ned_m.copy()
        self._world, self._earth_radius_m = world, earth_radius_m
        places = self.origin_ned_m.tolist()
        self._axes = np.array([world.local_axes(earth_radius_m, *place) for place in places]).reshape(-1, 2, 2)
        self._inverse = np.linalg.inv(self._axes)
        self.positioned = np.zeros(vehicles, dtype=bool)
        self.gps_fixed = np.zeros(vehicles, dtype=bool)
        self.clock_zero_s = np.zeros(vehicles)
        self.clock_rate = np.ones(vehicles)

    def local_m(self, rows: int | NDArray[np.intp], position_ned_m: Array) -> Array:
        """World positions (..., 3) in the local frames of the vehicles at `rows` (...,)."""
        local: Array = position_ned_m - self.origin_ned_m[rows]
        local[..., :2] = np.einsum("...ij,...j->...i", self._axes[rows], local[..., :2])
        return local

    def world_m(self, row: int, local_m: Vec3) -> Vec3:
        """A position in one vehicle's local frame as one in the world."""
        north_m, east_m, down_m = self.origin_ned_m[row].tolist()
        (nn, ne), (en, ee) = self._inverse[row].tolist()
        north, east, down = local_m
        return (north_m + nn * north + ne * east, east_m + en * north + ee * east, down_m + down)

    def restart(self, row: int, now_s: float, place_ned_m: Vec3) -> None:
        """A vehicle boots anew: its clock reads zero, and its local frame will be where it is now."""
        self.clock_zero_s[row], self.clock_rate[row] = now_s, 1.0
        self.origin_ned_m[row] = np.array(place_ned_m) + self._origin_errors_m[row]
        self._axes[row] = self._world.local_axes(self._earth_radius_m, *self.origin_ned_m[row].tolist())
        self._inverse[row] = np.linalg.inv(self._axes[row])
        self.told_origin_error_m[row] = 0.0
        self.positioned[row] = self.gps_fixed[row] = False

    def change_clock(self, row: int, now_s: float, by_s: float, gain: float) -> None:
        """A vehicle's own clock jumps, and goes on gaining seconds per second beside its present rate."""
        reads_s = self.clock_s(row, now_s) + by_s
        self.clock_rate[row] += gain
        self.clock_zero_s[row] = now_s - reads_s / self.clock_rate[row]

    def clock_s(self, row: int, now_s: float) -> float:
        """What a vehicle's own clock reads [s]."""
        return float((now_s - self.clock_zero_s[row]) * self.clock_rate[row])


def vec3(row: Array) -> Vec3:
    """A row of an array (V, 3) as plain numbers."""
    x, y, z = row.tolist()
    return (x, y, z)
