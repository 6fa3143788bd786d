import json
import re
from collections.abc import Mapping
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from plotly.offline import get_plotlyjs

from fg_gcs.record.evaluate.evaluation import evaluated
from fg_gcs.record.report.charts import acceleration_chart, lateness_chart, speed_chart, thinned
from fg_gcs.record.report.report import write_report
from fg_gcs.record.report.scene import along, scene
from fg_gcs.record.write.layouts import SETPOINTS, TELEMETRY, TICKS
from fg_gcs.record.write.recorder import EVENTS, MISSION, SUMMARY
from tests.record.flights import SUMMARY as FIGURES
from tests.record.flights import write_run

NAME = "2026-02-03T04-05-06-circle"
HOSTILE = '<script>alert(1)</script><img src=x onerror=alert(2)> & \\"</td>'
CHARTS = {"paths", "speed", "acceleration", "face", "separation", "tracking", "lateness"}


class Page(HTMLParser):
    """A report as a browser would take it apart."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.size = path.stat().st_size
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.scripts: list[str] = []
        self.rows: list[list[str]] = []
        self.styles: list[str] = []  # of the rows
        self.text = ""
        self._inside = ""
        self.feed(path.read_text(encoding="utf-8").replace(get_plotlyjs(), "plotly"))
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._inside = tag
        self.tags.append(tag)
        self.attributes += attrs
        if tag == "tr":
            self.rows.append([])
            self.styles.append(dict(attrs).get("class") or "")
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside in ("td", "th"):
            self.rows[-1][-1] += data
        if self._inside == "script":
            self.scripts[-1] += data
        elif self._inside != "style":
            self.text += data

    def row(self, name: str) -> list[str]:
        return next(row[1:] for row in self.rows if row and row[0] == name)

    def charts(self) -> set[str]:
        return {value or "" for key, value in self.attributes if key == "id"}


def report(tmp_path: Path, changes: Mapping[str, object] | None = None) -> Page:
    return Page(write_report(write_run(tmp_path / NAME, changes=changes)).path)


def test_the_report_tells_what_was_asked_and_what_was_flown(tmp_path: Path) -> None:
    page = report(tmp_path)
    assert "Completed" in page.text
    assert "Five vehicles on a circle" in page.text
    assert "Tuesday, 03 February 2026, 04:05:06" in page.text
    assert page.charts() == CHARTS
    assert page.row("Vehicles landed and disarmed") == ["5", "", "5 of 5", "✓"]
    assert page.row("Highest speed") == ["≤ 10 m/s", "9.98 m/s", "9.87 m/s", "✓"]
    assert page.row("Highest acceleration") == ["≤ 4 m/s²", "3.97 m/s²", "4.11 m/s²", "✓ 2.8 % above"]
    assert page.row("Smallest separation") == ["≥ 1.5 m", "2.22 m", "2.15 m", "✓"]
    assert page.row("Flux metric at the hold (1 is best)") == ["", "1.000", "0.987", ""]
    assert page.row("Tracking error, root mean square") == ["", "", "0.123 m", ""]
    assert page.row("Tracking error, largest") == ["", "", "0.456 m", ""]
    assert page.row("Setpoints for the vehicle served worst") == ["40 Hz", "", "39.9 Hz", "✓"]
    assert page.row("Lateness of 99 % of the setpoints") == ["< 25 ms", "", "1.75 ms", "✓"]
    assert page.row("Searching the path") == ["12.3 ms"]
    assert page.row("Bytes that were no MAVLink") == ["17"]
    assert page.row("Stage: approach") == ["4.00 s"]
    assert not any("for developers" in cell for row in page.rows for cell in row)
    assert "if a vehicle stops hearing us" not in page.text  # a run of before that was computed


def test_the_report_tells_what_was_computed_of_vehicles_that_hear_nothing_any_more(tmp_path: Path) -> None:
    page = report(tmp_path, {"min_fault_separation_m": 0.63, "vanished_separation_m": 1.234})
    assert page.row("Smallest separation if a vehicle stops hearing us") == ["≥ 0.5 m", "0.63 m", "", ""]
    assert page.row("Smallest separation if this program is gone") == ["≥ 0.5 m", "1.23 m", "", ""]


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("Vehicles landed and disarmed", {"vehicles_landed": 4}),
        ("Highest speed", {"flown_peak_speed_m_s": 10.6}),
        ("Highest acceleration", {"flown_peak_acceleration_m_s2": 4.3}),
        ("Smallest separation", {"flown_min_separation_m": 1.4999}),
        ("Setpoints for the vehicle served worst", {"setpoint_rate_hz": 30.0}),
        ("Lateness of 99 % of the setpoints", {"setpoint_late_p99_ms": 26.0}),
    ],
)
def test_what_was_not_kept_gets_a_cross(tmp_path: Path, name: str, changes: dict[str, object]) -> None:
    page = report(tmp_path, changes)
    crossed = [row[0] for row in page.rows if row and row[-1].startswith("✗")]
    assert crossed == [name]


@pytest.mark.parametrize("key", [key for key, value in FIGURES.items() if isinstance(value, float)])
def test_what_was_not_measured_is_left_open(tmp_path: Path, key: str) -> None:
    page = report(tmp_path, {key: None})
    assert any("-" in row[1:] for row in page.rows)
    assert not any(row[-1].startswith("✗") for row in page.rows if row)
    assert not any("nan" in cell.lower() or "None" in cell for row in page.rows for cell in row)


def test_an_aborted_flight_says_why(tmp_path: Path) -> None:
    page = report(tmp_path, {"completed": False, "reason": "stopped by SIGINT", "lost": [1, 2, 3, 5]})
    assert "Aborted: stopped by SIGINT" in page.text
    assert "lost: vehicles 1-3, 5" in page.text
    assert "Completed" not in page.text
    assert ("class", "bad") in page.attributes


def test_faults_are_red_and_what_many_vehicles_say_at_once_is_one_row(tmp_path: Path) -> None:
    folder = write_run(tmp_path / NAME)
    lines = [
        {"time_s": 5.0 + 0.01 * k, "kind": "text", "text": f"vehicle {k}: Armed", "severity": 6} for k in (1, 2, 3)
    ]
    lines += [{"time_s": 7.5, "kind": "text", "text": "vehicle 2: Armed", "severity": 6}]
    lines += [{"time_s": 8.0, "kind": "fault", "text": "vehicle 2 lost"}]
    lines += [{"time_s": 9.0, "kind": "text", "text": "vehicle 1: Motor failure", "severity": 2}]
    lines += [{"time_s": 9.5, "kind": "warning", "text": "not put back"}]
    (folder / EVENTS).write_text("\n".join(json.dumps(line) for line in lines))
    page = Page(write_report(folder).path)
    told = [(row[2], style) for row, style in zip(page.rows, page.styles, strict=True) if len(row) == 3]
    assert told == [
        ("what", ""),
        ("vehicles 1-3: Armed", ""),
        ("vehicle 2: Armed", ""),
        ("vehicle 2 lost", "fault"),
        ("vehicle 1: Motor failure", "fault"),
        ("not put back", "care"),
    ]


def test_hostile_text_stays_text(tmp_path: Path) -> None:
    plain = Page(write_report(write_run(tmp_path / "plain", "harmless", ("harmless",))).path)
    hostile_run = write_run(tmp_path / f"{NAME}<b>", HOSTILE, (HOSTILE.replace('\\"', '"'),))
    summary = json.loads((hostile_run / SUMMARY).read_text())
    summary |= {"completed": False, "reason": HOSTILE, "mission": HOSTILE}
    (hostile_run / SUMMARY).write_text(json.dumps(summary))
    hostile = Page(write_report(hostile_run).path)
    assert hostile.tags == plain.tags
    assert {key for key, _ in hostile.attributes} == {key for key, _ in plain.attributes}
    assert hostile.text.count("<script>alert(1)</script>") == 2 + 2  # description, reason, fault, text
    assert not any("alert(" in script for script in hostile.scripts)


def test_the_report_needs_no_network(tmp_path: Path) -> None:
    page = report(tmp_path)
    names = {key for key, _ in page.attributes}
    assert not names & {"src", "href", "data", "action", "srcset", "onerror", "onload"}
    assert not {"link", "iframe", "img", "object", "embed", "base", "form"} & set(page.tags)
    assert page.scripts[0] == "plotly"
    assert not any(re.search(r"https?://|//cdn|\bfetch\(|XMLHttpRequest", script) for script in page.scripts)
    assert all('"showSendToCloud": false' in script for script in page.scripts if "newPlot" in script)
    policy = next(value or "" for key, value in page.attributes if key == "content")
    assert "default-src 'none'" in policy
    assert page.size < 8e6


def test_the_same_run_gives_the_same_bytes(tmp_path: Path) -> None:
    folder = write_run(tmp_path / NAME)
    first = write_report(folder).path.read_bytes()
    assert write_report(folder).path.read_bytes() == first


def test_empty_tables_and_an_empty_summary_make_a_report(tmp_path: Path) -> None:
    folder = write_run(tmp_path / NAME, flown=False)
    assert Page(write_report(folder).path).charts() == set()
    (folder / SUMMARY).write_text("{}")
    (folder / EVENTS).write_text("")
    (folder / MISSION).write_text("nothing")
    page = Page(write_report(folder).path)
    assert "Aborted: no reason was written down" in page.text
    assert "no vehicle took off" in page.text
    assert "too few positions" in page.text


@pytest.mark.parametrize("samples", [1, 2, 3, 11])
def test_a_few_samples_make_a_report(tmp_path: Path, samples: int) -> None:
    folder = write_run(tmp_path / NAME)
    for layout in (TELEMETRY, SETPOINTS, TICKS):
        path = folder / layout.file_name
        np.save(path, np.load(path)[:samples])
    assert "paths" in Page(write_report(folder).path).charts()


@pytest.mark.parametrize("stage", ["gather", "approach", "hold", "home", "land"])
def test_a_flight_cut_short_makes_a_report(tmp_path: Path, stage: str) -> None:
    folder = write_run(tmp_path / NAME, changes={"completed": False, "reason": "cut"})
    summary = json.loads((folder / SUMMARY).read_text())
    begin_s = summary["stages"][stage][0]
    summary["stages"] = {name: span for name, span in summary["stages"].items() if span[0] < begin_s}
    (folder / SUMMARY).write_text(json.dumps(summary))
    lines = (folder / EVENTS).read_text().splitlines()
    (folder / EVENTS).write_text("\n".join(line for line in lines if json.loads(line)["time_s"] < begin_s))
    page = Page(write_report(folder).path)
    assert page.charts() >= CHARTS - {"tracking"}
    assert f"Stage: {stage}" not in [row[0] for row in page.rows]


def test_unknown_positions_and_lost_vehicles_make_a_report(tmp_path: Path) -> None:
    folder = write_run(tmp_path / NAME, changes={"lost": [2]})
    path = folder / TELEMETRY.file_name
    columns = np.load(path)
    for name in ("position_enu_m", "velocity_enu_m_s", "height_m"):
        columns[name][::7] = np.nan
    columns["position_enu_m"][columns["system_id"] == 4] = np.nan
    kept = (columns["system_id"] != 2) | (columns["time_s"] < 6.0)
    np.save(path, columns[kept])
    assert {"paths", "speed", "lateness"} <= Page(write_report(folder).path).charts()


@pytest.mark.parametrize("seed", range(20))
def test_thinning_keeps_every_peak_and_dip(seed: int) -> None:
    random = np.random.default_rng(seed)
    values = random.normal(size=int(random.integers(1, 5000)))
    values[random.random(len(values)) < 0.1] = np.nan
    points = 2 * int(random.integers(1, 800))
    keep = thinned(values, points)
    assert len(keep) <= points
    assert np.array_equal(keep, np.unique(keep))
    assert (keep[0] >= 0) & (keep[-1] < len(values))
    if np.isfinite(values).any():
        assert np.nanmax(values[keep]) == np.nanmax(values)
        assert np.nanmin(values[keep]) == np.nanmin(values)


@pytest.mark.parametrize("seed", range(10))
def test_paths_are_thinned_evenly_along_their_way(seed: int) -> None:
    random = np.random.default_rng(seed)
    waits = np.repeat(np.cumsum(random.normal(size=(300, 3)), axis=0), random.integers(1, 40, size=300), axis=0)
    chosen = along(waits, 100)
    assert 2 <= len(chosen) <= 100
    assert np.array_equal(chosen[0], waits[0])
    assert np.array_equal(chosen[-1], waits[-1])
    whole = np.linalg.norm(np.diff(waits, axis=0), axis=1)
    steps = np.linalg.norm(np.diff(chosen, axis=0), axis=1)
    assert steps.max() <= whole.sum() / 99 + whole.max() + 1e-9
    assert np.array_equal(along(waits[:50], 100), waits[:50])
    assert len(along(np.zeros((500, 3)), 100)) == 1  # never moved


def test_charts_show_limits_stages_and_the_flown_peaks(tmp_path: Path) -> None:
    run = evaluated(write_run(tmp_path / NAME))
    assert run.series is not None
    for chart, limit, flown in (
        (speed_chart(run), 10.0, run.series.speed_m_s),
        (acceleration_chart(run), 4.0, run.series.acceleration_m_s2),
    ):
        assert chart is not None
        lines = {trace.name: trace for trace in chart.data}
        assert lines[f"limit {limit:g}"].y == (limit, limit)
        assert tuple(chart.layout.xaxis.range) == run.span_s
        assert [note.text for note in chart.layout.annotations].count("approach") == 1
        assert [note.text for note in chart.layout.annotations].count("fault") == 1
        for row, values in enumerate(flown):
            name = f"leader {row + 1}" if row < 4 else f"vehicle {row + 1}"
            assert np.nanmax(lines[name].y) == pytest.approx(np.nanmax(values), rel=1e-6)
    lateness = lateness_chart(run)
    assert lateness is not None
    assert {trace.name for trace in lateness.data} == {"lateness", "one period 25"}


def test_the_scene_has_paths_plans_faces_pads_and_target(tmp_path: Path) -> None:
    figure = scene(evaluated(write_run(tmp_path / NAME)))
    assert figure is not None
    listed = [trace.name for trace in figure.data if trace.showlegend is not False and trace.name]
    leaders = [f"leader {i}" for i in (1, 2, 3, 4)]
    rest = ["followers", "way home", "planned paths", "face (begin, middle, hold)", "where they stood", "target"]
    assert listed == leaders + rest
    assert sum(trace.type == "mesh3d" for trace in figure.data) == 3
    view = figure.layout.scene
    axes = [(getattr(view, f"{name}axis").range, getattr(view.aspectratio, name)) for name in "xyz"]
    scales = [(high - low) / length for (low, high), length in axes]
    assert scales == pytest.approx([scales[0]] * 3)  # a metre is a metre in any direction
    for trace in figure.data:
        for values, ((low, high), _) in zip((trace.x, trace.y, trace.z), axes, strict=True):
            assert np.nanmin(values) >= low
            assert np.nanmax(values) <= high
    assert all(len(trace.x) <= 400 for trace in figure.data if trace.name != "planned paths")
