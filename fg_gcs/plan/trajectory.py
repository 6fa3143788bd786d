"""Trajectories, and plans that carry the proof that limits, fence and separation hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.frames import yaw_from_enu
from fg_gcs.core.separation import Separation, closest_approach
from fg_gcs.errors import PlanError
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.paths import SwarmPath
from fg_gcs.plan.timing import Timing, time_optimal

Array = NDArray[np.float64]

SAMPLES_PER_CELL = 5  # a cell is 0.1 m or so of way, on which a path bends little
SEPARATION_HZ = 200.0  # straight motion within 5 ms departs from the true one by 0.03 mm at 10 m/s^2
CHECK_BLOCK = 400  # cells looked at together: bounds the work space for large swarms
BETWEEN_SAMPLES = 1e-4  # how much a peak between two samples of a cell may exceed them both
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
    climb_m_s: float
    descent_m_s: float


class Trajectory:
    """A path with its timing: the swarm's position, velocity and acceleration at any time."""

    def __init__(self, path: SwarmPath, timing: Timing, stretch: float = 1.0) -> None:
        """Run the timing ``stretch`` times slower than given."""
        self._path = path
        self._timing = timing
        self._stretch = stretch
        self.duration_s = float(timing.time_s[-1]) * stretch

    def sample(self, time_s: Array) -> Sample:
        """Return the swarm at ``time_s``, shape (T,) [s]; before the start and after the end it rests there."""
        grid, speed, knots = self._timing
        inside = np.clip(time_s / self._stretch, 0.0, knots[-1])
        cell = np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, len(knots) - 2)
        span = np.maximum(knots[cell + 1] - knots[cell], np.finfo(float).tiny)
        growth = (speed[cell + 1] - speed[cell]) / span  # constant within a cell, so all below is exact
        tau = inside - knots[cell]
        s_m = np.clip(grid[cell] + (speed[cell] + 0.5 * growth * tau) * tau, 0.0, grid[-1])
        moving = (time_s >= 0.0) & (time_s < self.duration_s)
        rate = np.where(moving, speed[cell] + growth * tau, 0.0)[:, None, None] / self._stretch
        growth = np.where(moving, growth, 0.0)[:, None, None] / self._stretch**2
        position, first, second = self._path.at(s_m)
        return Sample(position, first * rate, first * growth + second * rate**2)

    def peaks(self) -> Peaks:
        """Return the largest values of all vehicles, both ends of every cell of constant path acceleration included.

        The acceleration steps from cell to cell, so samples in time could miss its peaks; samples in each cell cannot.
        """
        grid, speed, _ = self._timing
        fractions = np.linspace(0.0, 1.0, SAMPLES_PER_CELL)
        largest = np.zeros(4)
        for start in range(0, len(grid) - 1, CHECK_BLOCK):
            cells = np.arange(start, min(start + CHECK_BLOCK, len(grid) - 1))
            width = (grid[cells + 1] - grid[cells])[:, None]
            squares = speed[cells, None] ** 2 + np.diff(speed**2)[cells, None] * fractions  # linear in s within a cell
            rate = (np.sqrt(squares) / self._stretch).ravel()[:, None, None]
            tiny = np.finfo(float).tiny  # a path of no length has cells of no width, and nothing moves in them
            growth = np.diff(speed**2)[cells, None] / np.maximum(2.0 * width, tiny) / self._stretch**2
            growth = np.broadcast_to(growth, squares.shape).ravel()[:, None, None]
            _, first, second = self._path.at((grid[cells, None] + width * fractions).ravel())
            velocity = first * rate
            block = (
                np.linalg.norm(velocity, axis=2).max(),
                np.linalg.norm(first * growth + second * rate**2, axis=2).max(),
                velocity[:, :, 2].max(),
                -velocity[:, :, 2].min(),
            )
            largest = np.maximum(largest, block)
        return Peaks(*largest.tolist())


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
    """Return the time-optimal trajectory of a path, slowed by what its dense samples exceed the limits.

    Between grid points the path's spline can overshoot what the grid points promise by some tenths of a percent.
    Stretching time by k divides speeds by k and accelerations by k squared, so one stretch mends all.

    Raises:
        PlanError: no timing keeps the limits.
    """
    timing = time_optimal(path, limits)
    peaks = Trajectory(path, timing).peaks()
    worst = max(
        peaks.speed_m_s / limits.speed_m_s,
        peaks.climb_m_s / limits.climb_m_s,
        peaks.descent_m_s / limits.descent_m_s,
        float(np.sqrt(peaks.acceleration_m_s2 / limits.acceleration_m_s2)),
    )
    stretch = max(1.0, worst * (1.0 + BETWEEN_SAMPLES))
    return Trajectory(path, timing, stretch)


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
    peaks = Peaks(*np.max([piece.peaks() for piece in pieces], axis=0).tolist())
    _check_limits(peaks, rules.limits)
    separation = Separation(np.inf, 0.0, (0, 0))
    for piece, start_s in zip(pieces, starts_s, strict=False):
        time_s = _instants(piece.duration_s, SEPARATION_HZ)
        position = piece.sample(time_s).position_m
        _check_fence(position, time_s + start_s, rules)
        if position.shape[1] > 1:
            separation = min(separation, closest_approach(position, time_s + start_s))
    if separation.violates(rules.separation_m):
        first, second = separation.pair
        raise PlanError(
            f"vehicles {first + 1} and {second + 1} would come within {separation.distance_m:.2f} m of each other "
            f"at t={separation.time_s:.1f} s (minimum {rules.separation_m:.2f} m); widen the formation or the pads"
        )
    return CheckedPlan(tuple(pieces), starts_s[:-1], float(starts_s[-1]), peaks, separation, gaze_enu_m, heading)


def _check_limits(peaks: Peaks, limits: Limits) -> None:
    for name, unit in (("speed", "m_s"), ("acceleration", "m_s2"), ("climb", "m_s"), ("descent", "m_s")):
        peak, limit = getattr(peaks, f"{name}_{unit}"), getattr(limits, f"{name}_{unit}")
        if peak > limit * (1.0 + 1e-6):  # rounding of a stretched trajectory, no more
            raise PlanError(f"the plan reaches {peak:.3f} of {name}_{unit} (limit {limit:.3f}); slow it down")


def _check_fence(position_m: Array, time_s: Array, rules: Rules) -> None:
    excess = rules.fence.excess_m(position_m)  # (T, V)
    if excess.max() > 1e-6:  # a micrometre: rounding of places that lie on the fence itself
        instant, vehicle = np.unravel_index(int(excess.argmax()), excess.shape)
        place = ", ".join(f"{value:.1f}" for value in position_m[instant, vehicle])
        raise PlanError(
            f"vehicle {vehicle + 1} would be {excess[instant, vehicle]:.2f} m outside the fence "
            f"at t={time_s[instant]:.1f} s, at ({place}); raise the flight or move the fence by as much"
        )


def _instants(duration_s: float, rate_hz: float) -> Array:
    return np.linspace(0.0, duration_s, max(2, int(np.ceil(duration_s * rate_hz)) + 1))
