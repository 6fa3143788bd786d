"""The phases of a flight as one table: what each event leads to; an event that is not listed changes nothing."""

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import Final


class Phase(Enum):
    """Where a vehicle is in its flight, as its telemetry tells."""

    DISCOVERED = "heard, not ready to arm"
    READY = "ready to arm"
    ARMED = "armed on the ground"
    FLYING = "in the air, flown by us"
    LANDING = "in the air, landing as we told it"
    LANDED = "disarmed after a flight"
    TAKEN = "taken over: something else changed its mode"
    LOST = "lost: nothing is heard from it"


class PhaseEvent(Enum):
    """What a vehicle's telemetry, or its silence, says."""

    HEARD = "its heartbeat came"
    SILENT = "nothing came for too long"
    CHECKS_PASSED = "disarmed, its pre-arm checks are good"
    CHECKS_FAILED = "disarmed, its pre-arm checks are not good"
    ARMED = "its motors are armed"
    DISARMED = "its motors are not armed"
    AIRBORNE = "its landed state says that it is off the ground"
    LANDING_BEGAN = "it is in its land mode, and only we can have put it there"
    TAKEN_OVER = "it is in a mode that we did not command"
    GIVEN_BACK = "it follows us again after a failsafe of its own, as nothing was sent meanwhile"


TRANSITIONS: Final[Mapping[tuple[Phase, PhaseEvent], Phase]] = MappingProxyType(
    {
        (Phase.DISCOVERED, PhaseEvent.CHECKS_PASSED): Phase.READY,
        (Phase.DISCOVERED, PhaseEvent.ARMED): Phase.ARMED,
        (Phase.DISCOVERED, PhaseEvent.SILENT): Phase.LOST,
        (Phase.READY, PhaseEvent.CHECKS_FAILED): Phase.DISCOVERED,
        (Phase.READY, PhaseEvent.ARMED): Phase.ARMED,
        (Phase.READY, PhaseEvent.SILENT): Phase.LOST,
        (Phase.ARMED, PhaseEvent.DISARMED): Phase.DISCOVERED,  # idle too long: both autopilots disarm after 10 s
        (Phase.ARMED, PhaseEvent.AIRBORNE): Phase.FLYING,
        (Phase.ARMED, PhaseEvent.TAKEN_OVER): Phase.TAKEN,
        (Phase.ARMED, PhaseEvent.SILENT): Phase.LOST,
        (Phase.FLYING, PhaseEvent.LANDING_BEGAN): Phase.LANDING,
        (Phase.FLYING, PhaseEvent.DISARMED): Phase.LANDED,  # landed by setpoints, or worse
        (Phase.FLYING, PhaseEvent.TAKEN_OVER): Phase.TAKEN,
        (Phase.FLYING, PhaseEvent.SILENT): Phase.LOST,
        (Phase.LANDING, PhaseEvent.DISARMED): Phase.LANDED,
        (Phase.LANDING, PhaseEvent.TAKEN_OVER): Phase.TAKEN,
        (Phase.LANDING, PhaseEvent.SILENT): Phase.LOST,
        (Phase.LANDED, PhaseEvent.ARMED): Phase.ARMED,  # the next flight
        (Phase.LANDED, PhaseEvent.SILENT): Phase.LOST,
        # Sticky: a mode that comes back by itself is not given back to us, unless we are to blame
        (Phase.TAKEN, PhaseEvent.GIVEN_BACK): Phase.FLYING,
        (Phase.TAKEN, PhaseEvent.DISARMED): Phase.LANDED,
        (Phase.TAKEN, PhaseEvent.SILENT): Phase.LOST,
        (Phase.LOST, PhaseEvent.HEARD): Phase.DISCOVERED,  # the telemetry that follows tells the rest
    }
)


def following(phase: Phase, event: PhaseEvent) -> Phase:
    """Return the phase after ``event``."""
    return TRANSITIONS.get((phase, event), phase)
