"""Our timing against toppra, an independent solver of the same problem."""

from __future__ import annotations

import numpy as np
import pytest
import toppra
from toppra import algorithm, constraint

from fg_gcs.plan.flux_guided import plan_path
from fg_gcs.plan.limits import Limits
from fg_gcs.plan.paths import LinePath
from fg_gcs.plan.rigid_path import PosePath
from fg_gcs.plan.timing import time_optimal
from tests.plan.scenes import PAPER, START


@pytest.mark.parametrize("target", [(40.0, 40.0, 40.0), (-20.0, 20.0, 20.0), (30.0, 2.5, 2.5)])
def test_one_vehicle_in_one_dimension_takes_as_long_as_with_toppra(target: tuple[float, float, float]) -> None:
    """On a straight line the norm limits are toppra's own joint limits, so both solve the same problem."""
    distance_m = float(np.linalg.norm(np.array(target)))
    ours = time_optimal(LinePath(np.zeros((1, 3)), np.array([[distance_m, 0.0, 0.0]])), Limits(10.0, 5.0))
    path = toppra.SplineInterpolator([0.0, 0.5, 1.0], np.array([[0.0], [0.5], [1.0]]) * distance_m)
    limits = [
        constraint.JointVelocityConstraint(np.array([[-10.0, 10.0]])),
        constraint.JointAccelerationConstraint(np.array([[-5.0, 5.0]])),
    ]
    theirs = algorithm.TOPPRA(limits, path, gridpoints=np.linspace(0, 1, 401)).compute_trajectory(0, 0)
    assert ours.time_s[-1] == pytest.approx(theirs.duration, rel=0.01)


def test_boxes_that_enclose_the_discs_are_never_slower_and_those_inside_never_faster() -> None:
    """Per-axis limits around the norm limits are looser, those of 1/sqrt(3) are tighter: ours lies between."""
    path = PosePath(PAPER.slots_m, plan_path(PAPER, START, np.array([-20.0, 20.0, 20.0])).poses)
    ours = time_optimal(path, Limits(10.0, 5.0)).time_s[-1]
    s = np.linspace(0.0, path.length_m, 300)
    spline = toppra.SplineInterpolator(s, path.at(s).position_m.reshape(len(s), -1))
    durations = []
    for share in (1.0, 1.0 / np.sqrt(3.0)):
        boxes = np.tile([-share, share], (27, 1))
        limits = [constraint.JointVelocityConstraint(10.0 * boxes), constraint.JointAccelerationConstraint(5.0 * boxes)]
        grid = np.linspace(0.0, path.length_m, 301)
        durations.append(algorithm.TOPPRA(limits, spline, gridpoints=grid).compute_trajectory(0, 0).duration)
    assert durations[0] * 0.99 <= ours <= durations[1] * 1.01


def test_a_finer_grid_gains_next_to_nothing() -> None:
    path = PosePath(PAPER.slots_m, plan_path(PAPER, START, np.array([-10.0, 10.0, 10.0])).poses)

    class Finer:
        """The same path with more knots, so with more cells."""

        knots_m = np.linspace(0.0, path.length_m, 3000)
        length_m, vehicles, at, outline, closest = path.length_m, path.vehicles, path.at, path, path.closest

    coarse, fine = (time_optimal(p, Limits(10.0, 5.0)).time_s[-1] for p in (path, Finer()))
    assert fine == pytest.approx(coarse, rel=0.01)


def test_start_and_end_speeds_are_kept() -> None:
    line = LinePath(np.zeros((1, 3)), np.array([[30.0, 0.0, 0.0]]))
    timing = time_optimal(line, Limits(10.0, 5.0), start_speed=4.0, end_speed=6.0)
    assert timing.speed[[0, -1]] == pytest.approx([4.0, 6.0])
    assert timing.time_s[-1] < time_optimal(line, Limits(10.0, 5.0)).time_s[-1]
