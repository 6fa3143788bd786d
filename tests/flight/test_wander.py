"""Vehicles that wander: what shows of it on the ground and in the air, and what a flight makes of that."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.flight.wander import LOOKS_S, step_m
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.mission import Mission, parse_mission
from fg_gcs.record.write.kept_calibrations import KeptCalibrations
from fg_gcs.run.flying import FlyOptions, Outcome, RunResult, fly
from fg_gcs.run.planning import plan
from fg_gcs.run.simulators import Simulator, simulator_of, wish_of
from fg_gcs.wire.autopilots import ARDUPILOT, PX4, AutopilotProfile
from tests.flight.harness import GROUND_PORT, SMALL
from tests.plan.scenes import tops

SPACED = SMALL.replace("[takeoff]", "[pads]\nspacing_m = 8.0\n[takeoff]").replace("-30.0, 2.0]", "-30.0, 1.0]")
NOISY = '\n[simulator]\ndynamics = "measured"\ncollisions = false\nnoise_m = '


def mission_with(edge: str, noise_m: float, more: str = "") -> Mission:
    text = SPACED.replace("edge_m = 6.0", f"edge_m = {edge}").replace("separation_m = 1.5", f"separation_m = 1.0{more}")
    return parse_mission(f"{text}{NOISY}{noise_m}\n")


def flown(mission: Mission, folder: Path, state: Path | None = None) -> tuple[RunResult, float]:
    """Fly vehicles that have a simulator of their own; the closest that two of them truly came in the air [m]."""
    closest_m = np.inf

    async def look(simulator: Simulator) -> None:
        nonlocal closest_m
        while True:
            await asyncio.sleep(0.05)
            places = simulator.positions_enu_m
            if places[:, 2].max() > 0.5:
                gaps = np.linalg.norm(places[:, None] - places[None], axis=2) + np.diag(np.full(len(places), np.inf))
                closest_m = min(closest_m, float(gaps.min()))

    async def run() -> RunResult:
        simulator = simulator_of(mission, wish_of(mission), GROUND_PORT)
        async with simulator:
            looking = asyncio.ensure_future(look(simulator))
            options = FlyOptions(
                (f"udpin:127.0.0.1:{GROUND_PORT}",),
                wait_s=5.0,
                logs=folder,
                knows_origin=True,
                write_report=False,
                state=state,
            )
            try:
                return await fly(mission, options)
            finally:
                looking.cancel()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(run()), closest_m


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
    result, closest_m = flown(mission_with("3.0", 0.5), tmp_path)
    assert result.outcome is Outcome.NOT_FLOWN
    assert "the smallest edge that is safe is" in result.reason
    assert closest_m == np.inf
    assert float(str(result.summary["wander_m"])) == pytest.approx(0.5, rel=0.3)  # of four, for ten seconds


def test_an_edge_of_its_own_is_wide_enough(tmp_path: Path) -> None:
    """Vehicles truly keep the separation, and what they were seen to do is known to the next flight."""
    state = tmp_path / "state"
    result, closest_m = flown(mission_with('"auto"', 0.3), tmp_path, state)
    assert result.completed, result.reason
    assert closest_m > 1.0
    assert result.flight is not None
    assert result.flight.task is not None
    assert 2.2 < result.flight.task.edge_m < 4.0
    (name,) = KeptCalibrations(state).read()
    assert name == "PX4 1.17.0"
    assert KeptCalibrations(state).read()[name].wander_m == pytest.approx(0.3, rel=0.5)


def test_plans_say_it_beforehand() -> None:
    mission = parse_mission(SPACED)
    figures = plan(mission, 0.2, 0.02).figures
    assert figures["wander_m"] == pytest.approx(0.2)
    assert figures["edge_m"] == pytest.approx(6.0)
    smallest_m = figures["smallest_edge_m"]
    assert isinstance(smallest_m, float)
    assert 2.0 < smallest_m < 6.0
    assert "wander_m" not in plan(mission).figures


@pytest.mark.parametrize("profile", [PX4, ARDUPILOT])
def test_profiles_show_no_more_than_there_is(profile: AutopilotProfile) -> None:
    wander = profile.wander
    assert 0.0 < wander.shown_m <= np.hypot(*wander.hover_enu_m[:2])
