"""How fast the simulator's parts are, each alone, for `fg-gcs bench sim`: reads and writes one line of JSON.

echo '{"physics": [9, 250], "telemetry": [9, 250], "seconds": 1.0}' | python -m sitl_mock.host.measure
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from sitl_mock import profiles
from sitl_mock.host.fleet import Fleet, FleetOptions, grid
from sitl_mock.physics.constants import load_physics
from sitl_mock.physics.flight_model import FlightModel
from sitl_mock.physics.reference import ALL, Limits, Reference
from sitl_mock.physics.swarm import Swarm

LIMITS = Limits(10.0, 3.0, 1.5, 5.0, 1.0)
BATCH = 20  # steps between two looks at the clock
BOOT_S = 5.0  # until every stream goes


class Rate(NamedTuple):
    """Physics of V vehicles."""

    dynamics: str  # "paper", or the autopilot whose measured dynamics they have
    vehicles: int
    steps_s: float  # steps of one vehicle, in a second of the processor


class Cost(NamedTuple):
    """Telemetry of V vehicles, from arrays to frames."""

    vehicles: int
    message_us: float


def physics(vehicles: int, dynamics: str, seconds: float) -> Rate:
    """Fly along straight lines in wind, one step a call as the simulator does, and count.

    Args:
        vehicles: how many.
        dynamics: see `Rate`.
        seconds: of the processor; at least so many [s].
    """
    constants = load_physics()
    model: FlightModel | None = None if dynamics == "paper" else profiles.flight_model(dynamics)
    pads = np.array([(north, east, 0.0) for east, north in grid(vehicles)])
    swarm = Swarm(constants, pads, 3.0, np.random.default_rng(0), model)
    for row, (north, east, _) in enumerate(pads.tolist()):
        place, velocity = (north, east, -20.0), (2.0, 1.0, 0.0)
        target = Reference(place, velocity, position_used=ALL, velocity_used=ALL, yaw_rad=0.5, carry_s=1e9)
        swarm.commands.set(row, target, LIMITS, constants.tracking)
    steps, began_s = 0, time.process_time()
    while (taken_s := time.process_time() - began_s) < seconds or not steps:
        for _ in range(BATCH):
            swarm.step()
        steps += BATCH
    return Rate(dynamics, vehicles, steps * vehicles / taken_s)


def telemetry(vehicles: int, seconds: float) -> Cost:
    """Let vehicles stand on the ground and tell all that they tell unasked, and count.

    Args:
        vehicles: how many.
        seconds: of the processor, for telemetry alone; at least so many [s].
    """
    fleet = Fleet(FleetOptions(pads_enu_m=grid(vehicles)))
    tick_s, tick, messages, taken_s = fleet.physics.time.tick_s, 0, 0, 0.0
    while taken_s < seconds or not messages:
        tick += 1
        fleet.advance(tick * tick_s)
        began_s = time.process_time()
        said = fleet.telemetry(tick * tick_s)
        if tick * tick_s > BOOT_S:
            taken_s += time.process_time() - began_s
            messages += len(said)
    return Cost(vehicles, 1e6 * taken_s / messages)


def measured(asked: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """All that is asked for: lists of vehicles by "physics" and "telemetry", and "seconds" for each figure."""
    seconds, kinds = asked["seconds"], ("paper", *profiles.names())
    return {
        "physics": [physics(count, kind, seconds)._asdict() for kind in kinds for count in asked["physics"]],
        "telemetry": [telemetry(count, seconds)._asdict() for count in asked["telemetry"]],
    }


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measured(json.loads(sys.stdin.readline()))) + "\n")
