"""A disk that is really full in flight, or a folder that is gone: the flight completes, and its exit code says 5."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np

from tests.console.test_processes import GCS, PATIENCE_S, SPEED, flying, wait_for
from tests.flight.harness import SMALL
from tests.record.disks import small_disk


def told_once(said: str) -> str:
    (line,) = (line for line in said.splitlines() if "recording stopped" in line)
    return line


def test_a_full_disk_in_flight_costs_the_record_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL)
    with small_disk(tmp_path / "disk", 600) as disk:
        command = [*GCS, "fly", str(tmp_path / "small.toml"), "--logs", str(disk), "--speed", f"{SPEED:g}", "--json"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
        assert done.returncode == 5, done.stderr
        told = json.loads(done.stdout.splitlines()[-1])
        (folder,) = disk.iterdir()
        kept = json.loads((folder / "summary.json").read_text())
        events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
        last_s = float(np.load(folder / "setpoints.npy")["time_s"][-1])
        reported = subprocess.run([*GCS, "report", str(folder)], capture_output=True, text=True, check=False)
    assert "No space left on device" in told_once(done.stderr)
    assert [event["kind"] for event in events].count("recording") == 1
    for summary in (told, kept):
        assert (summary["completed"], summary["vehicles_landed"]) == (True, 4), summary["reason"]
        assert summary["recording_complete"] is False
        assert "No space left on device" in summary["recording_failure"]["text"]
        assert {"telemetry.npy", "setpoints.npy", "ticks.npy", "flight.tlog"} <= summary["recording_missing"].keys()
        assert last_s <= summary["recording_missing"]["setpoints.npy"] <= summary["recording_failure"]["since_s"]
    assert told["log"] == kept["log"] == str(folder)
    assert reported.returncode == 2  # there is no room for a report
    assert len(reported.stderr.splitlines()) == 1


def test_a_folder_that_is_gone_in_flight_costs_the_record_and_nothing_else(tmp_path: Path) -> None:
    with flying(tmp_path) as process:
        before = wait_for(process, r"\bgather$")
        while (tmp_path / "logs").exists():  # the summary may be written anew in between
            shutil.rmtree(tmp_path / "logs", ignore_errors=True)
        out, after = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 5
    told = json.loads(out.splitlines()[-1])
    assert told_once("".join(before) + after)
    assert (told["completed"], told["vehicles_landed"]) == (True, 4), told["reason"]
    assert told["recording_complete"] is False
    assert {"telemetry.npy", "setpoints.npy", "flight.tlog"} <= told["recording_missing"].keys()
    assert not (tmp_path / "logs").exists()
