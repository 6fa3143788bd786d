"""Makes the run's snapshots right after setpoints have left, and hands them to whoever wants them."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from fg_gcs.core.frames import rotate_ned_enu
from fg_gcs.flight.journal import STAGES
from fg_gcs.flight.snapshot import (
    CounterSnapshot,
    FormationSnapshot,
    RunEvent,
    Snapshot,
    TargetSnapshot,
    TrackingSnapshot,
    VehicleSnapshot,
    known,
    vector,
)
from fg_gcs.flight.target_follower import said
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.vehicle import Vehicle

if TYPE_CHECKING:
    from fg_gcs.flight.director import Director

MOST_HZ: Final = 25.0  # a picture shows no more; each costs some tenths of a millisecond that the streamer shares
MOST_EVENTS: Final = 1000  # kept for the next snapshot; more in a twenty-fifth of a second are a flood
ROUNDING_S: Final = 1e-6  # of a time: half a period of the stream is not to be lost to it
TINY_M2: Final = 1e-12  # of vehicles that stand in a line: a face without an area has no normal
ALARMING: Final = frozenset({Phase.LOST, Phase.TAKEN})


class Readers(Protocol):
    """Where snapshots go."""

    def wanted(self) -> bool:
        """Tell whether anything reads them now: if not, none is made."""

    def take(self, snapshot: Snapshot) -> None:
        """Hand one out; must not raise, and must not wait."""


class SnapshotMaker:
    """Makes snapshots of one flight whenever the flight says that it is a good moment.

    It has no timer of its own: an observed flight is the same flight.

    Attributes:
        enough: no more are made: making one has failed.
    """

    def __init__(self, director: Director, readers: Readers, rate_hz: float) -> None:
        """Make at most ``rate_hz`` snapshots a second, and never more than `MOST_HZ` [Hz]."""
        self.enough = False
        self._director = director
        self._readers = readers
        self._period_s = 1.0 / min(rate_hz, MOST_HZ)
        self._due_s = -math.inf
        self._events: deque[RunEvent] = deque(maxlen=MOST_EVENTS)
        self._number = 0

    def event(self, event: RunEvent) -> None:
        """Keep an event for the next snapshot."""
        self._events.append(event)

    def good_moment(self, now_s: float) -> None:
        """Make a snapshot if one is due and wanted; never raises.

        Args:
            now_s: reading of the loop's clock [s]; setpoints have just left, or none are streamed.
        """
        if self.enough or now_s < self._due_s - ROUNDING_S:
            return
        if not self._readers.wanted():
            self._events.clear()
            return
        self._due_s = max(self._due_s + self._period_s, now_s)  # a late one is not made up for
        try:
            self._readers.take(self.snapshot(now_s))
        except Exception as error:  # a bug of ours, which must not end the flight
            self.enough = True
            self._director.journal.event("warning", f"no more snapshots: {error!r}")

    def snapshot(self, now_s: float) -> Snapshot:
        """Return the run as it is at a reading of the loop's clock [s]; the events are handed out with it."""
        director, journal = self._director, self._director.journal
        since_start_s = journal.recorder.since_start_s
        fleet = director.fleet
        made = Snapshot(
            number=self._number,
            time_s=since_start_s(now_s),
            mission=director.mission.description,
            stage=journal.stage,
            stages=STAGES,
            stage_begins_s=since_start_s(journal.stage_begins_s),
            stage_ends_s=None if journal.stage_ends_s is None else since_start_s(journal.stage_ends_s),
            networks=len(director.networks),
            vehicles=() if fleet is None else self._vehicles(now_s),
            formation=self._formation(),
            target=self._target(now_s),
            tracking=self._tracking(),
            tracks=director.mission.targets is not None,
            counters=self._counters(),
            events=tuple(self._events),
        )
        self._number += 1
        self._events.clear()
        return made

    def _vehicles(self, now_s: float) -> tuple[VehicleSnapshot, ...]:
        director = self._director
        fleet, plan = director.fleet, director.result.plan
        assert fleet is not None, "asked only when there is one"
        wanted = director.wanted_enu_m(now_s).tolist()
        leaders = frozenset() if plan is None else frozenset(plan.rim_of)
        ages_s = fleet.states.ages_s(now_s).tolist()
        return tuple(
            self._vehicle(vehicle, now_s, ages_s[row], row in leaders, vector(wanted[row]))
            for row, vehicle in enumerate(fleet.vehicles)
        )

    def _vehicle(
        self,
        vehicle: Vehicle,
        now_s: float,
        age_s: float,
        leader: bool,
        setpoint_enu_m: tuple[float, float, float] | None,
    ) -> VehicleSnapshot:
        fleet, velocity, link = self._director.fleet, vehicle.velocity_ned_m_s, vehicle.timing.quality
        assert fleet is not None, "asked only when there is one"
        speed_m_s = None if velocity is None else sum(part * part for part in velocity) ** 0.5
        return VehicleSnapshot(
            network=vehicle.address.network,
            system_id=vehicle.address.system_id,
            leader=leader,
            phase=vehicle.phase.name.lower(),
            alarming=vehicle.phase in ALARMING,
            mode=vehicle.mode_name,
            armed=vehicle.armed,
            heard_s_ago=max(now_s - vehicle.heard_at_s, 0.0),
            position_enu_m=vector(fleet.position_enu_m(vehicle)),
            velocity_enu_m_s=None if velocity is None else vector(rotate_ned_enu(velocity)),
            setpoint_enu_m=setpoint_enu_m,
            yaw_rad=known(vehicle.yaw_rad),
            height_m=known(vehicle.height_m),
            speed_m_s=known(speed_m_s),
            battery=known(vehicle.battery.remaining),
            voltage_v=known(vehicle.battery.voltage_v),
            position_age_s=known(age_s),
            loss_in=known(link.loss_in),
            loss_out=known(link.loss_out),
            delay_s=known(link.delay_s),
        )

    def _formation(self) -> FormationSnapshot | None:
        plan, fleet = self._director.result.plan, self._director.fleet
        if plan is None or fleet is None:
            return None
        places = [fleet.position_enu_m(fleet.vehicles[row]) for row in plan.rim_of]
        rim = np.array([place for place in places if place is not None])
        if len(rim) < len(places):
            return None
        twice_area = np.cross(rim, np.roll(rim, -1, axis=0)).sum(
            axis=0
        )  # along the normal, whatever the polygon's shape
        centre, normal = vector(rim.mean(axis=0)), vector(twice_area / max(float(np.linalg.norm(twice_area)), TINY_M2))
        return (
            None
            if centre is None or normal is None
            else FormationSnapshot(tuple(map(int, plan.rim_of)), centre, normal)
        )

    def _target(self, now_s: float) -> TargetSnapshot | None:
        follower = self._director.target_follower
        if self._director.mission.targets is None:
            centre = self._director.mission.first_target()
            place = vector(centre.centre_enu_m.tolist())
            return (
                None if place is None else TargetSnapshot(place, (0.0, 0.0, 0.0), centre.radius_m, 0.0, (), (), False)
            )
        status = None if follower is None else follower.status
        estimate = None if status is None else status.known
        if estimate is None:
            return None
        place, velocity = vector(estimate.position_enu_m.tolist()), vector(estimate.velocity_m_s.tolist())
        if place is None or velocity is None:
            return None
        return TargetSnapshot(
            place,
            velocity,
            known(estimate.radius_m) or 0.0,
            estimate.age_s,
            estimate.lost,
            estimate.unseen,
            estimate.bounded,
        )

    def _tracking(self) -> TrackingSnapshot | None:
        follower = self._director.target_follower
        status = None if follower is None else follower.status
        if status is None:
            return None
        refused = sorted(status.refused.items(), key=lambda item: -item[1])
        return TrackingSnapshot(
            mode=status.mode.value,
            targets=status.targets,
            error_m=known(status.error_m),
            growth=status.growth,
            rests=status.rests,
            caught=status.caught,
            patience_s=status.patience_s,
            sightings=status.sightings,
            refused=tuple((said(verdict), count) for verdict, count in refused),
            latency_s=known(status.latency_s),
        )

    def _counters(self) -> CounterSnapshot:
        streamer, counters = self._director.streamer, self._director.counters
        late, gated = (0, 0) if streamer is None else (streamer.late_ticks, streamer.gate.counts.total)
        return CounterSnapshot(**counters._asdict(), late_ticks=late, gated=gated)
