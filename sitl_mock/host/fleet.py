"""All vehicles and their physics on one clock: the whole simulator without sockets. Sans-IO; time is an argument."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sitl_mock import profiles
from sitl_mock.autopilot.autopilot import Autopilot, Setup
from sitl_mock.autopilot.guidance import BodyState
from sitl_mock.host.vehicle import Vehicle
from sitl_mock.physics.constants import Physics, load_physics
from sitl_mock.physics.geodesy import Geodetic, World
from sitl_mock.physics.reference import Limits, Reference, Thrust, Vec3
from sitl_mock.physics.swarm import Swarm

TIME_SLACK_S = 1e-9  # a step whose time floating point put a hair behind now is due
WORST_ERROR_SIGMAS = 2.2  # measured origins: standard deviation 0.17 and 0.35 m, worst 0.39 and 0.75 m


@dataclass(frozen=True)
class FleetOptions:
    """Which vehicles there are, and in what world.

    Attributes:
        autopilot: the one that all vehicles play, one of `sitl_mock.profiles.names()`.
        pads_enu_m: east, north of each vehicle's pad from the origin [m]; its length is the number of vehicles.
        system_ids: one per pad, 1 ... 255; empty: 1, 2, 3 ...
        origin_deg_m: latitude, longitude [deg], altitude [m] of the world's origin (WGS84).
        seed: of everything random: origin errors, drifts and wind.
        real_boot: boot as slowly as the real autopilots.
        wind_m_s: mean wind [m/s], with gusts; 0 is still air.

    Raises:
        ValueError: options that contradict each other or mean nothing; one line that says which.
    """

    autopilot: str = "px4"
    pads_enu_m: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    system_ids: tuple[int, ...] = ()
    origin_deg_m: tuple[float, float, float] = (47.397742, 8.545594, 488.0)
    seed: int = 0
    real_boot: bool = False
    wind_m_s: float = 0.0

    def __post_init__(self) -> None:
        pads = len(self.pads_enu_m)
        if not self.system_ids:
            object.__setattr__(self, "system_ids", tuple(range(1, pads + 1)))
        if len(self.system_ids) != pads:
            raise ValueError(
                f"the number of system ids ({len(self.system_ids)}) is not the number of vehicles ({pads})"
            )
        if self.autopilot not in profiles.names():
            raise ValueError(f"autopilot {self.autopilot!r} is not one of: {', '.join(profiles.names())}")
        if not self.wind_m_s >= 0.0:
            raise ValueError(f"the wind must not be negative: {self.wind_m_s:g} m/s")
        check_system_ids(self.system_ids)


def check_system_ids(system_ids: Sequence[int]) -> None:
    """Refuse system ids that MAVLink does not have, and those of two vehicles.

    Raises:
        ValueError: says which.
    """
    for system_id, times in Counter(system_ids).items():
        if not 1 <= system_id <= 255:
            raise ValueError(f"MAVLink has no system id {system_id}: they are 1 to 255")
        if times > 1:
            raise ValueError(f"system id {system_id} belongs to {times} vehicles")


def grid(vehicles: int, spacing_m: float = 3.0) -> tuple[tuple[float, float], ...]:
    """Pads (east, north) [m] on a grid as square as possible, the first at the origin."""
    columns = math.ceil(math.sqrt(vehicles))
    return tuple((spacing_m * (k % columns), spacing_m * (k // columns)) for k in range(vehicles))


class Sent(NamedTuple):
    """Bytes of one vehicle for one of its links."""

    vehicle: int
    link: int
    data: bytes


class Fleet:
    """V vehicles.

    Args:
        options: which vehicles, and where they stand.
        links: how many remotes each vehicle talks to.
    """

    def __init__(self, options: FleetOptions, links: int = 1) -> None:
        self.physics: Physics = load_physics()
        rules, dialect = profiles.strategy(options.autopilot)
        self.profile = rules.profile
        world = World(Geodetic(*options.origin_deg_m))
        pads_ned_m = np.array([(north, east, 0.0) for east, north in options.pads_enu_m]).reshape(-1, 3)  # (V, 3)
        errors, drifts, wind = np.random.default_rng(options.seed).spawn(3)
        self.swarm = Swarm(self.physics, pads_ned_m, options.wind_m_s, wind)
        sigma = np.array([rules.profile.position_error_m[0]] * 2 + [rules.profile.position_error_m[1]])
        noise = np.clip(errors.standard_normal(pads_ned_m.shape), -WORST_ERROR_SIGMAS, WORST_ERROR_SIGMAS) * sigma
        self.vehicles = []
        for k, system_id in enumerate(options.system_ids):
            setup = Setup(
                system_id,
                links,
                options.real_boot,
                _vec3(pads_ned_m[k].tolist()),
                _vec3(noise[k].tolist()),
                float(drifts.uniform(-np.pi, np.pi)),
            )
            self.vehicles.append(Vehicle(Autopilot(rules, setup, world), dialect))
        self._given: list[tuple[Reference, Limits] | None] = [None] * len(self.vehicles)
        self._step = 0

    @property
    def time_s(self) -> float:
        """Simulated time of the physics: the end of its last step."""
        return self.swarm.time_s

    def advance(self, now_s: float) -> list[Sent]:
        """Run physics and logic up to a time.

        Returns:
            What the vehicles said meanwhile (answers, heartbeats at mode changes; streams are `telemetry`).
        """
        sent: list[Sent] = []
        while self.swarm.time_s + self.physics.time.step_s <= now_s + TIME_SLACK_S:
            if self._step % self.physics.time.logic_steps == 0:
                sent += self._think()
            self.swarm.step()
            self._step += 1
        return sent

    def receive(self, vehicle: int, link: int, data: bytes, now_s: float) -> list[Sent]:
        """Give one datagram to one vehicle, after `advance(now_s)`."""
        body = self._body(vehicle, now_s)
        sent = [Sent(vehicle, *d) for d in self.vehicles[vehicle].receive(link, data, body)]
        self._command(vehicle)
        return sent

    def telemetry(self, now_s: float) -> list[Sent]:
        """All streams that are due, after `advance(now_s)`."""
        due = [(k, vehicle.telemetry(now_s)) for k, vehicle in enumerate(self.vehicles)]
        if not any(names for _, names in due):
            return []
        bodies = list(self._bodies(now_s))
        return [Sent(k, *d) for k, names in due if names for d in self.vehicles[k].pack(names, bodies[k])]

    def _think(self) -> list[Sent]:
        sent: list[Sent] = []
        for k, body in enumerate(self._bodies(self.swarm.time_s)):
            sent += (Sent(k, *d) for d in self.vehicles[k].update(body))
            self._command(k)
        return sent

    def _command(self, vehicle: int) -> None:
        autopilot = self.vehicles[vehicle].autopilot
        if autopilot.thrust is not Thrust.FLY:
            self.swarm.commands.flying[vehicle] = False
            return
        given = (autopilot.reference, autopilot.limits)
        if self._given[vehicle] != given:  # most of the time nothing new is asked
            self._given[vehicle] = given
            self.swarm.commands.set(vehicle, *given, self.physics.tracking)
        self.swarm.commands.flying[vehicle] = True

    def _bodies(self, now_s: float) -> Iterator[BodyState]:
        positions_m, velocities_m_s = (array.tolist() for array in self.swarm.at(now_s))
        swarm = self.swarm
        rows = zip(
            positions_m,
            velocities_m_s,
            swarm.acceleration_m_s2.tolist(),
            swarm.yaw_rad.tolist(),
            swarm.yaw_rate_rad_s.tolist(),
            swarm.in_contact.tolist(),
            strict=True,
        )
        for position, velocity, acceleration, yaw_rad, rate_rad_s, contact in rows:
            yield BodyState(now_s, _vec3(position), _vec3(velocity), _vec3(acceleration), yaw_rad, rate_rad_s, contact)

    def _body(self, vehicle: int, now_s: float) -> BodyState:
        swarm = self.swarm
        positions_m, velocities_m_s = swarm.at(now_s)
        return BodyState(
            now_s,
            _vec3(positions_m[vehicle].tolist()),
            _vec3(velocities_m_s[vehicle].tolist()),
            _vec3(swarm.acceleration_m_s2[vehicle].tolist()),
            float(swarm.yaw_rad[vehicle]),
            float(swarm.yaw_rate_rad_s[vehicle]),
            bool(positions_m[vehicle, 2] > -self.physics.ground.contact_m),
        )


def _vec3(values: list[float]) -> Vec3:
    return (values[0], values[1], values[2])
