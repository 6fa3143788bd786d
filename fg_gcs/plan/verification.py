"""Plans that were verified: dense samples of them keep limits and fence, and every pair keeps its separation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import yaw_from_enu
from fg_gcs.core.separation import Separation
from fg_gcs.errors import PlanError
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.rules import Peaks, exceeded, outside, too_close
from fg_gcs.plan.trajectory import Sample, Trajectory, excess, place_text

YAW_BLEND_M = 1.0  # a vehicle this close to the vertical through its target has no bearing to it; blend over


@dataclass(frozen=True)
class CheckedPlan:
    """Trajectories one after the other, verified against the rules; made by :func:`check` alone.

    Row v of every sample belongs to vehicle v.
    """

    pieces: tuple[Trajectory, ...]
    starts_s: Array  # (pieces,) when each begins [s]
    duration_s: float
    peaks: Peaks
    separation: Separation
    limits: Limits  # that it was verified against
    gaze_enu_m: Array  # (3,) the point that every vehicle's nose points at [m; ENU]
    heading_enu: Array  # (2,) direction for a vehicle right above or below that point

    def sample(self, time_s: Array) -> Sample:
        """Return the swarm at ``time_s``, shape (T,) [s]; outside the plan it goes on as its end pieces do."""
        index = np.clip(np.searchsorted(self.starts_s, time_s, side="right") - 1, 0, len(self.pieces) - 1)
        if (index == index[0]).all():  # as for the single instants that are asked for in flight
            only = int(index[0])
            return self.pieces[only].sample(time_s - self.starts_s[only])
        parts = [self.pieces[i].sample(time_s[index == i] - self.starts_s[i]) for i in np.unique(index)]
        order = np.argsort(np.concatenate([np.flatnonzero(index == i) for i in np.unique(index)]))
        return Sample(*(np.concatenate(field)[order] for field in zip(*parts, strict=True)))

    def yaw_rad(self, position_m: Array) -> Array:
        """Return the heading towards the target from each position; (..., 3) to (...) [rad; NED]."""
        return yaw_towards(self.gaze_enu_m, position_m, self.heading_enu)


def yaw_towards(gaze_enu_m: Array, position_m: Array, heading_enu: Array) -> Array:
    """Return the headings towards a point from each position; (..., 3) to (...) [rad; NED].

    Args:
        gaze_enu_m: the point, shape (3,) [m; ENU].
        position_m: from where, shape (..., 3) [m; ENU].
        heading_enu: direction to blend over to right above or below the point, shape (2,).
    """
    yaw_rad = _yaw_towards(gaze_enu_m, np.ascontiguousarray(position_m).reshape(-1, 3), heading_enu)
    return yaw_rad.reshape(position_m.shape[:-1])


@kernel
def _yaw_towards(gaze: Array, positions: Array, heading: Array) -> Array:
    """Headings, (P,), from positions, (P, 3)."""
    yaw = np.empty(len(positions))
    for i in range(len(positions)):
        east, north = gaze[0] - positions[i, 0], gaze[1] - positions[i, 1]
        near = max(YAW_BLEND_M - math.sqrt(east * east + north * north), 0.0)
        yaw[i] = yaw_from_enu(east + near * heading[0], north + near * heading[1])
    return yaw


def check(pieces: Sequence[Trajectory], rules: Rules, gaze_enu_m: Array) -> CheckedPlan:
    """Verify a sequence of trajectories against the rules.

    Args:
        pieces: at least one trajectory; each starts where the one before ended.
        rules: limits, separation and fence.
        gaze_enu_m: the point that every nose points at, shape (3,) [m].

    Raises:
        PlanError: names the rule that is broken, by which vehicles (counted from 1), when, and what would help.
    """
    starts_s = np.concatenate(([0.0], np.cumsum([piece.duration_s for piece in pieces])))
    centre = pieces[0].sample(np.zeros(1)).position_m[0].mean(axis=0)
    bearing = (gaze_enu_m - centre)[:2]
    length = float(np.linalg.norm(bearing))
    heading = bearing / length if length > 0.0 else np.array([0.0, 1.0])
    surveys = [piece.survey for piece in pieces]
    peaks = Peaks(*np.max([survey.peaks for survey in surveys], axis=0).tolist())
    for piece, survey, start_s in zip(pieces, surveys, starts_s, strict=False):
        for name in exceeded(survey.peaks, rules.limits):
            raise PlanError(excess(piece, name, survey.peaks, rules.limits, float(start_s)))
        if outside(survey.excess_m(rules.fence)):
            raise _outside(piece, float(start_s), rules)
    found = [(piece.closest, float(start_s)) for piece, start_s in zip(pieces, starts_s, strict=False)]
    separation = min(closest._replace(time_s=closest.time_s + start_s) for closest, start_s in found)
    if too_close(separation.distance_m, rules.separation_m):
        first, second = separation.pair
        raise PlanError(
            f"vehicles {first + 1} and {second + 1} would come within {separation.distance_m:.2f} m of each other "
            f"at t={separation.time_s:.1f} s (minimum {rules.separation_m:.2f} m); widen the formation or the pads, "
            f"there by {rules.separation_m - separation.distance_m:.2f} m"
        )
    duration_s = float(starts_s[-1])
    return CheckedPlan(tuple(pieces), starts_s[:-1], duration_s, peaks, separation, rules.limits, gaze_enu_m, heading)


def _outside(piece: Trajectory, start_s: float, rules: Rules) -> PlanError:
    """Say which vehicle leaves the fence furthest, when and where."""
    moment = piece.largest(lambda sample, _: rules.fence.excess_m(sample.position_m))
    return PlanError(
        f"vehicle {moment.vehicle + 1} would be {moment.value:.2f} m outside the fence at "
        f"t={moment.time_s + start_s:.1f} s, at {place_text(moment.position_enu_m)}; "
        "raise the flight or move the fence by as much"
    )
