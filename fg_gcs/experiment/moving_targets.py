"""Moving targets: what planning alone makes of sightings, beside what is required of it.

Kinematic simulations, not flights: the vehicles follow perfectly. Whole flights are measured by ``fg-gcs bench track``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from statistics import median
from typing import Final, NamedTuple

import numpy as np

from fg_gcs.core.formation import Formation, Pose, facing, hemisphere
from fg_gcs.core.separation import Fence
from fg_gcs.experiment.baseline import Progress, Stopwatch
from fg_gcs.experiment.scenes import FOLLOWERS, LEADERS, LIMITS
from fg_gcs.experiment.tables import Cell, Column, ResultTable
from fg_gcs.mission.target_tables import TrackTable
from fg_gcs.plan.limits import Rules
from fg_gcs.run.kinematic import Figures, KinematicSimulation, simulate_kinematics
from fg_gcs.scenario.motions import Circle, FigureEight, TrueMotion
from fg_gcs.scenario.random_walk import RandomWalk
from fg_gcs.scenario.sensor import Sensor, SensorSettings
from fg_gcs.track.follow.replanner import Swarm

SECONDS = 60.0  # of a kinematic simulation: three quarters of the circle, after a capture within twenty seconds
SEEDS = 8  # of sensors and of the evader; they count from 0
EDGE_M, DEPTH_M, SEPARATION_M = 6.0, 1.0, 1.5  # as in the missions that fly the same
HEIGHT_M, REACH_M = 18.0, 100.0
SILENCE_S = (25.0, 33.0)  # of the target that is lost, when every kinematic simulation has caught it
MANY = 100  # vehicles of the second swarm

CLEAN: Final = SensorSettings()
ROUGH: Final = SensorSettings(drop=0.3, outliers=0.05, outlier_m=20.0)
CIRCLE, EIGHT, EVADER, LOST, OUTLIERS = (
    "circle, 4 m/s",
    "figure of eight, 5 m/s",
    "evader, 1 m/s²",
    "circle, unseen for 8 s",
    "circle, 30 % lost, 5 % wild",
)
DRAWN: Final = (CIRCLE, EIGHT, EVADER, LOST)

TEXT = (
    "Nine vehicles start from rest, under norms of 10 m/s and 5 m/s², with a sensor of 10 Hz, 0.5 m along each "
    "axis and 100 ms delay. These are figures of planning alone: 60 s with vehicles that follow perfectly, for "
    "several seeds of the sensor's noise (and of the evader's motion); the table has the median of the seeds and "
    "the worst. *Error* is the distance of the formation's centre from the true target, from 2 s after the "
    "capture to the end. *Coverage* is the smallest on the way to the target, once the face has turned to it. "
    "*Steps* are changes between setpoints 20 ms apart that neither their velocities nor the limit of "
    "acceleration explain."
)
REPLANS_TEXT = (
    "Time to find a better trajectory after a sighting, over the kinematic simulations of the circle. Times "
    "belong to the machine and the run that wrote this page."
)
COLUMNS = (
    Column("target"),
    Column("figure"),
    Column("required"),
    Column("median", 3),
    Column("worst", 3),
    Column("met"),
)
REPLANS_COLUMNS = (
    Column("vehicles", 0),
    Column("figure"),
    Column("required"),
    Column("measured [ms]", timed=True),
    Column("met"),
)


class Requirement(NamedTuple):
    """A figure and what is required of it."""

    figure: str
    bound: float | None  # None: it is only told
    at_least: bool = False

    @property
    def text(self) -> str:
        """What is required, as people write it; empty where nothing is."""
        return "" if self.bound is None else f"{'>=' if self.at_least else '<='} {self.bound:g}"

    def met(self, value: float | None) -> bool:
        """Say whether a value is good enough; one that could not be measured is not."""
        if self.bound is None:
            return True
        return value is not None and (value >= self.bound if self.at_least else value <= self.bound)

    def worst(self, values: Sequence[float | None]) -> float | None:
        """Return the worst of some values, None if one could not be measured."""
        known = [value for value in values if value is not None]
        return None if len(known) < len(values) or not known else (min if self.at_least else max)(known)


CAUGHT: Final = Requirement("caught after [s]", None)
REPLANS: Final = {  # by the number of vehicles: share of the durations [%], and what is required of it
    9: ((50.0, Requirement("replan, median [ms]", 5.0)), (99.0, Requirement("replan, 99 % [ms]", 15.0))),
    MANY: ((50.0, Requirement("replan, median [ms]", 20.0)), (99.0, Requirement("replan, 99 % [ms]", None))),
}

Measured = tuple[Requirement, Callable[[Figures], float | None]]


class Course(NamedTuple):
    """One kind of target and how it is seen."""

    name: str
    motion: Callable[[int], TrueMotion]  # by the seed
    sensor: SensorSettings
    required: tuple[Measured, ...]


def courses() -> tuple[Course, ...]:
    """Return what is simulated, in the order of the table."""
    circle = Circle((0.0, 0.0, HEIGHT_M), 50.0, 4.0)
    eight = FigureEight((30.0, 0.0, HEIGHT_M), 80.0, 5.0, 30.0)
    rms = "error, rms [m]"
    return (
        Course(
            CIRCLE,
            lambda _seed: circle,
            CLEAN,
            (
                (Requirement(rms, 0.5), lambda figures: figures.error_rms_m),
                (Requirement("share of time held", 0.95, at_least=True), lambda figures: figures.flux_metric_share),
                (
                    Requirement("coverage", 0.95, at_least=True),
                    lambda figures: figures.coverage_min_after_facing,
                ),
            ),
        ),
        Course(EIGHT, lambda _seed: eight, CLEAN, ((Requirement(rms, 0.7), lambda figures: figures.error_rms_m),)),
        Course(EVADER, _evader, CLEAN, ((Requirement("error, 95 % [m]", 1.5), lambda figures: figures.error_p95_m),)),
        Course(
            LOST,
            lambda _seed: circle,
            replace(CLEAN, silence_s=(SILENCE_S,)),
            ((Requirement("found again after [s]", 3.0), _found_again_s),),
        ),
        Course(OUTLIERS, lambda _seed: circle, ROUGH, ((Requirement(rms, None), lambda figures: figures.error_rms_m),)),
    )


def tracking_table(simulated: Mapping[str, Sequence[KinematicSimulation]]) -> ResultTable:
    """Return figures of kinematic simulations, by the courses' names, one for each seed, beside what is required."""
    figures = {name: [each.figures() for each in runs] for name, runs in simulated.items()}
    rows: list[tuple[Cell, ...]] = []
    for course in courses():
        own = figures[course.name]
        rows.append(_row(course.name, CAUGHT, [each.caught_s for each in own]))
        rows += [_row(course.name, requirement, [of(each) for each in own]) for requirement, of in course.required]
    ratios = [
        None if clean.error_rms_m is None or rough.error_rms_m is None else rough.error_rms_m / clean.error_rms_m
        for clean, rough in zip(figures[CIRCLE], figures[OUTLIERS], strict=True)
    ]
    rows.append(_row(OUTLIERS, Requirement("error over that without", 1.5), ratios))
    every = [each for own in figures.values() for each in own]
    for requirement, values in (
        (Requirement("step of the position [m]", 0.02), [each.position_step_m for each in every]),
        (Requirement("step of the velocity [m/s]", 0.2), [each.velocity_step_m_s for each in every]),
        (Requirement("rules broken", 0.0), [float(len(each.broken)) for each in every]),
        (Requirement("closest pair [m]", SEPARATION_M, at_least=True), [each.separation_m for each in every]),
    ):
        rows.append(_row("all", requirement, values))
    return ResultTable("moving", "Moving targets", TEXT, COLUMNS, tuple(rows))


