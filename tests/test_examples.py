"""The public face of the program: what it exports, what its page says of that, and the examples that use it."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import fg_gcs.run

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SAID = {  # what an example prints, among other things
    "fly_and_read": r"completed; 9 vehicles landed\nflux metric at the hold (1\.000|0\.99)",
    "own_motion": r"completed; caught after \d+\.\d s\ncentre off the target 0\.\d\d m rms",
    "own_sightings": r"completed\n\d{3} sightings, caught after \d\.\d s",
    "plan_and_plot": r"\d+\.\d m over all leaders in \d+\.\d s\nhighest speed [4-7]\.\d\d m/s\ndrawn: ",
    "ten_beside_another_client": r"vehicle 1: MAV_AUTOPILOT_ARDUPILOTMEGA\n(.*\n)+vehicle 10: MAV_AUTOPILOT_ARDU",
}


def test_every_example_says_what_is_expected_of_it() -> None:
    assert {path.stem for path in EXAMPLES} == set(SAID)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run_and_are_short(path: Path, tmp_path: Path) -> None:
    assert len(path.read_text().splitlines()) < 60
    done = subprocess.run(
        [sys.executable, str(path), str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=300.0,
        check=False,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(SAID[path.stem], done.stdout), done.stdout
    assert done.stderr == ""


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_use_what_is_public_alone(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(("fg_gcs", "sitl_mock")):
            assert node.module in ("fg_gcs.run", "sitl_mock")


def test_exports_exist_are_sorted_and_have_a_home() -> None:
    assert list(fg_gcs.run.__all__) == sorted(fg_gcs.run.__all__)
    for name in fg_gcs.run.__all__:
        assert getattr(fg_gcs.run, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'paln'"):
        _ = fg_gcs.run.paln


def test_every_export_is_on_the_page_about_the_library() -> None:
    page = (ROOT / "docs" / "api.md").read_text()
    for name in fg_gcs.run.__all__:
        assert re.search(rf"`(await )?{name}\b", page), name
    for field in fg_gcs.run.FlyOptions.__dataclass_fields__:
        assert f"| `{field}` |" in page, field


def test_importing_the_public_face_loads_nothing_heavy() -> None:
    script = "import sys, fg_gcs.run; print(*[m for m in ('numpy', 'numba', 'scipy', 'pydantic') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60.0)
    assert done.stdout.strip() == ""
