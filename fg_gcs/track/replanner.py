"""The inner loop: from the present ride and what is known of the target to the next ride, within all limits.

The flux says how the face has to stand: towards the target, by the same search that plans to a target at rest. The
centre goes state to state, with bounded jerk, to the place around the target where and when it will be met, at the
target's own velocity then. A face that looks away turns on the spot first. Every candidate is proven before it is
taken, from its start to the rest that it ends in; when none holds, the present ride goes on, and that one was proven.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fg_gcs.core.formation import Formation, Pose
from fg_gcs.errors import PlanError
from fg_gcs.plan.flux_guided import plan_path
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.rigid_path import outline_of
from fg_gcs.track.follow import Bounds, Joints
from fg_gcs.track.frames import State
from fg_gcs.track.ride import Ride, prove

Array = NDArray[np.float64]

JERK_M_S3 = 12.0  # where the mission states none: full acceleration within a quarter of a second, as autopilots do
NEAR_S = 2.5  # a target that is met within this time is followed, one that is not is approached
FACING = 0.9  # cosine between normal and target below which the face turns first and moves then
BESIDE_RADII = 1.5  # this near the face's centre no direction to the target counts
FASTEST = 0.9  # share of the vehicles' speed that a target may have to be followed at its own
HORIZON_S = 8.0  # nobody knows where a target will be later than this
ROUNDS = 8  # for the time of meeting, each aimed at where the target will be at the one before
MET_S = 0.02  # later than this is too late to meet
LATER = 1.03  # how much more time than it took to give it the next time
SAME_SCALE = 0.02  # a change of the size by less is not worth moving for


class Try(NamedTuple):
    """How hard to try; shares of the limits, which the outermost vehicle shares between move and turn."""

    move: float
    turn: float
    least_s: float  # for the centre to meet the target; longer is smoother
    run_on_s: float  # how long to go on at the target's velocity before braking


TRIES = (Try(0.8, 0.2, 0.9, 1.0), Try(0.65, 0.25, 0.9, 0.5), Try(0.5, 0.2, 0.9, 0.2), Try(0.3, 0.1, 0.9, 0.0))
FAR_RADII = 4.0  # beyond this many radii a move has a direction: it gets most of the limits, and across it less is left
ALONG, ACROSS = (1.0, 0.4, 0.4), (1.0, 1.0, 1.0)  # shares of the three axes' speeds, far and near
PUSH = 0.75  # share of
ON_THE_SPOT = (Try(0.9, 0.6, 0.0, 0.0), Try(0.7, 0.3, 0.0, 0.0), Try(0.4, 0.15, 0.0, 0.0))
SMOOTH_S = (1.0, 1.5, 2.2, 3.2)
GROWTH = 0.15  # share of the limits that growing may take at the outermost vehicle


class Goal(NamedTuple):
    """What to surround, as it is known."""

    time_s: float  # when it is there [s of the flight's clock]
    position_enu_m: Array  # (3,) [m; ENU]
    velocity_m_s: Array  # (3,)
    acceleration_m_s2: Array  # (3,)
    scale: float  # that the formation needs around it
    ease_s: float  # time constant by which the acceleration is believed to fade [s]

    def at(self, time_s: float) -> Array:
        """Return position, velocity and acceleration predicted for a time, shape (3, 3).

        The acceleration fades exponentially, so that nothing is predicted to run away [Singer1970]_.
        """
        passed, tau = time_s - self.time_s, self.ease_s
        left = float(np.exp(-max(passed, 0.0) / tau))
        a = self.acceleration_m_s2
        velocity = self.velocity_m_s + tau * (1.0 - left) * a
        position = self.position_enu_m + passed * self.velocity_m_s + tau * (passed - tau * (1.0 - left)) * a
        return np.stack((position, velocity, left * a))


class Mode(Enum):
    """What the inner loop is doing."""

    WAIT = "waiting for the target"
    TURN = "turning to the target"
    APPROACH = "approaching the target"
    FOLLOW = "following the target"


class Replan(NamedTuple):
    """What a look at the target led to."""

    ride: Ride
    mode: Mode
    taken: bool  # False: no candidate held, the ride is the one before


@dataclass(frozen=True)
class Swarm:
    """What rides are made for; row v of the slots belongs to vehicle v."""

    formation: Formation
    slots_m: Array  # (V, 3) [m; template]
    hold_depth_m: float
    rules: Rules


class Replanner:
    """Makes rides.

    Attributes:
        ride: the present one.
        mode: what it does.
    """

    def __init__(self, swarm: Swarm, start: Pose, start_s: float) -> None:
        """Rest at a pose from a time on [s]."""
        self.ride = Ride.resting(start, start_s)
        self.mode = Mode.WAIT
        self._swarm = swarm
        self._jerk_m_s3 = min(swarm.rules.limits.jerk_m_s3, JERK_M_S3)
        self._outline_m = outline_of(swarm.slots_m)
        self._reach_m = float(np.linalg.norm(swarm.slots_m, axis=1).max())
        self._smallest_m = swarm.formation.smallest_separation_m

    def chases(self, goal: Goal) -> bool:
        """Say whether the target is faster than the formation can follow."""
        return float(np.linalg.norm(goal.velocity_m_s)) > FASTEST * self._swarm.rules.limits.speed_m_s

    def look(self, goal: Goal, now_s: float) -> Replan:
        """Take the best new ride from ``now_s`` on, if there is one."""
        state = self.ride.state(now_s)
        attitude = self._guided(state, goal.at(now_s)[0])
        if self.mode is not Mode.FOLLOW and not self._facing(state, goal.at(now_s)[0]):
            ride = self._stopped(state, attitude, goal.scale, now_s)
            return self._taken(ride, Mode.TURN)
        for least_s in SMOOTH_S:
            ride = self._joined(state, attitude, goal, now_s, least_s)
            if ride is not None and self._holds(ride):
                return self._taken(ride, Mode.FOLLOW)
        for effort in TRIES:
            ride = self._met(state, attitude, goal, now_s, effort)
            if ride is not None and self._holds(ride):
                return self._taken(ride, Mode.APPROACH)
        return self._taken(None, self.mode)

    def wait(self, scale: float, now_s: float) -> Replan:
        """Come to rest where the present ride does, and change the formation's size there."""
        state = self.ride.state(max(now_s, self.ride.end_s))
        if now_s < self.ride.end_s or abs(scale - state.joints[0, 6]) < SAME_SCALE:
            return Replan(self.ride, self.mode, taken=False)
        return self._taken(self._stopped(state, state.attitude, scale, now_s), Mode.WAIT)

    def stop(self, now_s: float) -> Replan:
        """Come to rest as soon as the limits allow."""
        state = self.ride.state(now_s)
        return self._taken(self._stopped(state, state.attitude, float(state.joints[0, 6]), now_s), Mode.WAIT)

    def _taken(self, ride: Ride | None, mode: Mode) -> Replan:
        if ride is None:
            return Replan(self.ride, self.mode, taken=False)
        self.ride, self.mode = ride, mode
        return Replan(ride, mode, taken=True)

    def _guided(self, state: State, target_m: Array) -> Array:
        """Return the attitude that the flux turns the face to on its way to the target, shape (3, 3)."""
        pose = Pose(state.joints[0, :3], state.attitude, float(state.joints[0, 6]))
        try:
            return plan_path(self._swarm.formation, pose, target_m, self._swarm.hold_depth_m).poses[-1].rotation
        except PlanError:  # on the rim just now: the next sighting has it elsewhere
            return state.attitude

    def _facing(self, state: State, target_m: Array) -> bool:
        way = target_m - state.joints[0, :3]
        distance = float(np.linalg.norm(way))
        near_m = BESIDE_RADII * self._reach_m * state.joints[0, 6]
        return distance < near_m or float(way @ state.attitude[:, 0]) > FACING * distance

    def _stopped(self, state: State, attitude: Array, scale: float, now_s: float) -> Ride | None:
        """Return a ride that brakes to rest and takes up attitude and scale, if one holds."""
        axes = _axes(state.joints[1, :3])
        for effort in ON_THE_SPOT:
            moving = Joints(now_s, state.joints[:, :3] @ axes)
            turning = self._turning(state, attitude, scale, now_s, effort)
            if turning is not None and moving.to_velocity(np.zeros(3), self._bounds(axes, effort.move, ALONG)):
                ride = Ride(state.attitude, moving, turning, axes)
                if self._holds(ride):
                    return ride
        return None

    def _joined(self, state: State, attitude: Array, goal: Goal, now_s: float, takes_s: float) -> Ride | None:
        """Return a ride that joins the target smoothly in a given time, goes on with it for a while and brakes."""
        hold_m = self._swarm.hold_depth_m * attitude[:, 0]
        axes = np.eye(3)
        bounds = self._bounds(axes, 0.8, ACROSS)
        moving = Joints(now_s, state.joints[:, :3])
        turning = self._turning(state, attitude, goal.scale, now_s, TRIES[0])
        moving.smoothly(self._within(goal.at(now_s + takes_s), hold_m, goal.scale), takes_s)
        if turning is None or not moving.to_velocity(moving.end[1], bounds):
            return None
        moving.straight_on(now_s + takes_s + 1.0)
        if not moving.to_velocity(np.zeros(3), bounds):
            return None
        return Ride(state.attitude, moving, turning, axes)

    def _met(self, state: State, attitude: Array, goal: Goal, now_s: float, effort: Try) -> Ride | None:
        """Return a ride that meets the target, goes on with it for a while and brakes."""
        hold_m = self._swarm.hold_depth_m * attitude[:, 0]
        way = goal.at(now_s)[0] + hold_m - state.joints[0, :3]
        far = float(np.linalg.norm(way)) > FAR_RADII * self._reach_m * goal.scale
        axes = _axes(way) if far else np.eye(3)
        bounds = self._bounds(axes, effort.move, ALONG if far else ACROSS)
        turning = self._turning(state, attitude, goal.scale, now_s, effort)
        if turning is None:
            return None
        meets_s = now_s + effort.least_s
        for _ in range(ROUNDS):
            met = self._within(goal.at(min(meets_s, now_s + HORIZON_S)), hold_m, goal.scale) @ axes
            met[1] = np.clip(met[1], bounds.lowest_velocity, bounds.highest_velocity)
            met[2] = np.clip(met[2], -0.5 * bounds.acceleration, 0.5 * bounds.acceleration)
            moving = Joints(now_s, state.joints[:, :3] @ axes)
            if not moving.to(met, bounds, meets_s - now_s):
                return None
            if moving.end_s < meets_s + MET_S:  # in time, and so at that time
                break
            meets_s = now_s + LATER * (moving.end_s - now_s)
        # The target's acceleration fades, it is not followed for ever
        if not moving.to_velocity(moving.end[1], bounds):
            return None
        moving.straight_on(max(moving.end_s, meets_s + effort.run_on_s))
        if not moving.to_velocity(np.zeros(3), bounds):
            return None
        return Ride(state.attitude, moving, turning, axes)

    def _turning(self, state: State, attitude: Array, scale: float, now_s: float, effort: Try) -> Joints | None:
        """Return the joints that take up attitude and scale as fast as they may."""
        arm_m = max(self._reach_m * max(float(state.joints[0, 6]), scale), 0.1)  # a swarm on one spot may spin
        limits = self._swarm.rules.limits
        per_joint = np.array([effort.turn / arm_m] * 3 + [GROWTH / self._reach_m])
        speed, jerk = limits.speed_m_s * per_joint, self._jerk_m_s3 * per_joint
        turning = Joints(now_s, state.joints[:, 3:])
        goal = np.zeros((3, 4))
        goal[0, :3] = Rotation.from_matrix(attitude @ state.attitude.T).as_rotvec()
        goal[0, 3] = scale
        bounds = Bounds(-speed, speed, limits.acceleration_m_s2 * per_joint, jerk)
        return turning if turning.to(goal, bounds, effort.least_s) else None

    def _bounds(self, axes: Array, share: float, per_axis: tuple[float, float, float]) -> Bounds:
        """Bounds of the centre along its axes, the first the main one; the proof has the last word.

        An axis that leads up or down is no faster than climb or descent allow.
        """
        limits = self._swarm.rules.limits
        shares = share * np.array(per_axis)
        rise = np.maximum(np.abs(axes[2]), 1e-9)
        up, down = (share * limit / rise for limit in (limits.climb_m_s, limits.descent_m_s))
        upwards = axes[2] > 0.0
        speed = limits.speed_m_s * shares
        highest = np.minimum(speed, np.where(upwards, up, down))
        lowest = -np.minimum(speed, np.where(upwards, down, up))
        return Bounds(lowest, highest, PUSH * limits.acceleration_m_s2 * shares, self._jerk_m_s3 * shares)

    def _within(self, states: Array, hold_m: Array, scale: float) -> Array:
        """Return the centre's states for a target's, (3, 3), so that the formation fits into the fence."""
        fence, reach_m = self._swarm.rules.fence, self._reach_m * scale
        low, high = np.array(fence.low_enu_m) + reach_m, np.array(fence.high_enu_m) - reach_m
        centre = states.copy()
        centre[0] += hold_m
        outside = (centre[0] < low) | (centre[0] > high)
        centre[0] = np.clip(centre[0], np.minimum(low, high), np.maximum(low, high))
        centre[1:, outside] = 0.0
        return centre

    def _holds(self, ride: Ride) -> bool:
        return prove(ride, self._outline_m, self._swarm.rules).keeps(self._swarm.rules, self._smallest_m)


def _axes(way: Array) -> Array:
    """Return axes for a move, one a column: the first along the way, shape (3, 3)."""
    length = float(np.linalg.norm(way))
    first = way / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    helper = np.array([0.0, 0.0, 1.0]) if abs(first[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    second = np.cross(helper, first)
    second /= np.linalg.norm(second)
    return np.stack((first, second, np.cross(first, second)), axis=1)
