"""Each row of the table in docs/failures.md on whole flights: noticed as soon as it says, answered as it says."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from fg_gcs.core.arrays import Array
from fg_gcs.flight.motions import Follow, SwarmSetpoint
from fg_gcs.flight.policy import ROWS, Care, FaultKind, Rung
from fg_gcs.flight.safety import FENCE_SLACK_M, LAG_S
from fg_gcs.flight.watch import FORGETS_S
from fg_gcs.link.clock import VirtualTimeLoop, ticks
from tests.flight.harness import CIRCLING, SMALL, Flight, Table, fly, mission_of, moving
from tests.flight.meddling import StandingStill

LOOKS_S = 0.01  # between two looks at the truth
CLEARED_S = 30.0  # until nobody is below one that is to land: the others fly home meanwhile
DELAY_S = 0.1  # of the link, with the time between two looks of what watches, and of the simulator's own steps
MUTED = {"loss": 1.0}
NOTHING: Table = MappingProxyType({})
POSITIONS, SETPOINTS = ["LOCAL_POSITION_NED"], ["SET_POSITION_TARGET_LOCAL_NED"]
EAST_M = 16.2
PAIR = (  # around the target vehicle 2 is 2.4 m south of vehicle 3, vehicle 1 is 0.3 m inside the fence's eastern side
    SMALL.replace('shape = "hemisphere"\nleaders = 3\nfollowers = 1\nedge_m = 6.0', 'shape = "custom"')
    .replace("normal_enu", "leaders_yz_m = [[-1.2, 0.0], [1.2, 0.0], [0.0, 4.0], [-2.0, 4.0]]\nnormal_enu")
    .replace("[-6.0, 10.0, 12.0]", "[12.0, 0.0, 12.0]")
    .replace("[30.0, 30.0, 30.0]", f"[{EAST_M}, 30.0, 30.0]")
    .replace("duration_s = 2.0", "duration_s = 6.0")
)
LONG = SMALL.replace("duration_s = 2.0", "duration_s = 6.0")


class Noticed(NamedTuple):
    """The event that a fault is."""

    at_s: float  # since the run's start
    text: str
    vehicles: list[int]
    value: float | None


Check = Callable[[Flight, Noticed], None]


class Made(NamedTuple):
    """How a fault is made.

    Attributes:
        autopilot: of the vehicles.
        within_s: how soon it is to be noticed [s].
        stage: some time after its beginning it is made.
        at_s: that time [s].
        vehicles: system ids of those that it is about.
        fault: inside them.
        link: what is wrong with their links.
        act: makes it by hand.
        begins: when it counts as made by the truth, after all that; None: at once.
        text: of the mission.
    """

    autopilot: str
    within_s: float
    stage: str = "approach"
    at_s: float = 1.0
    vehicles: tuple[int, ...] = (3,)
    fault: Table = NOTHING
    link: Table = NOTHING
    act: Callable[[Flight], None] | None = None
    begins: Callable[[Flight], Callable[[], bool]] | None = None
    text: str = SMALL


def kill(coroutine: str, times: int = 1) -> Callable[[Flight], None]:
    """Return what ends the task of a coroutine, and those that take its place."""

    def act(flight: Flight) -> None:
        for task in asyncio.all_tasks():
            if getattr(task.get_coro(), "__qualname__", "") == coroutine:
                task.cancel()
        if times > 1:
            asyncio.get_running_loop().call_later(0.2, kill(coroutine, times - 1), flight)

    return act


class Jumping(Follow):
    """A plan's motion that is elsewhere with one vehicle."""

    def at(self, now_s: float) -> SwarmSetpoint:
        wanted = SwarmSetpoint(*(array.copy() for array in super().at(now_s)))
        wanted.position_m[2] += (3.0, 0.0, 0.0)
        return wanted


def jump(flight: Flight) -> None:
    streamer = flight.director.streamer
    assert streamer is not None
    assert isinstance(streamer.motion, Follow)
    streamer.motion = Jumping(streamer.motion.rows, streamer.motion.plan, streamer.motion.pace)


def change_back(flight: Flight) -> None:
    flight.simulator.fleet.vehicles[2].autopilot.parameters.write("COM_OBL_RC_ACT", 0.0, 6)


def stand_still(flight: Flight) -> None:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, StandingStill)
    loop.stand_still(3.0)


def disarm(flight: Flight) -> None:
    flight.simulator.fleet.vehicles[2].autopilot.disarm("command", force=True)


