from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fg_gcs.errors import MissionError
from fg_gcs.mission import Mission, load_mission
from fg_gcs.mission.model import Table

MISSIONS = Path(__file__).parents[2] / "missions"
GOOD = (MISSIONS / "paper_front.toml").read_text()


def refusal(path: Path, text: str) -> str:
    path.write_text(text)
    with pytest.raises(MissionError) as caught:
        load_mission(path)
    said = str(caught.value)
    assert "\n" not in said
    assert said.startswith(str(path))
    return said.removeprefix(f"{path}: ")


@pytest.mark.parametrize("path", sorted(MISSIONS.glob("*.toml")), ids=lambda path: path.stem)
def test_the_missions_that_come_along_are_good(path: Path) -> None:
    mission = load_mission(path)
    assert len(mission.task().formation.slots_m) == mission.swarm.vehicles == len(mission.pads_enu_m())
    assert len(path.read_text().splitlines()) <= 60


@pytest.mark.parametrize(
    ("found", "instead", "said"),
    [
        ("vehicles = 9", "vehicles = 9\nspeed = 3", "[swarm] speed: unknown key; accepted keys: vehicles, system_ids"),
        ("[target]", "[aim]\nx = 1\n[target]", "aim: unknown key; accepted tables and keys: description, swarm"),
        ("vehicles = 9", 'vehicles = "9"', "[swarm] vehicles: got '9'; accepted: a whole number from 3 to 250"),
        ("speed_m_s = 10.0", "speed_m_s = true", "[limits] speed_m_s: got True; accepted: norm of the speed"),
        ("speed_m_s = 10.0", "", "[limits] speed_m_s: missing; accepted: norm of the speed, a number above 0"),
        ("speed_m_s = 10.0", "speed_m_s = 0", "[limits] speed_m_s: got 0; accepted"),
        ("acceleration_m_s2 = 5.0", "acceleration_m_s2 = -5", "[limits] acceleration_m_s2: got -5; accepted"),
        ("speed_m_s = 10.0", "speed_m_s = nan", "[limits] speed_m_s: got nan; accepted"),
        ("[10.0, 10.0, 20.0]", "[10.0, inf, 20.0]", "[target] position_enu_m: got inf; accepted"),
        ("[10.0, 10.0, 20.0]", "[10.0, 20.0]", "[target] position_enu_m: missing; accepted: [east, north, up]"),
        (
            "[10.0, 10.0, 20.0]",
            "[10.0, 10.0, 2.0]",
            "[target] position_enu_m: up = 2 m lies below the floor; accepted: 3",
        ),
        ("[10.0, 10.0, 20.0]", "[99.0, 10.0, 20.0]", "[target] position_enu_m: [99.0, 10.0, 20.0] lies outside"),
        ("vehicles = 9", "vehicles = 8", "[swarm] vehicles: 8 vehicles for 9 slots of the formation; accepted: 9"),
        (
            "vehicles = 9",
            "vehicles = 9\nsystem_ids = [1, 2, 2, 3, 4, 5, 6, 7, 8]",
            "[swarm] system_ids: 2 occurs twice",
        ),
        ("vehicles = 9", "vehicles = 9\nsystem_ids = [1, 2]", "[swarm] system_ids: 2 ids for 9 vehicles; accepted: 9"),
        ("separation_m = 1.5", "separation_m = 1.9", "[limits] separation_m: 1.9 m, but the closest slots"),
        ("followers = 5", "followers = 7", "[formation] shape: a hemisphere of 4 leaders has 0, 1, 4 or 5 followers"),
        ("[1.0, 0.0, 0.0]", "[0.0, 0.0, 0.0]", "[formation] normal_enu: the normal of the face needs a direction"),
        ("[0.0, 2.5, 12.5]", "[0.0, 2.5, 4.0]", "[formation] centre_enu_m: slot"),
        ("[40.0, 40.0, 40.0]", "[40.0, -50.0, 40.0]", "[fence] high_enu_m: each number must be larger"),
        ("[pads]", "[takeoff]\nheight_m = 2.0\n[pads]", "[takeoff] height_m: 2 m is below the floor; accepted: 3"),
        ("[pads]", "[pads]\nspacing_m = 1.0", "[pads] spacing_m: 1 m; accepted: more than the separation of 1.5 m"),
        ("[pads]", "[hold]\nduration_s = 1979-05-27\n[pads]", "[hold] duration_s: got '1979-05-27'; accepted"),
        ("[swarm]", "[swarm", "not a TOML file: Expected ']' at the end of a table declaration"),
        ("[swarm]\nvehicles = 9", "swarm = 3", "swarm: got 3; accepted: a table"),
    ],
)
def test_one_clear_line_for_what_is_wrong(tmp_path: Path, found: str, instead: str, said: str) -> None:
    assert found in GOOD
    assert refusal(tmp_path / "bad.toml", GOOD.replace(found, instead)).startswith(said)


