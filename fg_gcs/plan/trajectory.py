"""Trajectories, and plans that carry the proof that limits, fence and separation hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fg_gcs.core.frames import yaw_from_enu
from fg_gcs.core.separation import Separation
from fg_gcs.errors import PlanError
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.paths import SwarmPath
from fg_gcs.plan.profile import Profile
from fg_gcs.plan.timing import time_optimal

Array = NDArray[np.float64]

BLEND_S = 0.05  # shortest window that accelerations are blended over: some setpoints, and 1 % of a short flight
SURVEY_HZ = 200.0  # density of the proof, besides the instants where the jerk steps: in between all is smooth
JERK_HZ = 1000.0  # where jerk is limited: it is taken from differences of accelerations
SURVEY_PLACES = 20_000  # instants times vehicles looked at together: 2 MB of work space, whatever the swarm
MOMENTS = 2001  # instants among which the moment of the closest approach is looked up
ON_FENCE_M = 1e-6  # a micrometre: rounding of places that lie on the fence itself
OUTSIDE_SAMPLES = 2001  # enough to name the vehicle, the time and the place
BETWEEN_SAMPLES = 2e-3  # how much a peak between two samples of the proof may exceed them both
UNITS = (("speed", "m_s"), ("acceleration", "m_s2"), ("jerk", "m_s3"), ("climb", "m_s"), ("descent", "m_s"))
YAW_BLEND_M = 1.0  # a vehicle this close to the vertical through its target has no bearing to it; blend over


class Sample(NamedTuple):
    """The swarm at T instants; each array of shape (T, V, 3)."""

    position_m: Array  # [m; ENU]
    velocity_m_s: Array  # [m/s; ENU]
    acceleration_m_s2: Array  # [m/s^2; ENU]


class Peaks(NamedTuple):
    """Largest values over all vehicles and times."""

    speed_m_s: float
    acceleration_m_s2: float
    jerk_m_s3: float  # of differences between dense samples
    climb_m_s: float
    descent_m_s: float


class Survey(NamedTuple):
    """What a dense look at a whole trajectory finds."""

    peaks: Peaks
    low_enu_m: Array  # (3,) corners of the box that it stays in [m]
    high_enu_m: Array


class Trajectory:
    """A path with its profile in time: the swarm's position, velocity and acceleration at any time."""

    def __init__(self, path: SwarmPath, profile: Profile, survey_hz: float = SURVEY_HZ) -> None:
        """Take both, and how densely to survey them; the path is not looked at before it is sampled."""
        self._path = path
        self._profile = profile
        self._survey_hz = survey_hz
        self.duration_s = profile.duration_s

    def sample(self, time_s: Array) -> Sample:
        """Return the swarm at ``time_s``, shape (T,) [s]; before the start and after the end it rests there."""
        s_m, rate, growth = self._profile.at(time_s)
        position, first, second = self._path.at(s_m)
        return Sample(position, *_derivatives(first, second, rate, growth))

    def slower(self, factor: float) -> Trajectory:
        """Return the same path flown ``factor`` times slower."""
        return Trajectory(self._path, self._profile.slower(factor), self._survey_hz)

    @cached_property
    def survey(self) -> Survey:
        """What a dense look at the whole trajectory finds, every instant included where the jerk steps."""
        time_s = self._profile.instants(self._survey_hz)
        s_m, rate, growth = self._profile.at(time_s)
        outline = self._path.outline
        peaks = np.zeros(5)
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        rows = max(1, SURVEY_PLACES // outline.vehicles)
        for start in range(0, len(time_s) - 1, rows):
            block = slice(start, start + rows + 1)  # neighbours share an instant: jerk needs two
            points = outline.at(s_m[block])
            _look(*points, rate[block], growth[block], time_s[block], peaks, low, high)
        return Survey(Peaks(*peaks.tolist()), low, high)

    @cached_property
    def closest(self) -> Separation:
        """The closest approach of any pair, in the trajectory's own time."""
        distance_m, s_m, pair = self._path.closest()
        time_s = np.linspace(0.0, self.duration_s, MOMENTS)
        moment = min(int(np.searchsorted(self._profile.at(time_s)[0], s_m)), MOMENTS - 1)
        return Separation(distance_m, float(time_s[moment]), pair)


@dataclass(frozen=True)
class CheckedPlan:
    """Trajectories one after the other, proven against the rules; made by :func:`check` alone.

    Row v of every sample belongs to vehicle v.
    """

    pieces: tuple[Trajectory, ...]
    starts_s: Array  # (pieces,) when each begins [s]
    duration_s: float
    peaks: Peaks
    separation: Separation
    gaze_enu_m: Array  # (3,) the point that every vehicle's nose looks at [m; ENU]
    heading_enu: Array  # (2,) direction for a vehicle right above or below that point

    def sample(self, time_s: Array) -> Sample:
        """Return the swarm at ``time_s``, shape (T,) [s]; outside the plan it rests at the plan's ends."""
        index = np.clip(np.searchsorted(self.starts_s, time_s, side="right") - 1, 0, len(self.pieces) - 1)
        parts = [self.pieces[i].sample(time_s[index == i] - self.starts_s[i]) for i in np.unique(index)]
        order = np.argsort(np.concatenate([np.flatnonzero(index == i) for i in np.unique(index)]))
        return Sample(*(np.concatenate(field)[order] for field in zip(*parts, strict=True)))

    def yaw_rad(self, position_m: Array) -> Array:
        """Return the heading that looks at the target from each position; (..., 3) to (...) [rad; NED]."""
        bearing = (self.gaze_enu_m - position_m)[..., :2]
        near = np.maximum(YAW_BLEND_M - np.linalg.norm(bearing, axis=-1, keepdims=True), 0.0)
        return yaw_from_enu(bearing + near * self.heading_enu)


def timed(path: SwarmPath, limits: Limits) -> Trajectory:
    """Return the fastest trajectory of a path with continuous acceleration, and bounded jerk where a limit is given.

    The time-optimal timing is averaged over a window, see :mod:`fg_gcs.plan.profile`. What then exceeds a limit is
    mended by flying slower: stretching time by k divides speeds by k, accelerations by k squared and jerks by k
    cubed.

    Raises:
        PlanError: no timing keeps the limits.
    """
    window_s = max(BLEND_S, 2.0 * limits.acceleration_m_s2 / limits.jerk_m_s3)
    profile = Profile(time_optimal(path, limits), window_s if path.length_m > 0.0 else 0.0)
    trajectory = Trajectory(path, profile, SURVEY_HZ if np.isinf(limits.jerk_m_s3) else JERK_HZ)
    peaks = trajectory.survey.peaks
    worst = max(
        peaks.speed_m_s / limits.speed_m_s,
        peaks.climb_m_s / limits.climb_m_s,
        peaks.descent_m_s / limits.descent_m_s,
        float(np.sqrt(peaks.acceleration_m_s2 / limits.acceleration_m_s2)),
        float(np.cbrt(peaks.jerk_m_s3 / limits.jerk_m_s3)),
    )
    return trajectory if worst < 1.0 - BETWEEN_SAMPLES else trajectory.slower(worst * (1.0 + BETWEEN_SAMPLES))


def check(pieces: Sequence[Trajectory], rules: Rules, gaze_enu_m: Array) -> CheckedPlan:
    """Prove a sequence of trajectories against the rules.

    Args:
        pieces: at least one trajectory; each starts where the one before ended.
        rules: limits, separation and fence.
        gaze_enu_m: the point that every vehicle looks at, shape (3,) [m].

    Raises:
        PlanError: names the rule that is broken, by which vehicles (counted from 1), where and when.
    """
    starts_s = np.concatenate(([0.0], np.cumsum([piece.duration_s for piece in pieces])))
    centre = pieces[0].sample(np.zeros(1)).position_m[0].mean(axis=0)
    bearing = (gaze_enu_m - centre)[:2]
    length = float(np.linalg.norm(bearing))
    heading = bearing / length if length > 0.0 else np.array([0.0, 1.0])
    surveys = [piece.survey for piece in pieces]
    peaks = Peaks(*np.max([survey.peaks for survey in surveys], axis=0).tolist())
    _check_limits(peaks, rules.limits)
    for piece, survey, start_s in zip(pieces, surveys, starts_s, strict=False):
        if rules.fence.excess_m(np.stack((survey.low_enu_m, survey.high_enu_m))).max() > ON_FENCE_M:
            raise _outside(piece, float(start_s), rules)
    found = [(piece.closest, float(start_s)) for piece, start_s in zip(pieces, starts_s, strict=False)]
    separation = min(closest._replace(time_s=closest.time_s + start_s) for closest, start_s in found)
    if separation.violates(rules.separation_m):
        first, second = separation.pair
        raise PlanError(
            f"vehicles {first + 1} and {second + 1} would come within {separation.distance_m:.2f} m of each other "
            f"at t={separation.time_s:.1f} s (minimum {rules.separation_m:.2f} m); widen the formation or the pads"
        )
    return CheckedPlan(tuple(pieces), starts_s[:-1], float(starts_s[-1]), peaks, separation, gaze_enu_m, heading)


def _check_limits(peaks: Peaks, limits: Limits) -> None:
    for name, unit in UNITS:
        peak, limit = getattr(peaks, f"{name}_{unit}"), getattr(limits, f"{name}_{unit}")
        if peak > limit * (1.0 + 1e-6):  # rounding of a stretched trajectory, no more
            raise PlanError(f"the plan reaches {peak:.3f} of {name}_{unit} (limit {limit:.3f}); slow it down")


def _outside(piece: Trajectory, start_s: float, rules: Rules) -> PlanError:
    """Say which vehicle leaves the fence furthest, when and where."""
    time_s = np.linspace(0.0, piece.duration_s, OUTSIDE_SAMPLES)
    position = piece.sample(time_s).position_m
    excess = rules.fence.excess_m(position)  # (T, V)
    instant, vehicle = np.unravel_index(int(excess.argmax()), excess.shape)
    place = ", ".join(f"{value:.1f}" for value in position[instant, vehicle])
    return PlanError(
        f"vehicle {vehicle + 1} would be {excess[instant, vehicle]:.2f} m outside the fence "
        f"at t={time_s[instant] + start_s:.1f} s, at ({place}); raise the flight or move the fence by as much"
    )


@njit(cache=True)
def _derivatives(first: Array, second: Array, rate: Array, growth: Array) -> tuple[Array, Array]:
    """Velocities ``q' s'`` and accelerations ``q' s'' + q'' s'^2``, each (T, V, 3)."""
    velocity, acceleration = np.empty_like(first), np.empty_like(first)
    for i in range(first.shape[0]):
        square = rate[i] * rate[i]
        for v in range(first.shape[1]):
            for k in range(3):
                velocity[i, v, k] = first[i, v, k] * rate[i]
                acceleration[i, v, k] = first[i, v, k] * growth[i] + second[i, v, k] * square
    return velocity, acceleration


@njit(cache=True)
def _look(
    position: Array,
    first: Array,
    second: Array,
    rate: Array,
    growth: Array,
    time: Array,
    peaks: Array,
    low: Array,
    high: Array,
) -> None:
    """Raise the peaks (speed, acceleration, jerk, climb, descent) and widen the box by T instants of V points."""
    vehicles = position.shape[1]
    before = np.zeros((vehicles, 3))  # accelerations of the instant before
    speed2, acceleration2, jerk2 = peaks[0] ** 2, peaks[1] ** 2, peaks[2] ** 2
    for i in range(position.shape[0]):
        square = rate[i] * rate[i]
        step = time[i] - time[i - 1] if i > 0 else 0.0
        for v in range(vehicles):
            v2, a2, j2 = 0.0, 0.0, 0.0
            for k in range(3):
                velocity = first[i, v, k] * rate[i]
                acceleration = first[i, v, k] * growth[i] + second[i, v, k] * square
                v2 += velocity * velocity
                a2 += acceleration * acceleration
                j2 += (acceleration - before[v, k]) ** 2
                before[v, k] = acceleration
                low[k] = min(low[k], position[i, v, k])
                high[k] = max(high[k], position[i, v, k])
            speed2, acceleration2 = max(speed2, v2), max(acceleration2, a2)
            if step > 1e-4:  # instants closer than this tell rounding, not jerk
                jerk2 = max(jerk2, j2 / (step * step))
            peaks[3] = max(peaks[3], first[i, v, 2] * rate[i])
            peaks[4] = max(peaks[4], -first[i, v, 2] * rate[i])
    peaks[0], peaks[1], peaks[2] = math.sqrt(speed2), math.sqrt(acceleration2), math.sqrt(jerk2)
