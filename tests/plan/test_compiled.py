from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

import fg_gcs
from fg_gcs import compiling
from fg_gcs.compiling import ROOMS, cache_folder, sources_hash
from fg_gcs.plan import trajectory
from fg_gcs.plan.compiled import build, is_built
from fg_gcs.plan.path import rigid_path
from fg_gcs.plan.search import rigid
from fg_gcs.plan.timing import profile, time_optimal
from tests.plan import scenes

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
    scenes.compiled()
    assert [kernel.signatures for kernel in kernels] == before


def test_machine_code_is_kept_in_the_folder_of_its_sources() -> None:
    build()
    assert list(cache_folder().rglob("rigid.search-*.nbi"))


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package with the same modules, whose text is their name: somebody may edit the real ones meanwhile."""
    for module in PACKAGE.rglob("*.py"):
        copy = tmp_path / module.relative_to(PACKAGE)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text(module.stem)
    return tmp_path


@pytest.mark.parametrize("changed", ["core/kernels.py", "plan/path/splines.py", "track/follow/axes.py", "compiling.py"])
def test_other_sources_have_another_folder(changed: str, package: Path) -> None:
    before = sources_hash(package)
    assert sources_hash(package) == before
    (package / changed).write_text((package / changed).read_text() + "# another line")
    assert sources_hash(package) != before


def test_a_source_that_moves_or_goes_has_another_folder(package: Path) -> None:
    before = sources_hash(package)
    (package / "core" / "kernels.py").rename(package / "core" / "nuts.py")
    moved = sources_hash(package)
    (package / "core" / "nuts.py").unlink()
    assert len({before, moved, sources_hash(package)}) == 3


def test_what_is_not_compiled_changes_nothing(package: Path) -> None:
    before = sources_hash(package)
    (package / "console" / "cli.py").write_text("")
    assert sources_hash(package) == before


def test_all_compiled_code_is_in_the_rooms_whose_sources_count() -> None:
    compiled = {path.relative_to(PACKAGE).parts[0] for path in PACKAGE.rglob("*.py") if "@kernel" in path.read_text()}
    assert compiled == {*ROOMS, "experiment"}  # those of experiment are in one file, whose changes the compiler sees


def test_folders_that_nothing_was_written_to_for_days_are_dropped(tmp_path: Path) -> None:
    folders = {name: tmp_path / f"kernels-cpython-{name}" for name in ("own", "fresh", "old")}
    for folder in folders.values():
        folder.mkdir()
    os.utime(folders["own"], (1.0, 1.0))
    os.utime(folders["old"], (1.0, 1.0))
    compiling._drop_unused(folders["own"])  # noqa: SLF001 # what opening a folder does to its neighbours
    assert [name for name, folder in folders.items() if folder.exists()] == ["own", "fresh"]
