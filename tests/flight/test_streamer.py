"""One round of setpoints: what leaves, to whom, and what is written down of it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import Fence
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.gate import Gate, GateCounts
from fg_gcs.flight.link_recorder import LinkRecorder
from fg_gcs.flight.motions import Rest
from fg_gcs.flight.streamer import Streamer
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.link.endpoint import Endpoint, Kind
from fg_gcs.link.router import Router
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.record.write.recorder import EVENTS, TLOG, Recorder
from fg_gcs.wire.bare import boot_frames
from fg_gcs.wire.codec import Codec, Frame

PORT, RATE_HZ = 14550, 50.0
RULES = Rules(Limits(8.0, 4.0), 1.5, Fence((-99.0, -99.0, -9.0), (99.0, 99.0, 99.0)))
SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"


class Listener(asyncio.DatagramProtocol):
    """A vehicle that is known, and remembers what it hears."""

    def __init__(self, system_id: int) -> None:
        self.system_id, self.heard, self._codec = system_id, list[Frame](), Codec()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.DatagramTransport)
        for frame in boot_frames(self.system_id).values():
            transport.sendto(frame)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.heard += [frame for frame in self._codec.receive(data) if frame.get_type() == SETPOINT]


@dataclass
class Round:
    """What came of a second of streaming."""

    streamer: Streamer
    fleet: Fleet
    vehicles: list[Listener]
    table: NDArray[Any]
    tlog: list[Frame]
    events: str


def streamed(folder: Path, places_m: Array, released: Sequence[int] = ()) -> Round:
    """Let vehicles stay beside where they are, shape (V, 3)."""
    count = len(places_m)

    async def main() -> Round:
        loop = asyncio.get_running_loop()
        with Recorder(folder, "", loop.time(), 1.7e9) as recorder:
            log = LinkRecorder(recorder)
            router = await Router.open(
                {"main": [Endpoint(Kind.UDP_IN, "127.0.0.1", PORT)]}, on_frame=log.on_frame, tap=log.tap
            )
            made = [
                await loop.create_datagram_endpoint(partial(Listener, k), remote_addr=("127.0.0.1", PORT))
                for k in range(1, count + 1)
            ]
            await asyncio.sleep(0.01)
            fleet = log.fleet = Fleet(router, [router.vehicles[address] for address in sorted(router.vehicles)])
            fleet.learn_frames(None, np.zeros(2), np.zeros(3))
            streamer = Streamer(fleet, recorder, RATE_HZ, Gate(fleet, RULES))
            places = fleet.positions_enu_m() + places_m
            streamer.motion = Rest(range(count), places, np.linspace(-1.0, 1.0, count))
            streamer.engage(range(count))
            streamer.release(released)
            task = asyncio.create_task(streamer.run())
            await asyncio.sleep(0.995)
            task.cancel()
            await asyncio.sleep(0.01)
            router.close()
        tlog = Codec().receive(b"".join(_frames((folder / TLOG).read_bytes())))
        events = (folder / EVENTS).read_text()
        vehicles = [listener for _, listener in made]
        return Round(streamer, fleet, vehicles, np.load(folder / "setpoints.npy"), tlog, events)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(main())


def _frames(tlog: bytes) -> list[bytes]:
    found, place = [], 0
    while place < len(tlog):
        size = 12 + tlog[place + 9]
        found.append(tlog[place + 8 : place + 8 + size])
        place += 8 + size
    return found


def test_what_is_heard_what_is_recorded_and_what_is_wanted_are_the_same(tmp_path: Path) -> None:
    beside = 0.05 * np.arange(12.0).reshape(4, 3)
    made = streamed(tmp_path, beside, released=[2])
    places = made.fleet.positions_enu_m() + beside
    for row, vehicle in enumerate(made.vehicles):
        assert len(vehicle.heard) == (0 if row == 2 else RATE_HZ)
        for frame in vehicle.heard:
            said = frame.fields()
            assert said.target_system == vehicle.system_id
            found = made.fleet.known_frames.one_enu_m(row, (said.x, said.y, said.z))
            np.testing.assert_allclose(found, places[row], atol=1e-6)
        assert [frame.get_seq() for frame in vehicle.heard] == list(range(len(vehicle.heard)))
        rows = made.table[made.table["system_id"] == vehicle.system_id]
        assert (rows["position_enu_m"] == places[row]).all()
        assert len(rows) == len(vehicle.heard)
    heard = {frame.raw for vehicle in made.vehicles for frame in vehicle.heard}
    assert {frame.raw for frame in made.tlog if frame.get_type() == SETPOINT} == heard


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e9])
def test_a_setpoint_that_must_not_leave_stops_nobody_elses(bad: float, tmp_path: Path) -> None:
    places = np.full((4, 3), 0.5)
    places[1, 2] = bad
    made = streamed(tmp_path, places)
    assert [len(vehicle.heard) for vehicle in made.vehicles] == [RATE_HZ, 0, RATE_HZ, RATE_HZ]
    assert made.streamer.gate.counts == GateCounts(0, 0, int(RATE_HZ), {"not finite": int(RATE_HZ)})
    assert made.events.count("setpoint of vehicle 2 held back (not finite)") == 1
    assert not (made.table["system_id"] == 2).any()


def test_positions_that_came_at_different_times_are_carried_on_to_one(tmp_path: Path) -> None:
    fleet = streamed(tmp_path, np.zeros((3, 3))).fleet
    now_s, velocity = 100.0, (2.0, -3.0, 0.5)  # all of them fly alike, NED
    for row, age_s in enumerate((0.0, 0.04, 0.09)):
        fleet.states.set_motion(row, *(-age_s * v for v in velocity), *velocity, 0.0, now_s - age_s)
    origins = fleet.known_frames.origins_enu_m
    np.testing.assert_allclose(fleet.positions_enu_m(now_s) - origins, 0.0, atol=1e-12)
    assert np.ptp(fleet.positions_enu_m() - origins, axis=0).max() > 0.2
    long_ago = fleet.positions_enu_m(now_s + 60.0)  # nobody knows
    carried = fleet.positions_enu_m() + 0.5 * np.array([-3.0, 2.0, -0.5])
    np.testing.assert_allclose(long_ago, carried, atol=0.004 * 0.5 * 3.6)  # metres of a sphere are 0.3 % off
