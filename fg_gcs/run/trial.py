"""A trial: one flight in virtual time with faults, judged by the simulator's truth against what must always hold.

Everything about a trial follows from its `Trial`, so that the same one gives the same flight again.
"""

from __future__ import annotations

import asyncio
import errno
import os
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist, squareform

from fg_gcs.core.arrays import Array
from fg_gcs.flight.director import MOST_STOPS, Director
from fg_gcs.flight.snapshot import RunEvent
from fg_gcs.link.clock import VirtualTimeLoop, ticks
from fg_gcs.mission.model import Mission
from fg_gcs.run.flying import VIRTUAL_PORT, FlyOptions, Outcome, RunResult, fly
from fg_gcs.run.harms import Death, Deaths, Stall, Stranger, speak, stand_still
from fg_gcs.run.observing import Observer
from fg_gcs.run.simulators import Simulator, simulator_of, wish_of

TOLD: Final = frozenset({"fault", "abort", "warning", "error", "notice", "stage"})
LOOKS_S: Final = 0.05  # between two looks at the truth
AFTER_S: Final = 120.0  # when everything that hears must be down
AFTER_LOOKS_S: Final = 1.0  # between two looks whether it is
LONGEST_S: Final = 900.0  # of a flight with its end: whatever takes longer hangs
IN_THE_AIR_M: Final = 0.3  # above the ground
NOISE_M: Final = 0.01  # by which a distance may be below its minimum: what particles are off by
SLACK_M: Final = 0.05  # likewise of a pair of which one could not hear us
WATCHED: Final = frozenset({"take-off", "gather", "approach", "hold", "home", "land"})  # stages of the flight itself
FAILSAFES: Final = MappingProxyType(  # whose values are ours: landing, or hovering and returning
    {"px4": ("COM_OBL_RC_ACT", (4.0, 5.0)), "ardupilot": ("FS_GCS_ENABLE", (5.0, 1.0))}
)
UNHEARING: Final = ("taken_over", "reboot", "dead", "commands_refused")  # kinds of vehicles that need not do as told


@dataclass(frozen=True)
class Trial:
    """One flight and what goes wrong in it.

    Attributes:
        mission: what is flown.
        autopilot: which one the simulator plays.
        dynamics: how vehicles fly.
        faults: inside vehicles, tables as `[[simulator.faults]]`.
        impairments: of links, tables as `[[simulator.impairments]]`.
        stops: when people ask to stop: stage and seconds since it began.
        disk_full: when the disk is full, likewise.
        deaths: tasks of the station that die or hang.
        stalls: times in which the whole station stands still.
        strangers: who else speaks to our port.
    """

    mission: Mission
    autopilot: str = "px4"
    dynamics: str = "paper"
    faults: tuple[Mapping[str, Any], ...] = ()
    impairments: tuple[Mapping[str, Any], ...] = ()
    stops: tuple[tuple[str, float], ...] = ()
    disk_full: tuple[tuple[str, float], ...] = ()
    deaths: tuple[Death, ...] = ()
    stalls: tuple[Stall, ...] = ()
    strangers: tuple[Stranger, ...] = ()

    @property
    def text(self) -> str:
        """One line for people."""
        parts = [f"{self.mission.name}, {self.autopilot}, {self.dynamics}"]
        parts += [_words(table) for table in (*self.faults, *self.impairments)]
        for what, moments in (("stop", self.stops), ("disk full", self.disk_full)):
            parts += [f"{what} {after_s:g} s into {stage}" for stage, after_s in moments]
        ours: tuple[Death | Stall | Stranger, ...] = (*self.deaths, *self.stalls, *self.strangers)
        parts += [each.text for each in ours]
        return "; ".join(parts)

    @property
    def faultless(self) -> bool:
        """Whether nothing goes wrong."""
        ours = self.stops or self.disk_full or self.deaths or self.stalls or self.strangers
        return not (self.faults or self.impairments or ours)

    @property
    def unhearing(self) -> frozenset[int]:
        """System ids of vehicles that at some time cannot hear us, or need not do as told."""
        everybody = tuple(range(1, self.mission.swarm.vehicles + 1))
        ids = set(everybody if self.stalls else (each.system_id for each in self.strangers if each.kind == "twin"))
        for table in self.faults:
            if table["kind"] in UNHEARING:
                ids.update(table.get("vehicles", everybody))
        for table in self.impairments:
            if table.get("loss", 0.0) == 1.0 and table.get("direction", "both") != "from_vehicle":
                ids.update(table.get("vehicles", everybody))
        return frozenset(ids)


