"""Local frames that move in flight: noticed by what positions do and velocities do not say.

A vehicle that flies from p0 to p1 within t at the velocities v0 and v1 has come e = p1 - p0 - (v0 + v1) t / 2 further
than it flew, of which a t^2 / 4 may be due to an acceleration of a. Whatever remains is the frame's own way, which
shows in one sample if it jumps; one that creeps by less than some 2 m/s cannot be told from velocities that are wrong.
The vehicle stays where it is when its frame moves, so that the frame is joined to the mission's anew, by as much.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import swap_ned_enu
from fg_gcs.wire.states import StateTable

MOVED_M: Final = 0.6
FORGETS_S: Final = 0.2  # time constant: PX4's simulated estimate has velocities that are wrong by 0.8 m/s for seconds
MOST_ACCELERATION_M_S2: Final = 10.0  # of any vehicle, in gusts and braking


class OriginWatch:
    """Notices frames that move; knows no clock: times are the vehicles' own stamps.

    Args:
        states: where the vehicles are in their own frames.
    """

    def __init__(self, states: StateTable) -> None:
        self._states = states
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
