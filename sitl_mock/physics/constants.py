"""The numbers of the world and of particles, read from `params.toml`."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources

from sitl_mock.physics.flight_model import FlightModel


@dataclass(frozen=True, slots=True)
class Timing:
    """Rates of the simulator's three loops."""

    step_s: float  # [s] physics
    logic_steps: int  # physics steps between two runs of the autopilot logic
    encounter_steps: int  # physics steps between two comparisons of all vehicles with each other and the ground
    tick_s: float  # [s] server
    catch_up_s: float  # [s] longest stall that is made up


@dataclass(frozen=True, slots=True)
class BodyLimits:
    """What the airframe can do at all."""

    speed_m_s: float  # [m/s] norm
    acceleration_m_s2: float  # [m/s^2] norm
    width_m: float  # [m]
    strike_m_s: float  # [m/s]


@dataclass(frozen=True, slots=True)
class PositionLoop:
    """Gains and bounds of the loop that follows a reference."""

    position_gain_per_s: float  # [1/s]
    velocity_gain_per_s: float  # [1/s]
    integral_gain_per_s2: float  # [1/s^2]
    integral_bound_m_s2: float  # [m/s^2]
    smoothing_s: float  # [s]
    headroom: float  # [1]
    speed_headroom_m_s: float  # [m/s]
    braking_share: float  # [1]


@dataclass(frozen=True, slots=True)
class Ground:
    """A flat, soft ground."""

    stiffness_per_s2: float  # [1/s^2]
    damping_per_s: float  # [1/s]
    friction_per_s: float  # [1/s]
    contact_m: float  # [m]


@dataclass(frozen=True, slots=True)
class Wind:
    """How wind becomes acceleration."""

    drag_per_s: float  # [1/s]
    gust_share: float  # [1]
    gust_time_s: float  # [s]


@dataclass(frozen=True, slots=True)
class Physics:
    """All numbers of the physics."""

    time: Timing
    body: BodyLimits
    tracking: PositionLoop
    ground: Ground
    wind: Wind
    particle: FlightModel  # without a control law of an autopilot: `tracking` is its loop


def load_physics() -> Physics:
    """Read the numbers that belong to this package.

    Returns:
        The physics; a missing or unknown key raises `TypeError` naming it.
    """
    tables = tomllib.loads(resources.files("sitl_mock.physics").joinpath("params.toml").read_text(encoding="utf-8"))
    return Physics(
        time=Timing(**tables["time"]),
        body=BodyLimits(**tables["body"]),
        tracking=PositionLoop(**tables["tracking"]),
        ground=Ground(**tables["ground"]),
        wind=Wind(**tables["wind"]),
        particle=FlightModel(None, tables["particle"], {}, {}),
    )
