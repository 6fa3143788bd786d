"""COMMAND_LONG and COMMAND_INT: one table per autopilot, from a command's number to what it does and answers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.setpoints import LETHAL
from sitl_mock.messages import CommandResult, Outgoing, Received, Severity
from sitl_mock.physics.geodesy import Geodetic
from sitl_mock.physics.reference import ALL, Reference
from sitl_mock.protocol.telemetry import MUTE_IDS, NAMES

FORCE_ARM, FORCE_DISARM = 2989.0, 21196.0
CUSTOM_MODE_BIT = 1
NAV_RTL, NAV_LAND, NAV_TAKEOFF, DO_SET_MODE, DO_REPOSITION, SET_ORIGIN = 20, 21, 22, 176, 192, 611
PX4_MAIN_AUTO = 4
PX4_KNOWN_MAIN_MODES = frozenset(range(1, 9))
GLOBAL_ALTITUDE_FRAMES, RELATIVE_ALTITUDE_FRAMES = (0, 5), (3, 6)  # MAV_FRAME
PROTOCOL_VERSION_ID = 300


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


def execute(vehicle: Autopilot, command: Command) -> None:
    """Do what a command asks and acknowledge it to its sender."""
    table = HANDLERS[vehicle.profile.name]
    handler = table.get(command.number)
    fixed = FIXED_RESULTS[vehicle.profile.name].get(command.number, CommandResult.UNSUPPORTED)
    result = fixed if handler is None else handler(vehicle, command)
    if result is not None:
        vehicle.outbox.append(acknowledgement(command, result))


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


def _arm(vehicle: Autopilot, command: Command) -> CommandResult | None:
    wish = command.parameters[0]
    if vehicle.profile.is_px4:
        wish = round(wish) if math.isfinite(wish) and abs(wish) < 10 else wish
        wish = 1.0 if command.parameters[0] == 0.5 else float(wish)  # measured: 0.5 counts as 1
    if wish not in (0.0, 1.0):
        if not vehicle.profile.is_px4:
            return CommandResult.UNSUPPORTED
        vehicle.say(f"Unsupported ARM_DISARM param: {command.parameters[0]:.3f}")
        return None
    forced = command.parameters[1]
    if wish == 1.0:
        return vehicle.arm(force=forced in (FORCE_ARM, FORCE_DISARM) if vehicle.profile.is_px4 else forced == FORCE_ARM)
    return vehicle.disarm("command", force=forced == FORCE_DISARM)


def _set_mode_px4(vehicle: Autopilot, command: Command) -> CommandResult | None:
    base, main, sub = (command.whole(i) for i in (1, 2, 3))
    if base is None or not base & CUSTOM_MODE_BIT:
        return CommandResult.DENIED
    # The MAVLink receiver acknowledges before the commander looks; the truth comes second.
    vehicle.outbox.append(acknowledgement(command, CommandResult.ACCEPTED))
    if main not in PX4_KNOWN_MAIN_MODES:
        return CommandResult.ACCEPTED  # measured: accepted, nothing happens
    number = main << 16 | ((sub or 0) & 0xFF) << 24
    mode = next((m for m in vehicle.profile.modes if m.number == number), None)
    if mode is None:
        if main == PX4_MAIN_AUTO:
            vehicle.say("Unsupported auto mode")
        return CommandResult.TEMPORARILY_REJECTED
    if mode.name == vehicle.profile.takeoff_mode:
        return _take_off_default(vehicle)
    return vehicle.set_mode(mode)


def _set_mode_ardupilot(vehicle: Autopilot, command: Command) -> CommandResult | None:
    base, number = command.whole(1), command.whole(2)
    if base is None or not base & CUSTOM_MODE_BIT:
        return CommandResult.DENIED
    return set_mode_number(vehicle, number)


def set_mode_number(vehicle: Autopilot, number: int | None) -> CommandResult:
    """Change to a custom mode by its number (DO_SET_MODE of ArduPilot, the SET_MODE message of both)."""
    mode = next((m for m in vehicle.profile.modes if m.number == number), None)
    if mode is None:
        if not vehicle.profile.is_px4:
            vehicle.say(f"No such mode {number}")
        return vehicle.profile.refused_mode
    if mode.name == "AUTO_RTL":
        return CommandResult.FAILED  # no landing sequence in a mission that is empty
    if vehicle.body.time_s < vehicle.boot.standby_s:
        return CommandResult.ACCEPTED  # measured: acknowledged while booting, and lost
    return vehicle.set_mode(mode)


def _take_off_default(vehicle: Autopilot) -> CommandResult:
    height_m = vehicle.parameters["MIS_TAKEOFF_ALT"]
    vehicle.say(f"Using default takeoff altitude: {height_m:.1f} m", Severity.INFO)
    return vehicle.take_off(height_m)


def _take_off_px4(vehicle: Autopilot, command: Command) -> CommandResult | None:
    amsl_m = command.parameters[6]
    if not math.isfinite(amsl_m):
        return _take_off_default(vehicle)
    return vehicle.take_off(amsl_m - vehicle.world.origin.altitude_m)


def _take_off_ardupilot(vehicle: Autopilot, command: Command) -> CommandResult | None:
    if command.frame is not None and command.frame not in RELATIVE_ALTITUDE_FRAMES:
        return CommandResult.DENIED
    height_m = command.parameters[6]
    if not math.isfinite(height_m):
        vehicle.say(LETHAL)
        return CommandResult.FAILED
    return vehicle.take_off(height_m - vehicle.home_ned_m[2])


def _land(vehicle: Autopilot, command: Command) -> CommandResult | None:
    if vehicle.profile.is_px4:
        vehicle.say("Landing at current position", Severity.INFO)
    return vehicle.set_mode(vehicle.modes[vehicle.profile.land_mode])


def _return(vehicle: Autopilot, command: Command) -> CommandResult | None:
    if vehicle.profile.is_px4:
        vehicle.say("Returning to launch", Severity.INFO)
    return vehicle.set_mode(vehicle.modes[vehicle.profile.return_mode])


def _reposition(vehicle: Autopilot, command: Command) -> CommandResult | None:
    """DO_REPOSITION by COMMAND_INT: a position to hold, in LOITER or GUIDED."""
    if command.frame is None:
        return CommandResult.UNSUPPORTED
    latitude_deg, longitude_deg, altitude = command.parameters[4:]
    if not all(map(math.isfinite, (latitude_deg, longitude_deg, altitude))) or abs(latitude_deg) > 90.0:
        return CommandResult.DENIED
    base_m = 0.0 if command.frame in GLOBAL_ALTITUDE_FRAMES else vehicle.world.origin.altitude_m
    place = vehicle.world.ned_m(Geodetic(latitude_deg, longitude_deg, altitude + base_m))
    name = vehicle.profile.hold_mode if vehicle.profile.is_px4 else vehicle.profile.stream_mode
    result = vehicle.set_mode(vehicle.modes[name])
    vehicle.pilot.go_to(Reference(place, position_used=ALL, yaw_rad=vehicle.body.yaw_rad))
    return result


def _set_origin(vehicle: Autopilot, command: Command) -> CommandResult | None:
    """MAV_CMD_DO_SET_GLOBAL_ORIGIN (ArduPilot)."""
    latitude_deg, longitude_deg, altitude_m = command.parameters[4:]
    if command.frame is None or not all(map(math.isfinite, (latitude_deg, longitude_deg, altitude_m))):
        return CommandResult.FAILED
    done = vehicle.set_origin(vehicle.world.ned_m(Geodetic(latitude_deg, longitude_deg, altitude_m)))
    return CommandResult.ACCEPTED if done else CommandResult.FAILED


def _set_interval(vehicle: Autopilot, command: Command) -> CommandResult | None:
    number, wish_us = command.whole(1), command.parameters[1]
    profile, link, now_s = vehicle.profile, vehicle.links[command.link], vehicle.body.time_s
    name = NAMES.get(number) if number is not None else None
    if name is None:
        if number in MUTE_IDS and not (number == 331 and not profile.is_px4):
            return CommandResult.ACCEPTED
        if not profile.is_px4:
            vehicle.say(f"No ap_message for mavlink id ({number})")
        return profile.unknown_interval
    if name == "HEARTBEAT" and not profile.heartbeat_settable:
        return CommandResult.FAILED
    if not math.isfinite(wish_us) or wish_us < -1.0:
        return CommandResult.DENIED
    if wish_us <= 0.0:
        link.set_interval(name, link.default_period_s(name) if wish_us == 0.0 else None, now_s)
        return CommandResult.ACCEPTED
    period_s = wish_us * 1e-6
    if profile.interval_step_s:
        period_s = math.floor(wish_us / 1e3) * profile.interval_step_s  # cut to whole milliseconds
    if period_s < profile.fastest_interval_s:
        if not profile.interval_capped:
            vehicle.say(f"Requested rate for message ID {number} too fast. Increase SCHED_LOOP_RATE")
            return CommandResult.DENIED
        period_s = profile.fastest_interval_s
    link.set_interval(name, period_s, now_s)
    return CommandResult.ACCEPTED


def _get_interval(vehicle: Autopilot, command: Command) -> CommandResult | None:
    number = command.whole(1)
    name = NAMES.get(number) if number is not None else None
    px4 = vehicle.profile.is_px4
    interval_us, result = -1 if px4 else 0, CommandResult.ACCEPTED if px4 else CommandResult.FAILED
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
        known = number in MUTE_IDS
        return CommandResult.ACCEPTED if known else vehicle.profile.unknown_request
    vehicle.outbox.append(acknowledgement(command, CommandResult.ACCEPTED))
    vehicle.send(name, None, command.link)  # nothing, if it cannot be sent now
    return None


def _request_fixed(name: str) -> Handler:
    """An old command that asks for one certain message."""

    def handler(vehicle: Autopilot, command: Command) -> CommandResult | None:
        vehicle.outbox.append(acknowledgement(command, CommandResult.ACCEPTED))
        vehicle.send(name, None, command.link)
        return None

    return handler


def _silent(vehicle: Autopilot, command: Command) -> CommandResult | None:
    return None


def _reboot(vehicle: Autopilot, command: Command) -> CommandResult | None:
    """PX4's simulator goes on. ArduPilot acknowledges; rebooting for real is not modelled."""
    return CommandResult.DENIED if vehicle.profile.is_px4 and command.parameters[0] != 0.0 else CommandResult.ACCEPTED


