"""Requests and their dialogues: ask, ask again, and believe the telemetry rather than the acknowledgement."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import VehicleError
from fg_gcs.wire import params
from fg_gcs.wire.autopilots import TakeOff
from fg_gcs.wire.codec import Message
from fg_gcs.wire.vehicle import Vehicle

_AUTOPILOT: Final[int] = dialect.MAV_COMP_ID_AUTOPILOT1
_WARNING: Final[int] = dialect.MAV_SEVERITY_WARNING  # texts up to this severity tell why something was refused
_REFUSALS: Final = {
    dialect.MAV_RESULT_TEMPORARILY_REJECTED: "temporarily rejected",  # PX4's way
    dialect.MAV_RESULT_DENIED: "denied",
    dialect.MAV_RESULT_UNSUPPORTED: "unsupported",
    dialect.MAV_RESULT_FAILED: "failed",  # ArduPilot's way
    6: "cancelled",  # MAV_RESULT_CANCELLED, which this dialect module does not name
}
_PARAMETER_REFUSALS: Final = {
    dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST: "there is no parameter of this name",
    dialect.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE: "the value is out of range",
    dialect.MAV_PARAM_ERROR_PERMISSION_DENIED: "it must not be changed now",
    dialect.MAV_PARAM_ERROR_READ_ONLY: "it is read-only",
}
_REASON_GRACE_S: Final = 0.3  # the texts that say why come up to this much after the refusal (chunks, 20 Hz at most)
_IN_AIR_SHARE: Final = 0.9  # of the height asked for: counts as taken off before the vehicle itself says so


def _no(vehicle: Vehicle, since_s: float) -> str | None:
    """Never refused: the vehicle has no way to say so."""
    return None


@dataclass(frozen=True, slots=True)
class Request:
    """One thing to get a vehicle to do.

    Attributes:
        name: What the vehicle is to do, in the words that follow "did not".
        build: Message to send, for the vehicle as it is now.
        satisfied: Telemetry shows that it is so; the second argument is when the first message left [s].
        refused: Reason why it will not be, None while it still may.
        new_mode: The mode that the vehicle will change to, None if it stays.
        resend_s: Send again after this long without success [s].
        deadline_s: Give up after this long [s].
        optional: A refusal does no harm: the dialogue counts as done.
    """

    name: str
    build: Callable[[Vehicle], Message]
    satisfied: Callable[[Vehicle, float], bool]
    refused: Callable[[Vehicle, float], str | None] = _no
    new_mode: Callable[[Vehicle], int] | None = None
    resend_s: float = 1.0
    deadline_s: float = 5.0
    optional: bool = False


class State(Enum):
    """How a dialogue stands."""

    PENDING = "pending"
    DONE = "done"
    REFUSED = "refused"
    TIMED_OUT = "timed out"


class Dialogue:
    """Runs one request with one vehicle; knows no clock: call `step` often (every 20 ms is plenty).

    Attributes:
        state: How it stands.
        reason: One line for people when it was refused or timed out; also kept when the request was optional.
    """

    def __init__(self, vehicle: Vehicle, request: Request) -> None:
        self.vehicle, self.request = vehicle, request
        self.state = State.PENDING
        self.reason = ""
        self._began_s: float | None = None
        self._sent_s = -math.inf
        self._refused_s: float | None = None

    def step(self, now_s: float) -> Message | None:
        """Compare with the vehicle's telemetry; return the message to send now, if any.

        The first step always sends, even if the telemetry already shows success: it may be a second old.

        Raises:
            VehicleError: This autopilot cannot be asked that (see `take_off`).
            UnsafeParameter: The value cannot be sent (see `write_parameter`).
        """
        if self.state is not State.PENDING:
            return None
        if self._began_s is None:
            self._began_s = now_s
            if self.request.new_mode is not None:
                self.vehicle.command_mode(self.request.new_mode(self.vehicle))
            return self._send(now_s)
        if self.request.satisfied(self.vehicle, self._began_s):
            self.state = State.DONE
        elif (refusal := self.request.refused(self.vehicle, self._began_s)) is not None:
            self._wait_for_reason(refusal, now_s)
        elif now_s - self._began_s >= self.request.deadline_s:
            self._finish(State.TIMED_OUT, f" within {self.request.deadline_s:g} s")
        elif now_s - self._sent_s >= self.request.resend_s:
            return self._send(now_s)
        return None

    def _send(self, now_s: float) -> Message:
        self._sent_s = now_s
        return self.request.build(self.vehicle)

    def _wait_for_reason(self, refusal: str, now_s: float) -> None:
        if self._refused_s is None:
            self._refused_s = now_s
        if now_s - self._refused_s >= _REASON_GRACE_S:
            self._finish(State.REFUSED, f": {refusal}")

    def _finish(self, state: State, how: str) -> None:
        began_s = self._began_s if self._began_s is not None else -math.inf
        said = [text.text for text in self.vehicle.recent_texts if text.at_s >= began_s and text.severity <= _WARNING]
        self.reason = f"vehicle {self.vehicle.address} did not {self.request.name}{how}"
        if said:
            self.reason += f" ({'; '.join(dict.fromkeys(said))})"
        self.state = State.DONE if self.request.optional else state


def heartbeat() -> Message:
    """Return the heartbeat of a ground station; autopilots want one a second."""
    message: Message = dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
    )
    return message


def arm() -> Request:
    """Arm; done when the heartbeat says so (ArduPilot: up to 1 s later, unless its heartbeats were made faster)."""
    return Request(
        "arm",
        build=lambda vehicle: _command(vehicle, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0),
        satisfied=lambda vehicle, since_s: vehicle.armed,
        refused=_refusal_of(dialect.MAV_CMD_COMPONENT_ARM_DISARM),
    )


def disarm() -> Request:
    """Disarm; refused in the air, and nothing here forces it: the vehicle would fall."""
    return Request(
        "disarm",
        build=lambda vehicle: _command(vehicle, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0),
        satisfied=lambda vehicle, since_s: not vehicle.armed,
        refused=_refusal_of(dialect.MAV_CMD_COMPONENT_ARM_DISARM),
    )


def set_mode(mode: int) -> Request:
    """Change the custom mode; done when HEARTBEAT or CURRENT_MODE shows it, whatever the acknowledgements say."""
    return Request(
        "change its mode",
        build=lambda vehicle: _mode_command(vehicle, mode),
        satisfied=lambda vehicle, since_s: vehicle.mode == mode,
        refused=_refusal_of(dialect.MAV_CMD_DO_SET_MODE),
        new_mode=lambda vehicle: mode,
    )


def land() -> Request:
    """Land here; done when the vehicle is in its land mode or no longer armed: landing itself takes its time."""

    def build(vehicle: Vehicle) -> Message:
        if vehicle.profile.lands_by_command:
            return _command(vehicle, dialect.MAV_CMD_NAV_LAND)
        return _mode_command(vehicle, vehicle.profile.land_mode)

    def refused(vehicle: Vehicle, since_s: float) -> str | None:
        by_command = vehicle.profile.lands_by_command
        command = dialect.MAV_CMD_NAV_LAND if by_command else dialect.MAV_CMD_DO_SET_MODE
        return _refusal_of(command)(vehicle, since_s)

    return Request(
        "begin to land",
        build=build,
        satisfied=lambda vehicle, since_s: vehicle.mode == vehicle.profile.land_mode or not vehicle.armed,
        refused=refused,
        new_mode=lambda vehicle: vehicle.profile.land_mode,
    )


def take_off(height_m: float, climb_m_s: float = 1.0) -> Request:
    """Take off by NAV_TAKEOFF; done when the vehicle is in the air: landed state IN_AIR, or 90 % of the height.

    Only for vehicles that take off by command, armed and in their streaming mode; no setpoint may reach them before
    this is done. Once accepted it is not sent again: a second one is refused in the air.

    Args:
        height_m: Height above home [m], positive.
        climb_m_s: Slowest climb to expect [m/s]; gives the deadline.

    Raises:
        VehicleError: The height is not a positive number (NaN kills ArduCopter).
    """
    if not 0.0 < height_m < math.inf:
        raise VehicleError(f"take-off height must be a positive number of metres, not {height_m}")
    refusal = _refusal_of(dialect.MAV_CMD_NAV_TAKEOFF)

    def build(vehicle: Vehicle) -> Message:
        if vehicle.profile.take_off is not TakeOff.BY_COMMAND:
            raise VehicleError(
                f"vehicle {vehicle.address} has no take-off command: {vehicle.profile.name} takes off by setpoints"
            )
        return _command(vehicle, dialect.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m)

    def satisfied(vehicle: Vehicle, since_s: float) -> bool:
        climbed = vehicle.height_m is not None and vehicle.height_m >= _IN_AIR_SHARE * height_m
        return climbed or vehicle.landed_state == dialect.MAV_LANDED_STATE_IN_AIR

    def refused(vehicle: Vehicle, since_s: float) -> str | None:
        return refusal(vehicle, since_s) if vehicle.armed else "it disarmed before lift-off"

    spool_up_s = 10.0  # motors need 1 to 3 s; the rest is for a slow machine
    deadline_s = spool_up_s + height_m / climb_m_s
    return Request("take off", build, satisfied, refused, resend_s=math.inf, deadline_s=deadline_s)


def request_message(message_id: int, *, optional: bool = False) -> Request:
    """Ask for one message; done when it has come."""
    return Request(
        f"send message {message_id}",
        build=lambda vehicle: _command(vehicle, dialect.MAV_CMD_REQUEST_MESSAGE, float(message_id)),
        satisfied=lambda vehicle, since_s: vehicle.message_at_s.get(message_id, -math.inf) > since_s,
        refused=_refusal_of(dialect.MAV_CMD_REQUEST_MESSAGE),
        resend_s=0.5,
        optional=optional,
    )


def request_origin() -> Request:
    """Ask where the vehicle's local frame has its zero (`Vehicle.origin`); refused while it has none."""
    return request_message(dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)


