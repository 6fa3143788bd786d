"""PX4 1.17 as its SITL answers and flies: what it understands and says, and the whole strategy."""

from __future__ import annotations

import math
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.guidance import BodyState
from sitl_mock.autopilot.parameters import ERROR_NAME, UNINDEXED, WriteRefused
from sitl_mock.autopilot.profile import (
    Behaviour,
)
from sitl_mock.autopilot.setpoints import (
    LOCAL_NED,
)
from sitl_mock.messages import CommandResult, Fields, Outgoing, Received, Severity
from sitl_mock.profiles.px4.profile import PROFILE
from sitl_mock.profiles.px4.rules import Px4Rules, invalid
from sitl_mock.protocol import commands, services, telemetry
from sitl_mock.protocol.commands import Command, acknowledgement
from sitl_mock.protocol.dialect import Dialect, Strategy
from sitl_mock.protocol.layouts import layout
from sitl_mock.protocol.rows import ROW_BUILDERS, RowBuilder, Rows, Scene, gps_raw, local_position, vfr_hud

_MAIN_AUTO = 4
_KNOWN_MAIN_MODES = frozenset(range(1, 9))
_GLOBAL_FRAMES = frozenset({5, 6, 11})  # of SET_POSITION_TARGET_GLOBAL_INT
_UINT32 = 5  # MAV_PARAM_TYPE
_PARAMETER_HASH = 0x5349544C  # `_HASH_CHECK` of a list; constant, since no client compares it here
_ECHO_S = 0.01  # a changed parameter is told a second time, on every link, after the next update


def _arm(vehicle: Autopilot, command: Command) -> CommandResult | None:
    given = command.parameters[0]
    arming = round(given) if math.isfinite(given) and abs(given) < 10 else given
    if given == 0.5:
        arming = 1  # measured: 0.5 counts as 1
    if arming not in (0, 1):
        vehicle.send_text(f"Unsupported ARM_DISARM param: {given:.3f}")
        return None
    code = command.parameters[1]
    if arming == 1:
        return vehicle.arm(force=code in (commands.FORCE_ARM, commands.FORCE_DISARM))
    return vehicle.disarm("command", force=code == commands.FORCE_DISARM)


def _set_mode(vehicle: Autopilot, command: Command) -> CommandResult | None:
    base, main, sub = (command.whole(i) for i in (1, 2, 3))
    if base is None or not base & commands.CUSTOM_MODE_BIT:
        return CommandResult.DENIED
    # The MAVLink receiver acknowledges before the commander decides; the truth comes second.
    vehicle.outbox.append(acknowledgement(command, CommandResult.ACCEPTED))
    if main not in _KNOWN_MAIN_MODES:
        return CommandResult.ACCEPTED  # measured: accepted, nothing happens
    number = main << 16 | ((sub or 0) & 0xFF) << 24
    mode = next((m for m in vehicle.profile.modes if m.number == number), None)
    if mode is None:
        if main == _MAIN_AUTO:
            vehicle.send_text("Unsupported auto mode")
        return CommandResult.TEMPORARILY_REJECTED
    if mode.behaviour is Behaviour.TAKEOFF:
        return _take_off_default(vehicle)
    return vehicle.set_mode(mode)


def _take_off_default(vehicle: Autopilot) -> CommandResult:
    height_m = vehicle.parameters["MIS_TAKEOFF_ALT"]
    vehicle.send_text(f"Using default takeoff altitude: {height_m:.1f} m", Severity.INFO)
    return vehicle.rules.take_off(vehicle, height_m)


def _take_off(vehicle: Autopilot, command: Command) -> CommandResult | None:
    amsl_m = command.parameters[6]
    if not math.isfinite(amsl_m):
        return _take_off_default(vehicle)
    return vehicle.rules.take_off(vehicle, amsl_m - vehicle.world.origin.altitude_m)


def _reboot(vehicle: Autopilot, command: Command) -> CommandResult | None:
    """The simulator goes on."""
    return CommandResult.ACCEPTED if command.parameters[0] == 0.0 else CommandResult.DENIED


def _start_mission(vehicle: Autopilot, command: Command) -> CommandResult | None:
    vehicle.send_text("Mission start denied! No valid mission")
    return CommandResult.DENIED


def _never_answer(vehicle: Autopilot, command: Command) -> CommandResult | None:
    return None


