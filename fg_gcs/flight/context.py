"""What all parts of one flight share."""

from __future__ import annotations

from dataclasses import dataclass

from fg_gcs.core.arrays import Array
from fg_gcs.flight.custody import Custody
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.journal import Journal
from fg_gcs.flight.streamer import Streamer
from fg_gcs.mission.model import Mission
from fg_gcs.plan.flight_plan import Task


@dataclass(frozen=True)
class Context:
    """A fleet that is ready to fly a mission, and what is needed for it."""

    fleet: Fleet
    mission: Mission
    task: Task  # the mission under the limits that the vehicles really have
    tops_enu_m: Array  # (V, 3) the places above the pads [m]
    streamer: Streamer
    custody: Custody
    journal: Journal
