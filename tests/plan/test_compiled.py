from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import fg_gcs
from fg_gcs.plan import profile, rigid_path, rigid_search, timing, trajectory
from fg_gcs.plan.compiled import build, is_built
from tests.plan.scenes import compiled


def test_once_built_the_planner_is_in_its_cache_and_compiles_no_more() -> None:
    build()
    assert is_built()
    kernels = (rigid_search.search, timing._reach, profile._averaged, trajectory.look, rigid_path._rigid_points)  # noqa: SLF001 # what build() is for
    before = [kernel.signatures for kernel in kernels]
    assert all(before)
    compiled()
    assert [kernel.signatures for kernel in kernels] == before


def test_cached_code_older_than_a_source_is_dropped(tmp_path: Path) -> None:
    """In a process of its own, on a copy, so that no other test compiles again."""
    package = Path(fg_gcs.__file__).parent
    copy = tmp_path / "fg_gcs"
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("*.nbi", "*.nbc"))
    cache = copy / "plan" / "__pycache__"
    cache.mkdir(exist_ok=True)
    stale = cache / "rigid_search.search-1.py311.nbi"
    stale.write_bytes(b"")
    os.utime(stale, (1.0, 1.0))
    fresh = cache / "rigid_search.search-2.py311.nbi"
    fresh.write_bytes(b"")
    script = "from fg_gcs.plan.compiled import drop_stale, is_built; drop_stale(); print(is_built())"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True"
    assert not stale.exists()
    assert fresh.exists()
