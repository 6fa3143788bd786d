"""The program as a library: whole flights in virtual time, watched and disturbed from outside."""

from __future__ import annotations

import asyncio
import json
import math
from pathlib import Path

import numpy as np
import pytest

from fg_gcs.errors import LinkError, PlanError
from fg_gcs.flight.director import Director
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.run import (
    FlyOptions,
    MissionError,
    Observer,
    Outcome,
    OwnSightings,
    RunEvent,
    RunResult,
    Snapshot,
    fly_blocking,
    parse_mission,
    plan,
    report,
)
from fg_gcs.run import fly as run_mission
from tests.flight.harness import CIRCLING, SMALL

IMPOSSIBLE = (  # the free formulation bends no path, and the shortest way behind the formation leads over the fence
    SMALL.replace("[hold]", '[plan]\nformulation = "free"\n[hold]')
    .replace("30.0, 30.0, 30.0", "30.0, 30.0, 13.6")
    .replace("[-6.0, 10.0, 12.0]", "[-12.0, 0.0, 12.0]")
)


class Watcher(Observer):
    """Keeps everything, and acts once, in a stage."""

    def __init__(self, stage: str = "", act: object = None) -> None:
        self.snapshots: list[Snapshot] = []
        self.events: list[RunEvent] = []
        self.director: Director | None = None
        self._stage, self._act = stage, act

    def started(self, director: Director) -> None:
        self.director = director

    def event(self, event: RunEvent) -> None:
        self.events.append(event)
        if event.kind == "stage" and event.text == self._stage and callable(self._act):
            self._act(self)

    def snapshot(self, snapshot: Snapshot) -> None:
        self.snapshots.append(snapshot)


class Clumsy(Observer):
    """Fails at whatever it hears."""

    def event(self, event: RunEvent) -> None:
        raise RuntimeError("clumsy")

    def snapshot(self, snapshot: Snapshot) -> None:
        raise RuntimeError("clumsy")


def flown(folder: Path, *observers: Observer, text: str = SMALL, **options: object) -> RunResult:
    chosen = FlyOptions(logs=folder, write_report=False, **options)  # type: ignore[arg-type]
    return fly_blocking(parse_mission(text, Path("small.toml")), chosen, observers, speed=math.inf)