def replan_table(durations_ms: Mapping[int, Sequence[float]]) -> ResultTable:
    """Return how long replanning takes, from its durations by the number of vehicles."""
    rows: list[tuple[Cell, ...]] = []
    for vehicles, wanted in REPLANS.items():
        for share, requirement in wanted:
            value = float(np.percentile(durations_ms[vehicles], share))
            met = "" if requirement.bound is None else "yes" if requirement.met(value) else "no"
            rows.append((float(vehicles), requirement.figure, requirement.text, value, met))
    return ResultTable("moving_replans", "Replanning times", REPLANS_TEXT, REPLANS_COLUMNS, tuple(rows))


def simulate_all(
    stopwatch: Stopwatch, progress: Progress, seeds: int = SEEDS, seconds: float = SECONDS
) -> dict[str, list[KinematicSimulation]]:
    """Simulate every course with every seed; by the courses' names."""
    simulated: dict[str, list[KinematicSimulation]] = {}
    for course in courses():
        progress(f"moving: {course.name}")
        simulated[course.name] = [run(course, nine(), seed, seconds, stopwatch) for seed in range(seeds)]
    return simulated


def replan_durations_ms(
    simulated: Mapping[str, Sequence[KinematicSimulation]],
    stopwatch: Stopwatch,
    progress: Progress,
    seconds: float = SECONDS,
) -> dict[int, list[float]]:
    """Return how long each replan took, by the number of vehicles; the larger number is simulated here."""
    progress(f"moving: {MANY} vehicles")
    crowd = run(courses()[0], many(), 0, seconds, stopwatch)
    return {9: durations_ms(simulated[CIRCLE]), MANY: durations_ms([crowd])}


