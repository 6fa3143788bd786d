import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.errors import MissionError
from fg_gcs.plan.flight_plan import FlightPlan
from fg_gcs.plan.targets import Charges, Target
from fg_gcs.record.report.plot import plot_plan
from fg_gcs.record.report.scene import TARGET_COLOUR
from tests.plan.scenes import compiled, task

BEGINNINGS = {"png": b"\x89PNG\r\n", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.fixture(scope="module")
def plan() -> FlightPlan:
    return compiled()


@pytest.mark.parametrize("ending", sorted(BEGINNINGS))
def test_the_ending_says_the_format_and_the_same_plan_gives_the_same_bytes(
    plan: FlightPlan, tmp_path: Path, ending: str
) -> None:
    paths = [tmp_path / f"first.{ending}", tmp_path / f"second.{ending.upper()}"]
    for path in paths:
        plot_plan(plan, task(), path)
    first, second = (path.read_bytes() for path in paths)
    assert first.startswith(BEGINNINGS[ending])
    assert first == second


def test_the_drawing_names_what_it_shows(plan: FlightPlan, tmp_path: Path) -> None:
    path = tmp_path / "plan.svg"
    plot_plan(plan, task(), path)
    text = path.read_text()
    for words in ("speed [m/s]", "closest pair [m]", "flux metric", "coverage", "gather", "approach", "home", "target"):
        assert f"<!-- {words} -->" in text
    assert f"{plan.figures.path_length_m:.1f} m over all leaders" in text


def test_every_source_has_its_star(tmp_path: Path) -> None:
    stars = []
    for count in (1, 4):
        places = np.array([10.0, 10.0, 20.0]) + np.arange(count)[:, None] * np.array([1.0, -1.0, 0.5])
        made = replace(task(), target=Target(Charges(places, np.ones(count))))
        path = tmp_path / f"{count}.svg"
        plot_plan(compiled(made), made, path)
        stars.append(len(re.findall(rf"<use [^>]*fill: {TARGET_COLOUR}", path.read_text())))
    assert stars[1] - stars[0] == 3


@pytest.mark.parametrize("name", ["plan.jpg", "plan", "plan.html", ".png"])
def test_other_endings_are_refused_and_name_the_accepted_ones(plan: FlightPlan, tmp_path: Path, name: str) -> None:
    with pytest.raises(MissionError, match=r"accepted endings: \.png, \.svg, \.pdf"):
        plot_plan(plan, task(), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_is_named(plan: FlightPlan, tmp_path: Path) -> None:
    with pytest.raises(MissionError, match=r"nowhere.*No such file"):
        plot_plan(plan, task(), tmp_path / "nowhere" / "plan.png")


def test_drawing_opens_no_windows(plan: FlightPlan, tmp_path: Path) -> None:
    before = "matplotlib.pyplot" in sys.modules
    plot_plan(plan, task(), tmp_path / "plan.png")
    assert ("matplotlib.pyplot" in sys.modules) == before
