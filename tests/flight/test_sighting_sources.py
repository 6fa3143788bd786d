"""Sightings from every kind of source, in virtual time; one run with a simulator process in accelerated time."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import geodetic_from_enu
from fg_gcs.errors import LinkError
from fg_gcs.flight.sightings.sighting_sources import SIMULATED_ENDPOINT, SightingSources, Substitutes
from fg_gcs.link.clock import VirtualTimeLoop, make_loop
from fg_gcs.mission import Mission, load_mission
from fg_gcs.mission.model import DEFAULT_ORIGIN
from fg_gcs.run.simulators import free_port, targets_in_loop, targets_process
from fg_gcs.scenario.motions import Circle
from fg_gcs.scenario.sensor import Sensor
from fg_gcs.track.sightings import Sighting, Verdict

MISSIONS = Path(__file__).parents[2] / "missions"
WHOLE = (MISSIONS / "circle.toml").read_text()
BEFORE, BEHIND = WHOLE[: WHOLE.index("[[targets]]")], "[track]\nmost_radius_m = 3.0\n" + WHOLE[WHOLE.index("[hold]") :]
CIRCLE = '[targets.motion]\nkind = "circle"\ncentre_enu_m = [0.0, 0.0, 18.0]\nradius_m = 50.0\nspeed_m_s = 4.0\n'
SCRIPT = f'[[targets]]\nname = "lead"\n{CIRCLE}'
PLACED = '[[targets]]\nname = "lead"\nposition_enu_m = [1.0, 2.0, 18.0]\n'
PORT = 15000
UDP = f'{PLACED}[targets.source]\nkind = "udp"\nendpoint = "udpin:127.0.0.1:{PORT}"\n'
REAL = f'{PLACED}[targets.source]\nkind = "vehicle"\nsystem_id = 101\nendpoint = "udpin:127.0.0.1:{PORT}"\n'
SIMULATED = f'{SCRIPT}[targets.source]\nkind = "vehicle"\nsystem_id = 101\nsimulated = true\n'
LATENCY_S = 0.001  # of a datagram in virtual time
BEGAN_S = 2.0
EPOCH_S = 1.7e9  # Unix time when the loop's time is 0


class Station:
    """Everything that came of a mission's sources."""

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.seen: list[Sighting] = []
        self.arrived_s: list[float] = []
        self.refused: dict[Verdict, int] = {}
        self.truth: Array | None = None
        self.failures: list[str] = []
        self.sources = SightingSources(
            mission.targets or [],
            self._take,
            self._refuse,
            Substitutes(),
            self.failures.append,
            lambda now_s: EPOCH_S + now_s,
        )

    def _take(self, sighting: Sighting) -> None:
        self.seen.append(sighting)
        self.arrived_s.append(asyncio.get_running_loop().time())

    def _refuse(self, verdict: Verdict, count: int) -> None:
        self.refused[verdict] = self.refused.get(verdict, 0) + count


Script = Callable[[Station], Awaitable[None]]


def mission_of(folder: Path, targets: str) -> Mission:
    path = folder / "m.toml"
    path.write_text(BEFORE + targets + BEHIND)
    return load_mission(path)


def run(mission: Mission, script: Script) -> Station:
    """Open the sources at 0 s, begin at 2 s, let a script interfere, and close."""

    async def main() -> Station:
        station = Station(mission)
        async with AsyncExitStack() as stack:
            await station.sources.open()
            stack.callback(station.sources.close)
            port = int(SIMULATED_ENDPOINT.rpartition(":")[2])
            await stack.enter_async_context(targets_in_loop(mission, port))
            await asyncio.sleep(BEGAN_S)
            assert not station.seen
            station.sources.begin(mission.origin_geodetic())
            await script(station)
        return station

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(main())


async def wait_10_s(station: Station) -> None:
    await asyncio.sleep(10.0)


async def say(*lines: object, port: int = PORT) -> None:
    await throw("\n".join(json.dumps(line) for line in lines).encode(), port)


async def throw(data: bytes, port: int = PORT) -> None:
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        asyncio.DatagramProtocol, remote_addr=("127.0.0.1", port)
    )
    transport.sendto(data)
    transport.close()
    await asyncio.sleep(2.0 * LATENCY_S)


