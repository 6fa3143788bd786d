"""Where a target vehicle is at a time: prescribed motions in world NED. Sans-IO; time is an argument."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeGuard

from sitl_mock.physics.reference import Vec3, plus

State = tuple[Vec3, Vec3]  # position [m; NED], velocity [m/s; NED]
Course = Callable[[float], State]  # by time since the simulator began [s]

LEAST, MOST = 1e-3, 1e6  # of lengths, speeds and accelerations, and of any number: angles and times stay numbers


def static(position_enu_m: Vec3) -> Course:
    """Stay."""
    place = _ned(position_enu_m)
    return lambda time_s: (place, (0.0, 0.0, 0.0))


def circle(
    centre_enu_m: Vec3, radius_m: float, speed_m_s: float, phase_deg: float = 0.0, clockwise: bool = False
) -> Course:
    """Go round a level circle; the phase counts from east, counter-clockwise as seen from above."""
    north, east, down = _ned(centre_enu_m)
    turn_rad_s = -speed_m_s / radius_m if clockwise else speed_m_s / radius_m

    def at(time_s: float) -> State:
        angle = math.radians(phase_deg) + turn_rad_s * time_s
        along_m_s = turn_rad_s * radius_m
        place = (north + radius_m * math.sin(angle), east + radius_m * math.cos(angle), down)
        return place, (along_m_s * math.cos(angle), -along_m_s * math.sin(angle), 0.0)

    return at


def figure_eight(centre_enu_m: Vec3, length_m: float, top_speed_m_s: float, heading_deg: float = 90.0) -> Course:
    """Fly a level lemniscate of Gerono: forwards ``L/2 sin q``, to the right ``-L/4 sin 2q``, fastest where q is 0."""
    north, east, down = _ned(centre_enu_m)
    rate = math.sqrt(2.0) * top_speed_m_s / length_m
    ahead_north, ahead_east = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))

    def turned(forwards: float, right: float) -> tuple[float, float]:
        return forwards * ahead_north - right * ahead_east, forwards * ahead_east + right * ahead_north

    def at(time_s: float) -> State:
        q = rate * time_s
        moved = turned(0.5 * length_m * math.sin(q), -0.25 * length_m * math.sin(2.0 * q))
        speed = turned(0.5 * length_m * rate * math.cos(q), -0.5 * length_m * rate * math.cos(2.0 * q))
        return (north + moved[0], east + moved[1], down), (speed[0], speed[1], 0.0)

    return at


def waypoints(
    points_enu_m: Sequence[Vec3], speed_m_s: float, acceleration_m_s2: float = 1.0, closed: bool = False
) -> Course:
    """Go straight from point to point; at corners the velocity turns evenly, half before the time of passing them.

    It rests at both ends, or goes round and round, then beginning in the middle of the first corner.

    Raises:
        ValueError: too few points, two in one place, or a leg too short for the turns at its ends.
    """
    points = [_ned(point) for point in points_enu_m]
    if len(points) < (3 if closed else 2):
        raise ValueError("waypoints: there must be at least two points, three if closed")
    legs = list(zip(points, points[1:] + points[:1], strict=True))[: None if closed else -1]
    if any(begin == end for begin, end in legs):
        raise ValueError("waypoints: two neighbouring points are in one place")
    speeds = [_scaled(_minus(end, begin), speed_m_s / math.dist(begin, end)) for begin, end in legs]
    rest = (0.0, 0.0, 0.0)
    turns = list(zip([speeds[-1] if closed else rest, *speeds], [*speeds, speeds[0] if closed else rest], strict=True))
    halves_s = [0.5 * math.dist(before, after) / acceleration_m_s2 for before, after in turns]
    # Times of the knots between which the velocity changes evenly, and the velocity there
    knots: list[tuple[float, Vec3]] = []
    passed_s = 0.0 if closed else halves_s[0]
    for k, (before, after) in enumerate(turns):
        knots += [(passed_s - halves_s[k], before), (passed_s + halves_s[k], after)]
        passed_s += math.dist(*legs[k]) / speed_m_s if k < len(legs) else 0.0
    if any(later < earlier for (earlier, _), (later, _) in itertools.pairwise(knots)):
        raise ValueError("waypoints: a leg is too short for the turns at its ends")
    start = _minus(points[0], _scaled(turns[0][0], halves_s[0]))
    return _driven(knots, start, sum(math.dist(*leg) for leg in legs) / speed_m_s if closed else math.inf)


COURSES: Mapping[str, Callable[..., Course]] = MappingProxyType(
    {"static": static, "circle": circle, "figure_eight": figure_eight, "waypoints": waypoints}
)


def _driven(knots: list[tuple[float, Vec3]], start_m: Vec3, round_s: float) -> Course:
    """Return the motion whose velocity runs evenly from knot to knot, from a place at the first of them."""
    places = [start_m]
    for (earlier_s, one), (later_s, other) in itertools.pairwise(knots):
        mean = _scaled(plus(one, other), 0.5)
        places.append(plus(places[-1], _scaled(mean, later_s - earlier_s)))

    def at(time_s: float) -> State:
        time_s = math.fmod(time_s, round_s) if math.isfinite(round_s) else time_s
        k = max([i for i, (knot_s, _) in enumerate(knots) if knot_s <= time_s], default=0)
        passed_s = max(time_s - knots[k][0], 0.0)
        velocity = knots[k][1]
        if k + 1 < len(knots):
            length_s = knots[k + 1][0] - knots[k][0]
            change = _minus(knots[k + 1][1], velocity)
            velocity = plus(velocity, _scaled(change, passed_s / length_s))
        return plus(places[k], _scaled(plus(knots[k][1], velocity), 0.5 * passed_s)), velocity

    return at


def _ned(enu: Vec3) -> Vec3:
    east, north, up = enu
    return (north, east, -up)


def _minus(one: Vec3, other: Vec3) -> Vec3:
    return (one[0] - other[0], one[1] - other[1], one[2] - other[2])


def _scaled(vector: Vec3, by: float) -> Vec3:
    return (by * vector[0], by * vector[1], by * vector[2])


def checked(kind: str, keys: Mapping[str, Any]) -> Course:
    """Return the course of a kind from keys that came from outside.

    Raises:
        ValueError: an unknown kind or key, a missing key, or a value that cannot be flown; says which.
    """
    if kind not in COURSES:
        raise ValueError(f"kind {kind!r} is not one of: {', '.join(COURSES)}")
    for key, value in keys.items():
        _check(key, value)
    try:
        return COURSES[kind](**keys)
    except TypeError as error:  # its text names the key that is missing or not known
        raise ValueError(str(error)) from error


def _check(key: str, value: object) -> None:
    """Refuse a value that no course can have for this key.

    Raises:
        ValueError: says what would be accepted.
    """
    if key == "points_enu_m":
        if not isinstance(value, list | tuple) or not all(_is_point(each) for each in value):
            raise ValueError(f"{key} must be a list of [east, north, up] in metres")
    elif key.endswith("_enu_m"):
        if not _is_point(value):
            raise ValueError(f"{key} must be [east, north, up] in metres")
    elif key in ("clockwise", "closed"):
        if not isinstance(value, bool):
            raise ValueError(f"{key} must be true or false")
    elif not _is_number(value) or (not key.endswith("_deg") and value < LEAST):
        raise ValueError(f"{key} must be a number{'' if key.endswith('_deg') else f' from {LEAST:g}'} to {MOST:g}")


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= MOST


def _is_point(value: object) -> bool:
    return isinstance(value, list | tuple) and len(value) == 3 and all(_is_number(each) for each in value)
