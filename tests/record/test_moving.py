"""Figures of the tracking against cases whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fg_gcs.core.formation import Formation, Pose, hemisphere
from fg_gcs.record.evaluate.figures import Flown, Whereabouts
from fg_gcs.record.evaluate.tracking import (
    KEYS,
    Followed,
    commanded_steps,
    coverage_after_facing,
    fitted,
    found_again,
    held_places,
    latency_s,
    reaction_s,
    tracking_figures,
    true_centre,
)
from fg_gcs.record.write.layouts import REPLANS, SETPOINTS, SIGHTINGS, TICKS, TRUTH, Columns
from fg_gcs.track.sightings import Verdict
from tests.record.flights import Row, main, told

LOPSIDED = Formation(np.array([(0, -3, -2), (0, 5, -1), (0, 4, 3), (0, -2, 6)], dtype=float), np.empty((0, 3)))
TAKEN, GATED = (verdict.name.lower() for verdict in (Verdict.TAKEN, Verdict.GATED))
DEPTH_M = 0.7
LEADERS = main(1, 2, 3, 4)


def the_followed(caught_s: float | None = 4.0, weights: tuple[float, ...] = (1.0,)) -> Followed:
    return Followed(1.0, 20.0, caught_s, weights, hemisphere(4, 0, 6.0).leaders_m, DEPTH_M, 1.5, 1.0)


@pytest.mark.parametrize("formation", [hemisphere(4, 5, 6.0), hemisphere(3, 0, 9.0), LOPSIDED])
@pytest.mark.parametrize("seed", range(5))
def test_the_place_of_a_held_target_is_found_from_the_leaders_alone(formation: Formation, seed: int) -> None:
    random = np.random.default_rng(seed)
    poses = [Pose(20.0 * random.normal(size=3), r.as_matrix(), 1.0 + random.random()) for r in Rotation.random(9, seed)]
    rims = np.stack([formation.place(pose)[: len(formation.leaders_m)] for pose in poses])
    wanted = np.stack([pose.centre_enu_m - DEPTH_M * pose.rotation[:, 0] for pose in poses])
    assert held_places(rims, formation.leaders_m, DEPTH_M) == pytest.approx(wanted, abs=1e-9)
    fit = fitted(rims, formation.leaders_m)
    assert fit.centre_enu_m == pytest.approx(np.stack([pose.centre_enu_m for pose in poses]), abs=1e-9)
    assert fit.attitude == pytest.approx(np.stack([pose.rotation for pose in poses]), abs=1e-9)
    assert fit.scale == pytest.approx(np.array([pose.scale for pose in poses]))


def test_noise_of_the_leaders_spoils_the_place_by_no_more_than_itself() -> None:
    random = np.random.default_rng(1)
    leaders = hemisphere(4, 0, 6.0).leaders_m
    rims = leaders + 0.1 * random.normal(size=(2000, 4, 3))
    error = held_places(rims, leaders, DEPTH_M) - np.array([-DEPTH_M, 0.0, 0.0])
    assert np.sqrt((error**2).mean(axis=0)).max() < 0.1


def test_the_true_centre_goes_by_the_weights_and_knows_nothing_where_one_is_unknown() -> None:
    truth: list[Row] = []
    for k in range(4):
        truth.append((0.1 * k, "a", 1.0 * k, 0.0, 5.0))
        truth.append((0.1 * k, "b", 1.0 * k, 4.0 if k else np.nan, 5.0))
    centre = true_centre(TRUTH.table(truth), (1.0, 3.0))
    assert centre is not None
    assert centre.time_s == pytest.approx([0.1, 0.2, 0.3])
    assert centre.position_m == pytest.approx(np.array([(1.0, 3.0, 5.0), (2.0, 3.0, 5.0), (3.0, 3.0, 5.0)]))
    assert centre.at(np.array([0.0, 0.15, 9.0]))[:, 0] == pytest.approx([1.0, 1.5, 3.0])
    assert true_centre(TRUTH.table([]), (1.0,)) is None


def test_a_loss_ends_with_the_first_sighting_and_is_mended_when_the_error_is_small() -> None:
    sightings: list[Row] = []
    for received_s, code in ((1.0, TAKEN), (1.9, TAKEN), (5.0, GATED), (5.5, TAKEN), (6.0, TAKEN), (8.0, TAKEN)):
        sightings.append((received_s, received_s, "lead", 0.0, 0.0, 0.0, code))
    time_s = np.arange(0.0, 10.0, 0.5)
    error = np.where((time_s >= 5.0) & (time_s < 7.0), 3.0, 1.0)
    assert found_again(time_s, error, SIGHTINGS.table(sightings), the_followed()) == [
        pytest.approx(2.0),
        pytest.approx(0.0),
    ]
    assert found_again(time_s, error + 5.0, SIGHTINGS.table(sightings), the_followed()) == [None, None]


def test_the_reaction_is_that_of_the_first_setpoint_after_a_trajectory_that_was_taken() -> None:
    replans: list[Row] = []
    for sighted_s, planned_s, taken in (
        (1.0, 1.005, 1),
        (2.0, 2.001, 0),
        (np.nan, 2.5, 1),
        (3.0, 3.02, 1),
        (9.0, 9.1, 1),
    ):
        replans.append((planned_s, sighted_s, planned_s, "follow", taken, *[0.0] * 9))
    setpoints = SETPOINTS.table(told(1, now_s) for now_s in (1.0, 1.02, 1.04, 3.02, 3.04))
    assert reaction_s(REPLANS.table(replans), setpoints) == pytest.approx([0.02, 0.04])


@pytest.mark.parametrize("delay_s", [0.0, 0.1, 2.0])
def test_the_latency_is_the_reaction_and_the_sensors_delay(delay_s: float) -> None:
    replans: list[Row] = []
    sightings: list[Row] = []
    arrivals = (1.0, 1.5, 3.0, 4.0)
    for sighted_s in arrivals:
        replans.append((sighted_s + 0.005, sighted_s, sighted_s + 0.01, "follow", True, *[0.0] * 9))
        sightings.append(
            (sighted_s - 0.001, sighted_s - 0.001, "lead", 0.0, 0.0, 0.0, GATED)
        )  # refused: leads to nothing
        sightings.append((sighted_s - delay_s, sighted_s, "lead", 0.0, 0.0, 0.0, TAKEN))
    rounds_s = np.arange(0.985, 3.5, 0.02).tolist()  # none is left after the last trajectory
    columns = REPLANS.table(replans), SETPOINTS.table(told(1, now_s) for now_s in rounds_s)
    reaction, latency = reaction_s(*columns), latency_s(*columns, SIGHTINGS.table(sightings))
    assert len(latency) == len(reaction) == 3
    assert latency == pytest.approx(reaction + delay_s)
    assert not len(latency_s(*columns, SIGHTINGS.table([])))


@pytest.mark.parametrize(("jump_m", "jump_m_s"), [(0.0, 0.0), (0.3, 0.0), (0.0, 0.5)])
def test_steps_are_what_velocities_and_the_limit_do_not_explain(jump_m: float, jump_m_s: float) -> None:
    rows: list[Row] = []
    for k in range(100):
        now_s = 0.02 * k
        speed = 1.0 + 4.0 * now_s + (jump_m_s if k >= 50 else 0.0)
        place = now_s + 2.0 * now_s**2 + (jump_m if k >= 50 else 0.0) + jump_m_s * max(now_s - 0.99, 0.0)
        rows.append(told(1, now_s, place, 0.0, 9.0, speed))
        rows.append(told(2, now_s, 50.0, 0.0, 9.0))
    setpoints = SETPOINTS.table(rows)
    position, velocity = commanded_steps(setpoints, (0.0, 9.0), 4.0)
    assert position == pytest.approx(jump_m, abs=1e-9)
    assert velocity == pytest.approx(jump_m_s, abs=1e-9)
    assert commanded_steps(setpoints, (1.2, 9.0), 4.0) == pytest.approx((0.0, 0.0), abs=1e-9)


def followed(offset_m: float) -> tuple[Flown, dict[str, Columns]]:
    """A formation that flies along a target's way, always a distance beside it, and all tables of that."""
    time_s = np.arange(0.0, 21.0, 0.02)
    way = np.stack((3.0 * time_s, np.zeros_like(time_s), np.full_like(time_s, 10.0)), axis=1)
    leaders = hemisphere(4, 0, 6.0).leaders_m
    rims = (way + np.array([DEPTH_M, offset_m, 0.0]))[:, None] + leaders
    truth: list[Row] = []
    setpoints: list[Row] = []
    for k, now_s in enumerate(time_s.tolist()):
        truth.append((now_s, "lead", *way[k].tolist()))
        for vehicle in range(4):
            setpoints.append(told(vehicle + 1, now_s, *rims[k, vehicle].tolist(), 3.0))
    ones, nothing = np.ones_like(time_s), (np.zeros(0),) * 4
    flag = (np.zeros(0, dtype=bool),) * 4
    metric = np.where(time_s < 12.0, 1.0, 0.5)
    series = Flown(LEADERS, time_s, rims, ones, metric, ones, nothing, nothing, nothing, flag, nothing)
    tables: dict[str, Columns] = {layout.name: layout.table([]) for layout in (REPLANS, SIGHTINGS, TICKS)}
    return series, {**tables, "truth": TRUTH.table(truth), "setpoints": SETPOINTS.table(setpoints)}


