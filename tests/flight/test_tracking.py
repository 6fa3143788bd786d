"""Flights after targets that move, whole, in virtual time, in both autopilots' behaviour."""

from __future__ import annotations

import asyncio
import json
import math
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import flux_metric
from fg_gcs.errors import LinkError
from fg_gcs.link.clock import ticks
from fg_gcs.record.read.run import load_run
from fg_gcs.run.flying import FlyOptions, Outcome, fly_blocking
from fg_gcs.scenario.motions import Circle
from sitl_mock.host.server import Simulator, SimulatorOptions
from sitl_mock.host.targets import parse_target
from tests.flight.harness import AUTOPILOTS, CIRCLE, CIRCLING, Flight, OtherStation, fly, mission_of, moving

PORT = 15000
WAY = Circle((0.0, 0.0, 12.0), 15.0, 2.0)
LEAD = '[[targets]]\nname = "lead"\n'
UDP = f'position_enu_m = [15.0, 0.0, 12.0]\n[targets.source]\nkind = "udp"\nendpoint = "udpin:127.0.0.1:{PORT}"\n'
SILENT = CIRCLING.replace(CIRCLE, CIRCLE + "[targets.sensor]\nsilence = [[8.0, 13.0]]\n")


def flown(folder: Path, text: str, autopilot: str | None = None, *, report: bool = False) -> dict[str, object]:
    """Fly a mission as people do, in virtual time; return what is written about it."""
    options = FlyOptions(autopilot=autopilot, logs=folder / "logs", write_report=report)
    result = fly_blocking(mission_of(folder, text), options, speed=math.inf)
    assert result.outcome is (Outcome.COMPLETED if result.completed else Outcome.ABORTED), result.error
    assert result.in_order
    summary = json.loads((result.folder / "summary.json").read_text())
    assert isinstance(summary, dict)
    return summary


def figure(summary: dict[str, object], key: str) -> float:
    value = summary[key]
    assert isinstance(value, float)
    return value


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_target_on_a_circle_is_caught_and_held(autopilot: str, tmp_path: Path) -> None:
    summary = flown(tmp_path, CIRCLING, autopilot)
    assert summary["completed"] is True, summary["reason"]
    assert summary["vehicles_landed"] == 4
    assert figure(summary, "capture_time_s") < 30.0
    assert figure(summary, "centre_error_rms_m") < 1.0
    assert figure(summary, "centre_error_p95_m") < 1.5
    assert figure(summary, "centre_error_commanded_rms_m") < 1.0
    assert figure(summary, "flux_metric_share") >= 0.9
    assert figure(summary, "flown_flux_metric") >= 0.9
    assert figure(summary, "commanded_position_step_max_m") <= 0.005
    assert figure(summary, "commanded_velocity_step_max_m_s") <= 0.01
    assert figure(summary, "sensed_to_setpoint_p99_ms") <= 25.0
    assert figure(summary, "flown_min_separation_m") >= 1.5
    assert figure(summary, "tracking_max_m") <= 1.0
    assert summary["sightings_rejected"] == {}
    assert summary["found_again_s"] == []
    stages = summary["stages"]
    assert isinstance(stages, dict)
    assert stages["hold"][1] - stages["hold"][0] == pytest.approx(12.0, abs=0.05)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_the_simulators_own_state_says_the_moving_target_is_surrounded(autopilot: str, tmp_path: Path) -> None:
    """Independent of telemetry, tables and figures; and nobody comes close on the whole flight."""
    seen: list[float] = []

    async def look(flight: Flight) -> None:
        await flight.reaches("approach")
        loop = asyncio.get_running_loop()
        began_s = loop.time()  # not later than by the step in which stages are looked at
        await flight.reaches("hold")
        await asyncio.sleep(2.0)
        async for _ in ticks(loop.time(), 0.5):
            if flight.director.journal.stage != "hold":
                return
            assert flight.director.result.plan is not None
            rim = flight.simulator.positions_enu_m[flight.director.result.plan.rim_of]
            target = WAY.at(np.array([loop.time() - began_s]))[0]
            seen.append(float(flux_metric(rim[None], target)[0]))

    flight = fly(tmp_path, autopilot, look, mission_of(tmp_path, CIRCLING))
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    assert len(seen) in (20, 21)
    assert min(seen) >= 0.9
    assert flight.down_and_disarmed
    assert flight.truth_separation_m >= 1.4


