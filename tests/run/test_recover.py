"""After a run that was killed: everything it had in the air comes down apart, and has its own parameters again."""

from __future__ import annotations

import asyncio
import os
import time
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.errors import LinkError
from fg_gcs.link.clock import VirtualTimeLoop, ticks
from fg_gcs.record.write.kept_parameters import Kept, KeptParameters, read_kept
from fg_gcs.run.flying import FlyOptions
from fg_gcs.run.flying import fly as run_mission
from fg_gcs.run.recovering import RecoverOptions, RecoverResult, recover
from fg_gcs.run.simulators import VIRTUAL_EPOCH_S
from sitl_mock import read_key
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.host.server import Simulator, SimulatorOptions
from tests.flight.harness import AUTOPILOTS, GROUND_PORT, OTHER_PORT, UPRIGHT, Flight, OtherStation, _Beside, mission_of

OWN = {"px4": ("COM_OBL_RC_ACT", 0.0), "ardupilot": ("FS_GCS_ENABLE", 0.0)}


def values_of(parameters: Parameters) -> dict[str, float]:
    names = [parameters.name_at(index) for index in range(len(parameters))]
    return {name: parameters[name] for name in names if name is not None}


class Crash:
    """A flight that is killed at a stage, and what `recover` makes of it some seconds later."""

    def __init__(
        self,
        folder: Path,
        autopilot: str,
        stage: str,
        later_s: float,
        mode: str = "",
        key: Path | None = None,
        ago_s: float = 0.0,
    ) -> None:
        self.state, self.folder, self.mode = folder / "state", folder, mode
        self.key, self.keys = key, () if key is None else (str(key),)
        self.stage, self.later_s = stage, later_s
        self.ago_s = ago_s  # by the files' own times
        self.autopilot = autopilot
        self.closest_m = np.inf

    def run(self) -> RecoverResult:
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            return runner.run(self._run())

    async def _run(self) -> RecoverResult:
        mission = mission_of(self.folder, UPRIGHT)
        self.simulator = Simulator(
            SimulatorOptions(
                autopilot=self.autopilot,
                pads_enu_m=tuple((x, y) for x, y in mission.pads_enu_m().tolist()),
                system_ids=mission.swarm.ids(),
                remotes=(("127.0.0.1", GROUND_PORT), ("127.0.0.1", OTHER_PORT)),
                signing_key=None if self.key is None else read_key(self.key),
                epoch_s=VIRTUAL_EPOCH_S,
            )
        )
        await self.simulator.start()
        other = await OtherStation.open()
        killed = asyncio.Event()

        async def kill(flight: Flight) -> None:
            await flight.reaches(self.stage)
            await asyncio.sleep(1.0)
            if self.mode:
                assert flight.director.fleet is not None
                other.command_mode(2, flight.director.fleet.vehicles[1].profile.modes[self.mode])
            # As the system does with a process that is killed: its sockets are closed, its locks are let go
            assert flight.director.fleet is not None
            flight.director.fleet.router.close()
            kept = flight.director._setup.kept  # noqa: SLF001 # a process that is killed is not asked
            assert kept is not None
            kept.close()
            killed.set()

        where = (f"udpin:127.0.0.1:{GROUND_PORT}",)
        options = FlyOptions(
            where,
            knows_origin=True,
            logs=self.folder,
            state=self.state,
            write_report=False,
            signing_keys=self.keys,
        )
        flight = asyncio.ensure_future(run_mission(mission, options, [_Beside(self.simulator, kill)]))
        await killed.wait()
        assert len({kept.uid for kept in read_kept(self.state)} - {""}) == 4
        await asyncio.sleep(self.later_s)
        if self.ago_s:
            self._age()
        watch = asyncio.ensure_future(self._watch())
        how = RecoverOptions(wait_s=6.0, logs=self.folder, state=self.state, signing_keys=self.keys)
        result = await recover(how)
        watch.cancel()
        flight.cancel()
        self.armed, self.highest_m = self.simulator.armed, self.simulator.positions_enu_m[:, 2].max()
        self.parameters = [v.autopilot.parameters[OWN[self.autopilot][0]] for v in self.simulator.fleet.vehicles]
        await self.simulator.close()
        await asyncio.gather(flight, return_exceptions=True)
        return result

    def _age(self) -> None:
        """Let it be so long ago; the flight, which is not killed but made deaf, goes on writing elsewhere."""
        for run in {Path(kept.run) for kept in read_kept(self.state)}:
            run.rename(run.with_suffix(".moved"))
        then_s = time.time() - self.ago_s
        for path in self.state.glob("*.json"):
            os.utime(path, (then_s, then_s))

    def run_and_fly_again(self) -> list[dict[str, float]]:
        """Return the parameters of each vehicle that are not what they were before the first flight."""
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            return runner.run(self._fly_again())

    async def _fly_again(self) -> list[dict[str, float]]:
        mission = mission_of(self.folder, UPRIGHT)
        simulator = Simulator(
            SimulatorOptions(
                autopilot=self.autopilot,
                pads_enu_m=tuple((x, y) for x, y in mission.pads_enu_m().tolist()),
                system_ids=mission.swarm.ids(),
                remotes=(("127.0.0.1", GROUND_PORT),),
            )
        )
        await simulator.start()
        parameters = [vehicle.autopilot.parameters for vehicle in simulator.fleet.vehicles]
        before = [values_of(each) for each in parameters]
        killed = asyncio.Event()

        async def kill(flight: Flight) -> None:
            await flight.reaches(self.stage)
            assert flight.director.fleet is not None
            flight.director.fleet.router.close()
            killed.set()

        options = FlyOptions(
            (f"udpin:127.0.0.1:{GROUND_PORT}",),
            knows_origin=True,
            logs=self.folder,
            state=self.state,
            write_report=False,
        )
        first = asyncio.ensure_future(run_mission(mission, options, [_Beside(simulator, kill)]))
        await killed.wait()
        first.cancel()
        await asyncio.gather(first, return_exceptions=True)
        assert len(read_kept(self.state)) == 4
        await asyncio.sleep(self.later_s)
        assert not simulator.armed.any()
        assert (await run_mission(mission, options)).completed
        now = [dict(values_of(each).items() - old.items()) for each, old in zip(parameters, before, strict=True)]
        await simulator.close()
        return now

    async def _watch(self) -> None:
        async for _ in ticks(asyncio.get_running_loop().time(), 0.05):
            places = self.simulator.positions_enu_m
            gaps = np.linalg.norm(places[:, None] - places[None, :], axis=2)
            up = places[:, 2] > 0.3
            gaps[~(up[:, None] | up[None, :])] = np.inf
            np.fill_diagonal(gaps, np.inf)
            self.closest_m = min(self.closest_m, float(gaps.min()))


