"""Our timing against toppra, an independent solver of the same problem."""

from __future__ import annotations

import numpy as np
import pytest
import toppra
from toppra import algorithm, constraint

from fg_gcs.errors import PlanError
from fg_gcs.plan.flux_guided import plan_path
from fg_gcs.plan.limits import Limits
from fg_gcs.plan.path.rigid_path import PosePath
from fg_gcs.plan.path.swarm_path import LinePath
from fg_gcs.plan.timing.profile import Profile
from fg_gcs.plan.timing.time_optimal import fine_grid, strictest, time_optimal
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


@pytest.mark.parametrize("limits", [Limits(10.0, 5.0), Limits(99.0, 1.0), Limits(9.0, 99.0, climb_m_s=2.0)])
def test_every_cell_keeps_every_limit_at_its_start_and_end(limits: Limits) -> None:
    for target in ((-20.0, 20.0, 20.0), (10.0, 10.0, 10.0), (-40.0, 2.5, 2.5)):
        path = PosePath(PAPER.slots_m, plan_path(PAPER, START, np.array(target)).poses)
        timing = time_optimal(path, limits)
        squares = timing.speed**2
        growths = np.diff(squares) / (2.0 * np.diff(timing.s_m))  # (S - 1,)
        _, first, second = path.at(timing.s_m)
        assert np.linalg.norm(first * timing.speed[:, None, None], axis=2).max() <= limits.speed_m_s * (1.0 + 1e-9)
        assert (first[:, :, 2] * timing.speed[:, None]).max() <= limits.climb_m_s * (1.0 + 1e-9)
        for cells in (slice(None, -1), slice(1, None)):  # a cell's start, a cell's end
            acceleration = first[cells] * growths[:, None, None] + second[cells] * squares[cells, None, None]
            assert np.linalg.norm(acceleration, axis=2).max() <= limits.acceleration_m_s2 * (1.0 + 1e-6)


def test_start_and_end_speeds_are_kept() -> None:
    line = LinePath(np.zeros((1, 3)), np.array([[30.0, 0.0, 0.0]]))
    timing = time_optimal(line, Limits(10.0, 5.0), start_speed=4.0, end_speed=6.0)
    assert timing.speed[[0, -1]] == pytest.approx([4.0, 6.0])
    assert timing.time_s[-1] < time_optimal(line, Limits(10.0, 5.0)).time_s[-1]


def test_a_stretch_left_out_at_either_end_is_not_timed() -> None:
    line = LinePath(np.zeros((1, 3)), np.array([[30.0, 0.0, 0.0]]))
    timing = time_optimal(line, Limits(10.0, 5.0), 4.0, 6.0, leads_m=(1.0, 2.0))
    assert timing.s_m[[0, -1]] == pytest.approx([1.0, 28.0])
    assert timing.speed[[0, -1]] == pytest.approx([4.0, 6.0])


def test_the_grid_holds_the_knots_and_the_middles_of_its_cells() -> None:
    path = PosePath(PAPER.slots_m, plan_path(PAPER, START, np.array([-10.0, 10.0, 10.0])).poses)
    for leads_m in ((0.0, 0.0), (0.7, 1.3)):
        fine = fine_grid(path, leads_m)
        grid = fine[::2]
        assert (np.diff(fine) > 0.0).all()
        assert fine[[0, -1]] == pytest.approx([leads_m[0], path.length_m - leads_m[1]])
        assert fine[1::2] == pytest.approx((grid[1:] + grid[:-1]) / 2.0)
        inside = path.knots_m[(path.knots_m > leads_m[0]) & (path.knots_m < path.length_m - leads_m[1])]
        assert np.isin(inside, grid).all()


@pytest.mark.parametrize(
    ("limits", "name"),
    [
        (Limits(2.0, 99.0), "speed_m_s 2"),
        (Limits(99.0, 0.1), "acceleration_m_s2 0.1"),
        (Limits(99.0, 99.0, climb_m_s=0.5), "climb_m_s 0.5"),
        (Limits(99.0, 99.0, descent_m_s=0.2), "descent_m_s 0.2"),
    ],
)
def test_the_strictest_bound_is_just_kept_at_its_speed_and_names_whose_it_is(limits: Limits, name: str) -> None:
    path = PosePath(PAPER.slots_m, plan_path(PAPER, START, np.array([-20.0, 20.0, 20.0])).poses)
    bound = strictest(path, np.linspace(0.0, path.length_m, 400), limits)
    point = path.at(np.array([bound.s_m]))
    reached = {
        "speed_m_s": np.linalg.norm(point.first[0], axis=1) * bound.speed,
        "acceleration_m_s2": np.linalg.norm(point.second[0], axis=1) * bound.speed**2,
        "climb_m_s": point.first[0, :, 2] * bound.speed,
        "descent_m_s": -point.first[0, :, 2] * bound.speed,
    }[bound.name]
    assert reached.max() == pytest.approx(bound.limit)
    assert reached.argmax() == bound.vehicle
    assert str(bound).startswith(f"vehicle {bound.vehicle + 1} may pass at")
    assert str(bound).endswith(f"({name})")


def test_a_start_too_fast_for_a_bend_names_the_bend_and_whose_it_is() -> None:
    path = PosePath(PAPER.slots_m, plan_path(PAPER, START, np.array([-20.0, 20.0, 20.0])).poses)
    with pytest.raises(PlanError, match=r"vehicle \d may pass at .* start at (\S+) m/s or slower") as refused:
        time_optimal(path, Limits(10.0, 5.0), start_speed=9.0)
    allowed = float(str(refused.value).split("start at ")[1].split()[0])
    assert time_optimal(path, Limits(10.0, 5.0), start_speed=allowed - 0.005).speed[0] == pytest.approx(allowed - 0.005)
    with pytest.raises(PlanError):
        time_optimal(path, Limits(10.0, 5.0), start_speed=allowed + 0.005)


def test_the_instants_of_a_profile_run_from_its_start_to_its_very_end_and_none_is_twice() -> None:
    for way_m in np.linspace(0.3, 60.0, 40):
        line = LinePath(np.zeros((1, 3)), np.array([[way_m, 0.0, 0.0]]))
        for window_s, stretch in ((0.0, 1.0), (0.05, 1.3)):
            profile = Profile(time_optimal(line, Limits(10.0, 5.0)), window_s, stretch)
            instants = profile.instants(200.0)
            assert instants[0] == 0.0
            assert instants[-1] == profile.duration_s
            assert (np.diff(instants) > 0.0).all()
            assert np.diff(instants).max() <= stretch / 200.0 * (1.0 + 1e-9)
