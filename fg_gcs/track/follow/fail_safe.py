"""Motions of a whole formation that are known to their end: every one of them comes to rest by itself.

A trajectory is made once, verified once, and then only read: when nothing newer comes, it is flown to its end, and
that is safe. What tracks a target replaces the present trajectory by a newer one that starts in the same state.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Pose
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.rules import Peaks, broken
from fg_gcs.plan.trajectory import Survey, extrema
from fg_gcs.track.follow.axes import Axes, axis_at
from fg_gcs.track.follow.formation_frames import AXES, Frames, State, frames_of, state_of

VERIFIED_EVERY_S = 0.04  # between instants of the verification, besides the axes' seams: speeds change by some cm/s
RESERVE = 1.008  # what lies between the instants of the verification may exceed them by


class FailSafeTrajectory:
    """A formation's motion from ``start_s`` on; before it is not asked for, after ``end_s`` the formation rests."""

    def __init__(self, attitude: Array, moving: Axes, turning: Axes, axes: Array) -> None:
        """Take axes over time.

        Args:
            attitude: template axes to ENU that turns count from, shape (3, 3).
            moving: the centre's three axes; they end at rest.
            turning: rotation vector and scale, four axes; likewise.
            axes: along which the centre moves, one a column, shape (3, 3) [ENU].
        """
        self.attitude, self._axes = attitude, axes
        self.start_s = moving.start_s
        self.end_s = max(moving.end_s, turning.end_s)
        self._moving, self._turning = moving, turning

    @classmethod
    def resting(cls, pose: Pose, start_s: float) -> FailSafeTrajectory:
        """Stay in a pose."""
        turn = np.zeros((3, AXES - 3))
        turn[0, 3] = pose.scale
        centre = np.zeros((3, 3))
        centre[0] = pose.centre_enu_m
        return cls(np.asarray(pose.rotation), Axes(start_s, centre), Axes(start_s, turn), np.eye(3))

    def axes_at(self, time_s: Array) -> Array:
        """Return centre, turn and scale with two derivatives at times, shape (T,) [s]; (T, 3, 7)."""
        return _axes_at(*self._moving.phases, *self._turning.phases, self._axes, time_s)

    def frames(self, time_s: Array) -> Frames:
        """Return the formation's frame at times, shape (T,) [s]."""
        return frames_of(self.axes_at(time_s), self.attitude)

    def state(self, time_s: float) -> State:
        """Return the formation's state at one instant [s]."""
        return state_of(self.frames(np.array([time_s])))

    @property
    def instants_s(self) -> Array:
        """Instants from start to end that show all of it, ascending [s]."""
        even = np.arange(self.start_s, self.end_s, VERIFIED_EVERY_S)
        instants = np.concatenate((even, self._moving.seams_s, self._turning.seams_s, [self.end_s]))
        instants.sort()
        return instants


class Verification(NamedTuple):
    """What dense samples of a trajectory show, with a reserve for what lies between them."""

    peaks: Peaks
    outside_m: float  # by how much a vehicle leaves the fence, negative inside
    scale: float  # the smallest: distances are those of the template times the scale

    def keeps(self, rules: Rules, smallest_m: float) -> bool:
        """Say whether the rules hold; ``smallest_m`` is the smallest distance in the template [m].

        Jerk is bounded axis by axis when a trajectory is made.
        """
        return not broken(self.peaks, self.outside_m, self.scale * smallest_m, rules)


def verify(trajectory: FailSafeTrajectory, outline_m: Array, rules: Rules) -> Verification:
    """Sample a trajectory from its start to its end.

    Args:
        trajectory: the trajectory.
        outline_m: slots, or points that enclose them: speeds and accelerations are convex in the slot, (P, 3) [m].
        rules: whose fence counts.
    """
    time_s = trajectory.instants_s
    axes = trajectory.axes_at(time_s)
    peaks, low, high = np.zeros(len(Peaks._fields)), np.full(3, np.inf), np.full(3, -np.inf)
    steady = np.ones(len(time_s)), np.zeros(len(time_s))  # time is its own parameter
    extrema(*frames_of(axes, trajectory.attitude).swarm(outline_m), *steady, time_s, peaks, low, high)
    survey = Survey(Peaks(*(RESERVE * peaks).tolist()), low, high)
    return Verification(survey.peaks, survey.excess_m(rules.fence), float(axes[:, 0, 6].min()))


@kernel
def _axes_at(
    moving: Array,
    moving_counts: NDArray[np.int_],
    turning: Array,
    turning_counts: NDArray[np.int_],
    columns: Array,
    times: Array,
) -> Array:
    """Axes of a formation at times, (T, 3, 7), from the phases of its centre along columns, and of its turn and scale.

    Of axes that move along ENU the columns are those of the identity.
    """
    axes = np.zeros((len(times), 3, AXES))
    for d in range(AXES):
        phase = 0
        for i in range(len(times)):
            if d < 3:
                phase, motion = axis_at(moving, moving_counts, d, phase, times[i])
                for order in range(3):
                    for k in range(3):
                        axes[i, order, k] += motion[order] * columns[k, d]
            else:
                phase, motion = axis_at(turning, turning_counts, d - 3, phase, times[i])
                for order in range(3):
                    axes[i, order, d] = motion[order]
    return axes
