"""Large swarms on bad links get ready and armed, and soon."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import NamedTuple

import pytest

from fg_gcs.flight.discovery import discover
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.journal import Journal
from fg_gcs.flight.preparation import Failsafes, prepare, vehicle_limits
from fg_gcs.link.endpoint import parse_networks
from fg_gcs.link.router import Router
from fg_gcs.plan.limits import Limits
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.commands import arm, set_mode
from sitl_mock.host.server import Simulator, SimulatorOptions
from tests.flight.harness import GROUND_PORT
from tests.flight.meddling import Judge, MeddlingLoop, lossy


class Times(NamedTuple):
    """How long a swarm took, since the first of its heartbeats could be heard [s]."""

    heard_s: float
    ready_s: float
    safe_s: float  # limits known and failsafes set: it may be armed
    armed_s: float


def armed(folder: Path, autopilot: str, count: int, judge: Judge) -> Times:
    """Get a swarm ready and armed in virtual time."""

    async def run() -> Times:
        loop = asyncio.get_running_loop()
        pads = tuple((3.0 * (number % 10), 3.0 * (number // 10)) for number in range(count))
        ids = tuple(range(1, count + 1))
        options = SimulatorOptions(
            autopilot=autopilot, pads_enu_m=pads, system_ids=ids, remotes=(("127.0.0.1", GROUND_PORT),)
        )
        networks = parse_networks((f"udpin:127.0.0.1:{GROUND_PORT}",))
        router = await Router.open(networks)
        keeping = asyncio.create_task(router.keep_alive())
        try:
            async with Simulator(options) as simulator:
                with Recorder(folder, "", loop.time(), 0.0) as recorder:
                    journal = Journal(recorder, loop.time)
                    wanted = tuple(VehicleAddress(MAIN, system_id) for system_id in ids)
                    fleet = Fleet(router, await discover(router, networks, count, wanted, 10.0, journal))
                    times_s = [loop.time()]
                    await prepare(fleet, journal)
                    times_s.append(loop.time())
                    await vehicle_limits(fleet, Limits(8.0, 4.0), journal)
                    await Failsafes(fleet, journal).set()
                    times_s.append(loop.time())
                    await fleet.ask(fleet.vehicles, lambda vehicle: [set_mode(vehicle.profile.waiting_mode), arm()])
                    times_s.append(loop.time())
                    assert simulator.armed.all()
                    return Times(*times_s)
        finally:
            keeping.cancel()
            await asyncio.gather(keeping, return_exceptions=True)
            router.close()

    with asyncio.Runner(loop_factory=lambda: MeddlingLoop(judge)) as runner:
        return runner.run(run())


@pytest.mark.parametrize(("autopilot", "count", "loss"), [("px4", 100, 0.1), ("ardupilot", 50, 0.2)])
def test_a_large_swarm_on_a_bad_link_is_ready_soon_and_armed(
    autopilot: str, count: int, loss: float, tmp_path: Path
) -> None:
    times = armed(tmp_path, autopilot, count, lossy(1, loss))
    assert times.ready_s < 10.0
    assert times.armed_s < times.ready_s + 20.0
