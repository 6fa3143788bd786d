"""Large swarms on bad links get ready and armed, and soon."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import NamedTuple

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import VehicleError
from fg_gcs.flight.discovery import discover
from fg_gcs.flight.failsafes import Failsafes
from fg_gcs.flight.fleet import Fleet, until
from fg_gcs.flight.journal import Journal
from fg_gcs.flight.preparation import prepare, vehicle_limits
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.link.endpoint import parse_networks
from fg_gcs.link.router import Router
from fg_gcs.plan.limits import Limits
from fg_gcs.record.write.kept_parameters import Kept, KeptParameters, read_kept
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.commands import arm, set_mode
from sitl_mock.host.server import Simulator, SimulatorOptions
from tests.flight.harness import GROUND_PORT
from tests.flight.meddling import Datagram, Judge, MeddlingLoop, lossy

COMMAND_LONG = dialect.MAVLINK_MSG_ID_COMMAND_LONG


class Connected(NamedTuple):
    """A swarm on the ground that was found."""

    fleet: Fleet
    journal: Journal
    simulator: Simulator


@asynccontextmanager
async def connected(folder: Path, autopilot: str, count: int) -> AsyncIterator[Connected]:
    """Start a swarm, and find it."""
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
                found = await discover(router, networks, count, wanted, 10.0, journal)
                yield Connected(Fleet(router, found), journal, simulator)
    finally:
        keeping.cancel()
        await asyncio.gather(keeping, return_exceptions=True)
        router.close()


class Times(NamedTuple):
    """When a swarm came how far, since it was switched on [s]."""

    heard_s: float
    ready_s: float
    safe_s: float  # limits known and failsafes set: it may be armed
    armed_s: float


def armed(folder: Path, autopilot: str, count: int, judge: Judge) -> Times:
    """Get a swarm ready and armed in virtual time."""

    async def run() -> Times:
        time = asyncio.get_running_loop().time
        async with connected(folder, autopilot, count) as (fleet, journal, simulator):
            times_s = [time()]
            await prepare(fleet, journal)
            times_s.append(time())
            vehicle_limits(fleet, Limits(8.0, 4.0), journal)
            await Failsafes(fleet, journal, None).set()
            times_s.append(time())
            await fleet.ask(fleet.vehicles, lambda vehicle: [set_mode(vehicle.profile.waiting_mode), arm()])
            times_s.append(time())
            assert simulator.armed.all()
            return Times(*times_s)

    with asyncio.Runner(loop_factory=lambda: MeddlingLoop(judge)) as runner:
        return runner.run(run())


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_who_stands_in_the_mode_for_landing_can_fly_again(autopilot: str, tmp_path: Path) -> None:
    """PX4 is not ready to be armed there, and stays there when it was told to land after it had landed."""

    async def run() -> None:
        async with connected(tmp_path, autopilot, 3) as (fleet, journal, _):
            await fleet.ask(fleet.vehicles[1:], lambda vehicle: [set_mode(vehicle.profile.land_mode)])
            await until(lambda: [v for v in fleet.vehicles[1:] if v.prearm_ok], 5.0, "cease to be ready")
            await prepare(fleet, journal)
            assert all(vehicle.prearm_ok for vehicle in fleet.vehicles)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(run())


@pytest.mark.parametrize(
    ("uid", "port", "own"),
    [
        ("", GROUND_PORT, True),
        ("000000025349544c", GROUND_PORT, True),
        ("00000002ffffffff", GROUND_PORT, False),
        ("000000025349544c", 9999, True),  # it has moved
        ("", 9999, False),
    ],
)
def test_what_a_crash_left_is_put_back_onto_no_other_hardware(uid: str, port: int, own: bool, tmp_path: Path) -> None:
    state, name = tmp_path / "state", "FS_GCS_ENABLE"

    async def run() -> tuple[float, list[Kept], str]:
        async with connected(tmp_path, "ardupilot", 2) as (fleet, journal, simulator):
            parameters = simulator.fleet.vehicles[1].autopilot.parameters
            parameters.write(name, 5.0, 9)
            await prepare(fleet, journal)
            with KeptParameters(state) as kept:
                failsafes = Failsafes(fleet, journal, kept)
                await failsafes.set()
                during = [one for one in read_kept(state) if one.run != "logs/gone"]
                await failsafes.put_back()
            journal.recorder.flush()
            return parameters[name], during, (tmp_path / "events.jsonl").read_text()

    with KeptParameters(state) as crashed:
        where = f"udpin:127.0.0.1:{port}"
        crashed.keep(Kept("main", 2, uid, where, "ArduPilot", {name: 2.0}, {name: 5.0}, "logs/gone", "gone.lock"))
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        value, during, events = runner.run(run())
    assert value == (2.0 if own else 5.0)
    assert {one.system_id: one.uid for one in during} == {1: "000000015349544c", 2: "000000025349544c"}
    assert [one.uid for one in read_kept(state)] == ([] if own else [uid])
    assert ("of other hardware" in events) is (uid.endswith("ffff"))


def test_vehicles_left_in_the_streaming_mode_become_ready_again(tmp_path: Path) -> None:
    """As after a flight that their own failsafe ended: without setpoints PX4 is never ready there."""

    async def run() -> float:
        async with connected(tmp_path, "px4", 4) as (fleet, journal, _):
            await prepare(fleet, journal)
            await fleet.ask(fleet.vehicles, lambda vehicle: [set_mode(vehicle.profile.streaming_mode)])
            await until(lambda: [vehicle for vehicle in fleet.vehicles if vehicle.prearm_ok], 5.0, "be unready")
            began_s = journal.time()
            await prepare(fleet, journal)
            await fleet.ask(fleet.vehicles, lambda vehicle: [arm()])
            return journal.time() - began_s

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        assert runner.run(run()) < 5.0


def test_nothing_is_asked_of_vehicles_that_somebody_else_has_armed_but_their_streams(tmp_path: Path) -> None:
    asked: list[bytes] = []

    def judge(datagram: Datagram) -> list[float]:
        if datagram.outbound and datagram.message_id == COMMAND_LONG and b"\xb0\x00" in datagram.data[10 + 28 :]:
            asked.append(datagram.data)  # 176: DO_SET_MODE
        return [0.001]

    async def run() -> None:
        async with connected(tmp_path, "ardupilot", 3) as (fleet, journal, _):
            await fleet.ask(fleet.vehicles[1:2], lambda vehicle: [set_mode(vehicle.profile.streaming_mode)])
            await until(lambda: [v for v in fleet.vehicles if journal.time() < 5.0], 10.0, "wait")
            await fleet.ask(fleet.vehicles[1:2], lambda vehicle: [arm()])
            asked.clear()
            with pytest.raises(VehicleError, match="armed already, by another ground station: vehicle 2"):
                await prepare(fleet, journal)

    with asyncio.Runner(loop_factory=lambda: MeddlingLoop(judge)) as runner:
        runner.run(run())
    assert not asked


@pytest.mark.parametrize(("autopilot", "count", "loss"), [("px4", 100, 0.1), ("ardupilot", 50, 0.2)])
def test_a_large_swarm_on_a_bad_link_is_ready_soon_and_armed(
    autopilot: str, count: int, loss: float, tmp_path: Path
) -> None:
    times = armed(tmp_path, autopilot, count, lossy(1, loss))
    assert times.ready_s < 10.0
    assert times.armed_s < times.ready_s + 20.0
