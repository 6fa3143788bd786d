"""The compiled parts of the planner: built once after installation, loaded from their cache ever after."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fg_gcs.core.formation import Pose, hemisphere
from fg_gcs.core.separation import Fence
from fg_gcs.plan.flight_plan import Task, compile_flight
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.rigid_search import search

INDEX, MACHINE_CODE = "*.nbi", "*.nbc"  # the two kinds of files in numba's cache


def is_built() -> bool:
    """Say whether the compiled planner is in its cache already; if not, the first plan takes half a minute."""
    return any(index for folder in _caches() for index in folder.glob("rigid_search.search-*.nbi"))


def drop_stale() -> None:
    """Delete cached code that is older than any source of the planner.

    The compiler's cache knows when a module changed, but not when a module that it imports did; code of both can be
    joined into one function, which would then go on as before.
    """
    package = Path(__file__).parent.parent
    sources = [*(package / "core").glob("*.py"), *(package / "plan").glob("*.py")]
    newest = max(source.stat().st_mtime for source in sources)
    for folder in _caches():
        for pattern in (INDEX, MACHINE_CODE):
            for cached in folder.glob(pattern):
                if cached.stat().st_mtime < newest:
                    cached.unlink(missing_ok=True)


def build() -> None:
    """Plan a small flight, so that the next plan of this process is as quick as the one after it."""
    fence = Fence((-99.0, -99.0, -99.0), (99.0, 99.0, 99.0))
    task = Task(
        formation=hemisphere(3, 1, 6.0),
        start=Pose(np.zeros(3), np.eye(3)),
        target_enu_m=np.array([-9.0, 4.0, 3.0]),
        hold_depth_m=0.1,
        rules=Rules(Limits(5.0, 3.0), 1.0, fence),
    )
    pads = np.array([(0.0, 0.0, -9.0), (4.0, 0.0, -9.0), (0.0, 4.0, -9.0), (4.0, 4.0, -9.0)])
    compile_flight(task, pads, lambda: 0.0)


def _caches() -> list[Path]:
    """Folders of the compiler's cache: beside the sources, or in the user's own where those cannot be written."""
    found = search.stats.cache_path
    if found is None:
        return []
    here = Path(found)
    return [here, *here.parent.parent.glob("core/__pycache__")] if here.name == "__pycache__" else [here]
