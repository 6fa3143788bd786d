"""One vehicle: its state and its verbs (arm, disarm, change mode, take off, obey a setpoint). Sans-IO.

Messages go in by `commands.py` and `services.py`, which call the verbs of `Autopilot`; `failsafes.py` and `ground.py`
watch what happens by itself; messages come out of `outbox`; `reference`, `limits` and `thrust` are what the physics is
asked to do. What differs between PX4 and ArduPilot is in `profiles.py`.
"""

from __future__ import annotations

import heapq
import math
from typing import NamedTuple

from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.autopilot.pilot import Body, Pilot
from sitl_mock.autopilot.profiles import AutopilotProfile, Behaviour, FlightMode, ModeEvent, Need
from sitl_mock.autopilot.setpoints import Understood, Verdict
from sitl_mock.links import Link
from sitl_mock.messages import CommandResult, Fields, Landed, Outgoing, Severity, StatusText
from sitl_mock.physics.geodesy import World
from sitl_mock.physics.reference import Limits, Reference, Thrust, Vec3

DETECTION_S = 0.05  # PX4 notices a lost stream 0.01-0.11 s after COM_OF_LOSS_T
TEXT_CHUNK = 50  # STATUSTEXT.text


class Setup(NamedTuple):
    """What makes a vehicle this vehicle."""

    system_id: int
    links: int
    real_boot: bool
    pad_ned_m: Vec3  # world
    origin_error_ned_m: Vec3  # local origin minus pad
    drift_rad: float


class Deferred(NamedTuple):
    """An answer that the real autopilot gives later; `order` keeps equal times in the order they were made."""

    due_s: float
    order: int
    message: Outgoing


