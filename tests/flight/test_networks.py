"""Vehicles of several networks in one flight, some of them with the same system id."""

from __future__ import annotations

import asyncio
import time
from contextlib import AsyncExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from fg_gcs.errors import LinkError, MissionError
from fg_gcs.flight.director import Director, FlightResult, Setup
from fg_gcs.flight.fleet import Fleet
from fg_gcs.link.clock import VirtualTimeLoop, ticks
from fg_gcs.link.endpoint import PX4_PORT, PX4_PORTS, parse_networks, px4_endpoints
from fg_gcs.link.router import Router
from fg_gcs.mission import Mission
from fg_gcs.record.evaluate.evaluation import evaluated
from fg_gcs.record.report.report import write_report
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.run.summary import summary_of
from fg_gcs.wire.address import VehicleAddress
from fg_gcs.wire.commands import set_mode
from sitl_mock.host.server import Simulator, SimulatorOptions
from tests.flight.harness import SMALL, mission_of

IDS = 'system_ids = ["west/1", "east/1", "west/2", "east/2"]\n'
PORTS = {"east": 14550, "west": 14551}
TABLE = "[networks]\n" + "".join(f'{name} = ["udpin:127.0.0.1:{port}"]\n' for name, port in PORTS.items())
NAMED = SMALL.replace("[formation]", IDS + TABLE + "[formation]")
UNNAMED = SMALL.replace("[formation]", TABLE + "[formation]")


class Flown(NamedTuple):
    result: FlightResult
    summary: dict[str, object]
    simulators: list[Simulator]
    events: str
    truth_separation_m: float  # closest pair in the simulators' own state


def flown(folder: Path, mission: Mission, connect: tuple[str, ...] = ()) -> Flown:
    """Fly a mission with two vehicles in each of two networks, their system ids 1 and 2 in both."""
    pads = [(x, y) for x, y in mission.pads_enu_m().tolist()]
    places = {"east": pads[:2], "west": pads[2:]}

    async def fly() -> Flown:
        simulators: list[Simulator] = []
        closest_m: list[float] = []

        async def watch() -> None:
            async for _ in ticks(asyncio.get_running_loop().time(), 0.05):
                places = np.concatenate([simulator.positions_enu_m for simulator in simulators])
                closest_m.append(float(pdist(places).min()))

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
            recorder = stack.enter_context(Recorder(folder, mission.text, asyncio.get_running_loop().time(), 0.0))
            watching = asyncio.create_task(watch())
            stack.callback(watching.cancel)
            result = await Director(mission, setup, recorder).fly()
            summary = recorder.finish(summary_of(mission, result, recorder, result.reason))
            return Flown(result, summary, simulators, (folder / "events.jsonl").read_text(), min(closest_m))

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(fly())


@pytest.mark.parametrize("text", [NAMED, UNNAMED])
def test_two_networks_fly_one_mission(text: str, tmp_path: Path) -> None:
    result, _, simulators, events, _ = flown(tmp_path, mission_of(tmp_path, text))
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


def test_equal_ids_of_two_networks_are_not_mixed_in_figures_and_report(tmp_path: Path) -> None:
    mission = mission_of(tmp_path, NAMED)
    flight = flown(tmp_path, mission)
    summary = flight.summary
    labels = [vehicle.label for vehicle in flight.result.vehicles]
    assert labels == ["east/1", "east/2", "west/1", "west/2"]
    for key, count in (("leader_ids", 3), ("min_separation_pair", 2)):
        told = summary[key]
        assert isinstance(told, list)
        assert len(set(told) & set(labels)) == count
    assert (summary["lost"], summary["vehicles_not_down"]) == ([], [])
    assert isinstance(summary["tracking_max_m"], float)
    assert summary["tracking_max_m"] < 0.5
    assert summary["flown_min_separation_m"] == pytest.approx(flight.truth_separation_m, abs=0.1)
    assert summary["flown_flux_metric"] == pytest.approx(1.0, abs=0.05)
    assert summary["setpoint_rate_hz"] == pytest.approx(mission.stream.rate_hz, rel=0.01)
    run = evaluated(tmp_path)
    assert run.remarks == ()
    assert [leader.label for leader in run.leaders] == summary["leader_ids"]
    assert run.series is not None
    assert run.series.vehicles == flight.result.vehicles
    written = write_report(tmp_path)
    assert written.remarks == ()
    page = written.path.read_text()
    for vehicle in flight.result.vehicles:
        what = "leader" if vehicle in run.leaders else "vehicle"
        name = f"{what} {vehicle}".replace("/", "\\u002f")  # as JSON lies in a page
        assert name in page


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


def test_twelve_px4_instances_are_heard_at_their_own_ports_and_told_each_its_own() -> None:
    """Instances 9, 10 and 11 share a port, as the real ones do."""

    async def main() -> None:
        router = await Router.open(parse_networks(px4_endpoints(12)))
        async with AsyncExitStack() as stack:
            simulators = []
            for instance in range(12):
                remote = "127.0.0.1", PX4_PORT + min(instance, PX4_PORTS - 1)
                options = SimulatorOptions(system_ids=(instance + 1,), remotes=(remote,))
                simulators.append(await stack.enter_async_context(Simulator(options)))
            await asyncio.sleep(2.0)
            fleet = Fleet(router, [router.vehicles[address] for address in sorted(router.vehicles)])
            assert len(fleet.vehicles) == 12
            await fleet.ask(fleet.vehicles, lambda vehicle: [set_mode(vehicle.profile.modes["LAND"])])
            assert router.endpoint_of(VehicleAddress("main", 12)) == "udpin:127.0.0.1:14549"
            assert router.counters.clashes == 0
        router.close()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(main())
