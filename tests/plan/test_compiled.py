from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import pytest

import fg_gcs
from fg_gcs import compiling
from fg_gcs.compiling import cache_folder, sources_hash
from fg_gcs.plan import trajectory
from fg_gcs.plan.compiled import build, is_built
from fg_gcs.plan.path import rigid_path
from fg_gcs.plan.search import rigid
from fg_gcs.plan.timing import profile, time_optimal
from tests.plan.scenes import compiled

PACKAGE = Path(fg_gcs.__file__).parent


def test_once_built_the_planner_is_in_its_cache_and_compiles_no_more() -> None:
    build()
    assert is_built()
    kernels: tuple[Any, ...] = (
        rigid.search,
        time_optimal._reach,  # noqa: SLF001 # what build() is for, like the next two
        profile._averaged,  # noqa: SLF001
        trajectory.extrema,
        rigid_path._rigid_points,  # noqa: SLF001
    )
    before = [kernel.signatures for kernel in kernels]
    assert all(before)
    compiled()
    assert [kernel.signatures for kernel in kernels] == before


def test_machine_code_is_kept_in_the_folder_of_its_sources() -> None:
    build()
    assert list(cache_folder().rglob("rigid.search-*.nbi"))


@pytest.mark.parametrize("changed", ["core/kernels.py", "plan/path/splines.py", "track/follow/axes.py", "compiling.py"])
def test_other_sources_have_another_folder(changed: str, tmp_path: Path) -> None:
    copy = tmp_path / "fg_gcs"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    before = sources_hash(copy)
    (copy / changed).write_bytes((copy / changed).read_bytes() + b"# another line\n")
    assert sources_hash(copy) != before


def test_what_is_not_compiled_changes_nothing(tmp_path: Path) -> None:
    copy = tmp_path / "fg_gcs"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    before = sources_hash(copy)
    (copy / "console" / "cli.py").write_text("")
    assert sources_hash(copy) == before


def test_folders_that_nothing_was_written_to_for_days_are_dropped(tmp_path: Path) -> None:
    folders = {name: tmp_path / f"kernels-cpython-{name}" for name in ("own", "fresh", "old")}
    for folder in folders.values():
        folder.mkdir()
    os.utime(folders["own"], (1.0, 1.0))
    os.utime(folders["old"], (1.0, 1.0))
    compiling._drop_unused(folders["own"])  # noqa: SLF001 # what opening a folder does to its neighbours
    assert [name for name, folder in folders.items() if folder.exists()] == ["own", "fresh"]