def test_the_same_flight_gives_the_same_tables_byte_for_byte(tmp_path: Path) -> None:
    noisy = CIRCLING.replace(CIRCLE, CIRCLE + "[targets.sensor]\ndrop = 0.2\noutliers = 0.05\njitter_s = 0.03\n")
    folders = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        assert flown(tmp_path / name, noisy)["completed"] is True
        (folder,) = (tmp_path / name / "logs").iterdir()
        folders.append(folder)
    tables = [f"{name}.npy" for name in ("telemetry", "setpoints", "ticks", "sightings", "replans", "truth")]
    for table in (*tables, "flight.tlog"):
        one, two = ((folder / table).read_bytes() for folder in folders)
        assert one == two, table
        assert len(one) > 1000, table


def test_a_target_that_is_not_seen_for_a_while_is_found_again(tmp_path: Path) -> None:
    summary = flown(tmp_path, SILENT)
    assert summary["completed"] is True, summary["reason"]
    again = summary["found_again_s"]
    assert isinstance(again, list)
    assert len(again) == 1
    assert 0.0 <= again[0] <= 4.0
    events = (Path(str(summary["log"])) / "events.jsonl").read_text()
    assert "lead is lost" in events
    assert "lead is seen again" in events


def test_when_a_target_is_lost_everybody_goes_home_if_the_mission_says_so(tmp_path: Path) -> None:
    flight = fly(tmp_path, "px4", mission=mission_of(tmp_path, SILENT + '[track]\non_lost = "home"\n'))
    assert flight.result is not None
    assert not flight.result.completed
    assert flight.result.reason == "every target is lost: no sightings for 2 s"
    assert flight.down_and_disarmed
    assert flight.truth_separation_m >= 1.4


def test_a_target_that_is_too_fast_is_given_up(tmp_path: Path) -> None:
    fast = CIRCLE.replace("speed_m_s = 2.0", "speed_m_s = 7.9")
    text = CIRCLING.replace(CIRCLE, fast) + "[track]\ngive_up_s = 15.0\ncapture_m = 0.05\n"
    summary = flown(tmp_path, text)
    assert summary["completed"] is False
    assert summary["reason"] == "the target is faster than the vehicles"
    assert summary["vehicles_landed"] == 4
    assert summary["capture_time_s"] is None
    assert summary["centre_error_rms_m"] is None
    assert figure(summary, "commanded_position_step_max_m") <= 0.005


def test_a_target_that_cannot_be_held_is_given_up_too(tmp_path: Path) -> None:
    flight = fly(
        tmp_path, "px4", mission=mission_of(tmp_path, CIRCLING + "[track]\ngive_up_s = 4.0\ncapture_m = 1e-9\n")
    )
    assert flight.result is not None
    assert flight.result.reason == "the target is not caught within 4 s"
    assert flight.down_and_disarmed


@pytest.mark.parametrize(
    ("silent_s", "reason"),
    [(1.5, "the target is not caught within 7 s"), (13.0, "no sightings for 7 s")],
    ids=["before the capture", "just before the end of the hold"],
)
def test_a_capture_and_a_hold_count_only_while_sightings_come(silent_s: float, reason: str, tmp_path: Path) -> None:
    """A formation that follows a prediction has not caught the target, from which it may be 6 m away by the truth."""
    off_m: dict[str, float] = {}

    async def look(flight: Flight) -> None:
        began_s = 0.0
        async for _ in ticks(asyncio.get_running_loop().time(), 0.02):
            now_s, stage = asyncio.get_running_loop().time(), flight.director.journal.stage
            if stage == "approach" and not began_s:
                began_s = now_s
            if stage in ("hold", "home") and stage not in off_m:
                assert flight.director.result.plan is not None
                centre = flight.simulator.positions_enu_m[flight.director.result.plan.rim_of].mean(axis=0)
                off_m[stage] = float(np.linalg.norm(centre - WAY.at(np.array([now_s - began_s]))[0]))

    deaf = CIRCLING.replace(CIRCLE, f"{CIRCLE}[targets.sensor]\nsilence = [[{silent_s:g}, 1e4]]\n")
    flight = fly(tmp_path, "px4", look, mission_of(tmp_path, deaf + "[track]\ngive_up_s = 7.0\n"))
    result = flight.result
    assert result is not None
    assert result.reason == reason
    assert not result.completed
    assert ("hold" in off_m) == (silent_s > 4.5)
    assert off_m.get("hold", 0.0) < 0.8 + 0.5  # the hold's depth, and half a metre for everything else
    assert off_m["home"] > 1.5
    assert flight.down_and_disarmed


