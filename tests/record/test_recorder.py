import errno
import gc
import json
import os
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from datetime import datetime
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.record.write.layouts import SETPOINTS, TELEMETRY, TICKS
from fg_gcs.record.write.recorder import (
    BALLAST,
    EVENTS,
    INDEX,
    INPUTS,
    MISSION,
    PARAMETERS,
    SUMMARY,
    TLOG,
    UNFINISHED,
    Recorder,
    make_folder,
    plain,
)
from fg_gcs.wire.address import MAIN
from tests.record.disks import small_disk

NOW = datetime(2026, 2, 3, 4, 5, 6)
LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text()
VALUES = st.recursive(LEAVES, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20)
ROW: tuple[float | str, ...] = (1.0, MAIN, 1, *[0.0] * 9)


class Pair(NamedTuple):
    first: float
    second: Path


class Colour(Enum):
    RED = 1


def strict(text: str) -> Any:  # noqa: ANN401 - whatever a JSON text holds
    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


@given(VALUES)
def test_plain_values_are_strict_json_and_stay_as_they_are(value: object) -> None:
    once = plain(value)
    assert strict(json.dumps(once, allow_nan=False)) == once
    assert plain(once) == once


@pytest.mark.parametrize(
    ("value", "wanted"),
    [
        (np.float64(1.5), 1.5),
        (np.float32(0.5), 0.5),
        (np.int64(7), 7),
        (np.bool_(True), True),
        (float("nan"), None),
        (np.float64("inf"), None),
        (np.float32("-inf"), None),
        (np.array([[1.0, np.nan], [2.0, 3.0]]), [[1.0, None], [2.0, 3.0]]),
        (Pair(1.0, Path("a/b")), [1.0, "a/b"]),
        ({1: (2, {"x": float("inf")})}, {"1": [2, {"x": None}]}),
        (range(3), [0, 1, 2]),
        (Colour.RED, "Colour.RED"),
        (True, True),
    ],
)
def test_plain(value: object, wanted: object) -> None:
    found = plain(value)
    assert found == wanted
    assert isinstance(found, type(wanted))  # a NumPy float is a float and is written as one


def test_folders_are_named_by_time_and_mission_and_never_shared(tmp_path: Path) -> None:
    logs = tmp_path / "not" / "yet"
    made = [make_folder(logs, "demo", NOW) for _ in range(3)] + [make_folder(logs, "other", NOW)]
    stem = "2026-02-03T04-05-06"
    assert [folder.name for folder in made] == [f"{stem}-demo", f"{stem}-demo-1", f"{stem}-demo-2", f"{stem}-other"]
    assert all(folder.is_dir() and folder.parent == logs for folder in made)


def test_a_place_that_cannot_be_written_is_an_os_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        make_folder(tmp_path / "file", "demo", NOW)


@pytest.mark.parametrize("in_thread", [False, True])
def test_everything_is_written_with_times_since_the_start(tmp_path: Path, in_thread: bool) -> None:
    heard = []
    with Recorder(tmp_path, "# as flown\n", start_s=50.0, epoch_s=1e9, in_thread=in_thread) as recorder:
        recorder.listeners.append(lambda *event: heard.append(event))
        recorder.event(51.25, "fault", "vehicle 1 lost", vehicles=(1,), height_m=float("nan"))
        recorder.event(52.0, "text", "line\nbreak")
        recorder.frames([b"\xfd123"], 53.0)
        recorder.telemetry.append((0.0, MAIN, 1, *range(9)))
        summary = recorder.finish({"completed": True, "flux": float("nan"), "rate": np.float64(50.0), "log": tmp_path})
    assert heard == [(1.25, "fault", "vehicle 1 lost"), (2.0, "text", "line\nbreak")]
    events = [strict(line) for line in (tmp_path / EVENTS).read_text().splitlines()]
    assert events == [
        {"time_s": 1.25, "kind": "fault", "text": "vehicle 1 lost", "vehicles": [1], "height_m": None},
        {"time_s": 2.0, "kind": "text", "text": "line\nbreak"},
    ]
    assert strict((tmp_path / SUMMARY).read_text()) == summary
    assert (summary["completed"], summary["flux"], summary["rate"], summary["log"]) == (True, None, 50.0, str(tmp_path))
    assert (summary["recording_complete"], summary["recording_failure"], summary["recording_missing"]) == (
        True,
        None,
        {},
    )
    assert (tmp_path / TLOG).read_bytes() == int((1e9 + 3.0) * 1e6).to_bytes(8, "big") + b"\xfd123"
    assert (tmp_path / MISSION).read_text() == "# as flown\n"
    assert np.load(tmp_path / "telemetry.npy")["position_enu_m"].tolist() == [[0.0, 1.0, 2.0]]
    assert len(np.load(tmp_path / "setpoints.npy")) == len(np.load(tmp_path / "ticks.npy")) == 0
    assert not (tmp_path / BALLAST).exists()


