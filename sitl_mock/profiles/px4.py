"""PX4 1.17 as its SITL answers and flies: numbers, rules, dialect."""

from __future__ import annotations

import math
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from sitl_mock.autopilot.autopilot import Autopilot, Rules
from sitl_mock.autopilot.battery import BatteryProfile
from sitl_mock.autopilot.guidance import BodyState
from sitl_mock.autopilot.parameters import ERROR_NAME, UNINDEXED, Parameters, WriteRefused, read_defaults
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
    FORCE_BIT,
    LOCAL_NED,
    Interpretation,
    Pose,
    SetpointEffect,
    SetpointFields,
    turned,
)
from sitl_mock.messages import CommandResult, Fields, Outgoing, Received, Severity, SystemStatus
from sitl_mock.physics.reference import ALL, Flags3, Reference, Vec3, plus
from sitl_mock.protocol import commands, services, telemetry
from sitl_mock.protocol.commands import Command, acknowledgement
from sitl_mock.protocol.dialect import Dialect, Strategy
from sitl_mock.protocol.layouts import layout
from sitl_mock.protocol.rows import ROW_BUILDERS, RowBuilder, Rows, Scene, local_position

# -- numbers, names and texts -----------------------------------------------------------------------------------------

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
_MAIN_AUTO = 4
_KNOWN_MAIN_MODES = frozenset(range(1, 9))
_GLOBAL_FRAMES = frozenset({5, 6, 11})  # of SET_POSITION_TARGET_GLOBAL_INT
_UINT32 = 5  # MAV_PARAM_TYPE
_PARAMETER_HASH = 0x5349544C  # `_HASH_CHECK` of a list; constant, since no client compares it here
_ECHO_S = 0.01  # a changed parameter is told a second time, on every link, after the next update
_STREAM_DETECTION_S = 0.05  # a lost stream is noticed 0.01-0.11 s after COM_OF_LOSS_T
_GCS_DETECTION_S = 1.45  # acts 11.45 s after the last heartbeat with COM_DL_LOSS_T 10
_NO_AID_S = 5.0  # EKF2_NOAID_TOUT
# The worst first: level, parameter, text.
_BATTERY_LEVELS = (
    (ModeEvent.BATTERY_EMERGENCY, "BAT_EMERGEN_THR", "Emergency battery level"),
    (ModeEvent.BATTERY_CRITICAL, "BAT_CRIT_THR", "Critical battery level"),
    (ModeEvent.BATTERY_LOW, "BAT_LOW_THR", "Low battery level"),
)
_LOWEST_CONE_M = 1.0  # lowest return above home
# The real PX4 holds each setpoint until the next. At 20 Hz and 10 m/s that alone costs 0.16 m rms here, where
# nothing else is in error; so a setpoint runs on, but never longer than this.
_CARRY_S = 0.1

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
    gps_fix=3,
    airspeed_measured=False,
    home_quaternion=(1.0, 0.0, 0.0, 0.0),
    # 74 after half a minute armed
    battery=BatteryProfile(full=100, drain_per_s=0.9, least=50, cells=4, full_cell_v=4.05, empty_cell_v=3.5),
    parameters=read_defaults(Path(__file__).with_suffix(".toml")),
    parameters_bytewise=True,
    system_id_parameter="MAV_SYS_ID",
    idle_disarm_parameter="COM_DISARM_PRFLT",
    speeds=SpeedParameters(
        scale=1.0,
        horizontal="MPC_XY_VEL_MAX",
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
    position_error_m=(0.15, 0.35),
)


# -- rules ------------------------------------------------------------------------------------------------------------


