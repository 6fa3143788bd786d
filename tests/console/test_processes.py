"""The program as people run it: real processes, real sockets, real signals; time runs faster than the clock."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.flight.harness import CIRCLE, SMALL, moving

GCS = [sys.executable, "-m", "fg_gcs.console.cli"]
VEHICLE = f'[[targets]]\nname = "car"\n{CIRCLE}[targets.source]\nkind = "vehicle"\nsystem_id = 101\nsimulated = true\n'
PATIENCE_S = 120.0  # for anything at all, on a busy machine


@contextmanager
def flying(folder: Path, *more: str, text: str = SMALL) -> Iterator[subprocess.Popen[str]]:
    mission = folder / "small.toml"
    mission.write_text(text)
    command = [*GCS, "fly", str(mission), "--logs", str(folder / "logs"), "--json", *more]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def wait_for(process: subprocess.Popen[str], pattern: str) -> list[str]:
    """Read what the program says until a line matches; return all lines so far."""
    assert process.stderr is not None
    lines: list[str] = []
    for line in process.stderr:
        lines.append(line)
        if re.search(pattern, line):
            return lines
    raise AssertionError(f"it never said {pattern}:\n{''.join(lines)}")


def children(pid: int) -> list[int]:
    threads = Path(f"/proc/{pid}/task").glob("*/children")  # whichever thread has started them
    return [int(child) for thread in threads for child in thread.read_text().split()]


def ends(pid: int) -> bool:
    """Wait until a process that is not our child has gone."""
    deadline_s = time.monotonic() + 20.0
    while time.monotonic() < deadline_s:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except OSError:
            return True
        os.sched_yield()
    return False


def summary_of(process: subprocess.Popen[str]) -> dict[str, object]:
    out, _ = process.communicate(timeout=PATIENCE_S)
    found = json.loads(out.splitlines()[-1])
    assert isinstance(found, dict)
    return found


def test_a_flight_over_real_sockets(tmp_path: Path) -> None:
    with flying(tmp_path, "--speed", "4") as process:
        flown = summary_of(process)
        assert process.returncode == 0
    assert flown["completed"] is True
    assert flown["vehicles_landed"] == 4
    assert Path(str(flown["report"])).stat().st_size > 100_000


def test_a_target_that_is_a_vehicle_in_a_process_of_its_own(tmp_path: Path) -> None:
    with flying(tmp_path, "--speed", "3", text=moving(VEHICLE)) as process:
        wait_for(process, "caught after")
        simulators = children(process.pid)
        flown = summary_of(process)
        assert process.returncode == 0
    assert flown["completed"] is True
    assert flown["vehicles_landed"] == 4
    assert isinstance(flown["centre_error_rms_m"], float)
    assert flown["centre_error_rms_m"] < 1.5
    assert isinstance(flown["replan_p99_ms"], float)
    assert len(simulators) == 2
    assert all(ends(simulator) for simulator in simulators)


def test_a_signal_while_tracking_brings_everybody_home(tmp_path: Path) -> None:
    with flying(tmp_path, "--speed", "3", text=moving(VEHICLE)) as process:
        wait_for(process, "caught after")
        process.send_signal(signal.SIGINT)
        flown = summary_of(process)
        assert process.returncode == 1
    assert flown["reason"] == "stopped by SIGINT"
    assert flown["vehicles_landed"] == 4
    assert Path(str(flown["report"])).stat().st_size > 100_000


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_flight_brings_everybody_home(number: signal.Signals, tmp_path: Path) -> None:
    with flying(tmp_path, "--speed", "4") as process:
        wait_for(process, r"\bapproach$")
        simulators = children(process.pid)
        process.send_signal(number)
        flown = summary_of(process)
        assert process.returncode == 1
    assert flown["completed"] is False
    assert flown["reason"] == f"stopped by {number.name}"
    assert flown["vehicles_landed"] == 4
    assert len(simulators) == 1
    assert ends(simulators[0])
    log = Path(str(flown["log"]))
    assert (log / "report.html").exists()
    assert json.loads((log / "events.jsonl").read_text().splitlines()[-1])["kind"]


def test_the_simulator_killed_in_flight(tmp_path: Path) -> None:
    with flying(tmp_path, "--speed", "4") as process:
        wait_for(process, r"\bapproach$")
        os.kill(children(process.pid)[0], signal.SIGKILL)
        flown = summary_of(process)
        assert process.returncode == 5
    assert flown["lost_vehicles"] == flown["vehicles_not_down"] == [1, 2, 3, 4]
    assert "lost" in str(flown["reason"])
    assert (Path(str(flown["log"])) / "report.html").exists()


def test_the_ground_station_killed_leaves_no_simulator(tmp_path: Path) -> None:
    with flying(tmp_path) as process:
        wait_for(process, "ready to arm")
        simulator = children(process.pid)[0]
        process.kill()
        assert ends(simulator)


def test_nobody_answers(tmp_path: Path) -> None:
    endpoint = f"udpin:127.0.0.1:{free_port()}"
    with flying(tmp_path, "--connect", endpoint, "--wait", "1") as process:
        _, said = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 3
    assert said.splitlines()[-1].startswith(f"fg-gcs: no vehicle answered within 1 s at {endpoint}")


def test_a_port_in_use_is_named(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with flying(tmp_path, "--connect", f"udpin:127.0.0.1:{port}") as process:
            _, said = process.communicate(timeout=PATIENCE_S)
            assert process.returncode == 3
        assert f"port {port} is in use" in said
        simulator = [*GCS, "sim", "--vehicles", "2", "--port-base", str(port - 1)]
        done = subprocess.run(simulator, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
        assert done.returncode == 2
        assert str(port) in done.stderr
        assert len(done.stderr.splitlines()) == 1


def test_two_flights_at_once_do_not_meet(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    with flying(tmp_path / "a", "--speed", "3") as one, flying(tmp_path / "b", "--speed", "3") as two:
        assert summary_of(one)["completed"] is True
        assert summary_of(two)["completed"] is True


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
