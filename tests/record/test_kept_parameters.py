"""What is kept of users' parameters survives whatever happens, and is nobody's while its run is alive."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.record.write.kept_parameters import Kept, KeptParameters, is_alive, read_kept, state_folder

numbers = st.dictionaries(st.text("ABC_", min_size=1, max_size=16), st.floats(-1e6, 1e6), max_size=4)
vehicles = st.builds(
    Kept,
    network=st.sampled_from(["main", "west"]),
    system_id=st.integers(1, 250),
    uid=st.sampled_from(["", "1f:00/..", "77"]),
    endpoint=st.sampled_from(["udpin:127.0.0.1:14550", "tcp:127.0.0.1:5760"]),
    autopilot=st.just("PX4"),
    found=numbers,
    set=numbers,
    run=st.just("logs/x"),
    lock=st.just("run-1.lock"),
)


@given(kept=vehicles)
def test_what_is_kept_comes_back_and_is_forgotten(kept: Kept, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("state") / "deep"
    with KeptParameters(folder) as parameters:
        parameters.keep(kept)
        parameters.keep(kept)
        assert read_kept(folder) == [kept]
        assert parameters.left() == [kept]  # its lock is held by nobody
        parameters.forget(kept)
        parameters.forget(kept)
        assert read_kept(folder) == []
    assert list(folder.iterdir()) == []


def test_a_run_that_is_alive_is_left_alone(tmp_path: Path) -> None:
    with KeptParameters(tmp_path) as mine:
        kept = Kept("main", 3, "", "udpin:127.0.0.1:14550", "PX4", {"A": 1.0}, {"A": 4.0}, lock=mine.lock)
        mine.keep(kept)
        with KeptParameters(tmp_path) as other:
            assert is_alive(tmp_path, kept)
            assert other.left() == []
    with KeptParameters(tmp_path) as other:
        assert other.left() == [kept]


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"found": 3}', '{"system_id": "x"}', "1e999"])
def test_files_that_say_nothing_are_passed_over(text: str, tmp_path: Path) -> None:
    (tmp_path / "broken-1.json").write_text(text)
    (tmp_path / "folder.json").mkdir()
    assert read_kept(tmp_path) == []


def test_the_folder_is_the_users_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_folder() == tmp_path / "fg-gcs"
    monkeypatch.setenv("XDG_STATE_HOME", "not/absolute")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert state_folder() == tmp_path / ".local" / "state" / "fg-gcs"
