"""Vehicles that hit each other or the ground are found by the truth, told, and have flown for the last time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from sitl_mock import SimulatorOptions, parse_fault
from tests.sitl.driver import AP_LAND, ARM, GUIDED, LOITER, OFFBOARD, PX4_LAND, Station, ready
from tests.sitl.virtual import World

STREAM_MODES = {"px4": OFFBOARD, "ardupilot": GUIDED}
BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])


def two_in_the_air(autopilot: str) -> Station:
    station = ready(autopilot, vehicles=2)
    for k in range(2):
        station.fly_to(6.0, vehicle=k)
        if k == 0 and autopilot == "px4":
            station.mode(LOITER)  # stays, without a stream
    station.setpoint((0.0, 0.0, -6.0), mask=0x9F8)
    station.mode(STREAM_MODES[autopilot])
    return station


@BOTH
def test_two_that_are_sent_to_one_place_collide(autopilot: str) -> None:
    station = two_in_the_air(autopilot)
    middle = (0.0, 1.5, -6.0)
    assert not station.fleet.incidents.found

    def both(_: float) -> None:
        for k in range(2):
            station.setpoint(middle, mask=0x9F8, vehicle=k)

    station.run(6.0, both)
    incident = station.fleet.incidents.found[0]
    assert incident.kind == "collision"
    assert incident.vehicles == (1, 2)
    assert incident.position_enu_m == pytest.approx((1.5, 0.0, 6.0), abs=0.4)
    assert incident.closing_m_s > 0.2
    assert len(incident.speeds_m_s) == 2
    assert "vehicles 1 and 2 collided" in str(incident)
    closest = station.fleet.incidents.closest
    assert closest is not None
    assert closest.distance_m <= 0.5
    # Both fall, and never fly again, whatever they are told
    assert not station.vehicle(0).armed
    assert not station.vehicle(1).armed
    station.run(3.0, both)
    assert max(station.height_m(k) for k in range(2)) < 0.1
    for parameters in ((1,), (1, 2989)):
        assert station.command(ARM, *parameters) == [1 if autopilot == "px4" else 4]
    assert any("rash" in text for text in station.texts())


@BOTH
def test_a_fall_is_a_strike(autopilot: str) -> None:
    station = Station(autopilot, faults=(parse_fault({"kind": "motor_dead", "at_s": 18.0}),))
    station.run(2.0)
    station.fly_to(6.0)
    station.run(6.0, lambda _: station.setpoint((0.0, 0.0, -6.0), mask=0x9F8))
    (incident,) = station.fleet.incidents.found
    assert (incident.kind, incident.vehicles) == ("ground_strike", (1,))
    assert incident.position_enu_m[2] == pytest.approx(0.0, abs=0.2)
    assert incident.closing_m_s == pytest.approx(np.sqrt(2 * 9.8 * 6.0), rel=0.4)
    assert "hit the ground" in str(incident)


@BOTH
def test_a_landing_is_none(autopilot: str) -> None:
    station = ready(autopilot)
    station.fly_to(6.0)
    station.mode(PX4_LAND if autopilot == "px4" else AP_LAND)
    station.run(25.0)
    assert not station.autopilot.armed
    assert not station.fleet.incidents.found
    assert station.fleet.incidents.closest is None  # there were never two


def test_neighbours_on_the_ground_are_no_collision() -> None:
    here = World(SimulatorOptions(pads_enu_m=((0.0, 0.0), (0.2, 0.0)), port_base=18570))
    here.run(2.0)
    assert not here.simulator.fleet.incidents.found
    here.close()


def test_the_truth_is_written_down(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    fault = parse_fault({"kind": "dead", "at_s": 3.0, "vehicles": [2]})
    here = World(SimulatorOptions(pads_enu_m=((0.0, 0.0), (3.0, 0.0)), port_base=18570, faults=(fault,), truth=path))
    here.run(1.0)
    swarm = here.simulator.fleet.swarm
    swarm.position_m[:, 2] = -20.0
    here.run(4.0)
    told = json.loads(path.read_text())
    assert [incident["kind"] for incident in told["incidents"]] == ["ground_strike", "ground_strike"]
    here.close()
    told = json.loads(path.read_text())
    assert told["closest"]["vehicles"] == [1, 2]
    assert told["closest"]["distance_m"] == pytest.approx(3.0, abs=0.01)


def test_harmless_collisions_are_told_once_and_hurt_nobody() -> None:
    """Ghosts: a pair that stays close has met once; after it has parted it can meet again."""
    pads = ((0.0, 0.0), (3.0, 0.0))
    here = World(SimulatorOptions(pads_enu_m=pads, port_base=18570, collisions=False))
    here.run(2.0)
    swarm, incidents = here.simulator.fleet.swarm, here.simulator.fleet.incidents
    for gap_m, met in ((0.3, 1), (0.2, 1), (2.0, 1), (0.3, 2)):
        swarm.position_m[:] = ((0.0, 0.0, -50.0), (0.0, gap_m, -50.0))
        swarm.velocity_m_s[:] = 0.0
        here.run(0.2)
        assert len(incidents.found) == met
    assert not any(vehicle.autopilot.wrecked for vehicle in here.simulator.fleet.vehicles)
    here.close()
