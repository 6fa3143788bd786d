"""A particle simulator of MAVLink vehicles that answers as PX4 and ArduPilot SITL do; imports nothing from fg_gcs.

In process, on any asyncio event loop::

    from sitl_mock import Simulator, SimulatorOptions, grid

    async with Simulator(SimulatorOptions(pads_enu_m=grid(10))) as simulator:
        ...

As a process: `python -m sitl_mock`. Without sockets or a clock, for tests: `sitl_mock.host.fleet.Fleet`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sitl_mock.faults.schema import FaultOptions, ImpairmentOptions, parse_fault, parse_impairment
    from sitl_mock.host.fleet import grid
    from sitl_mock.host.server import Counters, PortUnavailable, Simulator, SimulatorOptions
    from sitl_mock.host.targets import TargetOptions, parse_target
    from sitl_mock.protocol.signing import read_key

__all__ = [
    "Counters",
    "FaultOptions",
    "ImpairmentOptions",
    "PortUnavailable",
    "Simulator",
    "SimulatorOptions",
    "TargetOptions",
    "grid",
    "parse_fault",
    "parse_impairment",
    "parse_target",
    "read_key",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first used, so that `python -m sitl_mock --help` stays quick."""
    for module in ("faults.schema", "host.fleet", "host.server", "host.targets", "protocol.signing"):
        if name in __all__ and hasattr(found := importlib.import_module(f"sitl_mock.{module}"), name):
            return getattr(found, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
