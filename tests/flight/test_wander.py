"""Vehicles that wander: what shows of it on the ground and in the air, and what a flight makes of that."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.errors import PlanError
from fg_gcs.flight.wander import LOOKS_S, step_m
from fg_gcs.mission import Mission, parse_mission
from fg_gcs.record.write.kept_calibrations import KeptCalibrations
from fg_gcs.run.planning import plan
from tests.flight.harness import SMALL, fly
from tests.plan.scenes import tops

SPACED = SMALL.replace("[takeoff]", "[pads]\nspacing_m = 8.0\n[takeoff]").replace("-30.0, 2.0]", "-30.0, 1.0]")
NOISY = '\n[simulator]\ndynamics = "measured"\ncollisions = false\nnoise_m = '


def mission_with(edge: str, noise_m: float, hold_s: float = 2.0) -> Mission:
    text = SPACED.replace("duration_s = 2.0", f"duration_s = {hold_s}")
    text = text.replace("edge_m = 6.0", f"edge_m = {edge}").replace("separation_m = 1.5", "separation_m = 1.0")
    return parse_mission(f"{text}{NOISY}{noise_m}\n")


@pytest.mark.parametrize(("sigma_m", "slow_s", "white_m"), [(0.1, 4.0, 0.0), (0.1, 4.0, 0.05), (0.02, 1.0, 0.0)])
def test_the_step_is_the_wander_s_and_not_the_noise_s(sigma_m: float, slow_s: float, white_m: float) -> None:
    """First-order Gauss-Markov: E|x(t + s) - x(t)|^2 = 2 sigma^2 (1 - exp(-s / slow)) on each axis."""
    random, count = np.random.default_rng(0), 4000
    keep = np.exp(-LOOKS_S / slow_s)
    places = np.zeros((count, 8, 3))
    for k in range(1, count):
        places[k] = keep * places[k - 1] + sigma_m * np.sqrt(1.0 - keep**2) * random.standard_normal((8, 3))
    places += white_m * random.standard_normal(places.shape)
    expected = 2.0 * sigma_m * np.sqrt(np.exp(-LOOKS_S / slow_s) - np.exp(-0.5 / slow_s))
    assert np.sqrt((step_m(places) ** 2).mean()) == pytest.approx(expected, rel=0.1)


def test_who_stands_still_does_not_wander() -> None:
    assert (step_m(np.tile(tops(4), (50, 1, 1))) == 0.0).all()
    assert (step_m(np.zeros((3, 4, 3))) == 0.0).all()


def test_a_flight_that_is_too_narrow_is_refused_before_arming(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match="the smallest edge that is safe is"):
        fly(tmp_path, "px4", mission=mission_with("3.0", 0.5))
    (folder,) = tmp_path.glob("*-*/")
    assert "stage: take-off" not in (folder / "events.jsonl").read_text()
    measured_m = json.loads((folder / "summary.json").read_text())["wander_m"]
    assert measured_m == pytest.approx(0.5, rel=0.3)  # of four, for ten seconds


def test_an_edge_of_its_own_is_wide_enough(tmp_path: Path) -> None:
    """Vehicles truly keep the separation, and what they were seen to do is known to the next flight."""
    state = tmp_path / "state"
    flight = fly(tmp_path, "px4", mission=mission_with('"auto"', 0.3), state=state)
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    assert flight.truth_separation_m > 1.0
    assert flight.result.task is not None
    assert 2.2 < flight.result.task.edge_m < 4.0
    assert flight.result.plan is not None
    assert flight.result.plan.risk is not None
    assert flight.result.plan.risk.is_kept  # slowed down for faults as it is
    (name,) = KeptCalibrations(state).read()
    assert name == "PX4 1.17.0"
    assert KeptCalibrations(state).read()[name].wander_m == pytest.approx(0.3, rel=0.5)


def test_in_the_air_too_far_is_too_far(tmp_path: Path) -> None:
    """On the ground nothing was to be seen of it, and it matters in an hour, not in the seconds of watching."""
    noise = {"kind": "position_noise", "sigma_m": 0.12, "stage": "gather"}
    mission = mission_with("2.0", 0.05, hold_s=3600.0)
    flight = fly(tmp_path, "px4", mission=mission, faults=[noise])
    assert flight.result is not None
    assert "vehicles wander by" in flight.result.reason
    assert "safe" not in flight.result.reason  # what would do is no matter in the air
    assert "approach" not in flight.result.stages
    assert flight.down_and_disarmed


def test_plans_say_it_beforehand() -> None:
    mission = parse_mission(SPACED)
    figures = plan(mission, 0.2, 0.02).figures
    assert figures["wander_m"] == pytest.approx(0.2)
    assert figures["edge_m"] == pytest.approx(6.0)
    smallest_m = figures["smallest_edge_m"]
    assert isinstance(smallest_m, float)
    assert 2.0 < smallest_m < 6.0
    assert "wander_m" not in plan(mission).figures