@pytest.mark.parametrize(
    ("stage", "later_s", "autopilot"),
    [
        ("take-off", 0.5, "px4"),
        ("take-off", 0.5, "ardupilot"),
        ("approach", 0.5, "px4"),
        ("hold", 0.5, "ardupilot"),
        ("hold", 4.0, "px4"),
        ("hold", 4.0, "ardupilot"),
    ],
)
def test_what_was_left_in_the_air_comes_down_apart(stage: str, later_s: float, autopilot: str, tmp_path: Path) -> None:
    crash = Crash(tmp_path, autopilot, stage, later_s)
    result = crash.run()
    assert result.in_order
    assert [each.ours for each in result.vehicles] == [True] * 4
    assert not crash.armed.any()
    assert crash.highest_m < 0.1
    assert crash.parameters == [OWN[autopilot][1]] * 4
    assert crash.closest_m >= 1.45
    assert read_kept(crash.state) == []


def test_what_another_station_flies_is_left_alone(tmp_path: Path) -> None:
    """They follow setpoints so long after the last sign of life of their run that somebody else must send them."""
    crash = Crash(tmp_path, "ardupilot", "hold", 0.5, ago_s=60.0)
    result = crash.run()
    assert not result.in_order
    assert {each.parameters for each in result.vehicles} == {"another ground station flies it: left alone"}
    assert [each.ours for each in result.vehicles] == [False] * 4
    assert result.missing == []
    assert crash.armed.all()
    assert OWN["ardupilot"][1] not in crash.parameters
    assert len(read_kept(crash.state)) == 4


def test_what_cannot_be_read_any_more_is_told(tmp_path: Path) -> None:
    crash = Crash(tmp_path, "px4", "take-off", 0.5)
    crash.state.mkdir()
    (crash.state / "damaged.json").write_text('{"network": "ma')
    result = crash.run()
    assert result.unreadable == [str(crash.state / "damaged.json")]
    assert not result.in_order
    assert crash.parameters == [OWN["px4"][1]] * 4


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("mode", ["LAND", "LOITER"])
def test_whatever_mode_one_of_them_is_in(mode: str, autopilot: str, tmp_path: Path) -> None:
    crash = Crash(tmp_path, autopilot, "hold", 1.0, mode)
    assert crash.run().in_order
    assert not crash.armed.any()
    assert crash.parameters == [OWN[autopilot][1]] * 4


