"""Whatever fails, no two vehicles meet and none is left in the air: whole flights, judged by the simulator's truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from fg_gcs.mission import Mission, load_mission, parse_mission
from fg_gcs.run.harms import Death, Deaths, Stall, Stranger, StrangerKind
from fg_gcs.run.trial import Judgement, Trial, judge
from fg_gcs.run.trials import TASKS, WRONGS, trial_of
from tests.flight.harness import AUTOPILOTS, SMALL, UPRIGHT

MISSIONS = Path(__file__).parents[2] / "missions"
DEMO = load_mission(MISSIONS / "demo.toml")
FOUR = parse_mission(SMALL)
PAPER = load_mission(MISSIONS / "paper_front.toml")
MUTED = {"direction": "both", "loss": 1.0}
BOTH = ("px4", "ardupilot")


Table = Mapping[str, object]


def judged(
    autopilot: str,
    mission: Mission = DEMO,
    faults: tuple[Table, ...] = (),
    impairments: tuple[Table, ...] = (),
    stops: tuple[tuple[str, float], ...] = (),
    **ours: Any,  # noqa: ANN401 - whatever a trial does to the station
) -> Judgement:
    """Fly, and let nothing be broken."""
    found = judge(Trial(mission, autopilot, faults=faults, impairments=impairments, stops=stops, **ours))
    assert found.broken == []
    return found


def said(found: Judgement) -> str:
    return "\n".join(found.events)


def completed(found: Judgement) -> bool:
    assert found.result is not None
    return found.result.completed


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("mode", ["LAND", "LOITER", "RTL"])
def test_one_that_somebody_else_has_is_left_alone_and_comes_down_in_the_end(mode: str, autopilot: str) -> None:
    fault = {"kind": "taken_over", "mode": mode, "vehicles": [2], "stage": "hold", "at_s": 1.0}
    found = judged(autopilot, FOUR, faults=(fault,))
    assert f"vehicle 2 is taken over: something else changed its mode ({mode})" in said(found)
    hovers = mode == "LOITER" and autopilot == "px4"  # ArduPilot's sinks while no pilot holds the throttle
    assert ("nobody has brought it down for 60 s" in said(found)) == hovers


@pytest.mark.parametrize(
    ("autopilot", "link"),
    [("ardupilot", {"loss": 0.2}), ("px4", {"delay_s": 0.1, "jitter_s": 0.1, "reorder": 0.1, "duplicate": 0.1})],
    ids=["20 % lost", "150 +- 50 ms"],
)
def test_bad_links_are_flown_on(link: dict[str, float], autopilot: str) -> None:
    found = judged(autopilot, impairments=(link,))
    assert completed(found), said(found)


def test_the_judge_sees_what_it_is_there_for() -> None:
    """Vehicles that come closer than is asked for, and one that stays in the air, are told."""
    strict = DEMO.model_copy(update={"limits": DEMO.limits.model_copy(update={"separation_m": 2.6})})
    found = judge(Trial(strict, stops=(("connect", 0.1),)))
    assert found.broken == []  # nobody flew
    far = judge(Trial(DEMO, impairments=({**MUTED, "vehicles": [3], "stage": "hold", "at_s": 1.0},)), 9.0)
    assert any("one of which could not hear us" in line for line in far.broken)


def test_a_seed_is_a_trial_and_a_trial_is_a_flight() -> None:
    missions = [FOUR]
    trials = [trial_of(seed, missions, BOTH, ("paper",)) for seed in range(300)]
    assert [trial.text for trial in trials] == [trial_of(n, missions, BOTH, ("paper",)).text for n in range(300)]
    assert all(trial_of(seed, missions, BOTH, ("paper",), 0).faultless for seed in range(9))
    assert not any(trial.faultless for trial in trials)
    assert len({trial.text for trial in trials}) > 250
    kinds = {table["kind"] for trial in trials for table in trial.faults}
    assert kinds == {"taken_over", "dead", "battery_low", "reboot", "origin"}
    assert len(WRONGS) == 15
    assert {death.task for trial in trials for death in trial.deaths} == {*TASKS}
    assert {each.kind for trial in trials for each in trial.strangers} == {"station", "twin"}
    assert all(1.0 <= stall.lasts_s <= 5.0 for trial in trials for stall in trial.stalls)
    first, second = (judge(trials[7]) for _ in range(2))
    assert (first.events, first.closest_m, first.ended_s) == (second.events, second.closest_m, second.ended_s)


@pytest.mark.parametrize("seed", range(2))
def test_random_trials_break_no_law(seed: int) -> None:
    missions = [load_mission(MISSIONS / f"{name}.toml") for name in ("demo", "sitl")]
    found = judge(trial_of(seed, missions, BOTH, ("paper",)))
    assert found.broken == []


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_vehicle_that_falls_while_it_lands_has_not_completed_its_flight(autopilot: str) -> None:
    fault = {"kind": "reboot", "vehicles": [2], "stage": "land", "at_s": 0.1}
    found = judged(autopilot, FOUR, faults=(fault,))
    assert not completed(found)
    assert found.result is not None
    assert found.result.reason == "disarmed in the air while landing: vehicle 2"


@pytest.mark.parametrize(("task", "hangs"), [("streamer", True), ("recorder", False)])
def test_a_task_of_the_station_that_dies_or_hangs_is_told_and_started_again(task: str, hangs: bool) -> None:
    found = judged("px4", FOUR, deaths=(Death(task, hangs, "approach", 1.0),))
    assert completed(found), said(found)
    assert f"the {task} {'hangs' if hangs else 'fails'}" in said(found)


def test_the_judge_sees_a_death_that_nobody_notices(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Deaths, "strike", lambda *_: True)  # it says so, and harms nobody
    found = judge(Trial(FOUR, deaths=(Death("watch", False, "hold", 0.5),)))
    assert found.broken == ["nobody noticed what became of the watch"]


@pytest.mark.parametrize(("autopilot", "lasts_s"), [("px4", 1.0), ("ardupilot", 4.0)])
def test_a_station_that_stood_still_says_so_and_brings_everybody_down(autopilot: str, lasts_s: float) -> None:
    found = judged(autopilot, FOUR, stalls=(Stall(lasts_s, "approach", 1.0),))
    assert found.result is not None
    assert found.result.reason == f"this program stood still for {lasts_s:.1f} s"
    assert found.result.summary["vehicles_landed"] == 4


@pytest.mark.parametrize(
    ("autopilot", "lasts_s", "becomes"),
    [
        ("px4", 5.0, "stage: land"),  # they hover, and follow setpoints again as soon as they come
        ("px4", 12.0, "stage: land"),  # they hover, as heartbeats are missing, too: they are called back
        ("px4", 17.0, "vehicles 1-4 are on the way down"),  # they return already, each at a height of its own
        ("ardupilot", 14.0, "vehicles 1-4 are on the way down"),
    ],
)
def test_after_a_stall_an_upright_formation_comes_down_without_meeting(
    autopilot: str, lasts_s: float, becomes: str
) -> None:
    found = judged(autopilot, parse_mission(UPRIGHT), stalls=(Stall(lasts_s, "approach", 1.0),))
    assert becomes in said(found)
    assert found.closest_unhearing_m > 1.5  # the mission's separation
    assert ("on the way down" in said(found)) is ("on the way down" in becomes)


@pytest.mark.parametrize(("autopilot", "stage"), [("ardupilot", "take-off"), ("px4", "land")])
def test_a_stall_without_setpoints_is_told_too(autopilot: str, stage: str) -> None:
    found = judged(autopilot, FOUR, stalls=(Stall(3.0, stage, 1.0),))
    assert "this program stood still for 3.0 s" in said(found)
    assert completed(found) is (stage == "land")


def test_the_judge_sees_a_stall_that_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fg_gcs.run.trial.stand_still", lambda *_: None)
    found = judge(Trial(FOUR, stalls=(Stall(2.0, "hold", 0.5),)))
    assert found.broken == ["nobody noticed that the station stood still in hold"]


@pytest.mark.parametrize("kind", ["station", "twin"])
def test_strangers_in_flight_change_nothing(kind: StrangerKind) -> None:
    found = judged("ardupilot", FOUR, strangers=(Stranger(kind, 2, "approach", 1.0),))
    assert completed(found), said(found)


def test_who_has_a_twin_before_arming_does_not_fly() -> None:
    found = judged("px4", FOUR, strangers=(Stranger("twin", 2, "connect", 0.05),))
    assert not completed(found)
    assert found.result is not None
    assert found.result.reason.startswith("two vehicles have the system id 2: at 127.0.0.1:")
    assert found.ended_s < 5.0
    assert found.closest_unhearing_m == float("inf")  # nobody left the ground
