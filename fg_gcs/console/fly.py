"""The command ``fly``: simulator, flight, progress, record and closing summary."""

from __future__ import annotations

import asyncio
import gc
import json
import math
import signal
import sys
import time
from contextlib import AsyncExitStack, ExitStack, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from rich.console import Console

from fg_gcs.console.closing import closing
from fg_gcs.console.nonblocking import unhurried
from fg_gcs.console.plan import load_planner, plan_keys
from fg_gcs.console.progress import Progress
from fg_gcs.errors import FgError, LinkError, MissionError
from fg_gcs.flight.director import Director, FlightResult, Setup
from fg_gcs.flight.target_follower import warm_up
from fg_gcs.link.clock import make_loop
from fg_gcs.link.endpoint import parse_endpoint
from fg_gcs.mission import Mission, load_mission
from fg_gcs.record.evaluate.evaluation import flown_figures
from fg_gcs.record.read.run import RunError
from fg_gcs.record.report.report import write_report
from fg_gcs.record.write.recorder import REPORT, Recorder, make_folder, plain
from fg_gcs.run.simulators import (
    free_port,
    simulator_in_loop,
    simulator_process,
    targets_in_loop,
    targets_process,
)

VIRTUAL_PORT, VIRTUAL_TARGETS_PORT = 14550, 14560  # in virtual time nobody else is there
VIRTUAL_EPOCH_S = 1_700_000_000.0  # in virtual time there is no now; a fixed one keeps a run's files the same


@dataclass(frozen=True)
class Options:
    """What was asked for."""

    endpoints: tuple[str, ...] = ()  # empty: our own simulator
    wait_s: float = 30.0
    speed: float = 1.0  # infinite: virtual time
    autopilot: str | None = None  # of the simulator; None: as the mission says
    logs: Path = Path("logs")
    json: bool = False


def fly(path: Path, options: Options) -> int:
    """Fly a mission file and return the exit code.

    Raises:
        MissionError: the file or the options are at fault.
        LinkError: nobody answered.
        PlanError: the mission has no plan.
    """
    mission = load_mission(path)
    text = path.read_text()
    virtual = math.isinf(options.speed)
    if virtual and options.endpoints:
        raise MissionError("--speed max: only the built-in simulator lives in virtual time; leave --connect out")
    for endpoint in options.endpoints:
        try:
            parse_endpoint(endpoint)
        except LinkError as error:
            raise MissionError(f"--connect: {error}") from error
    try:
        folder = make_folder(options.logs, path.stem, datetime.now())
    except OSError as error:
        raise MissionError(f"--logs {options.logs}: {error.strerror or error}") from error
    load_planner({mission.plan.formulation})
    if mission.targets is not None:
        warm_up(mission)
    gc.collect()
    gc.freeze()  # what is loaded by now stays: a full collection in flight would take tens of milliseconds
    with asyncio.Runner(loop_factory=lambda: make_loop(options.speed)) as runner:
        try:
            result, summary = runner.run(_fly(path, text, mission, options, folder))
        except BaseException:
            with suppress(Exception):  # what is worth telling is why the flight ended
                write_report(folder)
            raise
    if options.json:
        print(json.dumps(summary))
    return 0 if result.completed else 1


async def _fly(
    path: Path, text: str, mission: Mission, options: Options, folder: Path
) -> tuple[FlightResult, dict[str, object]]:
    loop = asyncio.get_running_loop()
    virtual = math.isinf(options.speed)
    simulated = not options.endpoints
    autopilot = options.autopilot or mission.simulator.autopilot
    with ExitStack() as stack:
        epoch_s = VIRTUAL_EPOCH_S if virtual else time.time()
        recorder = stack.enter_context(_recorder(folder, text, mission, loop.time(), epoch_s, in_thread=not virtual))
        recorder.know(mission=str(path))
        console = Console(stderr=True, highlight=False)
        if not virtual:
            console = Console(file=stack.enter_context(unhurried(sys.stderr)), highlight=False)
        progress = stack.enter_context(Progress(mission, console, live=not virtual and console.is_terminal))
        recorder.listeners.append(progress.event)
        endpoints = options.endpoints
        if simulated:
            port = VIRTUAL_PORT if virtual else free_port()
            endpoints = (f"udpin:127.0.0.1:{port}",)
            recorder.event(
                loop.time(), "simulator", f"starting {mission.swarm.vehicles} simulated {autopilot} vehicles"
            )
            if not virtual:
                log = folder / "simulator.log"
                stack.enter_context(simulator_process(mission, autopilot, port, options.speed, log))
        targets_port = VIRTUAL_TARGETS_PORT if virtual else free_port()
        if not virtual:
            stack.enter_context(targets_process(mission, targets_port, options.speed, folder / "targets.log"))
        targets_endpoint = f"udpin:127.0.0.1:{targets_port}"
        setup = Setup(endpoints, options.wait_s, simulated, time.perf_counter, targets_endpoint)
        director = Director(mission, setup, recorder)
        async with AsyncExitStack() as in_loop:
            if simulated and virtual:
                await in_loop.enter_async_context(simulator_in_loop(mission, autopilot, port))
                await in_loop.enter_async_context(targets_in_loop(mission, targets_port))
            show = asyncio.create_task(progress.show(director))
            _on_signals(director)
            loop.set_exception_handler(lambda _, context: director.fail(context))
            try:
                result = await director.fly()
            except FgError as error:
                recorder.event(loop.time(), "error", str(error))
                raise
            finally:
                show.cancel()
                await asyncio.gather(show, return_exceptions=True)
        summary = recorder.finish(_summary(path, mission, result, recorder))
        try:
            write_report(folder)
        except (OSError, RunError) as error:  # the disk is full, or the folder is gone
            recorder.event(loop.time(), "warning", f"the report cannot be written: {error}")
    closing(Console(stderr=True, highlight=False), summary, mission)
    return result, summary


