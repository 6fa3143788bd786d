from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.experiment import drawings
from fg_gcs.experiment.moving_targets import (
    CIRCLE,
    DRAWN,
    LOST,
    MANY,
    OUTLIERS,
    SEPARATION_M,
    Requirement,
    courses,
    durations_ms,
    many,
    nine,
    replan_table,
    run,
    simulate_all,
    tracking_table,
)
from fg_gcs.run.kinematic import KinematicSimulation

SECONDS = 20.0  # the circle is caught by then


@pytest.fixture(scope="module")
def simulated() -> dict[str, list[KinematicSimulation]]:
    looks = itertools.count()
    return simulate_all(lambda: float(next(looks)), lambda _line: None, 2, SECONDS)


def test_requirements_know_which_way_is_good_and_what_is_missing() -> None:
    most, least = Requirement("error", 0.5), Requirement("share", 0.95, at_least=True)
    assert (most.text, least.text, Requirement("told", None).text) == ("<= 0.5", ">= 0.95", "")
    assert most.met(0.5)
    assert not most.met(0.51)
    assert least.met(0.95)
    assert not least.met(0.94)
    assert not most.met(None)
    assert Requirement("told", None).met(None)
    assert most.worst([0.1, 0.4]) == 0.4
    assert least.worst([0.1, 0.4]) == 0.1
    assert most.worst([0.1, None]) is None
    assert most.worst([]) is None


def test_every_course_has_its_rows_and_its_own_seeds(simulated: dict[str, list[KinematicSimulation]]) -> None:
    assert list(simulated) == [course.name for course in courses()]
    table = tracking_table(simulated)
    told = [(row[0], row[1]) for row in table.rows]
    assert len(set(told)) == len(told)
    for course in courses():
        assert (course.name, "caught after [s]") in told
        assert {(course.name, requirement.figure) for requirement, _ in course.required} <= set(told)
        one, other = simulated[course.name]
        assert not np.array_equal(one.position_m, other.position_m)


def test_the_table_holds_the_simulations_figures(simulated: dict[str, list[KinematicSimulation]]) -> None:
    rows = {(row[0], row[1]): row[2:] for row in tracking_table(simulated).rows}
    figures = [each.figures() for each in simulated[CIRCLE]]
    rms = [float(str(each.error_rms_m)) for each in figures]
    required, middle, worst, met = rows[CIRCLE, "error, rms [m]"]
    assert required == "<= 0.5"
    assert middle == pytest.approx(sum(rms) / 2.0)
    assert worst == max(rms)
    assert met == ("yes" if max(rms) <= 0.5 else "median" if sum(rms) <= 1.0 else "no")
    assert rows["all", "closest pair [m]"][0] == f">= {SEPARATION_M}"
    # It was not lost before the end, so it was not found either, and that is no success
    assert rows[LOST, "found again after [s]"] == ("<= 3", None, None, "no")
    ratio = float(str(rows[OUTLIERS, "error over that without"][2]))
    rough = [float(str(each.figures().error_rms_m)) for each in simulated[OUTLIERS]]
    assert ratio == pytest.approx(max(one / other for one, other in zip(rough, rms, strict=True)))


def test_replanning_times_stand_beside_what_is_required() -> None:
    table = replan_table({9: [1.0, 2.0, 30.0], MANY: [3.0]})
    assert [(row[0], row[3], row[4]) for row in table.rows] == [
        (9.0, 2.0, "yes"),
        (9.0, pytest.approx(29.44), "no"),
        (float(MANY), 3.0, "yes"),
        (float(MANY), 3.0, ""),
    ]


def test_durations_leave_out_the_first_of_each_simulation(simulated: dict[str, list[KinematicSimulation]]) -> None:
    runs = simulated[CIRCLE]
    found = durations_ms(runs)
    assert len(found) == sum(len(each.replans) - 1 for each in runs)
    assert set(found) == {1000.0}


def test_both_swarms_keep_the_separation_and_follow() -> None:
    for swarm, vehicles in ((nine(), 9), (many(), MANY)):
        assert len(swarm.slots_m) == vehicles
        assert swarm.formation.smallest_separation_m > SEPARATION_M
        figures = run(courses()[0], swarm, 0, SECONDS, lambda: 0.0).figures()
        assert figures.caught_s is not None
        assert figures.broken == ()


def test_the_same_simulations_give_the_same_pictures(
    simulated: dict[str, list[KinematicSimulation]], tmp_path: Path
) -> None:
    drawn = {name: simulated[name][0] for name in DRAWN}
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        drawings.save(drawings.draw_tracks(drawn), tmp_path / folder, "tracks")
        drawings.save(drawings.draw_errors(drawn), tmp_path / folder, "errors")
    for name in ("tracks.png", "tracks.svg", "errors.png", "errors.svg"):
        first = (tmp_path / "one" / name).read_bytes()
        assert first == (tmp_path / "two" / name).read_bytes()
        assert len(first) < 300_000