def test_a_script_is_its_motion_seen_by_the_sensor(tmp_path: Path) -> None:
    mission = mission_of(tmp_path, SCRIPT + "[targets.sensor]\ndrop = 0.2\njitter_s = 0.02\n")
    station = run(mission, wait_10_s)
    (target,) = mission.targets or []
    sensor = Sensor("lead", target.sensor.settings(), 0)
    expected = takewhile(lambda look: look.received_s < 10.0, sensor.measurements(Circle((0.0, 0.0, 18.0), 50.0, 4.0)))
    wanted = [look.sighting for look in expected if look.sighting is not None]
    assert 60 < len(wanted) < 95
    assert [s.time_s for s in station.seen] == pytest.approx([s.time_s + BEGAN_S for s in wanted])
    assert (np.array([s.position_enu_m for s in station.seen]) == [s.position_enu_m for s in wanted]).all()
    assert [s.received_s for s in station.seen] == pytest.approx([s.received_s + BEGAN_S for s in wanted])
    assert station.arrived_s == pytest.approx([s.received_s for s in station.seen])
    assert not station.refused


def test_the_truth_of_scripts_is_known_by_the_loops_time(tmp_path: Path) -> None:
    still = '[targets.motion]\nkind = "static"\nposition_enu_m = [3.0, 4.0, 18.0]\n'
    both = mission_of(tmp_path, SCRIPT + SCRIPT.replace("lead", "other").replace(CIRCLE, still))
    times = np.array([2.0, 5.0, 9.0])

    async def look(station: Station) -> None:
        station.truth = station.sources.truth(times)

    truth = run(both, look).truth
    assert truth is not None
    assert truth.shape == (3, 2, 3)
    assert truth[:, 0] == pytest.approx(Circle((0.0, 0.0, 18.0), 50.0, 4.0).at(times - BEGAN_S)[0])
    assert truth[:, 1] == pytest.approx(np.tile([3.0, 4.0, 18.0], (3, 1)))
    assert run(mission_of(tmp_path, SCRIPT + UDP.replace("lead", "other")), look).truth is None


def test_a_blind_script_neither_hangs_nor_speaks(tmp_path: Path) -> None:
    assert not run(mission_of(tmp_path, SCRIPT + "[targets.sensor]\ndrop = 1\n"), wait_10_s).seen


def test_a_recording_is_replayed_by_its_times(tmp_path: Path) -> None:
    rows = ["time_s,target,east_m,north_m,up_m,sigma_m", "4,lead,4,0,18,0.1", "1,lead,1,0,18,0.2", "2,other,0,0,18,1"]
    (tmp_path / "seen.csv").write_text("\n".join([*rows, "-1,lead,7,0,18,"]))
    source = '[[targets]]\nname = "lead"\n[targets.source]\nkind = "csv"\npath = "seen.csv"\n'
    station = run(mission_of(tmp_path, source), wait_10_s)
    assert [s.time_s - BEGAN_S for s in station.seen] == pytest.approx([-1.0, 1.0, 4.0])
    assert [t - BEGAN_S for t in station.arrived_s] == pytest.approx([0.0, 1.0, 4.0])
    assert [s.position_enu_m[0] for s in station.seen] == [7.0, 1.0, 4.0]
    assert [s.covariance_m2[0, 0] for s in station.seen] == pytest.approx([0.25, 0.04, 0.01])
    assert station.sources.truth(np.array([3.0])) is None


def test_datagrams_state_a_time_since_tracking_began_or_an_age(tmp_path: Path) -> None:
    async def script(station: Station) -> None:
        await asyncio.sleep(3.0)
        place = {"target": "lead", "position_enu_m": [1.0, 2.0, 3.0]}
        await say(
            place | {"time_s": 2.5}, place | {"age_s": 0.25, "sigma_m": 2.0}, {"target": "lead"}, place | {"x": 1}
        )

    station = run(mission_of(tmp_path, UDP + "[targets.sensor]\nsigma_m = 0.7\n"), script)
    received_s = BEGAN_S + 3.0 + LATENCY_S
    assert [s.time_s for s in station.seen] == pytest.approx([BEGAN_S + 2.5, received_s - 0.25])
    assert [s.received_s for s in station.seen] == pytest.approx([received_s] * 2)
    assert [s.covariance_m2[0, 0] for s in station.seen] == pytest.approx([0.49, 4.0])
    assert station.refused == {Verdict.MALFORMED: 2}