def _recorder(
    folder: Path, text: str, mission: Mission, start_s: float, epoch_s: float, *, in_thread: bool
) -> Recorder:
    try:
        return Recorder(folder, text, start_s, epoch_s, mission.files(), in_thread=in_thread)
    except OSError as error:
        raise MissionError(f"--logs {folder.parent}: {error.strerror or error}") from error


def _on_signals(director: Director) -> None:
    """Turn every way to be asked to stop into one: fly home and land; asked again: land on the spot."""
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, director.interrupt, f"stopped by {number.name}")


def _summary(path: Path, mission: Mission, result: FlightResult, recorder: Recorder) -> dict[str, object]:
    """The run's figures by the names of the command line's JSON."""
    summary: dict[str, object] = {"mission": str(path)}
    if result.plan is not None:
        summary |= plan_keys(str(path), result.system_ids, result.plan)
    leaders = [] if result.plan is None else [result.system_ids[row] for row in result.plan.rim_of]
    limits = None if result.task is None else result.task.rules.limits
    counters = result.counters
    summary |= {"completed": result.completed, "reason": result.reason, "vehicles_landed": result.vehicles_landed}
    target_enu_m = mission.first_target().centre_enu_m.tolist()
    recorder.know(target_enu_m=target_enu_m, stages=result.stages)
    recorder.settle()
    summary |= flown_figures(recorder.folder)
    summary |= _tracking_keys(result, recorder)
    summary |= {
        "late_ticks": result.late_ticks,
        "lost_vehicles": list(result.lost),
        "bad_bytes": counters.bad_bytes if counters else 0,
        "unknown_messages": counters.unknown_messages if counters else 0,
        "frames_in": counters.frames_in if counters else 0,
        "frames_out": counters.frames_out if counters else 0,
        "limits": None if limits is None else vars(limits),
        "separation_m": mission.limits.separation_m,
        "target_enu_m": target_enu_m,
        "leader_ids": leaders,
        "stages": {name: list(span) for name, span in result.stages.items()},
        "log": str(recorder.folder),
        "report": str(recorder.folder / REPORT),
    }
    plained = plain(summary)
    assert isinstance(plained, dict)
    return plained


def _tracking_keys(result: FlightResult, recorder: Recorder) -> dict[str, object]:
    """What is known of the tracking without its tables; of a target at rest it is 0 or none."""
    keys: dict[str, object] = {"replans": 0, "replans_late": 0, "replan_median_ms": None, "replan_p99_ms": None}
    keys |= {"capture_time_s": None, "sightings": 0, "sightings_rejected": {}}
    tracking = result.tracking
    if tracking is None:
        return keys
    if tracking.planning_s:
        took_ms = [1e3 * took for took in tracking.planning_s]
        keys |= {"replan_median_ms": np.median(took_ms), "replan_p99_ms": np.percentile(took_ms, 99)}
    if tracking.caught_s is not None:
        began_s, caught_s = (recorder.since_start_s(time_s) for time_s in (tracking.began_s, tracking.caught_s))
        keys["capture_time_s"] = caught_s - began_s
    rejected = {verdict.name.lower(): count for verdict, count in tracking.refused.items()}
    return keys | {
        "replans": len(tracking.planning_s),
        "replans_late": tracking.late,
        "sightings": tracking.sightings,
        "sightings_rejected": rejected,
    }
