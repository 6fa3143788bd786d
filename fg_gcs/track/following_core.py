"""From sightings to trajectories: an estimator for every target, their group, the inner loop; no clock, no network."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Pose
from fg_gcs.track.estimate.estimator import Estimator, Settings
from fg_gcs.track.estimate.group import Group, GroupEstimate, needed_scale
from fg_gcs.track.follow.fail_safe import FailSafeTrajectory
from fg_gcs.track.follow.replanner import RUN_ON_S, WORTH_S, FollowMode, Goal, Replan, Replanner, Swarm
from fg_gcs.track.sightings import Sighting, Verdict

LIVE_S = 0.5  # an estimate that no sighting has come for in so long says where a target should be, not where it is
QUIET_S = 0.25  # without a sighting for so long the trajectory is planned anew all the same: what is unknown grows


@dataclass(frozen=True)
class TrackingSettings:
    """What a mission says about tracking."""

    weights: Mapping[str, float]  # of every target, by its name
    estimator: Settings
    capture_m: float = 1.5  # the target is caught when the formation's centre is this near to its place
    confidence: float = 0.95  # with which a ball holds a target
    most_radius_m: float = 0.0  # of the ball that the formation grows for; 0: it keeps its size


class FollowingCore:
    """Follows targets.

    Attributes:
        counts: sightings by what became of them.
        replanner: the inner loop, with the present trajectory.
        caught_s: when the formation first was around the target [s], None until then, see :meth:`holds`.
    """

    def __init__(self, swarm: Swarm, tracking: TrackingSettings, start: Pose, start_s: float) -> None:
        """Rest at a pose from a time on [s]."""
        self.counts: Counter[Verdict] = Counter()
        self.replanner = Replanner(swarm, start, start_s)
        self.caught_s: float | None = None
        self._swarm = swarm
        self._tracking = tracking
        self._estimators = {name: Estimator(tracking.estimator) for name in tracking.weights}
        settings = tracking.estimator
        self._taken_s = dict.fromkeys(tracking.weights, -math.inf)  # when a sighting of it was taken last
        self._group = Group(tracking.weights, settings.lost_after_s, tracking.most_radius_m, tracking.confidence)
        self._first_scale = start.scale
        self._inscribed_m = swarm.formation.inscribed_radius_m

    @property
    def trajectory(self) -> FailSafeTrajectory:
        """The present trajectory."""
        return self.replanner.trajectory

    def sighted(self, sighting: Sighting, now_s: float) -> Verdict:
        """Take a sighting; return what became of it."""
        estimator = self._estimators.get(sighting.target)
        verdict = Verdict.UNKNOWN_TARGET if estimator is None else estimator.add(sighting, now_s)
        self.counts[verdict] += 1
        if verdict is Verdict.TAKEN:
            self._taken_s[sighting.target] = now_s
        return verdict

    def known(self, now_s: float) -> GroupEstimate | None:
        """Return what is known of the targets now, None before they are seen."""
        return self._group.at(now_s, {name: each.at(now_s) for name, each in self._estimators.items()})

    def replan(self, now_s: float) -> Replan | None:
        """Search for a better trajectory from now on; None while nothing is known.

        When every target is lost the formation goes on as predicted for a while, then rests. It grows with the
        uncertainty all the time.
        """
        known = self.known(now_s)
        return None if known is None else next(replan for replan in self.replanning(known) if replan is not None)

    def replanning(self, known: GroupEstimate) -> Iterator[Replan | None]:
        """Do the same in steps, see :meth:`.Replanner.replanning`, from the time at which so much is known."""
        now_s = known.time_s
        scale = needed_scale(self._inscribed_m, known.radius_m, self._first_scale)
        if len(known.lost) == len(self._tracking.weights) and known.last_age_s > RUN_ON_S - WORTH_S:
            yield self.replanner.wait(scale, now_s)
            return
        # Of the target seen last: one of several that is gone for good does not end what the others are followed by
        goal = Goal(known.prediction, scale, known.last_age_s)
        for replan in self.replanner.replanning(goal, now_s):
            followed = replan is not None and replan.mode is FollowMode.FOLLOW
            if self.caught_s is None and followed and self.holds(known):
                self.caught_s = now_s
            yield replan

    def holds(self, known: GroupEstimate) -> bool:
        """Say whether the formation is around the targets, as far as sightings of them say that now.

        A prediction says nothing of it: every target must have been seen, none may be lost, and of each a sighting must
        have come within the last :data:`LIVE_S`.
        """
        live = not (known.lost or known.unseen) and known.time_s - min(self._taken_s.values()) <= LIVE_S
        return live and self.error_m(known) < self._tracking.capture_m

    def error_m(self, known: GroupEstimate) -> float:
        """Return how far the formation's centre is from its place around the targets, as far as known [m]."""
        return math.dist(self.place(known.time_s), known.position_enu_m)

    def place(self, now_s: float) -> Array:
        """Return where the target is if it is held: on the axis, at the hold's depth, shape (3,) [m; ENU]."""
        frames = self.trajectory.frames(np.array([now_s]))
        normal = frames.arms[0, 0, :, 0] / frames.scale[0]
        place: Array = frames.centre[0, 0] - self._swarm.hold_depth_m * normal
        return place
