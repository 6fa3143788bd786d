"""The autopilots that can be simulated: one package each, with its parameters and how it really flies in TOML files.

A package has a `STRATEGY`: the autopilot's rules, with its profile, and its dialect. A new package here is a new
autopilot; nothing else has to know its name. Every number was measured on the wire of the real SITL autopilots (PX4
1.17-alpha with SIH, ArduCopter 4.7-dev); `docs/autopilots.md` has the records.
"""

from __future__ import annotations

import importlib
import pkgutil
from importlib import resources
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # `names` is for the command line's --help, which shall stay quick
    from sitl_mock.physics.flight_model import FlightModel
    from sitl_mock.protocol.dialect import Strategy


def names() -> tuple[str, ...]:
    """The autopilots that there are, in the order of the alphabet."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(__path__)))


def strategy(name: str) -> Strategy:
    """The strategy of an autopilot.

    Raises:
        ValueError: no autopilot has this name; says which do.
    """
    if name not in names():
        raise ValueError(f"autopilot {name!r} is not one of: {', '.join(names())}")
    found: Strategy = importlib.import_module(f"{__name__}.{name}").STRATEGY
    return found


def flight_model(name: str) -> FlightModel:
    """How the vehicles of an autopilot really fly, for measured dynamics.

    Raises:
        ValueError: no autopilot has this name; says which do.
    """
    from sitl_mock.physics.flight_model import read_flight_model

    if name not in names():
        raise ValueError(f"autopilot {name!r} is not one of: {', '.join(names())}")
    return read_flight_model(resources.files(__name__).joinpath(name, "flight.toml").read_text(encoding="utf-8"))
