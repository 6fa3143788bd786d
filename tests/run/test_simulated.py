"""Flights whose simulated vehicles fail on purpose: told by mission, options and command line; judged by the truth."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from fg_gcs.console.cli import main
from fg_gcs.errors import MissionError
from fg_gcs.mission import load_mission
from fg_gcs.run import FlyOptions, RunResult, fly_blocking
from tests.flight.harness import SMALL as FOUR

SMALL = (Path(__file__).parents[2] / "missions" / "sitl.toml").read_text()


def flown(folder: Path, text: str = SMALL, **options: Any) -> RunResult:  # noqa: ANN401 - any option
    path = folder / "mission.toml"
    path.write_text(text)
    chosen = FlyOptions(logs=folder / "logs", write_report=False, **options)
    return fly_blocking(load_mission(path), chosen, speed=math.inf)


def events(result: RunResult, kind: str) -> list[dict[str, Any]]:
    lines = (result.folder / "events.jsonl").read_text().splitlines()
    return [event for event in map(json.loads, lines) if event["kind"] == kind]


def test_a_fault_of_a_mission_begins_with_its_stage(tmp_path: Path) -> None:
    tables = '\n[[simulator.faults]]\nkind = "dead"\nvehicles = [2]\nstage = "hold"\nat_s = 1.0\n'
    result = flown(tmp_path, SMALL + tables)
    assert not result.completed
    assert "vehicle 2 is lost" in result.reason
    hold_s = next(event["time_s"] for event in events(result, "stage") if event["text"] == "hold")
    strikes = result.summary["ground_strikes"]
    assert isinstance(strikes, list)
    assert [strike["vehicles"] for strike in strikes] == [[2]]
    assert hold_s + 1.0 < strikes[0]["time_s"] < hold_s + 6.0
    assert [event["text"] for event in events(result, "truth")] == [strikes[0]["text"]]
    assert not result.in_order


def test_a_flight_with_faults_is_the_same_flight_again(tmp_path: Path) -> None:
    """The same seed and tables: the same bytes on every link."""
    faults = (
        {"kind": "position_noise", "sigma_m": 0.1, "vehicles": [1], "stage": "approach"},
        {"kind": "wind", "speed_m_s": 3.0, "gusts_m_s": 1.0, "stage": "airborne"},
    )
    impairments = ({"loss": 0.02, "delay_s": 0.02, "jitter_s": 0.01, "reorder": 0.02, "duplicate": 0.02},)
    logs = []
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        result = flown(folder, FOUR, autopilot="ardupilot", dynamics="measured", faults=faults, impairments=impairments)
        logs.append((result.folder / "flight.tlog").read_bytes())
    assert logs[0] == logs[1]
    assert len(logs[0]) > 1_000_000


def test_a_whole_flight_has_hit_nothing(tmp_path: Path) -> None:
    result = flown(tmp_path)
    assert result.completed
    assert result.in_order
    assert result.summary["collisions"] == result.summary["ground_strikes"] == []
    separation_m = result.summary["true_min_separation_m"]
    assert separation_m == pytest.approx(result.summary["flown_min_separation_m"], abs=0.1)


BAD = [
    ('[[simulator.faults]]\nkind = "gps_los"\n', "[[simulator.faults]] 1: kind = 'gps_los' (did you mean 'gps_loss'?)"),
    (
        '[[simulator.faults]]\nkind = "dead"\n[[simulator.faults]]\nkind = "dead"\nvehicles = [77]\n',
        "faults]] 2: vehicles",
    ),
    ('[[simulator.faults]]\nkind = "dead"\nstage = "lunch"\n', "stage = 'lunch'; accepted: one of"),
    ('[[simulator.faults]]\nkind = "taken_over"\nmode = "GUIDED"\n', "accepted: MANUAL"),
    (
        "[[simulator.impairments]]\nloss = 2.0\n",
        "[[simulator.impairments]] 1: loss = 2.0; accepted: a number from 0 to 1",
    ),
    ('[simulator]\nautopilot = "ardupilot"\nstrict_commands = true\n', "strict_commands is no manner of ardupilot"),
    ('[simulator]\ndynamics = "real"\n', "dynamics"),
    ("[simulator]\nfaults = 3\n", "faults"),
]


@pytest.mark.parametrize(("tables", "says"), BAD)
@pytest.mark.parametrize("command", ["fly", "check"])
def test_bad_tables_are_one_line_and_exit_2(
    tables: str, says: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(
        SMALL.replace("[simulator]", "[simulator_]") + tables if "[simulator]\n" in tables else SMALL + tables
    )
    more = ["--logs", str(tmp_path / "logs")] if command == "fly" else []
    assert main([command, str(path), *more]) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if "compiling" not in line]
    assert len(said) == 1
    assert says in said[0]
    assert not (tmp_path / "logs").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--fault", "{"], "--fault 1: not a JSON object"),
        (["--fault", '{"kind": "dead"}', "--fault", '{"kind": "deat"}'], "--fault 2: kind = 'deat'"),
        (["--impair", '{"loss": "much"}'], "--impair 1: loss = 'much'"),
    ],
)
def test_bad_options_are_one_line_and_exit_2(
    options: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "good.toml"
    path.write_text(SMALL)
    assert main(["fly", str(path), "--logs", str(tmp_path / "logs"), *options]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert says in said[0]


def test_options_of_a_flight_are_checked_before_it_begins(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match="--fault 1: kind = 'deat'"):
        flown(tmp_path, faults=({"kind": "deat"},))
    assert not (tmp_path / "logs").exists()
