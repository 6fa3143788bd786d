"""Several targets as one: the point that a formation surrounds, and the ball around it that its face has to cover.

docs/derivations.md has the equations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from fg_gcs.core.arrays import Array
from fg_gcs.errors import PlanError
from fg_gcs.track.estimate.estimator import Estimate
from fg_gcs.track.estimate.imm import Prediction


class GroupEstimate(NamedTuple):
    """What is known of all targets together at one time."""

    time_s: float  # [s of the flight's clock]
    position_enu_m: Array  # (3,) of the centre of charge [m; ENU]
    velocity_m_s: Array  # (3,) of the centre [m/s; ENU]
    prediction: Prediction  # of the centre
    radius_m: float  # of the ball around the centre that holds the targets; 0 for one target that is seen [m]
    age_s: float  # of the oldest of the newest sightings
    last_age_s: float  # of the newest one
    lost: tuple[str, ...]  # targets not seen for too long, predicted only
    unseen: tuple[str, ...]  # targets never seen so far: they count for nothing here
    bounded: bool  # the ball would have to be larger than it may be: it need not hold the targets any more


class Group:
    """How single estimates become one; knows no time and keeps nothing.

    A target is known to within a ball that holds it with the stated confidence, as in
    :func:`fg_gcs.plan.targets.uncertain`. One target that is seen counts as a point. When it is lost, it counts as its
    ball, which grows until its bound and then stays, with ``bounded`` set. Several targets have the ball around their
    centre that holds each one's own.
    """

    def __init__(
        self, weights: Mapping[str, float], lost_after_s: float, most_radius_m: float, confidence: float = 0.95
    ) -> None:
        """Take what the targets have in common.

        Args:
            weights: names of the targets, at least one, and how much each counts for the centre, > 0.
            lost_after_s: time without a sighting after which a target is lost.
            most_radius_m: the largest ball that the formation can hold, >= 0.
            confidence: probability inside (0, 1) that a target is inside its own ball.

        Raises:
            PlanError: there is no target, or a number is out of its bounds.
        """
        if not weights or not all(0.0 < weight < math.inf for weight in weights.values()):
            raise PlanError("a group needs at least one target, and for each a weight above 0")
        if not 0.0 < confidence < 1.0:
            raise PlanError(f"the confidence must lie between 0 and 1, got {confidence}")
        if not (lost_after_s > 0.0 and 0.0 <= most_radius_m < math.inf):
            raise PlanError(
                f"a group needs a time after which targets are lost above 0 s and a largest radius of 0 m or more, "
                f"got {lost_after_s} and {most_radius_m}"
            )
        self._weights = dict(weights)
        self._lost_after_s = lost_after_s
        self._most_radius_m = most_radius_m
        self._quantile = float(chi2.ppf(confidence, df=3))

    def at(self, time_s: float, estimates: Mapping[str, Estimate | None]) -> GroupEstimate | None:
        """Return the group at a time, None as long as no target of it has an estimate.

        Args:
            time_s: the time [s of the flight's clock]; each estimate is predicted to it.
            estimates: by name of the target, the newest of each or None; names that are not in the group are ignored.
        """
        known = {name: estimates.get(name) for name in self._weights}
        seen = {name: estimate.predicted(time_s) for name, estimate in known.items() if estimate is not None}
        if not seen:
            return None
        weights = np.array([self._weights[name] for name in seen])
        shares = weights / weights.max()  # so that no sum of weights overflows
        shares /= shares.sum()
        positions = np.stack([each.position_enu_m for each in seen.values()])  # (C, 3)
        centre = shares @ positions
        lost = tuple(name for name, each in seen.items() if each.age_s > self._lost_after_s)
        radius_m = 0.0
        if len(self._weights) > 1 or lost:
            own_m = np.array([self._own_radius_m(each) for each in seen.values()])
            radius_m = float((np.linalg.norm(positions - centre, axis=1) + own_m).max())
        return GroupEstimate(
            time_s,
            centre,
            shares @ np.stack([each.velocity_m_s for each in seen.values()]),
            Prediction.centre(shares.tolist(), [each.prediction for each in seen.values()]),
            min(radius_m, self._most_radius_m),
            max(each.age_s for each in seen.values()),
            min(each.age_s for each in seen.values()),
            lost,
            tuple(name for name in self._weights if name not in seen),
            radius_m > self._most_radius_m,
        )

    def _own_radius_m(self, estimate: Estimate) -> float:
        """Radius of the ball around the ellipsoid that holds the target with the group's confidence."""
        return math.sqrt(self._quantile * max(float(np.linalg.eigvalsh(estimate.covariance[:3, :3])[-1]), 0.0))


def needed_scale(
    inscribed_radius_m: float, radius_m: float, first_scale: float = 1.0, clearance_m: float = 0.0
) -> float:
    """Return the scale at which the circle inscribed in a face holds a ball and its clearance; never below the first.

    A ball without radius is a point, for which a formation keeps its first scale.

    Args:
        inscribed_radius_m: of the formation at scale one, see
            :attr:`fg_gcs.core.formation.Formation.inscribed_radius_m`.
        radius_m: of the ball, >= 0.
        first_scale: what the formation has anyway, > 0.
        clearance_m: between the ball and the face's rim, >= 0.

    Raises:
        PlanError: the ball has a radius, but no circle fits into the face around its centre.
    """
    if radius_m == 0.0:
        return first_scale
    if not inscribed_radius_m > 0.0:
        raise PlanError("no circle fits into a face whose centre lies outside of it; a target with a radius needs one")
    return max(first_scale, (radius_m + clearance_m) / inscribed_radius_m)
