"""Swarms of programs that stand in for SITL: which of them become ready, and why others do not."""

from __future__ import annotations

import asyncio
import io
import json
import math
import os
import re
import signal
import socket
import subprocess
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as dialect
from rich.console import Console

from fg_gcs.console.cli import main
from fg_gcs.console.swarm import table_of
from fg_gcs.errors import FgError, LinkError, MissionError, VehicleError
from fg_gcs.run.flying import FlyOptions, Outcome, fly_blocking
from fg_gcs.sitl.instances import Instance, SwarmOptions
from fg_gcs.sitl.swarm import Member, Stage, Swarm, judge, started
from tests.console.test_processes import GCS, ends
from tests.flight.harness import SMALL, mission_of
from tests.swarms.standins import OURS, Heard, alive, beating, options, script, some
from tests.swarms.test_processes import fifo, number_in

DYING = 'print("no sensors", file=sys.stderr); sys.exit(3)'
SILENT = "signal.pause()"
PATIENT = 20.0, 20.0  # for heartbeats, and until all can be armed [s]


def refusal(chosen: SwarmOptions, instances: list[Instance]) -> FgError:
    """Start instances that do not become ready; return why. None of them is left."""
    heard = Heard()

    async def start() -> FgError:
        with pytest.raises(FgError) as caught:
            async with started(chosen, instances, heard):
                pass
        return caught.value

    error = asyncio.run(start())
    assert "\n" not in str(error)
    assert not alive(heard.pids)
    return error


def words(chosen: SwarmOptions, folder: Path) -> list[str]:
    """Return the command that starts a swarm like this in a folder."""
    binary, files = str(chosen.binary), str(chosen.files)
    ports = ["--gcs-port", str(chosen.port), "--base-port", str(chosen.base_port)]
    return ["swarm", "ardupilot", "--binary", binary, "--defaults", files, "--folder", str(folder), *ports]


@pytest.mark.parametrize(
    ("write", "patience", "kind", "reason"),
    [
        (
            lambda path: script(path, DYING),
            PATIENT,
            LinkError,
            r"while booting instance \d \(vehicle \d\) ended with exit code 3; it said: no sensors; see .*; is ",
        ),
        (
            lambda path: script(path, SILENT),
            (0.3, 20.0),
            LinkError,
            "no heartbeat of vehicles 1-2 within 0.3 s: is .* a SITL.* it said nothing; see .*ardupilot-0/out.log",
        ),
        (lambda path: beating(path, kind=dialect.MAV_TYPE_FIXED_WING), PATIENT, MissionError, "is no multirotor"),
        (lambda path: beating(path, kind=dialect.MAV_TYPE_GROUND_ROVER), PATIENT, MissionError, "is no multirotor"),
        (
            lambda path: beating(path, px4=True),
            PATIENT,
            MissionError,
            "speaks as PX4; swarm ardupilot starts Ardu",
        ),
        (lambda path: beating(path, armed=True), PATIENT, VehicleError, "is armed already"),
        (
            beating,
            (20.0, 0.6),
            VehicleError,
            r"not ready to arm within 0.6 s: vehicles 1-2 \(mode not set yet\); set what they ask for by --param",
        ),
    ],
    ids=["dies", "is silent", "plane", "rover", "another autopilot", "armed", "never ready"],
)
def test_what_is_no_sitl_of_a_multirotor_is_refused_and_ends(
    write: Callable[[Path], Path], patience: tuple[float, float], kind: type[FgError], reason: str, tmp_path: Path
) -> None:
    chosen = options(tmp_path, write(tmp_path / "copter"))
    error = refusal(replace(chosen, heartbeat_s=patience[0], ready_s=patience[1]), some(2))
    assert type(error) is kind
    assert re.search(reason, str(error)), error


def test_a_machine_that_is_too_slow_is_told_with_figures(tmp_path: Path) -> None:
    async def judged(paces: tuple[float, float], busy: float) -> list[str]:
        chosen, heard = options(tmp_path, tmp_path / "copter"), Heard()
        members = [Member(one, tmp_path, pace=pace) for one, pace in zip(some(2), paces, strict=True)]
        judge(Swarm(chosen, tuple(members), (), heard, 0.0, busy))
        return heard.lines

    assert asyncio.run(judged((0.99, 1.0), 0.5)) == [
        "the slowest clock (vehicle 1) runs at 0.990 of real time, processors 50 % busy"
    ]
    assert len(asyncio.run(judged((0.99, 1.0), 0.99))) == 2
    assert asyncio.run(judged((math.nan, math.nan), math.nan)) == ["how fast their clocks run is not known"]
    with pytest.raises(VehicleError, match=r"too slow for so many instances \(2\).* \(vehicle 2\) runs at 0.800 of"):
        asyncio.run(judged((0.99, 0.8), 0.99))


