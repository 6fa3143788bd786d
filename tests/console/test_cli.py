"""The command line as scripts see it: exit codes, JSON, one clear line for what is wrong."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from fg_gcs.console.cli import main, parser

MISSIONS = Path(__file__).parents[2] / "missions"
PLAN_KEYS = [
    "mission",
    "planner",
    "vehicles",
    "leaders",
    "path_length_m",
    "straight_length_m",
    "iterates",
    "flux_metric",
    "coverage_mean",
    "coverage_min_after_facing",
    "last_scale",
    "plan_time_s",
    "timing_time_s",
    "duration_s",
    "peak_speed_m_s",
    "peak_acceleration_m_s2",
    "min_separation_m",
    "min_separation_pair",
    "min_fault_separation_m",
    "min_fault_separation_pair",
    "min_fault_separation_stage",
    "min_fault_separation_heard_s",
    "min_fault_separation_after_s",
    "min_fall_separation_m",
    "min_fall_separation_pair",
    "slower_for_faults",
]


def test_help_loads_nothing_heavy() -> None:
    """What makes a start slow is what is imported; the clock on a busy machine would say less."""
    script = (
        "import sys\nfrom fg_gcs.console.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "print([m for m in ('numpy','scipy','toppra','matplotlib','pydantic','rich','plotly','pymavlink','asyncio')"
        " if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.splitlines()[-1] == "[]"
    assert "examples:" in done.stdout


@pytest.mark.parametrize("command", ["fly", "plan", "check", "sim", "report"])
def test_every_command_explains_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    assert f"fg-gcs {command}" in capsys.readouterr().out


def test_plan_prints_one_json_line_a_mission_with_all_keys(capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(MISSIONS / f"{name}.toml") for name in ("paper_front", "paper_behind")]
    assert main(["plan", *files, "--json"]) == 0
    front, behind = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    for name, keys in zip(files, (front, behind), strict=True):
        assert list(keys) == PLAN_KEYS
        assert keys["mission"] == name
        assert keys["peak_speed_m_s"] <= 10.0
        assert keys["peak_acceleration_m_s2"] <= 5.0
        assert keys["min_separation_m"] >= 1.5
        assert keys["min_fault_separation_m"] >= 0.5
        assert keys["flux_metric"] >= 0.999
    assert front["path_length_m"] == pytest.approx(60.0, rel=0.03)
    assert behind["path_length_m"] == pytest.approx(70.8, rel=0.03)


def test_plan_tells_the_size_around_the_target_and_takes_the_formulation_from_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (MISSIONS / "paper_front.toml").read_text()
    wide, free, both = (tmp_path / f"{name}.toml" for name in ("wide", "free", "both"))
    grown = text.replace("[limits]", "radius_m = 5.0\n[limits]")
    wide.write_text(grown)
    free.write_text(text + '\n[plan]\nformulation = "free"\n')
    both.write_text(grown + '\n[plan]\nformulation = "free"\n')
    assert main(["plan", str(wide), str(free), "--json"]) == 0
    said = capsys.readouterr()
    scales = [json.loads(line)["last_scale"] for line in said.out.splitlines()]
    assert scales == [pytest.approx(2.0), 1.0]
    assert said.err.count("formation at 2.00 times its size at the end") == 1
    assert main(["check", str(wide), str(both)]) == 2
    assert 'use formulation = "rigid" ([plan])' in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("ending", ["png", "svg"])
def test_plan_draws_a_picture(ending: str, tmp_path: Path) -> None:
    picture = tmp_path / f"plan.{ending}"
    assert main(["plan", str(MISSIONS / "paper_front.toml"), "--plot", str(picture)]) == 0
    assert picture.stat().st_size > 10_000


def test_a_picture_of_an_unknown_kind_or_of_two_plans_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mission = str(MISSIONS / "demo.toml")
    assert main(["plan", mission, "--plot", str(tmp_path / "plan.doc")]) == 2
    assert main(["plan", mission, mission, "--plot", str(tmp_path / "plan.png")]) == 2
    said = capsys.readouterr().err
    assert "png" in said
    assert "only one file" in said


def test_check_names_each_file_and_fails_if_one_is_bad(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text((MISSIONS / "demo.toml").read_text().replace("vehicles = 9", "vehicles = 8"))
    unplannable = tmp_path / "low.toml"
    unplannable.write_text(
        (MISSIONS / "demo.toml")
        .read_text()
        .replace("high_enu_m = [40.0, 50.0, 40.0]", "high_enu_m = [40.0, 18.2, 40.0]")
    )
    assert main(["check", str(MISSIONS / "circle.toml")]) == 0
    assert main(["check", str(MISSIONS / "circle.toml"), str(bad), str(unplannable)]) == 2
    said = capsys.readouterr().err
    assert f"{bad}: [swarm] vehicles: 8 vehicles, but the formation has 9 slots" in said
    assert f"{unplannable}: the formation does not fit around the target" in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["fly", "nowhere.toml"], "nowhere.toml: cannot be read"),
        (["fly", str(MISSIONS / "demo.toml"), "--connect", "carrier:pigeon"], "udpin:"),
        (
            ["fly", str(MISSIONS / "demo.toml"), "--connect", "udpin:127.0.0.1:1", "--speed", "max"],
            "leave --connect out",
        ),
        (["fly", str(MISSIONS / "demo.toml"), "--logs", "/dev/null/logs"], "--logs /dev/null/logs: "),
        (["report", "nowhere"], "nowhere: not the folder of a recorded run"),
    ],
)
def test_bad_input_is_one_clear_line_and_exit_code_2(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("fg-gcs: ")
    assert said in lines[0]


def test_numbers_that_are_none_are_refused_by_the_parser() -> None:
    for arguments in (["--wait", "0"], ["--wait", "soon"], ["--speed", "-1"], ["--speed", "nan"]):
        with pytest.raises(SystemExit) as ended:
            parser().parse_args(["fly", "x.toml", *arguments])
        assert ended.value.code == 2
