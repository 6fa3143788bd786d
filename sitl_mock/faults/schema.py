"""Tables of faults and impairments as types: which kinds there are, which keys each has, and what is wrong with one.

A table is what a mission's `[[simulator.faults]]`, `--fault` and `parse_fault` take, all alike.
"""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

from sitl_mock.messages import CommandResult
from sitl_mock.protocol.layouts import is_message

# Stages that a ground station tells of, and those that a vehicle is in by itself.
FLIGHT_STAGES = ("connect", "prepare", "plan", "take-off", "gather", "approach", "hold", "home", "spread", "land")
OWN_STAGES = ("armed", "airborne", "landed")
STAGES = FLIGHT_STAGES + OWN_STAGES
LONGEST_S = 1e6  # of any time
FARTHEST_M = 1e6  # of any length
DIRECTIONS = ("from_vehicle", "to_vehicle", "both")
RESULTS = MappingProxyType({result.name.lower(): result for result in CommandResult})


class Key(NamedTuple):
    """A key of a table.

    Attributes:
        read: from what a table has to the value; raises `ValueError` that says what is accepted.
        default: without it; None: the key must be there.
        says: what it is, for people.
    """

    read: Callable[[Any], Any]
    default: Any
    says: str


class Kind(NamedTuple):
    """A kind of fault.

    Attributes:
        keys: that it has beside those that say when and where.
        says: what it does, for people.
        once: it happens at a moment, and does not end.
    """

    keys: Mapping[str, Key]
    says: str
    once: bool = False


def number(least: float = -FARTHEST_M, most: float = FARTHEST_M) -> Callable[[Any], float]:
    """A finite number within bounds."""

    def read(value: Any) -> float:  # noqa: ANN401  # whatever a table has
        if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
            raise ValueError(f"a number from {least:g} to {most:g}")
        return float(value)

    return read


def vector(value: Any) -> tuple[float, float, float]:  # noqa: ANN401  # whatever a table has
    """Three numbers: east, north, up."""
    one = number()
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise ValueError("three numbers: east, north, up")
    return one(value[0]), one(value[1]), one(value[2])


def flag(value: Any) -> bool:  # noqa: ANN401  # whatever a table has
    """True or false."""
    if not isinstance(value, bool):
        raise ValueError("true or false")
    return value


def text(value: Any) -> str:  # noqa: ANN401  # whatever a table has
    """A text that fits into status texts."""
    if not isinstance(value, str) or len(value) > 200 or not value.isprintable():
        raise ValueError("a text of at most 200 printable characters")
    return value


def choice(*accepted: str) -> Callable[[Any], str]:
    """One of some words."""

    def read(value: Any) -> str:  # noqa: ANN401  # whatever a table has
        if value not in accepted:
            raise ValueError("one of " + ", ".join(map(repr, accepted)))
        return str(value)

    return read


def _whole(value: Any, least: int, most: int) -> int:  # noqa: ANN401  # whatever a table has
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"a whole number from {least} to {most}")
    return value


def _command(value: Any) -> int:  # noqa: ANN401  # whatever a table has
    if isinstance(value, str) and value in COMMANDS:
        return COMMANDS[value]
    try:
        return _whole(value, 0, 65535)
    except ValueError:
        raise ValueError(f"a MAV_CMD number, or one of {', '.join(map(repr, COMMANDS))}") from None


def _names(value: Any) -> tuple[str, ...]:  # noqa: ANN401  # whatever a table has
    if not isinstance(value, list | tuple) or not all(isinstance(name, str) and name.isupper() for name in value):
        raise ValueError('a list of MAVLink messages such as ["HEARTBEAT"]')
    for name in value:
        if not is_message(name):
            raise ValueError(f"messages of the dialect; there is no message {name!r}")
    return tuple(value)


def _vehicles(value: Any) -> tuple[int, ...]:  # noqa: ANN401  # whatever a table has
    if not isinstance(value, list | tuple) or not value:
        raise ValueError("a list of system ids such as [3, 7]")
    return tuple(_whole(one, 1, 255) for one in value)


COMMANDS = MappingProxyType({"any": 0, "arm": 400, "take_off": 22, "land": 21, "set_mode": 176, "return": 20})
_seconds = number(0.0, LONGEST_S)
_share = number(0.0, 1.0)

# When and where: keys that every table has.
WINDOW: Mapping[str, Key] = MappingProxyType(
    {
        "vehicles": Key(_vehicles, (), "their system ids; every vehicle if it is left out"),
        "at_s": Key(_seconds, 0.0, "when it begins: since the simulator's start, or since `stage` began [s]"),
        "stage": Key(choice(*STAGES), "", "the stage that it waits for: of the flight, or of each vehicle by itself"),
        "for_s": Key(_seconds, math.inf, "how long it lasts [s]; without it, for good"),
    }
)

KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "position_noise": Kind(
            {"sigma_m": Key(number(0.0, 1e3), None, "standard deviation of every axis [m]")},
            "the estimated position is noisy",
        ),
        "position_bias": Kind(
            {
                "offset_enu_m": Key(vector, None, "how far it is off [m]"),
                "over_s": Key(_seconds, 10.0, "how long it takes to get there [s]"),
            },
            "the estimated position is pulled off, slowly, and the vehicle with it",
        ),
        "position_drift": Kind(
            {"rate_enu_m_s": Key(vector, None, "how fast [m/s]")},
            "the estimated position drifts away; when it ends it has jumped back",
        ),
        "position_jump": Kind(
            {"offset_enu_m": Key(vector, None, "how far [m]")},
            "the estimated position jumps, and back when it ends",
        ),
        "gps_loss": Kind({}, "no satellites: the estimate drifts, then the autopilot's own failsafe acts"),
        "estimator_stuck": Kind({}, "the estimate stands still, its time stamps go on"),
        "origin": Kind(
            {
                "offset_enu_m": Key(vector, (0.0, 0.0, 0.0), "how far the local frame's zero is moved at once [m]"),
                "rate_enu_m_s": Key(vector, (0.0, 0.0, 0.0), "how fast it moves from then on [m/s]"),
                "told": Key(flag, True, "whether GPS_GLOBAL_ORIGIN says so"),
            },
            "the local frame moves under the vehicle",
        ),
        "origin_wrong": Kind(
            {"offset_enu_m": Key(vector, None, "how far from the truth [m]")},
            "GPS_GLOBAL_ORIGIN says another place than the local frame has its zero at",
        ),
        "wind": Kind(
            {
                "speed_m_s": Key(number(0.0, 50.0), None, "mean [m/s]"),
                "from_deg": Key(number(-360.0, 360.0), 0.0, "where it comes from, clockwise from north [deg]"),
                "gusts_m_s": Key(number(0.0, 20.0), 0.0, "standard deviation of gusts [m/s]"),
            },
            "wind, beside what wind there is",
        ),
        "motor_weak": Kind(
            {"thrust": Key(_share, 0.7, "what is left of the thrust")},
            "the greatest thrust falls; under measured dynamics every thrust does, until the autopilot has learnt it",
        ),
        "motor_dead": Kind({}, "a motor stops: the vehicle falls"),
        "battery_low": Kind(
            {"remaining": Key(number(0.01, 1.0), 0.1, "what is left of the charge")},
            "the battery has suddenly less, and goes on from there",
            once=True,
        ),
        "battery_empty": Kind(
            {"lasts_s": Key(_seconds, 60.0, "until the motors stop [s]")},
            "nothing is left in the battery",
            once=True,
        ),
        "heartbeat_frozen": Kind({}, "heartbeats go on and say what the last one before said"),
        "commands_refused": Kind(
            {
                "command": Key(_command, 0, "which: a MAV_CMD number or a name"),
                "result": Key(choice(*RESULTS), "denied", "MAV_RESULT of the acknowledgement"),
                "text": Key(text, "", "status text that comes with it"),
            },
            "commands are refused",
        ),
        "reboot": Kind({}, "the autopilot boots anew, in the air as well: then the vehicle falls", once=True),
        "clock_jump": Kind(
            {"by_s": Key(number(-LONGEST_S, LONGEST_S), None, "how far [s]")}, "its clock jumps", once=True
        ),
        "clock_drift": Kind(
            {"rate": Key(number(-0.5, 0.5), None, "seconds that it gains in a second")}, "its clock runs off"
        ),
        "dead": Kind({}, "it says nothing more, hears nothing more, and falls", once=True),
        "taken_over": Kind(
            {"mode": Key(text, None, "name of the mode that another client puts it into")},
            "another client changes its mode",
            once=True,
        ),
    }
)

IMPAIRMENT: Mapping[str, Key] = MappingProxyType(
    {
        "direction": Key(choice(*DIRECTIONS), "both", "which way"),
        "messages": Key(_names, (), "only datagrams that begin with one of these messages; all if it is left out"),
        "loss": Key(_share, 0.0, "share of datagrams that are lost; 1: muted"),
        "delay_s": Key(number(0.0, 600.0), 0.0, "how much later they come [s]"),
        "jitter_s": Key(number(0.0, 600.0), 0.0, "up to so much later still, evenly [s]; their order is kept"),
        "reorder": Key(_share, 0.0, "share of datagrams that come behind the next one"),
        "duplicate": Key(_share, 0.0, "share of datagrams that come twice"),
        "corrupt": Key(_share, 0.0, "share of datagrams that have a byte changed"),
    }
)


@dataclass(frozen=True)
class Window:
    """When and where something is wrong.

    Attributes:
        vehicles: system ids; empty: every vehicle.
        at_s: when it begins, since the simulator's start or since the stage began [s].
        stage: that it waits for; empty: none.
        for_s: how long it lasts [s].
    """

    vehicles: tuple[int, ...] = ()
    at_s: float = 0.0
    stage: str = ""
    for_s: float = math.inf


