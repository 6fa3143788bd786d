"""A ground station for tests: feeds bytes to the simulator's fleet and advances time; no sockets, no clock."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.faults.schema import FaultOptions
from sitl_mock.host.fleet import Fleet, FleetOptions, Sent
from sitl_mock.messages import Landed

TICK_S = 0.01
SYSTEM, COMPONENT = 255, 190
USE_ALL, USE_POSITION, USE_VELOCITY = 0x800, 0x9F8, 0x9C7  # type masks; yaw used, yaw rate not
USE_POSITION_VELOCITY = 0x9C0
SET_MODE, ARM, TAKEOFF, LAND, SET_INTERVAL, REQUEST = 176, 400, 22, 21, 511, 512
OFFBOARD, LOITER, PX4_LAND, PX4_RTL = 0x00060000, 0x03040000, 0x06040000, 0x05040000
GUIDED, AP_RTL, AP_LAND, BRAKE = 4, 6, 9, 17
Vec3 = Sequence[float] | NDArray[np.float64]


class Packable(Protocol):
    """A message of the dialect."""

    def pack(self, mav: object) -> bytes: ...


class Station:
    """Talks to a fleet as a ground station would, and remembers all it hears.

    Args:
        autopilot: "px4" or "ardupilot".
        vehicles: how many, on a line 3 m apart to the east.
        links, seed, real_boot, wind_m_s, faults, dynamics: as in `FleetOptions`.
    """

    def __init__(
        self,
        autopilot: str,
        vehicles: int = 1,
        *,
        links: int = 1,
        seed: int = 0,
        real_boot: bool = False,
        wind_m_s: float = 0.0,
        faults: tuple[FaultOptions, ...] = (),
        dynamics: str = "paper",
    ) -> None:
        pads = tuple((3.0 * k, 0.0) for k in range(vehicles))
        ids = tuple(range(1, vehicles + 1))
        options = FleetOptions(
            autopilot, pads, ids, seed=seed, real_boot=real_boot, wind_m_s=wind_m_s, faults=faults, dynamics=dynamics
        )
        self.fleet = Fleet(options, links)
        self._first_origins_m = [np.array(self.vehicle(k).local_origin_ned_m) for k in range(vehicles)]
        self.px4 = autopilot == "px4"
        self.settled_m = 0.5 if dynamics == "paper" else 1.5  # settling or gusts; or an estimate that is off
        self.tick = 0
        self.heard: list[tuple[float, int, int, Any]] = []  # time, vehicle, link, message
        self.raw: list[bytes] = []
        self.heartbeats = True
        self._parsers: dict[tuple[int, int], Any] = {}
        self._mav = dialect.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)

    @property
    def now_s(self) -> float:
        return self.tick * TICK_S

    @property
    def autopilot(self) -> Autopilot:
        return self.fleet.vehicles[0].autopilot

    def vehicle(self, k: int = 0) -> Autopilot:
        return self.fleet.vehicles[k].autopilot

    def run(self, seconds: float, each: Callable[[float], object] | None = None, rate_hz: float = 20.0) -> None:
        """Let time pass, calling `each(now_s)` at a rate that divides 100 Hz."""
        for _ in range(round(seconds / TICK_S)):
            if self.heartbeats and self.tick % 100 == 0:
                self.heartbeat()
            if each is not None and self.tick % round(1.0 / TICK_S / rate_hz) == 0:
                each(self.now_s)
            self.tick += 1
            self._take(self.fleet.advance(self.now_s))
            self._take(self.fleet.telemetry(self.now_s))

    def heartbeat(self, system: int = SYSTEM) -> None:
        for k in range(len(self.fleet.vehicles)):
            self.send(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), k, system=system)

    def send(
        self, message: Packable, vehicle: int = 0, link: int = 0, system: int = SYSTEM, component: int = COMPONENT
    ) -> list[Any]:
        """Send a message; give the answers that came at once."""
        self._mav.srcSystem, self._mav.srcComponent = system, component
        return self.send_bytes(bytes(message.pack(self._mav)), vehicle, link)

    def send_bytes(self, data: bytes, vehicle: int = 0, link: int = 0) -> list[Any]:
        before = len(self.heard)
        self._take(self.fleet.advance(self.now_s))
        self._take(self.fleet.receive(vehicle, link, data, self.now_s))
        return [message for _, _, _, message in self.heard[before:]]

    def command(
        self, number: int, *parameters: float, vehicle: int = 0, system: int | None = None, **to: int
    ) -> list[int]:
        """Send a COMMAND_LONG; give the results of its acknowledgements."""
        filled = (*parameters, *(0.0,) * (7 - len(parameters)))
        target = vehicle + 1 if system is None else system
        message = dialect.MAVLink_command_long_message(target, to.get("component", 1), number, 0, *filled)
        return [m.result for m in self.send(message, vehicle) if m.get_type() == "COMMAND_ACK"]

    def mode(self, number: int, vehicle: int = 0) -> list[int]:
        if self.px4:
            return self.command(SET_MODE, 1, number >> 16 & 0xFF, number >> 24 & 0xFF, vehicle=vehicle)
        return self.command(SET_MODE, 1, number, vehicle=vehicle)

    def setpoint(
        self,
        position: Vec3 = (0.0, 0.0, 0.0),
        velocity: Vec3 = (0.0, 0.0, 0.0),
        acceleration: Vec3 = (0.0, 0.0, 0.0),
        yaw: float = 0.0,
        mask: int = USE_ALL,
        frame: int = 1,
        vehicle: int = 0,
        **target: int,
    ) -> list[Any]:
        """Send SET_POSITION_TARGET_LOCAL_NED (world NED: the local origin is added for frame 1)."""
        if frame == 1:
            origin = self.vehicle(vehicle).local_origin_ned_m
            position = [p - o for p, o in zip(position, origin, strict=True)]
        message = dialect.MAVLink_set_position_target_local_ned_message(
            0,
            target.get("system", vehicle + 1),
            target.get("component", 1),
            frame,
            mask,
            *position,
            *velocity,
            *acceleration,
            yaw,
            0.0,
        )
        return self.send(message, vehicle)

    def parameter(self, name: str, value: float, kind: int = 9, vehicle: int = 0) -> list[Any]:
        return self.send(dialect.MAVLink_param_set_message(vehicle + 1, 1, name.encode(), value, kind), vehicle)

    def fly_to(self, height_m: float, vehicle: int = 0) -> None:
        """Arm, take off and be in the streaming mode at a height; 14 s."""
        down = (0.0, 3.0 * vehicle, -height_m)
        if self.px4:
            self.setpoint(down, mask=USE_POSITION, vehicle=vehicle)
            self.mode(OFFBOARD, vehicle)
            assert self.command(ARM, 1, vehicle=vehicle) == [0]
            self.run(14.0, lambda _: self._setpoint_silently(down, vehicle))
        else:
            self.mode(GUIDED, vehicle)
            assert self.command(ARM, 1, vehicle=vehicle) == [0]
            assert self.command(TAKEOFF, 0, 0, 0, 0, 0, 0, height_m, vehicle=vehicle) == [0]
            self.run(14.0)
        assert abs(self.height_m(vehicle) - height_m) < self.settled_m

    def first_origin_m(self, vehicle: int) -> NDArray[np.float64]:
        """Where its local frame had its zero at the beginning; world NED."""
        return self._first_origins_m[vehicle]

    def landed(self, vehicle: int = 0) -> Landed:
        return self.vehicle(vehicle).landed

    def height_m(self, vehicle: int = 0) -> float:
        return -float(self.fleet.swarm.position_m[vehicle, 2])

    def position_m(self, vehicle: int = 0) -> tuple[float, float, float]:
        """World NED."""
        x, y, z = self.fleet.swarm.position_m[vehicle].tolist()
        return x, y, z

    def speed_m_s(self, vehicle: int = 0) -> float:
        return math.hypot(*self.fleet.swarm.velocity_m_s[vehicle].tolist())

    def messages(self, kind: str, vehicle: int = 0, since_s: float = 0.0, link: int = 0) -> list[Any]:
        return [m for t, k, j, m in self.heard if (k, j) == (vehicle, link) and t >= since_s and m.get_type() == kind]

    def texts(self, vehicle: int = 0, since_s: float = 0.0) -> list[str]:
        """Status texts, chunks joined."""
        texts: list[str] = []
        for m in self.messages("STATUSTEXT", vehicle, since_s):
            if m.chunk_seq:
                texts[-1] += m.text
            else:
                texts.append(m.text)
        return texts

    def _setpoint_silently(self, place: Vec3, vehicle: int) -> None:
        self.setpoint(place, mask=USE_POSITION, vehicle=vehicle)

    def _take(self, sent: list[Sent]) -> None:
        for k, link, data in sent:
            self.raw.append(data)
            if (k, link) not in self._parsers:
                self._parsers[k, link] = dialect.MAVLink(None)
            for message in self._parsers[k, link].parse_buffer(data) or []:
                self.heard.append((self.now_s, k, link, message))


def ready(autopilot: str, vehicles: int = 1, *, links: int = 1, seed: int = 0, wind_m_s: float = 0.0) -> Station:
    """A station whose vehicles can be armed."""
    station = Station(autopilot, vehicles, links=links, seed=seed, wind_m_s=wind_m_s)
    station.run(2.0)
    return station
