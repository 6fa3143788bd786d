"""The summary of a run: its figures by the names of the command line's JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from fg_gcs.flight.director import FlightResult
from fg_gcs.link.counters import Counters
from fg_gcs.mission.model import Mission
from fg_gcs.plan.flight_plan import plan_figures
from fg_gcs.record.evaluate.evaluation import flown_figures
from fg_gcs.record.write.recorder import REPORT, Recorder, plain

TRUE_KEYS: Final = ("collisions", "ground_strikes", "true_min_separation_m", "true_min_separation_pair")


class Truth(NamedTuple):
    """What the simulator knows of its vehicles, and no telemetry says.

    Attributes:
        figures: by the names of the command line's JSON; None where vehicles are real.
        told: a line for each incident.
    """

    figures: dict[str, object]
    told: tuple[str, ...]


def read_truth(path: Path) -> Truth:
    """Read what a simulator wrote down at its end; nothing is known where there is no such file."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        incidents, closest = list(found["incidents"]), found["closest"]
        figures: dict[str, object] = {
            "collisions": [each for each in incidents if each["kind"] == "collision"],
            "ground_strikes": [each for each in incidents if each["kind"] == "ground_strike"],
            "true_min_separation_m": None if closest is None else closest["distance_m"],
            "true_min_separation_pair": None if closest is None else closest["vehicles"],
        }
        return Truth(figures, tuple(str(each["text"]) for each in incidents))
    except (OSError, ValueError, KeyError, TypeError):
        return Truth(dict.fromkeys(TRUE_KEYS), ())


def summary_of(mission: Mission, result: FlightResult, recorder: Recorder, reason: str) -> dict[str, object]:
    """Return a run's figures by the names of the command line's JSON; what was flown is read from its tables.

    Args:
        mission: what was flown.
        result: what the flight knows of itself.
        recorder: what was written down.
        reason: why the run was not completed, empty if it was.
    """
    summary: dict[str, object] = {"mission": str(mission.path)}
    labels = [vehicle.label for vehicle in result.vehicles]
    if result.plan is not None:
        summary |= plan_figures(labels, result.plan)
    limits = None if result.task is None else result.task.rules.limits
    counters = result.counters or Counters.none()
    summary |= {"completed": result.completed, "reason": reason, "vehicles_landed": result.vehicles_landed}
    target_enu_m = mission.first_target().centre_enu_m.tolist()
    recorder.know(target_enu_m=target_enu_m, stages=result.stages)
    recorder.settle()
    summary |= flown_figures(recorder.folder)
    summary |= _tracking_keys(result, recorder)
    summary |= {
        "late_ticks": result.late_ticks,
        "gate": {} if result.gate is None else result.gate._asdict(),
        "lost": [vehicle.label for vehicle in result.lost],
        "tasks_died": list(result.died),
        "vehicles_not_down": [vehicle.label for vehicle in result.not_down],
        **counters._asdict(),
        "limits": None if limits is None else vars(limits),
        "separation_m": mission.limits.separation_m,
        "target_enu_m": target_enu_m,
        "leader_ids": [] if result.plan is None else [labels[row] for row in result.plan.rim_of],
        "stages": {name: list(span) for name, span in result.stages.items()},
        "log": str(recorder.folder),
        "report": str(recorder.folder / REPORT),
    }
    plained = plain(summary)
    assert isinstance(plained, dict)
    return plained


def _tracking_keys(result: FlightResult, recorder: Recorder) -> dict[str, object]:
    """What is known of the tracking without its tables; of a target at rest it is 0 or none."""
    keys: dict[str, object] = {"replans": 0, "replans_late": 0, "replan_median_ms": None, "replan_p99_ms": None}
    keys |= {"capture_time_s": None, "sightings": 0, "sightings_rejected": {}}
    tracking = result.tracking
    if tracking is None:
        return keys
    if tracking.planning_s:
        took_ms = [1e3 * took for took in tracking.planning_s]
        keys |= {"replan_median_ms": np.median(took_ms), "replan_p99_ms": np.percentile(took_ms, 99)}
    if tracking.caught_s is not None:
        began_s, caught_s = (recorder.since_start_s(time_s) for time_s in (tracking.began_s, tracking.caught_s))
        keys["capture_time_s"] = caught_s - began_s
    rejected = {verdict.name.lower(): count for verdict, count in tracking.refused.items()}
    return keys | {
        "replans": tracking.planned,
        "replans_late": tracking.late,
        "sightings": tracking.sightings,
        "sightings_rejected": rejected,
    }
