"""Plan a mission without flying it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fg_gcs.errors import PlanError
from fg_gcs.mission.model import Mission
from fg_gcs.plan.compiled import build
from fg_gcs.plan.flight_plan import FlightPlan, Task, compile_flight, plan_figures
from fg_gcs.wire.address import MAIN, VehicleAddress


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

    def draw(self, path: Path) -> None:
        """Draw the plan as a picture: png, svg or pdf, by the file's ending.

        Raises:
            MissionError: the file cannot be written, or its ending is none of these.
        """
        from fg_gcs.record.report.plot import plot_plan

        plot_plan(self.flight, self.task, path)


def plan(mission: Mission) -> PlannedMission:
    """Plan all of a mission's flight, from the pads that it names, and verify it against limits, fence and separation.

    Raises:
        PlanError: there is no such plan; one line that says why, and what would help.
    """
    build({mission.plan.formulation})
    task = mission.task()
    try:
        made = compile_flight(task, mission.tops_enu_m(), time.perf_counter)
    except PlanError as error:
        raise PlanError(f"{mission.path}: {error}") from error
    several = len(mission.networks or {}) > 1
    labels = [VehicleAddress(name if several and name else MAIN, i).label for name, i in mission.swarm.members()]
    return PlannedMission(mission, task, made, {"mission": str(mission.path), **plan_figures(labels, made)})
