"""Streams of setpoints as the records of the real autopilots used them, flown by the physics alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from sitl_mock import profiles
from sitl_mock.physics.arrays import Array
from sitl_mock.physics.constants import load_physics
from sitl_mock.physics.flight_model import FlightModel
from sitl_mock.physics.reference import ALL, NONE, ZERO, Limits, Reference
from sitl_mock.physics.swarm import Swarm

PHYSICS = load_physics()
LIMITS = MappingProxyType(  # the autopilots' defaults
    {
        "px4": Limits(12.0, 3.0, 1.5, 3.0, 0.95),
        "ardupilot": Limits(10.0, 2.5, 1.5, 2.5, 1.0),
    }
)
CARRIES = MappingProxyType({"px4": (0.1, False), "ardupilot": (3.0, True)})  # carry [s], lapses
LATENCY_S = 0.01  # of a setpoint on its way
SETTLING_S = 8.0  # hover before the motion begins
CRUISE_S, LINE_END_S = 8.0, 15.0

Motion = Callable[[float], tuple[Array, Array, Array]]  # time [s] -> position, velocity, acceleration (3,) NED


def quiet(model: FlightModel) -> FlightModel:
    """The nominal vehicle, whose estimate is the truth."""
    still = {"wander_sigma_m": (0.0,) * 3, "wander_sigma_m_s": (0.0,) * 3}
    return replace(model, spread={}, values=dict(model.values) | still)


def quiet_swarm(autopilot: str, pads_ned_m: Array, wind_m_s: float = 0.0) -> Swarm:
    """Nominal vehicles that fly."""
    model = quiet(profiles.flight_model(autopilot))
    swarm = Swarm(PHYSICS, pads_ned_m, wind_m_s, np.random.default_rng(0), model)
    swarm.commands.flying[:] = True
    return swarm


def command(swarm: Swarm, row: int, autopilot: str, reference: Reference) -> None:
    """Give one vehicle a reference with its autopilot's default limits."""
    swarm.commands.set(row, reference, LIMITS[autopilot], PHYSICS.tracking)


def fly(
    autopilot: str,
    motion: Motion,
    until_s: float,
    rate_hz: float,
    content: str,
    parameters: Mapping[str, float] = MappingProxyType({}),
) -> tuple[Array, Array, Array]:
    """Stream a motion's setpoints to one vehicle.

    Args:
        autopilot: which.
        motion: what to follow; before time 0 its start.
        until_s: how long.
        rate_hz: of setpoints.
        content: "P", "PV" or "PVA".
        parameters: of the autopilot, unlike their defaults.

    Returns:
        Times (T,), the motion's positions (T, 3) and the vehicle's own (T, 3) at every physics step.
    """
    swarm = quiet_swarm(autopilot, motion(-1.0)[0][None])
    for name, value in parameters.items():
        swarm.set_parameter(0, name, value)
    carry_s, lapses = CARRIES[autopilot]
    given = ALL if "V" in content else NONE
    sent, times_s, wanted_m, flown_m = -int(SETTLING_S * rate_hz), [], [], []
    while (now_s := swarm.time_s - SETTLING_S) <= until_s:
        while sent / rate_hz + LATENCY_S <= now_s + 1e-9:
            position, velocity, acceleration = motion(sent / rate_hz)
            reference = Reference(
                (position[0], position[1], position[2]),
                (velocity[0], velocity[1], velocity[2]) if "V" in content else ZERO,
                (acceleration[0], acceleration[1], acceleration[2]) if "A" in content else ZERO,
                ALL,
                given,
                0.0,
                0.0,
                swarm.time_s,
                carry_s,
                lapses,
            )
            command(swarm, 0, autopilot, reference)
            sent += 1
        swarm.step()
        times_s.append(swarm.time_s - SETTLING_S)
        wanted_m.append(motion(times_s[-1])[0])
        flown_m.append(swarm.estimated_position_m[0].copy())
    return np.array(times_s), np.array(wanted_m), np.array(flown_m)


def line(speed_m_s: float, ramp_m_s2: float, axis: int = 0) -> Motion:
    """Speed up, cruise for 8 s, stop: northwards (axis 0), or upwards (axis 2)."""
    ramp_s = speed_m_s / ramp_m_s2
    along = np.zeros(3)
    along[axis] = 1.0 if axis < 2 else -1.0

    def at(time_s: float) -> tuple[Array, Array, Array]:
        t, stop_s = max(time_s, 0.0), ramp_s + CRUISE_S
        if t < ramp_s:
            way, speed, acceleration = 0.5 * ramp_m_s2 * t * t, ramp_m_s2 * t, ramp_m_s2 if time_s >= 0.0 else 0.0
        elif t < stop_s:
            way, speed, acceleration = speed_m_s * (t - 0.5 * ramp_s), speed_m_s, 0.0
        else:
            braking = t < stop_s + ramp_s
            q = min(t - stop_s, ramp_s)
            way = speed_m_s * (stop_s - 0.5 * ramp_s) + speed_m_s * q - 0.5 * ramp_m_s2 * q * q
            speed, acceleration = speed_m_s - ramp_m_s2 * q, -ramp_m_s2 if braking else 0.0
        return np.array([0.0, 0.0, -10.0]) + way * along, speed * along, acceleration * along

    return at


def circle(speed_m_s: float, radius_m: float = 5.0) -> Motion:
    """Go round at constant speed from time 0 on."""
    turn = speed_m_s / radius_m

    def at(time_s: float) -> tuple[Array, Array, Array]:
        angle, moving = turn * max(time_s, 0.0), 1.0 if time_s >= 0.0 else 0.0
        out, along = (
            np.array([math.cos(angle), math.sin(angle), 0.0]),
            np.array([-math.sin(angle), math.cos(angle), 0.0]),
        )
        position = radius_m * out + np.array([0.0, 0.0, -10.0])
        return position, moving * speed_m_s * along, -moving * speed_m_s * turn * out

    return at
