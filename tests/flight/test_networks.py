"""Vehicles of several networks in one flight, some of them with the same system id."""

from __future__ import annotations

import asyncio
import time
from contextlib import AsyncExitStack
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.errors import LinkError, MissionError
from fg_gcs.flight.director import Director, FlightResult, Setup
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.link.endpoint import parse_networks
from fg_gcs.mission import Mission
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import VehicleAddress
from sitl_mock.host.server import Simulator, SimulatorOptions
from tests.flight.harness import SMALL, mission_of

IDS = 'system_ids = ["west/1", "east/1", "west/2", "east/2"]\n'
PORTS = {"east": 14550, "west": 14551}
TABLE = "[networks]\n" + "".join(f'{name} = ["udpin:127.0.0.1:{port}"]\n' for name, port in PORTS.items())
NAMED = SMALL.replace("[formation]", IDS + TABLE + "[formation]")
UNNAMED = SMALL.replace("[formation]", TABLE + "[formation]")


def flown(folder: Path, mission: Mission, connect: tuple[str, ...] = ()) -> tuple[FlightResult, list[Simulator], str]:
    """Fly a mission with two vehicles in each of two networks, their system ids 1 and 2 in both."""
    pads = [(x, y) for x, y in mission.pads_enu_m().tolist()]
    places = {"east": pads[:2], "west": pads[2:]}

    async def fly() -> tuple[FlightResult, list[Simulator]]:
        simulators = []
        async with AsyncExitStack() as stack:
            for name, port in PORTS.items():
                options = SimulatorOptions(
                    autopilot="px4", pads_enu_m=tuple(places[name]), system_ids=(1, 2), remotes=(("127.0.0.1", port),)
                )
                simulator = Simulator(options)
                await simulator.start()
                stack.push_async_callback(simulator.close)
                simulators.append(simulator)
            setup = Setup(
                parse_networks(connect or mission.connections()), 5.0, simulated=False, stopwatch=time.perf_counter
            )
            recorder = stack.enter_context(Recorder(folder, "", asyncio.get_running_loop().time(), 0.0))
            return await Director(mission, setup, recorder).fly(), simulators

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        result, simulators = runner.run(fly())
    return result, simulators, (folder / "events.jsonl").read_text()


@pytest.mark.parametrize("text", [NAMED, UNNAMED])
def test_two_networks_fly_one_mission(text: str, tmp_path: Path) -> None:
    result, simulators, events = flown(tmp_path, mission_of(tmp_path, text))
    assert result.completed, result.reason
    assert result.vehicles == tuple(VehicleAddress(name, n) for name in ("east", "west") for n in (1, 2))
    assert result.vehicles_landed == 4
    assert "vehicles east/1-2, west/1-2 answered (PX4)" in events
    assert "listening at east: udpin:127.0.0.1:14550; west: udpin:127.0.0.1:14551" in events
    assert result.counters is not None
    assert (result.counters.clashes, result.counters.unroutable) == (0, 0)
    for simulator in simulators:
        assert not simulator.armed.any()
        assert np.abs(simulator.positions_enu_m[:, 2]).max() < 0.1


@pytest.mark.parametrize(
    ("connect", "said"),
    [
        (("north=udp:14550", "east=udp:14551"), "system_ids: west/1-2 is in no network; the networks are north, east"),
        (("udp:14550",), "one network cannot have two vehicles of one id"),
    ],
)
def test_networks_that_do_not_fit_the_mission_are_told_before_anything_is_opened(
    connect: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    with pytest.raises(MissionError, match=said):
        flown(tmp_path, mission_of(tmp_path, NAMED), connect)


def test_who_is_missing_is_told_with_its_network(tmp_path: Path) -> None:
    text = NAMED.replace('"west/2"', '"west/3"')
    with pytest.raises(LinkError, match=r"only vehicles east/1-2, west/1-2 answered .* needs east/1-2, west/1, west/3"):
        flown(tmp_path, mission_of(tmp_path, text))