@dataclass
class Judgement:
    """What came of a trial.

    Attributes:
        broken: the laws that were broken, one line each.
        result: of the flight.
        closest_m: of any pair in the air that heard us all the time [m].
        closest_unhearing_m: of any other pair in the air [m].
        ended_s: when the flight had ended [s].
        events: what was said of faults and ways down, one line each.
    """

    broken: list[str] = field(default_factory=list)
    result: RunResult | None = None
    closest_m: float = np.inf
    closest_unhearing_m: float = np.inf
    ended_s: float = np.inf
    events: list[str] = field(default_factory=list)


def judge(trial: Trial, fault_separation_m: float | None = None) -> Judgement:
    """Fly a trial and return what came of it.

    Args:
        trial: what is flown, and what goes wrong.
        fault_separation_m: how near a vehicle that could not hear us may come to others; None: as the mission says [m].

    Raises:
        MissionError: a table of it is wrong.
    """
    with tempfile.TemporaryDirectory() as folder, asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(_judge(trial, fault_separation_m, Path(folder)))


class _Judge(Observer):
    """Looks at the truth while the flight is on."""

    def __init__(self, trial: Trial, simulator: Simulator, fault_separation_m: float | None) -> None:
        self.found = Judgement()
        self._trial, self._simulator = trial, simulator
        rules = trial.mission.task().rules
        ids = trial.mission.swarm.ids()
        deaf = np.isin(ids, sorted(trial.unhearing))
        self._deaf_pairs = deaf[:, None] | deaf[None, :]
        least_m = trial.mission.limits.fault_least_m if fault_separation_m is None else fault_separation_m
        self._least_m = np.where(self._deaf_pairs, least_m - SLACK_M, rules.separation_m - NOISE_M)
        self._worst: dict[tuple[int, int], tuple[float, float, str]] = {}
        self._failsafe: dict[int, float] = {}
        self.director: Director | None = None
        self.deaths = Deaths()
        self.struck: dict[str, float] = {}  # names of tasks, and when it must have been noticed by the loop's time [s]
        self.stood_still: list[str] = []  # stages in which that should be told
        self._ids = ids

    def started(self, director: Director) -> None:
        """Hear of the flight."""
        self.director = director
        if self._trial.deaths:
            director.around = self.deaths.around

    def event(self, event: RunEvent) -> None:
        """Keep what is told of faults."""
        if event.kind in TOLD:
            self.found.events.append(f"{event.time_s:7.2f} {event.kind}: {event.text}")

    async def watch(self) -> None:
        """Look, for ever."""
        async for _ in ticks(asyncio.get_running_loop().time(), LOOKS_S):
            self.look()

    def look(self) -> None:
        """Look once."""
        places, armed = self._simulator.positions_enu_m, self._simulator.armed
        high = places[:, 2] > IN_THE_AIR_M
        stage = "" if self.director is None else self.director.journal.stage
        now_s = self._simulator.now_s
        if high.sum() > 0:
            distances = squareform(pdist(places))
            concerned = (high[:, None] | high[None, :]) & ~np.eye(len(places), dtype=bool)
            self._pairs(distances, concerned, now_s, stage)
        self._failsafes(high & armed, now_s)

    def _pairs(self, distances: Array, concerned: NDArray[np.bool_], now_s: float, stage: str) -> None:
        heard = distances[concerned & ~self._deaf_pairs]
        deaf = distances[concerned & self._deaf_pairs]
        self.found.closest_m = min(self.found.closest_m, float(heard.min(initial=np.inf)))
        self.found.closest_unhearing_m = min(self.found.closest_unhearing_m, float(deaf.min(initial=np.inf)))
        for first, second in np.argwhere(np.triu(concerned & (distances < self._least_m))).tolist():
            pair, distance_m = (self._ids[first], self._ids[second]), float(distances[first, second])
            if distance_m < self._worst.get(pair, (np.inf, 0.0, ""))[0]:
                self._worst[pair] = distance_m, now_s, stage

    def _failsafes(self, flying: NDArray[np.bool_], now_s: float) -> None:
        name, wanted = FAILSAFES[self._trial.autopilot]
        for row in np.flatnonzero(flying).tolist():
            if self._simulator.fleet.vehicles[row].autopilot.parameters[name] not in wanted:
                self._failsafe.setdefault(self._ids[row], now_s)

    def conclude(self) -> None:
        """Say which laws were broken, after everything that hears has had time to come down."""
        found, simulator = self.found, self._simulator
        for (first, second), (distance_m, at_s, stage) in sorted(self._worst.items()):
            deaf = {first, second} & self._trial.unhearing
            law = "one of which could not hear us" if deaf else "both of which heard us"
            found.broken.append(
                f"vehicles {first} and {second}, {law}, {distance_m:.2f} m apart at {at_s:.1f} s ({stage})"
            )
        for system_id, at_s in self._failsafe.items():
            found.broken.append(f"vehicle {system_id} in the air with its own failsafe at {at_s:.1f} s")
        up, armed = simulator.positions_enu_m[:, 2] > IN_THE_AIR_M, simulator.armed
        for row in np.flatnonzero((up | armed) & ~_dead(simulator)).tolist():
            where = "in the air" if up[row] else "armed"
            found.broken.append(f"vehicle {self._ids[row]} {where} {AFTER_S:g} s after the end")
        result = found.result
        if result is not None and result.completed and simulator.fleet.incidents.found:
            found.broken.append(f"completed, though {simulator.fleet.incidents.found[0]}")
        if result is not None and result.outcome is Outcome.FAILED:
            found.broken.append(f"an error of this program: {result.error!r}")
        found.broken += self._untold()
        gate = None if result is None or result.flight is None else result.flight.gate
        if self._trial.faultless and gate is not None and gate.total:
            found.broken.append(f"{gate.total} setpoints did not pass the last gate, though nothing was wrong")

    def _untold(self) -> list[str]:
        """Return what went wrong in the station itself and was not told."""
        flight = None if self.found.result is None else self.found.result.flight
        died = () if flight is None else flight.died
        lines = [
            f"nobody noticed what became of the {name}"
            for name, noticed_s in self.struck.items()
            if name not in died and noticed_s < self.found.ended_s
        ]
        if self.stood_still and not any("this program stood still" in line for line in self.found.events):
            lines += [f"nobody noticed that the station stood still in {stage}" for stage in self.stood_still]
        return lines