@dataclass(frozen=True)
class FaultOptions:
    """A fault inside vehicles.

    Attributes:
        kind: one of `KINDS`.
        window: when and where.
        values: of the kind's own keys, complete.
    """

    kind: str
    window: Window
    values: Mapping[str, Any]


@dataclass(frozen=True)
class ImpairmentOptions:
    """An impairment of links.

    Attributes:
        window: when and where.
        values: of the keys of `IMPAIRMENT`, complete.
    """

    window: Window
    values: Mapping[str, Any]


def parse_fault(table: Mapping[str, Any] | str) -> FaultOptions:
    """Read a fault from a table, or from a JSON object.

    Raises:
        ValueError: one line that says what is wrong.
    """
    keys = _table(table)
    kind = keys.pop("kind", None)
    if not isinstance(kind, str) or kind not in KINDS:
        raise ValueError(f"kind = {kind!r}{_like(str(kind), KINDS)}; accepted: {', '.join(KINDS)}")
    window, values = _read(keys, KINDS[kind].keys, f"a fault of kind {kind!r}")
    if KINDS[kind].once and "for_s" in keys:
        raise ValueError(f"a fault of kind {kind!r} happens once and does not end: leave for_s out")
    if kind == "origin" and not any(values["offset_enu_m"]) and not any(values["rate_enu_m_s"]):
        raise ValueError("a fault of kind 'origin' needs offset_enu_m or rate_enu_m_s")
    return FaultOptions(kind, window, values)


def parse_impairment(table: Mapping[str, Any] | str) -> ImpairmentOptions:
    """Read an impairment from a table, or from a JSON object.

    Raises:
        ValueError: one line that says what is wrong.
    """
    window, values = _read(_table(table), IMPAIRMENT, "an impairment")
    if not any(values[name] for name in ("loss", "delay_s", "jitter_s", "reorder", "duplicate", "corrupt")):
        raise ValueError("an impairment needs one of loss, delay_s, jitter_s, reorder, duplicate, corrupt")
    return ImpairmentOptions(window, values)


def check_mode(fault: FaultOptions, modes: Sequence[str]) -> None:
    """Refuse a fault with a mode that the autopilot does not have.

    Raises:
        ValueError: says which it has.
    """
    mode = fault.values.get("mode")
    if mode is not None and mode not in modes:
        raise ValueError(f"a fault of kind {fault.kind!r}: mode = {mode!r}; accepted: {', '.join(modes)}")


def told() -> str:
    """All kinds and keys for people, a line each."""
    lines = ["keys of every fault and impairment:", *_told_keys(WINDOW), "", "kinds of faults, with their own keys:"]
    for name, kind in KINDS.items():
        lines += [f"  {name}: {kind.says}", *_told_keys(kind.keys, "    ")]
    return "\n".join([*lines, "", "keys of impairments:", *_told_keys(IMPAIRMENT)])


def _told_keys(keys: Mapping[str, Key], indent: str = "  ") -> list[str]:
    return [f"{indent}{name}{'' if key.default is not None else ' (needed)'}: {key.says}" for name, key in keys.items()]


def check_vehicles(window: Window, system_ids: Sequence[int]) -> None:
    """Refuse a window for vehicles that are not there.

    Raises:
        ValueError: says which.
    """
    for system_id in window.vehicles:
        if system_id not in system_ids:
            known = f"{min(system_ids)} to {max(system_ids)}" if system_ids else "none"
            raise ValueError(f"vehicles: there is no vehicle {system_id}; the system ids are {known}")


def _table(table: Mapping[str, Any] | str) -> dict[str, Any]:
    if isinstance(table, Mapping) and all(isinstance(key, str) for key in table):
        return dict(table)
    if not isinstance(table, str):
        raise ValueError("not a table of keys and values")
    try:
        keys = json.loads(table)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not a JSON object: {error}") from error
    if not isinstance(keys, dict):
        raise ValueError("not a JSON object")
    return keys


def _read(table: dict[str, Any], own: Mapping[str, Key], whose: str) -> tuple[Window, Mapping[str, Any]]:
    """Read the keys of a table that is `whose`."""
    accepted = {**WINDOW, **own}
    for name in table:
        if name not in accepted:
            raise ValueError(f"{whose} has no key {name!r}{_like(name, accepted)}; accepted: {', '.join(accepted)}")
    values = {}
    for name, key in accepted.items():
        if name not in table:
            if key.default is None:
                raise ValueError(f"{whose} needs {name}: {key.says}")
            values[name] = key.default
            continue
        try:
            values[name] = key.read(table[name])
        except ValueError as error:
            raise ValueError(f"{name} = {table[name]!r}; accepted: {error}") from None
    window = Window(**{name: values.pop(name) for name in WINDOW})
    return window, MappingProxyType(values)


def _like(word: str, accepted: Mapping[str, object]) -> str:
    close = difflib.get_close_matches(word, accepted, 1)
    return f" (did you mean {close[0]!r}?)" if close else ""