def test_events_are_on_disk_at_once_and_rows_after_a_flush(tmp_path: Path) -> None:
    with Recorder(tmp_path, "", 0.0, 0.0) as recorder:
        recorder.event(1.0, "abort", "the last words")
        assert "the last words" in (tmp_path / EVENTS).read_text()
        recorder.ticks.append((1.0, 0.0))
        assert len(np.load(tmp_path / "ticks.npy")) == 0
        recorder.flush()
        assert np.load(tmp_path / "ticks.npy")["time_s"].tolist() == [1.0]


def test_what_is_known_is_in_the_summary_from_the_start_on(tmp_path: Path) -> None:
    with Recorder(tmp_path, "", 0.0, 0.0) as recorder:
        first = strict((tmp_path / SUMMARY).read_text())
        assert (first["completed"], first["reason"], first["run"]) == (False, UNFINISHED, tmp_path.name)
        recorder.know(leader_ids=[1, 2, 3], stages={"connect": (0.0, None)})
        assert strict((tmp_path / SUMMARY).read_text())["stages"] == {"connect": [0.0, None]}
        recorder.finish({"completed": True, "reason": ""})
    last = strict((tmp_path / SUMMARY).read_text())
    assert (last["completed"], last["reason"], last["leader_ids"]) == (True, "", [1, 2, 3])


def test_inputs_and_parameters_are_copied(tmp_path: Path) -> None:
    inputs = {"seen.csv": b"one", "../other/seen.csv": b"two", "/far/away.csv": b"three"}
    with Recorder(tmp_path, "", 0.0, 0.0, inputs) as recorder:
        recorder.parameters([{"system_id": 1, "found": {"A": 1.0, "B": float("nan")}, "set": {"A": 4.0}}])
    names = strict((tmp_path / INPUTS / INDEX).read_text())
    assert {path: (tmp_path / INPUTS / name).read_bytes() for path, name in names.items()} == inputs
    kept = strict((tmp_path / PARAMETERS).read_text())
    assert kept == {"vehicles": [{"system_id": 1, "found": {"A": 1.0, "B": None}, "set": {"A": 4.0}}]}


def flights_that_fail(folder: Path) -> Iterator[Recorder]:
    with Recorder(folder, "", 0.0, 0.0) as recorder:
        recorder.frames([b"\xfdabc"], 1.0)
        recorder.telemetry.append(ROW)
        yield recorder
        raise RuntimeError("a bug")


def test_a_flight_that_raises_leaves_everything_and_why(tmp_path: Path) -> None:
    flight = flights_that_fail(tmp_path)
    recorder = next(flight)
    with pytest.raises(RuntimeError, match="a bug"):
        next(flight)
    assert (tmp_path / TLOG).read_bytes().endswith(b"\xfdabc")
    assert len(np.load(tmp_path / "telemetry.npy")) == 1
    summary = strict((tmp_path / SUMMARY).read_text())
    assert (summary["completed"], summary["reason"]) == (False, "a bug")
    recorder.frames([b"more"], 2.0)  # what comes late is left out and raises nothing
    recorder.event(2.0, "text", "more")
    recorder.telemetry.append(ROW)
    recorder.flush()
    assert "more" not in (tmp_path / EVENTS).read_text()


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_nothing_stays_open_when_a_file_cannot_be_created(tmp_path: Path) -> None:
    (tmp_path / EVENTS).mkdir()
    with pytest.raises(IsADirectoryError):
        Recorder(tmp_path, "", 0.0, 0.0)
    gc.collect()  # an open file would warn here


# --- when something goes wrong ----------------------------------------------------------------------------------------


