"""Flying a mode: turns a behaviour, the vehicle's state and its parameters into the reference of the moment."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from enum import Enum, auto
from typing import NamedTuple

from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.autopilot.profile import AutopilotProfile, Behaviour
from sitl_mock.physics.reference import ALL, NONE, Flags3, Limits, Reference, Vec3

STANDSTILL_M_S = 0.3  # slower than this a braking vehicle takes the spot for its place to stay
REACHED_M = 0.15  # of a height: the real ones call a take-off finished 0.1-0.2 m below
OVERHEAD_M = 1.0  # horizontal distance from home at which a return is over
OWN_GAIN_PER_S = 1.2  # approach of heights and places that the autopilot chose itself
PILOTLESS_RISE_M_S = 0.5  # PX4 STABILIZED without a pilot climbs away


class BodyState(NamedTuple):
    """One vehicle's state at one instant, world NED."""

    time_s: float  # simulated
    clock_s: float  # since its boot, by its own clock
    position_m: Vec3
    velocity_m_s: Vec3
    acceleration_m_s2: Vec3
    yaw_rad: float
    yaw_rate_rad_s: float
    contact: bool

    @property
    def height_m(self) -> float:
        """Above the ground."""
        return -self.position_m[2]


class Target(NamedTuple):
    """What changes from one setpoint of a stream to the next; world NED."""

    position_m: Vec3
    velocity_m_s: Vec3
    acceleration_m_s2: Vec3
    yaw_rad: float
    since_s: float


class ReturnStage(Enum):
    """Where a return is."""

    CLIMB = auto()
    CRUISE = auto()
    WAIT = auto()
    DESCEND = auto()


class GuidanceRules(ABC):
    """How one autopilot lands and returns; stateless.

    Args:
        profile: its numbers and names.
    """

    def __init__(self, profile: AutopilotProfile) -> None:
        self.profile = profile

    @abstractmethod
    def landing_speed_m_s(self, parameters: Parameters, height_m: float) -> float:
        """How fast a landing sinks [m/s] at a height above the ground [m]."""

    @abstractmethod
    def return_height_m(self, parameters: Parameters, away_m: float) -> float:
        """Lowest height above the ground [m] to return at from a horizontal distance [m]."""

    @abstractmethod
    def return_wait_s(self, parameters: Parameters) -> float:
        """How long a return waits above home [s] before it descends."""


