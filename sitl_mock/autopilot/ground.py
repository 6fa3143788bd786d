"""Leaving the ground and coming back to it: lift-off, landing detection, disarming by itself."""

from __future__ import annotations

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.profile import Behaviour, ModeEvent
from sitl_mock.messages import Landed, Severity
from sitl_mock.physics.reference import ALL, Reference

LIFT_M = 0.15  # a setpoint this much above the vehicle asks to leave the ground
LIFT_M_S = 0.1  # and so does an upward velocity


class GroundWatch:
    """Watches one vehicle.

    Args:
        vehicle: the vehicle.
    """

    def __init__(self, vehicle: Autopilot) -> None:
        self._vehicle = vehicle
        self._contact_since_s: float | None = None

    def watch(self) -> None:
        """Compare the vehicle with the ground once (50 Hz)."""
        vehicle = self._vehicle
        if not vehicle.armed:
            return
        if not vehicle.airborne:
            self._lift()
        elif vehicle.behaviour is Behaviour.TAKEOFF and vehicle.guidance.reached(vehicle.body):
            self._level_off()
        if vehicle.airborne:
            self._touch_down()
        if not vehicle.airborne and vehicle.landed is Landed.ON_GROUND:
            self._disarm()

    def _asked_to_climb(self) -> bool:
        """Whether what is asked leads off the ground."""
        vehicle = self._vehicle
        if vehicle.behaviour is Behaviour.TAKEOFF:
            return True
        setpoint = vehicle.guidance.setpoint
        if vehicle.behaviour is not Behaviour.FOLLOW or setpoint is None:
            return False
        above_m = vehicle.body.position_m[2] - setpoint.position_ned_m[2]
        return (setpoint.position_used[2] and above_m > LIFT_M) or (
            setpoint.velocity_used[2] and setpoint.velocity_ned_m_s[2] < -LIFT_M_S
        )

    def _lift(self) -> None:
        """Leave the ground some seconds after it was first asked for, as spooling and ramps make the real ones do."""
        vehicle, profile = self._vehicle, self._vehicle.profile
        takeoff = vehicle.behaviour is Behaviour.TAKEOFF
        if not self._asked_to_climb() or not (takeoff or profile.setpoints_lift_off):
            vehicle.climb_since_s = None
            vehicle.landed = Landed.ON_GROUND  # whatever take-off had begun
            if vehicle.behaviour is Behaviour.LAND and vehicle.landed_at_s is None:
                vehicle.landed_at_s = vehicle.now_s
            return
        if vehicle.climb_since_s is None:
            vehicle.climb_since_s = max(vehicle.now_s, vehicle.armed_at_s + profile.ground.spool_s)
        waited_s = vehicle.now_s - vehicle.climb_since_s
        if takeoff and waited_s >= profile.ground.takeoff_state_s and vehicle.landed is Landed.ON_GROUND:
            vehicle.landed = Landed.TAKEOFF
            vehicle.send_text(profile.texts.takeoff_detected, Severity.INFO)
        if waited_s >= (profile.ground.liftoff_s if takeoff else profile.ground.liftoff_stream_s):
            vehicle.airborne = True
            vehicle.landed = Landed.TAKEOFF if takeoff else Landed.IN_AIR
            self._contact_since_s = None

    def _level_off(self) -> None:
        """The take-off height is reached."""
        vehicle = self._vehicle
        vehicle.landed = Landed.IN_AIR
        if not vehicle.climbing:
            vehicle.change(vehicle.after(ModeEvent.CLIMBED), keep_intention=False)
            return
        vehicle.climbing = False
        north_m, east_m, _ = vehicle.reference.position_ned_m
        place = (north_m, east_m, -vehicle.guidance.takeoff_height_m)
        vehicle.guidance.setpoint = Reference(place, position_used=ALL, yaw_rad=vehicle.body.yaw_rad)

    def _touch_down(self) -> None:
        """On the ground long enough while not asked to climb: landed."""
        vehicle, profile, now_s = self._vehicle, self._vehicle.profile, self._vehicle.now_s
        if vehicle.mode.behaviour is Behaviour.RETURN and vehicle.guidance.descending:
            vehicle.landed = Landed.LANDING
        positioned = vehicle.behaviour is Behaviour.FOLLOW and not vehicle.reference.velocity_used[2]
        sitting = positioned and not profile.position_setpoints_land
        if not vehicle.body.contact or self._asked_to_climb() or sitting:
            self._contact_since_s = None
            return
        if self._contact_since_s is None:
            self._contact_since_s = now_s
        if now_s - self._contact_since_s >= profile.ground.detection_s:
            vehicle.airborne = False
            vehicle.landed = Landed.ON_GROUND
            vehicle.landed_at_s = now_s
            vehicle.send_text(profile.texts.landing_detected, Severity.INFO)

    def _disarm(self) -> None:
        """After a landing, or armed for too long without a take-off."""
        vehicle, now_s, landed_at_s = self._vehicle, self._vehicle.now_s, self._vehicle.landed_at_s
        delay_s = vehicle.rules.landed_disarm_s(vehicle)
        if landed_at_s is not None and delay_s is not None:
            if delay_s > 0.0 and now_s - landed_at_s >= delay_s:
                vehicle.disarm("landing")
            return
        idle_s = vehicle.parameters[vehicle.profile.idle_disarm_parameter]
        since_s = vehicle.armed_at_s if landed_at_s is None else landed_at_s
        # A request to climb that is being served is not idling.
        waited = now_s - since_s >= idle_s + vehicle.profile.ground.idle_extra_s
        if idle_s > 0.0 and vehicle.climb_since_s is None and waited:
            vehicle.disarm("idle")
