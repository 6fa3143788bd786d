"""The compiled parts of the planner: built once after installation, loaded from their cache ever after."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from fg_gcs.compiling import cache_folder
from fg_gcs.core import mending
from fg_gcs.core.formation import Pose, hemisphere
from fg_gcs.core.separation import Fence
from fg_gcs.plan.flight_plan import Task, compile_flight
from fg_gcs.plan.formulations import FormulationName
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.lost_link import LostLink, LostLinkRule, Reaction
from fg_gcs.plan.path.swarm_path import LinePath
from fg_gcs.plan.targets import Target
from fg_gcs.plan.trajectory import timed

USUAL: Final[tuple[FormulationName, ...]] = ("rigid",)


def is_built(formulations: Collection[FormulationName] = USUAL) -> bool:
    """Say whether these formulations are in the cache already; if not, the first plan takes long."""
    return all(_mark(formulation).exists() for formulation in formulations)


def build(formulations: Collection[FormulationName] = USUAL) -> None:
    """Plan a small flight by each formulation, so that this process's next plan is as quick as the one after it."""
    mending.build()  # of the last gate, which every plan passes
    for formulation in formulations:
        _build(formulation)


@cache
def _build(formulation: FormulationName) -> None:
    """Build one of them; a second time in a process there is nothing to do."""
    fence = Fence((-99.0, -99.0, -99.0), (99.0, 99.0, 99.0))
    task = Task(
        formation=hemisphere(3, 1, 6.0),
        start=Pose(np.zeros(3), np.eye(3)),
        target=Target.ball((-9.0, 4.0, 3.0)),
        hold_depth_m=0.1,
        rules=Rules(Limits(5.0, 3.0), 1.0, fence),
        formulation=formulation,
        lost_link=LostLinkRule(0.1, "slow", (LostLink(1.0, True, False, True, 3.0, (1.0,)),), Reaction(0.6, 2.0, 0.5)),
    )
    pads = np.array([(0.0, 0.0, -9.0), (4.0, 0.0, -9.0), (0.0, 4.0, -9.0), (4.0, 4.0, -9.0)])
    made = compile_flight(task, pads, lambda: 0.0).approach
    made.yaw_rad(made.sample(np.zeros(1)).position_m[0])  # as the first setpoint needs it
    timed(LinePath(pads, pads + 9.0), task.rules.limits, start_speed=1.0, end_speed=1.0)  # as plans made in flight are
    with suppress(OSError):  # where nothing can be kept, every process compiles anew
        _mark(formulation).touch()


def _mark(formulation: FormulationName) -> Path:
    return cache_folder() / f"{formulation}.built"