class Guidance:
    """Flies one vehicle by its behaviour.

    Args:
        rules: the autopilot's, with its profile.
        parameters: the vehicle's parameters, read whenever they matter.
        drift_rad: direction of travel of a vehicle in a pilot's mode without a pilot.
    """

    def __init__(self, rules: GuidanceRules, parameters: Parameters, drift_rad: float) -> None:
        self._rules = rules
        self._profile = rules.profile
        self._parameters = parameters
        drift_m_s = rules.profile.pilotless_drift_m_s
        self._drift_m_s = (drift_m_s * math.cos(drift_rad), drift_m_s * math.sin(drift_rad))
        self._place: tuple[float, float] | None = None  # north, east where the vehicle stays
        self._height_m: float | None = None
        self._yaw_rad = 0.0
        self._stage = ReturnStage.CLIMB
        self._since_s = 0.0
        self.takeoff_height_m = 0.0  # above the ground
        self._setpoint: Reference | None = None
        self._streamed: Target | None = None  # newer than the setpoint, and else like it
        self._destination: Reference | None = None
        self._limits: dict[tuple[str, float | None, float | None], Limits] = {}  # of these parameters
        self._limits_of = -1
        self.home_m: tuple[float, float] = (0.0, 0.0)  # north, east

    def enter(self, body: BodyState) -> None:
        """A new behaviour begins: forget places, keep the heading."""
        self._place = None
        self._height_m = None
        self._destination = None
        self._yaw_rad = body.yaw_rad
        self._stage = ReturnStage.CLIMB
        self._since_s = body.time_s

    def go_to(self, destination: Reference) -> None:
        """Hold somewhere else (DO_REPOSITION), until the behaviour changes or a setpoint comes."""
        self._destination = destination
        self.setpoint = None

    def reached(self, body: BodyState) -> bool:
        """Whether the take-off height is reached."""
        return body.height_m > self.takeoff_height_m - REACHED_M

    @property
    def descending(self) -> bool:
        """Whether a return is on its last leg."""
        return self._stage is ReturnStage.DESCEND

    @property
    def setpoint(self) -> Reference | None:
        """The newest setpoint; None: there is none to follow."""
        if self._streamed is not None and self._setpoint is not None:
            position_m, velocity_m_s, acceleration_m_s2, yaw_rad, since_s = self._streamed
            self._setpoint = self._setpoint._replace(
                position_ned_m=position_m,
                velocity_ned_m_s=velocity_m_s,
                acceleration_ned_m_s2=acceleration_m_s2,
                yaw_rad=yaw_rad,
                since_s=since_s,
            )
            self._streamed = None
        return self._setpoint

    @setpoint.setter
    def setpoint(self, reference: Reference | None) -> None:
        self._setpoint = reference
        self._streamed = None

    @property
    def has_setpoint(self) -> bool:
        """Whether there is one."""
        return self._setpoint is not None

    @property
    def streams(self) -> bool:
        """Whether the setpoint is of the kind that streams are made of: another like it may be given to `stream`."""
        setpoint = self._setpoint
        if setpoint is None or setpoint.planned:
            return False
        plain = setpoint.position_used == ALL and setpoint.velocity_used == ALL
        return plain and setpoint.yaw_rad is not None and setpoint.yaw_rate_rad_s == 0.0

    def stream(self, target: Target) -> None:
        """Follow a newer target; as setting a setpoint that has it and is else like the present one."""
        self._streamed = target

    def followed(self) -> tuple[Reference, Limits] | None:
        """The newest setpoint, and the limits to fly it with; None: there is none to follow."""
        if self.setpoint is None:
            return None
        profile = self._profile
        return self.setpoint, self._kept((None, None), profile.speeds.horizontal, profile.step_gain_per_s)

    def fly(self, behaviour: Behaviour, body: BodyState) -> tuple[Reference, Limits]:
        """The reference of this moment, and the limits to fly it with; without a setpoint to follow it stays."""
        if behaviour is Behaviour.TAKEOFF:
            place = self._settled_place(body) or body.position_m[:2]
            climb_m_s = self._speed(self._profile.speeds.takeoff)
            return self._at(place, self.takeoff_height_m), self.limits(climb_m_s=climb_m_s)
        if behaviour is Behaviour.LAND:
            return self._sink_slowly(body), self.limits()
        if behaviour is Behaviour.RETURN:
            return self._return(body)
        if behaviour is Behaviour.SINK:
            return self._moving((*self._drift_m_s, self._profile.sink_m_s)), self.limits(
                descent_m_s=self._profile.sink_m_s
            )
        if behaviour is Behaviour.RISE:
            return self._moving((*self._drift_m_s, -PILOTLESS_RISE_M_S)), self.limits()
        return self._stay(body), self.limits()

    def limits(self, climb_m_s: float | None = None, descent_m_s: float | None = None) -> Limits:
        """What the parameters allow the autopilot's own modes now."""
        names = self._profile.speeds
        return self._kept((climb_m_s, descent_m_s), names.cruise, OWN_GAIN_PER_S)

    def _kept(self, vertical_m_s: tuple[float | None, float | None], horizontal: str, gain_per_s: float) -> Limits:
        """Limits as the parameters have them; made anew when those change."""
        if self._limits_of != self._parameters.changes:
            self._limits_of = self._parameters.changes
            self._limits.clear()
        kind = (horizontal, *vertical_m_s)
        found = self._limits.get(kind)
        if found is None:
            names, (climb_m_s, descent_m_s) = self._profile.speeds, vertical_m_s
            found = self._limits[kind] = Limits(
                speed_m_s=self._speed(horizontal),
                climb_m_s=climb_m_s or self._speed(names.climb),
                descent_m_s=descent_m_s or self._speed(names.descent),
                acceleration_m_s2=self._speed(names.acceleration),
                step_gain_per_s=gain_per_s,
            )
        return found

    def _speed(self, name: str) -> float:
        """A parameter of speed or acceleration in SI units."""
        return self._parameters.positive(name, self._profile.speeds.scale)

    def _settled_place(self, body: BodyState) -> tuple[float, float] | None:
        """Where to stay, once the vehicle is slow enough to say so."""
        if self._place is None and math.hypot(body.velocity_m_s[0], body.velocity_m_s[1]) < STANDSTILL_M_S:
            self._place = (body.position_m[0], body.position_m[1])
        return self._place

    def _stay(self, body: BodyState) -> Reference:
        """Brake, then stay at the place and height where it came to rest; or go where it was sent."""
        if self._destination is not None:
            return self._destination
        if self._height_m is None and abs(body.velocity_m_s[2]) < STANDSTILL_M_S:
            self._height_m = body.height_m
        return self._reference(self._settled_place(body), self._height_m, (0.0, 0.0, 0.0))

    def _at(self, place: tuple[float, ...], height_m: float) -> Reference:
        """A step to a place: position only."""
        return Reference((place[0], place[1], -height_m), position_used=ALL, yaw_rad=self._yaw_rad, planned=True)

    def _moving(self, velocity_m_s: Vec3) -> Reference:
        return Reference(velocity_ned_m_s=velocity_m_s, velocity_used=ALL, yaw_rad=self._yaw_rad, planned=True)

    def _reference(self, place: tuple[float, float] | None, height_m: float | None, velocity_m_s: Vec3) -> Reference:
        """Positions on the axes that have one, the given velocity on the others."""
        level, vertical = place is not None, height_m is not None
        north_m, east_m = place or (0.0, 0.0)
        used: Flags3 = (level, level, vertical)
        free: Flags3 = (not level, not level, not vertical)
        return Reference(
            (north_m, east_m, -(height_m or 0.0)),
            velocity_m_s,
            position_used=used,
            velocity_used=free if any(free) else NONE,
            yaw_rad=self._yaw_rad,
            planned=True,
        )

    def _sink_slowly(self, body: BodyState) -> Reference:
        """Land here, as fast as the height allows."""
        descent_m_s = self._rules.landing_speed_m_s(self._parameters, body.height_m)
        return self._reference(self._settled_place(body), None, (0.0, 0.0, descent_m_s))

    def _return(self, body: BodyState) -> tuple[Reference, Limits]:
        """Climb, cruise home, wait, land."""
        away_m = math.hypot(body.position_m[0] - self.home_m[0], body.position_m[1] - self.home_m[1])
        if self._height_m is None:
            self._height_m = max(body.height_m, self._rules.return_height_m(self._parameters, away_m))
        if self._stage is ReturnStage.CLIMB and body.height_m > self._height_m - REACHED_M:
            self._stage = ReturnStage.CRUISE
        if self._stage is ReturnStage.CRUISE and away_m < OVERHEAD_M:
            self._stage, self._since_s = ReturnStage.WAIT, body.time_s
        wait_s = self._rules.return_wait_s(self._parameters)
        if self._stage is ReturnStage.WAIT and body.time_s - self._since_s >= wait_s:
            self._stage, self._place = ReturnStage.DESCEND, self.home_m
        if self._stage is ReturnStage.DESCEND:
            return self._sink_slowly(body), self.limits()
        if self._stage is ReturnStage.CLIMB:
            return self._reference(self._settled_place(body), self._height_m, (0.0, 0.0, 0.0)), self.limits()
        return self._at(self.home_m, self._height_m), self.limits()
