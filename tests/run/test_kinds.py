"""What once went wrong, each in the flight in which it was seen: now nobody meets, and everybody comes down."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import geodetic_from_enu
from fg_gcs.flight.snapshot import RunEvent
from fg_gcs.link.clock import ticks
from fg_gcs.mission import load_mission, parse_mission
from fg_gcs.run.flying import FlyOptions, RunResult
from fg_gcs.run.flying import fly as run_mission
from fg_gcs.run.observing import Observer
from fg_gcs.run.simulators import simulator_of, wish_of
from fg_gcs.run.trial import Judgement, Trial, judge
from fg_gcs.scenario.motions import Circle
from fg_gcs.wire.framing import Sender
from tests.flight.harness import AUTOPILOTS, GROUND_PORT, SMALL, Flight, fly, mission_of, moving
from tests.flight.meddling import LATENCY_S, Datagram, Judge, MeddlingLoop, OneOf

MISSIONS = Path(__file__).parents[2] / "missions"
DEMO, PAPER = (load_mission(MISSIONS / f"{name}.toml") for name in ("demo", "paper_front"))
FOUR = parse_mission(SMALL)
MUTED = {"loss": 1.0}
PORT = 15000  # of a target


def judged(trial: Trial) -> Judgement:
    """Fly, and let no law be broken: two minutes after the end nothing that hears is armed or in the air."""
    found = judge(trial)
    assert found.broken == []
    assert found.result is not None
    return found


def completes(flight: Flight) -> None:
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    assert flight.down_and_disarmed
    assert flight.truth_separation_m >= 1.4


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_back_again_hovers(autopilot: str, tmp_path: Path) -> None:
    """A vehicle that is given up and heard again is landed with the others, and has its own failsafe only then."""
    mute = {**MUTED, "direction": "from_vehicle", "vehicles": [3], "stage": "hold", "at_s": 0.0, "for_s": 6.0}
    flight = fly(tmp_path, autopilot, impairments=[mute])
    assert flight.result is not None
    assert not flight.result.completed
    assert flight.down_and_disarmed
    name = {"px4": "COM_OBL_RC_ACT", "ardupilot": "FS_GCS_ENABLE"}[autopilot]
    assert [vehicle.autopilot.parameters[name] for vehicle in flight.simulator.fleet.vehicles] == [0.0] * 4
    assert flight.truth_separation_m >= 1.0


@pytest.mark.parametrize("late_s", [12.0, 17.0])
def test_late_heartbeat(late_s: float, tmp_path: Path) -> None:
    """A heartbeat from before arming that comes a second time in flight disarms nobody."""
    one = OneOf(dialect.MAVLINK_MSG_ID_HEARTBEAT, 5, late_s, outbound=False)
    completes(fly(tmp_path, "px4", loop=lambda: MeddlingLoop(one)))


def test_guest_link_behind(tmp_path: Path) -> None:
    """A target's link falls three seconds behind: its stamps say so, and the flight is not told completed."""
    off_m: list[float] = []
    way = Circle((0.0, 0.0, 12.0), 15.0, 2.0)

    async def drive(flight: Flight) -> None:
        loop, recorder = asyncio.get_running_loop(), Sender(101, 1)
        transport, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, remote_addr=("127.0.0.1", PORT))
        async for _ in ticks(loop.time(), 0.1):
            stage, since_s = flight.director.journal.stage, flight.director.journal.stage_begins_s
            behind_s = 3.0 if stage == "home" or (stage == "hold" and loop.time() - since_s > 4.0) else 0.0
            place = way.at(np.array([loop.time()]))[0][0]
            frame = recorder.pack(_reported(place, loop.time()))
            loop.call_later(behind_s, transport.sendto, frame)
            if stage == "hold" and behind_s:
                assert flight.director.result.plan is not None
                rim = flight.simulator.positions_enu_m[flight.director.result.plan.rim_of]
                off_m.append(float(np.linalg.norm(rim.mean(axis=0) - place)))

    text = moving(
        '[[targets]]\nname = "guest"\nposition_enu_m = [15.0, 0.0, 12.0]\n[targets.source]\nkind = "vehicle"\n'
        f'system_id = 101\nendpoint = "udpin:127.0.0.1:{PORT}"\n[targets.sensor]\ndelay_s = 0.05\n',
        "[track]\ngive_up_s = 6.0\n",
    )
    flight = fly(tmp_path, "px4", drive, mission_of(tmp_path, text))
    assert max(off_m) < 0.8 + 1.0  # the hold's depth, and a metre for everything else
    assert flight.result is not None
    assert flight.result.reason.startswith(
        "the target is not held within 6 s of the end of the hold: its sightings are 3."
    )
    assert flight.down_and_disarmed


