"""What PX4 and ArduPilot do differently, as one table: `PX4` and `ARDUPILOT`.

Every entry was measured on ArduCopter 4.7-dev and PX4 1.17-alpha in simulation, see docs/autopilots.
"""

from collections.abc import Container, Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.core.frames import EquidistantGlobe, EquirectangularGlobe, Globe
from fg_gcs.plan.lost_link import LostLink
from fg_gcs.wire.codec import Message
from fg_gcs.wire.messages import Heartbeat
from fg_gcs.wire.params import Encoding

MULTIROTORS: Final = frozenset(  # MAV_TYPE of what can hover and take our setpoints
    {
        dialect.MAV_TYPE_QUADROTOR,
        dialect.MAV_TYPE_COAXIAL,
        dialect.MAV_TYPE_HELICOPTER,
        dialect.MAV_TYPE_HEXAROTOR,
        dialect.MAV_TYPE_OCTOROTOR,
        dialect.MAV_TYPE_TRICOPTER,
        dialect.MAV_TYPE_DODECAROTOR,
        dialect.MAV_TYPE_DECAROTOR,
    }
)

_QUIET_HZ: Final = -1.0  # negative rate: switch the stream off


class TakeOff(Enum):
    """How a vehicle leaves the ground."""

    BY_SETPOINT = "setpoints in the streaming mode lift it off; they must come before that mode, or it is refused"
    BY_COMMAND = "NAV_TAKEOFF lifts it off; a setpoint before lift-off cancels that in silence"


@dataclass(frozen=True, slots=True)
class LimitParameter:
    """Where one limit is stored.

    Attributes:
        quantity: Field name of the limit: speed_m_s, climb_m_s, descent_m_s, acceleration_m_s2 or jerk_m_s3.
        names: Parameter name and unit scale to SI, the likeliest first; a vehicle has one of them.
    """

    quantity: str
    names: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class FailsafeParameter:
    """One parameter that decides what happens when we fall silent.

    Attributes:
        name: Parameter name.
        wanted: The value that is safe for a swarm, None when the value is only to be reported.
        reason: One line for people.
        at_most: Whether lower values, above 0, are as safe as the wanted one.
    """

    name: str
    wanted: float | None
    reason: str
    at_most: bool = False

    def is_safe(self, value: float) -> bool:
        """Say whether a value needs no change."""
        return self.wanted is None or value == self.wanted or (self.at_most and 0.0 < value < self.wanted)


class ReturnSetting(Enum):
    """What a parameter of a return says."""

    FIXED = "a number that is the same for all"
    HEIGHT = "at which height above its pad a vehicle returns [m]"
    WAIT = "how long it waits above its pad [s]"


@dataclass(frozen=True, slots=True)
class ReturnParameter:
    """One parameter that makes a vehicle hover and then return, at a height of its own, when we fall silent.

    Attributes:
        setting: What it says.
        names: Its names in different firmwares, of which a vehicle has one, and what a height or wait is multiplied by.
        value: The number, if it is fixed.
        needed: Without it a vehicle does not return so.
    """

    setting: ReturnSetting
    names: Mapping[str, float]
    value: float = 0.0
    needed: bool = True

    def name_in(self, known: Container[str]) -> str | None:
        """Return its name among those that a vehicle knows."""
        return next((name for name in self.names if name in known), None)

    def value_for(self, name: str, height_m: float, wait_s: float) -> float:
        """Return what to set it to by one of its names; a multiple of metres or seconds is a whole number."""
        number = {ReturnSetting.FIXED: self.value, ReturnSetting.HEIGHT: height_m, ReturnSetting.WAIT: wait_s}
        scale = self.names[name]
        return round(scale * number[self.setting], 2 if scale == 1.0 else None) * 1.0


@dataclass(frozen=True, slots=True)
class WanderProfile:
    """How far vehicles of one autopilot are from where they are told to be, as measured.

    Attributes:
        ground_step_m: By how much their estimates move in half a second on the ground, less what they do from one look
            to the next, rms, as seen from above [m].
        hover_enu_m: How far they truly are from their places in the air, standard deviation without what all of them
            have in common [m; ENU].
        shown_m: How much of that their estimates show, rms, as seen from above [m].
    """

    ground_step_m: float
    hover_enu_m: tuple[float, float, float]
    shown_m: float


