"""PX4 1.17 as its SITL answers and flies: what it does in a way of its own."""

from __future__ import annotations

import math

from sitl_mock.autopilot.autopilot import Autopilot, Rules
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.autopilot.profile import (
    ModeEvent,
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
from sitl_mock.messages import CommandResult, Severity, SystemStatus
from sitl_mock.physics.reference import ALL, Flags3, Reference, Vec3, plus

_STREAM_DETECTION_S = 0.05  # a lost stream is noticed 0.01-0.11 s after COM_OF_LOSS_T
_GCS_DETECTION_S = 1.45  # acts 11.45 s after the last heartbeat with COM_DL_LOSS_T 10
_NO_AID_S = 5.0  # EKF2_NOAID_TOUT
_BATTERY_LEVELS = (
    (ModeEvent.BATTERY_EMERGENCY, "BAT_EMERGEN_THR", "Emergency battery level"),
    (ModeEvent.BATTERY_CRITICAL, "BAT_CRIT_THR", "Critical battery level"),
    (ModeEvent.BATTERY_LOW, "BAT_LOW_THR", "Low battery level"),
)
_LOWEST_CONE_M = 1.0  # lowest return above home
_CARRY_S = 0.1


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
            return invalid(f"{name} coordinate frame {fields.frame} unsupported")
        if fields.mask & FORCE_BIT and any(used_a):
            return invalid(f"{name} force not supported")
        if not any(used_p + used_v + used_a) or (fields.frame == BODY_NED and any(used_p)):
            return invalid(f"{name} invalid")
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


def invalid(text: str) -> Interpretation:
    """A setpoint that does not count as one, and the text that says so."""
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