def test_lost_flies_on() -> None:
    """ArduPilot flies on when nothing is heard of it, on the approach: the others' way home does not meet it."""
    mute = {**MUTED, "direction": "from_vehicle", "vehicles": [5], "stage": "approach", "at_s": 3.0}
    found = judged(Trial(DEMO, "ardupilot", impairments=(mute,)))
    assert found.result is not None
    assert found.result.summary["lost"] == [5]
    assert found.result.summary["vehicles_landed"] == 8


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_on_the_spot(autopilot: str) -> None:
    """Asked twice, the paper's upright formation parts before it lands."""
    found = judged(Trial(PAPER, autopilot, stops=(("hold", 1.0), ("home", 0.5))))
    assert any("stage: spread" in event for event in found.events)
    assert found.closest_m >= 1.5


def test_one_lost_take_off(tmp_path: Path) -> None:
    """ArduPilot's NAV_TAKEOFF is sent again."""
    lost: list[float] = []

    def lose(datagram: Datagram) -> list[float]:
        command = datagram.outbound and datagram.message_id == dialect.MAVLINK_MSG_ID_COMMAND_LONG
        if command and _opened(datagram).command == dialect.MAV_CMD_NAV_TAKEOFF and not lost:
            lost.append(datagram.at_s)
            return []
        return [LATENCY_S]

    completes(fly(tmp_path, "ardupilot", loop=lambda: MeddlingLoop(lose)))
    assert lost


def test_second_flight(tmp_path: Path) -> None:
    """PX4 that its own failsafe has landed stands in its streaming mode, and is flown again."""
    cut = [False]

    class Cutting(Observer):
        def event(self, event: RunEvent) -> None:
            if event.text == "approach":
                asyncio.get_running_loop().call_later(1.0, cut.__setitem__, 0, True)

    async def both() -> tuple[RunResult, RunResult]:
        async with simulator_of(FOUR, wish_of(FOUR, "px4"), GROUND_PORT) as simulator:
            options = FlyOptions((f"udpin:127.0.0.1:{GROUND_PORT}",), knows_origin=True, logs=tmp_path)
            first = await run_mission(FOUR, replace(options, write_report=False), [Cutting()])
            assert not simulator.armed.any()
            cut[0] = False
            return first, await run_mission(FOUR, replace(options, write_report=False))

    loop = MeddlingLoop(lambda datagram: [] if cut[0] else [LATENCY_S])
    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        first, second = runner.run(both())
    assert first.summary["lost"] == [1, 2, 3, 4]
    assert second.completed, second.reason