def _mission_start(vehicle: Autopilot, command: Command) -> CommandResult | None:
    if vehicle.profile.is_px4:
        vehicle.say("Mission start denied! No valid mission")
        return CommandResult.DENIED
    return CommandResult.FAILED


_COMMON: Mapping[int, Handler] = MappingProxyType(
    {
        NAV_RTL: _return,
        NAV_LAND: _land,
        DO_REPOSITION: _reposition,
        246: _reboot,
        300: _mission_start,
        400: _arm,
        410: _request_fixed("HOME_POSITION"),
        510: _get_interval,
        511: _set_interval,
        512: _request_message,
        520: _request_fixed("AUTOPILOT_VERSION"),
    }
)
# Measured: PX4 never answers these.
_PX4_SILENT = (203, 205, 206, 242, 420, 500, 521, 530, 1000, 2510, 2511, 3000, 30001, 42600)

HANDLERS: Mapping[str, Mapping[int, Handler]] = MappingProxyType(
    {
        "px4": MappingProxyType(
            dict(_COMMON)
            | {NAV_TAKEOFF: _take_off_px4, DO_SET_MODE: _set_mode_px4}
            | dict.fromkeys(_PX4_SILENT, _silent)
        ),
        "ardupilot": MappingProxyType(
            dict(_COMMON)
            | {NAV_TAKEOFF: _take_off_ardupilot, DO_SET_MODE: _set_mode_ardupilot, SET_ORIGIN: _set_origin}
        ),
    }
)
_NO_OPERATIONS = (178, 187, 191, 195, 197, 201, 241, 245, 401, 519, 525, 528, 43003)
FIXED_RESULTS: Mapping[str, Mapping[int, CommandResult]] = MappingProxyType(
    {
        "px4": MappingProxyType(
            dict.fromkeys((*_NO_OPERATIONS, 179), CommandResult.ACCEPTED)
            | {
                185: CommandResult.DENIED,
                189: CommandResult.CANCELLED,
                211: CommandResult.IN_PROGRESS,
                2600: CommandResult.FAILED,
            }
        ),
        "ardupilot": MappingProxyType(dict.fromkeys((178, 179, 193), CommandResult.ACCEPTED)),
    }
)
