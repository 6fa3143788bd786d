"""What is planned for vehicles that stop hearing us: as their autopilots behave, and as soon as the others notice."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from fg_gcs.flight.fleet import STEP_S, Fleet
from fg_gcs.flight.safety import OUTAGE_S, SPARE_S, delay_of, unanswered_s
from fg_gcs.flight.watch import WATCH_S
from fg_gcs.mission.model import Mission
from fg_gcs.plan.lost_link import LostLink, LostLinkRule, Reaction
from fg_gcs.wire.autopilots import AutopilotProfile

LEFT_S: Final = 0.6  # until a way home is planned, and all have left on it


def expected_rule(mission: Mission, profile: AutopilotProfile) -> LostLinkRule:
    """Return the rule for vehicles that are not there yet, on links without delay.

    Args:
        mission: what is flown.
        profile: the vehicles' autopilot.
    """
    return _rule(mission, [profile], [profile.lost_link], mission.faults.silent_s, 0.0)


def rule_of(mission: Mission, fleet: Fleet) -> LostLinkRule:
    """Return the rule for a fleet, by its vehicles' own time-outs and the delays of their links.

    Args:
        mission: what is flown.
        fleet: its vehicles, their parameters read and set.
    """
    silent_s = mission.faults.silent_s
    noticed_s = max(unanswered_s(vehicle, silent_s, len(fleet.vehicles)) for vehicle in fleet.vehicles)
    delay_s = max(map(delay_of, fleet.vehicles))
    behaviours = (v.profile.lost_link._replace(timeout_s=v.stream_timeout_s) for v in fleet.vehicles)
    profiles = [vehicle.profile for vehicle in fleet.vehicles]
    return _rule(mission, profiles, sorted(set(behaviours)), noticed_s, delay_s)


def _rule(
    mission: Mission,
    profiles: Iterable[AutopilotProfile],
    behaviours: Iterable[LostLink],
    noticed_s: float,
    delay_s: float,
) -> LostLinkRule:
    """Return the rule for what is noticed so late [s] on links with such a delay of one way [s]."""
    known = tuple(behaviours)
    waits_s = max(OUTAGE_S, *(behaviour.timeout_s + SPARE_S for behaviour in known))
    late_s = noticed_s - mission.faults.silent_s
    reaction = Reaction(noticed_s + WATCH_S + STEP_S, waits_s + late_s + delay_s, LEFT_S)
    limits = mission.limits
    shorter_s = sorted({timeout_s for profile in profiles for timeout_s in profile.shorter_timeouts_s}, reverse=True)
    return LostLinkRule(limits.fault_least_m, limits.fault_remedy, known, reaction, tuple(shorter_s))
