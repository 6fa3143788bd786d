"""The summary of a run: its figures by the names of the command line's JSON."""

from __future__ import annotations

import numpy as np

from fg_gcs.flight.director import FlightResult
from fg_gcs.mission.model import Mission
from fg_gcs.record.evaluate.evaluation import evaluate, evaluate_tracking
from fg_gcs.record.evaluate.tracking import KEYS, Followed
from fg_gcs.record.write.recorder import REPORT, Recorder, plain
from fg_gcs.run.planning import plan_keys


def summary_of(mission: Mission, result: FlightResult, recorder: Recorder, reason: str) -> dict[str, object]:
    """Return a run's figures by the names of the command line's JSON.

    Args:
        mission: what was flown.
        result: what the flight knows of itself.
        recorder: what was written down.
        reason: why the run was not completed, empty if it was.
    """
    summary: dict[str, object] = {"mission": str(mission.path)}
    if result.plan is not None:
        summary |= plan_keys(str(mission.path), [vehicle.label for vehicle in result.vehicles], result.plan)
    leaders = [] if result.plan is None else [result.vehicles[row].system_id for row in result.plan.rim_of]
    limits = None if result.task is None else result.task.rules.limits
    counters = result.counters
    summary |= {"completed": result.completed, "reason": reason, "vehicles_landed": result.vehicles_landed}
    target_enu_m = mission.first_target().centre_enu_m.tolist()
    summary |= evaluate(recorder, result.stages, leaders, target_enu_m)
    summary |= _tracking_keys(mission, result, recorder, leaders)
    summary |= {
        "late_ticks": result.late_ticks,
        "lost_vehicles": [vehicle.label for vehicle in result.lost],
        "vehicles_not_down": [vehicle.label for vehicle in result.not_down],
        "recording_complete": True,
        "bad_bytes": counters.bad_bytes if counters else 0,
        "unknown_messages": counters.unknown_messages if counters else 0,
        "frames_in": counters.frames_in if counters else 0,
        "frames_out": counters.frames_out if counters else 0,
        "limits": None if limits is None else vars(limits),
        "separation_m": mission.limits.separation_m,
        "target_enu_m": target_enu_m,
        "leader_ids": leaders,
        "stages": {name: list(span) for name, span in result.stages.items()},
        "log": str(recorder.folder),
        "report": str(recorder.folder / REPORT),
    }
    plained = plain(summary)
    assert isinstance(plained, dict)
    return plained


def _tracking_keys(mission: Mission, result: FlightResult, recorder: Recorder, leaders: list[int]) -> dict[str, object]:
    """The figures of the tracking; those of a target at rest are 0 or none."""
    keys: dict[str, object] = {"replans": 0, "replans_late": 0, "replan_median_ms": None, "replan_p99_ms": None}
    keys |= dict.fromkeys(KEYS) | {"found_again_s": [], "sightings": 0, "sightings_rejected": {}}
    tracking, task = result.tracking, result.task
    if tracking is None or task is None:
        return keys
    caught_s = None if tracking.caught_s is None else recorder.since_start_s(tracking.caught_s)
    followed = Followed(
        recorder.since_start_s(tracking.began_s),
        recorder.since_start_s(tracking.ended_s),
        caught_s,
        tuple(target.weight for target in mission.targets or ()),
        task.formation.leaders_m,
        task.hold_depth_m,
        mission.track.capture_m,
        mission.track.lost_after_s,
    )
    keys |= evaluate_tracking(recorder, result.stages, leaders, followed, task.rules.limits.acceleration_m_s2)
    if tracking.planning_s:
        took_ms = [1e3 * took for took in tracking.planning_s]
        keys |= {"replan_median_ms": np.median(took_ms), "replan_p99_ms": np.percentile(took_ms, 99)}
    rejected = {verdict.name.lower(): count for verdict, count in tracking.refused.items()}
    return keys | {
        "replans_late": tracking.late,
        "sightings": tracking.sightings,
        "sightings_rejected": rejected,
    }
