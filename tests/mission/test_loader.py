from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fg_gcs.errors import MissionError
from fg_gcs.mission import load_mission
from fg_gcs.mission.formats.toml import read_positions
from fg_gcs.plan.targets import Target

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
        ("speed_m_s = 10.0", "speed_m_s = true", "[limits] speed_m_s: got True; accepted: a number from 1e-6 to 1e6"),
        ("speed_m_s = 10.0", "", "[limits] speed_m_s: missing; accepted: a number from 1e-6 to 1e6, the largest norm"),
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
        ("[10.0, 10.0, 20.0]", "[nan, inf, 20.0]", "[target] position_enu_m: got nan; accepted"),
        ("[10.0, 10.0, 20.0]", "[99.0, 10.0, 20.0]", "[target] position_enu_m: [99.0, 10.0, 20.0] lies outside"),
        ("vehicles = 9", "vehicles = 8", "[swarm] vehicles: 8 vehicles, but the formation has 9 slots; accepted: 9"),
        (
            "vehicles = 9",
            "vehicles = 9\nsystem_ids = [1, 2, 2, 3, 4, 5, 6, 7, 8]",
            "[swarm] system_ids: 2 occurs twice",
        ),
        ("vehicles = 9", "vehicles = 9\nsystem_ids = [1, 2]", "[swarm] system_ids: 2 ids for 9 vehicles; accepted: 9"),
        ("vehicles = 9", 'vehicles = 9\nsystem_ids = ["west/251"]', "[swarm] system_ids: got"),
        (
            "vehicles = 9",
            'vehicles = 9\nsystem_ids = ["west/1", 2, 3, 4, 5, 6, 7, 8, 9]',
            '[swarm] system_ids: no network is called "west"; accepted: ids alone, or a table [networks]',
        ),
        (
            "[formation]",
            'system_ids = ["west/1", 2, 3, 4, 5, 6, 7, 8, "north/9"]\n'
            '[networks]\nwest = ["udp:14550"]\neast = ["udp:14551"]\n[formation]',
            '[swarm] system_ids: 2 names no network; accepted: "west/2" or "east/2"',
        ),
        ("[formation]", '[networks]\nWest = ["udp:14550"]\n[formation]', "networks: got 'West'; accepted: a table of"),
        ("[formation]", '[networks]\nwest = ["serial:1"]\n[formation]', "networks: got 'serial:1'; accepted: a table"),
        ("[formation]", '[networks]\nwest = ["udp:0"]\n[formation]', "[networks] west: udp:0; accepted: a port from 1"),
        (
            "[formation]",
            "[networks]\nwest = []\n[formation]",
            "[networks] west: has no endpoint; accepted: one or more",
        ),
        ("separation_m = 1.5", "separation_m = 1.9", "[limits] separation_m: 1.9 m, but the closest slots"),
        (
            "separation_m = 1.5",
            "separation_m = 1.5\nfault_separation_m = 1.6",
            "[limits] fault_separation_m: 1.6 m; accepted: at most 1.5 m ([limits] separation_m)",
        ),
        ("separation_m = 1.5", 'separation_m = 1.5\nfault_remedy = "stop"', "[limits] fault_remedy"),
        ("followers = 5", "followers = 7", "[formation] shape: a hemisphere of 4 leaders has 0, 1, 4 or 5 followers"),
        ("[1.0, 0.0, 0.0]", "[0.0, 0.0, 0.0]", "[formation] normal_enu: the normal of the face needs a direction"),
        ("[0.0, 2.5, 12.5]", "[0.0, 2.5, 4.0]", "[formation] centre_enu_m: slot"),
        (
            "[40.0, 40.0, 40.0]",
            "[40.0, -50.0, 40.0]",
            "[fence] high_enu_m: the fence has no inside; accepted: each number above",
        ),
        ("[pads]", "[takeoff]\nheight_m = 2.0\n[pads]", "[takeoff] height_m: 2 m is below the floor; accepted: 3"),
        ("[pads]", "[pads]\nspacing_m = 1.0", "[pads] spacing_m: got 1 m; accepted: more than 1.5 m"),
        ("[pads]", "[hold]\nduration_s = 1979-05-27\n[pads]", "[hold] duration_s: got '1979-05-27'; accepted"),
        ("[swarm]", "[swarm", "not a TOML file: Expected ']' at the end of a table declaration"),
        ("[swarm]\nvehicles = 9", "swarm = 3", "swarm: got 3; accepted: a table"),
    ],
)
def test_one_clear_line_for_what_is_wrong(tmp_path: Path, found: str, instead: str, said: str) -> None:
    assert found in GOOD
    assert refusal(tmp_path / "bad.toml", GOOD.replace(found, instead)).startswith(said)


