"""ArduCopter 4.7 as its SITL answers and flies: numbers, rules, dialect."""

from __future__ import annotations

import math
from pathlib import Path
from types import MappingProxyType

from sitl_mock.autopilot.autopilot import Autopilot, Rules
from sitl_mock.autopilot.battery import BatteryProfile
from sitl_mock.autopilot.guidance import BodyState
from sitl_mock.autopilot.parameters import Parameters, WriteRefused, read_defaults
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
from sitl_mock.autopilot.setpoints import (
    BODY_NED,
    BODY_OFFSET_NED,
    FORCE_BIT,
    LETHAL,
    LOCAL_NED,
    LOCAL_OFFSET_NED,
    YAW_BIT,
    YAW_RATE_BIT,
    Interpretation,
    Pose,
    SetpointEffect,
    SetpointFields,
    turned,
)
from sitl_mock.messages import CommandResult, Fields, Landed, Outgoing, Received, Severity, SystemStatus
from sitl_mock.physics.geodesy import Geodetic
from sitl_mock.physics.reference import ALL, NONE, ZERO, Reference, Vec3, plus
from sitl_mock.protocol import commands, services, telemetry
from sitl_mock.protocol.commands import Command
from sitl_mock.protocol.dialect import Dialect, Strategy
from sitl_mock.protocol.rows import ROW_BUILDERS

# -- numbers, names and texts -----------------------------------------------------------------------------------------

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
_AUTO_RTL = 27
_POSITIONLESS_MODES = frozenset({"STABILIZE", "ALT_HOLD"})  # can be armed in without a position
_CLIMBING_MODES = frozenset({"GUIDED", "LOITER"})  # can be taken off in
_READ_S = 0.08  # parameter reads are answered from a 10 Hz task: 63-99 ms
_LANDED_DISARM_S = 0.5  # disarms this long after it reported ON_GROUND in LAND and RTL
_FASTEST_OBEYED_M_S = 1000.0  # a velocity beyond brakes
_FARTHEST_SURVIVED_M = 1e8  # a position of 1e9 m killed the SITL, 1e6 m was flown to
_SLOWEST_TRAVEL = 1.0  # below a metre, or a metre per second, the direction of travel is noise
# REQUEST_DATA_STREAM: stream id -> the messages that this simulator knows of it
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

_BATTERY_ACTIONS = MappingProxyType({1: "LAND", 2: "RTL", 3: "SMART_RTL", 4: "SMART_RTL", 5: ""})
# The worst first: level, parameters of its voltage and its action.
_BATTERY_LEVELS = (
    (ModeEvent.BATTERY_CRITICAL, "BATT_CRT_VOLT", "BATT_FS_CRT_ACT", "critical"),
    (ModeEvent.BATTERY_LOW, "BATT_LOW_VOLT", "BATT_FS_LOW_ACT", "low"),
)
_CAPACITY_MAH = 3300
_EKF_FAILSAFE_S, _STOPS_AIDING_S = 8.1, 15.1  # after the satellites are gone

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
    gps_fix=6,
    airspeed_measured=True,
    home_quaternion=(math.nan, math.nan, math.nan, math.nan),
    # 97 to 90 in 30 s of hover
    battery=BatteryProfile(full=97, drain_per_s=0.23, least=0, cells=3, full_cell_v=4.2, empty_cell_v=3.3),
    parameters=read_defaults(Path(__file__).with_suffix(".toml")),
    parameters_bytewise=False,
    system_id_parameter="MAV_SYSID",
    idle_disarm_parameter="DISARM_DELAY",
    speeds=SpeedParameters(
        scale=0.01,  # cm/s and cm/s^2
        horizontal="WPNAV_SPEED",
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
    position_error_m=(0.0, 0.0),
)


# -- rules ------------------------------------------------------------------------------------------------------------


