"""ArduCopter 4.7 as its SITL answers and flies: what it understands and says, and the whole strategy."""

from __future__ import annotations

import math
from types import MappingProxyType

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.guidance import BodyState
from sitl_mock.autopilot.parameters import WriteRefused
from sitl_mock.autopilot.profile import (
    Behaviour,
)
from sitl_mock.autopilot.setpoints import (
    LETHAL,
)
from sitl_mock.messages import CommandResult, Fields, Outgoing, Received
from sitl_mock.physics.geodesy import Geodetic
from sitl_mock.profiles.ardupilot.profile import PROFILE
from sitl_mock.profiles.ardupilot.rules import ArduPilotRules
from sitl_mock.protocol import commands, services, telemetry
from sitl_mock.protocol.commands import Command
from sitl_mock.protocol.dialect import Dialect, Strategy
from sitl_mock.protocol.rows import ROW_BUILDERS, RowBuilder, gps_raw, vfr_hud

_AUTO_RTL = 27
_READ_S = 0.08  # parameter reads are answered from a 10 Hz task: 63-99 ms
_ALL_STREAMS = 0
_DATA_STREAMS = MappingProxyType(
    {
        2: ("SYS_STATUS", "MISSION_CURRENT", "GPS_RAW_INT"),
        6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
        10: ("ATTITUDE",),
        11: ("VFR_HUD",),
        12: ("SYSTEM_TIME", "BATTERY_STATUS", "EKF_STATUS_REPORT"),
    }
)


def _arm(vehicle: Autopilot, command: Command) -> CommandResult | None:
    arming, code = command.parameters[:2]
    if arming == 1.0:
        return vehicle.arm(force=code == commands.FORCE_ARM)
    if arming == 0.0:
        return vehicle.disarm("command", force=code == commands.FORCE_DISARM)
    return CommandResult.UNSUPPORTED


def _change_mode(vehicle: Autopilot, number: int | None) -> CommandResult:
    if number == _AUTO_RTL:
        return CommandResult.FAILED  # no landing sequence in a mission that is empty
    return commands.set_mode_by_number(vehicle, number, unknown_text=f"No such mode {number}")


def _set_mode(vehicle: Autopilot, command: Command) -> CommandResult | None:
    base, number = command.whole(1), command.whole(2)
    if base is None or not base & commands.CUSTOM_MODE_BIT:
        return CommandResult.DENIED
    return _change_mode(vehicle, number)


def _take_off(vehicle: Autopilot, command: Command) -> CommandResult | None:
    if command.frame is not None and command.frame not in commands.RELATIVE_ALTITUDE_FRAMES:
        return CommandResult.DENIED
    height_m = command.parameters[6]
    if not math.isfinite(height_m):
        vehicle.send_text(LETHAL)
        return CommandResult.FAILED
    return vehicle.rules.take_off(vehicle, height_m - vehicle.home_ned_m[2])


def _set_origin(vehicle: Autopilot, command: Command) -> CommandResult | None:
    latitude_deg, longitude_deg, altitude_m = command.parameters[4:]
    if command.frame is None or not all(map(math.isfinite, (latitude_deg, longitude_deg, altitude_m))):
        return CommandResult.FAILED
    done = vehicle.set_origin(vehicle.world.ned_m(Geodetic(latitude_deg, longitude_deg, altitude_m)))
    return CommandResult.ACCEPTED if done else CommandResult.FAILED


