"""A process that records at rate and is killed: what it leaves is whole, and at most a second is missing."""

import random
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.record.read.run import load_run
from fg_gcs.record.write.recorder import SUMMARY

# Real time and a real thread: 450 setpoints and telemetry rows and 900 frames a second, flushed as a flight does it.
# It says what it has recorded, so that a machine that is busy changes nothing
RECORDING = """
import sys, time
from pathlib import Path
from fg_gcs.wire.address import MAIN
from fg_gcs.record.write.recorder import Recorder
start_s = time.monotonic()
with Recorder(Path(sys.argv[1]), "", start_s, 1.7e9, in_thread=True) as recorder:
    k = 0
    while True:
        now_s = time.monotonic()
        time_s = recorder.since_start_s(now_s)
        for system_id in range(1, 10):
            recorder.setpoints.append((time_s, MAIN, system_id, *[float(k)] * 10))
            recorder.telemetry.append((time_s, MAIN, system_id, *[float(k)] * 9))
            recorder.frames([bytes(60)], now_s)
            recorder.frames([bytes(60)], now_s)
        print(time_s, flush=True)
        if k % 10 == 0:
            recorder.event(now_s, "text", f"round {k}")
            recorder.know(stages={"hold": [0.0, None]}, rounds=k)
            recorder.flush()
        k += 1
        time.sleep(0.02)
"""


@pytest.mark.parametrize("seed", range(6))
def test_a_run_that_is_killed_leaves_everything_but_the_last_second(tmp_path: Path, seed: int) -> None:
    process = subprocess.Popen([sys.executable, "-c", RECORDING, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    with process:
        assert process.stdout is not None
        killed_s = random.Random(seed).uniform(0.0, 1.2)
        said_s = [next(float(line) for line in process.stdout if float(line) >= killed_s)]
        process.send_signal(signal.SIGKILL)
        said_s += [float(line) for line in process.stdout]
    run = load_run(tmp_path)
    assert not [remark for remark in run.remarks if not remark.startswith("not understood")]  # there is no mission
    for table in (run.telemetry, run.setpoints):
        rows = np.load(tmp_path / f"{'telemetry' if table is run.telemetry else 'setpoints'}.npy")
        assert len(rows) == len(table["time_s"])
        assert len(rows) % 9 == 0
        last_s = rows["time_s"][-1] if len(rows) else 0.0
        assert last_s > said_s[-1] - 1.0
        assert (np.diff(table["time_s"]) >= 0.0).all()
        assert set(table["network"].tolist()) <= {"main"}
    assert (tmp_path / SUMMARY).exists()
    assert not run.summary.is_true("completed")
    assert run.stages.get("hold", (0.0, 0.0))[1] <= run.last_s