def test_a_flight_says_nothing_and_leaves_everything(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    mission = parse_mission(SMALL, Path("small.toml"))
    result = fly_blocking(mission, FlyOptions(logs=tmp_path), speed=math.inf)
    assert capfd.readouterr() == ("", "")
    assert result.outcome is Outcome.COMPLETED
    assert result.completed
    assert result.in_order
    assert result.reason == ""
    assert result.error is None
    assert result.summary["vehicles_landed"] == 4
    assert result.folder.name.endswith("-small")
    assert json.loads((result.folder / "summary.json").read_text()) == result.summary
    assert result.report is not None
    first = result.report.read_bytes()
    assert report(result.folder) == (result.report, ())
    assert result.report.read_bytes() == first


def test_it_is_awaited_on_whatever_loop_there_is(tmp_path: Path) -> None:
    async def two() -> list[RunResult]:
        options = FlyOptions(logs=tmp_path, write_report=False)
        return [await run_mission(parse_mission(SMALL), options) for _ in range(2)]

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        results = runner.run(two())
    assert [result.completed for result in results] == [True, True]


def test_snapshots_tell_the_flight_in_order_and_survive_the_wire(tmp_path: Path) -> None:
    watcher = Watcher()
    result = flown(tmp_path, watcher, text=CIRCLING)
    assert result.completed
    taken = watcher.snapshots
    assert [snapshot.number for snapshot in taken] == list(range(len(taken)))
    apart_s = np.diff([snapshot.time_s for snapshot in taken])
    assert apart_s.min() >= 0.02 - 1e-9
    assert len(taken) <= 25.0 * taken[-1].time_s + 1.0
    stages = list(dict.fromkeys(snapshot.stage for snapshot in taken))
    assert stages == [stage for stage in taken[0].stages if stage in stages]
    assert {"take-off", "approach", "hold", "home", "land"} <= set(stages)
    told = [event for snapshot in taken for event in snapshot.events]
    begin = watcher.events.index(told[0])
    assert told == watcher.events[begin : begin + len(told)]
    assert len(told) > 20
    tracked = [snapshot for snapshot in taken if snapshot.tracking is not None and snapshot.tracking.caught]
    assert tracked
    for snapshot in (taken[0], tracked[0], taken[-1]):
        assert Snapshot.from_json(snapshot.to_json()) == snapshot
    face, target = tracked[-1].formation, tracked[-1].target
    assert face is not None
    assert target is not None
    assert len(face.leaders) == 3
    assert np.dot(face.normal_enu, np.subtract(target.position_enu_m, face.centre_enu_m)) > -1.5  # behind it by less
    assert np.linalg.norm(face.normal_enu) == pytest.approx(1.0)
    first = tracked[0].vehicles[0]
    assert first.setpoint_enu_m is not None
    assert first.position_enu_m is not None
    assert math.dist(first.setpoint_enu_m, first.position_enu_m) < 0.5


def test_watching_changes_nothing(tmp_path: Path) -> None:
    alone = flown(tmp_path / "alone", text=CIRCLING)
    watched = flown(tmp_path / "watched", Watcher(), Clumsy(), text=CIRCLING)
    for name in ("telemetry.npy", "setpoints.npy", "flight.tlog"):
        assert (alone.folder / name).read_bytes() == (watched.folder / name).read_bytes()


def test_an_observer_that_fails_is_told_of_once_and_hears_no_more(tmp_path: Path) -> None:
    watcher = Watcher()
    assert flown(tmp_path, Clumsy(), watcher).completed
    assert [event.text for event in watcher.events if "Clumsy" in event.text] == [
        "observer Clumsy failed and hears no more: RuntimeError('clumsy')"
    ]


@pytest.mark.parametrize("line", [b"", b"{}", b"[]", b"null", b'{"version": 2}', b"\xff", b'{"version": 1}'])
def test_what_is_no_snapshot_is_refused(line: bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 # of several kinds
        Snapshot.from_json(line)


def test_a_flight_that_is_stopped_is_aborted_and_in_order(tmp_path: Path) -> None:
    def stop(watcher: Watcher) -> None:
        assert watcher.director is not None
        watcher.director.interrupt("enough")

    result = flown(tmp_path, Watcher("approach", stop))
    assert (result.outcome, result.reason) == (Outcome.ABORTED, "enough")
    assert result.in_order
    assert result.summary["vehicles_landed"] == 4


def test_a_flight_that_is_cancelled_brings_everything_down_first(tmp_path: Path) -> None:
    async def cancelled() -> None:
        tasks: list[asyncio.Task[RunResult]] = []
        observer = Watcher("approach", lambda _: tasks[0].cancel())
        options = FlyOptions(logs=tmp_path, write_report=False)
        tasks.append(asyncio.create_task(run_mission(parse_mission(SMALL), options, [observer])))
        with pytest.raises(asyncio.CancelledError):
            await tasks[0]

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(cancelled())
    (folder,) = tmp_path.iterdir()
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["completed"] is False
    assert summary["reason"] == "cancelled"
    assert summary["vehicles_landed"] == 4
    assert summary["vehicles_not_down"] == []


def test_a_fault_of_ours_is_reported_after_everything_is_down(tmp_path: Path) -> None:
    def fail(watcher: Watcher) -> None:
        assert watcher.director is not None
        watcher.director.fail({"message": "of ours", "exception": ZeroDivisionError("of ours")})

    result = flown(tmp_path, Watcher("approach", fail))
    assert result.outcome is Outcome.FAILED
    assert isinstance(result.error, ZeroDivisionError)
    assert result.summary["vehicles_landed"] == 4


def test_no_plan_and_no_answer_are_outcomes_with_a_record(tmp_path: Path) -> None:
    unplanned = flown(tmp_path, text=IMPOSSIBLE)
    assert unplanned.outcome is Outcome.NOT_FLOWN
    assert isinstance(unplanned.error, PlanError)
    unheard = flown(tmp_path, connect=("udpin:127.0.0.1:14600",), wait_s=3.0)
    assert unheard.outcome is Outcome.NO_ANSWER
    assert isinstance(unheard.error, LinkError)
    for result in (unplanned, unheard):
        assert json.loads((result.folder / "summary.json").read_text())["reason"] == result.reason
        assert report(result.folder).path.exists()


def test_what_is_wrong_before_anything_began_is_raised(tmp_path: Path) -> None:
    taken = tmp_path / "logs"
    taken.write_text("")
    with pytest.raises(MissionError, match="--logs"):
        flown(taken)
    with pytest.raises(MissionError, match="--connect"):
        flown(tmp_path, connect=("nowhere",))


def test_a_plan_can_be_had_without_flying(tmp_path: Path) -> None:
    planned = plan(parse_mission(SMALL))
    assert planned.figures["vehicles"] == 4
    sample = planned.flight.approach.sample(np.linspace(0.0, planned.flight.approach.duration_s, 50))
    assert sample.position_m.shape == (50, 4, 3)
    planned.draw(tmp_path / "plan.png")
    assert (tmp_path / "plan.png").stat().st_size > 10_000
    with pytest.raises(PlanError, match=r"mission\.toml"):
        plan(parse_mission(IMPOSSIBLE))


def test_cancelling_twice_lands_on_the_spot_and_the_summary_tells_the_truth(tmp_path: Path) -> None:
    async def cancelled() -> None:
        tasks: list[asyncio.Task[RunResult]] = []

        def cancel(_: Watcher) -> None:
            tasks[0].cancel()
            asyncio.get_running_loop().call_later(0.3, tasks[0].cancel)

        options = FlyOptions(logs=tmp_path, write_report=False)
        tasks.append(asyncio.create_task(run_mission(parse_mission(SMALL), options, [Watcher("approach", cancel)])))
        with pytest.raises(asyncio.CancelledError):
            await tasks[0]

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(cancelled())
    (folder,) = tmp_path.iterdir()
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["vehicles_landed"] == 4
    assert summary["vehicles_not_down"] == []
    assert "landing apart from each other: cancelled" in (folder / "events.jsonl").read_text()


@pytest.mark.parametrize("error", [SystemExit(1), asyncio.CancelledError(), KeyError("observer")], ids=repr)
def test_whatever_an_observer_raises_ends_no_flight(error: BaseException, tmp_path: Path) -> None:
    def fail(_: Watcher) -> None:
        raise error

    assert flown(tmp_path, Watcher("approach", fail)).completed


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"autopilot": "x"}, "accepted: px4 or ardupilot"),
        ({"wait_s": -1.0}, "accepted: a number above 0"),
        ({"wait_s": math.nan}, "accepted: a number above 0"),
        ({"snapshot_hz": 0.0}, "accepted: a number above 0"),
        ({"connect": "udpin:127.0.0.1:1"}, "accepted: a tuple"),
        ({"motions": {"nobody": None}}, "no target is called 'nobody'"),
    ],
)
def test_options_that_mean_nothing_are_refused_before_anything_begins(
    options: dict[str, object], said: str, tmp_path: Path
) -> None:
    with pytest.raises(MissionError, match=said):
        flown(tmp_path, text=CIRCLING, **options)
    assert not list(tmp_path.iterdir())


class Wrong:
    """A motion that answers in another shape, or not at all."""

    top_speed_m_s, box_enu_m = 1.0, np.zeros((2, 3))

    def __init__(self, answer: object) -> None:
        self._answer = answer

    def at(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if isinstance(self._answer, Exception):
            raise self._answer
        return self._answer  # type: ignore[return-value] # what is tried


@pytest.mark.parametrize(
    "answer",
    [None, np.zeros((2, 3)), (np.zeros(3),) * 2, (np.zeros((3, 2)),) * 2, (np.full((2, 3), np.nan),) * 2, KeyError()],
)
def test_motions_that_answer_wrongly_are_refused_before_anything_is_armed(answer: object, tmp_path: Path) -> None:
    with pytest.raises(MissionError, match="the motion of lead"):
        flown(tmp_path, text=CIRCLING, motions={"lead": Wrong(answer)})


@pytest.mark.parametrize("place", [(1.0, 2.0), ((1.0, 2.0, 3.0),), "here", np.zeros((2, 3))], ids=repr)
def test_sightings_that_are_no_three_numbers_are_refused_where_they_are_put(place: object) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 # NumPy's own, for what is no number at all
        OwnSightings().put(place)  # type: ignore[arg-type] # what is tried
