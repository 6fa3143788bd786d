"""Things that several planning tests plan with."""

from __future__ import annotations

import time

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Formation, Pose, facing, hemisphere
from fg_gcs.core.separation import Fence
from fg_gcs.plan.flight_plan import FlightPlan, Task, compile_flight
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.targets import Target

PAPER = hemisphere(4, 5, 5.0)
START = Pose(np.array([0.0, 2.5, 2.5]), facing(np.array([1.0, 0.0, 0.0])))
LIMITS = Limits(10.0, 5.0)


def task(
    target: tuple[float, float, float] = (10.0, 10.0, 20.0),
    limits: Limits = LIMITS,
    formation: Formation = PAPER,
    separation_m: float = 1.5,
) -> Task:
    start = Pose(np.array([0.0, 2.5, 12.5]), START.rotation)
    fence = Fence((-80.0, -80.0, 3.0), (80.0, 80.0, 80.0))
    return Task(formation, start, Target.ball(target), 0.25, Rules(limits, separation_m, fence))


def tops(count: int = 9, spacing_m: float = 3.0) -> Array:
    columns = int(np.ceil(np.sqrt(count)))
    index = np.arange(count)
    return np.stack((index % columns * spacing_m - 6.0, index // columns * spacing_m, np.full(count, 4.0)), axis=1)


def compiled(made: Task | None = None, above: Array | None = None) -> FlightPlan:
    chosen = made or task()
    count = len(chosen.formation.slots_m)
    return compile_flight(chosen, tops(count) if above is None else above, time.perf_counter)
