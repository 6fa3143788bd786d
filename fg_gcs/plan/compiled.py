"""The compiled parts of the planner: built once after installation, loaded from their cache ever after."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from fg_gcs.core.formation import Pose, hemisphere
from fg_gcs.core.separation import Fence
from fg_gcs.plan.flight_plan import Task, compile_flight
from fg_gcs.plan.formulations import FormulationName
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.paths import LinePath
from fg_gcs.plan.rigid_search import search
from fg_gcs.plan.targets import Target
from fg_gcs.plan.trajectory import timed

USUAL: Final[tuple[FormulationName, ...]] = ("rigid",)
ROOMS = ("core", "plan", "track")  # where compiled code is
INDEX, MACHINE_CODE = "*.nbi", "*.nbc"  # the two kinds of files in numba's cache


def is_built(formulations: Collection[FormulationName] = USUAL) -> bool:
    """Say whether the searches of these formulations are in the cache already; if not, the first plan takes long."""
    return all(
        any(index for folder in _caches() for index in folder.glob(f"{formulation}_search.search-*.nbi"))
        for formulation in formulations
    )


def drop_stale() -> None:
    """Delete cached code that is older than any source of the planner.

    The compiler's cache knows when a module changed, but not when a module that it imports did; code of both can be
    joined into one function, which would then go on as before.
    """
    package = Path(__file__).parent.parent
    sources = [source for room in ROOMS for source in (package / room).glob("*.py")]
    newest = max(source.stat().st_mtime for source in sources)
    for folder in _caches():
        for pattern in (INDEX, MACHINE_CODE):
            for cached in folder.glob(pattern):
                with suppress(FileNotFoundError):  # another process does the same at the same time
                    if cached.stat().st_mtime < newest:
                        cached.unlink()


def build(formulations: Collection[FormulationName] = USUAL) -> None:
    """Plan a small flight by each formulation, so that this process's next plan is as quick as the one after it."""
    fence = Fence((-99.0, -99.0, -99.0), (99.0, 99.0, 99.0))
    task = Task(
        formation=hemisphere(3, 1, 6.0),
        start=Pose(np.zeros(3), np.eye(3)),
        target=Target.ball((-9.0, 4.0, 3.0)),
        hold_depth_m=0.1,
        rules=Rules(Limits(5.0, 3.0), 1.0, fence),
    )
    pads = np.array([(0.0, 0.0, -9.0), (4.0, 0.0, -9.0), (0.0, 4.0, -9.0), (4.0, 4.0, -9.0)])
    for formulation in formulations:
        compile_flight(replace(task, formulation=formulation), pads, lambda: 0.0)
    timed(LinePath(pads, pads + 9.0), task.rules.limits, start_speed=1.0, end_speed=1.0)  # as plans made in flight are


def _caches() -> list[Path]:
    """Folders of the compiler's cache: beside the sources, or in the user's own where those cannot be written."""
    found = search.stats.cache_path
    if found is None:
        return []
    here = Path(found)
    if here.name != "__pycache__":
        return [here]
    return [folder for room in ROOMS for folder in here.parent.parent.glob(f"{room}/__pycache__")]
