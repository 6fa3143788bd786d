"""The run at one instant: an immutable, versioned picture that the terminal, browsers and other programs read.

A snapshot is made by the flight itself, right after setpoints have left, and handed out: whoever reads it has no way
to ask the flight for anything. Numbers that are not known are None; nothing in it is NaN or infinite, so that it is
strict JSON. Readers take what they know and pass over fields that they do not: a field that is added keeps the
version, one that is removed or changes its meaning raises it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Final, NamedTuple

VERSION: Final = 1

Vector = tuple[float, float, float]


class RunEvent(NamedTuple):
    """Something that happened."""

    time_s: float  # since the run's start
    kind: str
    text: str  # one line for people


@dataclass(frozen=True, slots=True)
class VehicleSnapshot:
    """One vehicle as its telemetry shows it, and where it is told to be."""

    network: str
    system_id: int
    leader: bool
    phase: str
    alarming: bool  # the phase is one that needs eyes: lost, or taken over
    mode: str
    armed: bool
    heard_s_ago: float
    position_enu_m: Vector | None
    velocity_enu_m_s: Vector | None
    setpoint_enu_m: Vector | None  # None while nothing is streamed to it
    yaw_rad: float | None  # clockwise from north
    height_m: float | None  # above its own ground
    speed_m_s: float | None
    battery: float | None  # share left, 0 to 1
    voltage_v: float | None  # of the battery
    position_age_s: float | None = None  # since the position was true, by the vehicle's own stamps
    loss_in: float | None = None  # share of its frames that are lost on the way to us, 0 to 1
    loss_out: float | None = None  # share of ours
    delay_s: float | None = None  # of one way, mean


@dataclass(frozen=True, slots=True)
class FormationSnapshot:
    """The face of the formation, once its leaders are known and where all of them are."""

    leaders: tuple[int, ...]  # places in `Snapshot.vehicles`, in the order in which they stand around the face
    centre_enu_m: Vector  # mean of the leaders' positions
    normal_enu: Vector  # unit normal, which looks at the target


@dataclass(frozen=True, slots=True)
class TargetSnapshot:
    """What is known of all targets together; of a target at rest what the mission says."""

    position_enu_m: Vector
    velocity_enu_m_s: Vector
    radius_m: float  # of the ball that the face has to hold
    age_s: float  # since the newest sighting
    lost: tuple[str, ...]  # names
    unseen: tuple[str, ...]  # names of those that were never seen
    too_wide: bool  # the ball is larger than the face may become, so that it need not hold all of them


@dataclass(frozen=True, slots=True)
class TrackingSnapshot:
    """How the formation follows moving targets."""

    mode: str  # what the formation does, in words
    targets: int
    error_m: float | None  # of the formation's centre, by the estimate
    growth: float  # size of the formation as a share of that at the start
    rests: bool  # it has come to the end of its trajectory and stands until there is another one
    caught: bool
    patience_s: float  # after so much more without a sighting, or without the capture, the swarm flies home
    sightings: int
    refused: tuple[tuple[str, int], ...]  # reason and count, most frequent first
    latency_s: float | None  # from the last sighting's stamp to the first setpoint that it led to


@dataclass(frozen=True, slots=True)
class CounterSnapshot:
    """What went through so far."""

    frames_in: int
    frames_out: int
    bad_bytes: int
    unknown_messages: int
    dropped: int
    unroutable: int
    clashes: int
    errors: int
    late_ticks: int
    refused: int = 0
    unsigned: int = 0  # frames not taken in a network with a key: without a signature
    forged: int = 0  # likewise, signed with another key
    replayed: int = 0  # likewise, with a time stamp that came before, or is too old
    forwarded: int = 0  # frames of vehicles passed on to other programs
    not_forwarded: int = 0  # those that such a program missed
    commands_passed: int = 0  # what such programs said to vehicles and was passed on
    commands_dropped: int = 0  # what was not
    gated: int = 0  # setpoints that the last gate changed, braked or held back


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The whole run at one instant; times are seconds since the run's start."""

    number: int  # 0, 1, 2, ...: a gap says that a reader missed some
    time_s: float
    mission: str  # its description
    stage: str
    stages: tuple[str, ...]  # of a whole flight, in order
    stage_begins_s: float
    stage_ends_s: float | None  # where that is known
    networks: int
    vehicles: tuple[VehicleSnapshot, ...]
    formation: FormationSnapshot | None
    target: TargetSnapshot | None
    tracking: TrackingSnapshot | None  # None while nothing is tracked
    tracks: bool  # the mission has moving targets, so that there will be something to say about tracking
    counters: CounterSnapshot
    events: tuple[RunEvent, ...]  # since the snapshot before
    version: int = VERSION

    def to_json(self) -> str:
        """Return it as one line of strict JSON."""
        return json.dumps(_plain(self), separators=(",", ":"), allow_nan=False)

    @classmethod
    def from_json(cls, line: str | bytes) -> Snapshot:
        """Return the snapshot of a line; fields that this version does not know are passed over.

        Raises:
            ValueError: it is no snapshot, or one of another version.
        """
        try:
            return _snapshot(json.loads(line))
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"no snapshot: {error!r}") from error


def known(value: float | None) -> float | None:
    """Return a number, or None for one that is not finite or not there."""
    return None if value is None or not math.isfinite(value) else float(value)


def vector(values: Sequence[float] | None) -> Vector | None:
    """Return three numbers, or None if one of them is not known."""
    if values is None or not all(map(math.isfinite, values)):
        return None
    x, y, z = values
    return float(x), float(y), float(z)


def _plain(value: object) -> object:
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, RunEvent):
        return value._asdict()
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value


def _read(kind: type[Any], found: dict[str, Any]) -> Any:  # noqa: ANN401 - of the kind that is asked for
    """Return a dataclass from its fields; JSON's lists become tuples."""
    if not isinstance(found, dict):
        raise TypeError(f"{kind.__name__}: not an object")
    return kind(**{field.name: _tuples(found[field.name]) for field in fields(kind) if field.name in found})


def _tuples(value: object) -> object:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def _snapshot(found: dict[str, Any]) -> Snapshot:
    if found["version"] != VERSION:
        raise ValueError(f"a snapshot of version {found['version']}; this program reads version {VERSION}")
    made: Snapshot = _read(
        Snapshot,
        found
        | {
            "stages": tuple(found["stages"]),
            "vehicles": tuple(_read(VehicleSnapshot, each) for each in found["vehicles"]),
            "formation": None if found["formation"] is None else _read(FormationSnapshot, found["formation"]),
            "target": None if found["target"] is None else _read(TargetSnapshot, found["target"]),
            "tracking": None if found["tracking"] is None else _read(TrackingSnapshot, found["tracking"]),
            "counters": _read(CounterSnapshot, found["counters"]),
            "events": tuple(RunEvent(*(each[name] for name in RunEvent._fields)) for each in found["events"]),
        },
    )
    return made
