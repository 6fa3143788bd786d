"""The paper's flights as trajectories: how long they take, and what their norms reach."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.experiment import ours
from fg_gcs.experiment.baseline import Progress, Stopwatch, run_paper_way
from fg_gcs.experiment.baselines.reference_planner import PaperPlan
from fg_gcs.experiment.scenes import LIMITS, Scene, scene
from fg_gcs.experiment.tables import Cell, Column, ResultTable

TARGETS = ((40.0, 40.0, 40.0), (-20.0, 20.0, 20.0), (10.0, 10.0, 10.0), (-10.0, 10.0, 10.0))  # those it draws

TEXT = (
    f"Nine vehicles fly from rest to rest, under norms of {LIMITS.speed_m_s:g} m/s and {LIMITS.acceleration_m_s2:g} "
    "m/s². The paper's way bounds each axis by these numbers, so its norms grow beyond them. *Bang-bang* is full "
    "acceleration and full braking along the straight line between the centres; no turn is as fast."
)
COLUMNS = (
    Column("target [m]"),
    Column("bang-bang [s]", 2),
    Column("paper's way here [s]", 2),
    Column("its top speed [m/s]", 2),
    Column("its top acceleration [m/s²]", 2),
    Column("ours [s]", 2),
    Column("our top speed [m/s]", 3),
    Column("our top acceleration [m/s²]", 3),
    Column("our coverage after the turn", 4),
)


class Norms(NamedTuple):
    """Norms over time of all vehicles."""

    time_s: Array  # (T,)
    speed_m_s: Array  # (T, V)
    acceleration_m_s2: Array  # (T, V)


@dataclass(frozen=True)
class Flight:
    """One flight both ways."""

    scene: Scene
    planned: ours.Planned
    ours: Norms
    theirs: Norms | None  # None: the paper's way found no timing


def fly(made: Scene, stopwatch: Stopwatch) -> Flight:
    """Plan a flight both ways and sample its norms at 1 kHz.

    Raises:
        PlanError: ours has no plan.
    """
    planned = ours.plan(made)
    time_s = np.arange(0.0, planned.plan.duration_s, 1.0 / ours.SAMPLE_HZ)
    _, velocity, acceleration = planned.plan.sample(time_s)
    mine = Norms(time_s, np.linalg.norm(velocity, axis=2), np.linalg.norm(acceleration, axis=2))
    theirs = run_paper_way(made, stopwatch).plan
    return Flight(made, planned, mine, None if theirs is None else _norms(theirs))


def fly_all(stopwatch: Stopwatch, progress: Progress) -> tuple[Flight, ...]:
    """Plan every flight that the paper draws.

    Raises:
        PlanError: ours has no plan.
    """
    flights = []
    for target_m in TARGETS:
        made = scene(target_m)
        progress(f"figures: flight to ({made.name})")
        flights.append(fly(made, stopwatch))
    return tuple(flights)


def flights_table(flights: tuple[Flight, ...]) -> ResultTable:
    """Return the flights' durations and peaks."""
    return ResultTable("flights", "Flights", TEXT, COLUMNS, tuple(_row(flight) for flight in flights))


def bang_bang_s(made: Scene) -> float:
    """Return the time of the straight line from rest to rest [s]."""
    way_m = float(np.linalg.norm(made.target_enu_m - made.start.centre_enu_m))
    speed, acceleration = LIMITS.speed_m_s, LIMITS.acceleration_m_s2
    if way_m < speed**2 / acceleration:  # too short to reach full speed
        return 2.0 * float(np.sqrt(way_m / acceleration))
    return way_m / speed + speed / acceleration


def _norms(plan: PaperPlan) -> Norms:
    time_s = np.arange(0.0, plan.duration_s, 1.0 / ours.SAMPLE_HZ)
    return Norms(time_s, plan.norms(time_s, 1), plan.norms(time_s, 2))


def _row(flight: Flight) -> tuple[Cell, ...]:
    theirs: tuple[Cell, ...] = (None, None, None)
    if flight.theirs is not None:
        last_s = float(flight.theirs.time_s[-1])
        theirs = (last_s, float(flight.theirs.speed_m_s.max()), float(flight.theirs.acceleration_m_s2.max()))
    return (
        flight.scene.name,
        bang_bang_s(flight.scene),
        *theirs,
        flight.planned.plan.duration_s,
        float(flight.ours.speed_m_s.max()),
        float(flight.ours.acceleration_m_s2.max()),
        ours.path_figures(flight.scene, flight.planned.path).coverage_after_facing,
    )
