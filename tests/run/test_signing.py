"""Whole flights of which every frame is signed, in virtual time, and what is refused before anything is armed."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.console.cli import main
from fg_gcs.errors import MissionError
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.record.write.kept_stamp import KeptStamp
from fg_gcs.run.flying import FlyOptions, Outcome, RunResult
from fg_gcs.run.flying import fly as run_mission
from fg_gcs.run.signing import key_files
from fg_gcs.run.simulators import VIRTUAL_EPOCH_S
from fg_gcs.wire.codec import MAGIC_V2, SIGNED, Codec
from fg_gcs.wire.signing import stamp_of
from sitl_mock import parse_impairment, read_key
from sitl_mock.host.server import Counters, Simulator, SimulatorOptions
from tests.flight.harness import AUTOPILOTS, GROUND_PORT, mission_of

HOUR_S, TLOG = 3600.0, "flight.tlog"


def key_file(folder: Path, text: str = "a passphrase", name: str = "swarm.key") -> Path:
    path = folder / name
    path.write_text(text + "\n")
    path.chmod(0o600)
    return path


class Attacker(asyncio.DatagramProtocol):
    """Repeats to the station all that the vehicles said, and says it unsigned as well; open it with `open`."""

    @classmethod
    async def open(cls) -> asyncio.DatagramTransport:
        made = await asyncio.get_running_loop().create_datagram_endpoint(cls, remote_addr=("127.0.0.1", GROUND_PORT))
        return made[0]


def newest_of(folder: Path) -> bytes:
    """The end of what was recorded so far."""
    (log,) = folder.glob("*/" + TLOG)
    return log.read_bytes()[-4000:]


def flown(
    folder: Path,
    *,
    autopilot: str = "px4",
    vehicles_key: Path | None,
    options: FlyOptions,
    clock_ahead_s: float = 0.0,
    impairments: Sequence[dict[str, object]] = (),
    attacked: bool = False,
) -> tuple[RunResult, Counters]:
    """Fly with vehicles that have a key, or none, and whose clock is ahead of ours."""
    mission = mission_of(folder)
    simulated = SimulatorOptions(
        autopilot=autopilot,
        pads_enu_m=tuple((x, y) for x, y in mission.pads_enu_m().tolist()),
        system_ids=mission.swarm.ids(),
        remotes=(("127.0.0.1", GROUND_PORT),),
        signing_key=None if vehicles_key is None else read_key(vehicles_key),
        epoch_s=VIRTUAL_EPOCH_S + clock_ahead_s,
        impairments=tuple(map(parse_impairment, impairments)),
    )
    chosen = replace(
        options,
        connect=(f"udpin:127.0.0.1:{GROUND_PORT}",),
        wait_s=5.0,
        logs=folder,
        knows_origin=True,
        write_report=False,
    )

    async def attack() -> None:
        transport = await Attacker.open()
        plain = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        while True:
            await asyncio.sleep(0.05)
            heard = [frame.raw for frame in Codec().receive(newest_of(folder)) if frame.system_id < 200]
            for raw in heard[:20]:
                transport.sendto(raw)
            heartbeat = dialect.MAVLink_heartbeat_message(2, 12, 209, 0, 4, 3)
            transport.sendto(bytes(heartbeat.pack(plain)))

    async def run() -> tuple[RunResult, Counters]:
        async with Simulator(simulated) as simulator:
            attacking = asyncio.ensure_future(attack()) if attacked else None
            try:
                return await run_mission(mission, chosen), simulator.counters
            finally:
                if attacking is not None:
                    attacking.cancel()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(run())


def frames_of(result: RunResult) -> list[bytes]:
    return [frame.raw for frame in Codec().receive((result.folder / TLOG).read_bytes())]


def test_every_frame_of_a_flight_is_signed_and_none_is_refused(tmp_path: Path) -> None:
    key = key_file(tmp_path)
    options = FlyOptions(signing_keys=(str(key),))
    result, counters = flown(tmp_path, vehicles_key=key, options=options)
    assert result.completed, result.reason
    assert counters == Counters(0, 0, 0, 0, 0.0, 0)
    assert [result.summary[reason] for reason in ("unsigned", "forged", "replayed")] == [0, 0, 0]
    frames = frames_of(result)
    assert len(frames) > 5_000
    assert all(raw[0] == MAGIC_V2 and raw[2] == SIGNED for raw in frames)


def test_a_flight_under_attack_is_none_the_worse(tmp_path: Path) -> None:
    key = key_file(tmp_path)
    options = FlyOptions(signing_keys=(str(key),))
    result, _ = flown(tmp_path, vehicles_key=key, options=options, attacked=True)
    assert result.completed, result.reason
    assert result.summary["clashes"] == 0
    for reason in ("unsigned", "replayed"):
        count = result.summary[reason]
        assert isinstance(count, int)
        assert count > 500


def test_what_the_link_reorders_is_taken_and_what_it_doubles_is_not(tmp_path: Path) -> None:
    key = key_file(tmp_path)
    options = FlyOptions(signing_keys=(str(key),))
    link = {"direction": "from_vehicle", "delay_s": 0.02, "jitter_s": 0.04, "reorder": 0.1}
    reordered, _ = flown(tmp_path, vehicles_key=key, options=options, impairments=[link])
    assert reordered.completed, reordered.reason
    assert reordered.summary["replayed"] == 0
    (again := tmp_path / "again").mkdir()
    doubled, _ = flown(again, vehicles_key=key, options=options, impairments=[link | {"duplicate": 0.2}])
    assert doubled.completed, doubled.reason
    replayed, taken = doubled.summary["replayed"], doubled.summary["frames_in"]
    assert isinstance(replayed, int)
    assert isinstance(taken, int)
    assert 0.1 < replayed / taken < 0.2  # a sixth of what came


def test_a_clock_that_was_set_back_an_hour_still_flies(tmp_path: Path) -> None:
    """The vehicles' is right; in the state folder is what the last run used, two minutes ago."""
    key, state = key_file(tmp_path), tmp_path / "state"
    last = stamp_of(VIRTUAL_EPOCH_S + HOUR_S - 120.0)
    KeptStamp(state).keep(last)
    options = FlyOptions(signing_keys=(str(key),), state=state)
    result, counters = flown(tmp_path, autopilot="ardupilot", vehicles_key=key, options=options, clock_ahead_s=HOUR_S)
    assert result.completed, result.reason
    assert counters.not_signed == 0
    stamps = [int.from_bytes(raw[-12:-6], "little") for raw in frames_of(result) if raw[5] == 255]
    assert min(stamps) > last
    assert stamps == sorted(set(stamps))
    assert KeptStamp(state).read() > max(stamps)