def test_hostile_datagrams_are_counted_and_cost_little(tmp_path: Path) -> None:
    async def script(station: Station) -> None:
        good = {"target": "lead", "position_enu_m": [1.0, 2.0, 3.0], "age_s": 0.0}
        await throw(b"\xff\x00 nonsense")
        await say(good | {"target": "nobody"})
        await asyncio.sleep(1.0)
        await asyncio.gather(*(say(good) for _ in range(1000)))
        await asyncio.sleep(1.0)
        await say(good)

    station = run(mission_of(tmp_path, UDP), script)
    assert len(station.seen) == 101  # a tenth of a second lets 100 through, and later there is room again
    assert station.refused == {Verdict.MALFORMED: 1, Verdict.UNKNOWN_TARGET: 1, Verdict.FLOOD: 900}


def test_nothing_is_looked_at_before_the_beginning_and_after_the_end(tmp_path: Path) -> None:
    async def script(station: Station) -> None:
        await asyncio.sleep(5.0)
        station.sources.close()
        station.sources.close()
        before = len(station.seen)
        await say({"target": "lead", "position_enu_m": [1.0, 2.0, 3.0], "age_s": 0.0})
        await asyncio.sleep(5.0)
        assert len(station.seen) == before

    for targets in (SCRIPT, UDP, REAL, SIMULATED):
        station = run(mission_of(tmp_path, targets), script)
        assert bool(station.seen) == (targets in (SCRIPT, SIMULATED))
        assert not station.refused


def test_a_callback_may_close_its_source(tmp_path: Path) -> None:
    async def main() -> int:
        seen: list[Sighting] = []
        sources: SightingSources

        def take(sighting: Sighting) -> None:
            seen.append(sighting)
            sources.close()

        sources = SightingSources(
            mission_of(tmp_path, SCRIPT).targets or [], take, lambda verdict, count: None, Substitutes(), print
        )
        await sources.open()
        sources.begin(DEFAULT_ORIGIN)
        await asyncio.sleep(5.0)
        return len(seen)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        assert runner.run(main()) == 1


@pytest.mark.parametrize("message", ["GLOBAL_POSITION_INT", "FOLLOW_TARGET"])
def test_a_simulated_vehicle_is_seen_through_the_sensor(tmp_path: Path, message: str) -> None:
    exact = "[targets.sensor]\nsigma_m = 0\nrate_hz = 20\ndelay_s = 0.25\nsilence = [[4, 6]]\n"
    keys = SIMULATED + f'message = "{message}"\n' + exact

    async def script(station: Station) -> None:
        await asyncio.sleep(10.0)
        station.truth = station.sources.truth(np.array([s.time_s for s in station.seen]))

    station = run(mission_of(tmp_path, keys), script)
    times = np.array([s.time_s for s in station.seen])
    assert len(times) == pytest.approx(20 * (10.0 - 2.0 - 0.25), abs=2)
    assert not [t for t in times - BEGAN_S if 4.0 <= t < 6.0]
    assert [s.received_s for s in station.seen] == pytest.approx(times + 0.25)
    assert station.arrived_s == pytest.approx(times + 0.25)
    # the simulator began at 0 s; its datagrams take 1 ms, and degrees come in steps of 11 mm
    expected = Circle((0.0, 0.0, 18.0), 50.0, 4.0).at(times - LATENCY_S)[0]
    positions = np.array([s.position_enu_m for s in station.seen])
    assert positions == pytest.approx(expected, abs=0.009)
    assert station.truth is not None
    assert station.truth[:, 0] == pytest.approx(positions, abs=1e-6)


def test_the_truth_of_a_simulated_vehicle_ends_with_its_reports(tmp_path: Path) -> None:
    times = np.array([1.0, 7.03, 12.05, 12.5, 14.0])

    async def script(station: Station) -> None:
        before = station.sources.truth(times)
        assert before is not None
        assert np.isnan(before).all()
        await asyncio.sleep(10.0)
        station.truth = station.sources.truth(times)

    truth = run(mission_of(tmp_path, SIMULATED + "[targets.sensor]\nsigma_m = 3\n"), script).truth
    assert truth is not None
    assert np.isnan(truth[[0, 4]]).all()
    expected = Circle((0.0, 0.0, 18.0), 50.0, 4.0).at(times[1:4])[0]
    assert truth[1:3, 0] == pytest.approx(expected[:2], abs=0.03)
    assert truth[3, 0] == pytest.approx(expected[2], abs=0.2)  # half a second on by the last two reports