@dataclass(frozen=True, slots=True)
class Stream:
    """One telemetry stream to ask for.

    Attributes:
        message_id: MAVLink message id.
        name: Its name.
        rate_hz: Rate [Hz]; negative switches it off.
        needed: A vehicle that refuses this one cannot be flown by us; others are asked for politely.
    """

    message_id: int
    name: str
    rate_hz: float
    needed: bool


@dataclass(frozen=True, slots=True)
class AutopilotProfile:
    """How one autopilot wants to be talked to.

    Attributes:
        name: For people.
        autopilot: MAV_AUTOPILOT of its heartbeat.
        modes: Custom mode numbers by readable name.
        streaming_mode: Mode in which position targets are obeyed.
        waiting_mode: Mode to stand in on the ground: it needs neither a pilot nor setpoints.
        land_mode: Mode that lands here.
        hovering_modes: Modes that stay where they are.
        stream_timeout: The parameter that says for how long a vehicle goes on without setpoints, and its default [s].
        lost_link: What it does without setpoints, with the longest time-out that is set for a flight.
        shorter_timeouts_s: Time-outs that may be set instead where that keeps vehicles apart better [s].
        take_off: How it leaves the ground.
        lands_by_command: NAV_LAND lands it; otherwise the mode does.
        encoding: How integer parameters travel.
        drag_is_compensated: Whether its acceleration setpoints may have the drag on top: they go straight to its
            thrust, and not into the motion of a target that it shapes.
        globe: How its local frame is laid over the Earth.
        wander: How far vehicles are from where they are told to be.
        limits: Where its limits of flight are stored.
        failsafes: What to check before arming.
        returns: What makes it hover and return at a height of its own instead; they come on top.
        rates_hz: Streams to ask for beside LOCAL_POSITION_NED, by message name; negative: off.
    """

    name: str
    autopilot: int
    modes: Mapping[str, int]
    streaming_mode: int
    waiting_mode: int
    land_mode: int
    hovering_modes: frozenset[int]
    stream_timeout: tuple[str, float]
    lost_link: LostLink
    shorter_timeouts_s: tuple[float, ...]
    take_off: TakeOff
    lands_by_command: bool
    encoding: Encoding
    drag_is_compensated: bool
    globe: Globe
    wander: WanderProfile
    limits: tuple[LimitParameter, ...]
    failsafes: tuple[FailsafeParameter, ...]
    returns: tuple[ReturnParameter, ...]
    rates_hz: Mapping[str, float]

    def mode_name(self, mode: int) -> str:
        """Return the readable name of a custom mode number; an unknown one is spelt as a number."""
        return next((name for name, number in self.modes.items() if number == mode), f"mode {mode:#x}")

    def streams(self, telemetry_hz: float = 50.0) -> tuple[Stream, ...]:
        """Return what to request on our link: enough to fly, little enough for nine vehicles.

        Args:
            telemetry_hz: Rate of LOCAL_POSITION_NED [Hz]. ArduPilot cuts intervals to whole milliseconds.
        """
        rates = {"LOCAL_POSITION_NED": telemetry_hz, **self.rates_hz}
        return tuple(Stream(_message_id(name), name, rate_hz, name in _NEEDED) for name, rate_hz in rates.items())


def profile_of(heartbeat: Message | Heartbeat) -> AutopilotProfile | None:
    """Return the profile of the autopilot that sent this HEARTBEAT; None for anything but a known autopilot."""
    if heartbeat.type == dialect.MAV_TYPE_GCS:
        return None
    return next((profile for profile in (PX4, ARDUPILOT) if profile.autopilot == heartbeat.autopilot), None)


def _message_id(name: str) -> int:
    identity: int = getattr(dialect, f"MAVLINK_MSG_ID_{name}")
    return identity