def test_a_state_folder_that_takes_nothing_is_told_once(tmp_path: Path) -> None:
    key, state = key_file(tmp_path), tmp_path / "state"
    state.write_text("a file is no folder")
    options = FlyOptions(signing_keys=(str(key),), state=state)
    result, _ = flown(tmp_path, vehicles_key=key, options=options)
    assert result.completed, result.reason
    said = (result.folder / "events.jsonl").read_text()
    assert said.count("the time stamp of signatures cannot be kept: File exists") == 1


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_vehicles_are_given_the_key_and_sign_before_they_are_relied_on(autopilot: str, tmp_path: Path) -> None:
    key = key_file(tmp_path)
    options = FlyOptions(signing_keys=(str(key),), signing_setup=True)
    result, counters = flown(tmp_path, autopilot=autopilot, vehicles_key=None, options=options)
    assert result.completed, result.reason
    assert counters.not_signed == 0
    events = (result.folder / "events.jsonl").read_text()
    assert "vehicles 1-4 sign with our key" in events
    secret = read_key(key)
    for path in result.folder.iterdir():  # the record is for others' eyes
        assert secret not in path.read_bytes(), path.name


def test_a_vehicle_that_does_not_take_the_key_keeps_all_on_the_ground(tmp_path: Path) -> None:
    """What is sent to it does not arrive."""
    key = key_file(tmp_path)
    deaf: dict[str, object] = {"vehicles": [3], "loss": 1.0, "direction": "to_vehicle", "messages": ["SETUP_SIGNING"]}
    options = FlyOptions(signing_keys=(str(key),), signing_setup=True)
    result, _ = flown(tmp_path, vehicles_key=None, options=options, impairments=[deaf])
    assert result.outcome is Outcome.ABORTED
    assert result.reason.startswith("vehicle 3 did not sign what it sends with the key that it was given within 5 s")
    assert result.summary["vehicles_not_down"] == []