def test_noise_is_put_on_a_simulated_vehicle_and_is_the_same_every_time(tmp_path: Path) -> None:
    runs = [run(mission_of(tmp_path, SIMULATED), wait_10_s).seen for _ in range(2)]
    expected = Circle((0.0, 0.0, 18.0), 50.0, 4.0).at(np.array([s.time_s for s in runs[0]]))[0]
    errors = np.array([s.position_enu_m for s in runs[0]]) - expected
    assert errors.std(axis=0) == pytest.approx(0.5, abs=0.15)  # 100 draws: four times 7 %
    assert [s.position_enu_m.tolist() for s in runs[0]] == [s.position_enu_m.tolist() for s in runs[1]]


def frame(message: dialect.MAVLink_message, system_id: int = 101) -> bytes:
    return bytes(message.pack(dialect.MAVLink(None, srcSystem=system_id, srcComponent=1)))


def position(latitude: int, longitude: int, altitude_mm: int = 500_000) -> dialect.MAVLink_message:
    return dialect.MAVLink_global_position_int_message(1, latitude, longitude, altitude_mm, 0, 0, 0, 0, 0)


def test_a_real_vehicle_is_believed_as_old_as_stated(tmp_path: Path) -> None:
    place = geodetic_from_enu(np.array([10.0, -20.0, 30.0]), DEFAULT_ORIGIN)
    told = position(round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7), round(place.altitude_m * 1e3))

    async def script(station: Station) -> None:
        for data in (frame(told, system_id=7), frame(dialect.MAVLink_heartbeat_message(10, 0, 0, 0, 4, 3))):
            await throw(data)
        assert not station.seen
        await throw(frame(told)[:20])
        await throw(b"noise" + frame(told))

    station = run(mission_of(tmp_path, REAL + "[targets.sensor]\ndelay_s = 0.3\nsigma_m = 2\n"), script)
    (sighting,) = station.seen
    assert sighting.position_enu_m == pytest.approx([10.0, -20.0, 30.0], abs=0.009)
    assert sighting.covariance_m2 == pytest.approx(4.0 * np.eye(3))
    assert sighting.received_s - sighting.time_s == pytest.approx(0.3)
    assert station.sources.truth(np.zeros(1)) is None


class Port:
    """A sender that keeps its port."""

    def __init__(self, transport: asyncio.DatagramTransport) -> None:
        self._transport = transport

    @classmethod
    async def open(cls, port: int = PORT) -> Port:
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            asyncio.DatagramProtocol, remote_addr=("127.0.0.1", port)
        )
        return cls(transport)

    def send(self, data: bytes) -> None:
        self._transport.sendto(data)

    def say(self, **line: object) -> None:
        self.send(json.dumps({"target": "lead", "position_enu_m": [1.0, 2.0, 3.0], **line}).encode())


@given(booted_s=st.floats(0.01, 4e6), behind_s=st.floats(0.0, 3.0))
def test_a_vehicle_whose_link_falls_behind_is_as_old_as_it_says(
    tmp_path_factory: pytest.TempPathFactory, booted_s: float, behind_s: float
) -> None:
    async def script(station: Station) -> None:
        port, time_s = await Port.open(), asyncio.get_running_loop().time
        for k in range(100):
            true_s = time_s() - (behind_s if k >= 50 else 0.0)
            stamp_ms = round(1e3 * (true_s + booted_s))
            port.send(frame(dialect.MAVLink_global_position_int_message(stamp_ms, 5, 5, 5, 0, 0, 0, 0, 0)))
            await asyncio.sleep(0.1)

    mission = mission_of(tmp_path_factory.mktemp("behind"), REAL + "[targets.sensor]\ndelay_s = 0.3\n")
    station = run(mission, script)
    ages = [sighting.received_s - sighting.time_s for sighting in station.seen]
    assert len(ages) == 100
    assert ages[:50] == pytest.approx([0.3] * 50, abs=0.002)
    assert ages[50:] == pytest.approx([0.3 + behind_s] * 50, abs=0.003)
    assert len(station.failures) == (behind_s > 1.002) or 0.998 < behind_s <= 1.002


