"""COMMAND_LONG and COMMAND_INT: from a command's number to what it does and answers.

`COMMANDS` has what every autopilot does; what one does in a way of its own it adds in its profile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.messages import CommandResult, Outgoing, Received, Severity
from sitl_mock.physics.geodesy import Geodetic
from sitl_mock.physics.reference import ALL, Reference
from sitl_mock.protocol.telemetry import NAMES, SILENT_IDS

FORCE_ARM, FORCE_DISARM = 2989.0, 21196.0
CUSTOM_MODE_BIT = 1
# MAV_CMD
NAV_RETURN_TO_LAUNCH, NAV_LAND, NAV_TAKEOFF, DO_SET_MODE, DO_REPOSITION = 20, 21, 22, 176, 192
PREFLIGHT_REBOOT_SHUTDOWN, MISSION_START, COMPONENT_ARM_DISARM = 246, 300, 400
GET_HOME_POSITION, GET_MESSAGE_INTERVAL, SET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 410, 510, 511, 512
REQUEST_AUTOPILOT_CAPABILITIES, DO_SET_GLOBAL_ORIGIN = 520, 611
GLOBAL_ALTITUDE_FRAMES, RELATIVE_ALTITUDE_FRAMES = (0, 5), (3, 6)  # MAV_FRAME


@dataclass(frozen=True, slots=True)
class Command:
    """A command with its sender; `parameters` are the seven, the last three lat [deg], lon [deg], alt if global."""

    number: int
    parameters: tuple[float, float, float, float, float, float, float]
    frame: int | None  # of COMMAND_INT
    system: int
    component: int
    link: int

    def whole(self, index: int) -> int | None:
        """A parameter (1-7) as integer; None when it is no number."""
        value = self.parameters[index - 1]
        return int(value) if math.isfinite(value) and abs(value) < 2**53 else None  # 2**53: exact in a float


Handler = Callable[[Autopilot, Command], CommandResult | None]


def command_of(message: Received, link: int) -> Command:
    """Read a COMMAND_LONG or COMMAND_INT."""
    f = message.fields
    first = (float(f["param1"]), float(f["param2"]), float(f["param3"]), float(f["param4"]))
    if message.name == "COMMAND_INT":
        last = (f["x"] / 1e7, f["y"] / 1e7, float(f["z"]))
        frame: int | None = int(f["frame"])
    else:
        last = (float(f["param5"]), float(f["param6"]), float(f["param7"]))
        frame = None
    return Command(int(f["command"]), first + last, frame, message.system, message.component, link)


def acknowledgement(command: Command, result: CommandResult) -> Outgoing:
    """COMMAND_ACK to the sender, on the link of the command."""
    fields = {
        "command": command.number,
        "result": int(result),
        "progress": 0,
        "result_param2": 0,
        "target_system": command.system,
        "target_component": command.component,
    }
    return Outgoing("COMMAND_ACK", fields, command.link)


def change_mode_to(name: str, text: str = "") -> Handler:
    """Handle a command that changes to a mode, with a status text."""

    def handler(vehicle: Autopilot, command: Command) -> CommandResult | None:
        vehicle.send_text(text, Severity.INFO)
        return vehicle.set_mode(vehicle.modes[name])

    return handler


def reposition_in(name: str) -> Handler:
    """DO_REPOSITION by COMMAND_INT: a position to hold, in a mode."""

    def handler(vehicle: Autopilot, command: Command) -> CommandResult | None:
        if command.frame is None:
            return CommandResult.UNSUPPORTED
        latitude_deg, longitude_deg, altitude = command.parameters[4:]
        if not all(map(math.isfinite, (latitude_deg, longitude_deg, altitude))) or abs(latitude_deg) > 90.0:
            return CommandResult.DENIED
        base_m = 0.0 if command.frame in GLOBAL_ALTITUDE_FRAMES else vehicle.world.origin.altitude_m
        place = vehicle.world.ned_m(Geodetic(latitude_deg, longitude_deg, altitude + base_m))
        result = vehicle.set_mode(vehicle.modes[name])
        vehicle.guidance.go_to(Reference(place, position_used=ALL, yaw_rad=vehicle.body.yaw_rad))
        return result

    return handler


def _set_interval(vehicle: Autopilot, command: Command) -> CommandResult | None:
    number, interval_us = command.whole(1), command.parameters[1]
    intervals, link, now_s = vehicle.profile.intervals, vehicle.links[command.link], vehicle.now_s
    name = NAMES.get(number) if number is not None else None
    if name is None:
        if number in SILENT_IDS - intervals.refused_ids:
            return CommandResult.ACCEPTED
        vehicle.send_text(vehicle.profile.texts.unknown_message.format(id=number))
        return intervals.unknown
    if name == "HEARTBEAT" and not intervals.heartbeat_settable:
        return CommandResult.FAILED
    if not math.isfinite(interval_us) or interval_us < -1.0:
        return CommandResult.DENIED
    if interval_us <= 0.0:
        link.set_interval(name, link.default_period_s(name) if interval_us == 0.0 else None, now_s)
        return CommandResult.ACCEPTED
    period_s = interval_us * 1e-6
    if intervals.step_s:
        period_s = math.floor(interval_us / 1e3) * intervals.step_s  # cut to whole milliseconds
    if period_s < intervals.fastest_s:
        if not intervals.capped:
            vehicle.send_text(f"Requested rate for message ID {number} too fast. Increase SCHED_LOOP_RATE")
            return CommandResult.DENIED
        period_s = intervals.fastest_s
    link.set_interval(name, period_s, now_s)
    return CommandResult.ACCEPTED


def _get_interval(vehicle: Autopilot, command: Command) -> CommandResult | None:
    number = command.whole(1)
    name = NAMES.get(number) if number is not None else None
    interval_us, result = vehicle.profile.intervals.unknown_query
    if name is not None:
        period_s = vehicle.links[command.link].period_s(name)
        interval_us, result = -1 if period_s is None else round(period_s * 1e6), CommandResult.ACCEPTED
    fields = {"message_id": (number or 0) & 0xFFFF, "interval_us": interval_us}
    vehicle.send("MESSAGE_INTERVAL", fields, command.link)
    return result


def _request_message(vehicle: Autopilot, command: Command) -> CommandResult | None:
    number = command.whole(1)
    name = NAMES.get(number) if number is not None else None
    if name is None:
        return CommandResult.ACCEPTED if number in SILENT_IDS else vehicle.profile.intervals.unknown_request
    vehicle.outbox.append(acknowledgement(command, CommandResult.ACCEPTED))
    vehicle.send(name, None, command.link)  # nothing, if it cannot be sent now
    return None


def _request_fixed(name: str) -> Handler:
    """Handle an old command that asks for one certain message."""

    def handler(vehicle: Autopilot, command: Command) -> CommandResult | None:
        vehicle.outbox.append(acknowledgement(command, CommandResult.ACCEPTED))
        vehicle.send(name, None, command.link)
        return None

    return handler


def set_mode_by_number(vehicle: Autopilot, number: int | None, unknown_text: str = "") -> CommandResult:
    """Change to a custom mode by its number, as HEARTBEAT.custom_mode shows it."""
    mode = next((m for m in vehicle.profile.modes if m.number == number), None)
    if mode is None:
        vehicle.send_text(unknown_text)
        return vehicle.profile.refused_mode
    if not vehicle.booted:
        return CommandResult.ACCEPTED  # measured: acknowledged while booting, and lost
    return vehicle.set_mode(mode)


COMMANDS: Mapping[int, Handler] = MappingProxyType(
    {
        GET_HOME_POSITION: _request_fixed("HOME_POSITION"),
        GET_MESSAGE_INTERVAL: _get_interval,
        SET_MESSAGE_INTERVAL: _set_interval,
        REQUEST_MESSAGE: _request_message,
        REQUEST_AUTOPILOT_CAPABILITIES: _request_fixed("AUTOPILOT_VERSION"),
    }
)