class ArduPilotRules(Rules):
    """What ArduPilot does in a way of its own."""

    def status(self, vehicle: Autopilot) -> SystemStatus:
        """Active is off the ground."""
        return SystemStatus.STANDBY if vehicle.landed is Landed.ON_GROUND else SystemStatus.ACTIVE

    def arming_refusal(self, vehicle: Autopilot) -> str | None:
        """The first of its reasons."""
        mode = vehicle.mode
        if not vehicle.booted:
            return "Arm: System not initialised"
        if mode.need is Need.MISSION:
            return "Arm: Mode requires mission"
        if not mode.armable:
            return f"Arm: {mode.name} mode not armable"
        if not vehicle.ready and mode.name not in _POSITIONLESS_MODES:
            return "Arm: Need Position Estimate"
        return None

    def on_arming(self, vehicle: Autopilot) -> None:
        """Say the origin, and forget the setpoint of the last flight."""
        vehicle.send("GPS_GLOBAL_ORIGIN")
        vehicle.guidance.setpoint = None

    def landed_disarm_s(self, vehicle: Autopilot) -> float | None:
        """Only in the modes that land."""
        return _LANDED_DISARM_S if vehicle.mode.behaviour in (Behaviour.LAND, Behaviour.RETURN) else None

    def take_off(self, vehicle: Autopilot, height_m: float) -> CommandResult:
        """Inside the present mode."""
        able = vehicle.mode.name in _CLIMBING_MODES and vehicle.armed and not vehicle.airborne
        if not able or height_m <= vehicle.body.height_m:
            return CommandResult.FAILED
        vehicle.guidance.takeoff_height_m = height_m
        vehicle.guidance.setpoint = None
        vehicle.guidance.enter(vehicle.body)
        vehicle.climbing = True
        vehicle.climb_since_s = None
        return CommandResult.ACCEPTED

    def interpret(self, fields: SetpointFields, pose: Pose, parameters: Parameters) -> Interpretation:
        """Group by group; any ignored bit of a group ignores the group."""
        use_p, use_v, use_a = (not fields.mask & (0b111 << shift) for shift in (0, 3, 6))
        refused = _refusal(fields, use_p, use_v, use_a)
        if refused is not None:
            return refused
        turn_rad = pose.yaw_rad if fields.frame in (BODY_NED, BODY_OFFSET_NED) else 0.0
        base = pose.local_origin_ned_m if fields.frame == LOCAL_NED else pose.position_ned_m
        position = plus(turned(fields.position_m, turn_rad), base) if use_p else ZERO
        velocity = turned(fields.velocity_m_s, turn_rad) if use_v else ZERO
        yaw_rad, rate_rad_s = fields.heading()
        if fields.mask & YAW_BIT and fields.mask & YAW_RATE_BIT:
            yaw_rad = _travel_rad(velocity, position if use_p else None, pose)
        carry_s = max(parameters["GUID_TIMEOUT"], 0.1)
        return Interpretation(
            SetpointEffect.FLY,
            Reference(
                position_ned_m=position,
                velocity_ned_m_s=velocity,
                acceleration_ned_m_s2=turned(fields.acceleration_m_s2, turn_rad) if use_a else ZERO,
                position_used=ALL if use_p else NONE,
                velocity_used=ALL if use_v else NONE,
                yaw_rad=yaw_rad,
                yaw_rate_rad_s=rate_rad_s,
                since_s=pose.now_s,
                carry_s=carry_s if use_v or use_a else 0.0,
                lapses=use_v or use_a,  # a position alone holds for ever
            ),
        )

    def streamed(self, fields: SetpointFields, position_ned_m: Vec3, vehicle: Autopilot) -> Reference:
        """Run on by GUID_TIMEOUT, and lapse."""
        return Reference(
            position_ned_m,
            fields.velocity_m_s,
            fields.acceleration_m_s2,
            ALL,
            ALL,
            math.remainder(fields.yaw_rad, 2.0 * math.pi),
            since_s=vehicle.now_s,
            carry_s=max(vehicle.parameters["GUID_TIMEOUT"], 0.1),
            lapses=True,
        )

    def on_setpoint(self, vehicle: Autopilot, reference: Reference | None) -> bool:
        """Drop it outside GUIDED; before lift-off it cancels the take-off in silence."""
        if vehicle.mode.name != self.profile.stream_mode:
            return False
        vehicle.climbing = False
        if vehicle.airborne:
            if reference is None:
                vehicle.guidance.enter(vehicle.body)
            vehicle.guidance.setpoint = reference
        return True

    def stream_fresh(self, vehicle: Autopilot) -> bool:
        """Always: targets lapse by themselves (GUID_TIMEOUT), the mode stays."""
        return True

    def stream_lost_at_s(self, vehicle: Autopilot) -> float:
        """Never."""
        return math.inf

    def watch_position(self, vehicle: Autopilot) -> None:
        """Without satellites it lands by itself, then it stops telling where it is; with them again it goes on."""
        lost_at_s = vehicle.gps_lost_at_s
        missing_s = 0.0 if lost_at_s is None else vehicle.now_s - lost_at_s
        if missing_s > _EKF_FAILSAFE_S and vehicle.airborne and vehicle.failsafe is not ModeEvent.POSITION_LOST:
            vehicle.send_text("EKF variance")
            vehicle.send_text("EKF Failsafe: changed to LAND Mode")
            vehicle.fail(ModeEvent.POSITION_LOST, "LAND", keep_intention=False)
        if missing_s > _STOPS_AIDING_S and not vehicle.position_lost:
            vehicle.position_lost = True
            vehicle.send_text("EKF3 IMU0 stopped aiding", Severity.INFO)
        elif lost_at_s is None and vehicle.position_lost:
            vehicle.position_lost = False
            vehicle.send_text("EKF3 IMU0 is using GPS", Severity.INFO)

    def _watch_battery(self, vehicle: Autopilot) -> None:
        """A voltage that stays below a level for BATT_LOW_TIMER is told, and acted on."""
        volt = vehicle.battery.voltage_v
        found = next((level for level in _BATTERY_LEVELS if volt < vehicle.parameters[level[1]]), None)
        if found is None:
            vehicle.battery_low_since_s = None
            return
        if vehicle.battery_low_since_s is None:
            vehicle.battery_low_since_s = vehicle.now_s
        level, _, action, word = found
        waited_s = vehicle.now_s - vehicle.battery_low_since_s
        known = (level, ModeEvent.BATTERY_CRITICAL)  # a critical battery is not told to be low again
        if waited_s < vehicle.parameters["BATT_LOW_TIMER"] or vehicle.battery_failsafe in known:
            return
        used_mah = _CAPACITY_MAH * (1.0 - vehicle.battery.share)
        vehicle.battery_failsafe = level
        vehicle.send_text(f"Battery 1 is {word} {volt:.2f}V used {used_mah:.0f} mAh", Severity.WARNING)
        vehicle.send_text("Battery Failsafe", Severity.WARNING)
        mode = self.profile.failsafe_modes[level].get(int(vehicle.parameters[action]))
        if mode is None:
            vehicle.failsafe, vehicle.failsafe_at_s = level, vehicle.now_s  # measured: critical, the mode stays
        else:
            vehicle.fail(level, mode, keep_intention=False)

    def watch_failsafes(self, vehicle: Autopilot) -> None:
        """The battery, and the ground station once it was heard; when it is back the mode stays."""
        self._watch_battery(vehicle)
        if not math.isfinite(vehicle.gcs_heard_at_s):
            return
        action, limit_s = int(vehicle.parameters["FS_GCS_ENABLE"]), vehicle.parameters["FS_GCS_TIMEOUT"]
        lost = vehicle.now_s - vehicle.gcs_heard_at_s > limit_s
        modes = self.profile.failsafe_modes[ModeEvent.GCS_LOST]
        if lost and not vehicle.gcs_missed and action in modes:
            vehicle.gcs_missed = True
            vehicle.send_text("GCS Failsafe", Severity.WARNING)
            if vehicle.airborne:
                vehicle.fail(ModeEvent.GCS_LOST, modes[action], keep_intention=False)
            else:
                vehicle.disarm("failsafe")
        elif not lost and vehicle.gcs_missed:
            vehicle.gcs_missed = False
            vehicle.failsafe = None
            vehicle.send_text("GCS Failsafe Cleared", Severity.WARNING)

    def landing_speed_m_s(self, parameters: Parameters, height_m: float) -> float:
        """Up to 1.5 m/s, then 0.5 m/s below 10 m."""
        high = height_m > parameters["LAND_ALT_LOW"] * 0.01
        return parameters.positive("WPNAV_SPEED_DN" if high else "LAND_SPEED", 0.01)

    def return_height_m(self, parameters: Parameters, away_m: float) -> float:
        """A parameter in centimetres."""
        return max(parameters["RTL_ALT"] * 0.01, 0.0)

    def return_wait_s(self, parameters: Parameters) -> float:
        """A parameter in milliseconds."""
        return parameters["RTL_LOIT_TIME"] * 0.001


