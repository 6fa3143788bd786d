from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fg_gcs.errors import MissionError
from fg_gcs.mission import Mission, load_mission
from fg_gcs.mission.formats.toml import parse_mission, read_positions
from fg_gcs.mission.position_files import PositionFile
from fg_gcs.mission.target_tables import CsvSource, UdpSource, VehicleSource

MISSIONS = Path(__file__).parents[2] / "missions"
GOOD = (MISSIONS / "circle.toml").read_text()
FIRST = GOOD.index("[[targets]]")
LAST = GOOD.index("[hold]")
TARGET = GOOD[FIRST:LAST]

NAMED = '[[targets]]\nname = "lead"\n'
CIRCLE = '[targets.motion]\nkind = "circle"\ncentre_enu_m = [0.0, 0.0, 18.0]\nradius_m = 50.0\nspeed_m_s = 4.0\n'
SECOND = NAMED.replace("lead", "other")
PLACED = f"{NAMED}position_enu_m = [1.0, 2.0, 18.0]\n"
UDP = '[targets.source]\nkind = "udp"\nendpoint = "udpin:127.0.0.1:15000"\n'
VEHICLE = '[targets.source]\nkind = "vehicle"\nsystem_id = 101\n'
CSV = '[targets.source]\nkind = "csv"\npath = "seen.csv"\n'
ROWS = "time_s,target,east_m,north_m,up_m\n0.0,lead,1.0,2.0,18.0\n1.0,other,0,0,18\n2.0,lead,4.0,2.0,18.0\n"


def written(folder: Path, tables: str) -> Path:
    path = folder / "m.toml"
    path.write_text(GOOD[:FIRST] + tables + GOOD[LAST:])
    (folder / "seen.csv").write_text(ROWS)
    return path


def loaded(folder: Path, tables: str) -> Mission:
    return load_mission(written(folder, tables))