class Heard:
    """A listener that keeps what it hears of the recording."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def __call__(self, time_s: float, kind: str, text: str) -> None:
        if kind == "recording":
            self.texts.append(text)


def fly_on(recorder: Recorder, begin_s: int, end_s: int, size: int = 200) -> None:
    """Record some seconds of a flight: rows, frames, events and what is known."""
    for second in range(begin_s, end_s):
        for k in range(50):
            time_s = second + 0.02 * k
            recorder.telemetry.append((time_s, MAIN, k, *[float(second)] * 9))
            recorder.frames([bytes([0xFD, *[k] * size])], time_s)
        recorder.event(float(second), "text", f"second {second}")
        recorder.flush()
        recorder.know(second=second)


def test_many_rows_at_once_are_as_good_as_one_after_the_other(tmp_path: Path) -> None:
    for name in ("one", "many"):
        (tmp_path / name).mkdir()
    numbers = np.arange(40.0).reshape(4, 10)
    with Recorder(tmp_path / "one", "", 0.0, 0.0) as recorder:
        for row in numbers.tolist():
            recorder.setpoints.append((1.5, MAIN, 7, *row))
    with Recorder(tmp_path / "many", "", 0.0, 0.0) as recorder:
        rows = recorder.setpoints.rows(4)
        rows["time_s"], rows["network"], rows["system_id"] = 1.5, SETPOINTS.text("network", MAIN), 7
        rows["position_enu_m"], rows["velocity_enu_m_s"] = numbers[:, :3], numbers[:, 3:6]
        rows["acceleration_enu_m_s2"], rows["yaw_rad"] = numbers[:, 6:9], numbers[:, 9]
        recorder.setpoints.extend(rows)
        recorder.setpoints.extend(recorder.setpoints.rows(0))
    one, many = ((tmp_path / name / "setpoints.npy").read_bytes() for name in ("one", "many"))
    assert one == many


def test_rows_of_another_table_end_the_recording_and_nothing_else(tmp_path: Path) -> None:
    with Recorder(tmp_path, "", 0.0, 0.0) as recorder:
        recorder.setpoints.extend(recorder.ticks.rows(1))
        recorder.flush()
        assert recorder.failure is not None
        assert recorder.failure.text.startswith("setpoints.npy: a row does not fit its columns")


def test_a_row_that_does_not_fit_ends_the_recording_and_nothing_else(tmp_path: Path) -> None:
    heard = Heard()
    with Recorder(tmp_path, "", 0.0, 0.0) as recorder:
        recorder.listeners.append(heard)
        fly_on(recorder, 0, 2)
        recorder.telemetry.append((1.0, 2.0))
        recorder.telemetry.append((1.0, MAIN, 1, *["text"] * 9))
        fly_on(recorder, 2, 4)
        assert recorder.failure is not None
        assert recorder.failure.text.startswith("telemetry.npy: a row does not fit its columns")
        summary = recorder.finish({"completed": True, "reason": ""})
    assert len(heard.texts) == 1
    assert (tmp_path / EVENTS).read_text().count('"recording"') == 1
    assert "second 3" not in (tmp_path / EVENTS).read_text()
    assert (summary["completed"], summary["recording_complete"]) == (True, False)
    assert summary["recording_missing"] == {"telemetry.npy": 1.98, "flight.tlog": 1.98, "events.jsonl": 1.0}
    assert strict((tmp_path / SUMMARY).read_text()) == summary
    assert len(np.load(tmp_path / "telemetry.npy")) == 100


def test_what_cannot_be_put_together_ends_the_recording_and_nothing_else(tmp_path: Path) -> None:
    class Strange:
        def __str__(self) -> str:
            raise RuntimeError("no text")

    with Recorder(tmp_path, "", 0.0, 0.0) as recorder:
        recorder.event(1.0, "text", "strange", what=Strange())
        assert recorder.failure is not None
        assert recorder.failure.text == "event cannot be recorded (RuntimeError: no text)"
        recorder.know(what=Strange())
        with recorder.guard("truth"):
            raise ZeroDivisionError


def test_a_listener_that_fails_hears_no_more_and_ends_nothing(tmp_path: Path) -> None:
    heard: list[str] = []

    def failing(time_s: float, kind: str, text: str) -> None:
        raise RuntimeError("no terminal")

    with Recorder(tmp_path, "", 0.0, 0.0) as recorder:
        recorder.listeners += [failing, lambda _time_s, _kind, text: heard.append(text)]
        recorder.event(1.0, "text", "first")
        recorder.event(2.0, "text", "second")
        assert recorder.failure is None
    assert heard == ["a listener failed and hears no more: RuntimeError('no terminal')", "first", "second"]


@pytest.mark.parametrize("in_thread", [False, True])
def test_a_folder_that_is_gone_ends_the_recording_and_nothing_else(tmp_path: Path, in_thread: bool) -> None:
    folder, heard = tmp_path / "run", Heard()
    folder.mkdir()
    with Recorder(folder, "", 0.0, 0.0, in_thread=in_thread) as recorder:
        recorder.listeners.append(heard)
        fly_on(recorder, 0, 2)
        recorder.settle()
        for path in folder.iterdir():
            path.unlink()
        folder.rmdir()
        fly_on(recorder, 2, 5)
        summary = recorder.finish({"completed": True, "reason": ""})
    assert len(heard.texts) == 1
    assert "is gone" in heard.texts[0]
    assert not folder.exists()
    assert (summary["completed"], summary["recording_complete"]) == (True, False)


@pytest.mark.parametrize("in_thread", [False, True])
@pytest.mark.parametrize("kilobytes", [256, 700, 1500])
def test_a_full_disk_ends_the_recording_with_one_event_and_the_summary_says_so(
    tmp_path: Path, in_thread: bool, kilobytes: int
) -> None:
    heard = Heard()
    with small_disk(tmp_path / "disk", kilobytes) as folder:
        with Recorder(folder, "", 0.0, 0.0, in_thread=in_thread) as recorder:
            recorder.listeners.append(heard)
            fly_on(recorder, 0, 100)
            (folder / "someone else's").write_bytes(b"")
            summary = recorder.finish({"completed": True, "reason": ""})
        assert heard.texts == [f"recording stopped: {recorder.failure.text}; the flight goes on"]  # type: ignore[union-attr]
        assert os.strerror(errno.ENOSPC) in heard.texts[0]
        assert strict((folder / SUMMARY).read_text()) == summary
        assert summary["recording_complete"] is False
        events = [strict(line) for line in (folder / EVENTS).read_text().splitlines()]
        assert [event["kind"] for event in events].count("recording") == 1
        assert events[-1]["kind"] == "recording"
        missing = summary["recording_missing"]
        assert isinstance(missing, dict)
        rows = np.load(folder / "telemetry.npy")
        last_s = rows["time_s"][-1] if len(rows) else 0.0
        assert missing["telemetry.npy"] == last_s
        assert (folder / TLOG).stat().st_size % (8 + 201) == 0  # nothing but whole frames


LIMITED = """
import resource, sys
from pathlib import Path
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import MAIN
resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
with Recorder(Path(sys.argv[1]), "", 0.0, 0.0, in_thread=True) as recorder:
    for k in range(5000):
        recorder.frames([bytes(100)], k * 0.01)
        if k % 20 == 0:
            recorder.event(k * 0.01, "text", f"{k}")
            recorder.flush()
    summary = recorder.finish({"completed": True, "reason": ""})
    assert recorder.failure is not None
