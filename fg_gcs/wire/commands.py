"""What vehicles are asked to do: each request harmless when it arrives twice, its effect told by telemetry."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import VehicleError
from fg_gcs.wire import params
from fg_gcs.wire.autopilots import TakeOff
from fg_gcs.wire.codec import Message
from fg_gcs.wire.dialogue import Answer, Request
from fg_gcs.wire.reading import parameter_refusal, read
from fg_gcs.wire.vehicle import ARMING, Vehicle

_AUTOPILOT: Final[int] = dialect.MAV_COMP_ID_AUTOPILOT1
_REFUSALS: Final = {
    dialect.MAV_RESULT_TEMPORARILY_REJECTED: "temporarily rejected",  # PX4's way
    dialect.MAV_RESULT_DENIED: "denied",
    dialect.MAV_RESULT_UNSUPPORTED: "unsupported",
    dialect.MAV_RESULT_FAILED: "failed",  # ArduPilot's way
    6: "cancelled",  # MAV_RESULT_CANCELLED, which this dialect module does not name
}
_IN_AIR_SHARE: Final = 0.9  # of the height asked for: counts as taken off before the vehicle itself says so
_LIFTED_M: Final = 0.3  # a vehicle this high has lifted off
_STILL_FLYING_S: Final = 1.0  # PX4 "temporarily" rejects disarming in the air: it is to be landed, and soon
_SPOOL_UP_S: Final = 5.0  # lift-off comes up to 3.3 s after the command; asked again sooner, it might begin anew
_IN_FLIGHT_S: Final = 3.0  # a take-off is refused in the air as well, and telemetry may be late to say which it was
_SAME_RATE: Final = (0.8, 1.25)  # of the interval asked for: ArduPilot cuts intervals to whole milliseconds
_VERSION_S: Final = 5.0  # ten questions: of what is only good to know, on a link that loses a fifth both ways
_STREAM_PATIENCE_S: Final = 6.0  # a dozen questions: then not all that were to set the stream can have been lost


def heartbeat() -> Message:
    """Return the heartbeat of a ground station; autopilots want one a second."""
    message: Message = dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
    )
    return message


def arm() -> Request:
    """Arm; done when the heartbeat says so (ArduPilot: up to 1 s later, unless its heartbeats were made faster)."""
    return Request(
        ARMING,
        build=lambda vehicle: [_command(vehicle, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)],
        satisfied=lambda vehicle, since_s: vehicle.armed,
        answered=_acknowledgement_of(dialect.MAV_CMD_COMPONENT_ARM_DISARM),
        answered_by=dialect.MAV_CMD_COMPONENT_ARM_DISARM,
    )


def disarm() -> Request:
    """Disarm; refused in the air, and nothing here forces it: the vehicle would fall.

    A vehicle that was asked to arm a moment ago may do so yet: it counts as disarmed when it says so after that.
    """
    return Request(
        "disarm",
        build=lambda vehicle: [_command(vehicle, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)],
        satisfied=lambda vehicle, since_s: not vehicle.may_be_armed,
        answered=_acknowledgement_of(dialect.MAV_CMD_COMPONENT_ARM_DISARM),
        answered_by=dialect.MAV_CMD_COMPONENT_ARM_DISARM,
        temporary_s=_STILL_FLYING_S,
    )


def set_mode(mode: int) -> Request:
    """Change the custom mode; done when HEARTBEAT or CURRENT_MODE shows it, whatever the acknowledgements say."""
    return Request(
        "change its mode",
        build=lambda vehicle: [_mode_command(vehicle, mode)],
        satisfied=lambda vehicle, since_s: vehicle.mode == mode,
        answered=_acknowledgement_of(dialect.MAV_CMD_DO_SET_MODE),
        answered_by=dialect.MAV_CMD_DO_SET_MODE,
        new_mode=lambda vehicle: mode,
    )


def land() -> Request:
    """Land here; done when the vehicle is in its land mode or no longer armed: landing itself takes its time."""

    def command(vehicle: Vehicle) -> int:
        by_command = vehicle.profile.lands_by_command
        number: int = dialect.MAV_CMD_NAV_LAND if by_command else dialect.MAV_CMD_DO_SET_MODE
        return number

    def build(vehicle: Vehicle) -> Sequence[Message]:
        if vehicle.profile.lands_by_command:
            return [_command(vehicle, dialect.MAV_CMD_NAV_LAND)]
        return [_mode_command(vehicle, vehicle.profile.land_mode)]

    return Request(
        "begin to land",
        build=build,
        satisfied=lambda vehicle, since_s: vehicle.mode == vehicle.profile.land_mode or not vehicle.armed,
        answered=lambda vehicle: _acknowledged(vehicle, command(vehicle)),
        answered_by=dialect.MAV_CMD_DO_SET_MODE,
        new_mode=lambda vehicle: vehicle.profile.land_mode,
    )


def take_off(height_m: float, climb_m_s: float = 1.0) -> Request:
    """Take off by NAV_TAKEOFF; done when the vehicle is in the air: landed state IN_AIR, or 90 % of the height.

    Only for vehicles that take off by command, armed and in their streaming mode; no setpoint may reach them before
    this is done. It is asked again until it is accepted or the vehicle lifts off; what arrives in the air is refused
    and changes nothing, so a refusal counts only if there is no lift-off for a while.

    Args:
        height_m: Height above home [m], positive.
        climb_m_s: Slowest climb to expect [m/s]; gives the deadline.

    Raises:
        VehicleError: The height is not a positive number (NaN kills ArduCopter).
    """
    if not 0.0 < height_m < math.inf:
        raise VehicleError(f"take-off height must be a positive number of metres, not {height_m}")

    def build(vehicle: Vehicle) -> Sequence[Message]:
        if vehicle.profile.take_off is not TakeOff.BY_COMMAND:
            raise VehicleError(
                f"vehicle {vehicle.address} has no take-off command: {vehicle.profile.name} takes off by setpoints"
            )
        return [_command(vehicle, dialect.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m)]

    def satisfied(vehicle: Vehicle, since_s: float) -> bool:
        climbed = vehicle.height_m is not None and vehicle.height_m >= _IN_AIR_SHARE * height_m
        return climbed or vehicle.landed_state == dialect.MAV_LANDED_STATE_IN_AIR

    def answered(vehicle: Vehicle) -> Answer | None:
        said = _acknowledged(vehicle, dialect.MAV_CMD_NAV_TAKEOFF)
        return None if said is None or (said.refusal and _has_lifted_off(vehicle)) else said

    spool_up_s = 15.0  # motors need 1 to 3 s; the rest is for a slow machine, and for losses
    return Request(
        "take off",
        build=build,
        satisfied=satisfied,
        answered=answered,
        answered_by=dialect.MAV_CMD_NAV_TAKEOFF,
        impossible=lambda vehicle: "" if vehicle.armed else "it disarmed before lift-off",
        begun=_has_lifted_off,
        patience_s=_IN_FLIGHT_S,
        rest_s=_SPOOL_UP_S,
        deadline_s=spool_up_s + height_m / climb_m_s,
    )


def request_message(message_id: int) -> Request:
    """Ask for one message; done when it has come."""
    return Request(
        f"send message {message_id}",
        build=lambda vehicle: [_command(vehicle, dialect.MAV_CMD_REQUEST_MESSAGE, float(message_id))],
        satisfied=lambda vehicle, since_s: vehicle.message_at_s.get(message_id, -math.inf) > since_s,
    )


def request_origin() -> Request:
    """Ask where the vehicle's local frame has its zero (`Vehicle.origin`); there is no answer while it has none."""
    return request_message(dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)