def _px4_mode(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


def _fixed(name: str, value: float, *, needed: bool = True) -> ReturnParameter:
    return ReturnParameter(ReturnSetting.FIXED, MappingProxyType({name: 1.0}), value, needed)


def _limit(quantity: str, **names: float) -> LimitParameter:
    return LimitParameter(quantity, MappingProxyType(names))


_NEEDED: Final = frozenset({"LOCAL_POSITION_NED", "EXTENDED_SYS_STATE", "SYS_STATUS"})

_RATES_HZ: Final = {
    "ATTITUDE": 10.0,
    "EXTENDED_SYS_STATE": 5.0,  # landed state: decides when a vehicle counts as airborne
    "SYS_STATUS": 2.0,  # readiness and battery
    "GLOBAL_POSITION_INT": 4.0,  # beside local positions it shows where the local frame lies
}

_PX4_MODES: Final = {
    "MANUAL": _px4_mode(1),
    "ALTCTL": _px4_mode(2),
    "POSCTL": _px4_mode(3),
    "TAKEOFF": _px4_mode(4, 2),
    "LOITER": _px4_mode(4, 3),
    "MISSION": _px4_mode(4, 4),
    "RTL": _px4_mode(4, 5),
    "LAND": _px4_mode(4, 6),
    "ACRO": _px4_mode(5),
    "OFFBOARD": _px4_mode(6),
    "STABILIZED": _px4_mode(7),
}

_ARDUPILOT_MODES: Final = {
    "STABILIZE": 0,
    "ACRO": 1,
    "ALT_HOLD": 2,
    "AUTO": 3,
    "GUIDED": 4,
    "LOITER": 5,
    "RTL": 6,
    "CIRCLE": 7,
    "LAND": 9,
    "POSHOLD": 16,
    "BRAKE": 17,
    "SMART_RTL": 21,
    "AUTO_RTL": 27,
}

PX4: Final = AutopilotProfile(
    name="PX4",
    autopilot=dialect.MAV_AUTOPILOT_PX4,
    modes=MappingProxyType(_PX4_MODES),
    streaming_mode=_PX4_MODES["OFFBOARD"],
    waiting_mode=_PX4_MODES["LOITER"],
    land_mode=_PX4_MODES["LAND"],
    hovering_modes=frozenset({_PX4_MODES["LOITER"], _PX4_MODES["POSCTL"], _PX4_MODES["ALTCTL"]}),
    stream_timeout=("COM_OF_LOSS_T", 1.0),
    lost_link=LostLink(1.0, runs_on=False, stays=False, lands=True, brakes_m_s2=3.0, gains_per_s=(0.95,)),  # MPC_XY_P
    shorter_timeouts_s=(),  # from its last setpoint on it slows down by itself
    take_off=TakeOff.BY_SETPOINT,
    lands_by_command=True,
    encoding=Encoding.BYTEWISE,
    drag_is_compensated=True,
    globe=EquidistantGlobe(6_371_000.0),
    wander=WanderProfile(0.0427, (0.63, 0.29, 0.40), 0.39),
    limits=(
        _limit("speed_m_s", MPC_XY_VEL_MAX=1.0),
        _limit("climb_m_s", MPC_Z_VEL_MAX_UP=1.0),
        _limit("descent_m_s", MPC_Z_VEL_MAX_DN=1.0),
        _limit("acceleration_m_s2", MPC_ACC_HOR_MAX=1.0),  # MPC_ACC_HOR binds its own automatic modes only
    ),
    failsafes=(
        FailsafeParameter(
            "COM_OBL_RC_ACT", 4.0, "lands when setpoints stop; by default it sinks and drifts without RC"
        ),
        FailsafeParameter(
            "COM_OF_LOSS_T",
            1.0,
            "how long setpoints may be missing before that, in seconds: twenty at the least rate",
            at_most=True,
        ),
        FailsafeParameter("NAV_DLL_ACT", None, "what it does when our heartbeats stop"),
    ),
    returns=(
        _fixed("COM_OBL_RC_ACT", 5.0),  # hover without setpoints; and without heartbeats for COM_DL_LOSS_T
        _fixed("NAV_DLL_ACT", 2.0),  # return
        _fixed("COM_DL_LOSS_T", 10.0),
        ReturnParameter(ReturnSetting.HEIGHT, MappingProxyType({"RTL_RETURN_ALT": 1.0})),
        ReturnParameter(ReturnSetting.HEIGHT, MappingProxyType({"RTL_DESCEND_ALT": 1.0})),  # where it waits
        ReturnParameter(ReturnSetting.WAIT, MappingProxyType({"RTL_LAND_DELAY": 1.0})),
        _fixed("RTL_CONE_ANG", 0.0),  # no lower return near home
    ),
    rates_hz=MappingProxyType(
        _RATES_HZ
        | {"CURRENT_MODE": 5.0}  # its HEARTBEAT stays at 1 Hz whatever one asks: a mode change would show late
        | dict.fromkeys(
            # 50 Hz each by default, 370 messages a second in all: nine vehicles would flood us.
            ("ATTITUDE_QUATERNION", "ATTITUDE_TARGET", "SERVO_OUTPUT_RAW", "POSITION_TARGET_LOCAL_NED"),
            _QUIET_HZ,
        )
    ),
)

ARDUPILOT: Final = AutopilotProfile(
    name="ArduPilot",
    autopilot=dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
    modes=MappingProxyType(_ARDUPILOT_MODES),
    streaming_mode=_ARDUPILOT_MODES["GUIDED"],
    waiting_mode=_ARDUPILOT_MODES["GUIDED"],
    land_mode=_ARDUPILOT_MODES["LAND"],
    hovering_modes=frozenset(_ARDUPILOT_MODES[name] for name in ("ALT_HOLD", "LOITER", "POSHOLD", "BRAKE")),
    stream_timeout=("GUID_TIMEOUT", 3.0),
    lost_link=LostLink(1.0, runs_on=True, stays=True, lands=False, brakes_m_s2=2.5, gains_per_s=(0.95, 1.5)),
    shorter_timeouts_s=(
        0.625,
    ),  # as far as others run on who brake by 5 m/s^2; by its own 2.5 they need the longer one
    take_off=TakeOff.BY_COMMAND,
    lands_by_command=False,
    encoding=Encoding.CAST,
    drag_is_compensated=False,
    globe=EquirectangularGlobe(6_378_100.0),
    wander=WanderProfile(0.0020, (0.02, 0.02, 0.02), 0.0058),
    limits=(  # newer firmware than the measured one renamed them and went from centimetres to metres
        _limit("speed_m_s", WPNAV_SPEED=0.01, WP_SPD=1.0),
        _limit("climb_m_s", WPNAV_SPEED_UP=0.01, WP_SPD_UP=1.0),
        _limit("descent_m_s", WPNAV_SPEED_DN=0.01, WP_SPD_DN=1.0),
        _limit("acceleration_m_s2", WPNAV_ACCEL=0.01, WP_ACC=1.0),
        _limit("jerk_m_s3", PSC_NE_JERK=1.0, PSC_JERK_NE=1.0, PSC_JERK_XY=1.0),
    ),
    failsafes=(
        FailsafeParameter("FS_GCS_ENABLE", 5.0, "lands when our heartbeats stop; by default it does nothing"),
        FailsafeParameter(
            "FS_GCS_TIMEOUT",
            5.0,
            "how long heartbeats may be missing before that, in seconds: ten, for a link that loses a fifth of them",
            at_most=True,
        ),
        FailsafeParameter(
            "GUID_TIMEOUT",
            1.0,
            "how long it flies on after setpoints stop, in seconds: about as far as the others until they rest",
            at_most=True,
        ),
    ),
    returns=(
        _fixed("FS_GCS_ENABLE", 1.0),  # return without heartbeats for FS_GCS_TIMEOUT; it hovers until then
        _fixed("FS_GCS_TIMEOUT", 10.0),
        ReturnParameter(ReturnSetting.HEIGHT, MappingProxyType({"RTL_ALT": 100.0, "RTL_ALT_M": 1.0})),
        ReturnParameter(ReturnSetting.WAIT, MappingProxyType({"RTL_LOIT_TIME": 1000.0})),
        _fixed("RTL_ALT_FINAL", 0.0, needed=False),  # come down to the ground
        _fixed("RTL_CONE_SLOPE", 0.0, needed=False),  # no lower return near home
    ),
    rates_hz=MappingProxyType(
        _RATES_HZ | {"HEARTBEAT": 5.0}  # arming shows in the next heartbeat only: up to 1 s late by default
    ),
)
