"""Where instances stand: places on the ground by a layout, and where on Earth these are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic, geodetic_from_enu
from fg_gcs.errors import MissionError
from fg_gcs.mission.model import square_grid

LEAST_APART_M: Final = 1.0  # of two homes: PX4 rounds them by 0.4 m, and rotors have a size


class Layout(Enum):
    """How homes lie to each other."""

    GRID = "grid"  # row by row northwards, as a mission's pads
    LINE = "line"  # eastwards
    CIRCLE = "circle"  # around the home that is named, neighbours a spacing apart


def places(layout: Layout, count: int, spacing_m: float) -> Array:
    """Return the homes of a layout, shape (V, 2) [m; east, north of the named home]."""
    if layout is Layout.GRID:
        return square_grid(count, spacing_m)
    index = np.arange(count)
    if layout is Layout.LINE:
        return np.column_stack((index * spacing_m, np.zeros(count)))
    angle = 2.0 * np.pi * index / count
    radius_m = spacing_m / (2.0 * math.sin(math.pi / count)) if count > 1 else 0.0
    return radius_m * np.column_stack((np.cos(angle), np.sin(angle)))


def read_places(path: Path, count: int) -> Array:
    """Return the homes that a file lists, a line ``EAST,NORTH`` in metres each, shape (V, 2); ``#`` begins a comment.

    Raises:
        MissionError: it cannot be read, a line is none, or there are not enough of them.
    """
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise MissionError(f"--layout {path}: {getattr(error, 'strerror', None) or 'not a text'}") from error
    found = []
    for number, line in enumerate(lines, start=1):
        text = line.partition("#")[0].strip()
        if not text:
            continue
        try:
            east, north = map(float, text.split(","))
        except ValueError:
            east = north = math.nan
        if not math.isfinite(east + north):
            raise MissionError(f"--layout {path}: line {number}: {text!r} is not EAST,NORTH in metres")
        found.append((east, north))
    if len(found) < count:
        raise MissionError(f"--layout {path}: {len(found)} homes for {count} vehicles")
    return np.array(found[:count])


def homes(places_m: Array, home: Geodetic) -> list[Geodetic]:
    """Return where places on the ground are on Earth, all at the height of the named home.

    Args:
        places_m: shape (V, 2) [m; east, north of the named home].
        home: on Earth.

    Raises:
        MissionError: two of them are too near to each other.
    """
    for first, second in combinations(range(len(places_m)), 2):
        apart_m = float(np.hypot(*(places_m[first] - places_m[second])))
        if apart_m < LEAST_APART_M:
            raise MissionError(
                f"homes {first + 1} and {second + 1} are {apart_m:.2f} m apart; at least {LEAST_APART_M:g} m are needed"
            )
    return [_level(place, home) for place in places_m]


def _level(place_m: Sequence[float] | Array, home: Geodetic) -> Geodetic:
    there = geodetic_from_enu(np.array([place_m[0], place_m[1], 0.0]), home)
    return there._replace(altitude_m=home.altitude_m)