def test_after_landing_only_parameters_are_put_back(tmp_path: Path) -> None:
    crash = Crash(tmp_path, "px4", "land", 25.0)
    result = crash.run()
    assert result.in_order
    assert all("disarmed" in each.was for each in result.vehicles)
    assert crash.parameters == [0.0] * 4


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_over_signed_links_too(autopilot: str, tmp_path: Path) -> None:
    """The stamps that the run used are on disk: what recovers goes on from there."""
    key = tmp_path / "swarm.key"
    key.write_text("a passphrase\n")
    key.chmod(0o600)
    crash = Crash(tmp_path, autopilot, "hold", 0.5, key=key)
    assert crash.run().in_order
    assert not crash.armed.any()
    assert crash.closest_m >= 1.45
    assert crash.simulator.counters.not_signed == 0


def run(options: RecoverOptions) -> RecoverResult:
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(recover(options))


def test_nobody_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="no vehicle answered within 2 s"):
        run(RecoverOptions(wait_s=2.0, logs=tmp_path, state=tmp_path / "state"))


def test_the_vehicles_of_a_run_that_is_alive_are_not_touched(tmp_path: Path) -> None:
    with KeptParameters(tmp_path / "state") as mine:
        mine.keep(Kept("main", 1, "", "udpin:127.0.0.1:14550", "PX4", {"A": 1.0}, {"A": 2.0}, "logs/mine", mine.lock))
        result = run(RecoverOptions(logs=tmp_path, state=tmp_path / "state"))
    assert (result.alive, result.vehicles, result.folder) == ("logs/mine", [], None)
    assert not result.in_order


def test_without_anything_kept_vehicles_are_only_looked_at(tmp_path: Path) -> None:
    async def look() -> tuple[RecoverResult, float]:
        simulator = Simulator(
            SimulatorOptions(autopilot="px4", pads_enu_m=((0.0, 0.0),), remotes=(("127.0.0.1", GROUND_PORT),))
        )
        await simulator.start()
        result = await recover(RecoverOptions(logs=tmp_path, state=tmp_path / "state"))
        value = simulator.fleet.vehicles[0].autopilot.parameters["COM_OBL_RC_ACT"]
        await simulator.close()
        return result, value

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        result, value = runner.run(look())
    assert [(each.vehicle, each.ours, each.parameters) for each in result.vehicles] == [
        ("1", False, "not ours: left alone")
    ]
    assert result.in_order
    assert value == 0.0


def test_without_recover_the_next_flight_puts_every_parameter_back(tmp_path: Path) -> None:
    crash = Crash(tmp_path, "ardupilot", "hold", 200.0)
    assert crash.run_and_fly_again() == [{}] * 4
    assert read_kept(crash.state) == []


@pytest.mark.parametrize("uid", ["", "000000015349544c", "00000002ffffffff"])
def test_what_is_kept_is_put_back_onto_no_other_hardware(uid: str, tmp_path: Path) -> None:
    """A board that was exchanged has its id and its place, and values of its own."""
    state, name = tmp_path / "state", "FS_GCS_ENABLE"

    async def look() -> tuple[RecoverResult, float]:
        simulator = Simulator(
            SimulatorOptions(autopilot="ardupilot", pads_enu_m=((0.0, 0.0),), remotes=(("127.0.0.1", GROUND_PORT),))
        )
        parameters = simulator.fleet.vehicles[0].autopilot.parameters
        parameters.write(name, 5.0, 9)
        await simulator.start()
        result = await recover(RecoverOptions(logs=tmp_path, state=state))
        await simulator.close()
        return result, parameters[name]

    with KeptParameters(state) as crashed:
        where = f"udpin:127.0.0.1:{GROUND_PORT}"
        crashed.keep(Kept("main", 1, uid, where, "ArduPilot", {name: 2.0}, {name: 5.0}, "logs/gone", "gone.lock"))
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        result, value = runner.run(look())
    own = not uid.endswith("ffff")
    assert ([each.ours for each in result.vehicles], value) == ([own], 2.0 if own else 5.0)
    assert len(read_kept(state)) == (0 if own else 1)
    assert bool(result.missing) is not own