class Px4Rules(Rules):
    """What PX4 does in a way of its own."""

    def status(self, vehicle: Autopilot) -> SystemStatus:
        """Armed is active, and standby says that arming would work."""
        if vehicle.armed:
            return SystemStatus.ACTIVE
        return SystemStatus.STANDBY if self.arming_refusal(vehicle) is None else SystemStatus.UNINIT

    def arming_refusal(self, vehicle: Autopilot) -> str | None:
        """One text for every reason."""
        gcs_needed = vehicle.parameters["NAV_DLL_ACT"] > 0
        gcs_missing = vehicle.now_s - vehicle.gcs_heard_at_s > vehicle.parameters["COM_DL_LOSS_T"]
        unable = not vehicle.ready or not vehicle.mode.armable or vehicle.lacks(vehicle.mode)
        return "Arming denied: Resolve system health failures first" if unable or (gcs_needed and gcs_missing) else None

    def landed_disarm_s(self, vehicle: Autopilot) -> float | None:
        """A parameter, in every mode."""
        return vehicle.parameters["COM_DISARM_LAND"]

    def take_off(self, vehicle: Autopilot, height_m: float) -> CommandResult:
        """By a mode."""
        vehicle.guidance.takeoff_height_m = max(height_m, vehicle.body.height_m)
        return vehicle.set_mode(vehicle.modes["TAKEOFF"])

    def interpret(self, fields: SetpointFields, pose: Pose, parameters: Parameters) -> Interpretation:
        """Axis by axis; NaN is the same as ignored; frame 1 for positions."""
        position = _masked(fields.position_m, fields.mask, 0)
        velocity = _masked(fields.velocity_m_s, fields.mask, 3)
        acceleration = _masked(fields.acceleration_m_s2, fields.mask, 6)
        used_p, used_v, used_a = _finite(position), _finite(velocity), _finite(acceleration)
        name = "SET_POSITION_TARGET_LOCAL_NED"
        if fields.frame not in (LOCAL_NED, BODY_NED):
            return _invalid(f"{name} coordinate frame {fields.frame} unsupported")
        if fields.mask & FORCE_BIT and any(used_a):
            return _invalid(f"{name} force not supported")
        if not any(used_p + used_v + used_a) or (fields.frame == BODY_NED and any(used_p)):
            return _invalid(f"{name} invalid")
        controlled = all(p or v or a for p, v, a in zip(used_p, used_v, used_a, strict=True))
        if used_p[0] != used_p[1] or used_v[0] != used_v[1] or not controlled:
            return Interpretation(SetpointEffect.HOLD)
        turn_rad = pose.yaw_rad if fields.frame == BODY_NED else 0.0
        yaw_rad, rate_rad_s = fields.heading()
        return Interpretation(
            SetpointEffect.FLY,
            Reference(
                position_ned_m=plus(_filled(position), pose.local_origin_ned_m),
                velocity_ned_m_s=turned(_filled(velocity), turn_rad),
                acceleration_ned_m_s2=turned(_filled(acceleration), turn_rad),
                position_used=used_p,
                velocity_used=used_v,
                yaw_rad=yaw_rad,
                yaw_rate_rad_s=rate_rad_s,
                since_s=pose.now_s,
                carry_s=_CARRY_S,
            ),
        )

    def streamed(self, fields: SetpointFields, position_ned_m: Vec3, vehicle: Autopilot) -> Reference:
        """Every axis counts."""
        return Reference(
            position_ned_m,
            fields.velocity_m_s,
            fields.acceleration_m_s2,
            ALL,
            ALL,
            math.remainder(fields.yaw_rad, 2.0 * math.pi),
            since_s=vehicle.now_s,
            carry_s=_CARRY_S,
        )

    def on_setpoint(self, vehicle: Autopilot, reference: Reference | None) -> bool:
        """Keep it in every mode; without a reference the vehicle stays where it is from here on."""
        if reference is None and vehicle.guidance.setpoint is not None:
            vehicle.guidance.enter(vehicle.body)
        vehicle.guidance.setpoint = reference
        return True

    def stream_fresh(self, vehicle: Autopilot) -> bool:
        """Within COM_OF_LOSS_T, and a little."""
        return vehicle.now_s <= self.stream_lost_at_s(vehicle)

    def stream_lost_at_s(self, vehicle: Autopilot) -> float:
        """COM_OF_LOSS_T after the last setpoint, and a little."""
        return vehicle.setpoint_at_s + vehicle.parameters["COM_OF_LOSS_T"] + _STREAM_DETECTION_S

    def watch_failsafes(self, vehicle: Autopilot) -> None:
        """The battery, the ground station once it was heard, then the stream of setpoints."""
        self._watch_battery(vehicle)
        if math.isfinite(vehicle.gcs_heard_at_s):
            self._watch_gcs(vehicle)
        if vehicle.armed:
            self._watch_stream(vehicle)

    def watch_position(self, vehicle: Autopilot) -> None:
        """Dead reckoning is given up after EKF2_NOAID_TOUT; in the air the vehicle then comes down where it is."""
        lost_at_s = vehicle.gps_lost_at_s
        vehicle.position_lost = lost_at_s is not None and vehicle.now_s - lost_at_s > _NO_AID_S
        if vehicle.position_lost and vehicle.armed and vehicle.failsafe is not ModeEvent.POSITION_LOST:
            vehicle.send_text("Failsafe activated")
            vehicle.fail(ModeEvent.POSITION_LOST, "LAND", keep_intention=True)

    def _watch_battery(self, vehicle: Autopilot) -> None:
        """Each level is told once, and acted on by COM_LOW_BAT_ACT."""
        for level, threshold, text in _BATTERY_LEVELS:
            if vehicle.battery.share >= vehicle.parameters[threshold]:
                continue
            if vehicle.battery_failsafe is level:
                return
            vehicle.battery_failsafe = level
            vehicle.send_text(text, Severity.WARNING)
            modes = self.profile.failsafe_modes.get(level, {})
            action = int(vehicle.parameters["COM_LOW_BAT_ACT"])
            if action in modes:
                vehicle.send_text("Failsafe activated", Severity.WARNING)
                vehicle.fail(level, modes[action], keep_intention=True)
            return

    def _watch_gcs(self, vehicle: Autopilot) -> None:
        """Hold for COM_FAIL_ACT_T, then return or land; heartbeats that come back cancel nothing."""
        action = int(vehicle.parameters["NAV_DLL_ACT"])
        limit_s = vehicle.parameters["COM_DL_LOSS_T"] + _GCS_DETECTION_S
        lost = vehicle.now_s - vehicle.gcs_heard_at_s > limit_s
        modes = self.profile.failsafe_modes[ModeEvent.GCS_LOST]
        if lost and not vehicle.gcs_missed and action in modes:
            vehicle.gcs_missed = True
            vehicle.send_text("Failsafe activated", Severity.WARNING)
            vehicle.fail(ModeEvent.GCS_LOST, modes[action], keep_intention=True)
        elif not lost:
            vehicle.gcs_missed = False
        later = self.profile.failsafe_modes[ModeEvent.FAILSAFE_DELAY_OVER].get(action)
        if later is None or vehicle.failsafe is not ModeEvent.GCS_LOST:
            return
        if vehicle.now_s - vehicle.failsafe_at_s >= vehicle.parameters["COM_FAIL_ACT_T"]:
            vehicle.change(vehicle.modes[later], keep_intention=True)

    def _watch_stream(self, vehicle: Autopilot) -> None:
        """OFFBOARD without setpoints is left by COM_OBL_RC_ACT; with setpoints again it is entered again."""
        fresh = self.stream_fresh(vehicle)
        if vehicle.failsafe is ModeEvent.STREAM_LOST and fresh:
            vehicle.failsafe = None
            vehicle.change(vehicle.intended, keep_intention=True)
        elif vehicle.mode.name == self.profile.stream_mode and not fresh:
            modes = self.profile.failsafe_modes[ModeEvent.STREAM_LOST]
            # Unknown values act like the default, Position.
            mode = modes.get(int(vehicle.parameters["COM_OBL_RC_ACT"]), modes[0])
            vehicle.fail(ModeEvent.STREAM_LOST, mode, keep_intention=True)
            vehicle.send_text("Failsafe activated")

    def landing_speed_m_s(self, parameters: Parameters, height_m: float) -> float:
        """1.5, 0.7, 0.3 m/s by height, with a ramp between the first two."""
        high_m, low_m = parameters["MPC_LAND_ALT1"], parameters["MPC_LAND_ALT2"]
        fast_m_s, slow_m_s = parameters.positive("MPC_Z_V_AUTO_DN"), parameters.positive("MPC_LAND_SPEED")
        if height_m < parameters["MPC_LAND_ALT3"]:
            return parameters.positive("MPC_LAND_CRWL")
        share = min(max((height_m - low_m) / max(high_m - low_m, 0.1), 0.0), 1.0)
        return slow_m_s + share * (fast_m_s - slow_m_s)

    def return_height_m(self, parameters: Parameters, away_m: float) -> float:
        """RTL_RETURN_ALT, or less in a cone above home."""
        highest_m = parameters["RTL_RETURN_ALT"]
        if away_m > parameters["RTL_MIN_DIST"]:
            return highest_m
        half_rad = math.radians(min(max(parameters["RTL_CONE_ANG"], 1.0), 89.0))
        return min(highest_m, max(away_m, _LOWEST_CONE_M) / math.tan(half_rad))

    def return_wait_s(self, parameters: Parameters) -> float:
        """A parameter in seconds."""
        return parameters["RTL_LAND_DELAY"]


