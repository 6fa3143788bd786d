import gc
import json
from collections.abc import Iterator
from datetime import datetime
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.record.write.recorder import EVENTS, MISSION, SUMMARY, TLOG, Recorder, make_folder, plain
from fg_gcs.record.write.table import load

NOW = datetime(2026, 2, 3, 4, 5, 6)
LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text()
VALUES = st.recursive(LEAVES, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20)


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


def test_everything_is_written_with_times_since_the_start(tmp_path: Path) -> None:
    heard = []
    with Recorder(tmp_path, "# as flown\n", start_s=50.0, epoch_s=1e9) as recorder:
        recorder.listener = lambda *event: heard.append(event)
        recorder.event(51.25, "fault", "vehicle 1 lost", vehicles=(1,), height_m=float("nan"))
        recorder.event(52.0, "text", "line\nbreak")
        recorder.frame(b"\xfd123", 53.0)
        recorder.telemetry.append(range(11))
        recorder.finish({"flux": float("nan"), "rate": np.float64(50.0), "log": tmp_path})
    assert heard == [(1.25, "fault", "vehicle 1 lost"), (2.0, "text", "line\nbreak")]
    events = [strict(line) for line in (tmp_path / EVENTS).read_text().splitlines()]
    assert events == [
        {"time_s": 1.25, "kind": "fault", "text": "vehicle 1 lost", "vehicles": [1], "height_m": None},
        {"time_s": 2.0, "kind": "text", "text": "line\nbreak"},
    ]
    assert strict((tmp_path / SUMMARY).read_text()) == {"flux": None, "rate": 50.0, "log": str(tmp_path)}
    assert (tmp_path / TLOG).read_bytes() == int((1e9 + 3.0) * 1e6).to_bytes(8, "big") + b"\xfd123"
    assert (tmp_path / MISSION).read_text() == "# as flown\n"
    assert load(tmp_path / "telemetry.npz")["position_enu_m"].tolist() == [[2.0, 3.0, 4.0]]
    assert len(load(tmp_path / "setpoints.npz")["time_s"]) == len(load(tmp_path / "ticks.npz")["time_s"]) == 0


def test_events_are_on_disk_at_once(tmp_path: Path) -> None:
    with Recorder(tmp_path, "", 0.0, 0.0) as recorder:
        recorder.event(1.0, "abort", "the last words")
        assert "the last words" in (tmp_path / EVENTS).read_text()


def flights_that_fail(folder: Path) -> Iterator[Recorder]:
    with Recorder(folder, "", 0.0, 0.0) as recorder:
        recorder.frame(b"\xfdabc", 1.0)
        yield recorder
        raise RuntimeError("a bug")


def test_files_are_closed_when_the_flight_raises(tmp_path: Path) -> None:
    flight = flights_that_fail(tmp_path)
    recorder = next(flight)
    with pytest.raises(RuntimeError, match="a bug"):
        next(flight)
    assert (tmp_path / TLOG).read_bytes().endswith(b"\xfdabc")
    with pytest.raises(ValueError, match="closed"):
        recorder.frame(b"more", 2.0)
    with pytest.raises(ValueError, match="closed"):
        recorder.event(2.0, "text", "more")


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_nothing_stays_open_when_a_file_cannot_be_created(tmp_path: Path) -> None:
    (tmp_path / EVENTS).mkdir()
    with pytest.raises(IsADirectoryError):
        Recorder(tmp_path, "", 0.0, 0.0)
    gc.collect()  # an open file would warn here