def test_vehicles_that_have_another_key_are_not_armed(tmp_path: Path) -> None:
    ours, theirs = key_file(tmp_path), key_file(tmp_path, "another", "other.key")
    result, _ = flown(tmp_path, vehicles_key=theirs, options=FlyOptions(signing_keys=(str(ours),)))
    assert result.outcome is Outcome.NO_ANSWER
    events = (result.folder / "events.jsonl").read_text()
    assert "is signed with another key: it is not taken" in events
    assert "; what came was refused: " in result.reason
    assert result.reason.endswith(" frames signed with another key")


def test_vehicles_without_a_key_are_not_heard_unless_they_are_to_get_one(tmp_path: Path) -> None:
    key = key_file(tmp_path)
    result, _ = flown(tmp_path, vehicles_key=None, options=FlyOptions(signing_keys=(str(key),)))
    assert result.outcome is Outcome.NO_ANSWER
    assert "is not signed: it is not taken" in (result.folder / "events.jsonl").read_text()
    assert result.reason.endswith(" frames unsigned")


def test_the_built_in_simulator_signs_as_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "small.toml").write_text(mission_of(tmp_path).text)
    key = key_file(tmp_path)
    arguments = ["fly", str(tmp_path / "small.toml"), "--speed", "max", "--logs", str(tmp_path / "logs"), "--json"]
    assert main([*arguments, "--signing-key", str(key)]) == 0
    flown_ = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert flown_["unsigned"] == 0
    (log,) = (tmp_path / "logs").glob("*/" + TLOG)
    assert all(frame.raw[2] == SIGNED for frame in Codec().receive(log.read_bytes()))


@pytest.mark.parametrize("command", [["fly", "MISSION"], ["recover", "--connect", "udp:1"], ["sim"]])
def test_a_key_that_others_can_read_is_refused(
    command: Sequence[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mission_of(tmp_path)
    key = key_file(tmp_path)
    key.chmod(0o644)
    words = [str(tmp_path / "mission.toml") if word == "MISSION" else word for word in command]
    if command[0] == "recover":
        words += ["--state", str(tmp_path / "state")]
    assert main([*words, "--signing-key", str(key)]) == 2
    captured = capsys.readouterr()
    assert "others can read" in captured.err
    assert captured.err.count("\n") == 1
    assert not list(tmp_path.glob("logs*"))


@pytest.mark.parametrize(
    ("texts", "networks", "files"),
    [
        ((), ("main",), {}),
        (("a.key",), ("main",), {"main": "a.key"}),
        (("west=a.key",), ("main",), {"main": "a.key"}),  # the only network needs no name
        (("a.key",), ("east", "west"), {"east": "a.key", "west": "a.key"}),
        (("west=a.key",), ("east", "west"), {"west": "a.key"}),
        (("b.key", "west=a.key"), ("east", "west"), {"east": "b.key", "west": "a.key"}),
        (("./x=y",), ("main",), {"main": "x=y"}),
    ],
)
def test_keys_belong_to_networks(texts: Sequence[str], networks: Sequence[str], files: dict[str, str]) -> None:
    assert key_files(texts, networks) == {name: Path(file) for name, file in files.items()}


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (("north=a",), "no network 'north'; there are east, west"),
        (("a", "b"), "a network has a key already"),
        (("west=a", "west=b"), "west has a key already"),
        (("",), "an empty text"),
    ],
)
def test_keys_of_no_network_are_refused(texts: Sequence[str], said: str) -> None:
    with pytest.raises(MissionError, match=said):
        key_files(texts, ("east", "west"))


def test_a_key_is_needed_to_give_it_away(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mission_of(tmp_path)
    assert main(["fly", str(tmp_path / "mission.toml"), "--signing-setup"]) == 2
    assert "there is no key to give to vehicles; name one by --signing-key" in capsys.readouterr().err
