"""``bench track`` as scripts see it, and what it makes of flights."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.console.cli import main, parser
from fg_gcs.core.arrays import Array
from fg_gcs.errors import PlanError
from fg_gcs.experiment.random_missions import AUTOPILOTS, MOTIONS, random_mission
from fg_gcs.experiment.track_bench import KEYS, MISSIONS, ROUGH, Flight, Flyer, Size, commanded, fly_once, measure
from fg_gcs.mission import load_mission
from fg_gcs.record.write.recorder import plain
from tests.flight.harness import SMALL as SMALL_MISSION

FOLDER = Path(__file__).parents[2] / "missions"
SMALL = Size(flights=0, seed=0, simulated_s=1.0)
GOOD: dict[str, object] = {
    "vehicles": 9,
    "completed": True,
    "reason": "",
    "vehicles_landed": 9,
    "separation_m": 1.5,
    "flown_min_separation_m": 2.1,
    "capture_time_s": 10.0,
    "centre_error_rms_m": 0.4,
    "centre_error_p95_m": 0.8,
    "centre_error_commanded_rms_m": 0.3,
    "flux_metric_share": 1.0,
    "coverage_min_after_facing": 0.99,
    "found_again_s": [1.0, 2.5],
    "commanded_position_step_max_m": 1e-4,
    "commanded_velocity_step_max_m_s": 0.0,
}


def flown(**other: object) -> Flight:
    return Flight(GOOD | other, (), 0)


def measured(flyer: Flyer, size: Size = SMALL) -> tuple[dict[str, object], dict[tuple[str, str], list[object]]]:
    looks = itertools.count()
    figures, rows = measure(FOLDER, size, flyer, lambda: float(next(looks)), lambda _line: None)
    return figures, {(str(row[0]), str(row[1])): list(row[2:]) for row in rows}


def test_good_flights_meet_everything_but_what_takes_a_second_a_look() -> None:
    flights: list[tuple[str, str | None]] = []

    def flyer(text: str, autopilot: str | None) -> Flight:
        flights.append((text, autopilot))
        return flown()

    figures, rows = measured(flyer)
    assert [text for text, _ in flights[: len(MISSIONS)]] == [
        (FOLDER / f"{name}.toml").read_text() for name in MISSIONS
    ]
    assert {autopilot for _, autopilot in flights} == {None}
    assert {key for key, row in rows.items() if row[2] == "no"} == {
        (f"{vehicles} vehicles", figure)
        for vehicles, figure in ((9, "replan, median [ms]"), (9, "replan, 99 % [ms]"), (100, "replan, median [ms]"))
    }
    assert rows["lost_and_found", "found again after [s]"] == ["<= 3", 2.5, "yes"]
    assert rows["all", "sighting to setpoint, 99 % [ms]"] == ["<= 25", None, "only in real time"]
    assert figures["sensed_to_setpoint_p99_ms"] is None
    assert isinstance(figures["missions"], dict)
    assert list(figures["missions"]) == [*MISSIONS, ROUGH]
    assert set(KEYS) <= set(figures["missions"]["circle"])
    assert not any("random" in target for target, _ in rows)


def test_what_is_bad_or_missing_is_not_met() -> None:
    bad = Flight(
        GOOD | {"centre_error_rms_m": 0.8, "centre_error_p95_m": None, "found_again_s": [1.0, None]}, ("speed",), 2
    )
    _, rows = measured(lambda _text, _autopilot: bad)
    for key, value in (
        (("circle", "error, rms [m]"), 0.8),
        (("figure_eight", "error, rms [m]"), 0.8),
        (("evader", "error, 95 % [m]"), None),
        (("lost_and_found", "found again after [s]"), None),
        (("all", "limits broken"), 7.0),
        (("all", "pairs too close"), 14.0),
    ):
        assert rows[key][1:] == [value, "no"]


def test_the_rough_circle_is_the_circle_with_a_worse_sensor_and_counts_by_the_ratio(tmp_path: Path) -> None:
    texts: list[str] = []

    def flyer(text: str, _autopilot: str | None) -> Flight:
        texts.append(text)
        return flown(centre_error_rms_m=0.5 if "outliers" in text else 0.4)

    _, rows = measured(flyer)
    assert rows[ROUGH, "error over that without"] == ["<= 1.5", pytest.approx(1.25), "yes"]
    path = tmp_path / "rough.toml"
    path.write_text(texts[-1])
    rough, clean = load_mission(path), load_mission(FOLDER / "circle.toml")
    assert rough.targets is not None
    assert clean.targets is not None
    assert (rough.targets[0].sensor.drop, rough.targets[0].sensor.outliers) == (0.3, 0.05)
    assert rough.targets[0].motion == clean.targets[0].motion
    assert rough.limits == clean.limits


def test_random_flights_are_counted_with_their_seeds() -> None:
    flights = iter(
        (
            flown(),
            flown(vehicles_landed=8, completed=False, reason="vehicle 3 lost"),
            Flight(GOOD | {"flown_min_separation_m": 1.4}, ("acceleration", "fence"), 3),
        )
    )

    def flyer(_text: str, autopilot: str | None) -> Flight:
        if autopilot is None:
            return flown()
        flight = next(flights, None)
        if flight is None:
            raise PlanError("no way")
        return flight

    figures, rows = measured(flyer, Size(flights=4, seed=7, simulated_s=1.0))
    drawn = figures["flights"]
    assert isinstance(drawn, dict)
    assert [each["seed"] for each in drawn.pop("odd")] == [8, 9, 10]
    assert drawn == {
        "flown": 4,
        "completed": 2,
        "not_landed": 2,
        "pairs_below_minimum": 3,
        "flown_below_minimum": 1,
        "limits_broken": 2,
        "flown_min_separation_m": 1.4,
    }
    assert rows["4 random flights", "limits broken"] == ["<= 0", 2.0, "no"]
    assert isinstance(figures["seeds"], dict)
    assert figures["seeds"]["flights"] == [7, 8, 9, 10]


def landed_on_even_seeds(text: str, _autopilot: str | None) -> Flight:
    odd = re.search(r"seed \d*[13579]\"", text) is not None
    return flown(vehicles_landed=8, completed=False, reason="vehicle 3 lost") if odd else flown()


def test_several_processes_count_the_same() -> None:
    one, two = (
        measured(landed_on_even_seeds, Size(flights=5, seed=4, simulated_s=1.0, jobs=jobs))[0]["flights"]
        for jobs in (1, 2)
    )
    assert one == two
    assert isinstance(one, dict)
    assert [each["seed"] for each in one["odd"]] == [5, 7]


def table(
    moved: Callable[[Array], None] | None = None,
) -> dict[str, Array]:
    """Setpoints of two vehicles 3 m apart that fly east with 2 m/s for 2 s."""
    time_s = np.repeat(np.arange(0.0, 2.0, 0.02), 2)
    rows = np.zeros((len(time_s), 9))
    rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = 2.0 * time_s, 3.0 * (np.arange(len(time_s)) % 2), 10.0, 2.0
    if moved is not None:
        moved(rows)
    return {
        "time_s": time_s,
        "system_id": 1.0 + np.arange(len(time_s)) % 2,
        "position_enu_m": rows[:, :3],
        "velocity_enu_m_s": rows[:, 3:6],
        "acceleration_enu_m_s2": rows[:, 6:],
    }


def test_setpoints_are_held_against_limits_fence_and_separation() -> None:
    limits = {"speed_m_s": 2.0, "acceleration_m_s2": 1.0, "climb_m_s": None, "descent_m_s": 0.5, "jerk_m_s3": None}
    summary = {"stages": {"approach": [0.5, 1.5]}, "limits": limits, "separation_m": 1.5}

    def looked_at(row: int, column: int, value: float, vehicle: int = 0) -> tuple[tuple[str, ...], int]:
        def moved(rows: Array) -> None:
            rows[2 * row + vehicle, column] = value

        return commanded(table(moved), summary, load_mission(FOLDER / "circle.toml"))

    assert looked_at(50, 2, 10.0) == ((), 0)
    assert looked_at(50, 3, 2.1) == (("speed",), 0)
    assert looked_at(10, 3, 2.1) == ((), 0)  # before the first planned stage
    assert looked_at(50, 8, -1.1) == (("acceleration",), 0)
    assert looked_at(50, 5, 0.6) == (("speed",), 0)  # the climb has no limit of its own, the norm has
    assert looked_at(50, 5, -0.6) == (("speed", "descent"), 0)
    assert looked_at(50, 2, 2.9) == (("fence",), 0)
    assert looked_at(50, 1, 1.0, vehicle=1) == ((), 1)


def test_random_missions_are_missions_and_the_same_for_the_same_seed(tmp_path: Path) -> None:
    drawn = [random_mission(seed) for seed in range(60)]
    assert {each.motion for each in drawn} == set(MOTIONS)
    assert {each.autopilot for each in drawn} == set(AUTOPILOTS)
    assert len({each.text for each in drawn}) == len(drawn)
    assert random_mission(5) == drawn[5]
    path = tmp_path / "mission.toml"
    for each in drawn:
        path.write_text(each.text)
        assert load_mission(path).targets is not None


def test_a_whole_flight_says_what_its_record_says() -> None:
    target = '[[targets]]\nname = "post"\n[targets.motion]\nkind = "static"\nposition_enu_m = [9.0, 2.0, 12.0]\n'
    text = re.sub(r"\[target\]\nposition_enu_m = .*\n", target, SMALL_MISSION)
    flight = fly_once(text, "ardupilot")
    assert flight.landed
    assert flight.summary["completed"] is True
    assert flight.pairs_below == 0
    assert flight.broken == ()
    assert isinstance(flight.summary["capture_time_s"], float)


@pytest.mark.parametrize("arguments", [["--flights", "-1"], ["--seed", "one"]])
def test_numbers_that_are_none_are_refused(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        parser().parse_args(["bench", "track", *arguments])
    assert ended.value.code == 2


def test_a_missing_mission_is_one_line_before_anything_flies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "track", "--missions", str(tmp_path), "--json"]) == 2
    said = capsys.readouterr()
    assert json.loads(said.out)["exit_code"] == 2
    assert said.err.splitlines() == [f"fg-gcs: {tmp_path / 'circle.toml'}: cannot be read: No such file or directory"]


def test_the_figures_are_json() -> None:
    figures, _ = measured(lambda _text, _autopilot: flown(), Size(flights=1, seed=0, simulated_s=1.0))
    assert json.loads(json.dumps(plain(figures)))["flights"]["flown"] == 1
