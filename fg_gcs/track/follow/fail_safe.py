"""Motions of a whole formation that are known to their end: every one of them comes to rest by itself.

A trajectory is made once, verified once, and then only read: when nothing newer comes, it is flown to its end, and
that is safe. What tracks a target replaces the present trajectory by a newer one that starts in the same state.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Pose
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.rules import Peaks, broken
from fg_gcs.plan.trajectory import Survey, extrema
from fg_gcs.track.follow.axes import Axes
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
        self._attitude, self._axes = attitude, axes
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

    def frames(self, time_s: Array) -> Frames:
        """Return the formation's frame at times, shape (T,) [s]."""
        axes = np.concatenate((self._moving.at(time_s) @ self._axes.T, self._turning.at(time_s)), axis=2)
        return frames_of(axes, self._attitude)

    def state(self, time_s: float) -> State:
        """Return the formation's state at one instant [s]."""
        return state_of(self.frames(np.array([time_s])))

    @property
    def instants_s(self) -> Array:
        """Instants from start to end that show all of it, ascending [s]."""
        even = np.arange(self.start_s, self.end_s, VERIFIED_EVERY_S)
        return np.unique(np.concatenate((even, self._moving.seams_s, self._turning.seams_s, [self.end_s])))


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
    frames = trajectory.frames(time_s)
    peaks, low, high = np.zeros(len(Peaks._fields)), np.full(3, np.inf), np.full(3, -np.inf)
    steady = np.ones(len(time_s)), np.zeros(len(time_s))  # time is its own parameter
    extrema(*frames.swarm(outline_m), *steady, time_s, peaks, low, high)
    survey = Survey(Peaks(*(RESERVE * peaks).tolist()), low, high)
    return Verification(survey.peaks, survey.excess_m(rules.fence), float(frames.scale.min()))