def _heartbeat(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if message.system == vehicle.parameters["MAV_GCS_SYSID"]:
        vehicle.gcs_heard_at_s = now_s


def _request_data_stream(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not services.addressed(vehicle, message, system_0=True):
        return
    number, rate_hz = message.fields["req_stream_id"], message.fields["req_message_rate"]
    period_s = 1.0 / rate_hz if message.fields["start_stop"] and rate_hz else None
    groups = _DATA_STREAMS.values() if number == _ALL_STREAMS else (_DATA_STREAMS.get(number, ()),)
    for group in groups:
        for name in group:
            vehicle.links[link].set_interval(name, period_s, now_s)


def _read_parameter(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not services.parameters_addressed(vehicle, message):
        return
    name = services.requested_parameter(vehicle, message)
    if name in vehicle.parameters:
        answer = vehicle.parameters.message(name, indexed=message.fields["param_index"] >= 0)
        vehicle.send_later(now_s + _READ_S, Outgoing("PARAM_VALUE", answer, link))


def _set_parameter(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not services.parameters_addressed(vehicle, message):
        return
    f = message.fields
    name = f["param_id"]
    try:
        vehicle.parameters.write(name, f["param_value"], f["param_type"])
    except WriteRefused:
        return  # in silence
    vehicle.send("PARAM_VALUE", vehicle.parameters.message(name, indexed=False), link)
    if name == vehicle.profile.system_id_parameter:
        vehicle.system_id = min(max(int(vehicle.parameters[name]), 1), 255)  # at once


def _position_target(vehicle: Autopilot, body: BodyState) -> Fields | None:
    if not vehicle.airborne or vehicle.mode.behaviour is not Behaviour.FOLLOW:
        return None
    target = telemetry.running_target(vehicle, body)
    placed_mask, unplaced_mask = (0xC00, 0xC07) if target.moving else (0xDF8, 0xC3F)
    mask = placed_mask if target.placed else unplaced_mask
    axes = (*target.position_m, *target.velocity_m_s, *target.acceleration_m_s2)
    return telemetry.position_target(body, axes, mask, yaw_rad=0.0)  # whatever the heading is


def _ekf_status_report(vehicle: Autopilot, body: BodyState) -> Fields:
    names = ("velocity", "pos_horiz", "pos_vert", "compass", "terrain_alt")
    return {"flags": 0x33F if vehicle.ready else 0xA7, **{f"{name}_variance": 0.01 for name in names}}


STRATEGY = Strategy(
    ArduPilotRules(PROFILE),
    Dialect(
        messages=MappingProxyType(
            dict(services.MESSAGES)
            | {
                "HEARTBEAT": _heartbeat,
                "SET_MODE": services.set_mode_with(_change_mode),
                "REQUEST_DATA_STREAM": _request_data_stream,
                "PARAM_REQUEST_READ": _read_parameter,
                "PARAM_SET": _set_parameter,
            }
        ),
        commands=MappingProxyType(
            dict(commands.COMMANDS)
            | {
                commands.NAV_RETURN_TO_LAUNCH: commands.change_mode_to("RTL"),
                commands.NAV_LAND: commands.change_mode_to("LAND"),
                commands.NAV_TAKEOFF: _take_off,
                commands.DO_SET_MODE: _set_mode,
                commands.DO_REPOSITION: commands.reposition_in("GUIDED"),
                commands.COMPONENT_ARM_DISARM: _arm,
                commands.DO_SET_GLOBAL_ORIGIN: _set_origin,
            }
        ),
        used_parameters=MappingProxyType({}),
        fixed_results=MappingProxyType(
            # Rebooting for real is not modelled.
            dict.fromkeys((178, 179, 193, commands.PREFLIGHT_REBOOT_SHUTDOWN), CommandResult.ACCEPTED)
            | {commands.MISSION_START: CommandResult.FAILED}
        ),
        builders=MappingProxyType(
            dict(telemetry.BUILDERS)
            | {"POSITION_TARGET_LOCAL_NED": _position_target, "EKF_STATUS_REPORT": _ekf_status_report}
        ),
        row_builders=MappingProxyType(
            dict(ROW_BUILDERS)
            | {
                "GPS_RAW_INT": RowBuilder(gps_raw(fix_type=6)),
                "VFR_HUD": RowBuilder(vfr_hud(airspeed_measured=True)),
            }
        ),
    ),
)