async def _judge(trial: Trial, fault_separation_m: float | None, folder: Path) -> Judgement:
    wish = wish_of(trial.mission, trial.autopilot, trial.dynamics, trial.faults, trial.impairments)
    simulator = simulator_of(trial.mission, wish, VIRTUAL_PORT)
    await simulator.start()
    judge_ = _Judge(trial, simulator, fault_separation_m)
    options = FlyOptions(
        (f"udpin:127.0.0.1:{VIRTUAL_PORT}",), wait_s=10.0, logs=folder, knows_origin=True, write_report=False
    )
    beside = [
        asyncio.ensure_future(judge_.watch()),
        asyncio.ensure_future(_stop(judge_, trial.stops)),
        asyncio.ensure_future(_fill_disk(judge_, trial.disk_full)),
        asyncio.ensure_future(_tell_stages(judge_, simulator)),
        *(asyncio.ensure_future(_strike(judge_, death)) for death in trial.deaths),
        *(asyncio.ensure_future(_stand_still(judge_, simulator, stall)) for stall in trial.stalls),
        *(asyncio.ensure_future(_speak(judge_, stranger, trial.autopilot)) for stranger in trial.strangers),
    ]
    loop = asyncio.get_running_loop()
    try:
        flight = asyncio.ensure_future(fly(trial.mission, options, [judge_]))
        done, _ = await asyncio.wait((flight,), timeout=LONGEST_S)
        if done:
            judge_.found.result = flight.result()
        else:
            judge_.found.broken.append(f"no end after {LONGEST_S:g} s")
            for _ in range(MOST_STOPS):  # as a person who asks again and again
                flight.cancel()
                await asyncio.sleep(1.0)
        judge_.found.ended_s = loop.time()
        await _all_down(simulator)
        judge_.conclude()
    finally:
        for task in beside:
            task.cancel()
        await asyncio.gather(*beside, return_exceptions=True)
        with suppress(asyncio.CancelledError):
            await simulator.close()
    return judge_.found


