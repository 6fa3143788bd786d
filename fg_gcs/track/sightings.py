"""Sightings: where a target was when, how sure that is, and how they are read from datagrams and files.

Whatever comes in a datagram, reading it never raises: what cannot be used is counted by its reason. A file is named on
purpose, so the first thing wrong with it ends the reading, in one clear line.
"""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from enum import Enum
from typing import Any, NamedTuple, NoReturn

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.errors import MissionError

MOST_LINES = 100  # of one datagram: a sighting takes some hundred bytes, and an unfragmented datagram holds a dozen
MOST_BYTES = 4096  # of one line: a sighting with a covariance and long decimals has a tenth of it
COLUMNS = ("time_s", "target", "east_m", "north_m", "up_m")  # that a file must have; sigma_m may come with them


class Verdict(Enum):
    """What became of a sighting; the value says it to people."""

    TAKEN = "taken"
    TENTATIVE = "held until others agree with it"
    MALFORMED = "not a sighting in the agreed form"
    NOT_FINITE = "has a number that is not finite"
    BAD_COVARIANCE = "its covariance is invalid, or too large to be of use"
    UNKNOWN_TARGET = "names a target that the mission does not have"
    FUTURE = "its stamp lies in the future"
    TOO_OLD = "its stamp lies too far in the past"
    FAR = "lies out of reach"
    DUPLICATE = "is known already"
    GATED = "does not fit what is known of the target"
    FLOOD = "one of too many at once"


class Sighting(NamedTuple):
    """One sensed position of one target."""

    target: str
    time_s: float  # when it was true [s of the flight's clock]
    position_enu_m: Array  # (3,) [m; ENU]
    covariance_m2: Array  # (3, 3) of the position's error [m^2; ENU]
    received_s: float  # when it arrived [s of the flight's clock]


class Batch(NamedTuple):
    """What one datagram held."""

    sightings: list[Sighting]
    refused: Mapping[Verdict, int]  # lines that gave none, by reason


class _RefusedError(Exception):
    """A line gives no sighting."""

    def __init__(self, verdict: Verdict) -> None:
        super().__init__(verdict.value)
        self.verdict = verdict


def parse_datagram(
    data: bytes,
    received_s: float,
    targets: Collection[str],
    sigma_m: float,
    began_s: float = 0.0,
    age_s: Callable[[float], float] | None = None,
) -> Batch:
    """Read the sightings of a datagram, one JSON object a line; never raises.

    Keys: ``target``; when it was true, one of ``stamp_unix_s`` in seconds of Unix time, ``age_s``, how long ago that
    was on arrival, and ``time_s`` in seconds since tracking began; ``position_enu_m``, three numbers; and, if wanted,
    either ``sigma_m``, one number or three, or ``covariance_m2``, three rows of three. Other keys mean nothing. Empty
    lines are skipped.

    Args:
        data: the datagram.
        received_s: when it arrived [s of the flight's clock].
        targets: names that are known.
        sigma_m: standard deviation along each axis of a sighting that states none [m].
        began_s: when tracking began: what is added to ``time_s`` [s of the flight's clock].
        age_s: turns ``stamp_unix_s`` into an age on arrival [s]; None: such stamps are refused.
    """
    lines = [line for line in data.split(b"\n") if line.strip()]
    sightings: list[Sighting] = []
    refused: Counter[Verdict] = Counter()
    for line in lines[:MOST_LINES]:
        try:
            sightings.append(_sighting(line, received_s, targets, sigma_m, began_s, age_s))
        except _RefusedError as refusal:
            refused[refusal.verdict] += 1
    if len(lines) > MOST_LINES:
        refused[Verdict.FLOOD] += len(lines) - MOST_LINES
    return Batch(sightings, refused)


def parse_csv(data: bytes, name: str, sigma_m: float) -> list[Sighting]:
    """Read the sightings of a file, in its order; each is received when it is true, which suits a replay.

    The first line names the columns: ``time_s,target,east_m,north_m,up_m`` and, if wanted, ``sigma_m``, in any order.

    Args:
        data: the file's content.
        name: what to call the file in errors.
        sigma_m: standard deviation along each axis where the file states none [m].

    Raises:
        MissionError: one line that names file and line, and says what would be accepted.
    """
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise MissionError(f"{name}: line {line}: not text in UTF-8") from error
    rows = csv.reader(lines, strict=True)
    sightings: list[Sighting] = []
    try:
        header = [column.strip() for column in next(rows, [])]
        _check_header(header, name)
        for row in rows:
            if row:
                sightings.append(_row(dict(_cells(header, row)), sigma_m))
    except (csv.Error, ValueError) as error:
        raise MissionError(f"{name}: line {rows.line_num}: {error}") from error
    if not sightings:
        raise MissionError(f"{name}: line {len(lines)}: no sighting; accepted: a header and one line for each sighting")
    return sightings


def isotropic(sigma_m: float) -> Array:
    """Return the covariance of an error with the same deviation along each axis, shape (3, 3) [m^2]."""
    return _read_only(np.diag([sigma_m * sigma_m] * 3))