def set_message_interval(message_id: int, rate_hz: float, *, optional: bool = True) -> Request:
    """Ask for a stream; done when accepted (one at a time per vehicle: the answer does not say which stream it means).

    Args:
        message_id: MAVLink message id.
        rate_hz: Rate [Hz]; negative switches the stream off.
        optional: A refusal does no harm.
    """
    interval_us = round(1e6 / rate_hz) if rate_hz > 0.0 else -1
    command = dialect.MAV_CMD_SET_MESSAGE_INTERVAL
    return Request(
        f"change the interval of message {message_id}",
        build=lambda vehicle: _command(vehicle, command, float(message_id), float(interval_us)),
        satisfied=lambda vehicle, since_s: _accepted(vehicle, command, since_s),
        refused=_refusal_of(command),
        resend_s=0.5,
        optional=optional,
    )


def read_parameter(name: str, *, optional: bool = False) -> Request:
    """Read one parameter into `Vehicle.params`; an unknown name is refused by PX4 and met with silence by ArduPilot."""
    return Request(
        f"tell its parameter {name}",
        build=lambda vehicle: _read(vehicle, name),
        satisfied=lambda vehicle, since_s: vehicle.param_at_s.get(name, -math.inf) > since_s,
        refused=_parameter_refusal(name),
        resend_s=0.5,
        deadline_s=3.0,
        optional=optional,
    )