def _invalid(text: str) -> Interpretation:
    return Interpretation(SetpointEffect.INVALID, text=text)


def _masked(values: Vec3, mask: int, shift: int) -> Vec3:
    x, y, z = (math.nan if mask & (1 << (shift + i)) else value for i, value in enumerate(values))
    return (x, y, z)


def _finite(values: Vec3) -> Flags3:
    x, y, z = (math.isfinite(value) for value in values)
    return (x, y, z)


def _filled(values: Vec3) -> Vec3:
    x, y, z = (value if math.isfinite(value) else 0.0 for value in values)
    return (x, y, z)


# -- commands ---------------------------------------------------------------------------------------------------------


def _arm(vehicle: Autopilot, command: Command) -> CommandResult | None:
    given = command.parameters[0]
    arming = round(given) if math.isfinite(given) and abs(given) < 10 else given
    if given == 0.5:
        arming = 1  # measured: 0.5 counts as 1
    if arming not in (0, 1):
        vehicle.send_text(f"Unsupported ARM_DISARM param: {given:.3f}")
        return None
    code = command.parameters[1]
    if arming == 1:
        return vehicle.arm(force=code in (commands.FORCE_ARM, commands.FORCE_DISARM))
    return vehicle.disarm("command", force=code == commands.FORCE_DISARM)


