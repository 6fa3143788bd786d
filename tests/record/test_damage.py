"""Folders of runs with something missing, cut off or foreign: what is there is read, a line says what is not."""

import json
import os
import random
import warnings
from collections.abc import Iterator
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

from fg_gcs.console.cli import main
from fg_gcs.console.plan import report
from fg_gcs.errors import MissionError
from fg_gcs.record.evaluate.evaluation import evaluated
from fg_gcs.record.read.run import RunError, load_run
from fg_gcs.record.read.tables import read_table
from fg_gcs.record.report.report import write_report
from fg_gcs.record.write.layouts import LAYOUTS, SIGHTINGS, TELEMETRY, TRUTH
from fg_gcs.record.write.recorder import EVENTS, INDEX, INPUTS, MISSION, SUMMARY, Recorder
from tests.record.flights import MISSION as TOML
from tests.record.flights import SUMMARY as FIGURES
from tests.record.flights import TARGET, Circle, instants

TRACKED = TOML.format(description="Five vehicles around two targets").replace(
    "[target]\nposition_enu_m = [1.0, 2.0, 20.0]\n",
    """[[targets]]
name = "one"
position_enu_m = [1.0, 2.0, 20.0]
[targets.source]
kind = "csv"
path = "../far/seen.csv"
[[targets]]
name = "two"
[targets.motion]
kind = "file"
path = "seen.csv"
""",
)
SEEN = b"time_s,target,east_m,north_m,up_m\n0,one,1,2,20\n9,one,1,2,20\n"
MOVED = b"time_s,target,east_m,north_m,up_m\n0,two,1,3,20\n90,two,2,3,20\n"
FILES = (SUMMARY, EVENTS, MISSION, f"{INPUTS}/{INDEX}", f"{INPUTS}/1-seen.csv", *(x.file_name for x in LAYOUTS))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that tracked two targets, with every kind of file in its folder."""
    folder = tmp_path_factory.mktemp("runs") / "2026-02-03T04-05-06-circle"
    folder.mkdir()
    circle = Circle()
    with Recorder(folder, TRACKED, 100.0, 1.7e9, {"../far/seen.csv": SEEN, "seen.csv": MOVED}) as recorder:
        for name, (begin_s, _) in FIGURES["stages"].items():  # type: ignore[attr-defined]
            recorder.event(100.0 + begin_s, "stage", name, stage=name)
        recorder.event(109.0, "fault", "vehicle 2 lost", fault="lost", severity=2)
        for row in circle.telemetry(instants(10.0)):
            recorder.telemetry.append(row)
        for row in circle.setpoints(instants(10.0), 0.25):
            recorder.setpoints.append(row)
        for time_s in np.arange(4.0, 10.0, 0.1).tolist():
            recorder.ticks.append((time_s, 0.001))
            recorder.sightings.append((time_s - 0.1, time_s, "one", *TARGET, "taken" if time_s < 8.0 else "gated"))
            row = (time_s, time_s, time_s + 0.01, "follow", True, *TARGET, 0.0, 0.0, 0.0, 0.1, 0.5, 0.2)
            recorder.replans.append(row)
            recorder.truth.append((time_s, "one", *TARGET))
            recorder.truth.append((time_s, "two", TARGET[0], TARGET[1] + 1.0, TARGET[2]))
        figures = dict(FIGURES)
        figures |= {"tracking": {"began_s": 4.0, "ended_s": 10.0, "caught_s": 6.0}, "found_again_s": [1.0, None]}
        recorder.finish(figures | {"sightings_rejected": {"gated": 20}})
    return folder


@pytest.fixture
def run(whole: Path, tmp_path: Path) -> Path:
    """A copy to be damaged."""
    return copytree(whole, tmp_path / whole.name)


def test_a_whole_run_has_nothing_to_remark(run: Path) -> None:
    read = evaluated(run)
    assert read.remarks == ()
    assert read.followed is not None
    assert read.figures["centre_error_rms_m"] is not None
    assert write_report(run).remarks == ()


def cuts(data: bytes) -> Iterator[bytes]:
    """Yield data cut at every 1000th byte, and close to its begin and its end."""
    for length in sorted({*range(0, len(data), 1000), 1, 5, 60, 127, 128, 129, len(data) - 1} & set(range(len(data)))):
        yield data[:length]


@pytest.mark.parametrize("name", FILES)
def test_every_reader_reads_what_is_there_of_a_file_that_is_cut_off(run: Path, name: str) -> None:
    data, table = (run / name).read_bytes(), next((x for x in LAYOUTS if x.file_name == name), None)
    for part in cuts(data):
        (run / name).write_bytes(part)
        if table is None:
            read = load_run(run)
            told = read.remarks
            if name == EVENTS:
                assert len(read.events) >= part.count(b"\n")
        else:
            columns, remark = read_table(run / name, table)
            told = () if remark is None else (remark,)
            assert len(columns["time_s"]) == max(len(part) - len(table.header()), 0) // table.row_bytes
        is_whole = name == EVENTS and (not part or part.endswith(b"\n") or part + b"\n" == data)
        is_whole |= name in (SUMMARY, f"{INPUTS}/{INDEX}") and part + b"\n" == data
        is_whole |= name in (MISSION, f"{INPUTS}/1-seen.csv")  # the rest may well be a mission, or a shorter file
        assert is_whole or len(told) >= 1
    (run / name).unlink()
    assert load_run(run).remarks


@pytest.mark.parametrize("name", FILES)
def test_figures_follow_from_what_is_there(run: Path, name: str) -> None:
    data = (run / name).read_bytes()
    parts = list(cuts(data))
    for part in random.Random(name).sample(parts, min(len(parts), 8)):
        (run / name).write_bytes(part)
        read = evaluated(run)
        assert read.figures.keys() >= {"flown_peak_speed_m_s", "centre_error_rms_m"}
        assert read.span_s[0] <= read.span_s[1]


@pytest.mark.parametrize("name", FILES)
def test_a_report_shows_what_is_there_and_says_what_is_not(
    run: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    data = (run / name).read_bytes()
    (run / name).write_bytes(data[: int(len(data) * random.Random(name).uniform(0.1, 0.9))])
    assert report(run) == 0
    told = capsys.readouterr().err.splitlines()
    assert told[-1].startswith("report: ")
    remarks = [line.partition(f"fg-gcs: {run}: ")[2] for line in told[:-1]]
    page = (run / "report.html").read_text()
    assert ("What is not here" in page) == bool(remarks)
    assert not any("cannot be shown" in remark for remark in remarks)


HEADERS = [
    "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }",
    "{'descr': [('time_s', '|O')], 'fortran_order': False, 'shape': (3,), }",
    "{'descr': [('time_s', '<f8'), ('late_s', '<f8')], 'fortran_order': False, 'shape': (-3,), }",
    "{'descr': [('time_s', '<f8'), ('late_s', '<f8')], 'fortran_order': False, 'shape': (10**9,), }",
    "{'descr': [('time_s', '<f8'), ('late_s', '<f8')], 'fortran_order': False, 'shape': (3, 10), }",
    "{'descr': [('time_s', '<f8'), ('late_s', '<f8')], 'fortran_order': False, 'shape': ('3',), }",
    "{'descr': [('time_s', '<f8'), ('late_s', '|S8')], 'fortran_order': False, 'shape': (3,), }",
    "{'descr': [('time_s', '<f8'), ('late_s', '<f8', (2,))], 'fortran_order': False, 'shape': (3,), }",
    "{'descr': [('time_s', '|S0')], 'fortran_order': False, 'shape': (3,), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (), }",
    "{'descr': [], 'fortran_order': False, 'shape': (3,), }",
    "__import__('os').system('false')",
    "(" * 5000,
    "[" * 90 + "]" * 90,
    "{'descr': '\\d', 'fortran_order': False, 'shape': (3,), }",
    "lambda: 1",
    "",
    "\\0" * 10,
]


@pytest.mark.parametrize("header", HEADERS)
@pytest.mark.parametrize("version", [b"\x01\x00", b"\x02\x00", b"\xff\xff"])
def test_hostile_headers_are_a_remark(tmp_path: Path, header: str, version: bytes) -> None:
    ticks = next(layout for layout in LAYOUTS if layout.name == "ticks")
    path, text = tmp_path / "ticks.npy", header.encode() + b"\n"
    path.write_bytes(b"\x93NUMPY" + version + len(text).to_bytes(2, "little") + text + bytes(48))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        columns, remark = read_table(path, ticks)
    assert not len(columns["time_s"])
    assert remark is not None
    assert remark.startswith("ticks.npy: not a table of ticks: ")
    assert "\n" not in remark


def test_counts_that_are_absurd_give_the_rows_that_are_there(run: Path) -> None:
    path = run / TELEMETRY.file_name
    data = path.read_bytes()
    rows = len(np.load(path))
    at = TELEMETRY.count_offset
    path.write_bytes(data[:at] + b"9" * 18 + b"  " + data[at + 20 :])
    columns, remark = read_table(path, TELEMETRY)
    assert len(columns["time_s"]) == rows
    assert remark == f"telemetry.npy: cut off: {rows} of {'9' * 18} rows are there"


@pytest.mark.parametrize("foreign", ["another table", "text", "pickle", "folder", "noise"])
def test_foreign_files_are_a_remark(run: Path, foreign: str) -> None:
    path = run / TELEMETRY.file_name
    if foreign == "another table":
        path.write_bytes((run / TRUTH.file_name).read_bytes())
    elif foreign == "pickle":
        np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    elif foreign == "folder":
        path.unlink()
        path.mkdir()
    else:
        path.write_bytes(b"just text" if foreign == "text" else random.Random(1).randbytes(5000))
    (remark,) = write_report(run).remarks
    assert remark.startswith("telemetry.npy: ")


def test_rows_of_an_older_version_lack_a_column_and_are_read(run: Path) -> None:
    path = run / SIGHTINGS.file_name
    rows = np.load(path)
    kept = [name for name in rows.dtype.names if name != "position_enu_m"]
    np.save(path, np.array(rows[kept].tolist(), dtype=[(name, rows.dtype[name]) for name in kept]))
    columns, remark = read_table(path, SIGHTINGS)
    assert remark == "sightings.npy: the column position_enu_m is missing"
    assert columns["verdict"].tolist() == rows["verdict"].astype(str).tolist()
    assert np.isnan(columns["position_enu_m"]).all()


def test_impossible_times_are_left_out(run: Path) -> None:
    path = run / TELEMETRY.file_name
    rows = np.load(path)
    rows["time_s"][:3] = (np.nan, 1e300, -np.inf)
    np.save(path, rows)
    (remark,) = write_report(run).remarks
    assert remark == "telemetry.npy: 3 rows with an impossible time are left out"


STRANGE = [
    None,
    True,
    -1,
    1e308,
    10**400,
    "text",
    [],
    [1],
    [[1]],
    {},
    {"a": 1},
    {"hold": [1, "2"]},
    "\ud800",
    [None] * 3,
]


@pytest.mark.parametrize("value", STRANGE)
def test_summaries_of_any_type_are_read(run: Path, value: object) -> None:
    good = json.loads((run / SUMMARY).read_text())
    for key in [*good, "recording_failure"]:
        (run / SUMMARY).write_text(json.dumps({**good, key: value}))
        read = evaluated(run)
        assert read.figures
        assert read.bands or not read.stages
        assert len(read.remarks) <= 2


@pytest.mark.parametrize("value", [None, 10**400, "\ud800", {"hold": [1, "2"]}])
def test_summaries_of_nothing_but_strange_values_make_a_report(run: Path, value: object) -> None:
    good = json.loads((run / SUMMARY).read_text())
    (run / SUMMARY).write_text(json.dumps(dict.fromkeys(good, value)))
    assert not any("cannot be shown" in remark for remark in write_report(run).remarks)


@pytest.mark.parametrize(
    "text", ["", "[1]", "{", "[" * 100_000, "1" * 5000, "NaN", '{"stages": {"hold": [NaN, 1e999]}}']
)
def test_damaged_summaries_are_a_remark(run: Path, text: str) -> None:
    (run / SUMMARY).write_text(text)
    read = evaluated(run)
    assert read.figures
    assert read.remarks[0].startswith("summary.json: ")


def test_a_folder_that_is_no_run_is_refused_in_one_line(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "nowhere", Path(__file__)):
        with pytest.raises(RunError, match=r"not the folder of a recorded run: .+") as raised:
            report(folder)
        assert "\n" not in str(raised.value)


def test_runs_of_older_versions_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "telemetry.npz").write_bytes(b"PK")
    (tmp_path / SUMMARY).write_text("{}")
    with pytest.raises(RunError, match="an older version of fg-gcs recorded it"):
        load_run(tmp_path)


def test_a_report_that_cannot_be_written_leaves_the_one_that_is_there(run: Path) -> None:
    path = write_report(run).path
    before = path.read_bytes()
    (run / ".report.html.draft").mkdir()
    with pytest.raises(MissionError, match="the report cannot be written: "):
        report(run)
    assert path.read_bytes() == before


def test_a_run_carried_elsewhere_gives_the_same_report(whole: Path, tmp_path: Path) -> None:
    copies = [copytree(whole, place) for place in (tmp_path / whole.name, tmp_path / "elsewhere" / "renamed")]
    one, two = (write_report(folder).path.read_bytes() for folder in copies)
    assert one == two


@pytest.mark.parametrize("name", ["../../summary.json", "/etc/passwd", "..", "", "a\0b", 7, None])
def test_copies_of_inputs_are_looked_for_in_their_folder_only(run: Path, name: object) -> None:
    (run / INPUTS / INDEX).write_text(json.dumps({"seen.csv": name}))
    read = load_run(run)
    assert read.mission is None
    assert len(read.remarks) == 1
    assert "seen.csv" in read.remarks[0]
    assert str(run) not in read.remarks[0]


FOREIGN = ("missing", "cut", "cut again", "folder", "loop", "empty", "noise", "huge header")


def spoil(path: Path, how: str, chance: random.Random) -> None:
    """Put something else where a file of a run should be."""
    data = path.read_bytes()
    path.unlink()
    match how:
        case "cut" | "cut again":
            path.write_bytes(data[: 1000 * chance.randrange(len(data) // 1000 + 1)])
        case "folder":
            path.mkdir()
        case "loop":
            path.symlink_to(path)
        case "empty":
            path.touch()
        case "noise":
            path.write_bytes(chance.randbytes(5000))
        case "huge header":
            path.write_bytes(b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65_535 + data[-2000:])


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave plotly's own megabytes out of the page: a hundred reports would spend their time on them."""
    monkeypatch.setattr("fg_gcs.record.report.html.get_plotlyjs", lambda: "")


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("name", FILES)
def test_whole_reports_of_damaged_folders_end_with_what_is_there_or_with_one_line(
    whole: Path, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for how in FOREIGN:
        folder = copytree(whole, tmp_path / how / whole.name)
        spoil(folder / name, how, random.Random(f"{name} {how}"))
        code = main(["report", str(folder)])
        told = capsys.readouterr().err.splitlines()
        assert code == 0, (how, told)
        assert told[-1] == f"report: {folder / 'report.html'}"
        remarks = [line for line in told[:-1] if line.startswith(f"fg-gcs: {folder}: ")]
        assert len(remarks) == len(told) - 1
        is_unseen = how.startswith("cut") or (how == "empty" and name == EVENTS)  # a cut may fall between two lines
        assert remarks or is_unseen, how
        assert not any("cannot be shown" in line for line in remarks), remarks


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("how", FOREIGN)
def test_a_report_of_nothing_but_damage_ends_with_one_line_or_shows_that_there_is_nothing(
    whole: Path, how: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copytree(whole, tmp_path / whole.name)
    for name in FILES:
        spoil(folder / name, how, random.Random(f"all {name} {how}"))
    code = main(["report", str(folder)])
    told = capsys.readouterr().err.splitlines()
    assert code == (2 if how == "missing" else 0), told
    assert len(told) == 1 if code else told[-1].startswith("report: ")


@pytest.mark.parametrize("name", FILES)
def test_a_pipe_in_the_place_of_a_file_is_not_waited_for(whole: Path, name: str, tmp_path: Path) -> None:
    folder = tmp_path / whole.name
    copytree(whole, folder)
    (folder / name).unlink()
    os.mkfifo(folder / name)
    named = Path(name).name.removeprefix("1-")  # the copy of a file is told by the name that the mission has for it
    wanted = "seen.csv" if name.startswith(INPUTS) else named
    assert any(wanted in remark for remark in load_run(folder).remarks), load_run(folder).remarks
