"""All experiments in a row, and the page that shows them: never typed by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from fg_gcs.experiment.baseline import Progress, Stopwatch
from fg_gcs.experiment.flights import flights_table, fly_all
from fg_gcs.experiment.formulations import formulations
from fg_gcs.experiment.measured import measured
from fg_gcs.experiment.moving_targets import (
    DRAWN,
    SEEDS,
    replan_durations_ms,
    replan_table,
    simulate_all,
    tracking_table,
)
from fg_gcs.experiment.multi import multi
from fg_gcs.experiment.scenes import TARGETS, scene
from fg_gcs.experiment.sensitivity import sensitivity
from fg_gcs.experiment.table1 import table1
from fg_gcs.experiment.tables import ResultTable
from fg_gcs.experiment.times import times

HEADING = """\
# Results

The experiments of the paper ([Hartley2021], see [references.md](references.md)) beside its published numbers, and
moving targets beside what is required of them. *Paper's way here* is the paper's method with general tools (SciPy's
`trust-constr` with a central-difference gradient, timing of each axis by toppra), written from its text and run
beside ours. `fg-gcs experiment all` writes this page; do not edit it. Times belong to the machine and the run that
wrote it and are rounded to two digits; everything else is the same in every run with the same versions of the
libraries. `fg-gcs bench plan` measures ratios of speed more carefully.
"""


class Picture(NamedTuple):
    """One picture of the page."""

    name: str  # of its files, without ending
    text: str


class ExperimentResult(NamedTuple):
    """What one experiment gives."""

    tables: tuple[ResultTable, ...]
    pictures: tuple[Picture, ...] = ()


def run_figures(stopwatch: Stopwatch, progress: Progress, out: Path) -> ExperimentResult:
    """Plan the paper's flights and draw its figures into ``out/figures``.

    Raises:
        PlanError: a method does not reach a target.
    """
    from fg_gcs.experiment import drawings  # matplotlib takes half a second to load, and tables do not need it

    folder = out / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    flights = fly_all(stopwatch, progress)
    progress("figures: drawing")
    drawings.save(drawings.compare_paths([scene(target_m) for target_m in TARGETS[:2]]), folder, "paths")
    pictures = [Picture("paths", "Paths of the leaders by flux guiding and by least squares.")]
    for flight, name in zip(flights, ("front_40", "behind_20", "front_10", "behind_10"), strict=True):
        if name in ("front_40", "behind_20"):
            drawings.save(drawings.draw_curves(flight), folder, f"curves_{name}")
            text = "Speed and acceleration of nine vehicles on the flight"
            pictures.append(Picture(f"curves_{name}", f"{text} to ({flight.scene.name})."))
        else:
            drawings.save(drawings.draw_flight(flight), folder, f"flight_{name}")
            pictures.append(Picture(f"flight_{name}", f"The hemisphere on its flight to ({flight.scene.name})."))
    return ExperimentResult((flights_table(flights),), tuple(pictures))


def run_moving(stopwatch: Stopwatch, progress: Progress, out: Path, seeds: int = SEEDS) -> ExperimentResult:
    """Simulate tracking with several seeds, and draw the first one's tracks and errors into ``out/figures``."""
    from fg_gcs.experiment import drawings  # matplotlib takes half a second to load, and tables do not need it

    folder = out / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    simulated = simulate_all(stopwatch, progress, seeds)
    tables = (tracking_table(simulated), replan_table(replan_durations_ms(simulated, stopwatch, progress)))
    drawn = {name: simulated[name][0] for name in DRAWN}
    drawings.save(drawings.draw_tracks(drawn), folder, "moving_tracks")
    drawings.save(drawings.draw_errors(drawn), folder, "moving_errors")
    return ExperimentResult(
        tables,
        (
            Picture("moving_tracks", "Targets and the formation's centre from above, with the first seed."),
            Picture("moving_errors", "Distance of the formation's centre from the true target over the same time."),
        ),
    )


def experiments(stopwatch: Stopwatch, progress: Progress, out: Path) -> dict[str, Callable[[], ExperimentResult]]:
    """Return every experiment by its name, in the order of the page; each runs when called."""
    return {
        "table1": lambda: ExperimentResult((table1(progress),)),
        "times": lambda: ExperimentResult((times(stopwatch, progress),)),
        "figures": lambda: run_figures(stopwatch, progress, out),
        "multi": lambda: ExperimentResult((multi(stopwatch, progress),)),
        "moving": lambda: run_moving(stopwatch, progress, out),
        "measured": lambda: ExperimentResult((measured(progress),)),
        "formulations": lambda: ExperimentResult((formulations(stopwatch, progress),)),
        "sensitivity": lambda: ExperimentResult(sensitivity(stopwatch, progress)),
    }


def write_tables(tables: Sequence[ResultTable], out: Path) -> tuple[Path, ...]:
    """Write every table as CSV into ``out/results`` and return the paths."""
    folder = out / "results"
    folder.mkdir(parents=True, exist_ok=True)
    paths = tuple(folder / f"{table.name}.csv" for table in tables)
    for path, table in zip(paths, tables, strict=True):
        path.write_text(table.csv(), encoding="utf-8")
    return paths


def write_page(results: Sequence[ExperimentResult], out: Path) -> Path:
    """Write ``out/results.md`` from what the experiments gave and return its path."""
    parts = [HEADING]
    for result in results:
        parts += [
            f"## {table.title}\n\n{table.text}\n\n{table.markdown()}\n{_source(table)}" for table in result.tables
        ]
        parts += [
            f"![{picture.text}](figures/{picture.name}.png)\n\n{picture.text} [SVG](figures/{picture.name}.svg)\n"
            for picture in result.pictures
        ]
    path = out / "results.md"
    path.write_text("\n".join(parts), encoding="utf-8")
    return path


def _source(table: ResultTable) -> str:
    return f"[CSV](results/{table.name}.csv)\n"
