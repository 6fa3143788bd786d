"""Telemetry: from a vehicle's state to the fields of each message it can send."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.pilot import Body
from sitl_mock.autopilot.profiles import Behaviour
from sitl_mock.messages import Fields
from sitl_mock.physics.reference import Vec3

ARMED_BIT, STREAMING_BIT = 0x80, 0x10
FENCE_BIT = 0x100000  # MAV_SYS_STATUS_GEOFENCE: there is none to breach; MAVProxy says so when it is missing
PREARM_BIT = 0x10000000  # MAV_SYS_STATUS_PREARM_CHECK
SENSORS = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x1000 | 0x2000 | 0x4000 | 0x8000 | 0x200000 | 0x2000000
GRAVITY_M_S2 = 9.80665
NAN = math.nan
CELLS_MV, NO_CELL = 4050, 65535  # a full cell; "no such cell" in BATTERY_STATUS
PX4_DRAIN_PER_S, PX4_LEAST = 0.9, 50  # percent: 74 after half a minute armed, sinks to 50 and stays
ARDUPILOT_FULL, ARDUPILOT_DRAIN_PER_S = 97, 0.23  # percent: 97 to 90 in 30 s of hover

Builder = Callable[[Autopilot, Body], Fields | None]


def _ms(body: Body) -> int:
    return round(body.time_s * 1e3) & 0xFFFFFFFF


def _us(body: Body) -> int:
    return round(body.time_s * 1e6)


def local_m(vehicle: Autopilot, body: Body) -> Vec3:
    """The vehicle's position in its own local NED."""
    p, o = body.position_m, vehicle.local_origin_ned_m
    return (p[0] - o[0], p[1] - o[1], p[2] - o[2])


def attitude_rad(body: Body) -> tuple[float, float]:
    """Roll and pitch whose thrust gives the acceleration that a particle has."""
    if body.contact:
        return 0.0, 0.0
    cos, sin = math.cos(body.yaw_rad), math.sin(body.yaw_rad)
    a = body.acceleration_m_s2
    forward, right, lift = cos * a[0] + sin * a[1], cos * a[1] - sin * a[0], max(GRAVITY_M_S2 - a[2], 0.1)
    pitch = math.atan2(-forward, lift)
    return math.atan2(right * math.cos(pitch), lift), pitch


def battery_percent(vehicle: Autopilot) -> int:
    """Remaining charge as the real SITL batteries show it."""
    if vehicle.profile.is_px4:
        return max(round(100 - PX4_DRAIN_PER_S * vehicle.flown_s), PX4_LEAST)
    return max(round(ARDUPILOT_FULL - ARDUPILOT_DRAIN_PER_S * vehicle.flown_s), 0)


def _heartbeat(vehicle: Autopilot, body: Body) -> Fields:
    base_mode = vehicle.mode.base_mode | (ARMED_BIT if vehicle.armed else 0)
    if vehicle.profile.is_px4 and vehicle.mode.behaviour is Behaviour.FOLLOW and vehicle.stream_fresh:
        base_mode |= STREAMING_BIT
    return {
        "type": 2,
        "autopilot": vehicle.profile.autopilot,
        "base_mode": base_mode,
        "custom_mode": vehicle.mode.number,
        "system_status": int(vehicle.status),
        "mavlink_version": 3,
    }


def _sys_status(vehicle: Autopilot, body: Body) -> Fields:
    able = vehicle.arming_refusal() is None
    return {
        "onboard_control_sensors_present": SENSORS | PREARM_BIT,
        "onboard_control_sensors_enabled": SENSORS | PREARM_BIT,
        "onboard_control_sensors_health": SENSORS | FENCE_BIT | (PREARM_BIT if able else 0),
        "load": 100,
        "voltage_battery": 4 * CELLS_MV,
        "current_battery": 1500 if vehicle.armed else 50,
        "battery_remaining": battery_percent(vehicle),
        "drop_rate_comm": 0,
        "errors_comm": 0,
        "errors_count1": 0,
        "errors_count2": 0,
        "errors_count3": 0,
        "errors_count4": 0,
    }


def _system_time(vehicle: Autopilot, body: Body) -> Fields:
    return {"time_unix_usec": _us(body), "time_boot_ms": _ms(body)}  # simulated time: runs are repeatable


def _gps_raw_int(vehicle: Autopilot, body: Body) -> Fields:
    point = vehicle.world.geodetic(*body.position_m)
    v = body.velocity_m_s
    fix = vehicle.ready or vehicle.body.time_s >= vehicle.boot.origin_s
    return {
        "time_usec": _us(body),
        "fix_type": (3 if vehicle.profile.is_px4 else 6) if fix else 0,
        "lat": round(point.latitude_deg * 1e7),
        "lon": round(point.longitude_deg * 1e7),
        "alt": round(point.altitude_m * 1e3),
        "eph": 100,
        "epv": 100,
        "vel": round(math.hypot(v[0], v[1]) * 100),
        "cog": round(math.degrees(math.atan2(v[1], v[0])) % 360.0 * 100) % 36000,
        "satellites_visible": 10,
    }