# --- datagrams -------------------------------------------------------------------------------------------------------


def _sighting(
    line: bytes,
    received_s: float,
    targets: Collection[str],
    default_sigma_m: float,
    began_s: float,
    age_s: Callable[[float], float] | None,
) -> Sighting:
    """Read one line, or raise :class:`_RefusedError`."""
    if len(line) > MOST_BYTES:
        raise _RefusedError(Verdict.MALFORMED)
    try:
        told = json.loads(line, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:  # bad UTF-8 and integers of thousands of digits are ValueErrors, too
        raise _RefusedError(Verdict.MALFORMED) from error
    if not isinstance(told, dict) or not isinstance(told.get("target"), str):
        raise _RefusedError(Verdict.MALFORMED)
    stamps = [key for key in ("time_s", "age_s", "stamp_unix_s") if key in told]
    if len(stamps) != 1 or ("sigma_m" in told and "covariance_m2" in told):
        raise _RefusedError(Verdict.MALFORMED)
    position = np.array(_numbers(told.get("position_enu_m"), 3))
    covariance = _told_covariance(told, default_sigma_m)
    if told["target"] not in targets:
        raise _RefusedError(Verdict.UNKNOWN_TARGET)
    stamp = _number(told[stamps[0]])
    if stamps[0] == "time_s":
        time_s = began_s + stamp
    elif stamps[0] == "age_s":
        time_s = received_s - stamp
    elif age_s is not None:
        time_s = received_s - age_s(stamp)
    else:
        raise _RefusedError(Verdict.MALFORMED)
    return Sighting(told["target"], time_s, _read_only(position), covariance, received_s)


def _told_covariance(told: Mapping[str, Any], default_sigma_m: float) -> Array:
    if "covariance_m2" in told:
        rows = told["covariance_m2"]
        if not isinstance(rows, list) or len(rows) != 3:
            raise _RefusedError(Verdict.MALFORMED)
        return _read_only(np.array([_numbers(row, 3) for row in rows]))
    sigma = told.get("sigma_m", default_sigma_m)
    sigmas = _numbers(sigma, 3) if isinstance(sigma, list) else [_number(sigma)] * 3
    variances = [each * each for each in sigmas]
    if min(sigmas) < 0.0 or not all(math.isfinite(variance) for variance in variances):
        raise _RefusedError(Verdict.BAD_COVARIANCE)
    return _read_only(np.diag(variances))


def _no_number(constant: str) -> NoReturn:
    raise ValueError(constant)  # NaN and infinities, which JSON does not have


def _number(value: object) -> float:
    """Return a JSON number; text, truth values and what no float can hold are none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise _RefusedError(Verdict.MALFORMED)
    try:
        number = float(value)
    except OverflowError as error:
        raise _RefusedError(Verdict.MALFORMED) from error
    if not math.isfinite(number):  # 1e999
        raise _RefusedError(Verdict.MALFORMED)
    return number


def _numbers(value: object, count: int) -> list[float]:
    if not isinstance(value, list) or len(value) != count:
        raise _RefusedError(Verdict.MALFORMED)
    return [_number(each) for each in value]


# --- files -----------------------------------------------------------------------------------------------------------


def _check_header(header: list[str], name: str) -> None:
    """Refuse columns that are missing, unknown, or there twice."""
    accepted = f"accepted: {','.join(COLUMNS)}[,sigma_m]"
    missing = [column for column in COLUMNS if column not in header]
    strange = [column for column in header if column not in (*COLUMNS, "sigma_m")]
    twice = [column for column in header if header.count(column) > 1]
    for columns, what in ((strange, "is no column"), (missing, "is missing"), (twice, "is there twice")):
        if columns:
            raise MissionError(f"{name}: line 1: {columns[0]!r:.40} {what}; {accepted}")


def _cells(header: list[str], row: list[str]) -> Iterator[tuple[str, str]]:
    if len(row) != len(header):
        raise ValueError(f"{len(row)} fields; accepted: {len(header)}, as in the first line")
    return zip(header, (cell.strip() for cell in row), strict=True)


def _row(cells: Mapping[str, str], default_sigma_m: float) -> Sighting:
    """Read one line of a file, or raise a ValueError that says what is wrong with which column."""
    if not cells["target"]:
        raise ValueError("target is empty; accepted: the name of a target")
    time_s, *position = (_cell(cells, key) for key in COLUMNS if key != "target")
    sigma_m = _cell(cells, "sigma_m") if cells.get("sigma_m") else default_sigma_m
    if not 0.0 <= sigma_m < math.inf or not math.isfinite(sigma_m * sigma_m):
        raise ValueError(f"sigma_m is {sigma_m:g}; accepted: a number of metres, 0 or more")
    return Sighting(cells["target"], time_s, _read_only(np.array(position)), isotropic(sigma_m), time_s)


def _cell(cells: Mapping[str, str], key: str) -> float:
    try:
        number = float(cells[key])
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{key} is {cells[key]!r:.40}; accepted: a finite number")
    return number


def _read_only(array: Array) -> Array:
    array.setflags(write=False)
    return array
