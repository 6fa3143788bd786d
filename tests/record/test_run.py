import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.record.evaluate.evaluation import evaluated, flown_figures
from fg_gcs.record.read.run import IN_FLIGHT, load_run
from fg_gcs.record.report.report import write_report
from fg_gcs.record.write.recorder import EVENTS, MISSION, SUMMARY
from tests.record.flights import STAGES, TARGET, main, write_run

NAME = "2026-02-03T04-05-06-circle"


def test_a_run_comes_back(tmp_path: Path) -> None:
    run = evaluated(write_run(tmp_path / NAME))
    assert (run.name, run.begun) == ("circle", datetime(2026, 2, 3, 4, 5, 6))
    assert run.mission is not None
    assert run.mission.stream.rate_hz == 40.0
    assert run.stages == STAGES
    assert run.leaders == main(1, 2, 3, 4)
    assert run.target_enu_m is not None
    assert run.target_enu_m.tolist() == list(TARGET)
    flown = [stage for stage in IN_FLIGHT if stage in STAGES]
    assert [band.stage for band in run.bands] == flown
    assert [(band.begin_s, band.end_s) for band in run.bands] == [STAGES[stage] for stage in flown]
    assert run.span_s == (0.5, 16.0)
    assert run.number("late_ticks") == 3.0
    assert run.number("completed") is None  # a yes is no number
    assert run.number("never heard of") is None
    assert run.summary.limit("descent_m_s") == 1.5
    assert run.summary.limit("climb_m_s") is None
    assert run.series is not None
    assert run.series.position_m.shape[1:] == (5, 3)


def test_a_run_without_tables_of_moving_targets_has_nothing_of_them(tmp_path: Path) -> None:
    folder = write_run(tmp_path / NAME)
    for name in ("sightings", "replans", "truth"):
        (folder / f"{name}.npy").unlink()
    run = evaluated(folder)
    assert run.followed is None
    assert run.true_target is None
    assert not len(run.sightings["time_s"])
    assert run.series is not None
    assert [remark.partition(":")[0] for remark in run.remarks] == ["sightings.npy", "replans.npy", "truth.npy"]


def test_a_folder_with_a_name_of_its_own_has_no_time(tmp_path: Path) -> None:
    run = evaluated(write_run(tmp_path / "best flight ever"))
    assert (run.name, run.begun) == ("best flight ever", None)


def test_a_stage_flown_twice_ends_the_first_time_where_the_flight_was_aborted(tmp_path: Path) -> None:
    folder = write_run(tmp_path / NAME)
    events = [(0.5, "take-off"), (4.0, "home"), (5.0, None), (6.0, "home"), (14.0, "land")]
    lines = [
        {"time_s": time_s, "kind": "abort" if stage is None else "stage", "text": stage or "aborting: a fault"}
        for time_s, stage in events
    ]
    (folder / EVENTS).write_text("\n".join(json.dumps(line) for line in lines) + "\n")
    bands = load_run(folder).bands
    wanted = [("take-off", 0.5, 4.0), ("home", 4.0, 5.0), ("home", 6.0, 14.0), ("land", 14.0, 16.0)]
    assert [tuple(band) for band in bands] == wanted


@pytest.mark.parametrize("line", ["", "{", '{"kind": "text"}', "[1]", '"x"', '{"time_s": "?", "kind": 1, "text": 2}'])
def test_lines_that_are_no_events_are_passed_over(tmp_path: Path, line: str) -> None:
    folder = write_run(tmp_path / NAME)
    whole = (folder / EVENTS).read_text()
    events = load_run(folder).events
    (folder / EVENTS).write_text(f"{line}\n{whole}{line}")
    assert load_run(folder).events == events
    assert len(events) == whole.count("\n")


def test_a_run_without_flight_or_plan(tmp_path: Path) -> None:
    folder = write_run(tmp_path / NAME, flown=False)
    (folder / SUMMARY).write_text("{}")
    (folder / EVENTS).write_text("")
    run = evaluated(folder)
    assert run.series is None
    assert (run.bands, run.leaders, run.stages, run.target_enu_m) == ((), (), {}, None)
    assert run.summary.limit("speed_m_s") is None
    assert run.span_s[0] < run.span_s[1]


def test_a_mission_of_another_day_is_left_out(tmp_path: Path) -> None:
    folder = write_run(tmp_path / NAME)
    (folder / MISSION).write_text("[swarm]\nrockets = 3\n")
    assert load_run(folder).mission is None


def test_a_summary_that_names_more_leaders_than_were_heard(tmp_path: Path) -> None:
    run = evaluated(write_run(tmp_path / NAME, changes={"leader_ids": [1, 5, 10]}))
    assert run.leaders == main(1, 5, 10)
    assert run.series is not None
    assert np.isnan(run.series.flux_metric).all()
    assert write_report(tmp_path / NAME).path.exists()


def test_a_run_without_flown_figures_gets_them_from_its_tables(tmp_path: Path) -> None:
    folder = write_run(tmp_path / NAME)
    whole = json.loads((folder / SUMMARY).read_text())
    known = {key: value for key, value in whole.items() if not key.startswith(("flown", "tracking", "setpoint"))}
    (folder / SUMMARY).write_text(json.dumps(known))
    run = evaluated(folder)
    assert run.number("flown_peak_speed_m_s") == pytest.approx(3.2)
    assert run.number("tracking_rms_m") == pytest.approx(0.25)
    assert run.number("late_ticks") == 3.0
    assert run.figures == flown_figures(folder)


def test_a_stage_that_had_not_ended_ends_with_the_record(tmp_path: Path) -> None:
    folder = write_run(tmp_path / NAME)
    summary = json.loads((folder / SUMMARY).read_text())
    summary["stages"]["land"][1] = None
    (folder / SUMMARY).write_text(json.dumps(summary))
    run = evaluated(folder)
    assert run.remarks == ()
    assert run.stages["land"] == (14.0, run.last_s)
    assert 15.9 < run.last_s < 16.0


def test_a_folder_that_is_gone_has_no_figures(tmp_path: Path) -> None:
    write_run(tmp_path / NAME)
    there, gone = flown_figures(tmp_path / NAME), flown_figures(tmp_path / "gone")
    assert there.keys() == gone.keys()
    assert not any(gone.values())