def off_course(flight: Flight) -> Callable[[], bool]:
    """Vehicle 3 is farther off than the bound, by the truth, and what the speeds it was told explain."""
    rows, loop = flight.recorded.setpoints, asyncio.get_running_loop()
    own, since_s = rows["system_id"] == 3, flight.recorder.since_start_s(loop.time())
    fades = np.exp((rows["time_s"][own] - since_s) / FORGETS_S)
    speed = float((np.linalg.norm(rows["velocity_enu_m_s"][own], axis=1) * fades).max())
    began_s = loop.time()

    def far() -> bool:
        told = flight.director.wanted_enu_m(loop.time())[2]
        explained_m = LAG_S * speed * np.exp((began_s - loop.time()) / FORGETS_S)
        return bool(np.linalg.norm(told - flight.simulator.positions_enu_m[2]) > 1.5 + explained_m)

    return far


def too_near(flight: Flight) -> Callable[[], bool]:
    return lambda: bool(pdist(flight.simulator.positions_enu_m).min() < 1.5)


def outside(flight: Flight) -> Callable[[], bool]:
    return lambda: bool(flight.simulator.positions_enu_m[0, 0] > EAST_M + FENCE_SLACK_M)


def landing(flight: Flight) -> Callable[[], bool]:
    return lambda: flight.simulator.fleet.vehicles[2].autopilot.mode.name == "LAND"


def seen_for(seconds: float) -> str:
    """A moving target whose sightings come from a file that ends."""
    source = f'[targets.source]\nkind = "csv"\npath = "seen-{seconds:g}.csv"\n'
    return moving(f'[[targets]]\nname = "lead"\n{source}', "[track]\ngive_up_s = 5.0\n")


def outage(seconds: float, direction: str, **more: object) -> Table:
    return {**MUTED, "direction": direction, "for_s": seconds, **more}


GUST = {"kind": "wind", "speed_m_s": 30.0, "for_s": 0.5}
STORM = {"kind": "wind", "speed_m_s": 40.0, "for_s": 0.6}
TARGET_S = 6.0
MADE: Mapping[FaultKind, Sequence[Made]] = {
    FaultKind.SILENT: (Made("px4", 0.5 + DELAY_S, link=outage(1.5, "from_vehicle")),),
    FaultKind.LOST: (
        Made("px4", 2.2 + DELAY_S, link={**MUTED, "direction": "from_vehicle"}),
        Made("ardupilot", 2.2 + DELAY_S, link={**MUTED, "direction": "from_vehicle"}),
    ),
    FaultKind.STUCK: (Made("ardupilot", 0.5 + DELAY_S, link=outage(1.5, "from_vehicle", messages=POSITIONS)),),
    FaultKind.UNANSWERED: (Made("ardupilot", 0.6 + DELAY_S, stage="hold", link=outage(1.4, "to_vehicle")),),
    FaultKind.OFF_COURSE: (Made("px4", 0.5, stage="hold", fault=STORM, begins=off_course, text=LONG),),
    FaultKind.DEAF: (
        Made("ardupilot", 2.2 + DELAY_S, stage="hold", link={**MUTED, "direction": "to_vehicle"}),
        Made("ardupilot", 1.5 + DELAY_S, stage="hold", fault={**STORM, "for_s": 20.0}, begins=off_course, text=LONG),
    ),
    FaultKind.TAKEN: (
        Made("px4", 0.5, fault={"kind": "taken_over", "mode": "LAND"}),
        Made("ardupilot", 0.5, fault={"kind": "taken_over", "mode": "RTL"}),
    ),
    FaultKind.OWN_FAILSAFE: (
        Made("px4", 0.5, stage="hold", link={**MUTED, "messages": SETPOINTS}, begins=landing),
        Made(
            "ardupilot",
            0.5,
            stage="hold",
            link={**MUTED, "messages": ["HEARTBEAT"], "direction": "to_vehicle"},
            begins=landing,
            text=LONG.replace("6.0\n[limits]", "9.0\n[limits]"),
        ),
    ),
    FaultKind.DISARMED: (
        Made("px4", 1.0 + DELAY_S, stage="hold", act=disarm),
        Made("ardupilot", 0.2 + DELAY_S, stage="hold", act=disarm),
    ),
    FaultKind.SEPARATION: (
        Made(
            "px4",
            0.1 + DELAY_S,
            stage="hold",
            vehicles=(2, 3),
            fault={**GUST, "from_deg": 180.0, "vehicles": [2]},
            begins=too_near,
            text=PAIR,
        ),
    ),
    FaultKind.FENCE: (
        Made(
            "px4",
            0.1 + DELAY_S,
            stage="hold",
            vehicles=(1,),
            fault={**GUST, "from_deg": 270.0},
            begins=outside,
            text=PAIR,
        ),
    ),
    FaultKind.ORIGIN: (
        Made("px4", 0.1 + DELAY_S, fault={"kind": "origin", "offset_enu_m": [4.0, -3.0, 1.5]}),
        Made("ardupilot", 0.1 + DELAY_S, fault={"kind": "origin", "offset_enu_m": [4.0, -3.0, 1.5], "told": False}),
    ),
    FaultKind.BATTERY: (Made("px4", 0.5 + DELAY_S, fault={"kind": "battery_low", "remaining": 0.12}),),
    FaultKind.PARAMETER: (Made("px4", 5.0, act=change_back),),
    FaultKind.REFUSED: (
        Made(
            "ardupilot",
            12.0,
            stage="take-off",
            at_s=0.0,
            fault={"kind": "commands_refused", "command": "take_off", "text": "Motors hot"},
        ),
    ),
    FaultKind.TARGET: (Made("px4", 5.0 + DELAY_S, at_s=TARGET_S, vehicles=(), text=seen_for(TARGET_S)),),
    FaultKind.PLANNER: (Made("px4", 2.0, vehicles=(), act=kill("TargetFollower.run"), text=CIRCLING),),
    FaultKind.STREAMER: (Made("px4", 0.2, vehicles=(), act=kill("Streamer.run")),),
    FaultKind.STREAMER_AGAIN: (Made("px4", 0.4, vehicles=(), act=kill("Streamer.run", 2)),),
    FaultKind.BYSTANDER: (Made("px4", 5.0, vehicles=(), act=kill("Director._drain")),),
    FaultKind.STALL: (Made("px4", 3.0 + DELAY_S, vehicles=(), act=stand_still),),
    FaultKind.GATE: (Made("px4", 1.0 + DELAY_S, stage="hold", act=jump, text=LONG),),
    FaultKind.PROGRAM: (Made("px4", 0.5, vehicles=(), act=kill("Watch.run")),),
}


