"""What PX4 and ArduPilot do differently, as one table of data.

Every number here was measured on the wire of the real SITL autopilots (PX4 1.17-alpha with SIH, ArduCopter 4.7-dev);
`docs/autopilots` has the records. The logic reads numbers, modes and results from this table; where the two autopilots
do different things altogether it asks `is_px4`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from types import MappingProxyType

from sitl_mock.messages import CommandResult, Severity


class Behaviour(Enum):
    """What a mode flies."""

    FOLLOW = auto()  # streamed setpoints
    HOLD = auto()  # brake, then stay
    TAKEOFF = auto()
    LAND = auto()
    RETURN = auto()
    SINK = auto()  # a pilot's mode without a pilot: throttle stick missing or at its minimum
    RISE = auto()  # PX4 STABILIZED without a pilot: drifts and climbs away


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
    STREAM_BACK = auto()
    GCS_LOST = auto()
    GCS_BACK = auto()
    FAILSAFE_DELAY_OVER = auto()


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


@dataclass(frozen=True, slots=True)
class Boot:
    """Seconds from start to each stage."""

    heartbeat_s: float
    standby_s: float  # commands are obeyed, status leaves BOOT
    origin_s: float  # EKF origin set: GPS_GLOBAL_ORIGIN and HOME_POSITION go out
    ready_s: float  # local position and arm-able


@dataclass(frozen=True, slots=True)
class AutopilotProfile:
    """How one autopilot behaves on the wire and in the air."""

    name: str
    is_px4: bool  # for what is another story, not another number
    autopilot: int  # MAV_AUTOPILOT
    modes: tuple[FlightMode, ...]
    first_mode: str
    transitions: Mapping[tuple[str, ModeEvent], str]  # a mode and an event -> the next mode; absent: nothing happens
    failsafe_modes: Mapping[ModeEvent, Mapping[int, str]]  # event -> value of its parameter -> mode ("" disarms)
    stream_mode: str
    hold_mode: str
    land_mode: str
    return_mode: str
    takeoff_mode: str | None  # None: a take-off is flown inside the present mode
    boot: Boot
    quick_boot: Boot
    default_streams: Mapping[str, float]  # [Hz] sent unasked
    heartbeat_settable: bool
    texts_need_gcs: bool  # a GCS heartbeat opens the link's texts; else any frame does
    text_suffix: str
    target_components: frozenset[int] | None  # commands for other components are not answered; None: any
    obeys_system_0: bool  # commands to target_system 0
    refused_arming: CommandResult
    refused_disarming: CommandResult
    refused_mode: CommandResult
    unknown_interval: CommandResult
    unknown_request: CommandResult
    fastest_interval_s: float
    interval_capped: bool  # faster wishes are granted at the fastest; else DENIED
    interval_step_s: float  # intervals are cut to whole multiples of this
    parameters_bytewise: bool
    stream_parameter: str | None  # how long a stream may pause [s]; None: targets lapse by themselves
    setpoints_lift_off: bool
    carry_s: float | None  # [s] how long a target runs on; None: the parameter GUID_TIMEOUT
    spool_s: float  # arming to motors ready
    liftoff_s: float  # wish to climb (motors ready) to first motion, take-off command
    liftoff_stream_s: float  # the same by setpoints
    takeoff_state_s: float  # wish to climb to landed state TAKEOFF
    ground_detect_s: float  # contact to landed state ON_GROUND
    idle_extra_s: float  # idle disarming is later than its parameter says by this
    disarm_texts: Mapping[str, str]
    step_gain_per_s: float  # position-only approach: PX4 MPC_XY_P; ArduPilot's shaped lag of 1.95 s
    sink_m_s: float
    position_error_m: tuple[float, float]  # origin against own start: standard deviation horizontal, vertical
    capabilities: int
    version: int
    version_text: str
    text_severity: Severity = Severity.CRITICAL


_PX4_AUTO = 0x1D  # custom, auto, guided, stabilize
_PX4_PILOT = 0x51  # custom, stabilize, manual

_PX4_MODES = (
    FlightMode("MANUAL", 0x00010000, Behaviour.SINK, _PX4_PILOT, Need.PILOT, title="Manual"),
    FlightMode("ALTCTL", 0x00020000, Behaviour.SINK, _PX4_PILOT, Need.PILOT, title="Altitude"),
    FlightMode("POSCTL", 0x00030000, Behaviour.SINK, _PX4_PILOT, Need.PILOT, title="Position"),
    FlightMode("ACRO", 0x00050000, Behaviour.SINK, _PX4_PILOT, Need.PILOT, title="Acro"),
    FlightMode("STABILIZED", 0x00070000, Behaviour.RISE, _PX4_PILOT, Need.PILOT, title="Stabilized"),
    # OFFBOARD shows stabilize (0x10) only while setpoints come; `Autopilot` adds that bit.
    FlightMode("OFFBOARD", 0x00060000, Behaviour.FOLLOW, 0x01, Need.STREAM, title="Offboard"),
    FlightMode("TAKEOFF", 0x02040000, Behaviour.TAKEOFF, _PX4_AUTO, title="Takeoff"),
    FlightMode("LOITER", 0x03040000, Behaviour.HOLD, _PX4_AUTO, title="Hold"),
    FlightMode("MISSION", 0x04040000, Behaviour.HOLD, _PX4_AUTO, Need.MISSION, title="Mission"),
    FlightMode("RTL", 0x05040000, Behaviour.RETURN, _PX4_AUTO, armable=False, title="Return"),
    FlightMode("LAND", 0x06040000, Behaviour.LAND, _PX4_AUTO, armable=False, title="Land"),
    FlightMode("FOLLOW", 0x08040000, Behaviour.HOLD, _PX4_AUTO, title="Follow Me"),
    FlightMode("PRECLAND", 0x09040000, Behaviour.LAND, _PX4_AUTO, armable=False, title="Precision Landing"),
)

PX4 = AutopilotProfile(
    name="px4",
    is_px4=True,
    autopilot=12,
    modes=_PX4_MODES,
    first_mode="LOITER",
    transitions=MappingProxyType(
        {
            ("TAKEOFF", ModeEvent.CLIMBED): "LOITER",
            # After landing the vehicle is back in Hold; out of a failsafe it returns to the intended mode instead.
            ("LAND", ModeEvent.DISARMED): "LOITER",
            ("PRECLAND", ModeEvent.DISARMED): "LOITER",
            ("RTL", ModeEvent.DISARMED): "LOITER",
            ("TAKEOFF", ModeEvent.DISARMED): "LOITER",
        }
    ),
    failsafe_modes=MappingProxyType(
        {
            # COM_OBL_RC_ACT: the default 0 is no hover without a pilot, it sinks and drifts
            ModeEvent.STREAM_LOST: MappingProxyType(
                {0: "POSCTL", 1: "ALTCTL", 2: "STABILIZED", 3: "RTL", 4: "LAND", 5: "LOITER", 6: "LOITER", 7: ""}
            ),
            # NAV_DLL_ACT: Hold for COM_FAIL_ACT_T, then the action
            ModeEvent.GCS_LOST: MappingProxyType({1: "LOITER", 2: "LOITER", 3: "LOITER", 5: "", 6: ""}),
            ModeEvent.FAILSAFE_DELAY_OVER: MappingProxyType({1: "LOITER", 2: "RTL", 3: "LAND"}),
        }
    ),
    stream_mode="OFFBOARD",
    hold_mode="LOITER",
    land_mode="LAND",
    return_mode="RTL",
    takeoff_mode="TAKEOFF",
    boot=Boot(heartbeat_s=1.2, standby_s=3.9, origin_s=1.2, ready_s=3.9),
    quick_boot=Boot(heartbeat_s=0.2, standby_s=1.0, origin_s=0.2, ready_s=1.0),
    # The real GCS link sends seven messages at 50 Hz (372 messages a second): here 10 Hz, to stay cheap.
    default_streams=MappingProxyType(
        {
            "HEARTBEAT": 1.0,
            "ATTITUDE": 10.0,
            "ATTITUDE_QUATERNION": 10.0,
            "LOCAL_POSITION_NED": 10.0,
            "POSITION_TARGET_LOCAL_NED": 10.0,
            "GLOBAL_POSITION_INT": 10.0,
            "GPS_RAW_INT": 5.0,
            "VFR_HUD": 4.0,
            "SYS_STATUS": 1.0,
            "EXTENDED_SYS_STATE": 1.0,
            "ALTITUDE": 1.0,
            "MISSION_CURRENT": 1.0,
            "BATTERY_STATUS": 0.5,
            "CURRENT_MODE": 0.5,
            "ESTIMATOR_STATUS": 0.5,
            "HOME_POSITION": 0.5,
        }
    ),
    heartbeat_settable=False,
    texts_need_gcs=True,
    text_suffix="\t",
    target_components=frozenset({0, 1}),
    obeys_system_0=False,
    refused_arming=CommandResult.TEMPORARILY_REJECTED,
    refused_disarming=CommandResult.TEMPORARILY_REJECTED,
    refused_mode=CommandResult.TEMPORARILY_REJECTED,
    unknown_interval=CommandResult.FAILED,
    unknown_request=CommandResult.DENIED,
    fastest_interval_s=0.008,
    interval_capped=True,
    interval_step_s=0.0,
    parameters_bytewise=True,
    stream_parameter="COM_OF_LOSS_T",
    setpoints_lift_off=True,
    # The real PX4 holds each setpoint until the next. At 20 Hz and 10 m/s that alone costs 0.16 m rms here, where
    # nothing else is in error; so a setpoint runs on, but never longer than this.
    carry_s=0.1,
    spool_s=1.0,
    liftoff_s=3.0,
    liftoff_stream_s=2.0,
    takeoff_state_s=0.9,
    ground_detect_s=2.0,
    idle_extra_s=1.05,
    disarm_texts=MappingProxyType(
        {
            "command": "Disarmed by external command",
            "landing": "Disarmed by landing",
            "idle": "Disarmed by auto preflight disarming",
            "failsafe": "Disarmed by failsafe",
        }
    ),
    step_gain_per_s=0.95,
    sink_m_s=0.7,
    position_error_m=(0.15, 0.35),
    capabilities=59647,
    version=0x01110040,
    version_text="PX4",
)

_AP_PILOT = 81  # custom, manual input, stabilize
_AP_POSITION = 89  # the same with guided: the horizontal position controller is active

_ARDUPILOT_MODES = (
    FlightMode("STABILIZE", 0, Behaviour.SINK, _AP_PILOT),
    FlightMode("ALT_HOLD", 2, Behaviour.SINK, _AP_PILOT),
    FlightMode("AUTO", 3, Behaviour.HOLD, _AP_POSITION, Need.MISSION),
    FlightMode("GUIDED", 4, Behaviour.FOLLOW, _AP_POSITION),
    FlightMode("LOITER", 5, Behaviour.SINK, _AP_POSITION),
    FlightMode("RTL", 6, Behaviour.RETURN, _AP_POSITION, armable=False),
    FlightMode("LAND", 9, Behaviour.LAND, _AP_POSITION, armable=False),
    FlightMode("POSHOLD", 16, Behaviour.SINK, _AP_POSITION),
    FlightMode("BRAKE", 17, Behaviour.HOLD, _AP_POSITION, armable=False),
    FlightMode("SMART_RTL", 21, Behaviour.RETURN, _AP_POSITION, armable=False),
    FlightMode("AUTO_RTL", 27, Behaviour.RETURN, _AP_POSITION, Need.MISSION, armable=False),
)

ARDUPILOT = AutopilotProfile(
    name="ardupilot",
    is_px4=False,
    autopilot=3,
    modes=_ARDUPILOT_MODES,
    first_mode="STABILIZE",
    transitions=MappingProxyType({}),  # nothing changes a mode by itself but a failsafe; LAND stays LAND when landed
    failsafe_modes=MappingProxyType(
        {
            ModeEvent.STREAM_LOST: MappingProxyType({}),  # targets lapse (GUID_TIMEOUT), the mode stays
            # FS_GCS_ENABLE
            ModeEvent.GCS_LOST: MappingProxyType(
                {1: "RTL", 2: "RTL", 3: "SMART_RTL", 4: "SMART_RTL", 5: "LAND", 6: "RTL", 7: "BRAKE"}
            ),
            ModeEvent.FAILSAFE_DELAY_OVER: MappingProxyType({}),
        }
    ),
    stream_mode="GUIDED",
    hold_mode="BRAKE",
    land_mode="LAND",
    return_mode="RTL",
    takeoff_mode=None,
    boot=Boot(heartbeat_s=1.02, standby_s=2.46, origin_s=20.02, ready_s=41.5),
    quick_boot=Boot(heartbeat_s=0.2, standby_s=0.3, origin_s=1.0, ready_s=1.2),
    default_streams=MappingProxyType({"HEARTBEAT": 1.0}),
    heartbeat_settable=True,
    texts_need_gcs=False,
    text_suffix="",
    target_components=None,
    obeys_system_0=True,
    refused_arming=CommandResult.FAILED,
    refused_disarming=CommandResult.FAILED,
    refused_mode=CommandResult.FAILED,
    unknown_interval=CommandResult.DENIED,
    unknown_request=CommandResult.FAILED,
    fastest_interval_s=0.003,
    interval_capped=False,
    interval_step_s=0.001,
    parameters_bytewise=False,
    stream_parameter=None,
    setpoints_lift_off=False,
    carry_s=None,
    spool_s=2.3,
    liftoff_s=1.35,
    liftoff_stream_s=1.35,
    takeoff_state_s=1.0,
    ground_detect_s=1.6,
    idle_extra_s=-0.1,
    disarm_texts=MappingProxyType(dict.fromkeys(("command", "landing", "idle", "failsafe"), "Disarming motors")),
    step_gain_per_s=0.6,
    sink_m_s=2.5,
    position_error_m=(0.0, 0.0),
    capabilities=64495,
    version=0x04070000,
    version_text="ArduCopter V4.7.0-dev",
)

MANNERS: Mapping[str, AutopilotProfile] = MappingProxyType({"px4": PX4, "ardupilot": ARDUPILOT})

# REQUEST_DATA_STREAM of ArduPilot: stream id -> the messages that this simulator knows of it.
DATA_STREAMS: Mapping[int, tuple[str, ...]] = MappingProxyType(
    {
        2: ("SYS_STATUS", "MISSION_CURRENT", "GPS_RAW_INT"),
        6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
        10: ("ATTITUDE",),
        11: ("VFR_HUD",),
        12: ("SYSTEM_TIME", "BATTERY_STATUS", "EKF_STATUS_REPORT"),
    }
)
DATA_STREAM_ALL = 0
