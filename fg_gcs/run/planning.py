"""Plan a mission without flying it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fg_gcs.errors import PlanError
from fg_gcs.mission.model import Mission
from fg_gcs.plan.compiled import build
from fg_gcs.plan.flight_plan import FlightPlan, Task, compile_flight


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
    return PlannedMission(mission, task, made, plan_keys(str(mission.path), mission.swarm.ids(), made))


def plan_keys(name: str, system_ids: Sequence[int | str], made: FlightPlan) -> dict[str, object]:
    """Return a plan's figures by the names of the command line's JSON; peaks and separation are the whole flight's."""
    first, second = made.separation.pair
    return {
        "mission": name,
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
