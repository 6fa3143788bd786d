"""Telemetry that comes often: one message of many vehicles in one pass, from arrays to arrays of payloads.

`ROW_BUILDERS` has what every autopilot sends; what one sends in a way of its own it adds in its profile.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl_mock.autopilot.table import VehicleTable
from sitl_mock.physics.arrays import Array
from sitl_mock.physics.geodesy import World
from sitl_mock.physics.swarm import Commands
from sitl_mock.protocol.layouts import layout

Rows = NDArray[np.intp]  # (R,) of vehicles
FULL_TURN_CDEG = 36000
NO_FIX = 1  # GPS_FIX_TYPE: a receiver is there, satellites are not
NO_SPEED = 65535  # of GPS_RAW_INT: not known, or too fast
HOVER_PERCENT = 48


class Scene(NamedTuple):
    """All V vehicles at one instant as their estimators have them; world NED.

    Attributes:
        clock_s: (V,) since each one's boot, by its own clock.
        position_m: (V, 3)
        velocity_m_s: (V, 3)
        roll_rad: (V,)
        pitch_rad: (V,)
        yaw_rad: (V,)
        yaw_rate_rad_s: (V,)
        commands: what the inner loops are asked to do.
        table: what else is kept in arrays.
        world: the ground.
        time_s: simulated time.
    """

    clock_s: Array
    position_m: Array
    velocity_m_s: Array
    roll_rad: Array
    pitch_rad: Array
    yaw_rad: Array
    yaw_rate_rad_s: Array
    commands: Commands
    table: VehicleTable
    world: World
    time_s: float


Builder = Callable[[Scene, Rows], NDArray[np.void]]


class RowBuilder(NamedTuple):
    """How one message is made for many vehicles.

    Attributes:
        build: from a scene and R rows to the payloads, see `Layout.rows`; with its time stamp still to be filled in.
        needs_position: it is sent only by vehicles whose estimator has a position.
    """

    build: Builder
    needs_position: bool = False

    def payloads(self, scene: Scene, rows: Rows) -> NDArray[np.void]:
        """The payloads of R vehicles, complete."""
        made = self.build(scene, rows)
        names = made.dtype.names or ()
        if "time_boot_ms" in names:  # as they wrap on the wire
            made["time_boot_ms"] = np.rint(scene.clock_s[rows] * 1e3).astype(np.int64) & 0xFFFFFFFF
        elif "time_usec" in names:
            made["time_usec"] = np.rint(scene.clock_s[rows] * 1e6).astype(np.int64)
        return made


def sendable(builder: RowBuilder, scene: Scene, row: int) -> bool:
    """Whether a vehicle can send the message now."""
    return not builder.needs_position or bool(scene.table.positioned[row])


def local_position(scene: Scene, rows: Rows) -> NDArray[np.void]:
    """LOCAL_POSITION_NED."""
    made = layout("LOCAL_POSITION_NED").rows(len(rows))
    position_m = scene.table.local_m(rows, scene.position_m[rows])
    velocity_m_s = scene.velocity_m_s[rows]
    for k, axis in enumerate("xyz"):
        made[axis] = position_m[:, k]
        made["v" + axis] = velocity_m_s[:, k]
    return made


def _global_position(scene: Scene, rows: Rows) -> NDArray[np.void]:
    made = layout("GLOBAL_POSITION_INT").rows(len(rows))
    position_m, velocity_m_s = scene.position_m[rows], scene.velocity_m_s[rows]
    points = scene.world.geodetic_rows(position_m)
    made["lat"] = np.rint(points[:, 0] * 1e7)
    made["lon"] = np.rint(points[:, 1] * 1e7)
    made["alt"] = np.rint(points[:, 2] * 1e3)
    made["relative_alt"] = np.rint((scene.table.home_ned_m[rows, 2] - position_m[:, 2]) * 1e3)
    centimetres = np.rint(velocity_m_s * 100.0)
    for k, axis in enumerate("xyz"):
        made["v" + axis] = centimetres[:, k]
    made["hdg"] = np.rint(np.degrees(scene.yaw_rad[rows]) % 360.0 * 100.0) % FULL_TURN_CDEG
    return made


def gps_raw(fix_type: int) -> Builder:
    """GPS_RAW_INT of an autopilot whose receiver has a kind of fix (GPS_FIX_TYPE) once it has one."""

    def build(scene: Scene, rows: Rows) -> NDArray[np.void]:
        made = layout("GPS_RAW_INT").rows(len(rows))
        points, velocity_m_s = scene.world.geodetic_rows(scene.position_m[rows]), scene.velocity_m_s[rows]
        fixed = scene.table.gps_fixed[rows]
        made["fix_type"] = np.where(fixed, fix_type, NO_FIX)
        made["satellites_visible"] = np.where(fixed, 10, 0)
        made["lat"] = np.rint(points[:, 0] * 1e7)
        made["lon"] = np.rint(points[:, 1] * 1e7)
        made["alt"] = np.rint(points[:, 2] * 1e3)
        made["eph"] = made["epv"] = 100
        made["vel"] = np.minimum(np.rint(np.hypot(velocity_m_s[:, 0], velocity_m_s[:, 1]) * 100.0), NO_SPEED)
        course_deg = np.degrees(np.arctan2(velocity_m_s[:, 1], velocity_m_s[:, 0]))
        made["cog"] = np.rint(course_deg % 360.0 * 100.0) % FULL_TURN_CDEG
        return made

    return build


def vfr_hud(airspeed_measured: bool) -> Builder:
    """VFR_HUD; an autopilot may have no airspeed."""

    def build(scene: Scene, rows: Rows) -> NDArray[np.void]:
        made = layout("VFR_HUD").rows(len(rows))
        velocity_m_s = scene.velocity_m_s[rows]
        made["groundspeed"] = np.hypot(velocity_m_s[:, 0], velocity_m_s[:, 1])
        made["airspeed"] = made["groundspeed"] if airspeed_measured else np.nan
        made["heading"] = np.rint(np.degrees(scene.yaw_rad[rows])) % 360
        made["throttle"] = np.where(scene.commands.flying[rows], HOVER_PERCENT, 0)
        made["alt"] = scene.world.origin.altitude_m - scene.position_m[rows, 2]
        made["climb"] = -velocity_m_s[:, 2]
        return made

    return build


def _attitude(scene: Scene, rows: Rows) -> NDArray[np.void]:
    made = layout("ATTITUDE").rows(len(rows))
    made["roll"], made["pitch"] = scene.roll_rad[rows], scene.pitch_rad[rows]
    made["yaw"], made["yawspeed"] = scene.yaw_rad[rows], scene.yaw_rate_rad_s[rows]
    return made


def _attitude_quaternion(scene: Scene, rows: Rows) -> NDArray[np.void]:
    made = layout("ATTITUDE_QUATERNION").rows(len(rows))
    halves = 0.5 * np.stack([scene.roll_rad[rows], scene.pitch_rad[rows], scene.yaw_rad[rows]])
    (cr, cp, cy), (sr, sp, sy) = np.cos(halves), np.sin(halves)
    made["q1"] = cr * cp * cy + sr * sp * sy
    made["q2"] = sr * cp * cy - cr * sp * sy
    made["q3"] = cr * sp * cy + sr * cp * sy
    made["q4"] = cr * cp * sy - sr * sp * cy
    made["yawspeed"] = scene.yaw_rate_rad_s[rows]
    return made


ROW_BUILDERS: Mapping[str, RowBuilder] = MappingProxyType(
    {
        "ATTITUDE": RowBuilder(_attitude),
        "ATTITUDE_QUATERNION": RowBuilder(_attitude_quaternion),
        "LOCAL_POSITION_NED": RowBuilder(local_position, needs_position=True),
        "GLOBAL_POSITION_INT": RowBuilder(_global_position, needs_position=True),
    }
)