def _set_mode(vehicle: Autopilot, command: Command) -> CommandResult | None:
    base, main, sub = (command.whole(i) for i in (1, 2, 3))
    if base is None or not base & commands.CUSTOM_MODE_BIT:
        return CommandResult.DENIED
    # The MAVLink receiver acknowledges before the commander decides; the truth comes second.
    vehicle.outbox.append(acknowledgement(command, CommandResult.ACCEPTED))
    if main not in _KNOWN_MAIN_MODES:
        return CommandResult.ACCEPTED  # measured: accepted, nothing happens
    number = main << 16 | ((sub or 0) & 0xFF) << 24
    mode = next((m for m in vehicle.profile.modes if m.number == number), None)
    if mode is None:
        if main == _MAIN_AUTO:
            vehicle.send_text("Unsupported auto mode")
        return CommandResult.TEMPORARILY_REJECTED
    if mode.behaviour is Behaviour.TAKEOFF:
        return _take_off_default(vehicle)
    return vehicle.set_mode(mode)


def _take_off_default(vehicle: Autopilot) -> CommandResult:
    height_m = vehicle.parameters["MIS_TAKEOFF_ALT"]
    vehicle.send_text(f"Using default takeoff altitude: {height_m:.1f} m", Severity.INFO)
    return vehicle.rules.take_off(vehicle, height_m)


def _take_off(vehicle: Autopilot, command: Command) -> CommandResult | None:
    amsl_m = command.parameters[6]
    if not math.isfinite(amsl_m):
        return _take_off_default(vehicle)
    return vehicle.rules.take_off(vehicle, amsl_m - vehicle.world.origin.altitude_m)