@pytest.fixture
def no_more(tmp_path: Path) -> None:
    rows = [f"{0.1 * k:.1f},lead,{15.0 - 0.1 * k:.2f},0,12" for k in range(round(10.0 * TARGET_S) + 1)]
    (tmp_path / f"seen-{TARGET_S:g}.csv").write_text("\n".join(["time_s,target,east_m,north_m,up_m", *rows]))


def test_every_row_has_flights() -> None:
    assert set(MADE) == set(KEPT) == set(FaultKind)


def test_every_task_of_the_page_is_killed_on_a_flight() -> None:
    page = (Path(__file__).parents[2] / "docs" / "failures.md").read_text()
    rows = page.partition("| task | watchdog |")[2].partition("\n\n")[0].splitlines()[2:]
    names = {name.strip() for row in rows for name in row.split("|")[1].partition(":")[0].split(",")}
    assert names == {*TASKS, "streamer", "watch", "planner of the inner loop", "recorder"}


@pytest.mark.usefixtures("no_more")
@pytest.mark.parametrize(
    ("kind", "made"),
    [
        pytest.param(kind, made, id=f"{kind.value}-{made.autopilot}-{made.stage}")
        for kind in MADE
        for made in MADE[kind]
    ],
)
def test_row(kind: FaultKind, made: Made, tmp_path: Path) -> None:
    flight, made_s = flown(made, tmp_path)
    noticed = notice(flight, kind)
    assert made_s - LOOKS_S <= noticed.at_s <= made_s + made.within_s
    assert noticed.vehicles == list(made.vehicles)
    row = ROWS[kind]
    RESPONSES[row.rung](flight, noticed)
    CARES[row.care](flight, noticed)
    KEPT[kind](flight, noticed)


TASKS: Mapping[str, Made] = {  # beside the rows above: streamer, planner, recorder, watch
    "descents": Made("px4", 0.5, stage="home", vehicles=(), act=kill("Descents.run")),
    "heartbeat": Made("ardupilot", 3.0, vehicles=(), act=kill("Router.keep_alive")),
    "parameters": Made("px4", 5.0, vehicles=(), act=kill("Failsafes.watch")),
    "compensation": Made("px4", 5.0, vehicles=(), act=kill("Compensation.run")),
}


@pytest.mark.parametrize("name", TASKS)
def test_task(name: str, tmp_path: Path) -> None:
    flight, made_s = flown(TASKS[name], tmp_path)
    kind = FaultKind.PROGRAM if name == "descents" else FaultKind.BYSTANDER
    noticed = notice(flight, kind)
    assert noticed.at_s <= made_s + TASKS[name].within_s
    RESPONSES[ROWS[kind].rung](flight, noticed)
    died(name)(flight, noticed)