def _attitude(vehicle: Autopilot, body: Body) -> Fields:
    roll, pitch = attitude_rad(body)
    return {
        "time_boot_ms": _ms(body),
        "roll": roll,
        "pitch": pitch,
        "yaw": body.yaw_rad,
        "rollspeed": 0.0,
        "pitchspeed": 0.0,
        "yawspeed": body.yaw_rate_rad_s,
    }


def _attitude_quaternion(vehicle: Autopilot, body: Body) -> Fields:
    roll, pitch = attitude_rad(body)
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(body.yaw_rad / 2), math.sin(body.yaw_rad / 2)
    return {
        "time_boot_ms": _ms(body),
        "q1": cr * cp * cy + sr * sp * sy,
        "q2": sr * cp * cy - cr * sp * sy,
        "q3": cr * sp * cy + sr * cp * sy,
        "q4": cr * cp * sy - sr * sp * cy,
        "rollspeed": 0.0,
        "pitchspeed": 0.0,
        "yawspeed": body.yaw_rate_rad_s,
    }


def _local_position_ned(vehicle: Autopilot, body: Body) -> Fields | None:
    if not vehicle.ready and not vehicle.profile.is_px4:
        return None  # ArduPilot never sends it before its estimator has a position
    x, y, z = local_m(vehicle, body)
    vx, vy, vz = body.velocity_m_s
    return {"time_boot_ms": _ms(body), "x": x, "y": y, "z": z, "vx": vx, "vy": vy, "vz": vz}


def _global_position_int(vehicle: Autopilot, body: Body) -> Fields | None:
    if not vehicle.ready:
        return None
    point = vehicle.world.geodetic(*body.position_m)
    v = body.velocity_m_s
    return {
        "time_boot_ms": _ms(body),
        "lat": round(point.latitude_deg * 1e7),
        "lon": round(point.longitude_deg * 1e7),
        "alt": round(point.altitude_m * 1e3),
        "relative_alt": round((vehicle.home_ned_m[2] - body.position_m[2]) * 1e3),
        "vx": round(v[0] * 100),
        "vy": round(v[1] * 100),
        "vz": round(v[2] * 100),
        "hdg": round(math.degrees(body.yaw_rad) % 360.0 * 100) % 36000,
    }


def _position_target_local_ned(vehicle: Autopilot, body: Body) -> Fields | None:
    px4 = vehicle.profile.is_px4
    if not px4 and (not vehicle.airborne or vehicle.mode.behaviour is not Behaviour.FOLLOW):
        return None  # ArduPilot has no target then
    position, velocity, acceleration, mask = [NAN] * 3, [NAN] * 3, [NAN, NAN, 100.0], 63  # PX4 on the ground
    target = vehicle.reference
    if vehicle.airborne:
        run_s = min(max(body.time_s - target.since_s, 0.0), target.carry_s)
        rows = zip(
            target.position_ned_m,
            target.velocity_ned_m_s,
            target.acceleration_ned_m_s2,
            vehicle.local_origin_ned_m,
            strict=True,
        )
        position, velocity = [], []
        for p, v, a, o in rows:
            position.append(p + v * run_s + 0.5 * a * run_s * run_s - o)
            velocity.append(v + a * run_s)
        acceleration = list(target.acceleration_ned_m_s2)
        placed, moving = all(target.position_used), any(target.velocity_used)
        mask = 0 if placed else 7
        if not px4:
            mask = (0xC00 if moving else 0xDF8) if placed else (0xC07 if moving else 0xC3F)
        elif not placed:
            position = [NAN] * 3
    names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz")
    fields: Fields = dict(zip(names, (*position, *velocity, *acceleration), strict=True))
    yaw = target.yaw_rad if px4 and target.yaw_rad is not None else 0.0  # ArduPilot always says 0
    return fields | {"time_boot_ms": _ms(body), "coordinate_frame": 1, "type_mask": mask, "yaw": yaw, "yaw_rate": 0.0}


def _vfr_hud(vehicle: Autopilot, body: Body) -> Fields:
    v = body.velocity_m_s
    speed_m_s = math.hypot(v[0], v[1])
    return {
        "airspeed": NAN if vehicle.profile.is_px4 else speed_m_s,
        "groundspeed": speed_m_s,
        "heading": round(math.degrees(body.yaw_rad)) % 360,
        "throttle": 48 if vehicle.airborne else 0,
        "alt": vehicle.world.origin.altitude_m - body.position_m[2],
        "climb": -v[2],
    }


def _extended_sys_state(vehicle: Autopilot, body: Body) -> Fields:
    return {"vtol_state": 0, "landed_state": int(vehicle.landed)}


def _home_position(vehicle: Autopilot, body: Body) -> Fields | None:
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
        "q": [1.0, 0.0, 0.0, 0.0] if vehicle.profile.is_px4 else [NAN] * 4,
        "approach_x": 0.0,
        "approach_y": 0.0,
        "approach_z": 0.0,
        "time_usec": _us(body),
    }


