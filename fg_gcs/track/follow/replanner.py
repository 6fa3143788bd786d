"""The inner loop: from the present trajectory and what is known of the target to the next one, within all limits.

The flux says how the face has to stand: towards the target, by the same search that plans to a target at rest. The
centre goes state to state, with bounded jerk, to the place around the target where and when it will be met, at the
target's own velocity then. A face turned away turns on the spot first. Every candidate is verified before it is
taken, from its start to the rest that it ends in; when none holds, the present trajectory goes on: that one was
verified. docs/derivations.md has the equations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from itertools import product
from typing import NamedTuple

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Formation, Pose
from fg_gcs.errors import PlanError
from fg_gcs.plan.flux_guided import plan_path
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.pace import BEYOND
from fg_gcs.plan.path.rigid_path import outline_of
from fg_gcs.plan.path.splines import rotation_vector
from fg_gcs.track.estimate.imm import Prediction
from fg_gcs.track.follow.axes import Axes, Bounds
from fg_gcs.track.follow.fail_safe import FailSafeTrajectory, verify
from fg_gcs.track.follow.formation_frames import State

Shares = tuple[float, float, float]

JERK_M_S3 = 12.0  # where the mission states none: from rest to 5 m/s^2 within half a second
TOWARDS = 0.9  # cosine between normal and target below which the face turns first and moves then
CLOSEST_M = 0.1  # as if a vehicle were so far from the centre: a swarm on one spot may spin
UPRIGHT = 0.5  # share of climb and descent for each axis of a turn that lifts vehicles on one side of the formation
SWING = 0.1  # angle by which a turn may swing on while the formation moves [rad]: a faster one ends on the spot
BESIDE_RADII = 4.0  # nearer than this many radii there is no time to turn first
FASTEST = 0.9  # share of the vehicles' speed that a target may have to be followed at its own
HORIZON_S = 8.0  # nobody knows where a target will be later than this
FIRST_S = 0.9  # time in which a target is met at best: where the search for the time of meeting starts
ROUNDS = 16  # of that search, each aimed at where the target will be at the time before
MET_S = 0.02  # change of the time of meeting that counts as none
SAME_SCALE = 0.02  # a change of the size by less is not worth moving for
TURN_S = 0.9  # least time for a turn on the way: attitudes wanted differ a little from replan to replan

# Times to join a target in, quick ones first: below 0.8 s accelerations mirror the noise of the sightings
SMOOTH_S = (0.8, 0.9, 1.0, 1.15, 1.3, 1.6, 2.0, 2.6, 3.4, 4.5)
# How long after the last sighting to go on as predicted if no other comes, how long if that leads too far, and the
# least for which it is worth planning
RUN_ON_S, SHORTLY_S, WORTH_S = 8.0, 2.0, 0.5
PIECE_S = 1.5  # of a prediction: a polynomial of fifth degree follows it to the millimetre


class LimitShares(NamedTuple):
    """How hard to try; shares of the limits, which at the outermost vehicle add up for move and turn."""

    move: float
    turn: float
    run_on_s: float = 0.0  # how long to go on at the target's velocity before braking


EFFORTS = (
    LimitShares(0.85, 0.15, 1.0),
    LimitShares(0.7, 0.2, 0.5),
    LimitShares(0.5, 0.2, 0.2),
    LimitShares(0.3, 0.1, 0.0),
)
ON_THE_SPOT = (LimitShares(0.9, 0.6), LimitShares(0.7, 0.3), LimitShares(0.4, 0.15))
JOINED = LimitShares(0.7, 0.15)  # what follows a smooth join
# Where somebody may be run into: as suddenly as plans come to rest then
AT_ONCE = tuple(LimitShares(move, turn) for move, turn in product((BEYOND, 1.0, 0.85, 0.7, 0.5), (0.1, 0.3)))
SUDDENLY_M_S3 = 40.0  # where the mission states no jerk
GROWTH = 0.15  # share of the limits that growing may take at the outermost vehicle

FAR_RADII = 1.5  # beyond this many radii the way to the target has a direction
GAP_M_S = 2.0  # nearer, a change of velocity above this has one
ALONG = ((1.0, 0.5, 0.5), (0.9, 0.5, 0.5))  # shares of three axes in speed and in acceleration, where one leads
STRAIGHT = ((1.0, 0.3, 0.3), (1.0, 0.3, 0.3))  # and where it is only braked along its way
ACROSS = ((1.0, 1.0, 1.0), (0.65, 0.65, 0.65))  # and where none does: all three may brake at once
GENTLY_M_S2, SPARE = 0.8, 1.3  # for braking on a long way, and how much more than needed
ENU = np.eye(3)  # axes for a move without a direction, one a column
JERKED = 0.95  # share of the jerk limit that a move's three axes and a turn may take together


class Goal(NamedTuple):
    """What to surround, as it is known."""

    prediction: Prediction
    scale: float  # that the formation needs around it
    age_s: float = 0.0  # of the newest sighting that the prediction is made of

    def at(self, time_s: float) -> Array:
        """Return position, velocity and acceleration predicted for a time, shape (3, 3)."""
        return self.prediction.at(time_s)

    def slowed(self, speed_m_s: float) -> Goal:
        """Return the same target, believed to be no faster than that [m/s]."""
        now = self.at(self.prediction.time_s)
        speed = float(np.linalg.norm(now[1]))
        if speed <= speed_m_s:
            return self
        return self._replace(prediction=Prediction.straight(self.prediction.time_s, now[0], speed_m_s / speed * now[1]))


class Join(NamedTuple):
    """What all ways to join a target smoothly have in common."""

    state: State  # that they start from
    goal: Goal
    hold_m: Array  # from the target to where the centre belongs, shape (3,) [m; ENU]
    turning: Axes  # attitude and scale, whatever the centre does
    bounds: Bounds  # of the centre when it brakes


class FollowMode(Enum):
    """What the inner loop is doing."""

    WAIT = "waiting for the target"
    TURN = "turning to the target"
    APPROACH = "approaching the target"
    FOLLOW = "following the target"


class Replan(NamedTuple):
    """What replanning came to."""

    trajectory: FailSafeTrajectory
    mode: FollowMode
    taken: bool  # False: no candidate held, the trajectory is the one before


@dataclass(frozen=True)
class Swarm:
    """What trajectories are made for; row v of the slots belongs to vehicle v."""

    formation: Formation
    slots_m: Array  # (V, 3) [m; template]
    hold_depth_m: float
    rules: Rules


class Replanner:
    """Makes trajectories.

    Attributes:
        trajectory: the present one.
        mode: what it does.
    """

    def __init__(self, swarm: Swarm, start: Pose, start_s: float) -> None:
        """Rest at a pose from a time on [s]."""
        self.trajectory = FailSafeTrajectory.resting(start, start_s)
        self.mode = FollowMode.WAIT
        self._swarm = swarm
        self._jerk_m_s3 = min(swarm.rules.limits.jerk_m_s3, JERK_M_S3)
        self._outline_m = outline_of(swarm.slots_m)
        self._box_m = np.array((swarm.rules.fence.low_enu_m, swarm.rules.fence.high_enu_m))
        self._reach_m = float(np.linalg.norm(swarm.slots_m, axis=1).max())
        self._smallest_m = swarm.formation.smallest_separation_m

    def chases(self, goal: Goal) -> bool:
        """Say whether the target is faster than the formation can follow."""
        return float(np.linalg.norm(goal.at(goal.prediction.time_s)[1])) > FASTEST * self._swarm.rules.limits.speed_m_s

    def replan(self, goal: Goal, now_s: float) -> Replan:
        """Take the best new trajectory from ``now_s`` on, if there is one.

        A target that is faster than the formation may be is chased: aimed at as if it were just as fast.
        """
        return next(replan for replan in self.replanning(goal, now_s) if replan is not None)

    def replanning(self, goal: Goal, now_s: float) -> Iterator[Replan | None]:
        """Do the same in steps: yield None after each that led to nothing yet, and what it led to in the end.

        Nothing has changed before that, so it may be given up at any step.
        """
        goal = goal.slowed(FASTEST * self._swarm.rules.limits.speed_m_s)
        state = self.trajectory.state(now_s)
        attitude = self._guided(state, goal.at(now_s)[0])
        if self.mode is not FollowMode.FOLLOW and not self._facing(state, goal.at(now_s)[0]):
            yield None
            trajectory = self._stopped(state, attitude, goal.scale, now_s)
            yield self._taken(trajectory, FollowMode.TURN)
            return
        join = self._join(state, attitude, goal, now_s)
        for replan in self._joining(join) if join is not None else ():
            yield replan
            if replan is not None:
                return
        for limit_shares in dict.fromkeys((*(self._swinging(state, each) for each in EFFORTS), *EFFORTS)):
            yield None
            trajectory = self._met(state, attitude, goal, now_s, limit_shares)
            if trajectory is not None and self._holds(trajectory):
                yield self._taken(trajectory, FollowMode.APPROACH)
                return
        yield self._taken(None, self.mode)

    def _joining(self, join: Join) -> Iterator[Replan | None]:
        """Search for a smooth way to join the target, in steps as above; none in the end if there is no such way."""
        run_on_s = max(RUN_ON_S - join.goal.age_s, 0.0)
        for takes_s in SMOOTH_S:
            trajectory = self._joined(join, takes_s, min(SHORTLY_S, run_on_s))
            if trajectory is None:  # which is known at once
                continue
            yield None
            if self._holds(trajectory):
                yield None
                longer = self._joined(join, takes_s, run_on_s)
                best = longer if longer is not None and self._holds(longer) else trajectory
                yield self._taken(best, FollowMode.FOLLOW)
                return

    def wait(self, scale: float, now_s: float) -> Replan:
        """Come to rest where the present trajectory does, and change the formation's size there."""
        state = self.trajectory.state(max(now_s, self.trajectory.end_s))
        if now_s < self.trajectory.end_s or abs(scale - state.axes[0, 6]) < SAME_SCALE:
            return Replan(self.trajectory, self.mode, taken=False)
        return self._taken(self._stopped(state, state.attitude, scale, now_s), FollowMode.WAIT)

    def stop(self, now_s: float, *, at_once: bool = False) -> Replan:
        """Come to rest.

        Args:
            now_s: from when on [s].
            at_once: as soon as the limits allow, and a tenth beyond, as plans come to rest for a fault: somebody who
                does not hear us may be run into.
        """
        state = self.trajectory.state(now_s)
        braked = self._braked(state, now_s) if at_once else None
        stopped = braked or self._stopped(state, state.attitude, float(state.axes[0, 6]), now_s)
        return self._taken(stopped, FollowMode.WAIT)

    def _taken(self, trajectory: FailSafeTrajectory | None, mode: FollowMode) -> Replan:
        if trajectory is None:
            return Replan(self.trajectory, self.mode, taken=False)
        self.trajectory, self.mode = trajectory, mode
        return Replan(trajectory, mode, taken=True)

    def _guided(self, state: State, target_m: Array) -> Array:
        """Return the attitude that the flux turns the face to on its way to the target, shape (3, 3)."""
        pose = Pose(state.axes[0, :3], state.attitude, float(state.axes[0, 6]))
        try:
            return plan_path(self._swarm.formation, pose, target_m, self._swarm.hold_depth_m).poses[-1].rotation
        except PlanError:  # on the rim just now: the next sighting has it elsewhere
            return state.attitude

    def _facing(self, state: State, target_m: Array) -> bool:
        way = target_m - state.axes[0, :3]
        distance = float(np.linalg.norm(way))
        radius_m = self._reach_m * float(state.axes[0, 6])
        push = EFFORTS[0].turn * self._swarm.rules.limits.acceleration_m_s2 / max(radius_m, CLOSEST_M)
        swings = float((state.axes[1, 3:6] ** 2).sum()) > 2.0 * push * SWING
        faces = float(way @ state.attitude[:, 0]) > TOWARDS * distance
        return distance < BESIDE_RADII * radius_m or (faces and not (swings and self.mode is FollowMode.TURN))

    def _stopped(self, state: State, attitude: Array, scale: float, now_s: float) -> FailSafeTrajectory | None:
        """Return the trajectory that soonest rests with another attitude and scale, if one holds."""
        axes = _axes(state.axes[1, :3])
        limits = self._swarm.rules.limits
        upright_rad_s = UPRIGHT * min(limits.climb_m_s, limits.descent_m_s) / self._arm_m(state, scale)
        trajectories = []
        for limit_shares, fastest_rad_s in product(ON_THE_SPOT, (np.inf, upright_rad_s)):
            moving = Axes(now_s, state.axes[:, :3] @ axes)
            turning = self._turning(state, attitude, scale, now_s, limit_shares.turn, 0.0, fastest_rad_s)
            if turning is not None and moving.to_velocity(np.zeros(3), self._bounds(axes, limit_shares, ALONG)):
                trajectories.append(FailSafeTrajectory(state.attitude, moving, turning, axes))
        soonest = sorted(trajectories, key=lambda trajectory: trajectory.end_s)
        return next((trajectory for trajectory in soonest if self._holds(trajectory)), None)

    def _braked(self, state: State, now_s: float) -> FailSafeTrajectory | None:
        """Return the trajectory whose centre soonest rests, a tenth beyond the limits, if one holds."""
        axes, rules = _axes(state.axes[1, :3]), self._swarm.rules
        rules = replace(rules, limits=rules.limits.beyond(BEYOND))
        jerk_m_s3, scale = min(rules.limits.jerk_m_s3, SUDDENLY_M_S3), float(state.axes[0, 6])
        for limit_shares in AT_ONCE:
            moving = Axes(now_s, state.axes[:, :3] @ axes)
            turning = self._turning(state, state.attitude, scale, now_s, limit_shares.turn, 0.0)
            if turning is not None and moving.to_velocity(
                np.zeros(3), self._bounds(axes, limit_shares, STRAIGHT, jerk_m_s3)
            ):
                trajectory = FailSafeTrajectory(state.attitude, moving, turning, axes)
                if self._holds(trajectory, rules):
                    return trajectory
        return None

    def _join(self, state: State, attitude: Array, goal: Goal, now_s: float) -> Join | None:
        """Return what all ways to join a target smoothly have in common; None if there is no turn for them."""
        limit_shares = self._swinging(state, JOINED)
        turning = self._turning(state, attitude, goal.scale, now_s, limit_shares.turn, TURN_S)
        if turning is None:
            return None
        hold_m = self._swarm.hold_depth_m * attitude[:, 0]
        return Join(state, goal, hold_m, turning, self._bounds(ENU, limit_shares, ACROSS))

    def _joined(self, join: Join, takes_s: float, run_on_s: float) -> FailSafeTrajectory | None:
        """Return a trajectory that joins the target smoothly in a given time, stays with it for a while and brakes."""
        state, goal, hold_m, turning, bounds = join
        now_s = turning.start_s
        met = self._within(goal.at(now_s + takes_s), hold_m, goal.scale)
        if math.dist(met[0], state.axes[0, :3]) > takes_s * self._swarm.rules.limits.speed_m_s:
            return None  # too far for anybody
        moving = Axes(now_s, state.axes[:, :3])
        if moving.smoothly(met, takes_s) > self._swarm.rules.limits.jerk_m_s3:
            return None
        while moving.end_s < now_s + run_on_s:  # along the prediction, piece by piece
            moving.smoothly(self._within(goal.at(moving.end_s + PIECE_S), hold_m, goal.scale), PIECE_S)
        if not (moving.to_velocity(moving.end[1], bounds) and moving.to_velocity(np.zeros(3), bounds)):
            return None
        return FailSafeTrajectory(state.attitude, moving, turning, ENU)

    def _met(
        self, state: State, attitude: Array, goal: Goal, now_s: float, limit_shares: LimitShares
    ) -> FailSafeTrajectory | None:
        """Return a trajectory that meets the target, goes on with it for a while and brakes."""
        hold_m = self._swarm.hold_depth_m * attitude[:, 0]
        axes, shares, gently = self._directions(state, goal, hold_m, now_s)
        bounds = self._bounds(axes, limit_shares, shares)
        bounds.lowest_acceleration[0] *= gently
        turning = self._turning(state, attitude, goal.scale, now_s, limit_shares.turn, TURN_S)
        if turning is None:
            return None
        given_s = FIRST_S
        for _ in range(ROUNDS):
            met = self._within(goal.at(now_s + min(given_s, HORIZON_S)), hold_m, goal.scale) @ axes
            met[2] = np.clip(met[2], 0.5 * bounds.lowest_acceleration, 0.5 * bounds.highest_acceleration)
            moving = Axes(now_s, state.axes[:, :3] @ axes)
            if not moving.to(met, bounds.reaching(met)):
                return None
            late_s = moving.end_s - now_s - given_s
            if abs(late_s) < MET_S:
                break
            given_s += late_s
        meets_s = moving.end_s
        # The target's acceleration fades, it is not followed for ever
        if not moving.to_velocity(moving.end[1], bounds.reaching(moving.end)):
            return None
        moving.straight_on(meets_s + limit_shares.run_on_s)
        if not moving.to_velocity(np.zeros(3), bounds):
            return None
        return FailSafeTrajectory(state.attitude, moving, turning, axes)

    def _directions(
        self, state: State, goal: Goal, hold_m: Array, now_s: float
    ) -> tuple[Array, tuple[Shares, Shares], float]:
        """Return axes for a move, their shares, and the share of the first one's for braking.

        A long way has a direction; braking on it is planned gently, so that something is left when the target does not
        do as predicted. A large change of velocity has one, too.
        """
        target = goal.at(now_s)
        way, change = target[0] + hold_m - state.axes[0, :3], target[1] - state.axes[1, :3]
        distance_m, gap_m_s = float(np.linalg.norm(way)), float(np.linalg.norm(change))
        hardest = ALONG[1][0] * self._swarm.rules.limits.acceleration_m_s2
        if distance_m > FAR_RADII * self._reach_m * goal.scale:
            axes = _axes(way)
            closing_m_s = max(float(-change @ axes[:, 0]), 0.0)
            needed = closing_m_s**2 / (2.0 * distance_m)
            return axes, ALONG, min(max(GENTLY_M_S2, SPARE * needed) / hardest, 1.0)
        if gap_m_s > GAP_M_S:
            return _axes(change), ALONG, 1.0
        return ENU, ACROSS, 1.0

    def _arm_m(self, state: State, scale: float) -> float:
        """Return how far from the centre a vehicle is at most on the way to a scale [m]."""
        return max(self._reach_m * max(float(state.axes[0, 6]), scale), CLOSEST_M)

    def _swinging(self, state: State, limit_shares: LimitShares) -> LimitShares:
        """Return an effort that turns at least as hard as the formation does now: or the turn would swing past."""
        pull = float(np.linalg.norm(state.axes[2, 3:6])) * self._arm_m(state, 0.0)
        present = pull / self._swarm.rules.limits.acceleration_m_s2
        return limit_shares._replace(turn=max(limit_shares.turn, min(present, ON_THE_SPOT[0].turn)))

    def _turning(
        self,
        state: State,
        attitude: Array,
        scale: float,
        now_s: float,
        share: float,
        least_s: float,
        fastest_rad_s: float = np.inf,
    ) -> Axes | None:
        """Return the axes that take up attitude and scale as fast as their share of the limits allows."""
        arm_m = self._arm_m(state, scale)
        limits = self._swarm.rules.limits
        per_joint = np.array([share / arm_m] * 3 + [GROWTH / self._reach_m])
        speed, jerk = limits.speed_m_s * per_joint, self._jerk_m_s3 * per_joint
        speed[:3] = np.minimum(speed[:3], fastest_rad_s)
        turning = Axes(now_s, state.axes[:, 3:])
        goal = np.zeros((3, 4))
        goal[0, :3] = rotation_vector(attitude @ state.attitude.T)
        goal[0, 3] = scale
        push = limits.acceleration_m_s2 * per_joint
        bounds = Bounds(-speed, speed, -push, push, jerk)
        return turning if turning.to(goal, bounds, least_s) else None

    def _bounds(
        self, axes: Array, limit_shares: LimitShares, per_axis: tuple[Shares, Shares], jerk_m_s3: float | None = None
    ) -> Bounds:
        """Bounds of the centre along its axes, the first the main one; the verification has the last word.

        An axis that leads up or down is no faster than climb or descent allow.
        """
        limits, share = self._swarm.rules.limits, limit_shares.move
        shares, pushes = share * np.array(per_axis)
        left = max(JERKED - np.sqrt(3.0) * limit_shares.turn, 0.1) / np.linalg.norm(
            pushes
        )  # turns have three axes, too
        rise = np.maximum(np.abs(axes[2]), 1e-9)
        up, down = (share * limit / rise for limit in (limits.climb_m_s, limits.descent_m_s))
        upwards = axes[2] > 0.0
        speed = limits.speed_m_s * shares
        highest = np.minimum(speed, np.where(upwards, up, down))
        lowest = -np.minimum(speed, np.where(upwards, down, up))
        push = limits.acceleration_m_s2 * pushes
        jerk = self._jerk_m_s3 if jerk_m_s3 is None else jerk_m_s3
        return Bounds(lowest, highest, -push, push, jerk * pushes * min(left, 1.0))

    def _within(self, states: Array, hold_m: Array, scale: float) -> Array:
        """Return the centre's states for a target's, (3, 3): inside the fence, no faster up and down than it may."""
        limits = self._swarm.rules.limits
        rates = -FASTEST * limits.descent_m_s, FASTEST * limits.climb_m_s
        return _inside(states, hold_m, self._box_m, self._reach_m * scale, *rates)

    def _holds(self, trajectory: FailSafeTrajectory, rules: Rules | None = None) -> bool:
        rules = rules or self._swarm.rules
        return verify(trajectory, self._outline_m, rules).keeps(rules, self._smallest_m)


