"""Everything that may go wrong in flight: whatever happens, nothing hangs and everybody comes down."""

from __future__ import annotations

import asyncio
import random
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.errors import LinkError, PlanError
from tests.flight.harness import AUTOPILOTS, GROUND_PORT, SMALL, Flight, OtherStation, fly, mission_of


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("stage", ["prepare", "take-off", "gather", "approach", "hold", "home", "land"])
def test_stopped_in_any_stage_everybody_is_brought_down(stage: str, autopilot: str, tmp_path: Path) -> None:
    async def stop(flight: Flight) -> None:
        await flight.reaches(stage)
        await asyncio.sleep(0.7)
        flight.director.interrupt("stopped by a test")

    flight = fly(tmp_path, autopilot, stop)
    assert flight.result is not None
    assert not flight.result.completed
    assert flight.result.reason == "stopped by a test"
    assert flight.down_and_disarmed
    assert flight.truth_separation_m >= 1.4
    assert not flight.result.lost


def test_stopped_twice_lands_on_the_spot(tmp_path: Path) -> None:
    async def stop(flight: Flight) -> None:
        await flight.reaches("hold")
        flight.director.interrupt("first")
        await asyncio.sleep(3.0)
        flight.director.interrupt("second")

    flight = fly(tmp_path, "px4", stop)
    assert flight.down_and_disarmed
    assert "landing apart from each other: second" in flight.events
    away = np.linalg.norm(flight.simulator.positions_enu_m[:, :2] - np.array([-6.0, 10.0]), axis=1)
    assert away.max() < 12.0


@pytest.mark.parametrize("stage", ["prepare", "take-off", "approach", "land"])
def test_a_simulator_that_dies_is_reported_and_nothing_hangs(stage: str, tmp_path: Path) -> None:
    ended: list[float] = []

    async def kill(flight: Flight) -> None:
        await flight.reaches(stage)
        await asyncio.sleep(0.5)
        ended.append(asyncio.get_running_loop().time())
        await flight.simulator.close()

    flight = fly(tmp_path, "px4", kill)
    assert flight.result is not None
    assert not flight.result.completed
    assert [vehicle.label for vehicle in flight.result.lost] == [1, 2, 3, 4] or stage == "prepare"
    last = flight.result.stages["prepare" if stage == "prepare" else stage][1]
    assert last - ended[0] < 130.0


def test_random_bytes_at_the_port_are_dropped_and_counted(tmp_path: Path) -> None:
    sent: list[int] = []

    async def shout(flight: Flight) -> None:
        await flight.reaches("prepare")
        await asyncio.sleep(0.1)  # until we have spoken: PX4 takes the first sender for its ground station, for good
        draw = random.Random(3)
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(asyncio.DatagramProtocol)
        while True:
            noise = draw.randbytes(draw.randrange(1, 300))
            transport.sendto(noise, ("127.0.0.1", GROUND_PORT))
            for port in flight.simulator.ports:
                transport.sendto(noise, ("127.0.0.1", port))
            sent.append(len(noise))
            await asyncio.sleep(0.1)

    flight = fly(tmp_path, "px4", shout)
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    assert flight.result.counters is not None
    assert flight.result.counters.bad_bytes > 0.5 * sum(sent)


def test_a_second_ground_station_hears_telemetry_and_nothing_of_our_dialogues(tmp_path: Path) -> None:
    heard: list[OtherStation] = []

    async def listen(flight: Flight) -> None:
        heard.append(await OtherStation.open())

    flight = fly(tmp_path, "px4", listen, shared=True)
    assert flight.result is not None
    assert flight.result.completed
    assert sorted(heard[0].addresses) == [1, 2, 3, 4]
    assert heard[0].acknowledgements == 0


def test_nobody_there(tmp_path: Path) -> None:
    async def close_at_once(flight: Flight) -> None:
        await flight.simulator.close()

    with pytest.raises(LinkError, match=r"no vehicle answered within 5 s at udpin:127\.0\.0\.1:14550"):
        fly(tmp_path, "px4", close_at_once)


def test_a_mission_that_the_real_pads_make_impossible_arms_nobody(tmp_path: Path) -> None:
    tight = mission_of(tmp_path, SMALL + "\n[pads]\nspacing_m = 1.55\n")

    async def never_armed(flight: Flight) -> None:
        while True:
            assert not flight.simulator.armed.any()
            await asyncio.sleep(0.1)

    with pytest.raises(PlanError, match="further apart"):
        fly(tmp_path, "px4", never_armed, tight)