def request_version() -> Request:
    """Ask for the hardware's identity (`Vehicle.uid`); a vehicle need not have one, or know the message."""
    asked = request_message(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    return replace(asked, deadline_s=_VERSION_S, optional=True)


def run_prearm_checks(vehicle: Vehicle) -> Message:
    """Return the wish to be told at once, as texts, what keeps a vehicle from being armed; there is no answer else."""
    return _command(vehicle, dialect.MAV_CMD_RUN_PREARM_CHECKS)


def set_message_interval(message_id: int, rate_hz: float, *, optional: bool = True) -> Request:
    """Ask for a stream; done when the vehicle tells that rate for it, which it is asked for together with the stream.

    Its acknowledgements do not say which stream they mean, so they are not listened to.

    Args:
        message_id: MAVLink message id.
        rate_hz: Rate [Hz]; negative switches the stream off.
        optional: A refusal does no harm.
    """
    interval_us = round(1e6 / rate_hz) if rate_hz > 0.0 else -1

    def build(vehicle: Vehicle) -> Sequence[Message]:
        return [
            _command(vehicle, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, float(message_id), float(interval_us)),
            _command(vehicle, dialect.MAV_CMD_GET_MESSAGE_INTERVAL, float(message_id)),
        ]

    def is_meant(told_us: int) -> bool:
        if interval_us < 0:
            return told_us <= 0
        return _SAME_RATE[0] * interval_us <= told_us <= _SAME_RATE[1] * interval_us

    def satisfied(vehicle: Vehicle, since_s: float) -> bool:
        told = vehicle.intervals.get(message_id)
        return told is not None and told.at_s > since_s and is_meant(told.interval_us)

    def answered(vehicle: Vehicle) -> Answer | None:
        told = vehicle.intervals.get(message_id)
        if told is None:
            return None
        instead = f"sends it every {told.interval_us} us" if told.interval_us > 0 else "does not send it"
        return Answer(told.at_s, "" if is_meant(told.interval_us) else f"it {instead}")

    return Request(
        f"change the interval of message {message_id}",
        build=build,
        satisfied=satisfied,
        answered=answered,
        answered_by=("interval", message_id),
        patience_s=_STREAM_PATIENCE_S,
        optional=optional,
    )


def write_parameter(name: str, value: float) -> Request:
    """Set one parameter; done when the vehicle reports that value.

    PX4 wants the right type, so a parameter that was not heard of yet is read first.
    """

    def build(vehicle: Vehicle) -> Sequence[Message]:
        param_type = vehicle.param_types.get(name)
        if param_type is None:
            return [read(vehicle, name)]
        carried = params.encode(name, value, param_type, vehicle.profile.encoding)
        return [
            dialect.MAVLink_param_set_message(vehicle.system_id, _AUTOPILOT, name.encode(), carried, param_type),
        ]

    def satisfied(vehicle: Vehicle, since_s: float) -> bool:
        return vehicle.param_at_s.get(name, -math.inf) > since_s and params.same(vehicle.params[name], value)

    def answered(vehicle: Vehicle) -> Answer | None:
        said = vehicle.param_errors.get(name)
        return None if said is None else Answer(said.at_s, parameter_refusal(vehicle, name, -math.inf))

    return Request(
        f"set its parameter {name} to {value:g}",
        build,
        satisfied,
        answered,
        answered_by=("parameter", name),
    )


def _acknowledgement_of(command: int) -> Callable[[Vehicle], Answer | None]:
    return lambda vehicle: _acknowledged(vehicle, command)


def _acknowledged(vehicle: Vehicle, command: int) -> Answer | None:
    """Return the newest acknowledgement: PX4 accepts a mode change blindly before it tells the truth."""
    ack = vehicle.acks.get(command)
    if ack is None:
        return None
    temporary = ack.result == dialect.MAV_RESULT_TEMPORARILY_REJECTED
    return Answer(ack.at_s, _REFUSALS.get(ack.result, ""), temporary)


def _has_lifted_off(vehicle: Vehicle) -> bool:
    return vehicle.airborne or (vehicle.height_m is not None and vehicle.height_m > _LIFTED_M)


def _command(vehicle: Vehicle, command: int, *parameters: float) -> Message:
    padded = (*parameters, *([0.0] * (7 - len(parameters))))
    message: Message = dialect.MAVLink_command_long_message(vehicle.system_id, _AUTOPILOT, command, 0, *padded)
    return message


def _mode_command(vehicle: Vehicle, mode: int) -> Message:
    """DO_SET_MODE: PX4 takes main and sub mode apart, ArduPilot's modes are small numbers without a sub mode."""
    main, sub = (mode >> 16 & 0xFF, mode >> 24) if mode > 0xFFFF else (mode, 0)
    custom = float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
    return _command(vehicle, dialect.MAV_CMD_DO_SET_MODE, custom, float(main), float(sub))
