"""Our planner on a scene: the path, its trajectory, and what dense samples of both say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import pdist

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import coverage, flux_metric, least_after_facing
from fg_gcs.core.formation import Formation
from fg_gcs.core.separation import Fence
from fg_gcs.experiment.scenes import LEADERS, LIMITS, Scene
from fg_gcs.plan.flux_guided import FluxPath, plan_path
from fg_gcs.plan.free import plan_leaders
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.path.leader_paths import LeadersPath
from fg_gcs.plan.path.rigid_path import PosePath
from fg_gcs.plan.path.swarm_path import SwarmPath
from fg_gcs.plan.rules import limit_shares, peaks_of
from fg_gcs.plan.trajectory import Trajectory, timed
from fg_gcs.plan.verification import CheckedPlan, check

OPEN_M = 1e5  # a fence that no experiment reaches: the paper has none
SEPARATION_SHARE = 0.95  # of the closest pair in the formation's own shape
SAMPLE_M = 0.1  # of path between samples of lengths and distances; halving it changes lengths by 1e-5
SAMPLE_HZ = 1000.0  # what the limits are held against


class PathFigures(NamedTuple):
    """What dense samples of a path say."""

    length_m: float  # sum over the leaders
    flux_metric: float  # at the end
    coverage_after_facing: float  # smallest after the face has turned to the target; 1 when it never has to
    separation_ratio: float  # closest pair over that of the template at the scale of the moment


class LimitRatios(NamedTuple):
    """Largest norms over their limits."""

    speed: float
    acceleration: float


@dataclass(frozen=True)
class Planned:
    """A scene with its path and plan."""

    scene: Scene
    path: PosePath
    plan: CheckedPlan


def search(scene: Scene) -> FluxPath:
    """Run the flux-guided search alone: what is timed as FG."""
    return plan_path(scene.formation, scene.start, scene.target_enu_m, last_scale=scene.last_scale)


def plan(scene: Scene) -> Planned:
    """Plan all vehicles of a scene, time and check: what is timed as a whole plan.

    Raises:
        PlanError: there is no such plan.
    """
    return plan_formation(scene, scene.formation)


def plan_formation(scene: Scene, formation: Formation) -> Planned:
    """Plan a scene with another formation in the place of its own.

    Raises:
        PlanError: there is no such plan.
    """
    found = plan_path(formation, scene.start, scene.target_enu_m, last_scale=scene.last_scale)
    path = PosePath(formation.slots_m, found.poses)
    trajectory = timed(path, LIMITS)
    smallest_m = formation.smallest_separation_m * min(1.0, scene.last_scale)
    rules = Rules(LIMITS, SEPARATION_SHARE * smallest_m, Fence((-OPEN_M,) * 3, (OPEN_M,) * 3))
    return Planned(scene, path, check([trajectory], rules, scene.target_enu_m))


def path_figures(scene: Scene, path: SwarmPath) -> PathFigures:
    """Measure a path. All vehicles share its parameter, so its samples see every moment of any timing."""
    count = max(2, int(np.ceil(path.length_m / SAMPLE_M)) + 1)
    places = path.at(np.linspace(0.0, path.length_m, count)).position_m  # (S, V, 3)
    rims = places[:, :LEADERS]
    covered = coverage(rims, scene.target_enu_m)
    return PathFigures(
        length_m=float(np.linalg.norm(np.diff(rims, axis=0), axis=2).sum()),
        flux_metric=float(flux_metric(rims[-1:], scene.target_enu_m)[0]),
        coverage_after_facing=least_after_facing(covered) or 0.0,
        separation_ratio=separation_ratio(places, scene.formation),
    )


def free_separation_ratio(scene: Scene) -> float:
    """Plan with freely moving leaders, at one size, and return the closest pair of the path over the template's.

    Raises:
        PlanError: there is no such path.
    """
    formation = scene.formation
    path = LeadersPath(formation, plan_leaders(formation, scene.start, scene.target_enu_m))
    return path.closest().distance_m / formation.smallest_separation_m


def separation_ratio(places_m: Array, formation: Formation) -> float:
    """Return the least of: closest pair over the template's, at the size of the rim at that moment; (S, V, 3)."""
    rims = places_m[:, :LEADERS]
    sizes_m = np.linalg.norm(rims - rims.mean(axis=1, keepdims=True), axis=2).mean(axis=1)
    own_m = float(np.linalg.norm(formation.leaders_m, axis=1).mean())
    closest_m = np.array([pdist(each).min() for each in places_m])
    return float((closest_m / (formation.smallest_separation_m * sizes_m / own_m)).min())


def limit_ratios(trajectory: Trajectory | CheckedPlan, limits: Limits = LIMITS) -> LimitRatios:
    """Sample a trajectory at 1 kHz and hold its norms against the limits."""
    time_s = np.arange(0.0, trajectory.duration_s, 1.0 / SAMPLE_HZ)
    _, velocity, acceleration = trajectory.sample(time_s)
    shares = limit_shares(peaks_of(velocity, acceleration, time_s), limits)
    return LimitRatios(shares["speed_m_s"], shares["acceleration_m_s2"])