async def _all_down(simulator: Simulator) -> None:
    """Wait until all that still works is on the ground and disarmed, at most `AFTER_S`: nothing arms by itself."""
    end_s = asyncio.get_running_loop().time() + AFTER_S
    async for _ in ticks(asyncio.get_running_loop().time(), AFTER_LOOKS_S):
        up, works = simulator.positions_enu_m[:, 2] > IN_THE_AIR_M, ~_dead(simulator)
        if not (up | (simulator.armed & works)).any() or asyncio.get_running_loop().time() >= end_s:
            return


def _dead(simulator: Simulator) -> NDArray[np.bool_]:
    return np.array([vehicle.autopilot.dead for vehicle in simulator.fleet.vehicles])


async def _stop(judge_: _Judge, stops: Sequence[tuple[str, float]]) -> None:
    """Ask to stop, as people do."""
    for stage, after_s in stops:
        director = await _in_stage(judge_, stage)
        await asyncio.sleep(after_s)
        director.interrupt("stopped")


async def _fill_disk(judge_: _Judge, moments: Sequence[tuple[str, float]]) -> None:
    """Let nothing be written down any more."""
    for stage, after_s in moments:
        director = await _in_stage(judge_, stage)
        await asyncio.sleep(after_s)
        with director.journal.recorder.guard("tables"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


async def _strike(judge_: _Judge, death: Death) -> None:
    """Let a task of the station die, or hang."""
    await _in_stage(judge_, death.stage)
    await asyncio.sleep(death.after_s)
    if judge_.deaths.strike(death):
        judge_.struck[death.task] = asyncio.get_running_loop().time() + judge_.deaths.noticed_s(death)


async def _stand_still(judge_: _Judge, simulator: Simulator, stall: Stall) -> None:
    """Let the station stand still."""
    director = await _in_stage(judge_, stall.stage)
    await asyncio.sleep(stall.after_s)
    if director.journal.stage in WATCHED:
        judge_.stood_still.append(director.journal.stage)
    stand_still(simulator, stall.lasts_s, LOOKS_S, judge_.look)


async def _speak(judge_: _Judge, stranger: Stranger, autopilot: str) -> None:
    """Let a stranger speak."""
    await _in_stage(judge_, stranger.stage)
    await asyncio.sleep(stranger.after_s)
    await speak(stranger, autopilot, VIRTUAL_PORT)


async def _in_stage(judge_: _Judge, stage: str) -> Director:
    async for _ in ticks(asyncio.get_running_loop().time(), 0.01):
        director = judge_.director
        if director is not None and director.journal.stage == stage:
            return director
    raise AssertionError("ticks never end")


async def _tell_stages(judge_: _Judge, simulator: Simulator) -> None:
    """Tell the simulator of the flight's stages, for faults that wait for one."""
    told = ""
    async for _ in ticks(asyncio.get_running_loop().time(), 0.01):
        director = judge_.director
        if director is not None and director.journal.stage != told:
            told = director.journal.stage
            simulator.begin_stage(told)


def _words(table: Mapping[str, Any]) -> str:
    return " ".join(f"{key}={value}" for key, value in table.items())
