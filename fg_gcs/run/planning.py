"""Plan a mission without flying it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np

from fg_gcs.errors import PlanError
from fg_gcs.flight.lost_links import expected_rule
from fg_gcs.flight.wander import usual
from fg_gcs.mission.model import Mission
from fg_gcs.plan.compiled import build
from fg_gcs.plan.flight_plan import FlightPlan, Task, compile_flight, fault_words, least_wide, plan_figures
from fg_gcs.plan.wander import Wander
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.autopilots import ARDUPILOT, PX4

PROFILES: Final = MappingProxyType({"px4": PX4, "ardupilot": ARDUPILOT})


@dataclass(frozen=True)
class PlannedMission:
    """A mission with its verified plans.

    Attributes:
        mission: what was planned.
        task: the mission in the planner's words: formation, start, target, limits, separation, fence.
        flight: gather, approach and home; sample them for places, speeds and accelerations.
        figures: by the names of the command line's JSON.
    """

    mission: Mission
    task: Task
    flight: FlightPlan
    figures: Mapping[str, object]

    @property
    def labels(self) -> list[str | int]:
        """What the vehicles are called, in the order of the plan's rows."""
        several = len(self.mission.networks or {}) > 1
        members = self.mission.swarm.members()
        return [VehicleAddress(name if several and name else MAIN, number).label for name, number in members]

    @property
    def in_fault(self) -> list[str]:
        """How near vehicles come when one stops hearing us, or falls, in lines for people."""
        return fault_words(self.labels, self.flight)

    def draw(self, path: Path) -> None:
        """Draw the plan as a picture: png, svg or pdf, by the file's ending.

        Raises:
            MissionError: the file cannot be written, or its ending is none of these.
        """
        from fg_gcs.record.report.plot import plot_plan

        plot_plan(self.flight, self.task, path)


def plan(mission: Mission, wander_m: float | str | None = None, lag_s: float = 0.0) -> PlannedMission:
    """Plan all of a mission's flight, from the pads that it names, and verify it against limits, fence and separation.

    Args:
        mission: what to plan.
        wander_m: how far vehicles hover off their places, rms, as seen from above [m], or the name of an autopilot of
            which they do as real ones; None: as the mission has it.
        lag_s: by how much they lag behind differently, standard deviation [s].

    Raises:
        PlanError: there is no such plan; one line that says why, and what would help.
    """
    build({mission.plan.formulation})
    profile = PROFILES[mission.simulator.autopilot]
    wander = _wander(mission, wander_m, lag_s)
    task = replace(mission.task(), lost_link=expected_rule(mission, profile), wander=wander)
    tops_enu_m = mission.tops_enu_m()
    try:
        made = compile_flight(task, tops_enu_m, time.perf_counter)
    except PlanError as error:
        raise PlanError(f"{mission.path}: {error}") from error
    planned = PlannedMission(mission, made.task, made, {})
    figures = {"mission": str(mission.path), **plan_figures(planned.labels, made)}
    if wander is not None and made.risk is not None:
        least = least_wide(made.task, tops_enu_m)
        figures |= {
            "wander_m": wander.level_m,
            "wander_breaches": made.risk.breaches,
            "edge_m": made.task.edge_m,
            "smallest_edge_m": least and least * made.task.edge_m,
        }
    return replace(planned, figures=figures)


def _wander(mission: Mission, wander_m: float | str | None, lag_s: float) -> Wander | None:
    """Return how far a mission's vehicles will wander; None: not at all."""
    profile = PROFILES[wander_m if isinstance(wander_m, str) else mission.simulator.autopilot]
    simulator = mission.simulator
    if isinstance(wander_m, str):
        level_m = None
    elif wander_m is not None:
        level_m = wander_m
    elif mission.limits.wander_m is not None:
        level_m = mission.limits.wander_m
    else:
        level_m = simulator.noise_m if simulator.dynamics == "measured" else 0.0
    if level_m == 0.0 and lag_s == 0.0:
        return None
    return Wander(np.tile(usual(profile, level_m), (mission.swarm.vehicles, 1)), mission.hold.duration_s, lag_s)