class Autopilot:
    """State machine of one vehicle.

    Args:
        profile: PX4's or ArduPilot's table.
        setup: identity and place.
        world: the ground it flies over.
    """

    def __init__(self, profile: AutopilotProfile, setup: Setup, world: World) -> None:
        self.profile = profile
        self.world = world
        self.system_id = setup.system_id
        self.boot = profile.boot if setup.real_boot else profile.quick_boot
        self.parameters = Parameters(profile, setup.system_id)
        self.pilot = Pilot(profile, self.parameters, setup.drift_rad)
        self.modes = {mode.name: mode for mode in profile.modes}
        self.mode = self.intended = self.modes[profile.first_mode]
        self.links = [Link(profile.default_streams, self.boot.heartbeat_s) for _ in range(setup.links)]
        self.outbox: list[Outgoing] = []
        self.body = Body(0.0, setup.pad_ned_m, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0, True)
        x, y, z = (p + e for p, e in zip(setup.pad_ned_m, setup.origin_error_ned_m, strict=True))
        self.local_origin_ned_m: Vec3 = (x, y, z)
        self.origin_set = False
        self.home_ned_m: Vec3 = setup.pad_ned_m
        self.pilot.home_m = setup.pad_ned_m[:2]

        self.armed = False
        self.airborne = False
        self.flown_s = 0.0  # armed time in all, for the battery
        self.landed = Landed.ON_GROUND
        self.failsafe: ModeEvent | None = None
        self.failsafe_at_s = 0.0
        self.climbing = False  # a take-off inside the present mode (ArduPilot)
        self.setpoint_at_s = -math.inf
        self.gcs_heard_at_s = -math.inf
        self.reference = Reference()
        self.limits: Limits = self.pilot.limits()
        self.thrust = Thrust.OFF
        self.armed_at_s = -math.inf
        self.climb_since_s: float | None = None  # motors ready and something asks to leave the ground
        self.landed_at_s: float | None = None  # since the last arming
        self._texts = 0
        self._deferred: list[Deferred] = []
        self._orders = 0

    # -- what the vehicle says ------------------------------------------------------------------------------------

    def send(self, name: str, fields: Fields | None = None, link: int | None = None) -> None:
        """Put a message into the outbox; without fields it is built from the vehicle's state."""
        self.outbox.append(Outgoing(name, fields, link))

    def send_later(self, due_s: float, message: Outgoing) -> None:
        """Put a message into the outbox when its time has come."""
        self._orders += 1
        heapq.heappush(self._deferred, Deferred(due_s, self._orders, message))

    def say(self, text: str, severity: Severity | None = None) -> None:
        """Send a STATUSTEXT on every link that hears texts, in chunks of 50 characters."""
        data = (text + self.profile.text_suffix).encode("ascii", "replace")
        level = self.profile.text_severity if severity is None else severity
        chunks = [data[i : i + TEXT_CHUNK] for i in range(0, len(data), TEXT_CHUNK)]
        number = 0
        if len(chunks) > 1:
            self._texts = number = self._texts % 65535 + 1
        for index, link in enumerate(self.links):
            if link.texts_open:
                for k, chunk in enumerate(chunks):
                    fields = {"severity": int(level), "text": chunk, "id": number, "chunk_seq": k}
                    self.send("STATUSTEXT", fields, index)

    # -- what the vehicle is --------------------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """Whether the estimator has a position."""
        return self.body.time_s >= self.boot.ready_s

    @property
    def stream_fresh(self) -> bool:
        """Whether a setpoint came recently enough for PX4's OFFBOARD."""
        name = self.profile.stream_parameter
        return name is None or self.body.time_s - self.setpoint_at_s <= self.parameters[name] + DETECTION_S

    @property
    def status(self) -> StatusText:
        """HEARTBEAT.system_status."""
        if self.body.time_s < self.boot.standby_s:
            return StatusText.UNINIT if self.profile.is_px4 else StatusText.BOOT
        if self.failsafe is not None and self.armed:
            return StatusText.CRITICAL
        if self.profile.is_px4:  # PX4: armed is active, and standby says that arming would work
            return (
                StatusText.ACTIVE
                if self.armed
                else StatusText.STANDBY
                if self.arming_refusal() is None
                else StatusText.UNINIT
            )
        return StatusText.ACTIVE if self.landed is not Landed.ON_GROUND else StatusText.STANDBY

    def arming_refusal(self) -> str | None:
        """Why arming in the present mode would be refused now; None: it would not."""
        mode = self.mode
        if self.profile.is_px4:
            gcs_wanted = self.parameters["NAV_DLL_ACT"] > 0
            deaf = self.body.time_s - self.gcs_heard_at_s > self.parameters["COM_DL_LOSS_T"]
            lacking = mode.need in (Need.PILOT, Need.MISSION) or (mode.need is Need.STREAM and not self.stream_fresh)
            if not self.ready or not mode.armable or lacking or (gcs_wanted and deaf):
                return "Arming denied: Resolve system health failures first"
            return None
        if self.body.time_s < self.boot.standby_s:
            return "Arm: System not initialised"
        if mode.need is Need.MISSION:
            return "Arm: Mode requires mission"
        if not mode.armable:
            return f"Arm: {mode.name} mode not armable"
        if not self.ready and mode.name not in ("STABILIZE", "ALT_HOLD"):
            return "Arm: Need Position Estimate"
        return None

    # -- verbs ----------------------------------------------------------------------------------------------------

    def arm(self, force: bool) -> CommandResult:
        """Arm, unless something speaks against it and `force` does not."""
        if self.armed:
            return CommandResult.ACCEPTED
        refusal = None if force else self.arming_refusal()
        if refusal is not None:
            self.say(refusal)
            return self.profile.refused_arming
        self.armed = True
        self.armed_at_s = self.body.time_s
        self.climb_since_s = self.landed_at_s = None
        self.failsafe = None
        self.pilot.enter(self.body)
        self.set_home(self.body.position_m)
        if not self.profile.is_px4:
            self.send("GPS_GLOBAL_ORIGIN")
            self.pilot.setpoint = None
        self.say("Armed by external command" if self.profile.is_px4 else "Arming motors", Severity.INFO)
        return CommandResult.ACCEPTED

    def disarm(self, reason: str, force: bool = False) -> CommandResult:
        """Disarm; in the air only by `force`, and then it falls. `reason` is a key of the profile's `disarm_texts`."""
        if not self.armed:
            return CommandResult.ACCEPTED
        if self.airborne and not force:
            if self.profile.is_px4:
                self.say("Disarming denied: not landed")
            return self.profile.refused_disarming
        self.armed = self.airborne = self.climbing = False
        self.landed = Landed.ON_GROUND
        self.say(self.profile.disarm_texts[reason], Severity.INFO)
        # Out of a failsafe the vehicle is back in the mode that was meant; else landing modes end.
        meant = self.intended if self.failsafe is ModeEvent.STREAM_LOST else None
        self.failsafe = None
        self.change(meant or self.after(ModeEvent.DISARMED), keep_intention=meant is not None)
        return CommandResult.ACCEPTED

    def set_mode(self, mode: FlightMode) -> CommandResult:
        """Change the mode by command, unless it needs what is not there."""
        lacking = mode.need in (Need.PILOT, Need.MISSION) or (mode.need is Need.STREAM and not self.stream_fresh)
        if self.armed and lacking:
            if mode.title:
                self.say(f"Switching to {mode.title} is currently not available")
            return self.profile.refused_mode
        if self.profile.is_px4:
            self.failsafe = None  # ArduPilot keeps its failsafe until its cause is gone
        self.change(mode, keep_intention=False)
        return CommandResult.ACCEPTED

    def take_off(self, height_m: float) -> CommandResult:
        """Climb to a height above the ground: by mode (PX4) or inside the present one (ArduPilot)."""
        takeoff_mode = self.profile.takeoff_mode
        if takeoff_mode is not None:
            self.pilot.takeoff_height_m = max(height_m, self.body.height_m)
            return self.set_mode(self.modes[takeoff_mode])
        able = self.mode.name in ("GUIDED", "LOITER") and self.armed and not self.airborne
        if not able or height_m <= self.body.height_m:
            return CommandResult.FAILED
        self.pilot.takeoff_height_m = height_m
        self.pilot.setpoint = None
        self.pilot.enter(self.body)
        self.climbing = True
        self.climb_since_s = None
        return CommandResult.ACCEPTED

    def obey(self, understood: Understood) -> None:
        """Take a setpoint in."""
        if understood.text:
            self.say(understood.text)
        if understood.verdict is Verdict.INVALID:
            return
        self.setpoint_at_s = self.body.time_s
        if self.profile.setpoints_lift_off:
            if understood.reference is None and self.pilot.setpoint is not None:
                self.pilot.enter(self.body)  # from here on it stays where it is
            self.pilot.setpoint = understood.reference
        elif self.mode.name != self.profile.stream_mode:
            return  # ArduPilot drops setpoints outside GUIDED
        elif self.airborne:
            self.climbing = False
            if understood.reference is None:
                self.pilot.enter(self.body)
            self.pilot.setpoint = understood.reference
        else:
            self.climbing = False  # a setpoint before lift-off cancels the take-off in silence
        if self.airborne:
            self.steer()

    def set_home(self, position_ned_m: Vec3) -> None:
        """Home is where the vehicle was armed."""
        self.home_ned_m = position_ned_m
        self.pilot.home_m = position_ned_m[:2]
        self.send("HOME_POSITION")

    def set_origin(self, origin_ned_m: Vec3) -> bool:
        """Move the local frame. PX4 always can (in flight it jumps); ArduPilot only before it has one."""
        if not self.profile.is_px4 and (self.origin_set or self.body.time_s < self.boot.standby_s):
            return False
        self.local_origin_ned_m = origin_ned_m
        self.origin_set = True
        self.send("GPS_GLOBAL_ORIGIN")
        if not self.profile.is_px4:
            self.send("HOME_POSITION")
        return True

    # -- time -----------------------------------------------------------------------------------------------------

    def enter(self, body: Body) -> None:
        """A new instant begins: what was deferred is sent, and booting goes on."""
        elapsed_s = body.time_s - self.body.time_s
        self.body = body
        while self._deferred and self._deferred[0].due_s <= body.time_s:
            self.outbox.append(heapq.heappop(self._deferred).message)
        if not self.origin_set and body.time_s >= self.boot.origin_s:
            self.set_origin(self.local_origin_ned_m)
        if self.armed:
            self.flown_s += elapsed_s

    @property
    def behaviour(self) -> Behaviour:
        """What is flown now."""
        return Behaviour.TAKEOFF if self.climbing else self.mode.behaviour

    def steer(self) -> None:
        """Say what the physics shall do from now on."""
        if not self.armed:
            self.thrust = Thrust.OFF
        elif not self.airborne:
            self.thrust = Thrust.IDLE
        else:
            self.thrust = Thrust.FLY
            self.reference, self.limits = self.pilot.fly(self.behaviour, self.body)

    def after(self, event: ModeEvent) -> FlightMode:
        """The mode that follows an event in the present mode."""
        return self.modes[self.profile.transitions.get((self.mode.name, event), self.mode.name)]

    def change(self, mode: FlightMode, keep_intention: bool) -> None:
        """Change the mode, with everything that follows; `keep_intention` when the vehicle does so by itself."""
        if not keep_intention:
            self.intended = mode
        if mode is self.mode:
            return
        self.mode = mode
        self.climbing = False
        self.climb_since_s = None
        self.pilot.enter(self.body)
        if not self.profile.setpoints_lift_off:
            self.pilot.setpoint = None
        if mode.behaviour is Behaviour.LAND and self.airborne:
            self.landed = Landed.LANDING
        elif self.airborne:
            self.landed = Landed.IN_AIR
        self.send("CURRENT_MODE" if self.profile.is_px4 else "HEARTBEAT")
