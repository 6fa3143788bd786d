"""ArduCopter 4.7 as its SITL answers and flies: its numbers, names and texts."""

from __future__ import annotations

import math
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

_PILOT = 81  # custom, manual input, stabilize
_POSITION = 89  # the same with guided: the horizontal position controller is active
_MODES = (
    FlightMode("STABILIZE", 0, Behaviour.SINK, _PILOT),
    FlightMode("ALT_HOLD", 2, Behaviour.SINK, _PILOT),
    FlightMode("AUTO", 3, Behaviour.HOLD, _POSITION, Need.MISSION),
    FlightMode("GUIDED", 4, Behaviour.FOLLOW, _POSITION),
    FlightMode("LOITER", 5, Behaviour.SINK, _POSITION),
    FlightMode("RTL", 6, Behaviour.RETURN, _POSITION, armable=False),
    FlightMode("LAND", 9, Behaviour.LAND, _POSITION, armable=False),
    FlightMode("POSHOLD", 16, Behaviour.SINK, _POSITION),
    FlightMode("BRAKE", 17, Behaviour.HOLD, _POSITION, armable=False),
    FlightMode("SMART_RTL", 21, Behaviour.RETURN, _POSITION, armable=False),
    FlightMode("AUTO_RTL", 27, Behaviour.RETURN, _POSITION, Need.MISSION, armable=False),
)
_BATTERY_ACTIONS = MappingProxyType({1: "LAND", 2: "RTL", 3: "SMART_RTL", 4: "SMART_RTL", 5: ""})
PROFILE = AutopilotProfile(
    autopilot=3,
    version=0x04070000,
    capabilities=64495,
    port_base=0,
    first_sender_is_partner=False,
    modes=_MODES,
    first_mode="STABILIZE",
    stream_mode="GUIDED",
    transitions=MappingProxyType({}),  # nothing changes a mode by itself but a failsafe; LAND stays LAND when landed
    failsafe_modes=MappingProxyType(
        {
            # FS_GCS_ENABLE
            ModeEvent.GCS_LOST: MappingProxyType(
                {1: "RTL", 2: "RTL", 3: "SMART_RTL", 4: "SMART_RTL", 5: "LAND", 6: "RTL", 7: "BRAKE"}
            ),
            # BATT_FS_LOW_ACT and BATT_FS_CRT_ACT: 0 only warns
            ModeEvent.BATTERY_LOW: _BATTERY_ACTIONS,
            ModeEvent.BATTERY_CRITICAL: _BATTERY_ACTIONS,
        }
    ),
    mode_message="HEARTBEAT",
    setpoint_outlives_mode=False,
    command_ends_failsafe=False,
    streaming_bit=0,
    manners=frozenset(),
    boot=Boot(heartbeat_s=1.02, standby_s=2.46, origin_s=20.02, ready_s=41.5),
    quick_boot=Boot(heartbeat_s=0.2, standby_s=0.3, origin_s=1.0, ready_s=1.2),
    booting_status=SystemStatus.BOOT,
    origin_movable=False,
    origin_messages=("GPS_GLOBAL_ORIGIN", "HOME_POSITION"),
    target_components=None,
    obeys_system_0=True,
    refused_arming=CommandResult.FAILED,
    refused_disarming=CommandResult.FAILED,
    refused_mode=CommandResult.FAILED,
    texts=Texts(
        suffix="",
        need_gcs=False,
        armed="Arming motors",
        disarmed=MappingProxyType(dict.fromkeys(("command", "landing", "idle", "failsafe"), "Disarming motors")),
        crashed="Arm: Crashed, reboot needed",
        unknown_message="No ap_message for mavlink id ({id})",
    ),
    default_streams=MappingProxyType({"HEARTBEAT": 1.0}),
    intervals=Intervals(
        heartbeat_settable=True,
        fastest_s=0.003,
        capped=False,
        step_s=0.001,
        unknown=CommandResult.DENIED,
        unknown_request=CommandResult.FAILED,
        unknown_query=(0, CommandResult.FAILED),
        refused_ids=frozenset({331}),
    ),
    home_quaternion=(math.nan, math.nan, math.nan, math.nan),
    # 97 to 90 in 30 s of hover
    battery=BatteryProfile(full=97, drain_per_s=0.23, least=0, cells=3, full_cell_v=4.2, empty_cell_v=3.3),
    parameters=read_defaults(Path(__file__).with_name("parameters.toml")),
    parameters_bytewise=False,
    system_id_parameter="MAV_SYSID",
    idle_disarm_parameter="DISARM_DELAY",
    speeds=SpeedParameters(
        scale=0.01,  # cm/s and cm/s^2
        horizontal="WPNAV_SPEED",
        cruise="WPNAV_SPEED",
        climb="WPNAV_SPEED_UP",
        descent="WPNAV_SPEED_DN",
        takeoff="WPNAV_SPEED_UP",
        acceleration="WPNAV_ACCEL",
    ),
    ground=GroundTimes(
        spool_s=2.3, liftoff_s=1.35, liftoff_stream_s=1.35, takeoff_state_s=1.0, detection_s=1.6, idle_extra_s=-0.1
    ),
    setpoints_lift_off=False,
    position_setpoints_land=True,
    step_gain_per_s=0.6,  # its shaped lag of 1.95 s
    sink_m_s=2.5,
    pilotless_drift_m_s=0.0,
    earth_radius_m=6_378_100.0,  # LATLON_TO_M: 0.011131884502 m per 1e-7 deg
    position_error_m=(0.0, 0.0),
)
