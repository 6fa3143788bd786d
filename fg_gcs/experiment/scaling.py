"""How a plan's time and memory grow with the swarm."""

from __future__ import annotations

import multiprocessing
import resource
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from fg_gcs.core.formation import Formation, hemisphere
from fg_gcs.experiment import ours
from fg_gcs.experiment.baseline import Stopwatch, seconds
from fg_gcs.experiment.scenes import EDGE_M, LEADERS, scene
from fg_gcs.plan.flux_guided import plan_path

FLIGHT = (50.0, 50.0, 50.0)
MANY_LEADERS, MANY_FOLLOWERS = 64, 1000


def leaders_ratio(stopwatch: Stopwatch, repeats: int) -> float:
    """Return the time of the search for 64 leaders over that for 4 on the same circle."""
    made = scene(FLIGHT)
    radius_m = EDGE_M / np.sqrt(2.0)
    rims = [hemisphere(count, 0, float(2.0 * radius_m * np.sin(np.pi / count))) for count in (LEADERS, MANY_LEADERS)]
    laps = [
        [seconds(partial(plan_path, rim, made.start, made.target_enu_m), stopwatch) for rim in rims]
        for _ in range(repeats)
    ]
    few_s, many_s = np.median(laps, axis=0)
    return float(many_s / few_s)


def followers_ms(stopwatch: Stopwatch, repeats: int) -> float:
    """Return what 1000 followers behind the face add to a whole plan [ms]."""
    made = scene(FLIGHT)
    bare, crowded = hemisphere(LEADERS, 0, EDGE_M), _crowded()
    laps = []
    for _ in range(repeats + 1):
        laps.append([seconds(partial(ours.plan_formation, made, each), stopwatch) for each in (bare, crowded)])
    few_s, many_s = np.median(laps[1:], axis=0)  # the first warms up
    return float(1e3 * (many_s - few_s))


def memory_mb() -> float:
    """Return by how much a whole plan for 1000 followers raises a process's peak memory, compiled code included [MB].

    A process of its own measures: a peak never falls again.
    """
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        return process.submit(_grown_mb).result()


def _grown_mb() -> float:
    made, crowded = scene(FLIGHT), _crowded()
    before = _peak_mb()
    ours.plan_formation(made, crowded)
    return _peak_mb() - before


def _peak_mb() -> float:
    """Peak resident memory; Linux counts it for this program alone in a file, and its parent's too in getrusage."""
    status = Path("/proc/self/status")
    if status.exists():
        kibibytes = next(line.split()[1] for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(kibibytes) * 1024.0 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # macOS counts bytes


def _crowded() -> Formation:
    """The paper's square with 1000 followers on a lattice behind it."""
    side = round(MANY_FOLLOWERS ** (1.0 / 3.0))
    axis = EDGE_M * np.arange(side)
    lattice = np.stack(np.meshgrid(-EDGE_M - axis, axis - axis.mean(), axis - axis.mean()), axis=-1).reshape(-1, 3)
    return Formation(hemisphere(LEADERS, 0, EDGE_M).leaders_m, lattice)