def durations_ms(simulations: Sequence[KinematicSimulation]) -> list[float]:
    """Return how long each replan took [ms]; the first of each kinematic simulation loads compiled code."""
    return [1e3 * replan.took_s for each in simulations for replan in each.replans[1:]]


def run(course: Course, swarm: Swarm, seed: int, seconds: float, stopwatch: Stopwatch) -> KinematicSimulation:
    """Simulate a course once; seeds 0 or more."""
    name = "target"
    tracking = TrackTable().settings({name: 1.0})  # as in flight, where a mission says nothing
    start = Pose(np.array([0.0, 0.0, 15.0]), facing(np.array([1.0, 0.0, 0.0])))
    sensors = [Sensor(name, course.sensor, seed)]
    return simulate_kinematics(swarm, tracking, start, {name: course.motion(seed)}, sensors, seconds, stopwatch)


def nine() -> Swarm:
    """Return the swarm of the requirements, as in the missions."""
    return _swarm(hemisphere(LEADERS, FOLLOWERS, EDGE_M), Fence((-REACH_M, -REACH_M, 3.0), (REACH_M, REACH_M, 60.0)))


def many() -> Swarm:
    """Return a hundred vehicles, a lattice behind a square of twice the size, above ground that lies lower."""
    lattice = np.stack(np.meshgrid(*[3.0 * np.arange(5.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    behind = np.array([-3.0, -6.0, -6.0]) + lattice * np.array([-1.0, 1.0, 1.0])
    leaders = hemisphere(LEADERS, 0, 2.0 * EDGE_M).leaders_m
    formation = Formation(leaders, behind[: MANY - LEADERS])
    return _swarm(formation, Fence((-REACH_M, -REACH_M, -REACH_M), (REACH_M, REACH_M, REACH_M)))


def _swarm(formation: Formation, fence: Fence) -> Swarm:
    return Swarm(formation, formation.slots_m, DEPTH_M, Rules(LIMITS, SEPARATION_M, fence))


def _evader(seed: int) -> TrueMotion:
    return RandomWalk((-70.0, -70.0, 14.0), (70.0, 70.0, 24.0), 5.0, 1.0, seed, (40.0, 20.0, HEIGHT_M))


def _found_again_s(figures: Figures) -> float | None:
    """The longest that it took after a loss; None if it was not found, or never lost."""
    return Requirement("", None).worst(figures.found_again_s)


def _row(name: str, requirement: Requirement, values: Sequence[float | None]) -> tuple[Cell, ...]:
    ordered = sorted(_never(requirement) if value is None else value for value in values)
    middle = median(ordered)
    half, worst = middle if math.isfinite(middle) else None, requirement.worst(values)
    met = "yes" if requirement.met(worst) else "median" if requirement.met(half) else "no"
    return (name, requirement.figure, requirement.text, half, worst, met if requirement.bound is not None else "")


def _never(requirement: Requirement) -> float:
    return -math.inf if requirement.at_least else math.inf
