"""Whole flights in virtual time that another program watches, and meddles with where the mission allows it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.console.cli import main
from fg_gcs.flight.snapshot import RunEvent
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.run.flying import FlyOptions, RunResult
from fg_gcs.run.flying import fly as run_mission
from fg_gcs.run.observing import Observer
from fg_gcs.wire.codec import MAGIC_V2, Message
from tests.flight.harness import AUTOPILOTS, SMALL, mission_of
from tests.link.test_forwarding import RECEIVER, Program

ALLOWED = SMALL.replace("vehicles = 4", "vehicles = 4\nforward_commands = true")
LAND = dialect.MAVLink_command_long_message(2, 1, 21, 0, 0, 0, 0, 0, 0, 0, 0)


class _InHold(Observer):
    """Does something in the hold."""

    def __init__(self, act: Callable[[], None]) -> None:
        self._act = act

    def event(self, event: RunEvent) -> None:
        if (event.kind, event.text) == ("stage", "hold"):
            self._act()


def flown(folder: Path, text: str, autopilot: str, *said: Message) -> tuple[RunResult, Program]:
    """Fly with a program that watches, and says something in the hold."""

    async def run() -> tuple[RunResult, Program]:
        program = await Program.start()
        options = FlyOptions(autopilot=autopilot, forward=(str(RECEIVER),), logs=folder, write_report=False)
        result = await run_mission(mission_of(folder, text), options, [_InHold(lambda: program.say(*said))])
        await asyncio.sleep(0.1)  # the last datagram is still under way
        return result, program

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(run())


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_program_sees_the_whole_flight_and_commands_nobody(autopilot: str, tmp_path: Path) -> None:
    result, program = flown(tmp_path, SMALL, autopilot, LAND)
    assert result.completed, result.reason
    assert all(data[0] == MAGIC_V2 for data in program.datagrams)
    seen = program.sees()
    assert {"HEARTBEAT", "LOCAL_POSITION_NED", "COMMAND_ACK", "PARAM_VALUE"} <= set(seen)
    summary = result.summary
    assert (len(seen), 0) == (summary["forwarded"], summary["not_forwarded"])
    assert (summary["commands_passed"], summary["commands_dropped"]) == (0, 1)
    said = (result.folder / "events.jsonl").read_text()
    assert said.count("what it says to vehicles is not passed on: the mission does not allow it") == 1


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_vehicle_that_a_program_commands_is_theirs_and_the_others_come_home(autopilot: str, tmp_path: Path) -> None:
    result, _ = flown(tmp_path, ALLOWED, autopilot, LAND)
    assert not result.completed
    assert "vehicle 2 is taken over" in result.reason
    assert (result.summary["commands_passed"], result.summary["commands_dropped"]) == (1, 0)
    assert result.summary["vehicles_not_down"] == []
    assert "vehicle 2 is somebody else's from now on: COMMAND_LONG" in (result.folder / "events.jsonl").read_text()


def test_a_program_that_streams_setpoints_has_its_vehicle_alone(tmp_path: Path) -> None:
    """No mode changes, so that nothing but the handing over tells whose it is."""
    setpoint = dialect.MAVLink_set_position_target_local_ned_message(
        0, 2, 1, 1, 0x9F8, 0, 0, -8.0, 0, 0, 0, 0, 0, 0, 0, 0
    )
    result, _ = flown(tmp_path, ALLOWED, "px4", setpoint)
    assert not result.completed
    assert "vehicle 2 is taken over" in result.reason
    assert result.summary["vehicles_not_down"] == []


@pytest.mark.parametrize(
    ("forward", "said"),
    [
        ("udpin:14560", "is not of the form [NAME=]udpout:HOST:PORT or [NAME=]tcp:HOST:PORT"),
        ("nonsense", "is not of the form udpin:HOST:PORT"),
        ("udpout:127.0.0.1:14550", "vehicles are heard at port 14550; another program needs another one"),
    ],
)
def test_bad_receivers_are_one_clear_line(
    forward: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mission_of(tmp_path)
    arguments = ["fly", str(tmp_path / "mission.toml"), "--connect", "udpin:14550", "--logs", str(tmp_path / "logs")]
    assert main([*arguments, "--forward", forward]) == 2
    told = capsys.readouterr().err
    assert told.startswith("fg-gcs: --forward: ")
    assert said in told
    assert told.count("\n") == 1
    assert not (tmp_path / "logs").exists()