def _gps_global_origin(vehicle: Autopilot, body: Body) -> Fields | None:
    if not vehicle.origin_set:
        return None
    point = vehicle.world.geodetic(*vehicle.local_origin_ned_m)
    return {
        "latitude": round(point.latitude_deg * 1e7),
        "longitude": round(point.longitude_deg * 1e7),
        "altitude": round(point.altitude_m * 1e3),
        "time_usec": _us(body),
    }


def _current_mode(vehicle: Autopilot, body: Body) -> Fields | None:
    if not vehicle.profile.is_px4:
        return None
    standard = {"TAKEOFF": 8, "LAND": 7, "RTL": 5}.get(vehicle.mode.name, 0)  # MAV_STANDARD_MODE as PX4 sends it
    return {
        "standard_mode": standard,
        "custom_mode": vehicle.mode.number,
        "intended_custom_mode": vehicle.intended.number,
    }


def _battery_status(vehicle: Autopilot, body: Body) -> Fields:
    return {
        "id": 0,
        "battery_function": 0,
        "type": 0,
        "temperature": 32767,
        "voltages": [CELLS_MV] * 4 + [NO_CELL] * 6,
        "current_battery": 1500 if vehicle.armed else 50,
        "current_consumed": -1,
        "energy_consumed": -1,
        "battery_remaining": battery_percent(vehicle),
    }


def _altitude(vehicle: Autopilot, body: Body) -> Fields | None:
    if not vehicle.profile.is_px4:
        return None
    amsl_m = vehicle.world.origin.altitude_m - body.position_m[2]
    return {
        "time_usec": _us(body),
        "altitude_monotonic": amsl_m,
        "altitude_amsl": amsl_m,
        "altitude_local": -local_m(vehicle, body)[2],
        "altitude_relative": vehicle.home_ned_m[2] - body.position_m[2],
        "altitude_terrain": NAN,
        "bottom_clearance": NAN,
    }


def _mission_current(vehicle: Autopilot, body: Body) -> Fields:
    return {"seq": 0, "total": 65535, "mission_state": 1, "mission_mode": 2}


def _estimator_status(vehicle: Autopilot, body: Body) -> Fields:
    ratios = ("vel", "pos_horiz", "pos_vert", "mag", "hagl")
    return {
        "time_usec": _us(body),
        "flags": 0x33F if vehicle.ready else 0xA7,
        **{f"{name}_ratio": 0.1 for name in ratios},
        "tas_ratio": NAN,
        "pos_horiz_accuracy": 0.3,
        "pos_vert_accuracy": 0.5,
    }


def _ekf_status_report(vehicle: Autopilot, body: Body) -> Fields | None:
    if vehicle.profile.is_px4:
        return None
    names = ("velocity", "pos_horiz", "pos_vert", "compass", "terrain_alt")
    return {"flags": 0x33F if vehicle.ready else 0xA7, **{f"{name}_variance": 0.01 for name in names}}


def _autopilot_version(vehicle: Autopilot, body: Body) -> Fields:
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
        "uid": 0x5349544C,  # the same for all vehicles, as on one machine with the real ones
    }


# Every message that can be streamed or requested: name -> message id, builder.
BUILDERS: Mapping[str, tuple[int, Builder]] = MappingProxyType(
    {
        "HEARTBEAT": (0, _heartbeat),
        "SYS_STATUS": (1, _sys_status),
        "SYSTEM_TIME": (2, _system_time),
        "GPS_RAW_INT": (24, _gps_raw_int),
        "ATTITUDE": (30, _attitude),
        "ATTITUDE_QUATERNION": (31, _attitude_quaternion),
        "LOCAL_POSITION_NED": (32, _local_position_ned),
        "GLOBAL_POSITION_INT": (33, _global_position_int),
        "MISSION_CURRENT": (42, _mission_current),
        "GPS_GLOBAL_ORIGIN": (49, _gps_global_origin),
        "VFR_HUD": (74, _vfr_hud),
        "POSITION_TARGET_LOCAL_NED": (85, _position_target_local_ned),
        "ALTITUDE": (141, _altitude),
        "BATTERY_STATUS": (147, _battery_status),
        "AUTOPILOT_VERSION": (148, _autopilot_version),
        "EKF_STATUS_REPORT": (193, _ekf_status_report),
        "ESTIMATOR_STATUS": (230, _estimator_status),
        "HOME_POSITION": (242, _home_position),
        "EXTENDED_SYS_STATE": (245, _extended_sys_state),
        "CURRENT_MODE": (436, _current_mode),
    }
)
NAMES: Mapping[int, str] = MappingProxyType({number: name for name, (number, _) in BUILDERS.items()})
# Messages that a real vehicle also streams but this one has nothing to say in: intervals are accepted, nothing is sent.
MUTE_IDS = frozenset(
    {8, 26, 27, 29, 35, 36, 65, 83, 87, 105, 111, 116, 125, 129, 132, 136, 152, 163, 164, 178, 231, 241, 331}
)


def fields_of(name: str, vehicle: Autopilot, body: Body) -> Fields | None:
    """The fields of a message, or None when the vehicle cannot send it now (or at all)."""
    row = BUILDERS.get(name)
    return None if row is None else row[1](vehicle, body)