def test_a_vehicle_that_does_not_know_the_time_is_believed_on_arrival(tmp_path: Path) -> None:
    async def script(station: Station) -> None:
        port = await Port.open()
        for _ in range(5):
            port.send(frame(dialect.MAVLink_global_position_int_message(0, 5, 5, 5, 0, 0, 0, 0, 0)))
            await asyncio.sleep(1.0)

    seen = run(mission_of(tmp_path, REAL + "[targets.sensor]\ndelay_s = 0.3\n"), script).seen
    assert [sighting.received_s - sighting.time_s for sighting in seen] == pytest.approx([0.3] * 5)


def test_two_senders_of_one_target_have_a_clock_each(tmp_path: Path) -> None:
    async def script(station: Station) -> None:
        ports, time_s = [await Port.open(), await Port.open()], asyncio.get_running_loop().time
        for _ in range(30):
            for port, booted_s in zip(ports, (5.0, 5000.0), strict=True):
                stamp_ms = round(1e3 * (time_s() + booted_s))
                port.send(frame(dialect.MAVLink_global_position_int_message(stamp_ms, 5, 5, 5, 0, 0, 0, 0, 0)))
                await asyncio.sleep(0.05)

    station = run(mission_of(tmp_path, REAL + "[targets.sensor]\ndelay_s = 0\n"), script)
    assert [s.received_s - s.time_s for s in station.seen] == pytest.approx([0.0] * 60, abs=0.002)
    assert station.failures == []


@pytest.mark.parametrize(("wrong_s", "told"), [(0.0, False), (-3600.0, True), (0.8, True), (86400.0, True)])
def test_stamps_by_unix_time_are_ages_whatever_the_senders_clock(tmp_path: Path, wrong_s: float, told: bool) -> None:
    async def script(station: Station) -> None:
        port, time_s = await Port.open(), asyncio.get_running_loop().time
        for k in range(40):
            age_s = 0.2 if k == 20 else 2.0 if k > 30 else 0.3
            port.say(stamp_unix_s=EPOCH_S + time_s() + wrong_s - age_s)
            await asyncio.sleep(0.1)

    station = run(mission_of(tmp_path, UDP), script)
    ages = np.array([sighting.received_s - sighting.time_s for sighting in station.seen])
    assert len(ages) == 40
    least_s = 0.0 if told else 0.2  # of a clock that is wrong nobody knows how long its soonest sighting took
    assert ages[31:] == pytest.approx(1.8 + least_s, abs=0.01)
    (line,) = station.failures
    assert ("are stamped by a clock" if told else "come 1.8 s later than they did") in line


@pytest.mark.parametrize("targets", [UDP, REAL])
def test_a_flood_of_senders_makes_no_source_deaf(tmp_path: Path, targets: str) -> None:
    async def script(station: Station) -> None:
        good = await Port.open()

        def report() -> None:
            if targets == UDP:
                good.say(age_s=0.0)
            else:
                stamp_ms = round(1e3 * asyncio.get_running_loop().time())
                good.send(frame(dialect.MAVLink_global_position_int_message(stamp_ms, 5, 5, 5, 0, 0, 0, 0, 0)))

        foreign = b'{"target": "nobody"}' if targets == UDP else frame(position(5, 5), system_id=7)
        strangers = [await Port.open() for _ in range(200)]
        for stranger in strangers:  # first, and all the time
            stranger.send(b"\xfe\0" * 100)
        for _ in range(50):
            for stranger in strangers:
                stranger.send(b"x")
                stranger.send(foreign)
            report()
            await asyncio.sleep(0.1)

    station = run(mission_of(tmp_path, targets), script)
    assert len(station.seen) == 50
    assert station.refused[Verdict.FLOOD] > 10_000


