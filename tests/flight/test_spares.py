"""More vehicles than are needed: who does not become ready to arm is passed over; where all are needed nobody is."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from fg_gcs.flight.director import Director, FlightResult, Setup
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.link.endpoint import parse_networks
from fg_gcs.record.write.recorder import Recorder
from sitl_mock import parse_fault
from sitl_mock.faults.schema import FaultOptions
from sitl_mock.host.server import Simulator, SimulatorOptions
from tests.flight.harness import GROUND_PORT, mission_of

BLIND = parse_fault({"kind": "gps_loss", "vehicles": [1]})  # from its boot on, for good
REFUSING = parse_fault(
    {"kind": "commands_refused", "command": "set_mode", "text": "Flight mode change failed", "vehicles": [1]}
)


def flown(folder: Path, autopilot: str, fault: FaultOptions, spares: int) -> tuple[FlightResult, str]:
    """Fly four of some vehicles of which the first one is never ready; return the flight, and what was said."""
    mission = mission_of(folder)
    pads = [(x, y) for x, y in mission.pads_enu_m().tolist()]
    pads += [(30.0 + 3.0 * spare, 0.0) for spare in range(spares)]

    async def fly() -> FlightResult:
        options = SimulatorOptions(
            autopilot=autopilot,
            pads_enu_m=tuple(pads),
            system_ids=tuple(range(1, len(pads) + 1)),
            remotes=(("127.0.0.1", GROUND_PORT),),
            faults=(fault,),
        )
        setup = Setup(
            parse_networks((f"udpin:127.0.0.1:{GROUND_PORT}",)), 5.0, simulated=False, stopwatch=time.perf_counter
        )
        with Recorder(folder, mission.text, asyncio.get_running_loop().time(), 0.0) as recorder:
            async with Simulator(options) as simulator:
                await asyncio.sleep(15.0)  # until its estimator has given up
                result = await Director(mission, setup, recorder).fly()
                assert not simulator.armed.any()
        return result

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(fly()), (folder / "events.jsonl").read_text()


@pytest.mark.parametrize(
    ("autopilot", "fault", "told"),
    [
        ("px4", BLIND, "not ready to arm within 90 s: vehicle 1 (no reason given)"),
        ("ardupilot", REFUSING, "vehicle 1 did not change its mode: denied (Flight mode change failed)"),
    ],
)
def test_one_that_does_not_become_ready_is_passed_over_for_another_one(
    autopilot: str, fault: FaultOptions, told: str, tmp_path: Path
) -> None:
    result, events = flown(tmp_path, autopilot, fault, 1)
    assert result.completed, result.reason
    assert [vehicle.system_id for vehicle in result.vehicles] == [2, 3, 4, 5]
    assert f"{told}; others fly instead" in events
    assert "vehicles 2-5 fly; vehicle 1 does not become ready to arm" in events


def test_where_all_are_needed_the_flight_is_refused_with_its_reasons(tmp_path: Path) -> None:
    result, _ = flown(tmp_path, "px4", BLIND, 0)
    assert result.reason == "not ready to arm within 90 s: vehicle 1 (no reason given)"
    assert [vehicle.system_id for vehicle in result.vehicles] == [1, 2, 3, 4]
    assert result.vehicles_landed == 0