def test_a_target_that_is_never_seen_leaves_everybody_where_they_gathered(tmp_path: Path) -> None:
    flight = fly(tmp_path, "px4", mission=mission_of(tmp_path, moving(LEAD + UDP, "[track]\ngive_up_s = 5.0\n")))
    assert flight.result is not None
    assert flight.result.reason == "no sightings for 5 s"
    rows = flight.recorded.setpoints
    begin_s, end_s = flight.result.stages["approach"]
    inside = (rows["time_s"] > begin_s) & (rows["time_s"] < end_s)
    assert np.ptp(rows["position_enu_m"][inside & (rows["system_id"] == 1)], axis=0) == pytest.approx(np.zeros(3))
    assert flight.down_and_disarmed


def test_datagrams_that_are_nonsense_are_counted_and_change_nothing(tmp_path: Path) -> None:
    async def talk(flight: Flight) -> None:
        await flight.reaches("approach")
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, remote_addr=("127.0.0.1", PORT))
        began_s = loop.time()
        async for k, _ in ticks(began_s, 0.1):
            place = WAY.at(np.array([loop.time() - began_s]))[0][0].tolist()
            true = json.dumps({"target": "lead", "age_s": 0.0, "position_enu_m": place, "sigma_m": 0.1})
            nonsense = [true.replace(str(place[0]), text) for text in ("NaN", "1e999", "Infinity", '"east"')]
            far = true.replace(str(place[0]), "1e7")
            transport.sendto("\n".join([true, *nonsense, far, '{"target": "other"}', "\x00"]).encode())
            if k % 7 == 0:
                transport.sendto(b"\xff" * 1000)

    flight = fly(tmp_path, "px4", talk, mission_of(tmp_path, moving(LEAD + UDP)))
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    assert flight.result.tracking is not None
    refused = {verdict.name: count for verdict, count in flight.result.tracking.refused.items()}
    assert set(refused) == {"MALFORMED", "FAR"}
    assert refused["MALFORMED"] > 6 * refused["FAR"] - 6
    assert refused["FAR"] > 100
    assert flight.events.count('"kind": "refused"') == 2
    assert flight.down_and_disarmed


def test_a_port_that_is_taken_keeps_everybody_on_the_ground(tmp_path: Path) -> None:
    async def take(flight: Flight) -> None:
        await asyncio.get_running_loop().create_datagram_endpoint(
            asyncio.DatagramProtocol, local_addr=("127.0.0.1", PORT)
        )
        while True:
            assert not flight.simulator.armed.any()
            await asyncio.sleep(0.1)

    with pytest.raises(LinkError, match=str(PORT)):
        fly(tmp_path, "px4", take, mission_of(tmp_path, moving(LEAD + UDP)))


def test_a_real_vehicle_is_followed_from_an_origin_that_was_learnt(tmp_path: Path) -> None:
    """Heights count from the ground under the vehicles, wherever the first of them says that is."""
    source = f'[targets.source]\nkind = "vehicle"\nsystem_id = 101\nendpoint = "udpin:127.0.0.1:{PORT}"\n'
    text = moving(f"{LEAD}position_enu_m = [15.0, 0.0, 12.0]\n{source}[targets.sensor]\ndelay_s = 0.0\n")
    circle = {"kind": "circle", "centre_enu_m": [0, 0, 12], "radius_m": 15, "speed_m_s": 2}
    places: list[tuple[Array, Array]] = []

    async def drive(flight: Flight) -> None:
        options = parse_target(json.dumps(circle | {"system_id": 101, "rate_hz": 10}))
        remotes = (("127.0.0.1", PORT),)
        vehicle = Simulator(SimulatorOptions(pads_enu_m=(), system_ids=(), remotes=remotes, targets=(options,)))
        await vehicle.start()
        await flight.reaches("hold")
        await asyncio.sleep(3.0)
        places.append((flight.simulator.positions_enu_m, vehicle.targets_enu_m[0]))
        await flight.reaches("land")
        await vehicle.close()

    flight = fly(tmp_path, "ardupilot", drive, mission_of(tmp_path, text), ours=False)
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    ((vehicles, target),) = places
    assert flight.result.plan is not None
    rim = vehicles[flight.result.plan.rim_of]
    assert float(flux_metric(rim[None], target)[0]) >= 0.9
    assert np.linalg.norm(rim.mean(axis=0) - target) <= 0.8 + 1.0  # the hold's depth, and a metre for everything else


