"""What the streamer can send: motions, each a pure function of time that never changes; a newer one replaces it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.plan.trajectory import Sample
from fg_gcs.plan.verification import CheckedPlan, yaw_towards
from fg_gcs.track.follow.fail_safe import FailSafeTrajectory


class SwarmSetpoint(NamedTuple):
    """What V vehicles should be doing at one instant; each array of shape (V, 3) but the yaw."""

    position_m: Array  # [m; ENU]
    velocity_m_s: Array  # [m/s; ENU]
    acceleration_m_s2: Array  # [m/s^2; ENU]
    yaw_rad: Array  # (V,) [rad; clockwise from north]

    def of(self, places: NDArray[np.int_]) -> SwarmSetpoint:
        """Return the setpoints of some of the vehicles."""
        return SwarmSetpoint(*(array[places] for array in self))


class Headings(NamedTuple):
    """Where V noses point at one instant."""

    time_s: float  # reading of the loop's clock [s]
    yaw_rad: Array  # (V,) [rad; clockwise from north]


class Motion(Protocol):
    """Something to stream."""

    @property
    def rows(self) -> Sequence[int]:
        """The fleet's rows that it moves, in the order of its own."""

    @property
    def turns_from(self) -> Headings | None:
        """Headings from which noses turn to the wanted ones at a limited rate; None: the wanted ones never jump."""

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return what is wanted at a reading of the loop's clock [s]."""


class Rest:
    """Stay at fixed places."""

    turns_from = None

    def __init__(self, rows: Sequence[int], position_enu_m: Array, yaw_rad: Array) -> None:
        """Take places of shape (V, 3) [m; ENU] and headings of shape (V,) [rad]."""
        still = np.zeros_like(position_enu_m)
        self.rows = rows
        self._wanted = SwarmSetpoint(position_enu_m, still, still, yaw_rad)

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return the same at any time."""
        return self._wanted


class Follow:
    """Fly a checked plan from ``start_s`` on, and rest at its end."""

    turns_from = None

    def __init__(self, rows: Sequence[int], plan: CheckedPlan, start_s: float) -> None:
        """Take the plan and the clock's reading at which it begins [s]."""
        self.rows = rows
        self.plan = plan
        self.start_s = start_s

    @property
    def end_s(self) -> float:
        """The clock's reading at which the plan ends [s]."""
        return self.start_s + self.plan.duration_s

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return the plan's sample."""
        return _facing(self.plan, *_row(self.plan.sample(np.array([now_s - self.start_s]))))


class Brake:
    """Come to rest on a plan's own path, so that the separation it verifies still holds.

    The plan's time runs slower and slower until it stands still: with the rate ``r(t)`` falling from 1 to 0 over the
    braking time, speeds are multiplied by ``r`` and accelerations become ``a r^2 + v r'``.
    """

    turns_from = None

    def __init__(self, motion: Follow, start_s: float) -> None:
        """Begin to brake at a reading of the clock [s]."""
        self.rows = motion.rows
        self._plan = motion.plan
        self._begin_s = start_s - motion.start_s
        self.start_s = start_s
        _, velocity, _ = _row(motion.plan.sample(np.array([self._begin_s])))
        speed = float(np.linalg.norm(velocity, axis=1).max())
        limit = max(motion.plan.peaks.acceleration_m_s2, 0.5)  # a plan that hardly accelerates still has to stop
        self._duration_s = max(0.5, 2.0 * speed / limit)  # v r' then takes half of what the plan accelerates by

    @property
    def end_s(self) -> float:
        """The clock's reading at which everything is at rest [s]."""
        return self.start_s + self._duration_s

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return the slowed sample."""
        passed = min(max(now_s - self.start_s, 0.0), self._duration_s)
        rate = 1.0 - passed / self._duration_s
        plan_s = self._begin_s + passed * (1.0 + rate) / 2.0
        position, velocity, acceleration = _row(self._plan.sample(np.array([plan_s])))
        braking = velocity / -self._duration_s if rate > 0.0 else np.zeros_like(velocity)
        return _facing(self._plan, position, velocity * rate, acceleration * rate**2 + braking)


class Gaze(NamedTuple):
    """The point that all noses are turned to; it moves straight on."""

    time_s: float  # when it is at the position [s]
    position_enu_m: Array  # (3,) [m; ENU]
    velocity_m_s: Array  # (3,) [m/s; ENU]

    def at(self, now_s: float) -> Array:
        """Return where it is, shape (3,) [m; ENU]."""
        there: Array = self.position_enu_m + (now_s - self.time_s) * self.velocity_m_s
        return there


@dataclass(frozen=True, slots=True, eq=False)
class FormationMotion:
    """Fly a formation along a trajectory that is known to its end, every nose at the target.

    What tracks a target replaces it again and again, see `with_trajectory`; `beginning` makes the first one.

    Attributes:
        rows: The fleet's rows that it moves.
        slots_m: Template slot of each, shape (V, 3) [m].
        trajectory: The formation's.
        gaze: Where noses point.
        heading: Horizontal direction of a nose that is straight above or below the gaze, shape (2,) [ENU].
        turns_from: Headings when tracking began: the target's estimate jumps, noses must not.
    """

    rows: Sequence[int]
    slots_m: Array
    trajectory: FailSafeTrajectory
    gaze: Gaze
    heading: Array
    turns_from: Headings

    @classmethod
    def beginning(
        cls, rows: Sequence[int], slots_m: Array, trajectory: FailSafeTrajectory, gaze_enu_m: Array, headings: Headings
    ) -> FormationMotion:
        """Return the motion that begins where the one before has ended.

        Args:
            rows: The fleet's rows that it moves.
            slots_m: Template slot of each, shape (V, 3) [m].
            trajectory: The one that begins now.
            gaze_enu_m: Where noses point at first, shape (3,) [m; ENU].
            headings: The present ones, at the present time.
        """
        bearing = (gaze_enu_m - trajectory.state(headings.time_s).axes[0, :3])[:2]
        length = float(np.linalg.norm(bearing))
        heading = bearing / length if length > 0.0 else np.array([0.0, 1.0])
        return cls(rows, slots_m, trajectory, Gaze(headings.time_s, gaze_enu_m, np.zeros(3)), heading, headings)

    def with_trajectory(self, trajectory: FailSafeTrajectory, gaze: Gaze) -> FormationMotion:
        """Return the motion along a newer trajectory, which begins in the state that this one has then."""
        return replace(self, trajectory=trajectory, gaze=gaze)

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return the trajectory's sample, with the headings that point at the target."""
        position, velocity, acceleration = self.trajectory.frames(np.array([now_s])).swarm(self.slots_m)
        yaw_rad = yaw_towards(self.gaze.at(now_s), position[0], self.heading)
        return SwarmSetpoint(position[0], velocity[0], acceleration[0], yaw_rad)


def _facing(plan: CheckedPlan, position_m: Array, velocity_m_s: Array, acceleration_m_s2: Array) -> SwarmSetpoint:
    """Complete a sample by the headings that face the plan's target."""
    return SwarmSetpoint(position_m, velocity_m_s, acceleration_m_s2, plan.yaw_rad(position_m))


def _row(sample: Sample) -> tuple[Array, Array, Array]:
    return sample.position_m[0], sample.velocity_m_s[0], sample.acceleration_m_s2[0]
