"""One vehicle: its state and its verbs (arm, disarm, change mode, take off, take a setpoint). Sans-IO.

Messages go in by `sitl_mock.protocol`, which calls the verbs of `Autopilot`; `ground.py` watches take-offs and
landings, `Rules.watch_failsafes` what goes missing; messages come out of `outbox`; `reference`, `limits` and `thrust`
are what the physics is asked to do. What one autopilot does in a way of its own is in its `AutopilotProfile` where it
is a number, a name or a text, and in its `Rules` where it is another story.
"""

from __future__ import annotations

import heapq
import math
from abc import abstractmethod
from typing import NamedTuple

from sitl_mock.autopilot.guidance import BodyState, Guidance, GuidanceRules
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.autopilot.profile import Behaviour, FlightMode, ModeEvent, Need
from sitl_mock.autopilot.setpoints import Interpretation, Pose, SetpointEffect, SetpointFields
from sitl_mock.links import Link
from sitl_mock.messages import CommandResult, Fields, Landed, Outgoing, Severity, SystemStatus
from sitl_mock.physics.geodesy import World
from sitl_mock.physics.reference import Limits, Reference, Thrust, Vec3

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
        rules: what this autopilot does in a way of its own, with its profile.
        setup: identity and place.
        world: the ground it flies over.
    """

    def __init__(self, rules: Rules, setup: Setup, world: World) -> None:
        self.rules = rules
        self.profile = profile = rules.profile
        self.world = world
        self.system_id = setup.system_id
        self.boot = profile.boot if setup.real_boot else profile.quick_boot
        self.parameters = Parameters(profile, setup.system_id)
        self.guidance = Guidance(rules, self.parameters, setup.drift_rad)
        self.modes = {mode.name: mode for mode in profile.modes}
        self.mode = self.intended = self.modes[profile.first_mode]
        self.links = [Link(profile.default_streams, self.boot.heartbeat_s) for _ in range(setup.links)]
        self.outbox: list[Outgoing] = []
        self.body = BodyState(0.0, setup.pad_ned_m, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0, True)
        x, y, z = (p + e for p, e in zip(setup.pad_ned_m, setup.origin_error_ned_m, strict=True))
        self.local_origin_ned_m: Vec3 = (x, y, z)
        self.origin_set = False
        self.home_ned_m: Vec3 = setup.pad_ned_m
        self.guidance.home_m = setup.pad_ned_m[:2]

        self.armed = False
        self.airborne = False
        self.flown_s = 0.0  # armed time in all, for the battery
        self.landed = Landed.ON_GROUND
        self.failsafe: ModeEvent | None = None
        self.failsafe_at_s = 0.0
        self.climbing = False  # a take-off inside the present mode (ArduPilot)
        self.setpoint_at_s = -math.inf
        self.gcs_heard_at_s = -math.inf
        self.gcs_missed = False
        self.reference = Reference()
        self.limits: Limits = self.guidance.limits()
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

    def send_text(self, text: str, severity: Severity = Severity.CRITICAL) -> None:
        """Send a STATUSTEXT on every link that is sent texts, in chunks of 50 characters; nothing if it is empty."""
        if not text:
            return
        data = (text + self.profile.texts.suffix).encode("ascii", "replace")
        chunks = [data[i : i + TEXT_CHUNK] for i in range(0, len(data), TEXT_CHUNK)]
        number = 0
        if len(chunks) > 1:
            self._texts = number = self._texts % 65535 + 1
        for index, link in enumerate(self.links):
            if link.texts_open:
                for k, chunk in enumerate(chunks):
                    fields = {"severity": int(severity), "text": chunk, "id": number, "chunk_seq": k}
                    self.send("STATUSTEXT", fields, index)

    # -- what the vehicle is --------------------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """Whether the estimator has a position."""
        return self.body.time_s >= self.boot.ready_s

    @property
    def booted(self) -> bool:
        """Whether commands are obeyed."""
        return self.body.time_s >= self.boot.standby_s

    @property
    def status(self) -> SystemStatus:
        """HEARTBEAT.system_status."""
        if not self.booted:
            return self.profile.booting_status
        if self.failsafe is not None and self.armed:
            return SystemStatus.CRITICAL
        return self.rules.status(self)

    def lacks(self, mode: FlightMode) -> bool:
        """Whether a mode needs what is not there now."""
        streamless = mode.need is Need.STREAM and not self.rules.stream_fresh(self)
        return mode.need in (Need.PILOT, Need.MISSION) or streamless

    # -- verbs ----------------------------------------------------------------------------------------------------

    def arm(self, force: bool) -> CommandResult:
        """Arm, unless something speaks against it and `force` does not."""
        if self.armed:
            return CommandResult.ACCEPTED
        refusal = None if force else self.rules.arming_refusal(self)
        if refusal is not None:
            self.send_text(refusal)
            return self.profile.refused_arming
        self.armed = True
        self.armed_at_s = self.body.time_s
        self.climb_since_s = self.landed_at_s = None
        self.failsafe = None
        self.guidance.enter(self.body)
        self.set_home(self.body.position_m)
        self.rules.on_arming(self)
        self.send_text(self.profile.texts.armed, Severity.INFO)
        return CommandResult.ACCEPTED

    def disarm(self, reason: str, force: bool = False) -> CommandResult:
        """Disarm; in the air only by `force`, and then it falls. `reason` is a key of `Texts.disarmed`."""
        if not self.armed:
            return CommandResult.ACCEPTED
        if self.airborne and not force:
            self.send_text(self.profile.texts.disarming_refused)
            return self.profile.refused_disarming
        self.armed = self.airborne = self.climbing = False
        self.landed = Landed.ON_GROUND
        self.send_text(self.profile.texts.disarmed[reason], Severity.INFO)
        # Out of a failsafe the vehicle is back in the mode that was meant; else landing modes end.
        meant = self.intended if self.failsafe is ModeEvent.STREAM_LOST else None
        self.failsafe = None
        self.change(meant or self.after(ModeEvent.DISARMED), keep_intention=meant is not None)
        return CommandResult.ACCEPTED

    def set_mode(self, mode: FlightMode) -> CommandResult:
        """Change the mode by command, unless it needs what is not there."""
        if self.armed and self.lacks(mode):
            if mode.title:
                self.send_text(f"Switching to {mode.title} is currently not available")
            return self.profile.refused_mode
        if self.profile.command_ends_failsafe:
            self.failsafe = None
        self.change(mode, keep_intention=False)
        return CommandResult.ACCEPTED

    def take_setpoint(self, fields: SetpointFields, now_s: float) -> None:
        """Act on a position target that arrives now, as far as the autopilot understands it."""
        pose = Pose(now_s, self.local_origin_ned_m, self.body.position_m, self.body.yaw_rad)
        self.act_on(self.rules.interpret(fields, pose, self.parameters))

    def act_on(self, setpoint: Interpretation) -> None:
        """Do what an interpreted position target asks for."""
        self.send_text(setpoint.text)
        if setpoint.effect is SetpointEffect.INVALID:
            return
        self.setpoint_at_s = self.body.time_s
        if self.rules.on_setpoint(self, setpoint.reference) and self.airborne:
            self.steer()

    def set_home(self, position_ned_m: Vec3) -> None:
        """Home is where the vehicle was armed."""
        self.home_ned_m = position_ned_m
        self.guidance.home_m = position_ned_m[:2]
        self.send("HOME_POSITION")

    def set_origin(self, origin_ned_m: Vec3) -> bool:
        """Move the local frame (in flight it jumps), if the autopilot can."""
        if not self.profile.origin_movable and (self.origin_set or not self.booted):
            return False
        self.local_origin_ned_m = origin_ned_m
        self.origin_set = True
        for name in self.profile.origin_messages:
            self.send(name)
        return True

    # -- time -----------------------------------------------------------------------------------------------------

    def enter(self, body: BodyState) -> None:
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
            self.reference, self.limits = self.guidance.fly(self.behaviour, self.body)

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
        self.guidance.enter(self.body)
        if not self.profile.setpoint_outlives_mode:
            self.guidance.setpoint = None
        if mode.behaviour is Behaviour.LAND and self.airborne:
            self.landed = Landed.LANDING
        elif self.airborne:
            self.landed = Landed.IN_AIR
        self.send(self.profile.mode_message)

    def fail(self, event: ModeEvent, mode_name: str, keep_intention: bool) -> None:
        """Enter a failsafe: change to a mode, or disarm if `mode_name` is empty."""
        self.failsafe, self.failsafe_at_s = event, self.body.time_s
        if mode_name:
            self.change(self.modes[mode_name], keep_intention)
        else:
            self.disarm("failsafe", force=True)


class Rules(GuidanceRules):
    """What one autopilot does in a way of its own. Stateless: whatever changes is the vehicle's."""

    @abstractmethod
    def status(self, vehicle: Autopilot) -> SystemStatus:
        """HEARTBEAT.system_status of a vehicle that has booted and is in no failsafe."""

    @abstractmethod
    def arming_refusal(self, vehicle: Autopilot) -> str | None:
        """Why arming in the present mode would be refused now, as a status text; None: it would not."""

    def on_arming(self, vehicle: Autopilot) -> None:  # most autopilots do nothing more
        """Do what goes with arming beside setting home."""

    @abstractmethod
    def landed_disarm_s(self, vehicle: Autopilot) -> float | None:
        """How long after a landing [s] the vehicle disarms; 0: never; None: as when it idles."""

    @abstractmethod
    def take_off(self, vehicle: Autopilot, height_m: float) -> CommandResult:
        """Climb to a height above the ground."""

    @abstractmethod
    def interpret(self, fields: SetpointFields, pose: Pose, parameters: Parameters) -> Interpretation:
        """Read a position target."""

    @abstractmethod
    def on_setpoint(self, vehicle: Autopilot, reference: Reference | None) -> bool:
        """Take in a valid position target; None: brake, or hold.

        Returns:
            Whether the present mode flies it.
        """

    @abstractmethod
    def stream_fresh(self, vehicle: Autopilot) -> bool:
        """Whether a setpoint came recently enough for the streaming mode."""

    @abstractmethod
    def watch_failsafes(self, vehicle: Autopilot) -> None:
        """See (50 Hz, while armed) whether the setpoint stream or the ground station is missing, and act on it."""
