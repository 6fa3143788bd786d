"""Telemetry: from a vehicle's state to the fields of each message it can send.

`BUILDERS` has what every autopilot sends; what one sends in a way of its own, or sends alone, it adds in its profile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.guidance import BodyState
from sitl_mock.autopilot.profile import Behaviour
from sitl_mock.messages import Fields
from sitl_mock.physics.reference import Vec3

ARMED_BIT = 0x80
FENCE_BIT = 0x100000  # MAV_SYS_STATUS_GEOFENCE: there is none to breach; MAVProxy says so when it is missing
PREARM_BIT = 0x10000000  # MAV_SYS_STATUS_PREARM_CHECK
SENSORS = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x1000 | 0x2000 | 0x4000 | 0x8000 | 0x200000 | 0x2000000
NAN = math.nan
GPS_BIT = 0x20  # MAV_SYS_STATUS_SENSOR_GPS
NO_CELL = 65535  # "no such cell" in BATTERY_STATUS

Builder = Callable[[Autopilot, BodyState], Fields | None]


def boot_ms(body: BodyState) -> int:
    """Milliseconds since boot, as they wrap on the wire."""
    return round(body.clock_s * 1e3) & 0xFFFFFFFF


def boot_us(body: BodyState) -> int:
    """Microseconds since boot."""
    return round(body.clock_s * 1e6) & 0xFFFFFFFFFFFFFFFF  # a clock that was set back wraps


def local_m(vehicle: Autopilot, body: BodyState) -> Vec3:
    """The vehicle's position in its own local NED."""
    p, o = body.position_m, vehicle.local_origin_ned_m
    return (p[0] - o[0], p[1] - o[1], p[2] - o[2])


def _heartbeat(vehicle: Autopilot, body: BodyState) -> Fields:
    if vehicle.heartbeat_frozen and vehicle.last_heartbeat is not None:
        return vehicle.last_heartbeat
    base_mode = vehicle.mode.base_mode | (ARMED_BIT if vehicle.armed else 0)
    if vehicle.mode.behaviour is Behaviour.FOLLOW and vehicle.rules.stream_fresh(vehicle):
        base_mode |= vehicle.profile.streaming_bit
    vehicle.last_heartbeat = {
        "type": 2,
        "autopilot": vehicle.profile.autopilot,
        "base_mode": base_mode,
        "custom_mode": vehicle.mode.number,
        "system_status": int(vehicle.status),
        "mavlink_version": 3,
    }
    return vehicle.last_heartbeat


def _sys_status(vehicle: Autopilot, body: BodyState) -> Fields:
    able = vehicle.rules.arming_refusal(vehicle) is None and not vehicle.wrecked
    gps = vehicle.gps_lost_at_s is None
    return {
        "onboard_control_sensors_present": SENSORS | PREARM_BIT,
        "onboard_control_sensors_enabled": SENSORS | PREARM_BIT,
        "onboard_control_sensors_health": (SENSORS if gps else SENSORS & ~GPS_BIT)
        | FENCE_BIT
        | (PREARM_BIT if able else 0),
        "load": 100,
        "voltage_battery": round(1e3 * vehicle.battery.voltage_v),
        "current_battery": 1500 if vehicle.armed else 50,
        "battery_remaining": vehicle.battery.percent,
        "drop_rate_comm": 0,
        "errors_comm": 0,
        "errors_count1": 0,
        "errors_count2": 0,
        "errors_count3": 0,
        "errors_count4": 0,
    }


def _system_time(vehicle: Autopilot, body: BodyState) -> Fields:
    return {"time_unix_usec": boot_us(body), "time_boot_ms": boot_ms(body)}  # simulated time: runs are repeatable


class RunningTarget(NamedTuple):
    """What a vehicle in the air is flying to, run on to the present; local NED."""

    position_m: list[float]
    velocity_m_s: list[float]
    acceleration_m_s2: list[float]
    placed: bool  # all axes of the position are controlled
    moving: bool  # some axis of the velocity is


def running_target(vehicle: Autopilot, body: BodyState) -> RunningTarget:
    """The reference of a vehicle at the time of `body`."""
    target = vehicle.reference
    run_s = min(max(body.time_s - target.since_s, 0.0), target.carry_s)
    rows = zip(
        target.position_ned_m,
        target.velocity_ned_m_s,
        target.acceleration_ned_m_s2,
        vehicle.local_origin_ned_m,
        strict=True,
    )
    position_m, velocity_m_s = [], []
    for p, v, a, o in rows:
        position_m.append(p + v * run_s + 0.5 * a * run_s * run_s - o)
        velocity_m_s.append(v + a * run_s)
    acceleration_m_s2 = list(target.acceleration_ned_m_s2)
    return RunningTarget(
        position_m, velocity_m_s, acceleration_m_s2, all(target.position_used), any(target.velocity_used)
    )


def position_target(body: BodyState, axes: Iterable[float], mask: int, yaw_rad: float) -> Fields:
    """POSITION_TARGET_LOCAL_NED with position, velocity and acceleration, one after the other."""
    names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz")
    fields: Fields = dict(zip(names, axes, strict=True))
    more = {"coordinate_frame": 1, "type_mask": mask, "yaw": yaw_rad, "yaw_rate": 0.0}
    return fields | {"time_boot_ms": boot_ms(body)} | more


