"""Exit codes of all commands."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """How a command ended."""

    DONE = 0
    ABORTED = 1  # the flight ended safely, but not as planned; or somebody stopped the command
    BAD_INPUT = 2
    NO_ANSWER = 3
    INTERNAL_ERROR = 4
    NOT_IN_ORDER = 5  # it ended, but the record is incomplete, or a vehicle is not known to be down