TARGET = "position_enu_m = [10.0, 10.0, 20.0]"
TWO = "positions_enu_m = [[10.0, 10.0, 20.0], [12.0, 8.0, 22.0]]"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("", "position_enu_m: missing; accepted: either position_enu_m or positions_enu_m"),
        (f"{TARGET}\n{TWO}", "position_enu_m: given beside positions_enu_m; accepted: either"),
        ("positions_enu_m = []", "positions_enu_m: got []; accepted: 1 to 1000 points"),
        (f"positions_enu_m = {[[1.0, 1.0, 9.0]] * 1001}", "positions_enu_m: got [[1"),
        ("positions_enu_m = [[1.0, 1.0, 9.0], [1.0, 1.0, nan]]", "positions_enu_m: got nan; accepted: 1 to 1000"),
        ("positions_enu_m = [[1.0, 1.0, 9.0], [1.0, 1.0, 2.0]]", "positions_enu_m: point 2: up = 2 m lies below the"),
        (
            "positions_enu_m = [[1.0, 99.0, 9.0], [1.0, 1.0, 9.0]]",
            "positions_enu_m: point 1: [1.0, 99.0, 9.0] lies",
        ),
        (f"{TARGET}\nweights = [1.0]", "weights: has no effect without positions_enu_m; accepted: both or neither"),
        (f'{TARGET}\nsource = "charges"', "source: has no effect without positions_enu_m; accepted: both or neither"),
        (f"{TARGET}\nconfidence = 0.9", "confidence: has no effect without sigma_m; accepted: both or neither"),
        (f"{TWO}\nweights = [1.0]", "weights: 1 weights for 2 positions; accepted: 2 weights"),
        (f"{TWO}\nweights = [1.0, 0.0]", "weights: got 0.0; accepted: numbers above 0"),
        (
            f"{TWO}\nweights = [1e308, 1e-308]",
            ": every charge needs a weight above 0, got 0.0; accepted: positions, weights",
        ),
        (f'{TWO}\nsource = "middle"', "source: got 'middle'; accepted: \"centre\""),
        (f"{TARGET}\nradius_m = -1", "radius_m: got -1; accepted: a number, 0 or more"),
        (f"{TARGET}\nradius_m = inf", "radius_m: got inf; accepted: a number, 0 or more"),
        (f"{TARGET}\nsigma_m = nan", "sigma_m: got nan; accepted: 0 to 1e6"),
        (f"{TARGET}\nsigma_m = [1.0, 2.0]", "sigma_m: got [1.0, 2.0]; accepted: 0 to 1e6"),
        (f"{TARGET}\nsigma_m = 2e6", "sigma_m: got 2000000.0; accepted: 0 to 1e6, a number or [east"),
        (f"{TARGET}\nsigma_m = 1.0\nconfidence = 1.0", "confidence: got 1.0; accepted: between 0 and 1"),
        (
            f"{TARGET}\nradius_m = 2.0",
            "radius_m: around a target of radius 2.00 m the closest slots are 1.46 m apart; accepted: a radius of "
            "2.05 m or more in all, or a smaller separation ([limits] separation_m)",
        ),
        (f"{TARGET}\nsigma_m = 0.7", "sigma_m: around a target of radius 1.96 m the closest slots"),
        (f"{TARGET}\nradius_m = 100", "radius_m: a target of radius 100.00 m does not fit inside the fence; accepted"),
        (f"{TARGET}\nradius_m = 1.7e308\nsigma_m = 1.0", "radius_m: a target of radius"),
    ],
)
def test_one_clear_line_for_what_is_wrong_with_a_target(tmp_path: Path, keys: str, said: str) -> None:
    assert TARGET in GOOD
    line = refusal(tmp_path / "bad.toml", GOOD.replace(TARGET, keys))
    assert line.startswith("[target]" + ("" if said.startswith(":") else " ") + said)


def target_of(path: Path, keys: str) -> Target:
    path.write_text(GOOD.replace(TARGET, keys))
    return load_mission(path).task().target


