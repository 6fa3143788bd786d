"""Leaving the ground and coming back to it: lift-off, landing detection, disarming by itself."""

from __future__ import annotations

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.profiles import Behaviour, ModeEvent
from sitl_mock.messages import Landed, Severity
from sitl_mock.physics.reference import ALL, Reference

LIFT_M = 0.15  # a setpoint this much above the vehicle lifts PX4 off
LIFT_M_S = 0.1  # and so does an upward velocity
LANDED_DISARM_S = 0.5  # ArduPilot disarms this long after it reported ON_GROUND in LAND and RTL


class GroundWatch:
    """Watches one vehicle.

    Args:
        vehicle: the vehicle.
    """

    def __init__(self, vehicle: Autopilot) -> None:
        self._vehicle = vehicle
        self._contact_since_s: float | None = None

    def watch(self) -> None:
        """Look once (50 Hz)."""
        vehicle = self._vehicle
        if not vehicle.armed:
            return
        if not vehicle.airborne:
            self._lift()
        elif vehicle.behaviour is Behaviour.TAKEOFF and vehicle.pilot.reached(vehicle.body):
            self._level_off()
        if vehicle.airborne:
            self._touch_down()
        if not vehicle.airborne and vehicle.landed is Landed.ON_GROUND:
            self._disarm()

    def _wants_up(self) -> bool:
        """Whether what is asked leads off the ground."""
        vehicle = self._vehicle
        if vehicle.behaviour is Behaviour.TAKEOFF:
            return True
        setpoint = vehicle.pilot.setpoint
        if vehicle.behaviour is not Behaviour.FOLLOW or setpoint is None:
            return False
        above_m = vehicle.body.position_m[2] - setpoint.position_ned_m[2]
        return (setpoint.position_used[2] and above_m > LIFT_M) or (
            setpoint.velocity_used[2] and setpoint.velocity_ned_m_s[2] < -LIFT_M_S
        )

    def _lift(self) -> None:
        """Leave the ground some seconds after it was first wanted, as spooling and ramps make the real ones do."""
        vehicle, profile = self._vehicle, self._vehicle.profile
        takeoff = vehicle.behaviour is Behaviour.TAKEOFF
        if not self._wants_up() or not (takeoff or profile.setpoints_lift_off):
            vehicle.climb_since_s = None
            return
        if vehicle.climb_since_s is None:
            vehicle.climb_since_s = max(vehicle.body.time_s, vehicle.armed_at_s + profile.spool_s)
        waited_s = vehicle.body.time_s - vehicle.climb_since_s
        if takeoff and waited_s >= profile.takeoff_state_s and vehicle.landed is Landed.ON_GROUND:
            vehicle.landed = Landed.TAKEOFF
            if profile.is_px4:
                vehicle.say("Takeoff detected", Severity.INFO)
        if waited_s >= (profile.liftoff_s if takeoff else profile.liftoff_stream_s):
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
        place = (north_m, east_m, -vehicle.pilot.takeoff_height_m)
        vehicle.pilot.setpoint = Reference(place, position_used=ALL, yaw_rad=vehicle.body.yaw_rad)

    def _touch_down(self) -> None:
        """On the ground long enough while not asked to climb: landed."""
        vehicle = self._vehicle
        px4, now_s = vehicle.profile.is_px4, vehicle.body.time_s
        if vehicle.mode.behaviour is Behaviour.RETURN and vehicle.pilot.descending:
            vehicle.landed = Landed.LANDING
        # PX4 does not take a position setpoint below the ground for a landing: it sits there armed.
        sitting = px4 and vehicle.behaviour is Behaviour.FOLLOW and not vehicle.reference.velocity_used[2]
        if not vehicle.body.contact or self._wants_up() or sitting:
            self._contact_since_s = None
            return
        if self._contact_since_s is None:
            self._contact_since_s = now_s
        if now_s - self._contact_since_s >= vehicle.profile.ground_detect_s:
            vehicle.airborne = False
            vehicle.landed = Landed.ON_GROUND
            vehicle.landed_at_s = now_s
            if px4:
                vehicle.say("Landing detected", Severity.INFO)

    def _disarm(self) -> None:
        """After a landing, or armed for too long without a take-off."""
        vehicle, value = self._vehicle, self._vehicle.parameters
        px4, now_s, landed_at_s = vehicle.profile.is_px4, vehicle.body.time_s, vehicle.landed_at_s
        ending = px4 or vehicle.mode.behaviour in (Behaviour.LAND, Behaviour.RETURN)
        if landed_at_s is not None and ending:
            delay_s = value["COM_DISARM_LAND"] if px4 else LANDED_DISARM_S
            if delay_s > 0.0 and now_s - landed_at_s >= delay_s:
                vehicle.disarm("landing")
            return
        idle_s = value["COM_DISARM_PRFLT" if px4 else "DISARM_DELAY"]
        since_s = vehicle.armed_at_s if landed_at_s is None else landed_at_s
        # A wish to climb that is being served is not idling.
        idle = vehicle.climb_since_s is None and now_s - since_s >= idle_s + vehicle.profile.idle_extra_s
        if idle_s > 0.0 and idle:
            vehicle.disarm("idle")
