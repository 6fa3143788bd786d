"""All vehicles and their physics on one clock: the whole simulator without sockets. Sans-IO; time is an argument."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from typing import NamedTuple

import numpy as np

from sitl_mock import profiles
from sitl_mock.autopilot.autopilot import Autopilot, Setup
from sitl_mock.autopilot.guidance import BodyState, Target
from sitl_mock.autopilot.profile import AutopilotProfile, Manners
from sitl_mock.autopilot.setpoints import is_plain
from sitl_mock.autopilot.table import VehicleTable, vec3
from sitl_mock.faults.incidents import Incidents
from sitl_mock.faults.schema import FaultOptions, check_mode, check_vehicles
from sitl_mock.faults.vehicle_faults import FaultSchedule, Stages, Subject
from sitl_mock.host.vehicle import Vehicle
from sitl_mock.links import DUE_SLACK_S
from sitl_mock.messages import Outgoing
from sitl_mock.physics.constants import Physics, load_physics
from sitl_mock.physics.geodesy import Geodetic, World
from sitl_mock.physics.reference import Limits, Reference, Thrust
from sitl_mock.physics.swarm import Swarm
from sitl_mock.protocol.codec import COMPONENT, encode_rows, plain_setpoint
from sitl_mock.protocol.layouts import layout
from sitl_mock.protocol.rows import Scene, sendable
from sitl_mock.protocol.signing import Signing, SigningTime

DYNAMICS = ("paper", "measured")
FARTHEST_M = 1e5  # of a pad: beyond, the world is not flat any more
MOST_NOISE_M = 10.0  # that a vehicle hovers off its place
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
        noise_m: how far vehicles hover off their places under measured dynamics, rms [m]; None: as measured.
        dynamics: "paper": the paper's particle; "measured": what the real autopilots were measured to do.
        manners: of other versions of the autopilot.
        faults: inside vehicles, see `sitl_mock.parse_fault`.
        collisions: vehicles that hit each other or the ground have flown for the last time; if not, it is only told.
        signing_key: that all vehicles have, see `sitl_mock.read_key`; None: they have none, and take one.
        epoch_s: Unix time at the start of simulated time, for signatures [s].

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
    noise_m: float | None = None
    dynamics: str = "paper"
    manners: Manners = field(default_factory=Manners)
    faults: tuple[FaultOptions, ...] = ()
    collisions: bool = True
    signing_key: bytes | None = field(default=None, repr=False)
    epoch_s: float = 0.0

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
        if not isinstance(self.seed, int) or self.seed < 0:
            raise ValueError(f"the seed must be a whole number, 0 or more: {self.seed!r}")
        if not all(math.isfinite(number) and abs(number) <= FARTHEST_M for pad in self.pads_enu_m for number in pad):
            raise ValueError(f"pads must be numbers, at most {FARTHEST_M:g} m from the origin")
        latitude_deg, longitude_deg, altitude_m = self.origin_deg_m
        if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0 and math.isfinite(altitude_m)):
            raise ValueError(f"the origin must be latitude, longitude and altitude: {self.origin_deg_m}")
        if self.dynamics not in DYNAMICS:
            raise ValueError(f"dynamics {self.dynamics!r} is not one of: {', '.join(DYNAMICS)}")
        if not self.wind_m_s >= 0.0:
            raise ValueError(f"the wind must not be negative: {self.wind_m_s:g} m/s")
        if self.noise_m is not None and not (0.0 <= self.noise_m <= MOST_NOISE_M and self.dynamics == "measured"):
            raise ValueError(f"noise is of measured dynamics, from 0 to {MOST_NOISE_M:g} m: {self.noise_m:g} m")
        check_system_ids(self.system_ids)
        for manner in fields(self.manners):
            if getattr(self.manners, manner.name) and manner.name not in profile_of(self.autopilot).manners:
                raise ValueError(f"{manner.name} is no manner of {self.autopilot}")
        for fault in self.faults:
            check_vehicles(fault.window, self.system_ids)
            check_mode(fault, [mode.name for mode in profile_of(self.autopilot).modes])


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


def profile_of(autopilot: str) -> AutopilotProfile:
    """The profile of an autopilot."""
    return profiles.strategy(autopilot).rules.profile


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
        rules, self._dialect = profiles.strategy(options.autopilot)
        self.profile = rules.profile
        self._world = World(Geodetic(*options.origin_deg_m))
        pads_ned_m = np.array([(north, east, 0.0) for east, north in options.pads_enu_m]).reshape(-1, 3)  # (V, 3)
        errors, drifts, wind = np.random.default_rng(options.seed).spawn(3)
        model = profiles.flight_model(options.autopilot) if options.dynamics == "measured" else None
        if model is not None and options.noise_m is not None:
            model = model.noisy(options.noise_m)
        self.swarm = Swarm(self.physics, pads_ned_m, options.wind_m_s, wind, model)
        sigma = np.array([rules.profile.position_error_m[0]] * 2 + [rules.profile.position_error_m[1]])
        noise = np.clip(errors.standard_normal(pads_ned_m.shape), -WORST_ERROR_SIGMAS, WORST_ERROR_SIGMAS) * sigma
        self._table = VehicleTable(pads_ned_m, noise, self._world, self.profile.earth_radius_m)
        self._signing_time = SigningTime(options.epoch_s)
        self.vehicles = []
        for k, system_id in enumerate(options.system_ids):
            drift_rad = float(drifts.uniform(-np.pi, np.pi))
            setup = Setup(system_id, links, options.real_boot, options.manners, k, drift_rad, partial(self._body, k))
            autopilot = Autopilot(rules, setup, self._world, self._table)
            self.vehicles.append(Vehicle(autopilot, self._dialect, Signing(self._signing_time, options.signing_key)))
        self._given: list[tuple[Reference, Limits] | None] = [None] * len(self.vehicles)
        self._tuned = [0] * len(self.vehicles)  # how many changes of parameters the control law knows
        self._streams = [False] * len(self.vehicles)  # whether plain setpoints change nothing but the target
        self._rests_until_s = [0.0] * len(self.vehicles)
        autopilots = [vehicle.autopilot for vehicle in self.vehicles]
        self.stages = Stages(autopilots)
        subjects = [Subject(k, v.autopilot, self.swarm.disturbances) for k, v in enumerate(self.vehicles)]
        self._faults = FaultSchedule(options.faults, subjects, self.stages)
        self.incidents = Incidents(self.swarm, autopilots, self.physics.body, harmless=not options.collisions)
        self._step = 0
        self._scene: Scene | None = None  # the newest

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
        self._signing_time.now_s = now_s
        while self.swarm.time_s + self.physics.time.step_s <= now_s + TIME_SLACK_S:
            if self._step % self.physics.time.logic_steps == 0:
                sent += self._think()
            self.swarm.step()
            self._step += 1
            self._scene = None
            if self._step % self.physics.time.encounter_steps == 0:
                for k in self.incidents.look(self.physics.time.encounter_steps * self.physics.time.step_s):
                    self._rests_until_s[k] = self.swarm.time_s
                    self._command(k)
        return sent

    def receive(self, vehicle: int, link: int, data: bytes, now_s: float) -> list[Sent]:
        """Give one datagram to one vehicle, after `advance(now_s)`."""
        if self._streams[vehicle] and self._stream(vehicle, link, data, now_s):
            return []
        said = self.vehicles[vehicle].receive(link, data, now_s)
        rests_until_s = self.vehicles[vehicle].autopilot.rests_until_s
        if rests_until_s < self._rests_until_s[vehicle]:
            self._rests_until_s[vehicle] = rests_until_s
        self._command(vehicle)
        self._tune(vehicle)
        return self._packed(vehicle, said, now_s) if said else []

    def telemetry(self, now_s: float) -> list[Sent]:
        """All streams that are due, after `advance(now_s)`: each message of all vehicles in one pass."""
        due: dict[str, list[tuple[int, int]]] = {}  # by message: vehicle and link
        for k, vehicle in enumerate(self.vehicles):
            if vehicle.autopilot.dead:
                continue
            for j, link in enumerate(vehicle.autopilot.links):
                if now_s >= link.next_s - DUE_SLACK_S:
                    for name in link.due(now_s):
                        due.setdefault(name, []).append((k, j))
        sent: list[Sent] = []
        for name, whom in due.items():
            sent += self._streamed(name, whom, now_s)
        return sent

    def _stream(self, vehicle: int, link: int, data: bytes, now_s: float) -> bool:
        """Take a datagram that is one more setpoint of a stream; False: it has to be read with care."""
        signing = self.vehicles[vehicle].signing
        values = plain_setpoint(data, signing.is_on)
        if values is None:
            return False
        _, x, y, z, u, v, w, a, b, c, yaw_rad, _, mask, system, component, frame = values
        autopilot = self.vehicles[vehicle].autopilot
        if system != autopilot.system_id or component != COMPONENT or not autopilot.links[link].texts_open:
            return False
        if not is_plain(mask, frame, x, y, z, u, v, w, a, b, c, yaw_rad):
            return False
        if signing.is_on and not signing.takes(data):
            return True
        yaw_rad = math.remainder(yaw_rad, 2.0 * math.pi)
        target = Target(self._table.world_m(vehicle, (x, y, z)), (u, v, w), (a, b, c), yaw_rad, now_s)
        self.swarm.commands.stream(vehicle, *target)
        autopilot.stream(target)
        return True

    def _think(self) -> list[Sent]:
        """Run the logic of every vehicle that has something to decide."""
        sent: list[Sent] = []
        now_s = self.swarm.time_s
        for k in self._faults.advance(now_s):
            self._rests_until_s[k] = now_s
        for k, touches in enumerate(self.swarm.in_contact.tolist()):
            vehicle = self.vehicles[k]
            if now_s >= self._rests_until_s[k] - TIME_SLACK_S or (touches and vehicle.autopilot.airborne):
                said = vehicle.update(now_s)
                if said:
                    sent += self._packed(k, said, now_s)
                self._rests_until_s[k] = vehicle.autopilot.rests_until_s
                self._command(k)
        return sent

    def _command(self, vehicle: int) -> None:
        autopilot = self.vehicles[vehicle].autopilot
        # A link that has to be thawed by whatever comes is no matter for streams.
        self._streams[vehicle] = autopilot.flies_stream and not autopilot.manners.parameter_freeze
        if autopilot.thrust is not Thrust.FLY:
            self.swarm.commands.flying[vehicle] = False
            self._given[vehicle] = None
            return
        given = (autopilot.reference, autopilot.limits)
        if self._given[vehicle] != given:  # most of the time nothing new is asked
            self._given[vehicle] = given
            self.swarm.commands.set(vehicle, *given, self.physics.tracking)

    def _tune(self, vehicle: int) -> None:
        """Let changed parameters reach the control law."""
        parameters = self.vehicles[vehicle].autopilot.parameters
        if parameters.changes != self._tuned[vehicle]:
            self._tuned[vehicle] = parameters.changes
            for name in self.swarm.model.parameters:
                if name in parameters:
                    self.swarm.set_parameter(vehicle, name, parameters[name])

    # -- packing --------------------------------------------------------------------------------------------------

    def _streamed(self, name: str, whom: list[tuple[int, int]], now_s: float) -> list[Sent]:
        """One message of several vehicles, each on a link."""
        builder = self._dialect.row_builders.get(name)
        if builder is None:
            sent: list[Sent] = []
            for k, link in whom:
                self.vehicles[k].autopilot.enter(now_s)
                sent += self._packed(k, [Outgoing(name, None, link)], now_s)
            return sent
        scene = self._scene_at(now_s)
        whom = [(k, link) for k, link in whom if sendable(builder, scene, k) and self._talks(k, link, now_s)]
        if not whom:
            return []
        payloads = builder.payloads(scene, np.array([k for k, _ in whom]))
        codecs = [self.vehicles[k].codecs[link] for k, link in whom]
        ids = [self.vehicles[k].autopilot.system_id for k, _ in whom]
        frames = encode_rows(layout(name), payloads, codecs, ids)
        return [Sent(k, link, frame) for (k, link), frame in zip(whom, frames, strict=True)]

    def _packed(self, vehicle: int, messages: list[Outgoing], now_s: float) -> list[Sent]:
        """What a vehicle says, as bytes; what it cannot say now is left out."""
        sent: list[Sent] = []
        codecs, autopilot = self.vehicles[vehicle].codecs, self.vehicles[vehicle].autopilot
        for name, content, only in messages:
            links = range(len(codecs)) if only is None else (only,)
            if content is None and name in self._dialect.row_builders:
                sent += self._streamed(name, [(vehicle, link) for link in links], now_s)
                continue
            if content is None:
                content = self._dialect.fields_of(name, autopilot)
            if content is not None:
                talking = [link for link in links if self._talks(vehicle, link, now_s)]
                sent += [
                    Sent(vehicle, link, codecs[link].encode(name, content, autopilot.system_id)) for link in talking
                ]
        return [one for one in sent if one.data]

    def _talks(self, vehicle: int, link: int, now_s: float) -> bool:
        """Whether a vehicle says anything on a link now."""
        return now_s <= self.vehicles[vehicle].autopilot.links[link].frozen_s

    def _scene_at(self, now_s: float) -> Scene:
        """All vehicles at a time inside the present step."""
        if self._scene is None or self._scene.time_s != now_s:
            position_m, velocity_m_s = self.swarm.estimated_at(now_s)
            swarm, table = self.swarm, self._table
            clocks_s = (now_s - table.clock_zero_s) * table.clock_rate
            self._scene = Scene(
                clocks_s,
                position_m,
                velocity_m_s,
                swarm.roll_rad,
                swarm.pitch_rad,
                swarm.yaw_rad,
                swarm.yaw_rate_rad_s,
                swarm.commands,
                table,
                self._world,
                now_s,
            )
        return self._scene

    def _body(self, vehicle: int, now_s: float) -> BodyState:
        """One vehicle at a time inside the present step."""
        scene, swarm = self._scene_at(now_s), self.swarm
        return BodyState(
            now_s,
            float(scene.clock_s[vehicle]),
            vec3(scene.position_m[vehicle]),
            vec3(scene.velocity_m_s[vehicle]),
            vec3(swarm.acceleration_m_s2[vehicle]),
            float(scene.yaw_rad[vehicle]),
            float(scene.yaw_rate_rad_s[vehicle]),
            bool(swarm.in_contact[vehicle]),
        )