def test_radii_of_points_extent_and_uncertainty_add_up(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    point = target_of(path, TARGET)
    assert (point.centre_enu_m.tolist(), point.radius_m) == ([10.0, 10.0, 20.0], 0.0)
    spread = np.sqrt(7.814728)  # the 95 % quantile of chi-square with three degrees of freedom, as tables print it
    assert target_of(path, f"{TARGET}\nradius_m = 3.0").radius_m == 3.0
    assert target_of(path, f"{TARGET}\nsigma_m = 2").radius_m == pytest.approx(2.0 * spread)
    assert target_of(path, f"{TARGET}\nsigma_m = [1.0, 2.0, 0.0]").radius_m == pytest.approx(2.0 * spread)
    wide = target_of(path, f"{TARGET}\nsigma_m = 2.0\nconfidence = 0.99").radius_m
    assert wide == pytest.approx(2.0 * np.sqrt(11.344867))
    two = (np.sqrt(3.0) + 5.0) / np.sqrt(2.0)  # the points are sqrt(3) m from their middle
    for source in ("centre", "charges"):
        group = target_of(path, f'{TWO}\nsource = "{source}"\nradius_m = 1.0\nsigma_m = 2.0')
        assert group.centre_enu_m == pytest.approx([11.0, 9.0, 21.0])
        assert group.radius_m == pytest.approx(two + 1.0 + 2.0 * spread)
        assert len(group.sources.weights) == {"centre": 1, "charges": 2}[source]
    heavy = target_of(path, f"{TWO}\nweights = [1.5e308, 0.5e308]")
    assert heavy.centre_enu_m == pytest.approx([10.5, 9.5, 20.5])


def test_the_task_knows_the_size_around_the_target_and_the_formulation(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text(GOOD.replace(TARGET, f'{TARGET}\nradius_m = 5.0\n[plan]\nformulation = "free"'))
    task = load_mission(path).task()
    assert task.last_scale == pytest.approx(2.0)  # the paper's square of 5 m holds a ball of 2.5 m
    assert task.formulation == "free"
    assert load_mission(MISSIONS / "paper_front.toml").task().formulation == "rigid"
    said = refusal(path, GOOD.replace("[target]", '[plan]\nformulation = "soft"\n[target]'))
    assert said.startswith("[plan] formulation: got 'soft'; accepted: \"rigid\"")


@pytest.mark.parametrize(
    ("rim", "said"),
    [
        ("[[-2, -2], [2, -2], [2, -2], [0, 3]]", "slots 2 and 3 lie in one place"),
        ("[[-2, -2], [2, -2], [0, 3], [0, 3]]", "slots 3 and 4 lie in one place"),
        ("[[-2, -2], [0, -2], [2, -2], [4, -2]]", "enclose an area"),
        ("[[1, 1], [1, 1], [1, 1], [1, 1]]", "enclose an area"),
    ],
)
def test_rims_without_a_face_are_refused(tmp_path: Path, rim: str, said: str) -> None:
    shape = f'shape = "custom"\nleaders_yz_m = {rim}'
    text = re.sub(r'shape = "hemisphere"\nleaders = 4\nfollowers = 5\nedge_m = 5.0', shape, GOOD)
    line = refusal(tmp_path / "rim.toml", text.replace("vehicles = 9", "vehicles = 4"))
    assert line.startswith("[formation] shape: ")
    assert said in line


def test_a_rim_beside_its_centre_covers_no_ball(tmp_path: Path) -> None:
    shape = 'shape = "custom"\nleaders_yz_m = [[3, 1], [7, 1], [5, 6]]'
    text = re.sub(r'shape = "hemisphere"\nleaders = 4\nfollowers = 5\nedge_m = 5.0', shape, GOOD)
    text = text.replace("vehicles = 9", "vehicles = 3").replace(TARGET, f"{TARGET}\nradius_m = 5.0")
    assert refusal(tmp_path / "rim.toml", text).startswith(
        "[target] radius_m: no circle around [0, 0] fits into the face"
    )


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
    assert mission.connections() == ()
    assert mission.task().formation.slots_m.tolist() == [[0, -2, -2], [0, 2, -2], [0, 0, 3], [-2, 0, 0]]


def test_vehicles_of_several_networks(tmp_path: Path) -> None:
    ids = ", ".join(f'"{name}/{system_id}"' for system_id in (3, 1, 2) for name in ("west", "east", "up"))
    networks = '[networks]\nwest = ["udp:14550", "tcp:host:5760"]\neast = ["udp:14551"]\nup = ["udpout:14552"]\n'
    text = GOOD.replace("[formation]", f"system_ids = [{ids}]\n{networks}[formation]")
    (tmp_path / "networks.toml").write_text(text)
    mission = load_mission(tmp_path / "networks.toml")
    assert mission.swarm.members() == tuple((name, n) for name in ("east", "up", "west") for n in (1, 2, 3))
    assert mission.connections() == ("west=udp:14550", "west=tcp:host:5760", "east=udp:14551", "up=udpout:14552")


@pytest.mark.parametrize(
    "text",
    ["[x" + ".a" * 3000 + "]\n", "n = " + "9" * 5000, "n = " + "[" * 2000 + "]" * 2000],
    ids=["deep", "long", "nested"],
)
def test_what_no_parser_takes_is_one_line(text: str, tmp_path: Path) -> None:
    (tmp_path / "hostile.toml").write_text(GOOD + text)
    with pytest.raises(MissionError) as refused:
        load_mission(tmp_path / "hostile.toml")
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize(("key", "value"), [("speed_m_s", "1e-300"), ("acceleration_m_s2", "1e300")])
def test_limits_that_no_arithmetic_works_with_are_refused(key: str, value: str, tmp_path: Path) -> None:
    text = re.sub(rf"^{key} = .*$", f"{key} = {value}", GOOD, flags=re.MULTILINE)
    assert text != GOOD
    (tmp_path / "absurd.toml").write_text(text)
    with pytest.raises(MissionError, match=rf"\[limits\] {key}: got 1e-?\+?300; accepted: a number from 1e-6 to 1e6"):
        load_mission(tmp_path / "absurd.toml")


def test_a_mission_is_a_file_that_has_an_end(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    for path in (tmp_path / "pipe.toml", Path("/dev/zero"), tmp_path):
        with pytest.raises(MissionError, match="accepted: a mission file"):
            load_mission(path)
    with pytest.raises(MissionError, match="accepted: a CSV file"):
        read_positions(Path("/dev/zero")).rows("lead", 0.5)
