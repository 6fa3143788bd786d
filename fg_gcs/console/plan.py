"""The commands that do not fly: ``plan``, ``check`` and ``report``."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Collection, Sequence
from pathlib import Path

from fg_gcs.errors import FgError, MissionError, PlanError
from fg_gcs.mission import Mission, load_mission
from fg_gcs.plan.flight_plan import FlightPlan, compile_flight, plan_figures
from fg_gcs.plan.formulations import FormulationName
from fg_gcs.record.write.recorder import plain


def plan(paths: Sequence[Path], *, as_json: bool, plot: Path | None) -> int:
    """Plan missions without flying; people read a few lines, programs one JSON line a mission.

    Raises:
        FgError: a file is at fault, or has no plan; the missions before it were told already.
    """
    if plot is not None and len(paths) > 1:
        raise MissionError("--plot draws one mission; name only one file")
    missions = [load_mission(path) for path in paths]
    load_planner({mission.plan.formulation for mission in missions})
    for path, mission in zip(paths, missions, strict=True):
        try:
            made = compile_flight(mission.task(), mission.tops_enu_m(), time.perf_counter)
        except PlanError as error:
            raise PlanError(f"{path}: {error}") from error
        keys = plan_keys(str(path), mission.swarm.ids(), made)
        print(_words(str(path), mission, made), file=sys.stderr)
        if as_json:
            print(json.dumps(plain(keys)), flush=True)
        if plot is not None:
            from fg_gcs.record.report.plot import plot_plan

            plot_plan(made, mission.task(), plot)
            print(f"drawn: {plot}", file=sys.stderr)
    return 0


def check(paths: Sequence[Path]) -> int:
    """Say of each file whether it is a valid mission that has a plan; return 2 if one is not."""
    bad = 0
    for path in paths:
        try:
            mission = load_mission(path)
            load_planner({mission.plan.formulation})
            compile_flight(mission.task(), mission.tops_enu_m(), time.perf_counter)
        except FgError as error:
            text = str(error)
            print(text if text.startswith(str(path)) else f"{path}: {text}", file=sys.stderr)
            bad += 1
        else:
            print(f"{path}: good", file=sys.stderr)
    return 2 if bad else 0


def report(folder: Path) -> int:
    """Write a recorded run's report again.

    Raises:
        RunError: the folder does not hold a recorded run.
        MissionError: the report cannot be written.
    """
    from fg_gcs.record.report.report import write_report

    try:
        written = write_report(folder)
    except OSError as error:
        raise MissionError(f"{folder}: the report cannot be written: {error.strerror or error}") from error
    for remark in written.remarks:
        print(f"fg-gcs: {folder}: {remark}", file=sys.stderr)
    print(f"report: {written.path}", file=sys.stderr)
    return 0


def load_planner(formulations: Collection[FormulationName]) -> None:
    """Load the compiled planner for these formulations, and say so when it has to be compiled first."""
    from fg_gcs.plan.compiled import build, is_built

    if not is_built(formulations):
        print("compiling the planner, once after installation (about half a minute) ...", file=sys.stderr)
    build(formulations)


def plan_keys(name: str, system_ids: Sequence[int], made: FlightPlan) -> dict[str, object]:
    """Return a plan's figures by the names of the command line's JSON; peaks and separation are the whole flight's."""
    return {"mission": name, **plan_figures(system_ids, made)}


def _words(name: str, mission: Mission, made: FlightPlan) -> str:
    figures, ids = made.figures, mission.swarm.ids()
    first, second = (ids[row] for row in made.separation.pair)
    sized = "" if figures.last_scale == 1.0 else f", formation at {figures.last_scale:.2f} times its size at the end"
    return "\n".join(
        (
            f"{name}: {len(made.slot_of)} vehicles, {len(made.rim_of)} of them leaders",
            f"  path        {figures.path_length_m:.1f} m over all leaders "
            f"(straight {figures.straight_length_m:.1f} m), {figures.iterates} steps{sized}",
            f"  flux        metric {figures.flux_metric:.3f} at the end; "
            f"coverage {figures.coverage_mean:.3f} on average, "
            f"{figures.coverage_min_after_facing:.3f} at least once it faces the target",
            f"  duration    {made.approach.duration_s:.2f} s; "
            f"at most {made.peaks.speed_m_s:.2f} m/s and {made.peaks.acceleration_m_s2:.2f} m/s^2",
            f"  separation  {made.separation.distance_m:.2f} m at least (vehicles {first} and {second}), "
            "on the whole flight",
            f"  planned in  {1e3 * (made.plan_time_s + made.timing_time_s):.1f} ms",
        )
    )