def test_sightings_in_reverse_order_are_handed_in_by_their_stamps_and_a_few_at_a_time(tmp_path: Path) -> None:
    turns: list[int] = []

    async def script(station: Station) -> None:
        await asyncio.sleep(3.0)
        loop, seen = asyncio.get_running_loop(), 0

        def count() -> None:
            nonlocal seen
            turns.append(len(station.seen) - seen)
            seen = len(station.seen)
            if len(turns) < 400:
                loop.call_soon(count)

        port = await Port.open()
        for first in (100, 0):
            lines = [
                {"target": "lead", "position_enu_m": [1.0, 2.0, 3.0], "age_s": 0.01 * k}
                for k in range(first, first + 100)
            ]
            port.send("\n".join(json.dumps(line) for line in lines[::-1]).encode())
        loop.call_later(0.0005, count)
        await asyncio.sleep(0.1)

    station = run(mission_of(tmp_path, UDP), script)
    assert len(station.seen) == 200
    stamps = np.array([sighting.time_s for sighting in station.seen])
    late = np.diff(stamps) < 0.0
    assert late.sum() < 30  # each of them makes the filter begin again
    assert max(turns) <= 16


def test_places_that_are_none_are_refused(tmp_path: Path) -> None:
    follow = [0.0] * 3
    wild = dialect.MAVLink_follow_target_message(1, 3, 1, 1, np.nan, follow, follow, [1, 0, 0, 0], follow, follow, 0)

    async def script(station: Station) -> None:
        for message in (position(0, 0), position(2**31 - 1, 5), position(5, -(2**31)), position(5, 5, 2**31 - 1), wild):
            await throw(frame(message))

    assert run(mission_of(tmp_path, REAL), script).refused == {Verdict.MALFORMED: 4}
    follows = REAL + 'message = "FOLLOW_TARGET"\n'
    assert run(mission_of(tmp_path, follows), script).refused == {Verdict.MALFORMED: 1}


@given(st.lists(st.binary(max_size=200), max_size=5))
def test_no_bytes_raise(tmp_path_factory: pytest.TempPathFactory, datagrams: list[bytes]) -> None:
    async def script(station: Station) -> None:
        for data in datagrams:
            await throw(data)
            await throw(data, PORT + 1)

    both = UDP + REAL.replace("lead", "other").replace(str(PORT), str(PORT + 1))
    assert not run(mission_of(tmp_path_factory.mktemp("bytes"), both), script).seen


def test_a_port_that_is_taken_is_said_and_nothing_stays_open(tmp_path: Path) -> None:
    both = UDP + UDP.replace("lead", "other").replace(str(PORT), str(PORT + 1))
    targets = mission_of(tmp_path, both).targets or []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        taken, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, local_addr=("127.0.0.1", PORT + 1))
        sources = SightingSources(targets, lambda sighting: None, lambda verdict, count: None, Substitutes(), print)
        with pytest.raises(LinkError, match=f"port {PORT + 1} is in use"):
            await sources.open()
        taken.close()
        again = SightingSources(targets, lambda sighting: None, lambda verdict, count: None, Substitutes(), print)
        await again.open()
        again.close()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(main())


def test_a_simulator_process_is_seen_and_its_end_is_mere_silence(tmp_path: Path) -> None:
    mission = mission_of(tmp_path, SIMULATED + "[targets.sensor]\nsigma_m = 0\n")
    port = free_port()

    async def main() -> list[Sighting]:
        seen: list[Sighting] = []
        enough = asyncio.Event()

        def take(sighting: Sighting) -> None:
            seen.append(sighting)
            if len(seen) == 20:
                enough.set()

        endpoint = f"udpin:127.0.0.1:{port}"
        sources = SightingSources(
            mission.targets or [], take, lambda verdict, count: None, Substitutes(endpoint), print
        )
        await sources.open()
        try:
            sources.begin(mission.origin_geodetic())
            with targets_process(mission, port, 10.0, tmp_path / "targets.log"):
                await asyncio.wait_for(enough.wait(), 200.0)  # 20 s of real time: a machine may be very busy
            await asyncio.sleep(1.0)
        finally:
            sources.close()
        return seen

    with asyncio.Runner(loop_factory=lambda: make_loop(10.0)) as runner:
        seen = runner.run(main())
    radii = [float(np.linalg.norm(s.position_enu_m[:2])) for s in seen]
    assert radii == pytest.approx([50.0] * len(radii), abs=0.015)
    assert {s.target for s in seen} == {"lead"}