@pytest.mark.parametrize("offset_m", [0.0, 0.4])
def test_a_formation_beside_its_target_is_off_by_as_much(offset_m: float) -> None:
    series, tables = followed(offset_m)
    found = tracking_figures(series, LEADERS, the_followed(), tables)
    for key in ("centre_error_rms_m", "centre_error_p95_m", "centre_error_commanded_rms_m"):
        assert found[key] == pytest.approx(offset_m, abs=1e-9), key
    assert found["capture_time_s"] == pytest.approx(3.0)
    assert found["flux_metric_share"] == pytest.approx((12.0 - 4.0) / (20.0 - 4.0), abs=0.01)


def test_what_was_never_caught_or_never_known_has_no_figures() -> None:
    series, tables = followed(0.0)
    for what, given in ((the_followed(caught_s=None), tables), (the_followed(), {**tables, "truth": TRUTH.table([])})):
        found = tracking_figures(series, LEADERS, what, given)
        assert set(found) == {*KEYS, "found_again_s", "replans"}
        assert found["centre_error_rms_m"] is None
    assert tracking_figures(None, LEADERS, the_followed(), tables)["flux_metric_share"] is None


def test_a_leader_that_was_never_heard_leaves_the_figures_of_the_formation_open() -> None:
    series, tables = followed(0.4)
    for leaders in (main(1, 2, 3, 9), ()):
        found = tracking_figures(series, leaders, the_followed(), tables)
        assert found["capture_time_s"] == pytest.approx(3.0)
        for key in ("centre_error_rms_m", "centre_error_p95_m", "centre_error_commanded_rms_m", "flux_metric_share"):
            assert found[key] is None, key
    told = tables["setpoints"]
    served = told["system_id"] != 2  # heard, but never sent anything
    found = tracking_figures(
        series,
        LEADERS,
        the_followed(),
        {**tables, "setpoints": {name: column[served] for name, column in told.items()}},
    )
    assert found["centre_error_rms_m"] == pytest.approx(0.4)
    assert found["centre_error_commanded_rms_m"] is None


def test_coverage_counts_from_when_the_face_first_looks_at_the_target() -> None:
    series, _ = followed(0.0)
    covered = np.interp(series.time_s, [0.0, 5.0, 10.0, 15.0], [0.2, 1.0, 0.8, 0.1])
    turned = Flown(**{**vars(series), "coverage": covered})
    assert coverage_after_facing(turned, (0.0, 10.0)) == pytest.approx(0.8, abs=1e-3)
    assert coverage_after_facing(turned, (0.0, 3.0)) is None


def test_what_stands_is_always_where_it_is() -> None:
    assert (
        Whereabouts.standing(np.array([1.0, 2.0, 3.0])).at(np.array([-5.0, 0.0, 7.0])).tolist() == [[1.0, 2.0, 3.0]] * 3
    )
