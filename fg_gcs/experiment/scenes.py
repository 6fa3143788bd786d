"""What the experiments plan: the paper's start and targets, its printed rows, and fresh draws from the same ranges."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Formation, Pose, facing, hemisphere
from fg_gcs.plan.limits import Limits

LIMITS = Limits(speed_m_s=10.0, acceleration_m_s2=5.0)  # the paper's
EDGE_M = 5.0  # the paper's square
LEADERS, FOLLOWERS = 4, 5  # the paper's hemisphere
TARGETS = (  # of all the paper's flights to one target, the first two as its lengths show them
    (50.0, 50.0, 50.0),
    (-50.0, 50.0, 50.0),
    (40.0, 40.0, 40.0),
    (-20.0, 20.0, 20.0),
    (10.0, 10.0, 10.0),
    (-10.0, 10.0, 10.0),
)
SEPARATIONS_M = (5.0, 20.0)  # ranges of the paper's sensitivity study
RADII_M = (2.5, 10.0)
REACH_M = 100.0
CROWD, CROWD_MEAN_M, CROWD_DEVIATION_M = 10, 200.0, 100.0  # the paper's several targets: N(200, 100) in every axis
MARGIN_M = 10.0  # of the face around several targets


@dataclass(frozen=True)
class Scene:
    """A square in the plane x = 0, one corner in the origin, facing +x; and what it shall surround."""

    name: str
    target_enu_m: Array  # (3,) [m]
    edge_m: float = EDGE_M  # of the square at the start [m]
    last_edge_m: float = EDGE_M  # of the square around the target [m]

    @cached_property
    def formation(self) -> Formation:
        """The hemisphere behind the square, at the size of the start."""
        return hemisphere(LEADERS, FOLLOWERS, self.edge_m)

    @cached_property
    def start(self) -> Pose:
        """Where the formation starts."""
        return Pose(np.array([0.0, self.edge_m / 2.0, self.edge_m / 2.0]), facing(np.array([1.0, 0.0, 0.0])))

    @cached_property
    def leaders_enu_m(self) -> Array:
        """Where the leaders start, shape (4, 3) [m]."""
        return self.formation.place(self.start)[:LEADERS]

    @property
    def last_scale(self) -> float:
        """Size at the end as a share of that at the start."""
        return self.last_edge_m / self.edge_m


class PrintedRow(NamedTuple):
    """One of the 50 rows that the paper prints of its sensitivity study."""

    scene: Scene
    flux_metric: float
    solve_time_s: float


def scene(target_m: tuple[float, float, float]) -> Scene:
    """Return the paper's square and one target [m; ENU]."""
    return Scene(target_name(target_m), np.array(target_m))


def target_name(target_m: tuple[float, float, float]) -> str:
    """Return a target as people write it: ``50,50,50``."""
    return ",".join(f"{value:g}" for value in target_m)


def printed_rows() -> tuple[PrintedRow, ...]:
    """Return the paper's printed rows. The square's edge goes from the separation to twice the target's radius."""
    text = resources.files("fg_gcs.experiment").joinpath("sensitivity.csv").read_text(encoding="utf-8")
    rows = []
    for number, row in enumerate(csv.DictReader(text.splitlines()), start=1):
        target = np.array([float(row[f"target_{axis}_m"]) for axis in "xyz"])
        edge_m, radius_m = float(row["uav_separation_m"]), float(row["target_radius_m"])
        printed = Scene(f"row {number}", target, edge_m, 2.0 * radius_m)
        rows.append(PrintedRow(printed, float(row["flux_metric"]), float(row["solve_time_s"])))
    return tuple(rows)


def draws(count: int, seed: int) -> tuple[Scene, ...]:
    """Return scenes from the ranges of the paper's sensitivity study; the same seed gives the same scenes."""
    random = np.random.default_rng(seed)
    targets = random.uniform(-REACH_M, REACH_M, (count, 3))
    edges_m = random.uniform(*SEPARATIONS_M, count)
    radii_m = random.uniform(*RADII_M, count)
    return tuple(
        Scene(f"draw {index + 1}", target, float(edge), float(2.0 * radius))
        for index, (target, edge, radius) in enumerate(zip(targets, edges_m, radii_m, strict=True))
    )


def crowd(seed: int) -> tuple[Scene, Array]:
    """Return several targets as one scene, and the targets themselves, shape (10, 3) [m].

    The source is their mean; the square's last edge is ``(2 d_max + 10 m) / sqrt(2)``, with the largest distance of a
    target from the mean.
    """
    targets = np.random.default_rng(seed).normal(CROWD_MEAN_M, CROWD_DEVIATION_M, (CROWD, 3))
    centre = targets.mean(axis=0)
    largest_m = float(np.linalg.norm(targets - centre, axis=1).max())
    return Scene(f"{CROWD} targets", centre, EDGE_M, (2.0 * largest_m + MARGIN_M) / np.sqrt(2.0)), targets
