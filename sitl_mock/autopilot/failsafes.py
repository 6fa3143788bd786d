"""What happens by itself when something is missing: the setpoint stream, the ground station."""

from __future__ import annotations

import math

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.profiles import ModeEvent
from sitl_mock.messages import Severity

GCS_LOSS_EXTRA_S = 1.45  # PX4 acts 11.45 s after the last heartbeat with COM_DL_LOSS_T 10


class Failsafes:
    """Watches one vehicle.

    Args:
        vehicle: the vehicle.
    """

    def __init__(self, vehicle: Autopilot) -> None:
        self._vehicle = vehicle
        self._gcs_missed = False

    def watch(self) -> None:
        """Look once (50 Hz)."""
        if self._vehicle.armed:
            self._watch_gcs()
        if self._vehicle.armed:
            self._watch_stream()

    def _watch_stream(self) -> None:
        """PX4: OFFBOARD without setpoints is left by COM_OBL_RC_ACT; with setpoints again it is entered again."""
        vehicle = self._vehicle
        table = vehicle.profile.failsafe_modes[ModeEvent.STREAM_LOST]
        if not table:
            return
        if vehicle.failsafe is ModeEvent.STREAM_LOST and vehicle.stream_fresh:
            vehicle.failsafe = None
            vehicle.change(vehicle.intended, keep_intention=True)
        elif vehicle.mode.name == vehicle.profile.stream_mode and not vehicle.stream_fresh:
            # Unknown values act like the default, Position.
            self._fail(ModeEvent.STREAM_LOST, table.get(int(vehicle.parameters["COM_OBL_RC_ACT"]), table[0]))
            vehicle.say("Failsafe activated")

    def _watch_gcs(self) -> None:
        """Heartbeats of the ground station: lost (only if it was ever there), and back."""
        vehicle = self._vehicle
        if not math.isfinite(vehicle.gcs_heard_at_s):
            return
        px4 = vehicle.profile.is_px4
        if px4:
            action = int(vehicle.parameters["NAV_DLL_ACT"])
            limit_s = vehicle.parameters["COM_DL_LOSS_T"] + GCS_LOSS_EXTRA_S
        else:
            action, limit_s = int(vehicle.parameters["FS_GCS_ENABLE"]), vehicle.parameters["FS_GCS_TIMEOUT"]
        lost = vehicle.body.time_s - vehicle.gcs_heard_at_s > limit_s
        table = vehicle.profile.failsafe_modes[ModeEvent.GCS_LOST]
        if lost and not self._gcs_missed and action in table:
            self._gcs_missed = True
            vehicle.say("Failsafe activated" if px4 else "GCS Failsafe", Severity.WARNING)
            if vehicle.airborne or px4:
                self._fail(ModeEvent.GCS_LOST, table[action])
            else:
                vehicle.disarm("failsafe")  # ArduPilot, armed on the ground
        elif not lost and self._gcs_missed:
            self._gcs_missed = False
            if not px4:  # the mode stays; on PX4 returning heartbeats cancel nothing
                vehicle.failsafe = None
                vehicle.say("GCS Failsafe Cleared", Severity.WARNING)
        self._act_later(action)

    def _act_later(self, action: int) -> None:
        """PX4 holds for COM_FAIL_ACT_T before it returns or lands."""
        vehicle = self._vehicle
        later = vehicle.profile.failsafe_modes[ModeEvent.FAILSAFE_DELAY_OVER].get(action)
        if later is None or vehicle.failsafe is not ModeEvent.GCS_LOST:
            return
        if vehicle.body.time_s - vehicle.failsafe_at_s >= vehicle.parameters["COM_FAIL_ACT_T"]:
            vehicle.change(vehicle.modes[later], keep_intention=True)

    def _fail(self, event: ModeEvent, mode_name: str) -> None:
        vehicle = self._vehicle
        vehicle.failsafe, vehicle.failsafe_at_s = event, vehicle.body.time_s
        if mode_name:
            # PX4 remembers what was intended, ArduPilot does not.
            vehicle.change(vehicle.modes[mode_name], keep_intention=vehicle.profile.is_px4)
        else:
            vehicle.disarm("failsafe", force=True)