def test_files_that_are_no_missions(tmp_path: Path) -> None:
    assert "cannot be read" in refusal_of(tmp_path / "nowhere.toml")
    assert "cannot be read" in refusal_of(tmp_path)
    (tmp_path / "binary.toml").write_bytes(bytes(range(256)))
    assert "not a TOML file" in refusal_of(tmp_path / "binary.toml")
    (tmp_path / "huge.toml").write_text("#" * 1_000_001)
    assert "larger than" in refusal_of(tmp_path / "huge.toml")
    (tmp_path / "deep.toml").write_text("a = " + "[" * 5000 + "]" * 5000)
    assert "not a TOML file" in refusal_of(tmp_path / "deep.toml")


def refusal_of(path: Path) -> str:
    with pytest.raises(MissionError) as caught:
        load_mission(path)
    return str(caught.value)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, len(GOOD.splitlines()) - 1), st.text(max_size=40))
def test_any_line_replaced_by_anything_is_good_or_one_clear_line(tmp_path: Path, line: int, text: str) -> None:
    lines = GOOD.splitlines()
    lines[line] = text
    path = tmp_path / "m.toml"
    path.write_text("\n".join(lines), errors="replace")
    said = "good"
    try:
        assert np.isfinite(load_mission(path).task().target_enu_m).all()
    except MissionError as error:
        said = str(error)
    assert said == "good" or ("\n" not in said and said.startswith(str(path)))


def test_a_custom_formation(tmp_path: Path) -> None:
    text = re.sub(
        r'shape = "hemisphere"\nleaders = 4\nfollowers = 5\nedge_m = 5.0',
        'shape = "custom"\nleaders_yz_m = [[-2, -2], [2, -2], [0, 3]]\nfollowers_xyz_m = [[-2, 0, 0]]',
        GOOD,
    ).replace("vehicles = 9", "vehicles = 4\nsystem_ids = [9, 3, 7, 5]")
    (tmp_path / "custom.toml").write_text(text)
    mission = load_mission(tmp_path / "custom.toml")
    assert mission.swarm.ids() == (3, 5, 7, 9)
    assert mission.task().formation.slots_m.tolist() == [[0, -2, -2], [0, 2, -2], [0, 0, 3], [-2, 0, 0]]


def tables(model: type[Table]) -> dict[str, type[Table]]:
    found: dict[str, type[Table]] = {}
    for name, field in model.model_fields.items():
        for kind in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(kind, type) and issubclass(kind, Table):
                found[name] = kind
    return found


def test_every_key_is_explained_in_the_missions_readme() -> None:
    text = (MISSIONS / "README.md").read_text()
    for table, model in tables(Mission).items():
        assert f"`[{table}]`" in text
        for key in model.model_fields:
            assert f"`{key}`" in text, f"[{table}] {key}"
    for path in MISSIONS.glob("*.toml"):
        assert f"`{path.name}`" in text
