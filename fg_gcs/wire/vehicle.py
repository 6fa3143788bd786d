"""One vehicle as its telemetry shows it; takes messages and times, knows no socket and no clock."""

import math
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.core.frames import Geodetic
from fg_gcs.wire import params
from fg_gcs.wire.address import VehicleAddress
from fg_gcs.wire.autopilots import AutopilotProfile, profile_of
from fg_gcs.wire.codec import GCS_COMPONENT, GCS_SYSTEM, Frame, Message
from fg_gcs.wire.messages import (
    Attitude,
    CurrentMode,
    ExtendedSysState,
    GlobalPositionInt,
    Heartbeat,
    LocalPositionNed,
    SysStatus,
    Timesync,
)
from fg_gcs.wire.order import FrameOrder
from fg_gcs.wire.phases import Phase, PhaseEvent, following
from fg_gcs.wire.states import State, StateTable
from fg_gcs.wire.texts import Text, TextAssembler
from fg_gcs.wire.timing import LinkTiming

LOST_AFTER_S: Final = 3.0  # three heartbeats at 1 Hz: one lost datagram is no lost vehicle
MOST_PARAMETERS: Final = 4096  # real autopilots have up to 1,350; a flood of made-up names must not fill the memory
QUEUE_LENGTH: Final = 512  # texts and changes kept for whoever reads them; the oldest go first

ARMING: Final = "arm"  # name of the request for it
OVERTAKING_S: Final = 0.6  # what was sent so long before a heartbeat came had arrived when that heartbeat was sent
_ARMS_S: Final = 5.0  # a vehicle that was asked to arm does so within that, if it does
FELL_M: Final = 1.0  # lower than that a vehicle may call itself in the air while it stands
PAIRED_S: Final = 0.1  # between a position on Earth and the local one that is carried to it: 5 cm at 1 m/s^2
EVIDENCE: Final = 2  # reports in a row that it takes to believe what starts an alarm: one datagram may be a stale one

_AIRBORNE: Final = frozenset(
    {dialect.MAV_LANDED_STATE_TAKEOFF, dialect.MAV_LANDED_STATE_IN_AIR, dialect.MAV_LANDED_STATE_LANDING}
)

_IN_FLIGHT: Final = frozenset({Phase.FLYING, Phase.LANDING, Phase.TAKEN})
_STATES: Final = frozenset(  # what is said anew all the time: only the last word counts; positions have stamps for that
    {
        dialect.MAVLINK_MSG_ID_HEARTBEAT,
        dialect.MAVLINK_MSG_ID_CURRENT_MODE,
        dialect.MAVLINK_MSG_ID_SYS_STATUS,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
        dialect.MAVLINK_MSG_ID_ATTITUDE,
    }
)

Vector = tuple[float, float, float]


class Ack(NamedTuple):
    """The newest acknowledgement of one command. PX4 sends two for a mode change: a blind one, then the truth.

    Attributes:
        result: MAV_RESULT.
        at_s: When it came [s].
        place: Of its frame among the vehicle's others: the newest is the one that was sent last.
    """

    result: int
    at_s: float
    place: int


class ParamError(NamedTuple):
    """A parameter that the vehicle would not read or write (PX4 says so, ArduPilot is silent).

    Attributes:
        error: MAV_PARAM_ERROR.
        at_s: When it said so [s].
    """

    error: int
    at_s: float


class Interval(NamedTuple):
    """How often the vehicle says that it sends one message on our link.

    Attributes:
        interval_us: Time between two of them [us]; zero or negative: never.
        at_s: When it said so [s].
    """

    interval_us: int
    at_s: float


class Origin(NamedTuple):
    """Where a local frame has its zero, as the vehicle reports it.

    Attributes:
        lat_deg: Latitude [deg; WGS84].
        lon_deg: Longitude [deg; WGS84].
        alt_m: Altitude above mean sea level [m].
    """

    lat_deg: float
    lon_deg: float
    alt_m: float


class Pairing(NamedTuple):
    """Where a vehicle says that it is at one instant, on Earth and in its own local frame.

    Attributes:
        boot_time_s: The instant, by the vehicle's clock [s].
        place: Latitude, longitude and altitude [deg, deg, m; WGS84, above mean sea level].
        north_m, east_m: In the local frame [m].
    """

    boot_time_s: float
    place: Geodetic
    north_m: float
    east_m: float


class Battery(NamedTuple):
    """State of charge.

    Attributes:
        voltage_v: Voltage [V], NaN if unknown.
        remaining: Share left, 0 to 1, NaN if unknown.
    """

    voltage_v: float
    remaining: float


