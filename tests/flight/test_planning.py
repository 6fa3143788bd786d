"""Planning takes time, and setpoints leave on time all the same: steps of work on a loop whose clock they move."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.core.formation import Pose
from fg_gcs.flight.planning import LATE_S, Durations, Planning
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.track.follow.fail_safe import FailSafeTrajectory
from fg_gcs.track.follow.replanner import FollowMode, Replan
from tests.flight.harness import Flight, Script, fly

FOUND = Replan(FailSafeTrajectory.resting(Pose(np.zeros(3), np.eye(3)), 0.0), FollowMode.FOLLOW, taken=True)
STEP_S = 0.003
HOLD_S = 2.0  # of the small mission


class BusyLoop(VirtualTimeLoop):
    """Virtual time in which work takes some."""

    def work(self, seconds: float) -> None:
        self._now_s += seconds


def working(count: int, step_s: float = STEP_S) -> Iterator[Replan | None]:
    """So many steps that lead to nothing, and one that does."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, BusyLoop)
    for _ in range(count):
        loop.work(step_s)
        yield None
    loop.work(step_s)
    yield FOUND


def planning(flight: Flight) -> Planning:
    streamer = flight.director.streamer
    assert streamer is not None
    return Planning(streamer)


def latest_s(folder: Path, script: Script) -> float:
    """Fly with a script that works during the hold; return by how much its latest setpoints were late [s]."""
    flight = fly(folder, "px4", script, loop=BusyLoop)
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    ticks = flight.recorded.ticks
    begin_s, end_s = flight.result.stages["hold"]
    return float(ticks["late_s"][(ticks["time_s"] >= begin_s) & (ticks["time_s"] <= end_s)].max())


@pytest.mark.parametrize("steps", [0, 1, 5, 12])
def test_steps_of_planning_delay_no_setpoint(steps: int, tmp_path: Path) -> None:
    plans = []

    async def plan_again_and_again(flight: Flight) -> None:
        await flight.reaches("hold")
        own, time = planning(flight), asyncio.get_running_loop().time
        begin_s = time()
        while time() < begin_s + 0.5 * HOLD_S:
            await own.gap()
            plans.append(await own.result(working(steps), lambda: False))
            await asyncio.sleep(0.007)  # so that plans begin at any time between two setpoints
        assert own.late == 0

    assert latest_s(tmp_path, plan_again_and_again) < 1e-9
    assert len(plans) > 10
    assert all(plan is FOUND for plan in plans)


def test_the_same_work_at_once_does_delay_them(tmp_path: Path) -> None:
    async def work_at_once(flight: Flight) -> None:
        await flight.reaches("hold")
        for _ in working(12):
            pass

    assert latest_s(tmp_path, work_at_once) > 0.01


def test_a_plan_that_takes_too_long_is_given_up(tmp_path: Path) -> None:
    async def plan_slowly(flight: Flight) -> None:
        await flight.reaches("hold")
        own, time = planning(flight), asyncio.get_running_loop().time
        for number in (1, 2):
            await own.gap()
            begun_s = time()
            assert await own.result(working(1000), lambda: False) is None
            assert LATE_S < time() - begun_s < LATE_S + 0.02 + STEP_S  # a gap and a step more
            assert own.late == number

    assert latest_s(tmp_path, plan_slowly) < 1e-9


def test_a_plan_that_nobody_wants_any_more_ends_at_once(tmp_path: Path) -> None:
    async def change_the_mind(flight: Flight) -> None:
        await flight.reaches("hold")
        own, asked = planning(flight), iter([False, False, True])
        assert await own.result(working(1000), lambda: next(asked)) is None
        assert next(asked, None) is None
        assert own.late == 0
        assert await own.result(iter(()), lambda: False) is None

    latest_s(tmp_path, change_the_mind)


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 16, 17, 1000])
def test_durations_are_all_kept_up_to_a_bound_and_evenly_thinned_beyond(count: int) -> None:
    durations = Durations(most=8)
    for duration_s in range(count):
        durations.add(float(duration_s))
    kept = durations.kept_s
    assert durations.count == count
    assert len(kept) <= 8
    if count <= 8:
        assert kept == tuple(map(float, range(count)))
    else:
        assert len(kept) > 4
        (stride,) = set(np.diff(kept))
        assert kept[0] == 0.0
        assert count - kept[-1] <= stride