def write_parameter(name: str, value: float) -> Request:
    """Set one parameter; done when the vehicle reports that value.

    PX4 wants the right type, so a parameter that was not heard of yet is read first.
    """

    def build(vehicle: Vehicle) -> Message:
        param_type = vehicle.param_types.get(name)
        if param_type is None:
            return _read(vehicle, name)
        carried = params.encode(name, value, param_type, vehicle.profile.encoding)
        message: Message = dialect.MAVLink_param_set_message(
            vehicle.system_id, _AUTOPILOT, name.encode(), carried, param_type
        )
        return message

    def satisfied(vehicle: Vehicle, since_s: float) -> bool:
        return vehicle.param_at_s.get(name, -math.inf) > since_s and params.same(vehicle.params[name], value)

    return Request(
        f"set its parameter {name} to {value:g}",
        build,
        satisfied,
        _parameter_refusal(name),
        resend_s=0.3,
        deadline_s=5.0,
    )


def _command(vehicle: Vehicle, command: int, *parameters: float) -> Message:
    padded = (*parameters, *([0.0] * (7 - len(parameters))))
    message: Message = dialect.MAVLink_command_long_message(vehicle.system_id, _AUTOPILOT, command, 0, *padded)
    return message


def _mode_command(vehicle: Vehicle, mode: int) -> Message:
    """DO_SET_MODE: PX4 takes main and sub mode apart, ArduPilot's modes are small numbers without a sub mode."""
    main, sub = (mode >> 16 & 0xFF, mode >> 24) if mode > 0xFFFF else (mode, 0)
    custom = float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
    return _command(vehicle, dialect.MAV_CMD_DO_SET_MODE, custom, float(main), float(sub))


def _read(vehicle: Vehicle, name: str) -> Message:
    message: Message = dialect.MAVLink_param_request_read_message(vehicle.system_id, _AUTOPILOT, name.encode(), -1)
    return message


def _accepted(vehicle: Vehicle, command: int, since_s: float) -> bool:
    ack = vehicle.acks.get(command)
    return ack is not None and ack.at_s > since_s and ack.result == dialect.MAV_RESULT_ACCEPTED


def _refusal_of(command: int) -> Callable[[Vehicle, float], str | None]:
    """Judge by the newest acknowledgement: PX4 accepts a mode change blindly before it tells the truth."""

    def refused(vehicle: Vehicle, since_s: float) -> str | None:
        ack = vehicle.acks.get(command)
        return _REFUSALS.get(ack.result) if ack is not None and ack.at_s > since_s else None

    return refused


def _parameter_refusal(name: str) -> Callable[[Vehicle, float], str | None]:
    def refused(vehicle: Vehicle, since_s: float) -> str | None:
        said = vehicle.param_errors.get(name)
        return (
            _PARAMETER_REFUSALS.get(said.error, f"parameter error {said.error}")
            if said is not None and said.at_s > since_s
            else None
        )

    return refused
