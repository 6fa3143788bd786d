"""Trajectories: a path with its profile in time, and what dense samples of all of it show."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import Fence, Separation
from fg_gcs.errors import PlanError
from fg_gcs.plan.limits import Limits
from fg_gcs.plan.path.swarm_path import SwarmPath
from fg_gcs.plan.rules import INSTANT_S, Peaks, exceeded, limit_shares, sizes
from fg_gcs.plan.timing.profile import Profile
from fg_gcs.plan.timing.time_optimal import time_optimal

BLEND_S = 0.05  # shortest window that accelerations are blended over: some setpoints, and 1 % of a short flight
SURVEY_HZ = 200.0  # density of the verification, besides the instants where the jerk steps: in between all is smooth
JERK_HZ = 1000.0  # where jerk is limited: it is taken from differences of accelerations
SURVEY_PLACES = 4_000  # instants times vehicles sampled together: 0.3 MB of work space, which stays in the cache
BETWEEN_SAMPLES = 2e-3  # how much a peak between two samples of the verification may exceed them both
POWERS = {"speed_m_s": 1, "acceleration_m_s2": 2, "jerk_m_s3": 3, "climb_m_s": 1, "descent_m_s": 1}  # of stretched time
MENDS = 8  # timings tried from or to a moving end; two or three do


class Sample(NamedTuple):
    """The swarm at T instants; each array of shape (T, V, 3)."""

    position_m: Array  # [m; ENU]
    velocity_m_s: Array  # [m/s; ENU]
    acceleration_m_s2: Array  # [m/s^2; ENU]


class Moment(NamedTuple):
    """Where something is largest on a trajectory."""

    value: float
    vehicle: int  # index
    time_s: float  # in the trajectory's own time
    position_enu_m: Array  # (3,) of the vehicle [m]


class Survey(NamedTuple):
    """What dense samples of a whole trajectory show."""

    peaks: Peaks
    low_enu_m: Array  # (3,) corners of the box that it stays in [m]
    high_enu_m: Array

    def excess_m(self, fence: Fence) -> float:
        """Return by how much a vehicle leaves the fence, negative inside [m]."""
        return float(fence.excess_m(np.stack((self.low_enu_m, self.high_enu_m))).max())

    def slower(self, factor: float) -> Survey:
        """Return what the same samples show when all is flown ``factor`` times slower.

        It meets the same places, where speeds are lower by the factor, accelerations by its square, jerks by its cube.
        """
        lower = {name: getattr(self.peaks, name) / factor**power for name, power in POWERS.items()}
        return self._replace(peaks=Peaks(**lower))


class Trajectory:
    """A path with its profile in time: the swarm's position, velocity and acceleration at any time."""

    def __init__(
        self, path: SwarmPath, profile: Profile, survey_hz: float = SURVEY_HZ, survey: Survey | None = None
    ) -> None:
        """Take both, how densely to sample them, and what that shows; None: sampled when it is asked for."""
        self._path = path
        self._profile = profile
        self._survey_hz = survey_hz
        self._known = survey
        self.duration_s = profile.duration_s

    def sample(self, time_s: Array) -> Sample:
        """Return the swarm at ``time_s``, shape (T,) [s].

        Before the start and after the end every vehicle moves straight on at the velocity that it has there, without
        acceleration; where the trajectory starts or ends at rest, it rests.
        """
        times = np.asarray(time_s, dtype=float)
        s_m, rate, s_ddot = self._profile.at(times)
        position, first, second = self._path.at(s_m)
        return Sample(*_motion(position, first, second, rate, s_ddot, times, self.duration_s))

    def slower(self, factor: float) -> Trajectory:
        """Return the same path flown ``factor`` times slower; the speeds at its ends fall by the factor too."""
        return Trajectory(self._path, self._profile.slower(factor), self._survey_hz, self.survey.slower(factor))

    @cached_property
    def survey(self) -> Survey:
        """What dense samples of the whole trajectory show, every instant included where the jerk steps.

        It steps where the timing's acceleration does, and where the path passes a knot.
        """
        if self._known is not None:
            return self._known
        outline = self._path.outline
        time_s = self._profile.instants(self._survey_hz)
        s_m, rate, s_ddot = self._profile.at(time_s)
        peaks = np.zeros(len(Peaks._fields))
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        rows = max(1, SURVEY_PLACES // outline.vehicles)
        for start in range(0, len(time_s) - 1, rows):
            block = slice(start, start + rows + 1)  # neighbours share an instant: jerk needs two
            points = outline.at(s_m[block])
            extrema(*points, rate[block], s_ddot[block], time_s[block], peaks, low, high)
        passed_s = np.interp(self._path.knots_m, s_m, time_s)  # straight between two instants: to some micrometres
        s_m, rate, s_ddot = self._profile.at(passed_s)
        extrema(*outline.at(s_m), rate, s_ddot, passed_s, peaks, low, high)
        return Survey(Peaks(*peaks.tolist()), low, high)

    def largest(self, of: Callable[[Sample, Array], Array]) -> Moment:
        """Return where something is largest among all vehicles and the instants of the survey.

        Args:
            of: of a sample and its times, shape (T,): what is compared, shape (T, V). An instant is shown twice, last
                in one sample and first in the next.
        """
        time_s = self._profile.instants(self._survey_hz)
        rows = max(1, SURVEY_PLACES // self._path.vehicles)
        found = []
        for start in range(0, len(time_s) - 1, rows):
            times = time_s[start : start + rows + 1]
            sample = self.sample(times)
            values = of(sample, times)
            row, vehicle = np.unravel_index(int(values.argmax()), values.shape)
            place = sample.position_m[row, vehicle]
            found.append(Moment(float(values[row, vehicle]), int(vehicle), float(times[row]), place))
        return max(found, key=lambda moment: moment.value)

    @cached_property
    def closest(self) -> Separation:
        """The closest approach of any pair, in the trajectory's own time."""
        distance_m, s_m, pair = self._path.closest()
        return Separation(distance_m, self._profile.when(s_m), pair)


def timed(path: SwarmPath, limits: Limits, start_speed: float = 0.0, end_speed: float = 0.0) -> Trajectory:
    """Return the fastest trajectory of a path with continuous acceleration, and bounded jerk where a limit is given.

    The time-optimal timing is averaged over a window, see :mod:`fg_gcs.plan.timing.profile`. What then exceeds a
    limit between two rests is mended by flying slower: stretching time by k divides speeds by k, accelerations by k
    squared and jerks by k cubed. From or to a moving end the speeds there have to stay: the path is timed again under
    limits that are lower by what was exceeded, until nothing is.

    Args:
        path: the swarm's path.
        limits: of every vehicle.
        start_speed: path speed at the start, ds/dt >= 0 [m/s]; the path acceleration there is 0.
        end_speed: path speed at the end, likewise.

    Raises:
        PlanError: no timing keeps the limits; the text says why and what would help.
    """
    window_s = max(BLEND_S, 2.0 * limits.acceleration_m_s2 / limits.jerk_m_s3) if path.length_m > 0.0 else 0.0
    survey_hz = SURVEY_HZ if np.isinf(limits.jerk_m_s3) else JERK_HZ
    if start_speed == 0.0 and end_speed == 0.0:
        trajectory = Trajectory(path, Profile(time_optimal(path, limits), window_s), survey_hz)
        peaks = trajectory.survey.peaks
        worst = max(share ** (1.0 / POWERS[name]) for name, share in limit_shares(peaks, limits).items())
        return trajectory if worst < 1.0 - BETWEEN_SAMPLES else trajectory.slower(worst * (1.0 + BETWEEN_SAMPLES))
    leads_m = _leads(path, start_speed, end_speed, window_s)
    cruise = limits
    for _ in range(MENDS):
        timing = time_optimal(path, limits, start_speed, end_speed, leads_m, cruise)
        trajectory = Trajectory(path, Profile(timing, window_s), survey_hz)
        reached = limit_shares(trajectory.survey.peaks, limits)
        if not exceeded(trajectory.survey.peaks, limits):
            return trajectory
        cruise = _lowered(cruise, reached)
    name = max(reached, key=lambda each: reached[each])
    reason = excess(trajectory, name, trajectory.survey.peaks, limits, 0.0)
    raise PlanError(f"no timing from {start_speed:.2f} to {end_speed:.2f} m/s keeps the limits: {reason}")


def _lowered(cruise: Limits, reached: dict[str, float]) -> Limits:
    """Lower what was exceeded; jerk comes from acceleration over the window, so that goes down for it."""
    excess = {name: share * (1.0 + BETWEEN_SAMPLES) if share > 1.0 else 1.0 for name, share in reached.items()}
    return replace(
        cruise,
        speed_m_s=cruise.speed_m_s / excess["speed_m_s"],
        climb_m_s=cruise.climb_m_s / excess["climb_m_s"],
        descent_m_s=cruise.descent_m_s / excess["descent_m_s"],
        acceleration_m_s2=cruise.acceleration_m_s2 / max(excess["acceleration_m_s2"], excess["jerk_m_s3"]),
    )


def _leads(path: SwarmPath, start_speed: float, end_speed: float, window_s: float) -> tuple[float, float]:
    """How much of the path's start and end is flown at constant speed while the window fills and empties [m].

    Raises:
        PlanError: the speeds are no numbers >= 0, or the path is too short for it.
    """
    if not (0.0 <= start_speed < np.inf and 0.0 <= end_speed < np.inf):
        raise PlanError(f"start and end speed must be finite and not negative, got {start_speed} and {end_speed}")
    start_m, end_m = 0.5 * window_s * start_speed, 0.5 * window_s * end_speed
    if not start_m + end_m < path.length_m:
        raise PlanError(
            f"the path of {path.length_m:.2f} m is too short to blend accelerations between {start_speed:.2f} and "
            f"{end_speed:.2f} m/s: that takes {start_m + end_m:.2f} m; start or end slower"
        )
    return start_m, end_m


def excess(piece: Trajectory, name: str, peaks: Peaks, limits: Limits, start_s: float) -> str:
    """Say which vehicle exceeds a limit most, when and where, and what would help."""
    peak, limit = getattr(peaks, name), getattr(limits, name)
    moment = piece.largest(lambda sample, time_s: sizes(name, sample.velocity_m_s, sample.acceleration_m_s2, time_s))
    who = f"vehicle {moment.vehicle + 1}"
    value = moment.value
    if value <= limit:  # only the points that stand for the vehicles of a large swarm exceed it
        who, value = f"a point around the swarm, next to {who},", peak
    slower = (peak / limit) ** (1.0 / POWERS[name])
    return (
        f"{who} would reach {value:.3f} of {name} (limit {limit:.3f}) at t={moment.time_s + start_s:.1f} s, "
        f"at {place_text(moment.position_enu_m)}; fly {slower:.3f} times slower "
        f"or raise the limit by {peak - limit:.3f}"
    )


def place_text(position_m: Array) -> str:
    """Return a place as people read it, shape (3,) [m]."""
    return "(" + ", ".join(f"{value:.1f}" for value in position_m) + ")"


@kernel
def _motion(
    position: Array, first: Array, second: Array, rate: Array, s_ddot: Array, time: Array, duration: float
) -> tuple[Array, Array, Array]:
    """Positions, velocities ``q' s'`` and accelerations ``q' s'' + q'' s'^2``, each (T, V, 3).

    Outside the duration there is no acceleration, and the positions are moved on at the velocity.
    """
    moved, velocity, acceleration = np.empty_like(first), np.empty_like(first), np.zeros_like(first)
    for i in range(first.shape[0]):
        square = rate[i] * rate[i]
        beyond = time[i] - min(max(time[i], 0.0), duration)
        for v in range(first.shape[1]):
            for k in range(3):
                velocity[i, v, k] = first[i, v, k] * rate[i]
                if beyond == 0.0:
                    acceleration[i, v, k] = first[i, v, k] * s_ddot[i] + second[i, v, k] * square
                moved[i, v, k] = position[i, v, k] + beyond * velocity[i, v, k]
    return moved, velocity, acceleration


@kernel
def extrema(
    position: Array,
    first: Array,
    second: Array,
    rate: Array,
    s_ddot: Array,
    time: Array,
    peaks: Array,
    low: Array,
    high: Array,
) -> None:
    """Raise the peaks and widen the box by T instants of V points.

    Args:
        position: of the points, shape (T, V, 3) [m].
        first: their derivatives by the path's parameter, shape (T, V, 3).
        second: their second derivatives, shape (T, V, 3).
        rate: derivative of the parameter by time, shape (T,).
        s_ddot: its second derivative, shape (T,).
        time: ascending, shape (T,) [s].
        peaks: the fields of :class:`Peaks`, shape (5,), raised in place.
        low: lower corner of the box, shape (3,), widened in place.
        high: upper corner, likewise.
    """
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
                acceleration = first[i, v, k] * s_ddot[i] + second[i, v, k] * square
                v2 += velocity * velocity
                a2 += acceleration * acceleration
                j2 += (acceleration - before[v, k]) ** 2
                before[v, k] = acceleration
                low[k] = min(low[k], position[i, v, k])
                high[k] = max(high[k], position[i, v, k])
            speed2, acceleration2 = max(speed2, v2), max(acceleration2, a2)
            if step > INSTANT_S:
                jerk2 = max(jerk2, j2 / (step * step))
            peaks[3] = max(peaks[3], first[i, v, 2] * rate[i])
            peaks[4] = max(peaks[4], -first[i, v, 2] * rate[i])
    peaks[0], peaks[1], peaks[2] = math.sqrt(speed2), math.sqrt(acceleration2), math.sqrt(jerk2)
