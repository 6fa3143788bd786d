"""What follows from what goes wrong, and from what people ask for: one table, and a pure function that reads it.

Typed faults and requests go in, a response comes out; nothing here knows a clock, a vehicle or a socket. Tests walk
through all of it, and `docs/failures.md` is drawn from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from types import MappingProxyType
from typing import Final, NamedTuple

from fg_gcs.wire.address import VehicleAddress


class Rung(IntEnum):
    """What the flight does, in ascending order of urgency: a rung is climbed, never descended.

    It is climbed when the policy says so, or when there is no verified plan for what the present rung asks for.
    """

    GO_ON = 0
    HOLD = 1
    HOME = 2
    LANDING = 3
    LAND_NOW = 4

    @property
    def does(self) -> str:
        """What it means, in words."""
        return _DOES[self]


_DOES: Final[Mapping[Rung, str]] = MappingProxyType(
    {
        Rung.GO_ON: "the flight goes on",
        Rung.HOLD: "the formation comes to rest on its verified path, and goes on when the fault is over",
        Rung.HOME: "the formation comes to rest, flies home on verified lines and lands",
        Rung.LANDING: "the vehicles part until the air below each is clear of the others, then all land there",
        Rung.LAND_NOW: "every vehicle is commanded to land where it is",
    }
)


class Part(Enum):
    """Where a flight is, as far as it decides what can be done."""

    GROUND = "nothing was asked to arm"
    TAKE_OFF = "vehicles arm and climb above their own pads"
    FLIGHT = "vehicles follow a motion"
    DESCENT = "vehicles come down by themselves, each on its own spot"


class Care(Enum):
    """What becomes of a vehicle that something is wrong with."""

    FLY = "it flies with the others"
    TELL = "setpoints to it go on, it may hear them; the others come to rest with it"
    LAND = (
        "it is commanded to land as soon as nobody is below it, and gets no setpoints any more; where it may be is "
        "kept clear by every later plan, down to the ground"
    )
    LEAVE = "it is left alone; where it may be is kept clear by every later plan, down to the ground"


class FaultKind(Enum):
    """What can go wrong."""

    SILENT = "silent"
    LOST = "lost"
    STUCK = "stuck"
    UNANSWERED = "unanswered"
    OFF_COURSE = "off_course"
    DEAF = "deaf"
    TAKEN = "taken"
    OWN_FAILSAFE = "own_failsafe"
    DISARMED = "disarmed"
    SEPARATION = "separation"
    FENCE = "fence"
    ORIGIN = "origin"
    BATTERY = "battery"
    PARAMETER = "parameter"
    REFUSED = "refused"
    TARGET = "target"
    PLANNER = "planner"
    STREAMER = "streamer"
    STREAMER_AGAIN = "streamer_again"
    BYSTANDER = "bystander"
    STALL = "stall"
    GATE = "gate"
    PROGRAM = "program"


class RequestKind(Enum):
    """What people and signals ask for."""

    STOP = "stop"


@dataclass(frozen=True)
class Row:
    """One row of the table.

    Attributes:
        what: the fault, in words.
        noticed: how.
        within: how soon, in words.
        rung: the least one that the flight is on from then on.
        care: of the vehicles that it is about.
        data: what is kept of it beside its event.
    """

    what: str
    noticed: str
    within: str
    rung: Rung
    care: Care = Care.FLY
    data: str = ""


ROWS: Final[Mapping[FaultKind, Row]] = MappingProxyType(
    {
        FaultKind.SILENT: Row(
            "nothing is heard from a vehicle",
            "no message of it",
            "0.5 s and the link's delay",
            Rung.HOLD,
            Care.TELL,
            "its last telemetry",
        ),
        FaultKind.LOST: Row(
            "a vehicle stays silent",
            "no message for its own time-out (PX4 `COM_OF_LOSS_T`, ArduPilot `GUID_TIMEOUT`) and 0.5 s, and for 2.2 s",
            "2.2 s",
            Rung.HOME,
            Care.LAND,
            "where it was last, and the region that is kept clear",
        ),
        FaultKind.STUCK: Row(
            "a vehicle's positions stop, though it is heard",
            "no newer position",
            "0.5 s and the link's delay",
            Rung.HOLD,
            Care.TELL,
            "its last telemetry",
        ),
        FaultKind.UNANSWERED: Row(
            "a vehicle is heard, but does not seem to hear us",
            "no answer to TIMESYNC requests, ten a second: five in a row, more where the link loses some",
            "0.5 s and the link's delay, twice; 1.2 s where 20 % are lost each way",
            Rung.HOLD,
            Care.TELL,
            "its last telemetry",
        ),
        FaultKind.OFF_COURSE: Row(
            "a vehicle is not where it is told to be",
            "its tracking error grows beyond `[faults] off_course_m`, and what its speed explains",
            "0.5 s from there",
            Rung.HOLD,
            Care.TELL,
            "the tracking error",
        ),
        FaultKind.DEAF: Row(
            "a vehicle stays off its course, or does not answer",
            "off course for its own time-out and 0.5 s, or unanswered for as long as one that is silent is waited for",
            "PX4 1.5 s, ArduPilot 1.5 or 1.1 s; 2.2 s where it does not answer",
            Rung.HOME,
            Care.LAND,
            "the tracking error",
        ),
        FaultKind.TAKEN: Row(
            "somebody else has changed a vehicle's mode, or commands it by `--forward` where the mission allows that",
            "HEARTBEAT or CURRENT_MODE; the command",
            "0.5 s",
            Rung.HOME,
            Care.LEAVE,
            "the mode",
        ),
        FaultKind.OWN_FAILSAFE: Row(
            "a vehicle's own failsafe has changed its mode",
            "the mode, with the text in which the autopilot says so",
            "0.5 s",
            Rung.HOME,
            Care.LAND,
            "the mode and the texts",
        ),
        FaultKind.DISARMED: Row(
            "a vehicle is disarmed in the air",
            "HEARTBEAT",
            "PX4 1 s, ArduPilot 0.2 s",
            Rung.HOME,
            Care.LEAVE,
            "its last telemetry",
        ),
        FaultKind.SEPARATION: Row(
            "two vehicles are closer than the minimum",
            "positions of one instant, beyond what their age and noise explain",
            "0.1 s and the link's delay",
            Rung.HOME,
            data="the distance",
        ),
        FaultKind.FENCE: Row(
            "a vehicle is outside the fence",
            "positions of one instant, by more than 0.5 m",
            "0.1 s and the link's delay",
            Rung.HOME,
            data="by how much",
        ),
        FaultKind.ORIGIN: Row(
            "a vehicle's local frame moves in flight",
            "positions that jump by 0.6 m more than velocities say; one that creeps: positions on Earth do not fit",
            "0.1 s and the link's delay",
            Rung.HOME,
            data="by how much; the frame is joined to the mission's anew at once, so that nobody is sent elsewhere",
        ),
        FaultKind.BATTERY: Row(
            "a battery gets low",
            "SYS_STATUS below `[faults] battery_low`",
            "0.5 s",
            Rung.HOME,
            data="the share left",
        ),
        FaultKind.PARAMETER: Row(
            "a parameter that was set for the flight has another value",
            "read again every 2 s",
            "5 s",
            Rung.GO_ON,
            data="both values; it is set again",
        ),
        FaultKind.REFUSED: Row(
            "a vehicle refuses, or does not do in time, what it is told",
            "its dialogue ends without effect",
            "the time of that dialogue",
            Rung.HOME,
            data="its answer and its texts",
        ),
        FaultKind.TARGET: Row(
            "the target is lost, or cannot be caught",
            "no sightings, no capture, or not held when the hold is to end, for `[track] give_up_s`",
            "as the mission says",
            Rung.HOME,
            data="the tracks",
        ),
        FaultKind.PLANNER: Row(
            "the planner of the inner loop raises or hangs",
            "its task ends, or gives no sign of life for 2 s",
            "2 s; the present trajectory runs to its rest",
            Rung.HOME,
            data="the exception",
        ),
        FaultKind.STREAMER: Row(
            "the streamer raises or hangs",
            "its task ends, or sends nothing for 0.2 s",
            "0.2 s; it is started again at once",
            Rung.GO_ON,
            data="the exception",
        ),
        FaultKind.STREAMER_AGAIN: Row(
            "the streamer dies again",
            "as the first time",
            "0.2 s",
            Rung.LAND_NOW,
            data="the exception",
        ),
        FaultKind.BYSTANDER: Row(
            "the recorder, the terminal or a viewer raises or hangs",
            "its task ends, or gives no sign of life for 5 s",
            "5 s; told once",
            Rung.GO_ON,
            data="the exception; what the record misses from then on",
        ),
        FaultKind.STALL: Row(
            "this program stood still",
            "the clock, between two turns of the event loop",
            "when it goes on",
            Rung.HOME,
            data="how long",
        ),
        FaultKind.GATE: Row(
            "a motion does not pass the last gate before the wire",
            "a vehicle's setpoints are changed or braked for 1 s",
            "at once braked, 1 s until all come to rest",
            Rung.HOME,
            data="reasons, counts, by how much and whom it would have met",
        ),
        FaultKind.PROGRAM: Row(
            "an error of this program, anywhere else",
            "an exception in a callback",
            "at once",
            Rung.HOME,
            data="the exception",
        ),
    }
)


class Situation(NamedTuple):
    """What is under way."""

    part: Part
    rung: Rung
    stops: int = 0  # how often people have asked to stop, the present time included


class Response(NamedTuple):
    """What to do.

    Attributes:
        rung: the one that the flight is on from now on.
        again: what is under way is planned anew, with the vehicles that are left.
        care: of the vehicles that the fault is about.
    """

    rung: Rung
    again: bool
    care: Care


class Fault(NamedTuple):
    """What is wrong in one way, with one vehicle or with many."""

    kind: FaultKind
    vehicles: tuple[VehicleAddress, ...]  # ascending; none: it is about all
    text: str  # one line for people
    since_s: float = 0.0  # the loop's time since which it is so [s]
    value: float = 0.0  # distance [m], share, duration [s]: what its kind measures


def respond(trigger: FaultKind | RequestKind, now: Situation) -> Response:
    """Return what follows from a fault or a request.

    Args:
        trigger: what has come up.
        now: what is under way.
    """
    if isinstance(trigger, RequestKind):
        asked = (Rung.HOME, Rung.LANDING, Rung.LAND_NOW)[min(max(now.stops, 1), 3) - 1]
        return Response(max(now.rung, asked), again=False, care=Care.FLY)
    row = ROWS[trigger]
    rung = max(now.rung, row.rung)
    if trigger is FaultKind.STALL and now.part is Part.DESCENT:
        rung = now.rung  # nobody needs anything of us while all land
    # Whoever comes down by itself has no plan that could be made anew
    again = now.rung >= Rung.HOME and row.rung >= Rung.HOME and now.part is Part.FLIGHT and rung is now.rung
    return Response(rung, again, row.care)


def refused(now: Situation) -> Response:
    """Return what follows when there is no verified plan for the present rung: the next one."""
    following = Rung.HOME if now.rung < Rung.HOME else Rung(min(now.rung + 1, Rung.LAND_NOW))
    return Response(following, again=False, care=Care.FLY)


def failures_table() -> str:
    """Return the table of all faults and what follows from them, as docs/failures.md has it."""
    lines = ["| fault | how it is noticed | how soon | response | the vehicle itself | what is kept |"]
    lines.append("| --- " * 6 + "|")
    for kind, row in ROWS.items():
        cells = (f"`{kind.value}`: {row.what}", row.noticed, row.within, row.rung.does, row.care.value, row.data)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)