def _heartbeat(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if message.fields["type"] == services.GCS_TYPE:
        vehicle.links[link].texts_open = True
        vehicle.gcs_heard_at_s = now_s


def _setpoint_global(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    frame = int(message.fields["coordinate_frame"])
    if frame in _GLOBAL_FRAMES:
        services.setpoint_global(vehicle, message, link, now_s)
    elif services.addressed(vehicle, message, system_0=True):
        vehicle.act_on(invalid(f"SET_POSITION_TARGET_GLOBAL_INT invalid coordinate frame {frame}"))


def _ping(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    f = message.fields
    if f["target_system"] == 0:
        back = {"target_system": message.system, "target_component": message.component}
        vehicle.send("PING", {"time_usec": f["time_usec"], "seq": f["seq"], **back}, link)


def _list_parameters(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not services.parameters_addressed(vehicle, message):
        return
    services.begin_parameter_list(vehicle, message, link, now_s)
    fields = {
        "param_id": b"_HASH_CHECK",
        "param_value": float(_PARAMETER_HASH & 0x7FFFFF),
        "param_type": _UINT32,
        "param_count": len(vehicle.parameters),
        "param_index": UNINDEXED,
    }
    vehicle.send("PARAM_VALUE", fields, link)


def _read_parameter(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not services.parameters_addressed(vehicle, message):
        return
    name = services.requested_parameter(vehicle, message)
    if name in vehicle.parameters:
        vehicle.send("PARAM_VALUE", vehicle.parameters.message(name, indexed=True), link)
    else:
        _send_parameter_error(vehicle, message, name, link, ERROR_NAME)


def _set_parameter(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not services.parameters_addressed(vehicle, message):
        return
    f = message.fields
    name = f["param_id"]
    try:
        changed = vehicle.parameters.write(name, f["param_value"], f["param_type"])
    except WriteRefused as refusal:
        _send_parameter_error(vehicle, message, name, link, refusal.error)
        return
    answer = vehicle.parameters.message(name, indexed=True)
    vehicle.send("PARAM_VALUE", answer, link)
    if changed:
        vehicle.send_later(now_s + _ECHO_S, Outgoing("PARAM_VALUE", answer))
        if vehicle.manners.parameter_freeze:
            vehicle.freeze()


def _send_parameter_error(vehicle: Autopilot, message: Received, name: str, link: int, error: int) -> None:
    back = {"target_system": message.system, "target_component": message.component}
    fields = {"param_id": name.encode("ascii", "replace"), "param_index": 0, "error": error}
    vehicle.send("PARAM_ERROR", back | fields, link)


def _position_target(scene: Scene, rows: Rows) -> NDArray[np.void]:
    """POSITION_TARGET_LOCAL_NED: the controller's setpoint, run on to the present."""
    commands = scene.commands
    made = layout("POSITION_TARGET_LOCAL_NED").rows(len(rows))
    run_s = np.minimum(np.maximum(scene.time_s - commands.since_s[rows], 0.0), commands.carry_s[rows])[:, None]
    acceleration_m_s2 = commands.acceleration_m_s2[rows]
    velocity_m_s = commands.velocity_m_s[rows] + acceleration_m_s2 * run_s
    moved_m = (commands.velocity_m_s[rows] + 0.5 * acceleration_m_s2 * run_s) * run_s
    most = np.finfo(np.float32).max
    position_m = np.clip(scene.table.local_m(rows, commands.position_m[rows] + moved_m), -most, most)
    flying = commands.flying[rows]
    placed = commands.position_used[rows].all(axis=1) & flying
    on_ground = (math.nan, math.nan, 100.0)  # of acceleration: measured
    for k, axis in enumerate("xyz"):
        made[axis] = np.where(placed, position_m[:, k], math.nan)
        made["v" + axis] = np.where(flying, velocity_m_s[:, k], math.nan)
        made["af" + axis] = np.where(flying, acceleration_m_s2[:, k], on_ground[k])
    made["yaw"] = np.where(commands.yaw_used[rows], commands.yaw_rad[rows], 0.0)
    made["type_mask"] = np.where(flying, np.where(placed, 0, 7), 63)
    made["coordinate_frame"] = LOCAL_NED
    return made


def _current_mode(vehicle: Autopilot, body: BodyState) -> Fields:
    return {
        "standard_mode": vehicle.mode.standard_mode,
        "custom_mode": vehicle.mode.number,
        "intended_custom_mode": vehicle.intended.number,
    }


def _altitude(vehicle: Autopilot, body: BodyState) -> Fields:
    amsl_m = vehicle.world.origin.altitude_m - body.position_m[2]
    return {
        "time_usec": telemetry.boot_us(body),
        "altitude_monotonic": amsl_m,
        "altitude_amsl": amsl_m,
        "altitude_local": -telemetry.local_m(vehicle, body)[2],
        "altitude_relative": vehicle.home_ned_m[2] - body.position_m[2],
        "altitude_terrain": math.nan,
        "bottom_clearance": math.nan,
    }


_UNANSWERED = (203, 205, 206, 242, 420, 500, 521, 530, 1000, 2510, 2511, 3000, 30001, 42600)  # measured
_NO_OPERATIONS = (178, 179, 187, 191, 195, 197, 201, 241, 245, 401, 519, 525, 528, 43003)

# Parameters 1 to 4 that a command has, as bits; of newer versions, which deny the others (its pull request 27541).
_USED_PARAMETERS = MappingProxyType(
    {
        commands.NAV_RETURN_TO_LAUNCH: 0b0000,
        commands.NAV_LAND: 0b1010,
        commands.NAV_TAKEOFF: 0b1000,
        commands.DO_SET_MODE: 0b0111,
        commands.DO_REPOSITION: 0b1111,
        commands.MISSION_START: 0b0011,
        commands.COMPONENT_ARM_DISARM: 0b0011,
        commands.GET_HOME_POSITION: 0b0000,
        commands.GET_MESSAGE_INTERVAL: 0b0001,
        commands.SET_MESSAGE_INTERVAL: 0b0111,
        commands.REQUEST_MESSAGE: 0b1111,
        commands.REQUEST_AUTOPILOT_CAPABILITIES: 0b0001,
    }
)

STRATEGY = Strategy(
    Px4Rules(PROFILE),
    Dialect(
        messages=MappingProxyType(
            dict(services.MESSAGES)
            | {
                "HEARTBEAT": _heartbeat,
                "SET_MODE": services.set_mode_with(commands.set_mode_by_number),
                "SET_POSITION_TARGET_GLOBAL_INT": _setpoint_global,
                "PING": _ping,
                "PARAM_REQUEST_LIST": _list_parameters,
                "PARAM_REQUEST_READ": _read_parameter,
                "PARAM_SET": _set_parameter,
            }
        ),
        commands=MappingProxyType(
            dict(commands.COMMANDS)
            | {
                commands.NAV_RETURN_TO_LAUNCH: commands.change_mode_to("RTL", "Returning to launch"),
                commands.NAV_LAND: commands.change_mode_to("LAND", "Landing at current position"),
                commands.NAV_TAKEOFF: _take_off,
                commands.DO_SET_MODE: _set_mode,
                commands.DO_REPOSITION: commands.reposition_in("LOITER"),
                commands.PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
                commands.MISSION_START: _start_mission,
                commands.COMPONENT_ARM_DISARM: _arm,
            }
            | dict.fromkeys(_UNANSWERED, _never_answer)
        ),
        used_parameters=_USED_PARAMETERS,
        fixed_results=MappingProxyType(
            dict.fromkeys(_NO_OPERATIONS, CommandResult.ACCEPTED)
            | {
                185: CommandResult.DENIED,
                189: CommandResult.CANCELLED,
                211: CommandResult.IN_PROGRESS,
                2600: CommandResult.FAILED,
            }
        ),
        builders=MappingProxyType(
            dict(telemetry.BUILDERS)
            | {
                "CURRENT_MODE": _current_mode,
                "ALTITUDE": _altitude,
            }
        ),
        row_builders=MappingProxyType(
            dict(ROW_BUILDERS)
            | {
                "GPS_RAW_INT": RowBuilder(gps_raw(fix_type=3)),
                "VFR_HUD": RowBuilder(vfr_hud(airspeed_measured=False)),
                "LOCAL_POSITION_NED": RowBuilder(local_position),  # sent before there is a position
                "POSITION_TARGET_LOCAL_NED": RowBuilder(_position_target),
            }
        ),
    ),
)
