"""PX4 1.17 as its SITL answers and flies: its numbers, names and texts."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType

from sitl_mock.autopilot.battery import BatteryProfile
from sitl_mock.autopilot.parameters import read_defaults
from sitl_mock.autopilot.profile import (
    AutopilotProfile,
    Behaviour,
    Boot,
    FlightMode,
    GroundTimes,
    Intervals,
    ModeEvent,
    Need,
    SpeedParameters,
    Texts,
)
from sitl_mock.messages import CommandResult, SystemStatus

_AUTO = 0x1D  # custom, auto, guided, stabilize
_PILOT = 0x51  # custom, stabilize, manual
_MODES = (
    FlightMode("MANUAL", 0x00010000, Behaviour.SINK, _PILOT, Need.PILOT, title="Manual"),
    FlightMode("ALTCTL", 0x00020000, Behaviour.SINK, _PILOT, Need.PILOT, title="Altitude"),
    FlightMode("POSCTL", 0x00030000, Behaviour.SINK, _PILOT, Need.PILOT, title="Position"),
    FlightMode("ACRO", 0x00050000, Behaviour.SINK, _PILOT, Need.PILOT, title="Acro"),
    FlightMode("STABILIZED", 0x00070000, Behaviour.RISE, _PILOT, Need.PILOT, title="Stabilized"),
    # OFFBOARD shows stabilize only while setpoints come: `streaming_bit`.
    FlightMode("OFFBOARD", 0x00060000, Behaviour.FOLLOW, 0x01, Need.STREAM, title="Offboard"),
    FlightMode("TAKEOFF", 0x02040000, Behaviour.TAKEOFF, _AUTO, title="Takeoff", standard_mode=8),
    FlightMode("LOITER", 0x03040000, Behaviour.HOLD, _AUTO, title="Hold"),
    FlightMode("MISSION", 0x04040000, Behaviour.HOLD, _AUTO, Need.MISSION, title="Mission"),
    FlightMode("RTL", 0x05040000, Behaviour.RETURN, _AUTO, armable=False, title="Return", standard_mode=5),
    FlightMode("LAND", 0x06040000, Behaviour.LAND, _AUTO, armable=False, title="Land", standard_mode=7),
    FlightMode("FOLLOW", 0x08040000, Behaviour.HOLD, _AUTO, title="Follow Me"),
    FlightMode("PRECLAND", 0x09040000, Behaviour.LAND, _AUTO, armable=False, title="Precision Landing"),
)
PROFILE = AutopilotProfile(
    autopilot=12,
    version=0x01110040,
    capabilities=59647,
    port_base=18570,
    first_sender_is_partner=True,
    modes=_MODES,
    first_mode="LOITER",
    stream_mode="OFFBOARD",
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
            # COM_LOW_BAT_ACT: 0 and 1 only warn
            ModeEvent.BATTERY_CRITICAL: MappingProxyType({2: "LAND", 3: "RTL"}),
            ModeEvent.BATTERY_EMERGENCY: MappingProxyType({2: "LAND", 3: "LAND"}),
        }
    ),
    mode_message="CURRENT_MODE",
    setpoint_outlives_mode=True,
    command_ends_failsafe=True,
    streaming_bit=0x10,
    manners=frozenset({"strict_commands", "new_partner", "parameter_freeze"}),
    boot=Boot(heartbeat_s=1.2, standby_s=3.9, origin_s=1.2, ready_s=3.9),
    quick_boot=Boot(heartbeat_s=0.2, standby_s=1.0, origin_s=0.2, ready_s=1.0),
    booting_status=SystemStatus.UNINIT,
    origin_movable=True,
    origin_messages=("GPS_GLOBAL_ORIGIN",),
    target_components=frozenset({0, 1}),
    obeys_system_0=False,
    refused_arming=CommandResult.TEMPORARILY_REJECTED,
    refused_disarming=CommandResult.TEMPORARILY_REJECTED,
    refused_mode=CommandResult.TEMPORARILY_REJECTED,
    texts=Texts(
        suffix="\t",
        need_gcs=True,
        armed="Armed by external command",
        disarmed=MappingProxyType(
            {
                "command": "Disarmed by external command",
                "landing": "Disarmed by landing",
                "idle": "Disarmed by auto preflight disarming",
                "failsafe": "Disarmed by failsafe",
            }
        ),
        disarming_refused="Disarming denied: not landed",
        crashed="Arming denied: vehicle has crashed",
        takeoff_detected="Takeoff detected",
        landing_detected="Landing detected",
    ),
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
    intervals=Intervals(
        heartbeat_settable=False,
        fastest_s=0.008,
        capped=True,
        step_s=0.0,
        unknown=CommandResult.FAILED,
        unknown_request=CommandResult.DENIED,
        unknown_query=(-1, CommandResult.ACCEPTED),
    ),
    home_quaternion=(1.0, 0.0, 0.0, 0.0),
    # 74 after half a minute armed
    battery=BatteryProfile(full=100, drain_per_s=0.9, least=50, cells=4, full_cell_v=4.05, empty_cell_v=3.5),
    parameters=read_defaults(Path(__file__).with_name("parameters.toml")),
    parameters_bytewise=True,
    system_id_parameter="MAV_SYS_ID",
    idle_disarm_parameter="COM_DISARM_PRFLT",
    speeds=SpeedParameters(
        scale=1.0,
        horizontal="MPC_XY_VEL_MAX",
        cruise="MPC_XY_CRUISE",
        climb="MPC_Z_VEL_MAX_UP",
        descent="MPC_Z_VEL_MAX_DN",
        takeoff="MPC_TKO_SPEED",
        acceleration="MPC_ACC_HOR",
    ),
    ground=GroundTimes(
        spool_s=1.0, liftoff_s=3.0, liftoff_stream_s=2.0, takeoff_state_s=0.9, detection_s=2.0, idle_extra_s=1.05
    ),
    setpoints_lift_off=True,
    position_setpoints_land=False,
    step_gain_per_s=0.95,  # MPC_XY_P
    sink_m_s=0.7,
    pilotless_drift_m_s=0.14,  # POSCTL: 1.4 m in 10 s
    earth_radius_m=6_371_000.0,  # CONSTANTS_RADIUS_OF_EARTH
    position_error_m=(0.15, 0.35),
)
