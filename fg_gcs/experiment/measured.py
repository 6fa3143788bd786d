"""Nine simulated vehicles under measured dynamics beside nine real ones, mission by mission."""

from __future__ import annotations

import csv
import math
import re
import tempfile
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from statistics import median
from typing import Final, NamedTuple

from fg_gcs.experiment.baseline import Progress
from fg_gcs.experiment.tables import Cell, Column, ResultTable
from fg_gcs.mission import Mission, parse_mission
from fg_gcs.run.flying import FlyOptions, fly_blocking

MISSIONS: Final = Path("missions")
SEEDS: Final = (0, 1, 2)
NOT_SLOWED_M: Final = 0.001
RECORDED: Final = {  # what `sitl.toml` says now, and what it said when nine real vehicles flew it
    "edge_m = 16.0 ": "edge_m = 12.0 ",
    "centre_enu_m = [0.0, 0.0, 20.0]": "centre_enu_m = [0.0, 0.0, 18.0]",
    "separation_m = 1.0\n": "separation_m = 2.0\n",
    "spacing_m = 6.0": "spacing_m = 4.0",
}
CLOSE_M: Final = 0.01  # a separation that hardly anything falls below: flights go on to their end

TEXT = (
    "Errors of nine vehicles against their setpoints: recorded with unmodified ArduCopter 4.7-dev and PX4 1.17-alpha "
    "(SIH), and simulated with `--dynamics measured`. Recorded flights that were *stopped* were so because two "
    "vehicles came closer than the mission allows, some by positions of different ages; their errors are those up to "
    "the landing. Here nothing is stopped and nobody is hurt by another (a minimum separation of a centimetre, "
    "`collisions = false`), so that what is compared is how vehicles follow; the table has the median of "
    f"{len(SEEDS)} seeds. The last columns are of the mission as it is shipped: how many seeds are stopped, and the "
    "errors up to the landing."
)
COLUMNS = (
    Column("autopilot"),
    Column("mission"),
    Column("recorded flight"),
    Column("error rms, recorded [m]"),
    Column("simulated [m]"),
    Column("ratio"),
    Column("worst, recorded [m]"),
    Column("simulated [m] "),
    Column("ratio "),
    Column("centre rms, recorded [m]"),
    Column("simulated [m]  "),
    Column("stopped"),
    Column("shipped: rms [m]"),
    Column("worst [m]"),
)


class RealFlight(NamedTuple):
    """What was recorded of one flight of nine real vehicles."""

    autopilot: str
    mission: str
    ended: str
    rms_m: float
    worst_m: float
    centre_rms_m: float | None


class Errors(NamedTuple):
    """How far simulated vehicles were off."""

    rms_m: float
    worst_m: float
    centre_rms_m: float | None
    completed: bool


def real_flights() -> tuple[RealFlight, ...]:
    """Return what was recorded."""
    text = resources.files("fg_gcs.experiment").joinpath("real_flights.csv").read_text(encoding="utf-8")
    return tuple(
        RealFlight(
            row["autopilot"],
            row["mission"],
            row["ended"],
            float(row["rms_m"]),
            float(row["worst_m"]),
            float(row["centre_rms_m"]) if row["centre_rms_m"] else None,
        )
        for row in csv.DictReader(text.splitlines())
    )


def measured(progress: Progress, seeds: Sequence[int] = SEEDS, only: str | None = None) -> ResultTable:
    """Fly every recorded mission with simulated vehicles; return their errors beside the recorded ones.

    Args:
        progress: hears of each flight.
        seeds: of the simulator.
        only: the autopilot whose flights are flown; None: both.
    """
    rows = []
    for real in real_flights():
        if only not in (None, real.autopilot):
            continue
        progress(f"measured: {real.autopilot} flies {real.mission}")
        flown = [errors(real, seed, stopped=False) for seed in seeds]
        shipped = [errors(real, seed, stopped=True) for seed in seeds]
        rows.append(_row(real, flown, shipped))
    return ResultTable("measured", "Measured dynamics", TEXT, COLUMNS, tuple(rows))


def errors(real: RealFlight, seed: int, *, stopped: bool) -> Errors:
    """Fly a recorded mission with simulated vehicles in virtual time.

    Args:
        real: which.
        seed: of the simulator.
        stopped: whether vehicles that come too close end it, as in the mission.
    """
    mission = _mission(real.mission, seed, stopped=stopped)
    with tempfile.TemporaryDirectory(prefix="fg-gcs-measured-") as logs:
        options = FlyOptions(autopilot=real.autopilot, dynamics="measured", logs=Path(logs), write_report=False)
        summary = fly_blocking(mission, options, speed=math.inf).summary
    numbers = [summary[key] for key in ("tracking_rms_m", "tracking_max_m", "centre_error_rms_m")]
    rms_m, worst_m, centre_m = (value if isinstance(value, float) else None for value in numbers)
    assert rms_m is not None, "it has flown"
    assert worst_m is not None, "likewise"
    return Errors(rms_m, worst_m, centre_m, summary["completed"] is True)


def as_recorded(text: str) -> str:
    """Return a mission's text with formation and speed of the recorded flights.

    Those were not slowed for vehicles that stop hearing us, their faces were not rolled, nothing made up for lag, and
    nobody asked how far vehicles wander.
    """
    for now, then in RECORDED.items():
        text = text.replace(now, then)
    text = f"{text}\n[stream]\ncompensation = false\n"
    text = re.sub(r"(?m)^roll_deg = .*\n", "", text)
    return re.sub(r"(?m)^separation_m = [0-9.]+", rf"\g<0>\nwander_m = 0.0\nfault_separation_m = {NOT_SLOWED_M}", text)


def _mission(name: str, seed: int, *, stopped: bool) -> Mission:
    path = MISSIONS / f"{name}.toml"
    text = path.read_text(encoding="utf-8")
    if not stopped:
        text = re.sub(r"(?m)^separation_m = [0-9.]+", f"separation_m = {CLOSE_M}", text)
    collisions = "true" if stopped else "false"
    return parse_mission(f"{as_recorded(text)}\n[simulator]\nseed = {seed}\ncollisions = {collisions}\n", path)


def _row(real: RealFlight, flown: Sequence[Errors], shipped: Sequence[Errors]) -> tuple[Cell, ...]:
    rms_m, worst_m = median(each.rms_m for each in flown), median(each.worst_m for each in flown)
    centres_m = [each.centre_rms_m for each in flown if each.centre_rms_m is not None]
    centre_m = median(centres_m) if centres_m and real.centre_rms_m is not None else None
    return (
        real.autopilot,
        real.mission,
        real.ended,
        real.rms_m,
        rms_m,
        rms_m / real.rms_m,
        real.worst_m,
        worst_m,
        worst_m / real.worst_m,
        real.centre_rms_m,
        centre_m,
        f"{sum(not each.completed for each in shipped)} of {len(shipped)}",
        median(each.rms_m for each in shipped),
        median(each.worst_m for each in shipped),
    )