def _reboot(vehicle: Autopilot, command: Command) -> CommandResult | None:
    """The simulator goes on."""
    return CommandResult.ACCEPTED if command.parameters[0] == 0.0 else CommandResult.DENIED


def _start_mission(vehicle: Autopilot, command: Command) -> CommandResult | None:
    vehicle.send_text("Mission start denied! No valid mission")
    return CommandResult.DENIED


def _never_answer(vehicle: Autopilot, command: Command) -> CommandResult | None:
    return None


# -- messages ---------------------------------------------------------------------------------------------------------


def _heartbeat(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if message.fields["type"] == services.GCS_TYPE:
        vehicle.links[link].texts_open = True
        vehicle.gcs_heard_at_s = now_s


def _setpoint_global(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    frame = int(message.fields["coordinate_frame"])
    if frame in _GLOBAL_FRAMES:
        services.setpoint_global(vehicle, message, link, now_s)
    elif services.addressed(vehicle, message, system_0=True):
        vehicle.act_on(_invalid(f"SET_POSITION_TARGET_GLOBAL_INT invalid coordinate frame {frame}"))


def _ping(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    f = message.fields
    if f["target_system"] == 0:
        back = {"target_system": message.system, "target_component": message.component}
        vehicle.send("PING", {"time_usec": f["time_usec"], "seq": f["seq"], **back}, link)


def _list_parameters(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not services.parameters_addressed(vehicle, message):
        return
    services.begin_parameter_list(vehicle, message, link, now_s)
    fields = {
        "param_id": b"_HASH_CHECK",
        "param_value": float(_PARAMETER_HASH & 0x7FFFFF),
        "param_type": _UINT32,
        "param_count": len(vehicle.parameters),
        "param_index": UNINDEXED,
    }
    vehicle.send("PARAM_VALUE", fields, link)


def _read_parameter(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not services.parameters_addressed(vehicle, message):
        return
    name = services.requested_parameter(vehicle, message)
    if name in vehicle.parameters:
        vehicle.send("PARAM_VALUE", vehicle.parameters.message(name, indexed=True), link)
    else:
        _send_parameter_error(vehicle, message, name, link, ERROR_NAME)


def _set_parameter(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not services.parameters_addressed(vehicle, message):
        return
    f = message.fields
    name = f["param_id"]
    try:
        changed = vehicle.parameters.write(name, f["param_value"], f["param_type"])
    except WriteRefused as refusal:
        _send_parameter_error(vehicle, message, name, link, refusal.error)
        return
    answer = vehicle.parameters.message(name, indexed=True)
    vehicle.send("PARAM_VALUE", answer, link)
    if changed:
        vehicle.send_later(now_s + _ECHO_S, Outgoing("PARAM_VALUE", answer))


def _send_parameter_error(vehicle: Autopilot, message: Received, name: str, link: int, error: int) -> None:
    back = {"target_system": message.system, "target_component": message.component}
    fields = {"param_id": name.encode("ascii", "replace"), "param_index": 0, "error": error}
    vehicle.send("PARAM_ERROR", back | fields, link)


# -- telemetry --------------------------------------------------------------------------------------------------------


def _position_target(scene: Scene, rows: Rows) -> NDArray[np.void]:
    """POSITION_TARGET_LOCAL_NED: the controller's setpoint, run on to the present."""
    commands = scene.commands
    made = layout("POSITION_TARGET_LOCAL_NED").rows(len(rows))
    run_s = np.minimum(np.maximum(scene.time_s - commands.since_s[rows], 0.0), commands.carry_s[rows])[:, None]
    acceleration_m_s2 = commands.acceleration_m_s2[rows]
    velocity_m_s = commands.velocity_m_s[rows] + acceleration_m_s2 * run_s
    moved_m = (commands.velocity_m_s[rows] + 0.5 * acceleration_m_s2 * run_s) * run_s
    position_m = scene.table.local_m(rows, commands.position_m[rows] + moved_m)
    flying = commands.flying[rows]
    placed = commands.position_used[rows].all(axis=1) & flying
    on_ground = (math.nan, math.nan, 100.0)  # of acceleration: measured
    for k, axis in enumerate("xyz"):
        made[axis] = np.where(placed, position_m[:, k], math.nan)
        made["v" + axis] = np.where(flying, velocity_m_s[:, k], math.nan)
        made["af" + axis] = np.where(flying, acceleration_m_s2[:, k], on_ground[k])
    made["yaw"] = np.where(commands.yaw_used[rows], commands.yaw_rad[rows], 0.0)
    made["type_mask"] = np.where(flying, np.where(placed, 0, 7), 63)
    made["coordinate_frame"] = LOCAL_NED
    return made


def _current_mode(vehicle: Autopilot, body: BodyState) -> Fields:
    return {
        "standard_mode": vehicle.mode.standard_mode,
        "custom_mode": vehicle.mode.number,
        "intended_custom_mode": vehicle.intended.number,
    }


def _altitude(vehicle: Autopilot, body: BodyState) -> Fields:
    amsl_m = vehicle.world.origin.altitude_m - body.position_m[2]
    return {
        "time_usec": telemetry.boot_us(body),
        "altitude_monotonic": amsl_m,
        "altitude_amsl": amsl_m,
        "altitude_local": -telemetry.local_m(vehicle, body)[2],
        "altitude_relative": vehicle.home_ned_m[2] - body.position_m[2],
        "altitude_terrain": math.nan,
        "bottom_clearance": math.nan,
    }


# -- tables -----------------------------------------------------------------------------------------------------------

_UNANSWERED = (203, 205, 206, 242, 420, 500, 521, 530, 1000, 2510, 2511, 3000, 30001, 42600)  # measured
_NO_OPERATIONS = (178, 179, 187, 191, 195, 197, 201, 241, 245, 401, 519, 525, 528, 43003)

STRATEGY = Strategy(
    Px4Rules(PROFILE),
    Dialect(
        messages=MappingProxyType(
            dict(services.MESSAGES)
            | {
                "HEARTBEAT": _heartbeat,
                "SET_MODE": services.set_mode_with(commands.set_mode_by_number),
                "SET_POSITION_TARGET_GLOBAL_INT": _setpoint_global,
                "PING": _ping,
                "PARAM_REQUEST_LIST": _list_parameters,
                "PARAM_REQUEST_READ": _read_parameter,
                "PARAM_SET": _set_parameter,
            }
        ),
        commands=MappingProxyType(
            dict(commands.COMMANDS)
            | {
                commands.NAV_RETURN_TO_LAUNCH: commands.change_mode_to("RTL", "Returning to launch"),
                commands.NAV_LAND: commands.change_mode_to("LAND", "Landing at current position"),
                commands.NAV_TAKEOFF: _take_off,
                commands.DO_SET_MODE: _set_mode,
                commands.DO_REPOSITION: commands.reposition_in("LOITER"),
                commands.PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
                commands.MISSION_START: _start_mission,
                commands.COMPONENT_ARM_DISARM: _arm,
            }
            | dict.fromkeys(_UNANSWERED, _never_answer)
        ),
        fixed_results=MappingProxyType(
            dict.fromkeys(_NO_OPERATIONS, CommandResult.ACCEPTED)
            | {
                185: CommandResult.DENIED,
                189: CommandResult.CANCELLED,
                211: CommandResult.IN_PROGRESS,
                2600: CommandResult.FAILED,
            }
        ),
        builders=MappingProxyType(
            dict(telemetry.BUILDERS)
            | {
                "CURRENT_MODE": _current_mode,
                "ALTITUDE": _altitude,
            }
        ),
        row_builders=MappingProxyType(
            dict(ROW_BUILDERS)
            | {
                "LOCAL_POSITION_NED": RowBuilder(local_position),  # sent before there is a position
                "POSITION_TARGET_LOCAL_NED": RowBuilder(_position_target),
            }
        ),
    ),
)