class PhaseChange(NamedTuple):
    """One step through `fg_gcs.wire.phases.TRANSITIONS`."""

    at_s: float
    before: Phase
    event: PhaseEvent
    after: Phase


class Vehicle:
    """State of one vehicle, kept by the messages of its autopilot (component 1).

    Args:
        address: Its network and its MAVLink system id.
        profile: How its autopilot wants to be talked to.
        now_s: Loop time of the first heartbeat [s].

    Attributes:
        phase: Where it is in its flight.
        changes: Phase changes, for whoever takes them out (`deque.popleft`).
        texts: Whole status texts, for whoever takes them out.
        kind: MAV_TYPE, 0 before the first heartbeat.
        mode: Custom mode, None before the first heartbeat. The newest of HEARTBEAT and CURRENT_MODE.
        commanded_mode: The mode that we put it in; any other mode, once that one was seen, is a take-over.
        armed: Motors armed.
        fell: Disarmed once while it was higher than `FELL_M` in the air, as far as it told, or started again with its
            motors on.
        prearm_ok: Pre-arm checks are good *for the current mode*: choose the streaming mode first.
        landed_state: MAV_LANDED_STATE, 0 while unknown.
        samples: Number of finite LOCAL_POSITION_NED so far, but for those that came too late: a new number is a new
            sample.
        timing: Loss, delay and jitter of its link, and its clock; whoever owns the link counts the frames there.
        origin: Origin of its local frame, None before the first GPS_GLOBAL_ORIGIN.
        pairing: The newest of its positions that it has told both ways, None before the first.
        battery: State of charge.
        firmware: Its autopilot's name and version; the name alone before AUTOPILOT_VERSION.
        uid: Of its hardware in hexadecimal digits, "" before the first AUTOPILOT_VERSION or where that tells none.
        params: Values of the parameters heard so far, by name.
        param_types: Their MAV_PARAM_TYPE.
        param_at_s: When they came [s].
        param_errors: Newest refusal by parameter name.
        acks: Newest acknowledgement by command, of those addressed to us.
        intervals: Newest word on each stream by message id.
        asked_at_s: When it was last sent a request [s], by the request's name and by what its answers are told by.
        message_at_s: Loop time of the newest message by message id [s].
        heard_at_s: Loop time of the newest message [s].
    """

    def __init__(self, address: VehicleAddress, profile: AutopilotProfile, now_s: float) -> None:
        self.address = address
        self.profile = profile
        self.phase = Phase.DISCOVERED
        self.changes: deque[PhaseChange] = deque(maxlen=QUEUE_LENGTH)
        self.texts: deque[Text] = deque(maxlen=QUEUE_LENGTH)
        self.recent_texts: deque[Text] = deque(maxlen=16)  # why a request was refused: a few lines
        self.kind: int = dialect.MAV_TYPE_GENERIC
        self.mode: int | None = None
        self.commanded_mode: int | None = None
        self.armed = False
        self.fell = False
        self.prearm_ok = False
        self.landed_state = 0
        self.samples = 0
        self.origin: Origin | None = None
        self.pairing: Pairing | None = None
        self.battery = Battery(math.nan, math.nan)
        self.uid = ""
        self.firmware = self.profile.name
        self.params: dict[str, float] = {}
        self.param_types: dict[str, int] = {}
        self.param_at_s: dict[str, float] = {}
        self.param_errors: dict[str, ParamError] = {}
        self.acks: dict[int, Ack] = {}
        self.intervals: dict[int, Interval] = {}
        self.asked_at_s: dict[Hashable, float] = {}
        self.message_at_s: dict[int, float] = {}
        self.heard_at_s = now_s
        self.timing = LinkTiming()
        self._states, self._row = StateTable(1), 0
        self._assembler = TextAssembler()
        self._accepted_modes: frozenset[int | None] | None = None  # None: nothing commanded, nothing to take over
        self._order = FrameOrder()
        self._index = 0  # of the frame that is being read
        self._newest: dict[int | str, int] = {}  # indices of the newest frames that told of one thing
        self._arming_reports = self._foreign_modes = 0  # reports in a row
        self._falls = False  # the first of them came while it was in the air
        self._ran = False  # its motors did, at its newest position

    @property
    def system_id(self) -> int:
        """Its MAVLink system id, as messages to it need it; for anything else it is `address` that tells it."""
        return self.address.system_id

    @property
    def mode_name(self) -> str:
        """Readable name of the mode."""
        return "unknown" if self.mode is None else self.profile.mode_name(self.mode)

    @property
    def stream_timeout_s(self) -> float:
        """How long it goes on without setpoints, as its parameter says, or as that is by default [s]."""
        name, default_s = self.profile.stream_timeout
        return self.params.get(name, default_s)

    @property
    def state(self) -> State:
        """Where it is and how it moves, in numbers of which the unknown ones are NaN."""
        return self._states[self._row]

    @property
    def position_ned_m(self) -> Vector | None:
        """Position [m; NED from the vehicle's own local origin], None before the first."""
        return _known(self.state[0:3])

    @property
    def velocity_ned_m_s(self) -> Vector | None:
        """Velocity [m/s; NED], None before the first."""
        return _known(self.state[3:6])

    @property
    def boot_time_s(self) -> float:
        """The vehicle's clock at that sample [s]."""
        return self.state.boot_time_s

    @property
    def position_at_s(self) -> float:
        """Our loop time when that sample came [s], minus infinity before the first."""
        return self.state.position_at_s

    @property
    def ground_ned_m(self) -> Vector | None:
        """The last position while disarmed [m; NED]; its z is this vehicle's ground, which is not z = 0."""
        return _known(self.state[8:11])

    @property
    def yaw_rad(self) -> float | None:
        """Heading [rad; clockwise from north], None before the first ATTITUDE."""
        yaw_rad = self.state.yaw_rad
        return None if math.isnan(yaw_rad) else yaw_rad

    @property
    def may_be_armed(self) -> bool:
        """Armed as last heard, or asked to arm too lately for its heartbeats to deny it."""
        heartbeat_at_s = self.message_at_s.get(dialect.MAVLINK_MSG_ID_HEARTBEAT, -math.inf)
        return self.armed or heartbeat_at_s < self.asked_at_s.get(ARMING, -math.inf) + OVERTAKING_S

    @property
    def airborne(self) -> bool:
        """Off the ground, by its landed state: an acknowledged take-off is not yet one."""
        return self.landed_state in _AIRBORNE

    @property
    def height_m(self) -> float | None:
        """Height above where it last stood disarmed [m]; None before that is known."""
        state = self.state
        height_m = state.ground_down_m - state.down_m
        return None if math.isnan(height_m) else height_m

    def keep_state_in(self, states: StateTable, row: int) -> None:
        """Keep the state in a row of another table from now on, as it is."""
        states[row] = self.state
        self._states, self._row = states, row

    def handle(self, frame: Frame, now_s: float) -> None:
        """Take one message of this vehicle; never raises, fields that are not finite are not believed.

        Args:
            frame: Any message; those of other components and unknown ones change nothing.
            now_s: Loop time [s].
        """
        if frame.component_id != dialect.MAV_COMP_ID_AUTOPILOT1:
            return
        index = self._order.place(frame, now_s)
        if index >= 0:
            self._believe(frame, index, now_s)
            return
        for one, index in self._order.released():
            self._believe(one, index, now_s)

    def _believe(self, frame: Frame, index: int, now_s: float) -> None:
        identity, self._index = frame.message_id, index
        handler = self._HANDLERS.get(identity)
        if handler is not None:
            if identity in _STATES:
                if index <= self._newest.get(identity, -1):
                    return
                self._newest[identity] = index
            fields = frame.fields()
            if identity == dialect.MAVLINK_MSG_ID_HEARTBEAT and profile_of(fields) is not self.profile:
                return
            handler(self, fields, now_s)
        self.heard_at_s = self.message_at_s[identity] = now_s

    def _is_newest(self, thing: int | str) -> bool:
        """Tell whether what is being read was sent after everything else that told of the same thing."""
        if self._index <= self._newest.get(thing, -1):
            return False
        self._newest[thing] = self._index
        return True

    def watch(self, now_s: float) -> None:
        """Notice silence, and give out texts whose rest never came: call it about once a second."""
        self._tell(self._assembler.flush_stale(now_s))
        if now_s - self.heard_at_s > LOST_AFTER_S:
            self._apply(PhaseEvent.SILENT, now_s)

    def command_mode(self, mode: int) -> None:
        """Say that we command ``mode``: until it is seen, the mode before it is ours as well; then only it is."""
        self.commanded_mode = mode
        self._accepted_modes = frozenset({mode}) if self.mode == mode else frozenset({mode, self.mode})
        self._foreign_modes = 0

    def take_back(self, now_s: float) -> bool:
        """Count it as flown by us again if it is in the mode that we commanded; return whether it is."""
        if self.phase is Phase.TAKEN and self.mode == self.commanded_mode:
            self._apply(PhaseEvent.GIVEN_BACK, now_s)
        return self.phase is Phase.FLYING

    def _judge(self, now_s: float) -> None:
        for event in self._evidence():
            self._apply(event, now_s)

    def _evidence(self) -> Iterator[PhaseEvent]:
        """Yield what the telemetry says now, in the order in which it must be believed."""
        yield PhaseEvent.ARMED if self.armed else PhaseEvent.DISARMED
        if self.airborne:
            yield PhaseEvent.AIRBORNE
        # On the ground again after our landing it leaves its land mode by itself as it disarms: that is no take-over
        down = self.phase is Phase.LANDING and not self.airborne
        if self._is_foreign(self.mode) and not down:
            if self._foreign_modes >= EVIDENCE:
                yield PhaseEvent.TAKEN_OVER
        elif self.mode == self.profile.land_mode:
            yield PhaseEvent.LANDING_BEGAN
        if not self.armed:
            yield PhaseEvent.CHECKS_PASSED if self.prearm_ok else PhaseEvent.CHECKS_FAILED

    def hand_over(self, now_s: float) -> None:
        """Take it for somebody else's from now on, whose command it is about to get; on the ground that means nothing.

        Args:
            now_s: Loop time [s].
        """
        self._apply(PhaseEvent.TAKEN_OVER, now_s)

    def _apply(self, event: PhaseEvent, now_s: float) -> None:
        before, self.phase = self.phase, following(self.phase, event)
        if self.phase is not before:
            self.changes.append(PhaseChange(now_s, before, event, self.phase))

    def _tell(self, texts: list[Text]) -> None:
        self.texts.extend(texts)
        self.recent_texts.extend(texts)

    def _is_foreign(self, mode: int | None) -> bool:
        return self._accepted_modes is not None and mode not in self._accepted_modes

    def _set_mode(self, mode: int) -> None:
        if not self._is_newest("mode"):  # HEARTBEAT and CURRENT_MODE may have overtaken each other
            return
        if mode == self.commanded_mode:
            self._accepted_modes = frozenset({mode})
        self.mode = mode
        self._foreign_modes = self._foreign_modes + 1 if self._is_foreign(mode) else 0

    def _set_armed(self, now_s: float, *, armed: bool) -> None:
        """Believe what is expected at once, and anything else when it is said again.

        Expected is that it arms when asked to, and disarms on the ground after its flight.
        """
        if armed == self.armed:
            self._arming_reports = 0
            return
        self._arming_reports += 1
        if self._arming_reports == 1:  # what it says of itself after a restart is of the ground already
            self._falls = not armed and self.airborne and (self.height_m or 0.0) > FELL_M
        if armed:
            asked = now_s - self.asked_at_s.get(ARMING, -math.inf) < _ARMS_S
            expected = asked or dialect.MAVLINK_MSG_ID_HEARTBEAT not in self.message_at_s  # its first word
        else:
            expected = self.phase in _IN_FLIGHT and self.landed_state == dialect.MAV_LANDED_STATE_ON_GROUND
        if expected or self._arming_reports >= EVIDENCE:
            self.armed, self._arming_reports = armed, 0
            self.fell = self.fell or self._falls

    def _on_heartbeat(self, message: Heartbeat, now_s: float) -> None:
        self.kind = message.type
        self._set_armed(now_s, armed=bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED))
        self._set_mode(message.custom_mode)
        self._apply(PhaseEvent.HEARD, now_s)
        self._judge(now_s)

    def _on_current_mode(self, message: CurrentMode, now_s: float) -> None:
        self._set_mode(message.custom_mode)
        self._judge(now_s)

    def _on_sys_status(self, message: SysStatus, now_s: float) -> None:
        self.prearm_ok = bool(message.onboard_control_sensors_health & dialect.MAV_SYS_STATUS_PREARM_CHECK)
        voltage_mv, percent = message.voltage_battery, message.battery_remaining
        self.battery = Battery(
            voltage_v=math.nan if voltage_mv == 0xFFFF else voltage_mv / 1000.0,  # MAVLink's "not known"
            remaining=percent / 100.0 if 0 <= percent <= 100 else math.nan,
        )
        self._judge(now_s)

    def _on_landed_state(self, message: ExtendedSysState, now_s: float) -> None:
        self.landed_state = message.landed_state
        self._judge(now_s)

    def _on_position(self, message: LocalPositionNed, now_s: float) -> None:
        time_boot_ms, x, y, z, vx, vy, vz = message
        if not math.isfinite(x + y + z + vx + vy + vz):
            return
        boot_time_s = time_boot_ms / 1000.0
        offset_s = self.timing.clock.stamped(boot_time_s, now_s)
        if offset_s is None:  # older than the newest, or that again
            return
        if boot_time_s < self.boot_time_s and self._ran:  # it has started again with its motors on
            self.fell = True
        self._states.set_motion(self._row, x, y, z, vx, vy, vz, boot_time_s, now_s)
        self._states.set_measured(self._row, vx, vy, vz, boot_time_s + offset_s)
        self.samples += 1
        self._ran = self.armed
        if not self.armed:
            self._states.set_ground(self._row, x, y, z)

    def _on_global_position(self, message: GlobalPositionInt, now_s: float) -> None:
        """Pair it with the local position of the same instant: the newest one, carried on by its velocity."""
        boot_time_s = message.time_boot_ms / 1000.0
        north, east, _, v_north, v_east, _, local_s = self.state[:7]
        passed_s = boot_time_s - local_s
        if abs(passed_s) <= PAIRED_S and not math.isnan(north):
            place = Geodetic(message.lat / 1e7, message.lon / 1e7, message.alt / 1e3)
            self.pairing = Pairing(boot_time_s, place, north + v_north * passed_s, east + v_east * passed_s)

    def _on_attitude(self, message: Attitude, now_s: float) -> None:
        if math.isfinite(message.roll + message.pitch + message.yaw):
            self._states.set_attitude(self._row, message.yaw, message.roll, message.pitch)

    def _on_timesync(self, message: Timesync, now_s: float) -> None:
        if message.tc1:  # otherwise it asks us
            self.timing.answered(message.tc1, message.ts1, now_s)

    def _on_origin(self, message: Message, now_s: float) -> None:
        self.origin = Origin(message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1e3)

    def _on_version(self, message: Message, now_s: float) -> None:
        """The longer identity is newer; a vehicle that has none tells zeros."""
        major, minor, patch, _ = int(message.flight_sw_version).to_bytes(4, "big")
        self.firmware = f"{self.profile.name} {major}.{minor}.{patch}"
        longer = bytes(message.uid2)
        self.uid = longer.hex() if any(longer) else f"{message.uid:016x}" if message.uid else ""

    def _on_ack(self, message: Message, now_s: float) -> None:
        if message.target_system in (0, GCS_SYSTEM) and message.target_component in (0, GCS_COMPONENT):
            known = self.acks.get(message.command)
            if known is None or known.place < self._index:
                self.acks[message.command] = Ack(message.result, now_s, self._index)

    def _on_text(self, message: Message, now_s: float) -> None:
        self._tell(self._assembler.add(message, now_s))

    def _on_param(self, message: Message, now_s: float) -> None:
        name = message.param_id
        if (name not in self.params and len(self.params) >= MOST_PARAMETERS) or not self._is_newest(name):
            return
        self.params[name] = params.decode(message, self.profile.encoding)
        self.param_types[name] = message.param_type
        self.param_at_s[name] = now_s

    def _on_param_error(self, message: Message, now_s: float) -> None:
        if len(self.param_errors) < MOST_PARAMETERS:
            self.param_errors[message.param_id] = ParamError(message.error, now_s)

    def _on_interval(self, message: Message, now_s: float) -> None:
        if len(self.intervals) < MOST_PARAMETERS:
            self.intervals[message.message_id] = Interval(message.interval_us, now_s)

    _HANDLERS: ClassVar[Mapping[int, Callable[["Vehicle", Any, float], None]]] = MappingProxyType(
        {
            dialect.MAVLINK_MSG_ID_HEARTBEAT: _on_heartbeat,
            dialect.MAVLINK_MSG_ID_CURRENT_MODE: _on_current_mode,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: _on_sys_status,
            dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _on_landed_state,
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _on_position,
            dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _on_global_position,
            dialect.MAVLINK_MSG_ID_ATTITUDE: _on_attitude,
            dialect.MAVLINK_MSG_ID_TIMESYNC: _on_timesync,
            dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _on_origin,
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _on_version,
            dialect.MAVLINK_MSG_ID_COMMAND_ACK: _on_ack,
            dialect.MAVLINK_MSG_ID_STATUSTEXT: _on_text,
            dialect.MAVLINK_MSG_ID_PARAM_VALUE: _on_param,
            dialect.MAVLINK_MSG_ID_PARAM_ERROR: _on_param_error,
            dialect.MAVLINK_MSG_ID_MESSAGE_INTERVAL: _on_interval,
        }
    )


def _known(numbers: tuple[float, ...]) -> Vector | None:
    x, y, z = numbers
    return None if math.isnan(x) else (x, y, z)
