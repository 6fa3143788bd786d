"""The flights that must hold, whole, in virtual time, in both autopilots' behaviour."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.console.cli import main
from fg_gcs.core.coverage import flux_metric
from fg_gcs.link.counters import Counters
from fg_gcs.record.evaluate.tracking import KEYS
from tests.flight.harness import AUTOPILOTS, SMALL, Flight, fly, mission_of

MISSIONS = Path(__file__).parents[2] / "missions"


@pytest.mark.parametrize(("mission", "autopilot"), [("paper_front", "px4"), ("paper_behind", "ardupilot")])
def test_the_papers_flights(mission: str, autopilot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["fly", str(MISSIONS / f"{mission}.toml"), "--speed", "max", "--json"]
    code = main([*arguments, "--autopilot", autopilot, "--logs", str(tmp_path)])
    flown = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == 0
    assert flown["completed"] is True
    assert flown["vehicles_landed"] == 9
    assert flown["peak_speed_m_s"] <= 10.0
    assert flown["peak_acceleration_m_s2"] <= 5.0
    assert flown["flown_flux_metric"] >= 0.99
    assert flown["gate"] == {"changed": 0, "braked": 0, "held_back": 0, "reasons": {}}
    assert flown["tracking_rms_m"] <= 0.3
    assert flown["tracking_max_m"] <= 1.0
    assert flown["flown_peak_speed_m_s"] <= 10.1
    assert flown["flown_peak_acceleration_m_s2"] <= 5.25
    assert flown["flown_min_separation_m"] >= 1.5
    assert flown["setpoint_rate_hz"] >= 20.0
    assert min(flown["frames_in"], flown["frames_out"]) > 10_000
    assert all(flown[key] == 0 for key in Counters._fields if not key.startswith("frames"))
    assert (flown["replans"], flown["sightings"], flown["sightings_rejected"], flown["found_again_s"]) == (0, 0, {}, [])
    assert all(flown[key] is None for key in (*KEYS, "replan_median_ms", "replan_p99_ms"))
    folder = Path(flown["log"])
    files = {
        "flight.tlog",
        "events.jsonl",
        "telemetry.npy",
        "setpoints.npy",
        "mission.toml",
        "parameters.json",
        "report.html",
    }
    assert files <= {path.name for path in folder.iterdir()}


def test_the_demo_flies_too(tmp_path: Path) -> None:
    assert main(["fly", str(MISSIONS / "demo.toml"), "--speed", "max", "--logs", str(tmp_path)]) == 0


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_the_simulators_own_state_says_the_target_is_surrounded(autopilot: str, tmp_path: Path) -> None:
    """Independent of telemetry, frames and figures: a wrong sign on the way could not cancel here."""
    seen: list[float] = []

    async def look(flight: Flight) -> None:
        for stage in ("hold", "home"):
            await flight.reaches(stage)
            plan = flight.director.result.plan
            assert plan is not None
            rim = flight.simulator.positions_enu_m[plan.rim_of]
            seen.append(float(flux_metric(rim[None], np.array([-6.0, 10.0, 12.0]))[0]))

    flight = fly(tmp_path, autopilot, look)
    assert flight.result is not None
    assert flight.result.completed
    assert min(seen) >= 0.95  # GPS origins of PX4 are off by decimetres, as the real ones are
    assert not flight.simulator.armed.any()
    assert flight.simulator.positions_enu_m[:, 2] == pytest.approx(np.zeros(4), abs=0.05)
    assert flight.truth_separation_m >= 1.4


def test_several_targets_are_flown_around_by_a_formation_that_grows(tmp_path: Path) -> None:
    points = [[-6.0, 10.0, 14.0], [-8.0, 12.0, 15.0], [-7.0, 9.0, 13.0]]
    keys = f'positions_enu_m = {points}\nsource = "charges"\nweights = [2.0, 1.0, 1.0]'
    rims: list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]] = []

    async def look(flight: Flight) -> None:
        await flight.reaches("home")
        plan = flight.director.result.plan
        assert plan is not None
        rims.append(flight.simulator.positions_enu_m[plan.rim_of])

    mission = mission_of(tmp_path, SMALL.replace("position_enu_m = [-6.0, 10.0, 12.0]", keys))
    flight = fly(tmp_path, "px4", look, mission)
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    target = mission.task().target
    assert target.centre_enu_m.tolist() == [-6.75, 10.25, 14.0]
    centre = rims[0].mean(axis=0)
    assert np.linalg.norm(centre - target.centre_enu_m) <= 0.25 + 0.6  # the hold's depth, GPS and tracking
    middles = 0.5 * (rims[0] + np.roll(rims[0], -1, axis=0))
    assert np.linalg.norm(middles - centre, axis=1) == pytest.approx(np.full(3, target.radius_m), abs=0.5)
    assert flight.truth_separation_m >= 1.4


@pytest.mark.parametrize(("autopilot", "jerk_m_s3"), [("px4", np.inf), ("ardupilot", 5.0)])
def test_the_free_formulation_flies_too_within_the_vehicles_own_jerk(
    autopilot: str, jerk_m_s3: float, tmp_path: Path
) -> None:
    mission = mission_of(tmp_path, SMALL + '[plan]\nformulation = "free"\n')
    flight = fly(tmp_path, autopilot, mission=mission)
    result = flight.result
    assert result is not None
    assert result.completed, result.reason
    assert flight.truth_separation_m >= 1.4
    assert result.task is not None
    assert result.plan is not None
    assert result.task.rules.limits.jerk_m_s3 == jerk_m_s3
    assert result.plan.peaks.jerk_m_s3 <= jerk_m_s3
    assert ("jerk_m_s3 lowered to 5 by PSC_JERK_XY of vehicle 1" in flight.events) == (autopilot == "ardupilot")


def test_same_seed_and_mission_give_the_same_tables_byte_for_byte(tmp_path: Path) -> None:
    mission = tmp_path / "small.toml"
    mission_of(tmp_path)
    (tmp_path / "mission.toml").rename(mission)
    for name in ("one", "two"):
        assert main(["fly", str(mission), "--speed", "max", "--logs", str(tmp_path / name)]) == 0
    one, two = (next((tmp_path / name).iterdir()) for name in ("one", "two"))
    for table in ("telemetry.npy", "setpoints.npy", "ticks.npy", "flight.tlog"):
        assert (one / table).read_bytes() == (two / table).read_bytes(), table
    assert len((one / "telemetry.npy").read_bytes()) > 10_000


def test_a_flight_in_wind_still_comes_home(tmp_path: Path) -> None:
    flight = fly(tmp_path, "px4", wind_m_s=5.0)
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_failsafes_are_set_for_the_flight_and_put_back_after_it(autopilot: str, tmp_path: Path) -> None:
    name, found, wanted = {"px4": ("COM_OBL_RC_ACT", 0.0, 4.0), "ardupilot": ("FS_GCS_ENABLE", 0.0, 5.0)}[autopilot]
    during: list[float] = []

    async def look(flight: Flight) -> None:
        await flight.reaches("hold")
        fleet = flight.director.fleet
        assert fleet is not None
        during.extend(vehicle.params[name] for vehicle in fleet.vehicles)

    flight = fly(tmp_path, autopilot, look)
    assert during == [wanted] * 4
    assert flight.director.fleet is not None
    assert [vehicle.params[name] for vehicle in flight.director.fleet.vehicles] == [found] * 4
    assert f"{name} = {found:g}, set to {wanted:g} for this flight" in flight.events
