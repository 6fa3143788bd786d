"""The program as a library: plan, fly and report a mission without printing, signals or process-wide state.

What is public is exported here and listed with types and units in ``docs/api.md``; everything else may move. Names are
imported when they are first asked for, so that importing it costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fg_gcs.errors import FgError, LinkError, MissionError, PlanError, VehicleError
    from fg_gcs.flight.sightings.own_source import OwnSightings
    from fg_gcs.flight.snapshot import RunEvent, Snapshot
    from fg_gcs.link.clock import make_loop
    from fg_gcs.mission import Mission, load_mission, parse_mission
    from fg_gcs.run.flying import FlyOptions, Outcome, RunResult, fly, fly_blocking
    from fg_gcs.run.observing import Observer
    from fg_gcs.run.planning import PlannedMission, plan
    from fg_gcs.run.reporting import report
    from fg_gcs.scenario.motions import TrueMotion
    from fg_gcs.sitl.instances import SwarmOptions

_HOMES = {
    "FgError": "fg_gcs.errors",
    "FlyOptions": "fg_gcs.run.flying",
    "LinkError": "fg_gcs.errors",
    "Mission": "fg_gcs.mission",
    "MissionError": "fg_gcs.errors",
    "Observer": "fg_gcs.run.observing",
    "Outcome": "fg_gcs.run.flying",
    "OwnSightings": "fg_gcs.flight.sightings.own_source",
    "PlanError": "fg_gcs.errors",
    "PlannedMission": "fg_gcs.run.planning",
    "RunEvent": "fg_gcs.flight.snapshot",
    "RunResult": "fg_gcs.run.flying",
    "Snapshot": "fg_gcs.flight.snapshot",
    "SwarmOptions": "fg_gcs.sitl.instances",
    "TrueMotion": "fg_gcs.scenario.motions",
    "VehicleError": "fg_gcs.errors",
    "fly": "fg_gcs.run.flying",
    "fly_blocking": "fg_gcs.run.flying",
    "load_mission": "fg_gcs.mission",
    "make_loop": "fg_gcs.link.clock",
    "parse_mission": "fg_gcs.mission",
    "plan": "fg_gcs.run.planning",
    "report": "fg_gcs.run.reporting",
}

__all__ = [
    "FgError",
    "FlyOptions",
    "LinkError",
    "Mission",
    "MissionError",
    "Observer",
    "Outcome",
    "OwnSightings",
    "PlanError",
    "PlannedMission",
    "RunEvent",
    "RunResult",
    "Snapshot",
    "SwarmOptions",
    "TrueMotion",
    "VehicleError",
    "fly",
    "fly_blocking",
    "load_mission",
    "make_loop",
    "parse_mission",
    "plan",
    "report",
]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - whatever the name stands for
    """Import a public name when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
