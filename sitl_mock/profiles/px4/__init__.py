"""PX4 1.17 as its SITL answers and flies: numbers, rules, dialect."""

from sitl_mock.profiles.px4.dialect import STRATEGY
from sitl_mock.profiles.px4.profile import PROFILE
from sitl_mock.profiles.px4.rules import Px4Rules

__all__ = ["PROFILE", "STRATEGY", "Px4Rules"]