def _axes(way: Array) -> Array:
    """Return axes for a move, one a column: the first along the way, shape (3, 3)."""
    length = float(np.linalg.norm(way))
    first = way / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    helper = np.array([0.0, 0.0, 1.0]) if abs(first[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    second = np.cross(helper, first)
    second /= np.linalg.norm(second)
    return np.stack((first, second, np.cross(first, second)), axis=1)


@kernel
def _inside(states: Array, hold: Array, box: Array, reach: float, slowest: float, fastest: float) -> Array:
    """The centre's states for a target's, each (3, 3).

    Args:
        states: of the target.
        hold: from it to the centre, (3,) [m].
        box: corners of the fence, (2, 3) [m]; the centre stays by the reach inside, [m].
        reach: of the vehicles around the centre.
        slowest: lowest vertical velocity [m/s].
        fastest: highest one [m/s].
    """
    centre = states.copy()
    rise = centre[1, 2]
    centre[1, 2] = min(max(rise, slowest), fastest)
    if centre[1, 2] != rise:
        centre[2, 2] = 0.0
    for k in range(3):
        low, high = box[0, k] + reach, box[1, k] - reach
        place = centre[0, k] + hold[k]
        centre[0, k] = min(max(place, min(low, high)), max(low, high))
        if place < low or place > high:
            centre[1, k], centre[2, k] = 0.0, 0.0
    return centre
