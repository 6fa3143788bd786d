"""The commands that do not fly: ``plan``, ``check`` and ``report``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from fg_gcs.console.codes import ExitCode
from fg_gcs.errors import FgError, MissionError
from fg_gcs.mission import Mission, load_mission
from fg_gcs.plan.compiled import is_built
from fg_gcs.record.write.recorder import plain
from fg_gcs.run import planning, reporting
from fg_gcs.run.planning import PlannedMission
from fg_gcs.run.simulators import check_simulator, wish_of


def plan(chosen: argparse.Namespace) -> ExitCode:
    """Plan missions without flying; people read a few lines, programs one JSON line a mission.

    Args:
        chosen: as `plan_options` has it.

    Raises:
        FgError: a file is at fault, or has no plan; the missions before it were told already.
    """
    plot: Path | None = chosen.plot
    if plot is not None and len(chosen.missions) > 1:
        raise MissionError("--plot draws one mission; name only one file")
    missions = [load_mission(path) for path in chosen.missions]
    tell_if_not_built(missions)
    for mission in missions:
        made = planning.plan(mission, chosen.wander, chosen.lag)
        print(_words(made), file=sys.stderr)
        if chosen.json:
            print(json.dumps(plain(dict(made.figures))), flush=True)
        if plot is not None:
            made.draw(plot)
            print(f"drawn: {plot}", file=sys.stderr)
    return ExitCode.DONE


def check(paths: Sequence[Path]) -> ExitCode:
    """Say of each file whether it is a valid mission that has a plan."""
    bad = False
    for path in paths:
        try:
            mission = load_mission(path)
            tell_if_not_built([mission])
            planned = planning.plan(mission)
            check_simulator(mission, wish_of(mission))
        except FgError as error:
            print(error, file=sys.stderr)
            bad = True
        else:
            print("\n  ".join((f"{path}: good", *planned.in_fault)), file=sys.stderr)
    return ExitCode.BAD_INPUT if bad else ExitCode.DONE


def report(folder: Path) -> ExitCode:
    """Write a recorded run's report again.

    Raises:
        RunError: the folder does not hold a recorded run.
        MissionError: the report cannot be written.
    """
    written = reporting.report(folder)
    for remark in written.remarks:
        print(f"fg-gcs: {folder}: {remark}", file=sys.stderr)
    print(f"report: {written.path}", file=sys.stderr)
    return ExitCode.DONE


def tell_if_not_built(missions: Sequence[Mission]) -> None:
    """Say so when the planner has to be compiled first."""
    if not is_built({mission.plan.formulation for mission in missions}):
        print("compiling the planner, once after installation (about half a minute) ...", file=sys.stderr)


def _words(planned: PlannedMission) -> str:
    name, made = str(planned.mission.path), planned.flight
    figures, pair = made.figures, planned.figures["min_separation_pair"]
    assert isinstance(pair, list)
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
            f"  separation  {made.separation.distance_m:.2f} m at least (vehicles {pair[0]} and {pair[1]}), "
            "on the whole flight",
            *_wander_words(planned),
            *(f"  in faults   {line}" for line in planned.in_fault),
            f"  planned in  {1e3 * (made.plan_time_s + made.timing_time_s):.1f} ms",
        )
    )


def _wander_words(planned: PlannedMission) -> list[str]:
    figures, risk = planned.figures, planned.flight.risk
    if risk is None:
        return []
    least = figures["smallest_edge_m"]
    smallest = "" if least is None else f"; the smallest edge that is safe is {least:.1f} m"
    return [
        f"  wander      {figures['wander_m']:.2f} m: in {risk.percent:.2g} % of flights two come "
        f"below {planned.task.rules.separation_m:.2f} m with an edge of {figures['edge_m']:.1f} m{smallest}"
    ]
