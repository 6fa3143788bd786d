"""What may differ from one autopilot to the next, as far as it is a number, a name or a text.

The tables themselves are in `sitl_mock.profiles`, one module an autopilot. What an autopilot does in a way of its own
is in `autopilot.Rules`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto

from sitl_mock.autopilot.battery import BatteryProfile
from sitl_mock.messages import CommandResult, SystemStatus


class Behaviour(Enum):
    """What a mode flies."""

    FOLLOW = auto()  # streamed setpoints
    HOLD = auto()  # brake, then stay
    TAKEOFF = auto()
    LAND = auto()
    RETURN = auto()
    SINK = auto()  # a pilot's mode without a pilot: throttle stick missing or at its minimum
    RISE = auto()  # a pilot's mode without a pilot that drifts and climbs away


class Need(Enum):
    """What a mode cannot do without while armed."""

    NOTHING = auto()
    PILOT = auto()
    MISSION = auto()
    STREAM = auto()


class ModeEvent(Enum):
    """What can change a mode by itself, without a command."""

    CLIMBED = auto()  # the take-off height is reached
    DISARMED = auto()
    STREAM_LOST = auto()
    GCS_LOST = auto()
    FAILSAFE_DELAY_OVER = auto()
    BATTERY_LOW = auto()
    BATTERY_CRITICAL = auto()
    BATTERY_EMERGENCY = auto()
    POSITION_LOST = auto()


@dataclass(frozen=True, slots=True)
class Manners:
    """Ways of one autopilot that differ from one version to another; each may be asked for.

    Attributes:
        strict_commands: parameters that a command does not have must be 0 or NaN, else it is denied.
        new_partner: a partner that fell silent is replaced by whoever speaks next.
        parameter_freeze: a changed parameter makes it forget its partner, until something is heard again.
    """

    strict_commands: bool = False
    new_partner: bool = False
    parameter_freeze: bool = False


@dataclass(frozen=True, slots=True)
class FlightMode:
    """One flight mode: its number on the wire and what it does."""

    name: str
    number: int  # HEARTBEAT.custom_mode
    behaviour: Behaviour
    base_mode: int  # MAV_MODE_FLAG without the armed bit
    need: Need = Need.NOTHING
    armable: bool = True
    title: str = ""  # as the autopilot's own texts spell it
    standard_mode: int = 0  # MAV_STANDARD_MODE in CURRENT_MODE


@dataclass(frozen=True, slots=True)
class Boot:
    """Seconds from start to each stage."""

    heartbeat_s: float
    standby_s: float  # commands are obeyed, status leaves BOOT
    origin_s: float  # EKF origin set: GPS_GLOBAL_ORIGIN and HOME_POSITION go out
    ready_s: float  # local position and arm-able


@dataclass(frozen=True, slots=True)
class Texts:
    """Status texts, and who receives them; an empty one is not sent."""

    suffix: str
    need_gcs: bool  # a GCS heartbeat opens the link's texts; else any frame does
    armed: str
    disarmed: Mapping[str, str]  # by the reason for disarming: command, landing, idle, failsafe
    disarming_refused: str = ""
    crashed: str = ""
    takeoff_detected: str = ""
    landing_detected: str = ""
    unknown_message: str = ""  # an interval is asked for a message that the autopilot does not have; {id}


@dataclass(frozen=True, slots=True)
class GroundTimes:
    """How long leaving the ground and coming back to it take, in seconds."""

    spool_s: float  # arming to motors ready
    liftoff_s: float  # asked to climb (motors ready) to first motion, take-off command
    liftoff_stream_s: float  # the same by setpoints
    takeoff_state_s: float  # asked to climb to landed state TAKEOFF
    detection_s: float  # contact to landed state ON_GROUND
    idle_extra_s: float  # idle disarming is later than its parameter says by this


@dataclass(frozen=True, slots=True)
class SpeedParameters:
    """Which parameters hold the speeds and the acceleration that guidance keeps to; times `scale` they are SI."""

    scale: float
    horizontal: str  # of streamed setpoints
    cruise: str  # of the autopilot's own modes
    climb: str
    descent: str
    takeoff: str
    acceleration: str


@dataclass(frozen=True, slots=True)
class Intervals:
    """How SET_MESSAGE_INTERVAL and its kin are answered."""

    heartbeat_settable: bool
    fastest_s: float
    capped: bool  # a faster interval is granted as the fastest; else DENIED
    step_s: float  # intervals are cut to whole multiples of this; 0: they are not
    unknown: CommandResult  # for a message that the autopilot does not have
    unknown_request: CommandResult  # REQUEST_MESSAGE for one
    unknown_query: tuple[int, CommandResult]  # GET_MESSAGE_INTERVAL for one: MESSAGE_INTERVAL.interval_us, result
    refused_ids: frozenset[int] = frozenset()  # ids of silent messages that are unknown here all the same


@dataclass(frozen=True, slots=True)
class ParameterDefault:
    """The type and the value that a parameter has at boot; integers are whole floats."""

    type: str  # MAV_PARAM_TYPE without its prefix
    value: float


@dataclass(frozen=True, slots=True)
class AutopilotProfile:
    """How one autopilot behaves on the wire and in the air, as far as tables can say it."""

    autopilot: int  # MAV_AUTOPILOT
    version: int
    capabilities: int  # MAV_PROTOCOL_CAPABILITY
    # Sockets
    port_base: int  # where the first vehicle listens by default; 0: on any free port
    first_sender_is_partner: bool  # telemetry goes to whoever speaks first; else only the remote is listened to
    # Modes
    modes: tuple[FlightMode, ...]
    first_mode: str
    stream_mode: str
    transitions: Mapping[tuple[str, ModeEvent], str]  # a mode and an event -> the next mode; absent: nothing happens
    failsafe_modes: Mapping[ModeEvent, Mapping[int, str]]  # event -> value of its parameter -> mode ("" disarms)
    mode_message: str  # sent when the mode changes
    setpoint_outlives_mode: bool  # the last setpoint is still there when the streaming mode is entered
    command_ends_failsafe: bool  # a mode by command ends a failsafe; else it lasts until its cause is gone
    streaming_bit: int  # of HEARTBEAT.base_mode while setpoints come in the streaming mode
    manners: frozenset[str]  # those of `Manners` that it can have
    # Boot
    boot: Boot
    quick_boot: Boot
    booting_status: SystemStatus
    origin_movable: bool  # at any time; else only before there is one
    origin_messages: tuple[str, ...]  # sent when the origin is set
    # Who is obeyed, and how it is answered
    target_components: frozenset[int] | None  # commands for other components are not answered; None: any
    obeys_system_0: bool  # commands and parameters to target_system 0
    refused_arming: CommandResult
    refused_disarming: CommandResult
    refused_mode: CommandResult
    texts: Texts
    # Telemetry
    default_streams: Mapping[str, float]  # [Hz] sent unasked
    intervals: Intervals
    home_quaternion: tuple[float, float, float, float]
    battery: BatteryProfile
    # Parameters
    parameters: Mapping[str, ParameterDefault]
    parameters_bytewise: bool  # integers travel bytewise in the float field; else they are cast
    system_id_parameter: str
    idle_disarm_parameter: str
    speeds: SpeedParameters
    # Flight
    ground: GroundTimes
    setpoints_lift_off: bool
    position_setpoints_land: bool  # under a position setpoint below the ground it lands; else it sits there armed
    step_gain_per_s: float  # position-only approach
    sink_m_s: float  # of a pilot's mode without a pilot
    pilotless_drift_m_s: float  # horizontal, of the same
    earth_radius_m: float  # of the sphere that its local frame is on
    position_error_m: tuple[float, float]  # origin against own start: standard deviation horizontal, vertical
