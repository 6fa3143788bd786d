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
from collections.abc import Callable
from typing import NamedTuple

from sitl_mock.autopilot.battery import Battery
from sitl_mock.autopilot.guidance import BodyState, Guidance, GuidanceRules, Target
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.autopilot.profile import Behaviour, FlightMode, Manners, ModeEvent, Need
from sitl_mock.autopilot.setpoints import Interpretation, Pose, SetpointEffect, SetpointFields
from sitl_mock.autopilot.table import VehicleTable, vec3
from sitl_mock.links import Link, phase_s
from sitl_mock.messages import CommandResult, Fields, Landed, Outgoing, Severity, SystemStatus
from sitl_mock.physics.geodesy import World
from sitl_mock.physics.reference import Limits, Reference, Thrust, Vec3

TEXT_CHUNK = 50  # STATUSTEXT.text
WATCH_S = 0.1  # how often a vehicle that flies a stream looks after itself, beside the stream


class Setup(NamedTuple):
    """What makes a vehicle this vehicle."""

    system_id: int
    links: int
    real_boot: bool
    manners: Manners
    row: int  # of the fleet's arrays
    drift_rad: float
    sense: Callable[[float], BodyState]  # the vehicle as its estimator has it at a simulated time


class Refusal(NamedTuple):
    """Commands that are refused, whatever the vehicle could do."""

    command: int  # MAV_CMD; 0: any
    result: CommandResult
    text: str


class Deferred(NamedTuple):
    """An answer that the real autopilot gives later; `order` keeps equal times in the order they were made."""

    due_s: float
    order: int
    message: Outgoing


