"""A flight whose process is killed or stopped: at most a second of its record is missing, and everybody comes down."""

from __future__ import annotations

import json
import random
import re
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from tests.console.test_processes import GCS, PATIENCE_S, flying, summary_of, wait_for

MISSING_S = 1.0  # at most, at the end of each table
STREAMING = ("gather", "approach", "hold", "home")
SPEED = 4.0
STOPPED_S = 8.0


@pytest.mark.parametrize("seed", range(3))
def test_crash_no_report_a_killed_flight_gives_a_report_of_all_but_a_second(tmp_path: Path, seed: int) -> None:
    with flying(tmp_path, "--speed", f"{SPEED:g}") as process:
        wait_for(process, "ready to arm")
        time.sleep(random.Random(seed).uniform(0.5, 5.0))
        killed_s = time.time()
        process.send_signal(signal.SIGKILL)
    (folder,) = (tmp_path / "logs").iterdir()
    reported = subprocess.run(
        [*GCS, "report", str(folder)], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert reported.returncode == 0, reported.stderr
    assert reported.stderr.splitlines()[-1] == f"report: {folder / 'report.html'}"
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    stage = [event["text"] for event in events if event["kind"] == "stage"][-1]
    flown_s = killed_s - (folder / "mission.toml").stat().st_mtime  # the first thing that a run writes, and only once
    for name in ("telemetry", "setpoints", "ticks") if stage in STREAMING else ("telemetry",):
        last_s = float(np.load(folder / f"{name}.npy")["time_s"][-1])
        assert flown_s - last_s / SPEED < MISSING_S


def test_stopped_process_says_that_it_stood_still_and_brings_everybody_down(tmp_path: Path) -> None:
    """Vehicles land by their own failsafes meanwhile, and are not blamed for that."""
    with flying(tmp_path, "--speed", f"{SPEED:g}") as process:
        wait_for(process, r"\bapproach$")
        time.sleep(1.0 / SPEED)
        process.send_signal(signal.SIGSTOP)
        time.sleep(STOPPED_S / SPEED)
        process.send_signal(signal.SIGCONT)
        flown = summary_of(process)
        assert process.returncode == 1
    assert flown["vehicles_not_down"] == []
    assert re.fullmatch(r"this program stood still for \d+\.\d s", str(flown["reason"]))
    events = (Path(str(flown["log"])) / "events.jsonl").read_text()
    assert "is taken over" not in events
    assert "are taken over" not in events
