"""ArduCopter 4.7 as its SITL answers and flies: what it does in a way of its own."""

from __future__ import annotations

import math

from sitl_mock.autopilot.autopilot import Autopilot, Rules
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.autopilot.profile import (
    Behaviour,
    ModeEvent,
    Need,
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
from sitl_mock.messages import CommandResult, Landed, Severity, SystemStatus
from sitl_mock.physics.reference import ALL, NONE, ZERO, Reference, Vec3, plus

_POSITIONLESS_MODES = frozenset({"STABILIZE", "ALT_HOLD"})  # can be armed in without a position
_CLIMBING_MODES = frozenset({"GUIDED", "LOITER"})  # can be taken off in
_LANDED_DISARM_S = 0.5  # disarms this long after it reported ON_GROUND in LAND and RTL
_FASTEST_OBEYED_M_S = 1000.0  # a velocity beyond brakes
_FARTHEST_SURVIVED_M = 1e8  # a position of 1e9 m killed the SITL, 1e6 m was flown to
_SLOWEST_TRAVEL = 1.0  # below a metre, or a metre per second, the direction of travel is noise
_BATTERY_LEVELS = (
    (ModeEvent.BATTERY_CRITICAL, "BATT_CRT_VOLT", "BATT_FS_CRT_ACT", "critical"),
    (ModeEvent.BATTERY_LOW, "BATT_LOW_VOLT", "BATT_FS_LOW_ACT", "low"),
)
_CAPACITY_MAH = 3300
_EKF_FAILSAFE_S, _STOPS_AIDING_S = 8.1, 15.1  # after the satellites are gone


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