class Autopilot:
    """State machine of one vehicle.

    Args:
        rules: what this autopilot does in a way of its own, with its profile.
        setup: identity and senses.
        world: the ground it flies over.
        table: arrays that it shares with the fleet.
    """

    def __init__(self, rules: Rules, setup: Setup, world: World, table: VehicleTable) -> None:
        self.rules = rules
        self.profile = profile = rules.profile
        self.world = world
        self.system_id = setup.system_id
        self.manners = setup.manners
        self.boot = profile.boot if setup.real_boot else profile.quick_boot
        self.parameters = Parameters(profile, setup.system_id)
        self.guidance = Guidance(rules, self.parameters, setup.drift_rad)
        self.modes = {mode.name: mode for mode in profile.modes}
        self.mode = self.intended = self.modes[profile.first_mode]
        start_s = self.boot.heartbeat_s + phase_s(setup.row)
        self.links = [Link(profile.default_streams, start_s) for _ in range(setup.links)]
        self.outbox: list[Outgoing] = []
        self.now_s = 0.0
        self.table, self.row = table, setup.row
        self.booted_at_s = 0.0
        self.origin_set = False
        self.guidance.home_m = self.home_ned_m[:2]

        self.dead = False  # says nothing, hears nothing, turns no motor
        self.wrecked = False  # has hit something: its motors stand still for good
        self.refusals: list[Refusal] = []
        self.heartbeat_frozen = False
        self.last_heartbeat: Fields | None = None
        self.gps_lost_at_s: float | None = None
        self.position_lost = False  # the estimator has given up

        self.armed = False
        self.airborne = False
        self.battery_failsafe: ModeEvent | None = None  # the worst so far
        self.battery_low_since_s: float | None = None
        self.battery = Battery(profile.battery)
        self.landed = Landed.ON_GROUND
        self.failsafe: ModeEvent | None = None
        self.failsafe_at_s = 0.0
        self.climbing = False  # a take-off inside the present mode (ArduPilot)
        self.setpoint_at_s = -math.inf
        self.gcs_heard_at_s = -math.inf
        self.gcs_missed = False
        self._own_reference: Reference | None = Reference()  # None: the setpoint is flown
        self.limits: Limits = self.guidance.limits()
        self.thrust = Thrust.OFF
        self.armed_at_s = -math.inf
        self.climb_since_s: float | None = None  # motors ready and something asks to leave the ground
        self.landed_at_s: float | None = None  # since the last arming
        self._lived_s = 0.0  # until when the battery was used
        self._sense = setup.sense
        self._body: BodyState | None = None  # at `now_s`, once it was needed
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
    def body(self) -> BodyState:
        """The vehicle now, as its estimator has it."""
        if self._body is None:
            self._body = self._sense(self.now_s)
        return self._body

    @property
    def local_origin_ned_m(self) -> Vec3:
        """Where its local frame has its zero; world."""
        return vec3(self.table.origin_ned_m[self.row])

    @property
    def told_origin_ned_m(self) -> Vec3:
        """Where it says that its local frame has its zero; world."""
        return vec3(self.table.origin_ned_m[self.row] + self.table.told_origin_error_m[self.row])

    @property
    def home_ned_m(self) -> Vec3:
        """Where it was armed; world."""
        return vec3(self.table.home_ned_m[self.row])

    @property
    def ready(self) -> bool:
        """Whether the estimator has a position."""
        return self.uptime_s >= self.boot.ready_s and not self.position_lost

    @property
    def booted(self) -> bool:
        """Whether commands are obeyed."""
        return self.uptime_s >= self.boot.standby_s

    @property
    def uptime_s(self) -> float:
        """Since it was booted [s of simulated time]."""
        return self.now_s - self.booted_at_s

    @property
    def status(self) -> SystemStatus:
        """HEARTBEAT.system_status."""
        if not self.booted:
            return self.profile.booting_status
        if self.failsafe is not None and self.armed:
            return SystemStatus.CRITICAL
        return self.rules.status(self)

    @property
    def reference(self) -> Reference:
        """What the physics is asked to fly to."""
        return self._own_reference or self.guidance.setpoint or Reference()

    @property
    def flies_stream(self) -> bool:
        """Whether a plain setpoint would change nothing but the target, see `stream`."""
        return self.thrust is Thrust.FLY and self._own_reference is None and self.guidance.streams

    def stream(self, target: Target) -> None:
        """Fly to the target of a plain setpoint that has just come; as `take_setpoint`, where `flies_stream`."""
        self.enter(target.since_s)
        self.setpoint_at_s = target.since_s
        self.guidance.stream(target)

    def lacks(self, mode: FlightMode) -> bool:
        """Whether a mode needs what is not there now."""
        streamless = mode.need is Need.STREAM and not self.rules.stream_fresh(self)
        return mode.need in (Need.PILOT, Need.MISSION) or streamless

    # -- verbs ----------------------------------------------------------------------------------------------------

    def arm(self, force: bool) -> CommandResult:
        """Arm, unless something speaks against it and `force` does not."""
        if self.armed:
            return CommandResult.ACCEPTED
        if self.wrecked:
            self.send_text(self.profile.texts.crashed)
            return self.profile.refused_arming
        refusal = None if force else self.rules.arming_refusal(self)
        if refusal is not None:
            self.send_text(refusal)
            return self.profile.refused_arming
        self.armed = True
        self.armed_at_s = self.now_s
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
        if fields.is_plain:  # what a stream consists of: the same for every autopilot
            position_m = self.table.world_m(self.row, fields.position_m)
            self.act_on(Interpretation(SetpointEffect.FLY, self.rules.streamed(fields, position_m, self)))
            return
        pose = Pose(now_s, self.local_origin_ned_m, self.body.position_m, self.body.yaw_rad)
        self.act_on(self.rules.interpret(fields, pose, self.parameters))

    def act_on(self, setpoint: Interpretation) -> None:
        """Do what an interpreted position target asks for."""
        self.send_text(setpoint.text)
        if setpoint.effect is SetpointEffect.INVALID:
            return
        self.setpoint_at_s = self.now_s
        if self.rules.on_setpoint(self, setpoint.reference) and self.airborne:
            self.steer()

    def set_home(self, position_ned_m: Vec3) -> None:
        """Home is where the vehicle was armed."""
        self.table.home_ned_m[self.row] = position_ned_m
        self.guidance.home_m = position_ned_m[:2]
        self.send("HOME_POSITION")

    def set_origin(self, origin_ned_m: Vec3) -> bool:
        """Move the local frame (in flight it jumps), if the autopilot can."""
        if not self.profile.origin_movable and (self.origin_set or not self.booted):
            return False
        self.table.origin_ned_m[self.row] = origin_ned_m
        self.origin_set = True
        for name in self.profile.origin_messages:
            self.send(name)
        return True

    # -- what can happen to it ------------------------------------------------------------------------------------

    def crash(self) -> None:
        """It has hit something: its motors stand still for good, and it says so."""
        self.wrecked = True
        self.disarm("failsafe", force=True)
        self.send_text(self.profile.texts.crashed)
        self.steer()

    def die(self) -> None:
        """Nothing in it works any more: it says nothing, hears nothing, and falls."""
        self.dead = True
        self.armed = self.airborne = self.climbing = False
        self.outbox.clear()
        self._deferred.clear()
        self.steer()

    def freeze(self) -> None:
        """Say nothing more on any link, until something is heard there again; what is being said goes out."""
        for link in self.links:
            link.frozen_s = self.now_s

    def reboot(self) -> None:
        """Begin anew, with what parameters there are; in the air it falls meanwhile."""
        self.armed = self.airborne = self.climbing = False
        self.booted_at_s = self.now_s
        self.landed = Landed.ON_GROUND
        self.mode = self.intended = self.modes[self.profile.first_mode]
        self.failsafe = self.battery_failsafe = self.battery_low_since_s = None
        self.setpoint_at_s = self.gcs_heard_at_s = self.armed_at_s = -math.inf
        self.gcs_missed = self.origin_set = False
        self.guidance.enter(self.body)
        self.guidance.setpoint = None
        start_s = self.now_s + self.boot.heartbeat_s + phase_s(self.row)
        self.links = [Link(self.profile.default_streams, start_s) for _ in self.links]
        self.outbox.clear()
        self._deferred.clear()
        self.table.restart(self.row, self.now_s, self.body.position_m)
        self.steer()

    # -- time -----------------------------------------------------------------------------------------------------

    def enter(self, now_s: float) -> None:
        """A new instant begins."""
        self.now_s = now_s
        self._body = None

    def go_on(self) -> None:
        """Send what was deferred, boot on, and use up the battery."""
        if self.armed:
            self.battery.use(self.now_s - self._lived_s)
        self._lived_s = self.now_s
        while self._deferred and self._deferred[0].due_s <= self.now_s:
            self.outbox.append(heapq.heappop(self._deferred).message)
        if not self.origin_set and self.uptime_s >= self.boot.origin_s:
            self.set_origin(self.local_origin_ned_m)
        self.table.positioned[self.row] = self.ready
        self.table.gps_fixed[self.row] = self.uptime_s >= self.boot.origin_s and self.gps_lost_at_s is None

    @property
    def rests_until_s(self) -> float:
        """When its logic has to run again if nothing reaches it until then, and it touches nothing.

        Whoever stands disarmed, or flies a setpoint in the air, has nothing to decide from one step to the next.
        """
        if any(link.parameter_index is not None for link in self.links):
            return self.now_s
        due_s = self._deferred[0].due_s if self._deferred else math.inf
        if not self.origin_set:
            due_s = min(due_s, self.booted_at_s + self.boot.origin_s)
        if self.uptime_s < self.boot.ready_s:
            due_s = min(due_s, self.booted_at_s + self.boot.ready_s)
        if self.gps_lost_at_s is not None:
            due_s = min(due_s, self.now_s + WATCH_S)
        if not self.armed:
            return due_s
        follows = self.airborne and self.behaviour is Behaviour.FOLLOW and self.guidance.has_setpoint
        if not follows or self.failsafe is not None or self.landed is not Landed.IN_AIR:
            return self.now_s
        return min(due_s, self.now_s + WATCH_S, self.rules.stream_lost_at_s(self))

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
            followed = self.guidance.followed() if self.behaviour is Behaviour.FOLLOW else None
            reference, self.limits = followed or self.guidance.fly(self.behaviour, self.body)
            self._own_reference = None if followed else reference

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
        self.failsafe, self.failsafe_at_s = event, self.now_s
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
    def streamed(self, fields: SetpointFields, position_ned_m: Vec3, vehicle: Autopilot) -> Reference:
        """The reference of a plain position target (`SetpointFields.is_plain`) that arrives now; as `interpret`.

        Args:
            fields: of the message.
            position_ned_m: of the target; world.
            vehicle: whom it is for.
        """

    @abstractmethod
    def on_setpoint(self, vehicle: Autopilot, reference: Reference | None) -> bool:
        """Take in a valid position target; None: brake, or hold.

        Returns:
            Whether the present mode flies it.
        """

    @abstractmethod
    def watch_position(self, vehicle: Autopilot) -> None:
        """See (50 Hz, when something is wrong with the satellites) whether the estimator still has a position."""

    @abstractmethod
    def stream_fresh(self, vehicle: Autopilot) -> bool:
        """Whether a setpoint came recently enough for the streaming mode."""

    @abstractmethod
    def stream_lost_at_s(self, vehicle: Autopilot) -> float:
        """When a stream that ends now is called lost; infinity: never."""

    @abstractmethod
    def watch_failsafes(self, vehicle: Autopilot) -> None:
        """See (50 Hz, while armed) whether the stream, the ground station or charge is missing, and act on it."""
