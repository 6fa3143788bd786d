"""The whole flight as checked plans, compiled before anything moves: gather, approach, home."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import coverage, flux_metric, least_after_facing
from fg_gcs.core.formation import Formation, Pose
from fg_gcs.core.separation import Separation
from fg_gcs.errors import PlanError
from fg_gcs.plan.formulations import FORMULATIONS, FormulationName
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.rules import Peaks
from fg_gcs.plan.targets import Target
from fg_gcs.plan.trajectory import timed
from fg_gcs.plan.transit import gather
from fg_gcs.plan.verification import CheckedPlan, check
from fg_gcs.plan.way_home import plan_home

Indices = NDArray[np.intp]

FIGURES_HZ = 100.0  # density of the figures about an approach: every 0.1 m at 10 m/s


@dataclass(frozen=True)
class Task:
    """What a flight is about, in the planner's words."""

    formation: Formation
    start: Pose  # where the formation gathers
    target: Target  # what to surround; a radius changes the formation's size on the way
    hold_depth_m: float  # how far the target's centre lies behind the face during the hold [m]
    rules: Rules
    formulation: FormulationName = "rigid"

    @property
    def target_enu_m(self) -> Array:
        """The centre of the target, shape (3,) [m]."""
        return self.target.centre_enu_m

    @property
    def last_scale(self) -> float:
        """Scale of the formation around the target.

        Raises:
            PlanError: no scale makes the face hold the target.
        """
        return self.target.last_scale(self.formation, self.start.scale)


class ApproachFigures(NamedTuple):
    """What the approach is like; lengths are sums over the leaders, flux and coverage those of the target's centre."""

    path_length_m: float
    straight_length_m: float
    iterates: int
    flux_metric: float
    coverage_mean: float
    coverage_min_after_facing: float
    last_scale: float  # of the formation around the target, times its template


@dataclass(frozen=True)
class FlightPlan:
    """Three plans that follow each other; between the last two the swarm holds around the target.

    Row v of every sample belongs to vehicle v, whatever slot or pad it was given.
    """

    gather: CheckedPlan
    approach: CheckedPlan
    home: CheckedPlan
    slot_of: Indices  # (V,)
    rim_of: Indices  # (N,) the vehicle at each place of the rim
    figures: ApproachFigures
    plan_time_s: float  # flux-guided search
    timing_time_s: float  # timing, transits and checks

    @property
    def separation(self) -> Separation:
        """The closest approach of the whole flight; its time counts within its own plan."""
        return min(plan.separation for plan in (self.gather, self.approach, self.home))

    @property
    def peaks(self) -> Peaks:
        """Largest speed and acceleration of the whole flight."""
        return Peaks(*np.max([plan.peaks for plan in (self.gather, self.approach, self.home)], axis=0).tolist())


def compile_flight(task: Task, tops_enu_m: Array, stopwatch: Callable[[], float]) -> FlightPlan:
    """Plan and verify a whole flight.

    Args:
        task: formation, target and rules.
        tops_enu_m: the places above the pads where the vehicles are after take-off, shape (V, 3) [m].
        stopwatch: returns seconds; planning reads no clock by itself.

    Raises:
        PlanError: some part of the flight has no plan that keeps the rules.
    """
    slots = len(task.formation.slots_m)
    if len(tops_enu_m) != slots:
        raise PlanError(f"the formation has {slots} slots, but there are {len(tops_enu_m)} vehicles")
    rules = task.rules
    search = FORMULATIONS[task.formulation]
    began = stopwatch()
    path = search(task.formation, task.start, task.target.source, task.hold_depth_m, task.last_scale, rules.fence)
    found = stopwatch()
    into = gather(tops_enu_m, task.formation.place(task.start), rules)
    approach = check([timed(path.swarm_path(into.goal_of), rules.limits)], rules, task.target_enu_m)
    hold = approach.sample(np.array([approach.duration_s])).position_m[0]
    home = plan_home(hold, tops_enu_m, rules)
    rim = np.argsort(into.goal_of)[: len(task.formation.leaders_m)]
    return FlightPlan(
        gather=check(into.pieces, rules, task.target_enu_m),
        approach=approach,
        home=check(home.pieces, rules, task.target_enu_m),
        slot_of=into.goal_of,
        rim_of=rim,
        figures=_figures(task, path.iterates, approach, rim),
        plan_time_s=found - began,
        timing_time_s=stopwatch() - found,
    )


def _figures(task: Task, iterates: int, approach: CheckedPlan, rim: Indices) -> ApproachFigures:
    instants = np.linspace(0.0, approach.duration_s, max(2, int(approach.duration_s * FIGURES_HZ) + 1))
    rims = approach.sample(instants).position_m[:, rim]  # (T, N, 3)
    covered = coverage(rims, task.target_enu_m)
    least = least_after_facing(covered)
    straight_m = np.linalg.norm(task.target_enu_m - task.start.centre_enu_m)
    return ApproachFigures(
        path_length_m=float(np.linalg.norm(np.diff(rims, axis=0), axis=2).sum()),
        straight_length_m=float(len(rim) * straight_m),
        iterates=iterates,
        flux_metric=float(flux_metric(rims[-1:], task.target_enu_m)[0]),
        coverage_mean=float(covered.mean()),
        coverage_min_after_facing=float(covered.min()) if least is None else least,
        last_scale=task.last_scale,
    )


def plan_figures(system_ids: Sequence[int | str], made: FlightPlan) -> dict[str, object]:
    """Return a plan's figures by the names of the command line's JSON; peaks and separation are the whole flight's.

    Args:
        system_ids: of the vehicles, as files hold them, in the order of the plan's rows.
        made: the plan.
    """
    first, second = made.separation.pair
    return {
        "planner": "flux_guided",
        "vehicles": len(made.slot_of),
        "leaders": len(made.rim_of),
        **made.figures._asdict(),
        "plan_time_s": made.plan_time_s,
        "timing_time_s": made.timing_time_s,
        "duration_s": made.approach.duration_s,
        "peak_speed_m_s": made.peaks.speed_m_s,
        "peak_acceleration_m_s2": made.peaks.acceleration_m_s2,
        "min_separation_m": made.separation.distance_m,
        "min_separation_pair": [system_ids[first], system_ids[second]],
    }