def _extended_sys_state(vehicle: Autopilot, body: BodyState) -> Fields:
    return {"vtol_state": 0, "landed_state": int(vehicle.landed)}


def _home_position(vehicle: Autopilot, body: BodyState) -> Fields | None:
    if not vehicle.origin_set:
        return None
    home, o = vehicle.home_ned_m, vehicle.local_origin_ned_m
    point = vehicle.world.geodetic(*home)
    return {
        "latitude": round(point.latitude_deg * 1e7),
        "longitude": round(point.longitude_deg * 1e7),
        "altitude": round(point.altitude_m * 1e3),
        "x": home[0] - o[0],
        "y": home[1] - o[1],
        "z": home[2] - o[2],
        "q": list(vehicle.profile.home_quaternion),
        "approach_x": 0.0,
        "approach_y": 0.0,
        "approach_z": 0.0,
        "time_usec": boot_us(body),
    }


def _gps_global_origin(vehicle: Autopilot, body: BodyState) -> Fields | None:
    if not vehicle.origin_set:
        return None
    point = vehicle.world.geodetic(*vehicle.told_origin_ned_m)
    return {
        "latitude": round(point.latitude_deg * 1e7),
        "longitude": round(point.longitude_deg * 1e7),
        "altitude": round(point.altitude_m * 1e3),
        "time_usec": boot_us(body),
    }


def _battery_status(vehicle: Autopilot, body: BodyState) -> Fields:
    cells = vehicle.profile.battery.cells
    return {
        "id": 0,
        "battery_function": 0,
        "type": 0,
        "temperature": 32767,
        "voltages": [round(1e3 * vehicle.battery.cell_v)] * cells + [NO_CELL] * (10 - cells),
        "current_battery": 1500 if vehicle.armed else 50,
        "current_consumed": -1,
        "energy_consumed": -1,
        "battery_remaining": vehicle.battery.percent,
    }


def _mission_current(vehicle: Autopilot, body: BodyState) -> Fields:
    return {"seq": 0, "total": 65535, "mission_state": 1, "mission_mode": 2}


def _estimator_status(vehicle: Autopilot, body: BodyState) -> Fields:
    ratios = ("vel", "pos_horiz", "pos_vert", "mag", "hagl")
    return {
        "time_usec": boot_us(body),
        "flags": 0x33F if vehicle.ready else 0xA7,
        **{f"{name}_ratio": 0.1 for name in ratios},
        "tas_ratio": NAN,
        "pos_horiz_accuracy": 0.3,
        "pos_vert_accuracy": 0.5,
    }


def _autopilot_version(vehicle: Autopilot, body: BodyState) -> Fields:
    return {
        "capabilities": vehicle.profile.capabilities,
        "flight_sw_version": vehicle.profile.version,
        "middleware_sw_version": vehicle.profile.version,
        "os_sw_version": 0,
        "board_version": 0,
        "flight_custom_version": list(b"particle"),
        "middleware_custom_version": [0] * 8,
        "os_custom_version": [0] * 8,
        "vendor_id": 0,
        "product_id": 0,
        "uid": vehicle.system_id << 32 | 0x5349544C,  # real simulators tell the same all, but boards tell their own
    }


# What every autopilot sends.
BUILDERS: Mapping[str, Builder] = MappingProxyType(
    {
        "HEARTBEAT": _heartbeat,
        "SYS_STATUS": _sys_status,
        "SYSTEM_TIME": _system_time,
        "MISSION_CURRENT": _mission_current,
        "GPS_GLOBAL_ORIGIN": _gps_global_origin,
        "BATTERY_STATUS": _battery_status,
        "AUTOPILOT_VERSION": _autopilot_version,
        "ESTIMATOR_STATUS": _estimator_status,
        "HOME_POSITION": _home_position,
        "EXTENDED_SYS_STATE": _extended_sys_state,
    }
)
# Messages that can be asked for by their id. One that an autopilot has no builder for is accepted and never sent.
NAMES: Mapping[int, str] = MappingProxyType(
    {
        0: "HEARTBEAT",
        1: "SYS_STATUS",
        2: "SYSTEM_TIME",
        24: "GPS_RAW_INT",
        30: "ATTITUDE",
        31: "ATTITUDE_QUATERNION",
        32: "LOCAL_POSITION_NED",
        33: "GLOBAL_POSITION_INT",
        42: "MISSION_CURRENT",
        49: "GPS_GLOBAL_ORIGIN",
        74: "VFR_HUD",
        85: "POSITION_TARGET_LOCAL_NED",
        141: "ALTITUDE",
        147: "BATTERY_STATUS",
        148: "AUTOPILOT_VERSION",
        193: "EKF_STATUS_REPORT",
        230: "ESTIMATOR_STATUS",
        242: "HOME_POSITION",
        245: "EXTENDED_SYS_STATE",
        436: "CURRENT_MODE",
    }
)
# Messages that a real vehicle also streams but this one has nothing to say in: accepted likewise.
SILENT_IDS = frozenset(
    {8, 26, 27, 29, 35, 36, 65, 83, 87, 105, 111, 116, 125, 129, 132, 136, 152, 163, 164, 178, 231, 241, 331}
)
