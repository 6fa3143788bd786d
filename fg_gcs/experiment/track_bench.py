"""What ``bench track`` measures: whole flights after moving targets in virtual time, beside what they must keep."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from fg_gcs.errors import FgError, MissionError
from fg_gcs.experiment.moving_targets import MANY, REPLANS, Requirement, courses, durations_ms, many, nine, run
from fg_gcs.experiment.random_missions import random_mission
from fg_gcs.experiment.tables import Cell, Column
from fg_gcs.mission import Mission, load_mission, parse_mission
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.rules import Peaks, broken, peaks_of, too_close
from fg_gcs.record.evaluate.figures import PLANNED_STAGES
from fg_gcs.record.read.run import load_run
from fg_gcs.record.write.layouts import Columns
from fg_gcs.run.flying import FlyOptions, fly_blocking

Summary = Mapping[str, object]

MISSIONS = ("circle", "figure_eight", "evader", "lost_and_found", "convoy", "escort")
ROUGH = "circle, rough"
ROUGH_SENSOR = "\n[targets.sensor]\ndrop = 0.3\noutliers = 0.05\noutlier_m = 20.0\n"  # goes to the last target
SIMULATED_S = 60.0  # a minute gives some 600 durations of replanning
KEYS = (  # of every mission's summary, by the names of the JSON of `fly`
    "completed",
    "reason",
    "vehicles_landed",
    "capture_time_s",
    "centre_error_rms_m",
    "centre_error_p95_m",
    "centre_error_commanded_rms_m",
    "flux_metric_share",
    "coverage_min_after_facing",
    "found_again_s",
    "commanded_position_step_max_m",
    "commanded_velocity_step_max_m_s",
    "flown_min_separation_m",
    "replans",
    "replan_median_ms",
    "replan_p99_ms",
    "sightings",
    "sightings_rejected",
)
COLUMNS = (
    Column("target"),
    Column("figure"),
    Column("required"),
    Column("measured", 3),
    Column("met"),
)
TEXT = "Nine simulated vehicles; flown figures are those of their telemetry."

RMS = "centre_error_rms_m"
SHARE, COVERAGE, FOUND = "flux_metric_share", "coverage_min_after_facing", "found_again_s"
REQUIRED: dict[str, tuple[tuple[str, Requirement], ...]] = {  # of whole flights, by mission
    "circle": (
        (RMS, Requirement("error, rms [m]", 0.5)),
        (SHARE, Requirement("share of time held", 0.95, at_least=True)),
        (COVERAGE, Requirement("coverage", 0.95, at_least=True)),
    ),
    "figure_eight": ((RMS, Requirement("error, rms [m]", 0.7)),),
    "evader": (("centre_error_p95_m", Requirement("error, 95 % [m]", 1.5)),),
    "lost_and_found": ((FOUND, Requirement("found again after [s]", 3.0)),),
    "convoy": ((RMS, Requirement("error, rms [m]", None)),),
    "escort": ((RMS, Requirement("error, rms [m]", None)),),
    ROUGH: ((RMS, Requirement("error, rms [m]", None)),),
}
TOLD = (  # of every mission, what is only told
    ("capture_time_s", Requirement("caught after [s]", None)),
    ("centre_error_commanded_rms_m", Requirement("error as commanded, rms [m]", None)),
)
STEPS = (
    ("commanded_position_step_max_m", Requirement("step of the position [m]", 0.02)),
    ("commanded_velocity_step_max_m_s", Requirement("step of the velocity [m/s]", 0.2)),
)
REACTION = Requirement("sighting to setpoint, 99 % [ms]", 25.0)


class Flight(NamedTuple):
    """One whole flight."""

    summary: Summary  # by the names of the JSON of `fly`
    broken: tuple[str, ...]  # names of the limits that setpoints broke
    pairs_below: int  # pairs of vehicles whose setpoints came too close

    @property
    def landed(self) -> bool:
        """Whether every vehicle was on the ground in the end."""
        return self.summary["vehicles_landed"] == self.summary["vehicles"]


class Tried(NamedTuple):
    """What came of a random mission."""

    seed: int
    said: str
    flight: Flight | None  # None: it could not be flown


Flyer = Callable[[str, str | None], Flight]  # takes a mission's TOML and the simulator's autopilot (None: as it says)


@dataclass(frozen=True)
class Size:
    """How much is measured."""

    flights: int = 0  # random ones, besides the missions
    seed: int = 0  # of the first random flight, one more for each of the next; and of the kinematic simulations
    simulated_s: float = SIMULATED_S
    jobs: int = 1  # processes for the random flights


def measure(
    missions: Path, size: Size, flyer: Flyer, stopwatch: Callable[[], float], progress: Callable[[str], None]
) -> tuple[dict[str, object], tuple[tuple[Cell, ...], ...]]:
    """Return every figure for programs, and the rows of the table for people.

    Raises:
        MissionError: a mission file is missing or wrong.
        PlanError: a mission has no plan.
    """
    texts = {name: _text(missions / f"{name}.toml") for name in MISSIONS}
    texts[ROUGH] = texts["circle"] + ROUGH_SENSOR
    flown: dict[str, Flight] = {}
    for number, (name, text) in enumerate(texts.items(), start=1):
        progress(f"flight {number} of {len(texts)}: {name}")
        flown[name] = flyer(text, None)
    durations: dict[int, list[float]] = {}
    for vehicles, swarm in ((9, nine()), (MANY, many())):
        progress(f"replanning for {vehicles} vehicles")
        durations[vehicles] = durations_ms([run(courses()[0], swarm, size.seed, size.simulated_s, stopwatch)])
    drawn = _random_flights(size, flyer, progress)
    rows = [*_mission_rows(flown), *_replan_rows(durations), *_random_rows(drawn)]
    figures: dict[str, object] = {
        "seeds": {
            "kinematic simulation": size.seed,
            "flights": [size.seed + number for number in range(size.flights)],
            "sensors": {name: _sensor_seeds(missions / f"{name}.toml") for name in MISSIONS},
        },
        "missions": {
            name: {key: each.summary.get(key) for key in KEYS}
            | {"limits_broken": list(each.broken), "pairs_below_minimum": each.pairs_below}
            for name, each in flown.items()
        },
        "replans": {
            str(vehicles): {"median_ms": np.median(took), "p99_ms": np.percentile(took, 99.0), "count": len(took)}
            for vehicles, took in durations.items()
        },
        "sensed_to_setpoint_p99_ms": None,  # virtual time stands still while a trajectory is planned
        "flights": drawn,
        "requirements": [dict(zip(("target", "figure", "required", "value", "met"), row, strict=True)) for row in rows],
    }
    return figures, tuple(rows)


def fly_once(text: str, autopilot: str | None) -> Flight:
    """Fly a mission in virtual time and return what its record says.

    Raises:
        MissionError: the mission is wrong.
        PlanError: it has no plan.
    """
    with TemporaryDirectory(prefix="fg-gcs-bench-") as place:
        mission = parse_mission(text)
        result = fly_blocking(
            mission, FlyOptions(autopilot=autopilot, logs=Path(place), write_report=False), speed=math.inf
        )
        if isinstance(result.error, FgError):
            raise result.error
        return Flight(result.summary, *commanded(load_run(result.folder).setpoints, result.summary, mission))


def commanded(setpoints: Columns, summary: Summary, mission: Mission) -> tuple[tuple[str, ...], int]:
    """Return which limits setpoints broke in the planned stages, and how many pairs came too close.

    Args:
        setpoints: columns of the setpoint table.
        summary: of the flight: its stages, limits and separation.
        mission: whose fence counts.
    """
    stages, limits = summary["stages"], summary["limits"]
    assert isinstance(stages, dict)
    assert isinstance(limits, dict)
    time_s, ids = setpoints["time_s"], np.unique(setpoints["system_id"])
    spans = [stages[name] for name in PLANNED_STAGES if name in stages]
    inside = np.any([(time_s >= begin) & (time_s <= end) for begin, end in spans] or [np.zeros(len(time_s))], axis=0)
    rows = np.flatnonzero(inside)
    rows = rows[np.lexsort((setpoints["system_id"][rows], time_s[rows]))]
    _, tick, count = np.unique(time_s[rows], return_inverse=True, return_counts=True)
    rows = rows[count[tick] == len(ids)]  # instants at which everybody got one
    if not len(rows):
        return (), 0
    position, velocity, acceleration = (
        setpoints[name][rows].reshape(-1, len(ids), 3)
        for name in ("position_enu_m", "velocity_enu_m_s", "acceleration_enu_m_s2")
    )
    peaks = peaks_of(velocity, acceleration, time_s[rows].reshape(-1, len(ids))[:, 0])
    told = Limits(**{name: math.inf if limits[name] is None else limits[name] for name in Peaks._fields})
    minimum_m, fence = _number(summary["separation_m"]), mission.fence.box()
    excess_m = float(fence.excess_m(position).max())
    first, second = np.triu_indices(len(ids), k=1)
    nearest = np.linalg.norm(position[:, first] - position[:, second], axis=2).min(axis=0)
    pairs_below = sum(too_close(distance_m, minimum_m) for distance_m in nearest.tolist())
    return broken(peaks, excess_m, math.inf, Rules(told, minimum_m, fence)), pairs_below  # pairs count by themselves


def _random_flights(size: Size, flyer: Flyer, progress: Callable[[str], None]) -> dict[str, object]:
    """Fly random missions and count what went wrong."""
    counts: Counter[str] = Counter()
    odd: list[dict[str, object]] = []
    nearest: list[float] = []
    for number, (seed, said, flight) in enumerate(_tries(size, flyer), start=1):
        drawn = random_mission(seed)
        progress(f"random flight {number} of {size.flights}: seed {seed}, {drawn.motion}, {drawn.autopilot}: {said}")
        if flight is None:
            counts["not_landed"] += 1
            odd.append({"seed": seed, "said": said})
            continue
        below = too_close(*(_number(flight.summary[key]) for key in ("flown_min_separation_m", "separation_m")))
        counts["completed"] += bool(flight.summary["completed"])
        counts["not_landed"] += not flight.landed
        counts["pairs_below_minimum"] += flight.pairs_below
        counts["flown_below_minimum"] += below
        counts["limits_broken"] += len(flight.broken)
        nearest.append(_number(flight.summary["flown_min_separation_m"]))
        if said != "completed" or below:
            odd.append({"seed": seed, "said": said, "flown_min_separation_m": nearest[-1]})
    told = ("completed", "not_landed", "pairs_below_minimum", "flown_below_minimum", "limits_broken")
    return {
        "flown": size.flights,
        **{name: counts[name] for name in told},
        "flown_min_separation_m": min(nearest, default=None),
        "odd": odd,
    }


def _tries(size: Size, flyer: Flyer) -> Iterator[Tried]:
    """Fly every random mission, several at once if so many are wanted; in the order of their seeds."""
    seeds = range(size.seed, size.seed + size.flights)
    if size.jobs == 1:
        yield from (_tried(seed, flyer) for seed in seeds)
        return
    # Spawned, not forked: a fork would copy the threads' locks, but not the threads
    with ProcessPoolExecutor(size.jobs, mp_context=get_context("spawn")) as pool:
        try:
            yield from pool.map(partial(_tried, flyer=flyer), seeds)
        finally:
            pool.shutdown(cancel_futures=True)


def _tried(seed: int, flyer: Flyer) -> Tried:
    """Fly, and say how it went."""
    drawn = random_mission(seed)
    try:
        flight = flyer(drawn.text, drawn.autopilot)
    except FgError as error:
        return Tried(seed, f"not flown: {error}", None)
    parts = [] if flight.summary["completed"] else [f"not completed: {flight.summary['reason']}"]
    parts += [] if flight.landed else [f"{flight.summary['vehicles_landed']} vehicles landed"]
    parts += [f"broke {', '.join(flight.broken)}"] if flight.broken else []
    parts += [f"{flight.pairs_below} pairs too close"] if flight.pairs_below else []
    return Tried(seed, "; ".join(parts) or "completed", flight)


def _mission_rows(flown: Mapping[str, Flight]) -> Iterator[tuple[Cell, ...]]:
    for name, flight in flown.items():
        for key, requirement in (*REQUIRED[name], *TOLD):
            yield _row(name, requirement, _figure(flight.summary, key))
    clean, rough = (_figure(flown[name].summary, RMS) for name in ("circle", ROUGH))
    ratio = None if clean is None or rough is None else rough / clean
    yield _row(ROUGH, Requirement("error over that without", 1.5), ratio)
    for key, requirement in STEPS:
        values = [_figure(flight.summary, key) for flight in flown.values()]
        yield _row("all", requirement, requirement.worst(values))
    yield _row("all", Requirement("limits broken", 0.0), sum(len(flight.broken) for flight in flown.values()))
    yield _row("all", Requirement("pairs too close", 0.0), sum(flight.pairs_below for flight in flown.values()))
    away = sum(not (flight.landed and flight.summary["completed"]) for flight in flown.values())
    yield _row("all", Requirement("not completed and landed", 0.0), away)
    yield ("all", REACTION.figure, REACTION.text, None, "only in real time")


def _replan_rows(durations: Mapping[int, Sequence[float]]) -> Iterator[tuple[Cell, ...]]:
    for vehicles, wanted in REPLANS.items():
        for share, requirement in wanted:
            yield _row(f"{vehicles} vehicles", requirement, float(np.percentile(durations[vehicles], share)))


def _random_rows(drawn: Summary) -> Iterator[tuple[Cell, ...]]:
    if not drawn["flown"]:
        return
    name = f"{drawn['flown']} random flights"
    for key in ("pairs_below_minimum", "flown_below_minimum", "limits_broken", "not_landed"):
        yield _row(name, Requirement(key.replace("_", " "), 0.0), _number(drawn[key]))
    yield _row(name, Requirement("completed", None), _number(drawn["completed"]))


def _row(name: str, requirement: Requirement, value: float | None) -> tuple[Cell, ...]:
    met = "" if requirement.bound is None else "yes" if requirement.met(value) else "no"
    return (name, requirement.figure, requirement.text, None if value is None else float(value), met)


def _figure(summary: Summary, key: str) -> float | None:
    """Return a figure of a summary; of several the worst, None if one is missing."""
    value = summary.get(key)
    if isinstance(value, list):
        return Requirement("", None).worst(value)
    return None if value is None else _number(value)


def _number(value: object) -> float:
    """Return a number of a summary; one that is missing is none."""
    return float(value) if isinstance(value, (int, float)) else math.nan


def _text(path: Path) -> str:
    """Return a mission file's text.

    Raises:
        MissionError: it cannot be read, or something in it is wrong.
    """
    load_mission(path)  # before minutes of flying, not after
    return path.read_text()


def _sensor_seeds(path: Path) -> dict[str, int]:
    targets = load_mission(path).targets
    if targets is None:
        raise MissionError(f"{path}: no [[targets]]; accepted: a mission whose targets move")
    return {target.name: target.sensor.seed for target in targets}
