"""Vehicles to be followed: each moves exactly as prescribed, sends where it is, and ignores what it receives."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from sitl_mock.links import Link
from sitl_mock.messages import Fields, SystemStatus
from sitl_mock.physics import courses
from sitl_mock.physics.geodesy import Geodetic, World
from sitl_mock.protocol.codec import Codec

DEFAULT_HZ = 10.0  # as PX4 and ArduPilot send their global position unasked, in round numbers
MOST_HZ = 100.0  # the server sends streams no faster
GROUND_ROVER = 10  # MAV_TYPE
GENERIC = 0  # MAV_AUTOPILOT: none in particular
ARMED_BIT = 128
ESTIMATES = 0b11  # FOLLOW_TARGET.est_capabilities: position and velocity


@dataclass(frozen=True)
class TargetOptions:
    """A vehicle to be followed.

    Attributes:
        system_id: 1 ... 255.
        kind: of its motion, one of `courses.COURSES`.
        keys: of that motion.
        rate_hz: of its position messages.
        follow_target: send FOLLOW_TARGET beside GLOBAL_POSITION_INT.
    """

    system_id: int
    kind: str
    keys: dict[str, Any] = field(default_factory=dict)
    rate_hz: float = DEFAULT_HZ
    follow_target: bool = False

    def course(self) -> courses.Course:
        """Return its motion.

        Raises:
            ValueError: there is no such motion; says why.
        """
        return courses.checked(self.kind, self.keys)


def parse_target(text: str) -> TargetOptions:
    """Read a target from a JSON object: `system_id`, `kind`, the keys of that kind, `rate_hz` and `follow_target`.

    Raises:
        ValueError: one line that says what is wrong.
    """
    try:
        keys = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not a JSON object: {error}") from error
    if not isinstance(keys, dict):
        raise ValueError("not a JSON object")
    system_id, rate_hz = keys.pop("system_id", None), keys.pop("rate_hz", DEFAULT_HZ)
    kind, follow_target = keys.pop("kind", None), keys.pop("follow_target", False)
    if not isinstance(system_id, int) or not 1 <= system_id <= 255:
        raise ValueError("system_id must be a whole number from 1 to 255")
    if not isinstance(rate_hz, int | float) or not 0.0 < rate_hz <= MOST_HZ:
        raise ValueError(f"rate_hz must be a number above 0, at most {MOST_HZ:g}")
    if not isinstance(follow_target, bool):
        raise ValueError("follow_target must be true or false")
    options = TargetOptions(system_id, str(kind), keys, float(rate_hz), follow_target)
    options.course()
    return options


class TargetSent(NamedTuple):
    """Bytes of one target for one of its links."""

    target: int
    link: int
    data: bytes


class Targets:
    """All vehicles to be followed, on one clock.

    Args:
        options: of each.
        links: remotes of each.
        origin_deg_m: latitude, longitude, altitude of the world's origin (WGS84).
    """

    def __init__(self, options: Sequence[TargetOptions], links: int, origin_deg_m: tuple[float, float, float]) -> None:
        self._options = tuple(options)
        self._courses = [target.course() for target in options]
        self._world = World(Geodetic(*origin_deg_m))
        self.codecs = [[Codec() for _ in range(links)] for _ in options]
        self._links = [[Link(_streams_hz(target), 0.0) for _ in range(links)] for target in options]

    def telemetry(self, now_s: float) -> list[TargetSent]:
        """All streams that are due."""
        ids = [target.system_id for target in self._options]
        return [
            TargetSent(row, link, data)
            for row, links in enumerate(self._links)
            for link, streams in enumerate(links)
            for name in streams.due(now_s)
            if (data := self.codecs[row][link].encode(name, self._fields(row, name, now_s), ids[row]))
        ]

    def positions_enu_m(self, now_s: float) -> list[tuple[float, float, float]]:
        """Where the targets truly are [m; ENU]."""
        places = [course(now_s)[0] for course in self._courses]
        return [(east, north, -down) for north, east, down in places]

    def _fields(self, row: int, name: str, now_s: float) -> Fields:
        if name == "HEARTBEAT":
            return _HEARTBEAT
        (north, east, down), (v_north, v_east, v_down) = self._courses[row](now_s)
        point = self._world.geodetic(north, east, down)
        latitude, longitude = round(point.latitude_deg * 1e7), round(point.longitude_deg * 1e7)
        if name == "FOLLOW_TARGET":
            return {
                "timestamp": round(now_s * 1e3),
                "est_capabilities": ESTIMATES,
                "lat": latitude,
                "lon": longitude,
                "alt": point.altitude_m,
                "vel": [v_north, v_east, v_down],
                "acc": [0.0] * 3,
                "attitude_q": [1.0, 0.0, 0.0, 0.0],
                "rates": [0.0] * 3,
                "position_cov": [0.0] * 3,
                "custom_state": 0,
            }
        heading_deg = math.degrees(math.atan2(v_east, v_north)) % 360.0
        return {
            "time_boot_ms": round(now_s * 1e3),
            "lat": latitude,
            "lon": longitude,
            "alt": round(point.altitude_m * 1e3),
            "relative_alt": round(-down * 1e3),
            "vx": round(v_north * 100),
            "vy": round(v_east * 100),
            "vz": round(v_down * 100),
            "hdg": round(heading_deg * 100) % 36000,
        }


_HEARTBEAT: Fields = {
    "type": GROUND_ROVER,
    "autopilot": GENERIC,
    "base_mode": ARMED_BIT,
    "custom_mode": 0,
    "system_status": int(SystemStatus.ACTIVE),
    "mavlink_version": 3,
}


def _streams_hz(target: TargetOptions) -> dict[str, float]:
    streams = {"HEARTBEAT": 1.0, "GLOBAL_POSITION_INT": target.rate_hz}
    return streams | ({"FOLLOW_TARGET": target.rate_hz} if target.follow_target else {})
