"""What becomes of the record changes nothing of the flight."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from fg_gcs.record.read.run import load_run
from fg_gcs.record.report.report import write_report
from tests.flight.harness import CIRCLING, Flight, fly, mission_of
from tests.record.disks import small_disk


def test_a_disk_that_fills_up_in_flight_ends_the_recording_and_not_the_flight(tmp_path: Path) -> None:
    whole = fly(_made(tmp_path / "whole"), "px4")
    with small_disk(tmp_path / "disk", 600) as disk:
        cut = fly(disk, "px4")
        assert cut.recorder.failure is not None
        assert 5.0 < cut.recorder.failure.since_s < 30.0
        assert cut.events.count('"recording"') == 1
        rows = np.load(cut.recorder.folder / "setpoints.npy")
    for flight in (whole, cut):
        assert flight.result is not None
        assert flight.result.completed, flight.result.reason
    assert _stages(whole) == _stages(cut)
    assert whole.truth_separation_m == cut.truth_separation_m
    assert len(rows) > 1000
    assert np.array_equal(np.load(whole.recorder.folder / "setpoints.npy")[: len(rows)], rows)


def test_a_row_that_cannot_be_packed_ends_the_recording_and_not_the_flight(tmp_path: Path) -> None:
    async def spoil(flight: Flight) -> None:
        await flight.reaches("gather")
        flight.recorder.setpoints.append(())

    flight = fly(tmp_path, "ardupilot", spoil)
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    assert flight.recorder.failure is not None
    assert flight.events.count('"recording"') == 1


def test_what_a_flight_leaves_in_the_middle_gives_a_report_with_its_figures(tmp_path: Path) -> None:
    copies: list[Path] = []

    async def copy(flight: Flight) -> None:
        await flight.reaches("home")
        folder = _made(tmp_path / "killed")
        for path in flight.recorder.folder.iterdir():  # as a crash would leave them now
            (folder / path.name).write_bytes(path.read_bytes())
        copies.append(folder)

    fly(_made(tmp_path / "run"), "px4", copy, mission_of(tmp_path, CIRCLING))
    (folder,) = copies
    (folder / "mission.toml").write_text(CIRCLING)
    run = load_run(folder)
    assert run.remarks == ()
    assert list(run.stages)[-1] == "home"
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["completed"] is False
    assert summary["tracking"]["caught_s"] > summary["tracking"]["began_s"]
    written = write_report(folder)
    assert written.remarks == ()
    page = written.path.read_text()
    assert "the run did not come to its end" in page
    assert "Time until the target was caught" in page


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _stages(flight: Flight) -> object:
    return None if flight.result is None else flight.result.stages
