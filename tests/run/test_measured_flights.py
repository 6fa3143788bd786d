"""Whole flights under measured dynamics are as far off as real ones; `fg-gcs experiment measured` has all of them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.experiment.measured import COLUMNS, RealFlight, errors, measured, real_flights
from fg_gcs.mission import load_mission
from fg_gcs.run import FlyOptions, fly_blocking
from sitl_mock import profiles
from sitl_mock.physics.reference import ALL, Reference
from sitl_mock.physics.swarm import Swarm, enu_from_ned
from tests.sitl.tracking_runs import PHYSICS, command

SINGLE_RUN_M = 0.3  # the record of PX4's lag says so
CENTIMETRES_M = 0.05  # ArduPilot's worst errors are some decimetres, of one recorded flight
TESTED = (("ardupilot", "sitl"), ("px4", "convoy"))
RECORDS = {(real.autopilot, real.mission): real for real in real_flights()}


@pytest.mark.parametrize("real", [RECORDS[key] for key in TESTED], ids=["-".join(key) for key in TESTED])
def test_simulated_vehicles_are_as_far_off_as_real_ones(real: RealFlight) -> None:
    flown = errors(real, 0, stopped=False)
    assert flown.rms_m == pytest.approx(real.rms_m, rel=0.2)
    if real.autopilot == "ardupilot":
        assert flown.worst_m == pytest.approx(real.worst_m, rel=0.2, abs=CENTIMETRES_M)


def test_px4_is_stopped_on_the_circle_as_the_real_one_was() -> None:
    """Lag and noise bring two of nine closer than the mission allows, though it was planned with room."""
    real = RECORDS["px4", "circle"]
    assert real.ended == "stopped"
    assert not errors(real, 0, stopped=True).completed


def test_what_helps_px4_follow_a_circle(tmp_path: Path) -> None:
    """Setpoints of a whole flight, streamed to the measured physics: rms errors of the record.

    Within 20 %, or half of the record's own repeatability: it is one run of one vehicle, and here nine fly.
    """
    record = {(0.0, 0.0): 1.65, (0.0, 0.25): 1.06, (0.5, 0.0): 1.01, (1.0, 0.0): 0.57, (1.0, 0.15): 0.54}
    options = FlyOptions(logs=tmp_path, write_report=False)
    result = fly_blocking(load_mission(Path("missions/circle.toml")), options, speed=math.inf)
    setpoints = np.load(result.folder / "setpoints.npy")
    mine = setpoints[setpoints["system_id"] == 5]
    begin_s, end_s = (result.flight.stages[name][k] for name, k in (("gather", 0), ("home", 1)))
    time_s = np.arange(begin_s, end_s, 1.0 / 50.0)
    columns = ("position_enu_m", "velocity_enu_m_s", "acceleration_enu_m_s2")
    for (gain_per_s, lead_s), recorded_m in record.items():
        wanted = [_at(mine, name, time_s + lead_s) for name in columns]
        wanted[2] = wanted[2] + gain_per_s * wanted[1] * (1.0, 1.0, 0.0)
        planned_m = _at(mine, "position_enu_m", time_s)
        assert _rms(wanted, planned_m) == pytest.approx(recorded_m, rel=0.2, abs=0.5 * SINGLE_RUN_M)


def _at(rows: np.ndarray, name: str, time_s: np.ndarray) -> np.ndarray:
    """A column of setpoints at some times, (T, 3), north, east, down."""
    return enu_from_ned(np.stack([np.interp(time_s, rows["time_s"], rows[name][:, k]) for k in range(3)], axis=1))


def _rms(wanted: list[np.ndarray], planned_m: np.ndarray) -> float:
    """Fly nine vehicles of different luck along the same setpoints; their errors' root mean square [m]."""
    vehicles = 9
    start = np.repeat(planned_m[:1], vehicles, axis=0)
    swarm = Swarm(PHYSICS, start, 0.0, np.random.default_rng(1), profiles.flight_model("px4"))
    swarm.commands.flying[:] = True
    squares = []
    for k, target in enumerate(zip(*(array.tolist() for array in wanted), strict=True)):
        position, velocity, acceleration = (tuple(vector) for vector in target)
        for row in range(vehicles):
            reference = Reference(position, velocity, acceleration, ALL, ALL, 0.0, since_s=swarm.time_s)
            command(swarm, row, "px4", reference)
        squares.append(((swarm.estimated_position_m - planned_m[k]) ** 2).sum(axis=1).mean())
        swarm.step(2)
    return float(np.sqrt(np.mean(squares)))


def test_the_table_has_a_row_for_every_record(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = [real for real in real_flights() if (real.autopilot, real.mission) == ("ardupilot", "paper_front")]
    monkeypatch.setattr("fg_gcs.experiment.measured.real_flights", lambda: tuple(chosen))
    told: list[str] = []
    table = measured(told.append, seeds=(0,))
    assert told == ["measured: ardupilot flies paper_front"]
    (row,) = table.rows
    assert len(row) == len(COLUMNS)
    assert row[:3] == ("ardupilot", "paper_front", "completed")
    assert row[-3] == "0 of 1"
