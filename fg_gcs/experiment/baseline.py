"""The paper's way on a scene, with a stopwatch."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fg_gcs.core import solid_angle
from fg_gcs.errors import PlanError
from fg_gcs.experiment.baselines.reference_planner import PaperPath, PaperPlan, plan_leaders, plan_swarm
from fg_gcs.experiment.scenes import LIMITS, Scene

Stopwatch = Callable[[], float]  # returns seconds
Progress = Callable[[str], None]  # one line for people


class PaperRun(NamedTuple):
    """One plan the paper's way."""

    path: PaperPath
    plan: PaperPlan | None  # None: some vehicle had no timing
    search_s: float
    total_s: float  # search, followers and timing; until it failed, where it did

    def flux_metric(self, scene: Scene) -> float:
        """Flux metric at the end, clipped as the paper does; the face may have folded or passed the target."""
        flux = float(solid_angle.flux(self.path.leaders_enu_m[-1], scene.target_enu_m))
        return float(np.clip(flux / solid_angle.HALF_SPHERE, 0.0, 1.0))


def run_paper_way(scene: Scene, stopwatch: Stopwatch) -> PaperRun:
    """Plan a scene the paper's way."""
    began = stopwatch()
    path = plan_leaders(scene.leaders_enu_m, scene.target_enu_m, scene.last_edge_m)
    found = stopwatch()
    plan: PaperPlan | None
    try:
        plan = plan_swarm(path, scene.formation, LIMITS)
    except PlanError:  # a failure of the baseline is a result too
        plan = None
    return PaperRun(path, plan, found - began, stopwatch() - began)


def seconds(run: Callable[[], object], stopwatch: Stopwatch) -> float:
    """Return how long a call takes [s]."""
    began = stopwatch()
    run()
    return stopwatch() - began