# --- what follows ----------------------------------------------------------------------------------------------------


def goes_on(flight: Flight, noticed: Noticed) -> None:
    assert flight.director.result.completed
    assert flight.down_and_disarmed
    assert not spoken(flight, "abort")


def holds(flight: Flight, noticed: Noticed) -> None:
    """All come to rest by what they are told, and go on when the fault is over."""
    rows = flight.recorded.setpoints
    back_s = there_again_s(flight)
    speeds = np.linalg.norm(rows["velocity_enu_m_s"], axis=1)
    waiting = (rows["time_s"] > noticed.at_s) & (rows["time_s"] < back_s)
    last_s = rows["time_s"][waiting].max()
    assert speeds[waiting & (rows["time_s"] == last_s)].max() < 1.0  # as far as it can within that time
    assert speeds[rows["time_s"] > back_s].max() > 1.0
    goes_on(flight, noticed)


def comes_home(flight: Flight, noticed: Noticed) -> None:
    """They fly home, unless they have only begun to take off, and land."""
    result, (first, *_) = flight.director.result, spoken(flight, "abort")
    assert not result.completed
    assert (result.reason, first["text"]) == (noticed.text, f"aborting: {noticed.text}")
    *before, last = [event["stage"] for event in spoken(flight, "stage") if event["time_s"] >= noticed.at_s]
    assert last == "land"
    assert set(before) == (set() if "gather" not in result.stages else {"home"})  # anew after a further fault
    assert flight.down_and_disarmed


def lands_now(flight: Flight, noticed: Noticed) -> None:
    stages = [event["stage"] for event in spoken(flight, "stage") if event["time_s"] >= noticed.at_s]
    assert stages == ["land"]
    assert f"landing at once: {noticed.text}" in [event["text"] for event in spoken(flight, "abort")]
    assert flight.down_and_disarmed


RESPONSES: Mapping[Rung, Check] = {
    Rung.GO_ON: goes_on,
    Rung.HOLD: holds,
    Rung.HOME: comes_home,
    Rung.LAND_NOW: lands_now,
}


def flies(flight: Flight, noticed: Noticed) -> None:
    assert flight.director.result.lost == ()
    assert flight.truth_separation_m >= (1.4 if noticed.vehicles != [2, 3] else 1.2)


def is_told(flight: Flight, noticed: Noticed) -> None:
    """Setpoints to it go on all the time."""
    times_s = sent_s(flight, noticed.vehicles[0])
    assert np.diff(times_s[times_s > noticed.at_s - 0.1]).max() < 0.1
    assert there_again_s(flight) < times_s.max()


def is_landed(flight: Flight, noticed: Noticed) -> None:
    """It is given up: it gets no setpoints from when it is commanded to land, and later ways keep clear of it."""
    (label,) = noticed.vehicles
    assert [lost.label for lost in flight.director.result.lost] == [label]
    assert sent_s(flight, label).max() < noticed.at_s + CLEARED_S + DELAY_S
    assert "regions" in spoken(flight, "clear")[0]
    assert flight.truth_separation_m >= 1.0


def is_left(flight: Flight, noticed: Noticed) -> None:
    (label,) = noticed.vehicles
    assert [lost.label for lost in flight.director.result.lost] == [label]
    assert sent_s(flight, label).max() <= noticed.at_s + 1e-6
    assert f"where vehicle {label} may be" in spoken(flight, "clear")[0]["text"]
    assert flight.truth_separation_m >= 1.0


CARES: Mapping[Care, Check] = {Care.FLY: flies, Care.TELL: is_told, Care.LAND: is_landed, Care.LEAVE: is_left}


# --- what is kept ----------------------------------------------------------------------------------------------------


def last_telemetry(flight: Flight, noticed: Noticed) -> None:
    rows = flight.recorded.telemetry
    own = rows["time_s"][rows["system_id"] == noticed.vehicles[0]]
    assert noticed.at_s - own[own <= noticed.at_s].max() < 2.4


def value(least: float, most: float) -> Check:
    def check(flight: Flight, noticed: Noticed) -> None:
        assert noticed.value is not None
        assert least <= noticed.value <= most

    return check


def text(*words: str) -> Check:
    def check(flight: Flight, noticed: Noticed) -> None:
        assert all(word in noticed.text for word in words), noticed.text

    return check


def region(flight: Flight, noticed: Noticed) -> None:
    last_telemetry(flight, noticed)
    assert spoken(flight, "clear")[0]["regions"][0]["radius_m"] > 0.0