"""


def test_a_file_that_must_not_grow_any_more_ends_the_recording_and_nothing_else(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", LIMITED, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    summary = strict((tmp_path / SUMMARY).read_text())
    assert summary["recording_failure"]["text"] == f"flight.tlog cannot be written ({os.strerror(errno.EFBIG)})"
    assert (tmp_path / TLOG).stat().st_size <= 300_000
    assert (tmp_path / EVENTS).read_text().count('"recording"') == 1


def test_a_disk_that_does_not_keep_up_ends_the_recording_and_holds_nobody_up(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "slow")  # whoever opens it for writing waits for a reader
    heard = Heard()
    with Recorder(tmp_path, "", 0.0, 0.0, in_thread=True) as recorder:
        recorder.listeners.append(heard)
        recorder.know(first=1)
        (tmp_path / f".{SUMMARY}.draft").unlink(missing_ok=True)
        recorder.settle()
        os.mkfifo(tmp_path / f".{SUMMARY}.draft")
        recorder.know(second=2)
        for k in range(100):
            recorder.frames([bytes(200_000)], k * 0.01)
            recorder.flush()
        assert recorder.failure is not None
        assert recorder.failure.text == "the disk does not keep up"
        with (tmp_path / f".{SUMMARY}.draft").open("rb") as pipe:  # the disk is back
            assert b"second" in pipe.read()
        summary = recorder.finish({"completed": True, "reason": ""})
    assert len(heard.texts) == 1
    assert summary["recording_complete"] is False


def test_memory_does_not_grow_with_the_flight(tmp_path: Path) -> None:
    with Recorder(tmp_path, "", 0.0, 0.0) as recorder:
        tracemalloc.start()
        try:
            fly_on(recorder, 0, 20)
            gc.collect()
            before, _ = tracemalloc.get_traced_memory()
            fly_on(recorder, 20, 80)
            gc.collect()
            after, _ = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    written = 60 * 50 * (TELEMETRY.row_bytes + 209)
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) > written
    assert after - before < written / 20


def test_even_without_a_flush_little_waits_in_memory(tmp_path: Path) -> None:
    with Recorder(tmp_path, "", 0.0, 0.0) as recorder:
        for k in range(100_000):
            recorder.ticks.append((0.02 * k, 0.0))
        assert (tmp_path / TICKS.file_name).stat().st_size > 100_000 * 16 - 300_000


def test_the_same_run_gives_the_same_bytes(tmp_path: Path) -> None:
    folders = [tmp_path / "one" / "run", tmp_path / "two" / "run"]
    for folder, in_thread in zip(folders, (False, True), strict=True):
        folder.mkdir(parents=True)
        with Recorder(folder, "# flown", 0.0, 1e9, {"a.csv": b"rows"}, in_thread=in_thread) as recorder:
            fly_on(recorder, 0, 5)
            recorder.finish({"completed": True, "reason": ""})
    one, two = ({p.relative_to(f): p.read_bytes() for p in f.rglob("*") if p.is_file()} for f in folders)
    assert one == two