# --- when something is wrong -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("stage", ["approach", "hold", "home"])
def test_stopped_while_tracking_everybody_is_brought_home(stage: str, autopilot: str, tmp_path: Path) -> None:
    async def stop(flight: Flight) -> None:
        await flight.reaches(stage)
        await asyncio.sleep(2.7)
        flight.director.interrupt("stopped by a test")

    flight = fly(tmp_path, autopilot, stop, mission_of(tmp_path, CIRCLING))
    assert flight.result is not None
    assert flight.result.reason == "stopped by a test"
    assert "home" in flight.result.stages
    assert "landing apart" not in flight.events
    assert flight.down_and_disarmed
    assert flight.truth_separation_m >= 1.4


def test_stopped_twice_while_tracking_lands_on_the_spot(tmp_path: Path) -> None:
    async def stop(flight: Flight) -> None:
        await flight.reaches("hold")
        flight.director.interrupt("first")
        await asyncio.sleep(0.5)
        flight.director.interrupt("second")

    flight = fly(tmp_path, "px4", stop, mission_of(tmp_path, CIRCLING))
    assert "landing apart from each other: second" in flight.events
    assert flight.down_and_disarmed
    assert np.linalg.norm(flight.simulator.positions_enu_m[:, :2], axis=1).min() > 8.0


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_vehicle_taken_over_while_tracking_is_left_alone(autopilot: str, tmp_path: Path) -> None:
    async def take(flight: Flight) -> None:
        other = await OtherStation.open()
        await flight.reaches("approach")
        await asyncio.sleep(2.0)
        assert flight.director.fleet is not None
        other.command_mode(2, flight.director.fleet.vehicles[1].profile.modes["RTL"])

    flight = fly(tmp_path, autopilot, take, mission_of(tmp_path, CIRCLING), shared=True)
    assert flight.result is not None
    assert "vehicle 2 is taken over" in flight.result.reason
    assert flight.down_and_disarmed


def test_vehicles_that_are_lost_while_tracking_end_it(tmp_path: Path) -> None:
    async def kill(flight: Flight) -> None:
        await flight.reaches("hold")
        await asyncio.sleep(0.5)
        assert flight.director.target_follower is not None
        status = flight.director.target_follower.status
        assert status is not None
        assert status.error_m < 5.0
        assert status.known is not None
        assert status.known.age_s <= 0.2 + 1e-6  # the sensor's delay, and the time between two looks
        assert status.refused == {}
        await flight.simulator.close()

    flight = fly(tmp_path, "px4", kill, mission_of(tmp_path, CIRCLING))
    assert flight.result is not None
    assert not flight.result.completed
    assert [vehicle.label for vehicle in flight.result.lost] == [1, 2, 3, 4]
    assert len(flight.recorded.truth["time_s"]) > 100


def test_the_noses_follow_the_target_without_jumps(tmp_path: Path) -> None:
    summary = flown(tmp_path, CIRCLING)
    run = Path(str(summary["log"]))
    recorded = load_run(run)
    setpoints, truth = recorded.setpoints, recorded.truth
    stages = summary["stages"]
    assert isinstance(stages, dict)
    begin_s, end_s = stages["approach"][0], stages["hold"][1]
    for system_id in range(1, 5):
        rows = (setpoints["system_id"] == system_id) & (setpoints["time_s"] >= begin_s) & (setpoints["time_s"] <= end_s)
        time_s, yaw = setpoints["time_s"][rows], np.unwrap(setpoints["yaw_rad"][rows])
        assert np.abs(np.diff(yaw) / np.diff(time_s)).max() <= 1.0 + 1e-6
        target = np.stack([np.interp(time_s, truth["time_s"], axis) for axis in truth["position_enu_m"].T], axis=1)
        away = (target - setpoints["position_enu_m"][rows])[:, :2]
        bearing = np.arctan2(away[:, 0], away[:, 1])
        far = (np.linalg.norm(away, axis=1) > 4.0) & (time_s > begin_s + 2.0)  # near it, its noise turns the bearing
        assert far.any()
        wrong = np.remainder(yaw - bearing + np.pi, 2.0 * np.pi) - np.pi
        assert np.abs(wrong[far]).max() < 0.5


def test_the_report_shows_the_chase(tmp_path: Path) -> None:
    wild = CIRCLING.replace(CIRCLE, CIRCLE + "[targets.sensor]\noutliers = 0.1\n")
    summary = flown(tmp_path, wild, report=True)
    page = Path(str(summary["report"])).read_text()
    for said in ("target&#x27;s true way", "How far off the target", "refused: gated", "following the target"):
        assert said in page or said.replace("&#x27;", "'") in page or said.replace("&#x27;", "\\u0027") in page, said
    rejected = summary["sightings_rejected"]
    assert isinstance(rejected, dict)
    assert rejected["gated"] > 5
