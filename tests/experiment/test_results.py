from __future__ import annotations

import csv
import itertools
import re
from pathlib import Path

import pytest

from fg_gcs.console.cli import EXPERIMENTS, main
from fg_gcs.experiment import drawings
from fg_gcs.experiment.flights import fly
from fg_gcs.experiment.formulations import formulations
from fg_gcs.experiment.published import LENGTHS_M
from fg_gcs.experiment.results import ExperimentResult, Picture, experiments, write_page, write_tables
from fg_gcs.experiment.scenes import TARGETS, printed_rows, scene
from fg_gcs.experiment.sensitivity import sensitivity
from fg_gcs.experiment.table1 import table1
from fg_gcs.experiment.tables import Column, ResultTable

SMALL = ResultTable(
    "small",
    "A small table",
    "What it shows.",
    (Column("name"), Column("length [m]", 1), Column("time [s]", timed=True)),
    (("one, two", 1.25, 0.012345), ("none", None, 123.4)),
)


def quiet(_line: str) -> None:
    """Tell nobody."""


def test_csv_and_page_hold_the_same_digits() -> None:
    rows = list(csv.reader(SMALL.csv().splitlines()))
    assert rows == [["name", "length [m]", "time [s]"], ["one, two", "1.2", "0.012"], ["none", "", "120"]]
    assert SMALL.markdown().splitlines()[1:] == [
        "| --- | ---: | ---: |",
        "| one, two | 1.2 | 0.012 |",
        "| none | - | 120 |",
    ]


def test_the_page_holds_every_table_and_links_what_is_there(tmp_path: Path) -> None:
    result = ExperimentResult((SMALL,), (Picture("face", "A face."),))
    write_tables(result.tables, tmp_path)
    page = write_page([result], tmp_path).read_text()
    assert SMALL.markdown() in page
    assert SMALL.text in page
    links = re.findall(r"\]\(((?:results|figures)/[^)]+)\)", page)
    assert links == ["results/small.csv", "figures/face.png", "figures/face.svg"]
    assert (tmp_path / links[0]).read_text() == SMALL.csv()


def test_the_command_line_names_the_experiments_that_there_are(tmp_path: Path) -> None:
    assert {*experiments(lambda: 0.0, quiet, tmp_path), "all"} == set(EXPERIMENTS)


def test_published_here_and_ours_stand_in_one_row() -> None:
    rows = {(str(row[0]), str(row[1])): row[2:5] for row in table1(quiet).rows}
    assert len(rows) == 3 * len(LENGTHS_M)
    published, here, ours = rows["50,50,50", "FG"]
    assert published == 345.0
    assert isinstance(here, float)
    assert isinstance(ours, float)
    assert 335.0 < ours <= 340.0
    assert rows["50,50,50", "LS beta=0"][2] is None


def test_sensitivity_sums_up_its_rows() -> None:
    looks = itertools.count()
    summary, lines = sensitivity(lambda: float(next(looks)), quiet, printed_rows()[30:33], 4)
    assert len(lines.rows) == 3
    named = {str(row[0]): row for row in summary.rows}
    assert float(str(named["ours: printed rows"][4])) > 0.999  # the worst metric
    assert named["ours: fresh draws"][1] == 4.0
    assert named["ours: fresh draws"][5] == 1.0  # one look at the watch to the next
    assert named["published: printed rows"][4] == min(row.flux_metric for row in printed_rows()[30:33])


def test_both_formulations_stand_under_each_other_for_every_scene() -> None:
    looks = itertools.count()
    table = formulations(lambda: float(next(looks)), quiet, 2, 1)
    assert [row[1] for row in table.rows] == ["rigid", "free"] * (len(TARGETS) + 1)
    titles = [column.title for column in table.columns]
    named = {(str(row[0]), str(row[1])): dict(zip(titles, row, strict=True)) for row in table.rows}
    for scene_name in [*(scene(target).name for target in TARGETS), "2 draws"]:
        rigid, free = named[scene_name, "rigid"], named[scene_name, "free"]
        assert free["path length [m]"] == pytest.approx(rigid["path length [m]"], rel=0.02)
        assert rigid["separation"] == pytest.approx(1.0)
        assert 0.95 <= float(str(free["separation"])) < 1.0
        for row in (rigid, free):
            assert float(str(row["flux metric"])) >= 0.999
            assert (row["search [s]"], row["whole plan [s]"]) == (1.0, 2.0)  # looks at the watch


def test_the_same_flight_gives_the_same_bytes(tmp_path: Path) -> None:
    flight = fly(scene((10.0, 10.0, 10.0)), lambda: 0.0)
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        for name, figure in (("curves", drawings.draw_curves(flight)), ("flight", drawings.draw_flight(flight))):
            drawings.save(figure, tmp_path / folder, name)
    names = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert names == ["curves.png", "curves.svg", "flight.png", "flight.svg"]
    for name in names:
        first = (tmp_path / "one" / name).read_bytes()
        assert first == (tmp_path / "two" / name).read_bytes()
        assert len(first) < 300_000


def test_the_command_shows_its_table_to_people_and_writes_it_for_programs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["experiment", "multi", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert said.out == ""
    assert "Several targets" in said.err
    rows = list(csv.DictReader((tmp_path / "results" / "multi.csv").read_text().splitlines()))
    assert [row["what"] for row in rows] == ["paper's way here", "ours"]
    assert float(rows[1]["path length [m]"]) < float(rows[0]["path length [m]"])


def test_a_folder_that_cannot_be_written_is_one_line_and_bad_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken").write_text("a file")
    assert main(["experiment", "multi", "--out", str(tmp_path / "taken")]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"fg-gcs: --out {tmp_path / 'taken'}: ")