def test_slow_positions(tmp_path: Path) -> None:
    """Positions of one vehicle that come three times a second make no breach of separation."""
    last_s = [-9.0]

    def thin(datagram: Datagram) -> list[float]:
        position = not datagram.outbound and datagram.message_id == dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED
        if position and datagram.data[5] == 2:
            if datagram.at_s - last_s[0] < 0.33:
                return []
            last_s[0] = datagram.at_s
        return [LATENCY_S]

    flight = fly(tmp_path, "px4", loop=lambda: MeddlingLoop(thin))
    completes(flight)
    assert '"kind": "fault"' not in flight.events


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("after_s", [0.9, 2.1, 3.0, 4.6, 5.4])
def test_stop_while_arming(after_s: float, autopilot: str) -> None:
    """A stop while vehicles arm and take off brings all down at once."""
    found = judged(Trial(FOUR, autopilot, stops=(("prepare", after_s),)))
    assert found.ended_s < 0.3 + after_s + 25.0


def test_three_setpoints(tmp_path: Path) -> None:
    """PX4 refuses its streaming mode while the first setpoints are lost, and is asked again."""
    lost: list[float] = []

    def lose(datagram: Datagram) -> list[float]:
        setpoint = datagram.message_id == dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
        if setpoint and len(lost) < 50:  # of all four vehicles: some 0.4 s
            lost.append(datagram.at_s)
            return []
        return [LATENCY_S]

    completes(fly(tmp_path, "px4", loop=lambda: MeddlingLoop(lose)))


@pytest.mark.parametrize(("autopilot", "later_s"), [("px4", 0.0), ("ardupilot", 0.6)])
def test_two_at_once(autopilot: str, later_s: float) -> None:
    """A second vehicle that is lost is no second stop: the others still fly home."""
    mutes = tuple(
        {**MUTED, "vehicles": [lost], "stage": "hold", "at_s": at_s} for lost, at_s in ((1, 1.0), (2, 1.0 + later_s))
    )
    found = judged(Trial(FOUR, autopilot, impairments=mutes))
    assert found.result is not None
    assert found.result.summary["lost"] == [1, 2]
    assert found.result.summary["vehicles_landed"] == 2
    assert "landing" not in found.result.reason


def deaf_to(name: str, until_s: float) -> Judge:
    """Return what loses every answer of vehicle 3 about one parameter for a while."""

    def lose(datagram: Datagram) -> list[float]:
        about = datagram.message_id == dialect.MAVLINK_MSG_ID_PARAM_VALUE and name.encode() in datagram.data
        lost = about and not datagram.outbound and datagram.data[5] == 3 and datagram.at_s < until_s
        return [] if lost else [LATENCY_S]

    return lose


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("until_s", [20.0, np.inf])
def test_unheard_failsafe(until_s: float, autopilot: str, tmp_path: Path) -> None:
    """A failsafe that is heard late is set all the same; without it no flight begins."""
    name, wanted = {"px4": ("COM_OBL_RC_ACT", 4.0), "ardupilot": ("FS_GCS_ENABLE", 5.0)}[autopilot]
    during: list[float] = []

    async def look(flight: Flight) -> None:
        await flight.reaches("hold")
        during.extend(vehicle.autopilot.parameters[name] for vehicle in flight.simulator.fleet.vehicles)

    flight = fly(tmp_path, autopilot, look, loop=lambda: MeddlingLoop(deaf_to(name, until_s)))
    assert flight.result is not None
    if until_s < np.inf:
        completes(flight)
        assert during == [wanted] * 4
    else:
        assert f"vehicle 3 did not tell its parameter {name} within 30 s, but tells " in flight.result.reason
        assert during == []


def _reported(place_enu_m: Array, boot_s: float) -> dialect.MAVLink_message:
    """A vehicle's own position, as it was at a time of its clock."""
    latitude_deg, longitude_deg, altitude_m = geodetic_from_enu(place_enu_m, FOUR.origin_geodetic())
    places = round(latitude_deg * 1e7), round(longitude_deg * 1e7), round(altitude_m * 1e3), 0
    return dialect.MAVLink_global_position_int_message(round(boot_s * 1e3), *places, 0, 0, 0, 0)


def _opened(datagram: Datagram) -> dialect.MAVLink_message:
    return dialect.MAVLink(None).decode(bytearray(datagram.data))
