"""Real SITL instances that are started for one flight, where its mission has its pads, and end with it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Final

from fg_gcs.errors import MissionError
from fg_gcs.link.clock import speed_of
from fg_gcs.mission.model import Mission
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.sitl.instances import Instance, SwarmOptions, check_options, numbered
from fg_gcs.sitl.layout import homes
from fg_gcs.sitl.swarm import Listener, started

FOLDER: Final = "sitl"  # in the run's folder


def instances_of(mission: Mission, options: SwarmOptions | None, spacing_m: float | None) -> list[Instance]:
    """Return the instances that a mission needs: one a vehicle, on its pads, with its ids; none without options.

    Args:
        mission: what is flown.
        options: how they are started.
        spacing_m: between neighbouring homes [m]; None: as the mission has it.

    Raises:
        MissionError: the mission or the options do not allow it.
    """
    if options is None:
        return []
    if mission.connections() or len({network for network, _ in mission.swarm.members()}) > 1:
        raise MissionError(f"{mission.path}: [networks] says where vehicles are; --swarm starts them in one network")
    if speed_of(asyncio.get_running_loop()) != 1.0:
        raise MissionError("--swarm: real instances fly in real time; leave --speed out")
    check_options(options)
    pads_m, first_m = mission.pads_enu_m(), mission.pads.first_enu_m
    if spacing_m is not None:
        pads_m = first_m + (pads_m - first_m) * (spacing_m / mission.pads.spacing_m)
    ids = mission.swarm.ids()
    numbers = [each - 1 for each in ids]
    return numbered(numbers, ids, homes(pads_m, mission.origin_geodetic()), options.autopilot)


def heard_at(options: SwarmOptions, instances: Sequence[Instance]) -> tuple[str, ...]:
    """Return the endpoints at which instances are heard, as ``--connect`` takes them."""
    return options.recipe.endpoints(options, [instance.number for instance in instances])


@asynccontextmanager
async def swarm_for(
    options: SwarmOptions | None, instances: Sequence[Instance], recorder: Recorder
) -> AsyncIterator[None]:
    """Have instances running that can all be armed; nothing without options. What becomes of them is recorded.

    Raises:
        FgError: see :func:`fg_gcs.sitl.swarm.started`.
    """
    if options is None:
        yield
        return
    heard = _Recorded(recorder)
    name = options.recipe.profile.name
    heard.said(f"starting {len(instances)} instances of {name}, {options.binary}")
    async with started(replace(options, folder=options.folder or recorder.folder / FOLDER), instances, heard) as swarm:
        took_s = max(member.ready_s for member in swarm.members)
        recorder.know(
            swarm_ready_s=round(took_s, 2),
            swarm_least_pace=None if math.isnan(swarm.slowest.pace) else round(swarm.slowest.pace, 4),
        )
        yield


class _Recorded(Listener):
    """Writes down what becomes of a swarm; that is how the terminal hears of it, too."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._time = asyncio.get_running_loop().time

    def said(self, text: str) -> None:
        """Record it."""
        self._recorder.event(self._time(), "simulator", text)

    def ended(self, text: str) -> None:
        """Record it as something that should not happen."""
        self._recorder.event(self._time(), "warning", text)
