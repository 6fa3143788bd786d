"""What the streamer can send: motions, each a pure function of time that never changes; a newer one replaces it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.plan.pace import AHEAD_S, GENTLEST, SHORTEST_S, Pace, stop_s
from fg_gcs.plan.trajectory import Sample
from fg_gcs.plan.verification import CheckedPlan, yaw_towards
from fg_gcs.track.follow.fail_safe import FailSafeTrajectory

STOP_LOOKS_S = 0.05  # between two samples of what a plan would do while it comes to rest


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


class Braking:
    """Come to rest straight on from what was sent last, each by the same deceleration, and stay there.

    Args:
        rows: the fleet's rows that it moves.
        last: what they were told at the time.
        begin_s: the time, by the loop's clock [s].
        deceleration_m_s2: of each [m/s^2].
    """

    turns_from = None

    def __init__(self, rows: Sequence[int], last: SwarmSetpoint, begin_s: float, deceleration_m_s2: float) -> None:
        self.rows = rows
        self._last, self._begin_s = last, begin_s
        speed = np.linalg.norm(last.velocity_m_s, axis=1)
        self._lasts_s = speed / deceleration_m_s2
        self.end_s = begin_s + float(self._lasts_s.max(initial=0.0))

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return p + v t - a t^2 / 2 until it rests."""
        position, velocity, _, yaw_rad = self._last
        passed_s = np.clip(now_s - self._begin_s, 0.0, self._lasts_s)
        lasts_s = np.maximum(self._lasts_s, np.finfo(float).tiny)
        left = np.maximum(1.0 - passed_s / lasts_s, 0.0)
        slower = np.where(left > 0.0, -1.0 / lasts_s, 0.0)
        slower = np.where(self._lasts_s > 0.0, slower, 0.0)
        moved = velocity * (0.5 * (1.0 + left) * passed_s)[:, None]
        return SwarmSetpoint(position + moved, velocity * left[:, None], velocity * slower[:, None], yaw_rad)


class Follow:
    """Fly a checked plan, and rest at its end.

    It can come to rest on the plan's own path on the way, where the separation that is verified still holds, and go on
    from there: the plan's time then passes slower and slower, or faster and faster.

    Args:
        rows: the fleet's rows that it moves.
        plan: what is flown.
        pace: when, and how fast its time passes.
    """

    turns_from = None

    def __init__(self, rows: Sequence[int], plan: CheckedPlan, pace: Pace) -> None:
        self.rows = rows
        self.plan = plan
        self.pace = pace

    @classmethod
    def from_now(cls, rows: Sequence[int], plan: CheckedPlan, now_s: float) -> Follow:
        """Return the motion along a whole plan that begins at a reading of the clock [s]."""
        return cls(rows, plan, Pace(now_s, 0.0))

    @property
    def end_s(self) -> float:
        """The clock's reading at which everything is at rest: at the plan's end, or before it [s]."""
        if self.stops:
            return self.pace.begin_s + self.pace.lasts_s
        return self.pace.when(self.plan.duration_s)

    @property
    def stops(self) -> bool:
        """Whether it comes to rest before the plan's end, or has."""
        return self.pace.after == 0.0

    def stopping(self, now_s: float) -> Follow:
        """Return the motion that comes to rest from its present state on, as quickly as the vehicles can."""
        plan_s, rate, slope = self.pace.at(now_s)
        pace, limits = Pace(now_s, plan_s, rate, slope, 0.0), self.plan.limits
        longest_s = max(AHEAD_S, GENTLEST * self.plan.peaks.speed_m_s / limits.acceleration_m_s2)
        ahead = self.plan.sample(plan_s + np.arange(0.0, longest_s + STOP_LOOKS_S, STOP_LOOKS_S))
        lasts_s = stop_s(ahead.velocity_m_s, ahead.acceleration_m_s2, STOP_LOOKS_S, limits, pace)
        return Follow(self.rows, self.plan, pace._replace(lasts_s=lasts_s))

    def going_on(self, now_s: float) -> Follow:
        """Return the motion that is at full speed again, from its rest on."""
        plan_s, rate, slope = self.pace.at(now_s)
        ahead_s = np.linspace(plan_s, plan_s + AHEAD_S, 20)
        speed = float(np.linalg.norm(self.plan.sample(ahead_s).velocity_m_s, axis=2).max())
        lasts_s = max(SHORTEST_S, GENTLEST * speed / self.plan.limits.acceleration_m_s2)
        return Follow(self.rows, self.plan, Pace(now_s, plan_s, rate, slope, 1.0, lasts_s))

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return the plan's sample."""
        plan_s, rate, change = self.pace.at(now_s)
        position, velocity, acceleration = _row(self.plan.sample(np.array([plan_s])))
        if rate == 1.0 and change == 0.0:
            return _facing(self.plan, position, velocity, acceleration)
        return _facing(self.plan, position, velocity * rate, acceleration * rate**2 + velocity * change)


class Beside:
    """Fly a motion while others, which it does not move, stay where they were told to be.

    Args:
        motion: what the others fly.
        rows: the fleet's rows of those that stay, none of them the motion's.
        position_enu_m: where, shape (S, 3) [m; ENU].
        yaw_rad: with which headings, shape (S,) [rad].
    """

    def __init__(self, motion: Motion, rows: Sequence[int], position_enu_m: Array, yaw_rad: Array) -> None:
        self.rows = (*motion.rows, *rows)
        self._motion = motion
        self._stays = Rest(rows, position_enu_m, yaw_rad)

    @property
    def turns_from(self) -> Headings | None:
        """As the motion's; those that stay do not turn."""
        found = self._motion.turns_from
        if found is None:
            return None
        return found._replace(yaw_rad=np.concatenate((found.yaw_rad, self._stays.at(0.0).yaw_rad)))

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return what both say."""
        both = zip(self._motion.at(now_s), self._stays.at(now_s), strict=True)
        return SwarmSetpoint(*(np.concatenate(parts) for parts in both))


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
