"""Local frames that do not lie where they are taken to: by what positions do, and by positions on Earth.

A vehicle that flies from p0 to p1 within t at the velocities v0 and v1 has come e = p1 - p0 - (v0 + v1) t / 2 further
than it flew, of which a t^2 / 4 may be due to an acceleration of a. Whatever remains is the frame's own way, which
shows in one sample if it jumps; one that creeps by less than some 2 m/s cannot be told from velocities that are wrong.
That one shows, horizontally, in where the vehicle says that it is on Earth: its local frame, laid over the Earth as its
autopilot does that, says another place then. The vehicle stays where it is when its frame moves, so that the frame is
joined to the mission's anew, by as much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic, Globe, swap_ned_enu
from fg_gcs.wire.states import StateTable
from fg_gcs.wire.vehicle import Pairing, Vehicle

MOVED_M: Final = 0.6
PAIRS: Final = 2  # in a row that say so: one may be of the moment of a jump
FORGETS_S: Final = 0.2  # time constant: PX4's simulated estimate has velocities that are wrong by 0.8 m/s for seconds
MOST_ACCELERATION_M_S2: Final = 10.0  # of any vehicle, in gusts and braking


def away_m(vehicle: Vehicle) -> float | None:
    """Return how far a vehicle's local frame lies from where it says [m]; None: that cannot be told."""
    if vehicle.origin is None or vehicle.pairing is None:
        return None
    return math.hypot(*_away_m(vehicle.pairing, vehicle.profile.globe, Geodetic(*vehicle.origin)))


def _away_m(pairing: Pairing, globe: Globe, origin: Geodetic) -> tuple[float, float]:
    """Return how far the place of a pairing lies from where its local position says, northwards and eastwards [m]."""
    north, east = globe.local_m(pairing.place, origin)
    return north - pairing.north_m, east - pairing.east_m


class _Laid:
    """A frame as it is taken to lie on Earth: as it was when it was learnt, and moved by what was noticed since."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._origin = None if vehicle.origin is None else Geodetic(*vehicle.origin)
        self._known_m = (0.0, 0.0)  # by how much it has moved, northwards and eastwards
        self._seen_s = -math.inf
        self._pairs = 0

    def joined(self, by_enu_m: Array) -> None:
        """Take it that it has moved by so much, shape (3,) [m; ENU]."""
        north, east = self._known_m
        self._known_m = north + float(by_enu_m[1]), east + float(by_enu_m[0])
        self._pairs = 0

    def crept_enu_m(self) -> Array | None:
        """Return by how much it has moved without being noticed, shape (3,) [m; ENU]; it is noticed then."""
        pairing = self._vehicle.pairing
        if pairing is None or self._origin is None or pairing.boot_time_s == self._seen_s:
            return None
        self._seen_s = pairing.boot_time_s
        north, east = _away_m(pairing, self._vehicle.profile.globe, self._origin)
        crept = np.array([east - self._known_m[1], north - self._known_m[0], 0.0])
        self._pairs = self._pairs + 1 if math.hypot(crept[0], crept[1]) > MOVED_M else 0
        if self._pairs < PAIRS:
            return None
        self.joined(crept)
        return crept


class OriginWatch:
    """Notices frames that move; knows no clock: times are the vehicles' own stamps.

    Args:
        vehicles: whose origins are known.
        states: where they are in their own frames, a row each.
    """

    def __init__(self, vehicles: Sequence[Vehicle], states: StateTable) -> None:
        self._states, self._vehicles = states, vehicles
        self._laid = [_Laid(vehicle) for vehicle in vehicles]
        self._position_m = states.position_ned_m.copy()
        self._velocity_m_s = states.velocity_ned_m_s.copy()
        self._boot_time_s = states.boot_time_s.copy()
        self._way_m = np.zeros_like(self._position_m)

    def moved_enu_m(self) -> dict[int, Array]:
        """Return by how much frames have moved since they were last joined, by row, shape (3,) each [m; ENU].

        To be called about as often as positions come. What is returned is forgotten here: whoever asks joins the frames
        anew.
        """
        states = self._states
        new = states.boot_time_s != self._boot_time_s
        # A clock that began anew is another boot's; a place that is the same to the last bit is not estimated any more
        follows = new & (states.boot_time_s > self._boot_time_s) & np.isfinite(self._position_m[:, 0])
        follows &= (states.position_ned_m != self._position_m).any(axis=1)
        rows = np.flatnonzero(follows)
        found: dict[int, Array] = {}
        if len(rows):
            surely_m, likely_m = self._gone_on(rows)
            has_moved = np.linalg.norm(surely_m, axis=1) > MOVED_M
            found = dict(zip(rows[has_moved].tolist(), -swap_ned_enu(likely_m[has_moved]), strict=True))
            self._way_m[rows] = np.where(has_moved[:, None], 0.0, surely_m)
        self._way_m[new & ~follows] = 0.0
        self._position_m[new] = states.position_ned_m[new]
        self._velocity_m_s[new] = states.velocity_ned_m_s[new]
        self._boot_time_s[new] = states.boot_time_s[new]
        for row, laid in enumerate(self._laid):
            if row in found:
                laid.joined(found[row])
            else:
                crept = laid.crept_enu_m()
                if crept is not None:
                    found[row] = crept
        return found

    def _gone_on(self, rows: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return the ways of some frames, those of the newest samples among them, shape (N, 3) [m; NED].

        First without what accelerations may explain of them, then with it.
        """
        states = self._states
        passed_s = (states.boot_time_s - self._boot_time_s)[rows, None]
        flown_m = 0.5 * passed_s * (states.velocity_ned_m_s[rows] + self._velocity_m_s[rows])
        way_m = states.position_ned_m[rows] - self._position_m[rows] - flown_m
        length_m = np.maximum(np.linalg.norm(way_m, axis=1, keepdims=True), np.finfo(float).tiny)
        share = np.maximum(1.0 - 0.25 * MOST_ACCELERATION_M_S2 * passed_s**2 / length_m, 0.0)
        before_m = self._way_m[rows] * np.exp(-passed_s / FORGETS_S)
        return before_m + share * way_m, before_m + way_m
