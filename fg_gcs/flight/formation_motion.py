"""The motion of a formation that tracks a target: samples whatever trajectory is the present one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.flight.streamer import SwarmSetpoint
from fg_gcs.plan.verification import yaw_towards
from fg_gcs.track.follow.fail_safe import FailSafeTrajectory

NOSE_RAD_S = 1.0  # autopilots turn about as fast; what the target does, and noise in its estimate, makes no jumps


class FormationMotion:
    """Stream the present trajectory, every nose at the target.

    Attributes:
        rows: the fleet's rows that it moves.
        trajectory: the present trajectory; a newer one begins in the state that the one before had then.
    """

    def __init__(
        self,
        rows: Sequence[int],
        slots_m: Array,
        trajectory: FailSafeTrajectory,
        gaze_enu_m: Array,
        yaw_rad: Array,
        now_s: float,
    ) -> None:
        """Begin where the motion before has ended.

        Args:
            rows: the fleet's rows that it moves.
            slots_m: template slot of each, shape (V, 3) [m].
            trajectory: that begins now.
            gaze_enu_m: where to look at first, shape (3,) [m; ENU].
            yaw_rad: present headings, shape (V,) [rad; NED].
            now_s: reading of the loop's clock [s].
        """
        self.rows = rows
        self.trajectory = trajectory
        self._slots_m = slots_m
        self._gaze = (now_s, gaze_enu_m, np.zeros(3))
        bearing = (gaze_enu_m - trajectory.state(now_s).axes[0, :3])[:2]
        length = float(np.linalg.norm(bearing))
        self._heading = bearing / length if length > 0.0 else np.array([0.0, 1.0])
        self._yaw = (now_s, yaw_rad)

    def look_at(self, time_s: float, position_enu_m: Array, velocity_m_s: Array) -> None:
        """Look from now on at a point that moves straight on, each of shape (3,) [m; ENU] at a time [s]."""
        self._gaze = (time_s, position_enu_m, velocity_m_s)

    def gaze_enu_m(self, now_s: float) -> Array:
        """Return the point that everybody looks at, shape (3,) [m; ENU]."""
        time_s, position, velocity = self._gaze
        there: Array = position + (now_s - time_s) * velocity
        return there

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return the trajectory's sample; headings turn on from those of the sample before."""
        position, velocity, acceleration = self.trajectory.frames(np.array([now_s])).swarm(self._slots_m)
        return SwarmSetpoint(position[0], velocity[0], acceleration[0], self._turned(position[0], now_s))

    def _turned(self, position_m: Array, now_s: float) -> Array:
        before_s, before = self._yaw
        away = yaw_towards(self.gaze_enu_m(now_s), position_m, self._heading) - before
        shortest = np.remainder(away + np.pi, 2.0 * np.pi) - np.pi
        most = NOSE_RAD_S * max(now_s - before_s, 0.0)
        yaw: Array = np.remainder(before + np.clip(shortest, -most, most) + np.pi, 2.0 * np.pi) - np.pi
        self._yaw = (max(now_s, before_s), yaw)
        return yaw
