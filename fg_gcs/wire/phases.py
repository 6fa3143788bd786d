"""The phases of a flight as one table: what each event leads to; an event that is not listed changes nothing."""

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import Final


class Phase(Enum):
    """Where a vehicle is in its flight, as its telemetry tells."""

    DISCOVERED = "heard, cannot arm yet"
    READY = "can arm"
    ARMED = "armed on the ground"
    FLYING = "in the air, flown by us"
    LANDING = "in the air, landing as we told it"
    LANDED = "disarmed after a flight"
    TAKEN = "somebody or something else changed its mode: hands off"
    LOST = "not heard from"


class Event(Enum):
    """What a vehicle's telemetry, or its silence, says."""

    HEARD = "its heartbeat came"
    SILENT = "nothing came for too long"
    CHECKS_PASSED = "disarmed, its pre-arm checks are good"
    CHECKS_FAILED = "disarmed, its pre-arm checks are not good"
    ARMED = "its motors are armed"
    DISARMED = "its motors are not armed"
    AIRBORNE = "its landed state says that it is off the ground"
    LANDING_BEGAN = "it is in its land mode and nobody but us put it there"
    TAKEN_OVER = "it is in a mode that we did not command"


TRANSITIONS: Final[Mapping[tuple[Phase, Event], Phase]] = MappingProxyType(
    {
        (Phase.DISCOVERED, Event.CHECKS_PASSED): Phase.READY,
        (Phase.DISCOVERED, Event.ARMED): Phase.ARMED,
        (Phase.DISCOVERED, Event.SILENT): Phase.LOST,
        (Phase.READY, Event.CHECKS_FAILED): Phase.DISCOVERED,
        (Phase.READY, Event.ARMED): Phase.ARMED,
        (Phase.READY, Event.SILENT): Phase.LOST,
        (Phase.ARMED, Event.DISARMED): Phase.DISCOVERED,  # idle too long: both autopilots disarm after 10 s
        (Phase.ARMED, Event.AIRBORNE): Phase.FLYING,
        (Phase.ARMED, Event.TAKEN_OVER): Phase.TAKEN,
        (Phase.ARMED, Event.SILENT): Phase.LOST,
        (Phase.FLYING, Event.LANDING_BEGAN): Phase.LANDING,
        (Phase.FLYING, Event.DISARMED): Phase.LANDED,  # landed by setpoints, or worse
        (Phase.FLYING, Event.TAKEN_OVER): Phase.TAKEN,
        (Phase.FLYING, Event.SILENT): Phase.LOST,
        (Phase.LANDING, Event.DISARMED): Phase.LANDED,
        (Phase.LANDING, Event.TAKEN_OVER): Phase.TAKEN,
        (Phase.LANDING, Event.SILENT): Phase.LOST,
        (Phase.LANDED, Event.ARMED): Phase.ARMED,  # the next flight
        (Phase.LANDED, Event.SILENT): Phase.LOST,
        (Phase.TAKEN, Event.DISARMED): Phase.LANDED,  # sticky: a mode that comes back by itself is not given back to us
        (Phase.TAKEN, Event.SILENT): Phase.LOST,
        (Phase.LOST, Event.HEARD): Phase.DISCOVERED,  # the telemetry that follows tells the rest
    }
)


def following(phase: Phase, event: Event) -> Phase:
    """Return the phase after ``event``."""
    return TRANSITIONS.get((phase, event), phase)