def failsafes_text(flight: Flight, noticed: Noticed) -> None:
    assert "(LAND)" in noticed.text
    assert any("failsafe" in event["text"].lower() for event in spoken(flight, "text"))


def tracks(flight: Flight, noticed: Noticed) -> None:
    assert len(flight.recorded.sightings["time_s"]) > 20
    assert noticed.text == "no sightings for 5 s"


def died(*tasks: str) -> Check:
    """The exception is in the event, and the task in the summary."""

    def check(flight: Flight, noticed: Noticed) -> None:
        assert "ended by itself" in noticed.text
        assert flight.director.result.died == tasks

    return check


def gate_counts(flight: Flight, noticed: Noticed) -> None:
    gate = flight.director.result.gate
    assert gate is not None
    assert gate.reasons.keys() == {"jump"}
    assert any(event.get("reasons") == ["jump"] for event in spoken(flight, "warning"))


KEPT: Mapping[FaultKind, Check] = {
    FaultKind.SILENT: last_telemetry,
    FaultKind.LOST: region,
    FaultKind.STUCK: last_telemetry,
    FaultKind.UNANSWERED: last_telemetry,
    FaultKind.OFF_COURSE: value(1.5, 4.0),
    FaultKind.DEAF: value(0.05, 20.0),
    FaultKind.TAKEN: text("something else changed its mode ("),
    FaultKind.OWN_FAILSAFE: failsafes_text,
    FaultKind.DISARMED: last_telemetry,
    FaultKind.SEPARATION: value(1.0, 1.5),
    FaultKind.FENCE: value(0.5, 1.0),
    FaultKind.ORIGIN: value(4.8, 5.6),
    FaultKind.BATTERY: value(0.119, 0.121),
    FaultKind.PARAMETER: text("from 4 to 0; it is set again"),
    FaultKind.REFUSED: text("denied", "Motors hot"),
    FaultKind.TARGET: tracks,
    FaultKind.PLANNER: died("planner"),
    FaultKind.STREAMER: died("streamer"),
    FaultKind.STREAMER_AGAIN: died("streamer", "streamer"),
    FaultKind.BYSTANDER: died("recorder"),
    FaultKind.STALL: value(3.0, 3.1),
    FaultKind.GATE: gate_counts,
    FaultKind.PROGRAM: died("watch"),
}


# --- flights ---------------------------------------------------------------------------------------------------------


def flown(made: Made, folder: Path) -> tuple[Flight, float]:
    """Fly with a fault; return the flight, and when the fault was made since the run's start [s]."""
    since: list[float] = []

    async def make(flight: Flight) -> None:
        await flight.reaches(made.stage)
        journal, loop = flight.director.journal, asyncio.get_running_loop()
        await asyncio.sleep(max(journal.stage_begins_s + made.at_s - loop.time(), 0.0))
        since.append(flight.recorder.since_start_s(loop.time()))
        if made.act is not None:
            made.act(flight)
        begins = None if made.begins is None else made.begins(flight)
        async for _ in ticks(loop.time(), LOOKS_S):
            if begins is None:
                return
            since[0] = flight.recorder.since_start_s(loop.time())
            if begins():
                return

    window = {"stage": made.stage, "at_s": made.at_s, "vehicles": list(made.vehicles)}
    flight = fly(
        folder,
        made.autopilot,
        make,
        mission_of(folder, made.text),
        faults=[{**window, **made.fault}] if made.fault else (),
        impairments=[{**window, **made.link}] if made.link else (),
        loop=StandingStill if made.act is stand_still else VirtualTimeLoop,
    )
    return flight, since[0]


def notice(flight: Flight, kind: FaultKind) -> Noticed:
    """Return the first event of a kind of fault."""
    found = [event for event in flight.said if event.get("fault") == kind.value]
    assert found, [event["text"] for event in flight.said if event["kind"] in ("fault", "abort", "error")]
    return Noticed(found[0]["time_s"], found[0]["text"], found[0].get("vehicles", []), found[0].get("value"))


def spoken(flight: Flight, kind: str) -> list[dict[str, Any]]:
    return [event for event in flight.said if event["kind"] == kind]


def there_again_s(flight: Flight) -> float:
    """When the vehicle was taken back."""
    (told,) = (event for event in spoken(flight, "notice") if "there again" in event["text"])
    return float(told["time_s"])


def sent_s(flight: Flight, label: int) -> Array:
    """When setpoints left to a vehicle [s]."""
    rows = flight.recorded.setpoints
    times_s: Array = rows["time_s"][rows["system_id"] == label]
    return times_s