def motion(kind: str, keys: str) -> str:
    return f'{NAMED}[targets.motion]\nkind = "{kind}"\n{keys}\n'


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ("", "[target]: missing; accepted: either [target] or [[targets]]"),
        (TARGET + "[target]\nposition_enu_m = [0.0, 0.0, 9.0]\n", "[target]: given beside [[targets]]; accepted"),
        ("targets = []\n", "[formation] targets: unknown key"),  # it stands behind [formation]
        ("[target]\nposition_enu_m = [0.0, 0.0, 9.0]\n[track]\n", "[track]: has no effect without [[targets]]"),
        (TARGET + '[plan]\nformulation = "free"\n', '[plan] formulation: "free" cannot follow moving targets'),
        (TARGET + '[track]\nmodel = "jerk"\n', "[track] model: got 'jerk'; accepted: \"velocity\" (constant"),
        (CIRCLE, "targets: got {'motion'"),
        ("[[targets]]\n" + CIRCLE, "[targets] name of target 1: missing; accepted: 1 to 32 of the characters"),
        (TARGET.replace("lead", "The Lead"), "[targets] name of target 1: got 'The Lead'; accepted"),
        (TARGET + TARGET, '[targets] name of target 1: "lead" occurs 2 times; accepted: a different name'),
        (TARGET + "[targets.wheels]\n", "[targets] wheels of target 1: unknown key; accepted keys: name, position"),
        (NAMED, "[targets] motion of target 1: missing; accepted: a table with the motion that the sensor sees"),
        (TARGET + SECOND, "[targets] motion of target 2: missing; accepted: a table"),
        (f"{NAMED}weight = 0\n{CIRCLE}", "[targets] weight of target 1: got 0; accepted: a number above 0"),
        (f"{NAMED}motion = 3\n", "[targets] motion of target 1: got 3; accepted: a table"),
        (
            NAMED + "[targets.motion]\nradius_m = 3.0\n",
            '[targets.motion] kind of target 1: missing; accepted: "static", "waypoints", "circle", "figure_eight"',
        ),
        (motion("square", ""), '[targets.motion] kind of target 1: got \'square\'; accepted: "static", "waypoints"'),
        (motion("circle", ""), "[targets.motion] centre_enu_m of target 1: missing; accepted: [east, north, up]"),
        (
            TARGET + SECOND + CIRCLE + "seed = 3\n",
            "[targets.motion] seed of target 2: unknown key; accepted keys",
        ),
        (
            TARGET.replace("50.0", "-5"),
            "[targets.motion] radius_m of target 1: got -5; accepted: a number of metres from 0.1 to 1e6",
        ),
        (TARGET.replace("0.0, 18.0]", "nan, 18.0]"), "[targets.motion] centre_enu_m of target 1: got nan; accepted"),
        (TARGET.replace("0.0, 18.0]", "18.0]"), "[targets.motion] centre_enu_m of target 1: missing; accepted"),
        (TARGET.replace("50.0", "120.0"), "[targets.motion] kind of target 1: leaves the fence by up to 20.00 m"),
        (
            TARGET.replace("50.0", "97.0"),
            "[targets.motion] kind of target 1: the formation around it reaches 5.24 m",
        ),
        (TARGET.replace("18.0", "7.0"), "[targets.motion] kind of target 1: the formation around it reaches 5.24 m"),
        (TARGET.replace("4.0", "10.0"), "[targets.motion] kind of target 1: moves at up to 10.00 m/s; accepted: less"),
        (
            TARGET.replace("4.0", "1e300"),
            "[targets.motion] speed_m_s of target 1: got 1e+300; accepted: a number above 0",
        ),
        (
            motion("waypoints", "points_enu_m = [[0.0, 0.0, 18.0], [3.0, 0.0, 18.0]]\nspeed_m_s = 4.0"),
            "[targets.motion] kind of target 1: the leg from point 1 is 3.00 m long; accepted: 16.00 m or more",
        ),
        (
            motion("waypoints", "points_enu_m = [[0.0, 0.0, 18.0], [1e308, -1e308, 18.0]]\nspeed_m_s = 4.0"),
            "[targets.motion] kind of target 1: the numbers are too large; accepted: positions inside",
        ),
        (
            motion("random_walk", "low_enu_m = [0, 0, 18]\nhigh_enu_m = [9, -1, 18]\nspeed_m_s = 4.0"),
            "[targets.motion] kind of target 1: high_enu_m lies below low_enu_m; accepted",
        ),
        (motion("file", 'path = "nowhere.csv"'), "[targets.motion] path of target 1: "),
        (f"{NAMED}{CIRCLE}{UDP}", '[targets] motion of target 1: has no effect with a source of kind "udp"'),
        (NAMED + UDP, "[targets] position_enu_m of target 1: missing; accepted: [east, north, up] in metres, where"),
        (PLACED + UDP.replace("udpin", "tcp"), "[targets.source] endpoint of target 1: got 'tcp:127.0.0.1:15000'"),
        (
            PLACED + UDP.replace("15000", "99999"),
            "[targets.source] endpoint of target 1: got port 99999; accepted: a port from",
        ),
        (
            PLACED + UDP + PLACED.replace("lead", "other") + UDP.replace("127.0.0.1:", ""),
            "[targets.source] endpoint of target 2: port 15000 is used by another source; accepted: a port that",
        ),
        (PLACED + VEHICLE, '[targets.source] endpoint of target 1: missing; accepted: "udpin:HOST:PORT" for a real'),
        (
            NAMED + VEHICLE + "simulated = true\n",
            "[targets] motion of target 1: missing; accepted: a table with the motion that the sim",
        ),
        (
            NAMED + CIRCLE + VEHICLE.replace("101", "9") + "simulated = true\n",
            "[targets.source] system_id of target 1: 9 is used by another vehicle; accepted: an id that",
        ),
        (
            motion("random_walk", "low_enu_m = [0, 0, 18]\nhigh_enu_m = [9, 9, 18]\nspeed_m_s = 4.0")
            + VEHICLE
            + "simulated = true\n",
            '[targets.motion] kind of target 1: simulated vehicles do not fly "random_walk"; accepted: "static"',
        ),
        (
            TARGET + '[targets.source]\nkind = "radar"\n',
            "[targets.source] kind of target 1: got 'radar'; accepted",
        ),
        (
            PLACED + UDP + "[targets.sensor]\ndrop = 0.1\n",
            "[targets.sensor] drop of target 1: has no effect with a source",
        ),
        (
            TARGET + "[targets.sensor]\ndrop = 1.5\n",
            "[targets.sensor] drop of target 1: got 1.5; accepted: a number from 0 to 1",
        ),
        (TARGET + "[targets.sensor]\nsilence = [[1, 2, 3]]\n", "[targets.sensor] silence of target 1: got [1, 2, 3]"),
        (
            TARGET + "[targets.sensor]\nsilence = [[8, 2]]\n",
            "[targets.sensor] silence of target 1: got [8, 2]; accepted",
        ),
        (NAMED + CSV.replace("seen", "none"), "[targets.source] path of target 1: "),
        (NAMED.replace("lead", "third") + CSV, "[targets.source] path of target 1: "),
    ],
)
def test_one_clear_line_for_what_is_wrong(tmp_path: Path, tables: str, said: str) -> None:
    path = written(tmp_path, tables)
    with pytest.raises(MissionError) as caught:
        load_mission(path)
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith(f"{path}: {said}")