def test_the_table_has_a_row_for_each_whatever_it_says(tmp_path: Path) -> None:
    members = [Member(one, tmp_path, pid=17) for one in some(3)]
    members[1].stage, members[1].waits = Stage.BOOTING, "PreArm: [red]no[/red] position"
    members[2].stage, members[2].waits, members[2].ready_s = Stage.READY, "", 41.66

    async def shown() -> str:
        table = table_of(Swarm(options(tmp_path, tmp_path), tuple(members), (), Heard(), 0.0))
        console = Console(width=100, file=io.StringIO())
        console.print(table)
        assert isinstance(console.file, io.StringIO)
        return console.file.getvalue()

    rows = [line.split() for line in asyncio.run(shown()).splitlines()]
    assert rows[1:] == [
        ["0", "1", "17", "starting", "no", "heartbeat", "yet"],
        ["1", "2", "17", "booting", "PreArm:", "[red]no[/red]", "position"],
        ["2", "3", "17", "ready", "41.7", "s"],
    ]


def test_ports_that_are_taken_are_named_before_anything_is_started(tmp_path: Path) -> None:
    chosen = options(tmp_path, script(tmp_path / "copter", SILENT))
    instances = some(2)
    port = chosen.recipe.ports(chosen, instances[1].number)[2].number
    for address, reason in (
        (("127.0.0.1", port), rf"instance 1: UDP port {port} \(remote control\) is in use"),
        (("127.0.0.1", chosen.port), f"port {chosen.port} is in use"),
    ):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(address)
            error = refusal(chosen, instances)
        assert type(error) is LinkError
        assert re.search(reason, str(error)), error
    assert not list(tmp_path.glob("sitl/*/out.log"))


def test_a_mission_whose_instances_die_is_not_flown_and_says_why(tmp_path: Path) -> None:
    chosen = replace(options(tmp_path, script(tmp_path / "copter", DYING)), folder=None)
    result = fly_blocking(mission_of(tmp_path, SMALL), FlyOptions(swarm=chosen, logs=tmp_path / "logs"))
    assert result.outcome is Outcome.NO_ANSWER
    assert re.search("while booting instance 0 .* it said: no sensors", result.reason)
    assert (result.folder / "sitl" / "ardupilot-0" / "out.log").read_text() == "no sensors\n"


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        (["--spacing", "5"], "--spacing is for --swarm px4 or --swarm ardupilot"),
        (["--gcs-port", "14560", "--keep-parameters"], "--keep-parameters is for --swarm"),
        (["--swarm", "px4"], "no SITL program of px4 is named: --binary PATH does that"),
        (["--swarm", "ardupilot", "--binary", "/bin/true", "--px4-etc", "/"], "--px4-etc is not for ardupilot"),
        (["--swarm", "px4", "--binary", "/bin/true", "--param", "RTL_ALT"], "not of the form NAME=VALUE"),
        (
            ["--swarm", "ardupilot", "--binary", "/bin/true", "--defaults", "/dev/null"],
            "has not beside it|is not a file",
        ),
    ],
)
def test_a_flight_with_options_at_fault_begins_nothing(
    more: list[str], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mission_of(tmp_path, SMALL)
    (mission,) = tmp_path.glob("*.toml")
    assert main(["fly", str(mission), "--logs", str(tmp_path / "logs"), *more]) == 2
    assert re.search(reason, capsys.readouterr().err)
    assert not (tmp_path / "logs").exists()


def test_a_swarm_becomes_ready_tells_who_ends_and_leaves_nobody_though_it_is_killed(tmp_path: Path) -> None:
    """The command, with the simulator of the project as one vehicle an instance."""
    chosen = options(tmp_path, script(tmp_path / "copter", OURS, lean=False))
    process = subprocess.Popen(
        [*GCS, *words(chosen, tmp_path / "own"), "--vehicles", "2", "--first-id", "7", "--slow-machine-ok", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        ready = json.loads(process.stdout.readline())
        assert ready["connect"] == [f"udpin:127.0.0.1:{chosen.port}"]
        assert [each["system_id"] for each in ready["instances"]] == [7, 8]
        pids = [each["pid"] for each in ready["instances"]]
        assert alive(pids) == pids
        os.kill(pids[0], signal.SIGKILL)
        line = next(line for line in process.stderr if "was ended by" in line)
        assert line.startswith("instance 0 (vehicle 7) was ended by SIGKILL; ")
        process.kill()
        assert ends(pids[1])
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda number: number.name)
def test_a_swarm_that_is_stopped_while_it_boots_leaves_nobody(
    number: signal.Signals, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = fifo(tmp_path / "pid")
    write = f"if system_id == '2':\n    open({str(path)!r}, 'w').write(str(os.getpid()))"
    told = script(tmp_path / "copter", f"{write}\n{SILENT}")
    pids: list[int] = []

    def stop() -> None:
        pids.append(number_in(path))
        os.kill(os.getpid(), number)

    thread = threading.Thread(target=stop)
    thread.start()
    code = main([*words(options(tmp_path, told), tmp_path / "own"), "--vehicles", "2", "--json"])
    thread.join()
    out, said = capsys.readouterr()
    assert code == 1
    assert "ending all instances" in said
    assert json.loads(out.splitlines()[-1]) == {"ready": False, "ended": True, "exit_code": 1}
    assert pids
    assert not alive(pids)
