"""The program as people run it: real processes, real sockets, real signals; time runs faster than the clock."""

from __future__ import annotations

import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.flight.harness import CIRCLE, SMALL, moving

GCS = [sys.executable, "-m", "fg_gcs.console.cli"]
VEHICLE = f'[[targets]]\nname = "car"\n{CIRCLE}[targets.source]\nkind = "vehicle"\nsystem_id = 101\nsimulated = true\n'
PATIENCE_S = 300.0  # for anything at all, on a busy machine
SPEED = (
    2.0  # times real time: a flight needs a tenth of a core then, and gets that on a machine that has ten other jobs
)


@contextmanager
def flying(folder: Path, *more: str, text: str = SMALL) -> Iterator[subprocess.Popen[str]]:
    mission = folder / "small.toml"
    mission.write_text(text)
    command = [*GCS, "fly", str(mission), "--logs", str(folder / "logs"), "--speed", f"{SPEED:g}", "--json", *more]
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
    try:
        process = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([process], [], [], PATIENCE_S)[0])
    finally:
        os.close(process)


def summary_of(process: subprocess.Popen[str]) -> dict[str, object]:
    out, _ = process.communicate(timeout=PATIENCE_S)
    found = json.loads(out.splitlines()[-1])
    assert isinstance(found, dict)
    return found


def test_two_flights_at_once_over_real_sockets_do_not_meet(tmp_path: Path) -> None:
    """One at a target at rest, one after a target that is a vehicle in a process of its own."""
    for name in ("resting", "moving"):
        (tmp_path / name).mkdir()
    chase = moving(VEHICLE).replace("duration_s = 12.0", "duration_s = 4.0")
    with flying(tmp_path / "resting") as resting, flying(tmp_path / "moving", text=chase) as chasing:
        wait_for(chasing, "caught after")
        simulators = children(chasing.pid)
        followed, reached = summary_of(chasing), summary_of(resting)
        assert (resting.returncode, chasing.returncode) == (0, 0)
    for flown in (reached, followed):
        assert flown["completed"] is True
        assert flown["vehicles_landed"] == 4
        assert Path(str(flown["report"])).stat().st_size > 100_000
    assert isinstance(followed["centre_error_rms_m"], float)
    assert followed["centre_error_rms_m"] < 1.5
    assert isinstance(followed["replan_p99_ms"], float)
    assert len(simulators) == 2
    assert all(ends(simulator) for simulator in simulators)


@pytest.mark.parametrize(
    ("number", "text", "moment"),
    [(signal.SIGINT, SMALL, r"\bapproach$"), (signal.SIGTERM, moving(VEHICLE), "caught after")],
    ids=["SIGINT, target at rest", "SIGTERM, target followed"],
)
def test_a_signal_in_flight_brings_everybody_home(
    number: signal.Signals, text: str, moment: str, tmp_path: Path
) -> None:
    with flying(tmp_path, text=text) as process:
        wait_for(process, moment)
        simulators = children(process.pid)
        process.send_signal(number)
        flown = summary_of(process)
        assert process.returncode == 1
    assert flown["completed"] is False
    assert flown["reason"] == f"stopped by {number.name}"
    assert flown["vehicles_landed"] == 4
    assert len(simulators) == 1 + text.count("simulated = true")
    assert all(ends(simulator) for simulator in simulators)
    log = Path(str(flown["log"]))
    assert (log / "report.html").stat().st_size > 100_000
    assert json.loads((log / "events.jsonl").read_text().splitlines()[-1])["kind"]


def test_the_simulator_killed_in_flight(tmp_path: Path) -> None:
    with flying(tmp_path) as process:
        wait_for(process, r"\bapproach$")
        os.kill(children(process.pid)[0], signal.SIGKILL)
        flown = summary_of(process)
        assert process.returncode == 5
    assert flown["lost"] == flown["vehicles_not_down"] == [1, 2, 3, 4]
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
        assert done.returncode == 3
        assert str(port) in done.stderr
        assert len(done.stderr.splitlines()) == 1


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def test_a_reader_of_the_words_that_has_gone_costs_the_words_alone(tmp_path: Path) -> None:
    mission = tmp_path / "small.toml"
    mission.write_text(SMALL)
    here, there = os.pipe()
    os.close(here)
    command = [*GCS, "fly", str(mission), "--logs", str(tmp_path / "logs"), "--json", "--speed", "max"]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=there, timeout=PATIENCE_S, check=False)
    os.close(there)
    assert done.returncode == 0
    assert json.loads(done.stdout.splitlines()[-1])["completed"] is True


def test_the_code_says_how_it_ended_though_nobody_reads(tmp_path: Path) -> None:
    mission = tmp_path / "small.toml"
    mission.write_text(SMALL)
    here, there = os.pipe()
    os.close(here)
    fault = '{"kind": "taken_over", "mode": "LAND", "vehicles": [2], "stage": "hold"}'
    command = [
        *GCS,
        "fly",
        str(mission),
        "--logs",
        str(tmp_path / "logs"),
        "--json",
        "--speed",
        "max",
        "--fault",
        fault,
    ]
    done = subprocess.run(command, stdout=there, stderr=there, timeout=PATIENCE_S, check=False)
    os.close(there)
    assert done.returncode == 1