def test_no_targets_at_all_and_too_many(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text("targets = []\n" + GOOD[:FIRST] + GOOD[LAST:])
    with pytest.raises(MissionError, match=r"m.toml: targets: got \[\]; accepted: 1 to 20 tables"):
        load_mission(path)
    many = "".join(TARGET.replace("lead", f"t{k}") for k in range(21))
    with pytest.raises(MissionError, match=r"m.toml: targets: got .*; accepted: 1 to 20 tables"):
        loaded(tmp_path, many)
    assert len(loaded(tmp_path, "".join(TARGET.replace("lead", f"t{k}") for k in range(20))).targets or []) == 20


def test_the_task_is_about_where_targets_are_at_first(tmp_path: Path) -> None:
    assert loaded(tmp_path, TARGET).task().target.centre_enu_m.tolist() == [50.0, 0.0, 18.0]
    assert loaded(tmp_path, TARGET).task().last_scale == 1.0
    assert loaded(tmp_path, PLACED + CIRCLE).task().target.centre_enu_m.tolist() == [1.0, 2.0, 18.0]
    assert loaded(tmp_path, PLACED + UDP).task().target.centre_enu_m.tolist() == [1.0, 2.0, 18.0]
    assert loaded(tmp_path, NAMED + CSV).task().target.centre_enu_m.tolist() == [1.0, 2.0, 18.0]


def test_a_group_has_the_radius_of_all_but_not_more_than_allowed(tmp_path: Path) -> None:
    two = f"{PLACED}weight = 3.0\n{CIRCLE}" + SECOND + "position_enu_m = [9.0, 2.0, 18.0]\n" + CIRCLE
    target = loaded(tmp_path, two).task().target
    assert target.centre_enu_m == pytest.approx([3.0, 2.0, 18.0])
    assert target.radius_m == pytest.approx((6.0 + 5.0) / np.sqrt(2.0))
    assert loaded(tmp_path, two + "[track]\nmost_radius_m = 6.5\n").task().target.radius_m == 6.5
    assert loaded(tmp_path, two + "[track]\nmost_radius_m = 6.0\n").task().last_scale == pytest.approx(2.0)


def test_files_are_found_beside_the_mission_and_read_for_one_target(tmp_path: Path) -> None:
    (target,) = loaded(tmp_path, NAMED + CSV).targets or []
    assert [(row.time_s, row.target) for row in target.replay()] == [(0.0, "lead"), (2.0, "lead")]
    (target,) = loaded(tmp_path, motion("file", 'path = "seen.csv"')).targets or []
    moving = target.true_motion()
    assert moving is not None
    assert moving.at(np.array([-1.0, 1.0, 9.0]))[0][:, 0] == pytest.approx([1.0, 2.5, 4.0])


def test_sources_and_sensors_as_they_are_read(tmp_path: Path) -> None:
    tables = TARGET + PLACED.replace("lead", "b") + UDP + SECOND + CIRCLE + VEHICLE + "simulated = true\n"
    silent = "[targets.sensor]\nsilence = [[1, 2.5]]\nsigma_m = 0\n"
    narrow = "[track]\nmost_radius_m = 3.0\n"
    first, second, third = loaded(tmp_path, tables + silent + narrow).targets or []
    assert first.source.kind == "script"
    assert isinstance(second.source, UdpSource)
    assert second.true_motion() is None
    assert isinstance(third.source, VehicleSource)
    assert (first.simulated, second.simulated, third.simulated) == (False, False, True)
    assert third.sensor.settings().silence_s == ((1.0, 2.5),)
    assert (first.sensor.settings().sigma_m, third.sensor.settings().sigma_m) == (0.5, 0.0)


def test_vehicles_may_come_to_one_port(tmp_path: Path) -> None:
    real = VEHICLE + 'endpoint = "udpin:15000"\n'
    mission = loaded(tmp_path, PLACED + real + PLACED.replace("lead", "other") + real.replace("101", "102"))
    assert len(mission.targets or []) == 2


TEXTS = st.text(max_size=40)


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from(["circle", "figure_eight", "evader", "lost_and_found", "escort"]),
    st.integers(0, 60),
    st.one_of(TEXTS, st.sampled_from(["[targets.sensor]", "closed = 3", "path = '\\u0000'", "radius_m = 1e308"])),
)
def test_any_line_replaced_by_anything_is_good_or_one_clear_line(
    tmp_path: Path, name: str, row: int, text: str
) -> None:
    lines = (MISSIONS / f"{name}.toml").read_text().splitlines()
    lines[row % len(lines)] = text
    path = tmp_path / "m.toml"
    path.write_text("\n".join(lines), errors="replace")
    said = "good"
    try:
        assert np.isfinite(load_mission(path).task().target_enu_m).all()
    except MissionError as error:
        said = str(error)
    assert said == "good" or ("\n" not in said and said.startswith(str(path)))


