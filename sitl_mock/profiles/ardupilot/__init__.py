"""ArduCopter 4.7 as its SITL answers and flies: numbers, rules, dialect."""

from sitl_mock.profiles.ardupilot.dialect import STRATEGY
from sitl_mock.profiles.ardupilot.profile import PROFILE
from sitl_mock.profiles.ardupilot.rules import ArduPilotRules

__all__ = ["PROFILE", "STRATEGY", "ArduPilotRules"]