def _refusal(fields: SetpointFields, use_p: bool, use_v: bool, use_a: bool) -> Interpretation | None:
    """Why a setpoint brakes instead of being flown; None: it is flown."""
    if fields.mask & FORCE_BIT and use_a:
        return Interpretation(SetpointEffect.BRAKE)
    if not (use_p or use_v or use_a) or (use_p and use_a and not use_v):
        return Interpretation(SetpointEffect.BRAKE)
    if fields.frame not in (LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED):
        return Interpretation(SetpointEffect.BRAKE)
    if use_v and not all(abs(v) <= _FASTEST_OBEYED_M_S for v in fields.velocity_m_s):
        return Interpretation(SetpointEffect.BRAKE)  # NaN compares false: it brakes too
    if (
        (use_p and not all(abs(p) < _FARTHEST_SURVIVED_M for p in fields.position_m))
        or (use_a and not all(map(math.isfinite, fields.acceleration_m_s2)))
        or (not fields.mask & YAW_BIT and not math.isfinite(fields.yaw_rad))
    ):
        return Interpretation(SetpointEffect.BRAKE, text=LETHAL)
    return None


def _travel_rad(velocity: Vec3, position: Vec3 | None, pose: Pose) -> float | None:
    """Without a yaw the nose turns into the direction of travel; None (keep) when there is none."""
    north, east = velocity[0], velocity[1]
    if position is not None and velocity == ZERO:
        north, east = (position[i] - pose.position_ned_m[i] for i in (0, 1))
    return math.atan2(east, north) if math.hypot(north, east) >= _SLOWEST_TRAVEL else None


# -- commands ---------------------------------------------------------------------------------------------------------


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


# -- messages ---------------------------------------------------------------------------------------------------------


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


# -- telemetry --------------------------------------------------------------------------------------------------------


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


# -- tables -----------------------------------------------------------------------------------------------------------

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
        fixed_results=MappingProxyType(
            # Rebooting for real is not modelled.
            dict.fromkeys((178, 179, 193, commands.PREFLIGHT_REBOOT_SHUTDOWN), CommandResult.ACCEPTED)
            | {commands.MISSION_START: CommandResult.FAILED}
        ),
        builders=MappingProxyType(
            dict(telemetry.BUILDERS)
            | {"POSITION_TARGET_LOCAL_NED": _position_target, "EKF_STATUS_REPORT": _ekf_status_report}
        ),
        row_builders=ROW_BUILDERS,
    ),
)