def test_a_mission_reads_no_files_itself() -> None:
    asked: list[str] = []

    def files(path: str) -> PositionFile:
        asked.append(path)
        return PositionFile(path, rows.encode())

    moving = motion("file", 'path = "seen.csv"').replace("lead", "other")
    rows = ROWS + "90.0,other,0,1,18\n"
    text = GOOD.replace(TARGET, NAMED + CSV + moving)
    mission = parse_mission(text, Path("m.toml"), files)
    assert asked == ["seen.csv"]  # once, though two tables name it
    assert mission.files() == {"seen.csv": rows.encode()}
    assert parse_mission((MISSIONS / "circle.toml").read_text(), files=files).files() == {}


def test_a_file_of_positions_is_taken_apart_once(tmp_path: Path) -> None:
    (tmp_path / "seen.csv").write_text(ROWS)
    file = read_positions(tmp_path / "seen.csv")
    (tmp_path / "seen.csv").unlink()  # what was read is enough
    assert file.rows("lead", 0.5)[0] is file.rows("lead", 0.5)[0]
    assert file.rows("lead", 0.5)[0].covariance_m2[0, 0] == 0.25
    assert file.rows("lead", 2.0)[0].covariance_m2[0, 0] == 4.0
    with pytest.raises(MissionError, match=r"seen\.csv: no line of target 'nobody'; accepted: one or more"):
        file.rows("nobody", 0.5)
    with pytest.raises(MissionError, match=r"gone: cannot be read: No such file or directory"):
        read_positions(tmp_path / "seen.csv", "gone").rows("lead", 0.5)
    with pytest.raises(MissionError, match="cannot be read: embedded null byte"):
        read_positions(tmp_path / "a\0b").rows("lead", 0.5)


def test_a_table_that_nobody_loaded_says_so() -> None:
    with pytest.raises(MissionError, match=r"seen\.csv: has not been read"):
        CsvSource(kind="csv", path="seen.csv").file.rows("lead", 0.5)
