"""What the autopilot logic reads and writes: MAVLink messages as names and fields, without bytes."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, NamedTuple

Fields = dict[str, Any]  # a MAVLink message's fields by name: numbers, texts, lists, as the dialect has them


class Received(NamedTuple):
    """One good message from outside. Its *values* are still hostile: NaN, infinity, any integer."""

    name: str
    system: int
    component: int
    names: tuple[str, ...]  # of its fields, in the order of the wire
    values: tuple[Any, ...]  # of its fields, likewise

    @property
    def fields(self) -> Fields:
        """Its fields by name."""
        return dict(zip(self.names, self.values, strict=True))


class Outgoing(NamedTuple):
    """One message to send.

    `fields` None: as `telemetry` builds it from the vehicle's state. `link` is the index of the remote, None: all.
    """

    name: str
    fields: Fields | None
    link: int | None = None


class CommandResult(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5
    CANCELLED = 6
    LONG_ONLY = 7
    INT_ONLY = 8
    UNSUPPORTED_FRAME = 9


class Landed(IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class SystemStatus(IntEnum):
    """MAV_STATE, as far as the vehicles use it."""

    UNINIT = 0
    BOOT = 1
    STANDBY = 3
    ACTIVE = 4
    CRITICAL = 5


class Severity(IntEnum):
    """MAV_SEVERITY, as far as the vehicles use it."""

    CRITICAL = 2
    WARNING = 4
    INFO = 6
