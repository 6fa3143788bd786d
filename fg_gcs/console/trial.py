"""The command ``trial``: seeded random flights with seeded random faults, judged by the simulator's truth."""

from __future__ import annotations

import argparse
import json
import shlex
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.markup import escape

from fg_gcs.console.codes import ExitCode
from fg_gcs.mission import load_mission
from fg_gcs.run.flying import prepare
from fg_gcs.run.trial import judge
from fg_gcs.run.trials import trial_of

TOLD_S = 5.0  # between two lines of progress where there is no terminal to draw on


class Wish(NamedTuple):
    """What all trials of a run have in common."""

    missions: tuple[Path, ...]
    autopilots: tuple[str, ...]
    dynamics: tuple[str, ...]
    faults: int | None = None  # how many in each flight; None: one or two


class Outcome(NamedTuple):
    """What came of one seed."""

    seed: int
    text: str
    completed: bool
    reason: str
    broken: tuple[str, ...]
    events: tuple[str, ...]
    closest_m: float
    closest_unhearing_m: float


def run(chosen: argparse.Namespace) -> ExitCode:
    """Fly the chosen trials; one line a seed that broke a law.

    Raises:
        MissionError: a mission is missing or wrong.
    """
    autopilots, dynamics = chosen.autopilot or ("px4", "ardupilot"), chosen.dynamics or ("paper",)
    wish = Wish(tuple(chosen.missions), tuple(autopilots), tuple(dynamics), chosen.faults)
    alone = chosen.single is not None
    for path in wish.missions:
        prepare(load_mission(path))
    seeds = [chosen.single] if alone else list(range(chosen.seed, chosen.seed + chosen.count))
    console = Console(stderr=True, highlight=False)
    began_s = told_s = time.monotonic()
    outcomes: list[Outcome] = []
    with console.status("flying") as status:
        for outcome in _outcomes(wish, seeds, chosen.jobs):
            outcomes.append(outcome)
            if outcome.broken or alone:
                _tell(console, outcome, wish, whole=alone)
            took_s = time.monotonic() - began_s
            left_s = took_s / len(outcomes) * (len(seeds) - len(outcomes))
            broken = sum(bool(one.broken) for one in outcomes)
            text = f"{len(outcomes)} of {len(seeds)} trials, {broken} broke a law, {left_s:.0f} s left"
            status.update(text)
            if not console.is_terminal and time.monotonic() - told_s > TOLD_S:
                told_s = time.monotonic()
                console.print(text)
    return _close(console, outcomes, as_json=chosen.json)


def _close(console: Console, outcomes: Sequence[Outcome], *, as_json: bool) -> ExitCode:
    broken = sorted(one.seed for one in outcomes if one.broken)
    completed = sum(one.completed for one in outcomes)
    console.print(f"{len(outcomes)} trials: {completed} completed, {len(outcomes) - completed} brought down, ", end="")
    console.print("no law broken" if not broken else f"{len(broken)} broke a law")
    if as_json:
        least = min((one.closest_m for one in outcomes), default=float("inf"))
        figures = {"trials": len(outcomes), "completed": completed, "broken": broken, "closest_m": least}
        print(json.dumps(figures), flush=True)
    return ExitCode.NOT_IN_ORDER if broken else ExitCode.DONE


def _tell(console: Console, outcome: Outcome, wish: Wish, *, whole: bool) -> None:
    """Say which laws a seed broke, and how to fly it again."""
    console.print(escape(f"seed {outcome.seed}: {outcome.text}"))
    for line in outcome.broken:
        console.print(escape(f"  {line}"), style="red")
    if whole:
        for line in outcome.events:
            console.print(escape(f"  {line}"), style="dim")
        end = "completed" if outcome.completed else outcome.reason
        console.print(escape(f"  {end}; closest pair {outcome.closest_m:.2f} m"))
    else:
        names = [str(path) for path in wish.missions]
        more = [f"--autopilot={each}" for each in wish.autopilots] + [f"--dynamics={each}" for each in wish.dynamics]
        more += [] if wish.faults is None else [f"--faults={wish.faults}"]
        again = shlex.join(["fg-gcs", "trial", *names, *more, "--only", str(outcome.seed)])
        console.print(escape(f"  again: {again}"), style="dim", soft_wrap=True)


def _outcomes(wish: Wish, seeds: Sequence[int], jobs: int) -> Iterator[Outcome]:
    """Yield what comes of each seed, as it comes."""
    if jobs == 1 or len(seeds) == 1:
        yield from (outcome_of(wish, seed) for seed in seeds)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        waiting = [pool.submit(outcome_of, wish, seed) for seed in seeds]
        for done in as_completed(waiting):
            yield done.result()


def outcome_of(wish: Wish, seed: int) -> Outcome:
    """Fly one seed."""
    missions = [load_mission(path) for path in wish.missions]
    trial = trial_of(seed, missions, wish.autopilots, wish.dynamics, wish.faults)
    found = judge(trial)
    result = found.result
    return Outcome(
        seed,
        trial.text,
        result is not None and result.completed,
        "" if result is None else result.reason,
        tuple(found.broken),
        tuple(found.events),
        found.closest_m,
        found.closest_unhearing_m,
    )
