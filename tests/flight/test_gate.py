"""The last gate: whatever is wanted, what leaves is finite, goes on from what left, is inside the fence, and apart."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from fg_gcs.core.admissible import LEAP_M, LEAP_M_S, MARGIN
from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import Fence
from fg_gcs.flight.gate import FENCE_M, LASTS_S, SEPARATION_M, Gate
from fg_gcs.flight.motions import Follow, SwarmSetpoint
from fg_gcs.plan.keep_clear import Column
from fg_gcs.plan.limits import Limits, Rules
from tests.flight.harness import SMALL, Flight, fly, mission_of

ACCELERATION, APART, DT_S = 4.0, 1.5, 0.02
FENCE = Fence((-10.0, -10.0, 2.0), (10.0, 10.0, 12.0))
RULES = Rules(Limits(8.0, ACCELERATION), APART, FENCE)


@dataclass
class Reports:
    """Vehicles that are where they are said to be."""

    places_m: Array
    armed_too: list[bool] = field(default_factory=list)

    @property
    def armed(self) -> NDArray[np.bool_]:
        return np.array(self.armed_too or [True] * len(self.places_m))

    def positions_enu_m(self, now_s: float) -> Array:
        return self.places_m


def grid(count: int) -> Array:
    return np.array([(3.0 * (k % 3) - 3.0, 3.0 * (k // 3) - 3.0, 6.0) for k in range(count)])


def still(places_m: Array) -> Array:
    return np.column_stack((places_m, np.zeros((len(places_m), 7))))


class Wanderers:
    """Vehicles that a motion flies to random places, smoothly and without regard for anything."""

    def __init__(self, seed: int, count: int) -> None:
        self.random = np.random.default_rng(seed)
        self.place, self.goal = grid(count), grid(count)
        self.velocity = np.zeros((count, 3))

    def next(self, dt_s: float) -> Array:
        if self.random.random() < 0.03:
            self.goal = self.random.uniform((-14.0, -14.0, 0.0), (14.0, 14.0, 14.0), self.goal.shape)
        wanted = _shorter(self.goal - self.place, RULES.limits.speed_m_s)
        push = _shorter((wanted - self.velocity) / max(dt_s, DT_S), ACCELERATION)
        self.place = self.place + self.velocity * dt_s + 0.5 * push * dt_s * dt_s
        self.velocity = self.velocity + push * dt_s
        return np.column_stack((self.place, self.velocity, push, np.zeros(len(push))))


def _shorter(vectors: Array, most: float) -> Array:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    shorter: Array = vectors * np.minimum(1.0, most / np.maximum(lengths, 1e-9))
    return shorter


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(2, 7),
    wrong=st.sampled_from(("nothing", "numbers", "jumps")),
    late=st.booleans(),
)
def test_what_leaves_is_finite_goes_on_is_inside_and_apart(seed: int, count: int, wrong: str, late: bool) -> None:
    flown, random = Wanderers(seed, count), np.random.default_rng(seed)
    gate, rows, now_s = Gate(Reports(grid(count)), RULES), np.arange(count), 0.0
    before = gate.passed(rows, still(grid(count)), now_s).numbers
    for _ in range(120):
        dt_s = random.uniform(0.0, 0.3) if late and random.random() < 0.05 else DT_S
        now_s += dt_s
        if wrong == "jumps" and random.random() < 0.03:
            flown.place[random.integers(count)] += random.normal(scale=2.0, size=3)
        wanted = flown.next(dt_s)
        if wrong == "numbers" and random.random() < 0.05:
            wanted[random.integers(count), random.integers(10)] = random.choice((np.nan, np.inf, -1e9))
        passed = gate.passed(rows, wanted, now_s)
        left = passed.numbers
        assert left.shape == (count, 10)
        assert np.isfinite(left).all()
        _goes_on(before, left, dt_s)
        assert FENCE.excess_m(left[:, :3]).max() <= FENCE_M + 1e-5
        assert pdist(left[:, :3]).min() >= APART - SEPARATION_M - 1e-5
        touched = {change.row for change in passed.changes}
        as_wanted = [row for row in range(count) if row not in touched]
        assert (left[as_wanted] == wanted[as_wanted]).all()
        before = left


def _goes_on(before: Array, left: Array, dt_s: float) -> None:
    most = MARGIN * ACCELERATION
    leap = np.linalg.norm(left[:, :3] - before[:, :3] - before[:, 3:6] * dt_s, axis=1)
    assert leap.max() <= 0.5 * most * dt_s * dt_s + LEAP_M + 1e-9
    assert np.linalg.norm(left[:, 3:6] - before[:, 3:6], axis=1).max() <= most * dt_s + LEAP_M_S + 1e-9
    assert np.linalg.norm(left[:, 6:9], axis=1).max() <= most + 1e-9


def first(places_m: Array, now_s: float = 0.0, reports: Reports | None = None) -> tuple[Gate, NDArray[np.int_]]:
    gate, rows = Gate(reports or Reports(places_m), RULES), np.arange(len(places_m))
    assert not gate.passed(rows, still(places_m), now_s).changes
    return gate, rows


def test_a_take_off_is_a_leap_straight_up_from_the_ground_and_from_nowhere_else() -> None:
    ground = grid(4) * (1.0, 1.0, 0.0)
    gate, rows = first(ground)
    tops = ground + np.array((0.3, 0.0, 4.0))
    assert not gate.passed(rows, still(tops), DT_S).changes
    tops[1, 2] += 1.0
    (change,) = gate.passed(rows, still(tops), 2.0 * DT_S).changes
    assert (change.row, change.reasons) == (1, ("jump",))


def test_pads_nearer_than_the_minimum_may_be_left_and_not_approached() -> None:
    tight = np.array([(0.0, 0.0, 6.0), (1.0, 0.0, 6.0)])
    gate, rows = first(tight)
    apart = tight + np.array(((-0.005, 0.0, 0.0), (0.005, 0.0, 0.0)))
    assert not gate.passed(rows, still(apart), DT_S).changes
    changed = gate.passed(rows, still(tight), 2.0 * DT_S)
    assert [change.reasons for change in changed.changes] == [("separation",)] * 2
    assert pdist(changed.numbers[:, :3])[0] >= 1.01 - 1e-6


def test_a_vehicle_that_gets_no_setpoints_is_kept_away_from_where_it_is_reported() -> None:
    places = np.array([(0.0, 0.0, 6.0), (3.0, 0.0, 6.0)])
    gate, reports = Gate(Reports(places), RULES), np.array([0])
    place, speed = 0.0, 0.0
    passed = gate.passed(reports, still(places[:1]), 0.0)
    for turn in range(1, 200):
        wanted = still(np.array([(place, 0.0, 6.0)]))
        wanted[0, 3] = speed
        passed = gate.passed(reports, wanted, turn * DT_S)
        speed, place = min(speed + ACCELERATION * DT_S, 2.0), place + speed * DT_S
    assert passed.numbers[0, 0] <= 1.5 + SEPARATION_M + 1e-6
    disarmed = Gate(Reports(places, [True, False]), RULES)
    assert not disarmed.passed(reports, still(places[:1]), 0.0).changes


@pytest.mark.parametrize("above", [False, True])
def test_what_plans_keep_clear_is_not_entered(above: bool) -> None:
    column = Column((3.0, -9.0), (3.0, 9.0), 4.0 if above else 12.0, 1.0)
    two = Reports(grid(2), [True, False])
    gate, rows, place, speed = Gate(two, RULES, lambda: {1: [column]}), np.array([0]), -3.0, 0.0
    passed = gate.passed(rows, still(grid(1)), 0.0)
    for turn in range(1, 200):
        wanted = still(np.array([(place, -3.0, 6.0)]))
        wanted[0, 3] = speed
        passed = gate.passed(rows, wanted, turn * DT_S)
        speed, place = min(speed + ACCELERATION * DT_S, 2.0), place + speed * DT_S
    clear_m = 1.0 + 0.5 * APART
    assert passed.numbers[0, 0] > 4.0 if above else passed.numbers[0, 0] <= 3.0 - clear_m + SEPARATION_M + 1e-6
    assert (gate.counts.total == 0) is above


def test_what_has_not_passed_for_a_while_is_told_until_it_is_forgiven() -> None:
    gate, rows = first(grid(3))
    away = still(grid(3))
    away[1, :3] += (2.0, 2.0, 3.0)
    turns = int(LASTS_S / DT_S) + 1
    lasting = [(gate.passed(rows, away, turn * DT_S), gate.lasting(turn * DT_S))[1] for turn in range(1, turns + 1)]
    assert lasting == [[]] * (turns - 1) + [[1]]
    gate.forgive()
    assert gate.lasting(9.0) == []


# --- whole flights ---------------------------------------------------------------------------------------------------


class Planted(Follow):
    """A plan's motion of which something is wrong with one vehicle from a time on."""

    def __init__(self, good: Follow, begin_s: float, wrong: Callable[[SwarmSetpoint, float], None]) -> None:
        super().__init__(good.rows, good.plan, good.pace)
        self._begin_s, self._wrong = begin_s, wrong

    def at(self, now_s: float) -> SwarmSetpoint:
        wanted = SwarmSetpoint(*(array.copy() for array in super().at(now_s)))
        if now_s > self._begin_s:
            self._wrong(wanted, now_s - self._begin_s)
        return wanted


def into_another(wanted: SwarmSetpoint, passed_s: float) -> None:
    way = wanted.position_m[1] - wanted.position_m[0]
    speed = min(2.0 * passed_s, 3.0)
    far = speed * passed_s - min(passed_s, 1.5) * speed / 2.0
    wanted.position_m[0] += far * way / np.linalg.norm(way)
    wanted.velocity_m_s[0] = speed * way / np.linalg.norm(way)


def out_of_the_fence(wanted: SwarmSetpoint, passed_s: float) -> None:
    speed = min(2.0 * passed_s, 4.0)
    wanted.position_m[2, 2] += speed * passed_s - min(passed_s, 2.0) * speed / 2.0
    wanted.velocity_m_s[2, 2] = speed


def no_number(wanted: SwarmSetpoint, passed_s: float) -> None:
    wanted.position_m[1, 1] = np.nan


@pytest.mark.parametrize(
    ("wrong", "reason", "told"),
    [
        (into_another, "separation", "vehicles 1 and 2 are 1.4"),  # 1.49 m, and what the vehicle is off by
        (out_of_the_fence, "fence", "setpoints of vehicle 3 have not passed the last gate for 1 s"),
        (no_number, "not finite", "setpoints of vehicle 2 have not passed"),
    ],
)
def test_a_motion_that_goes_wrong_is_stopped_and_everybody_comes_home(
    wrong: Callable[[SwarmSetpoint, float], None], reason: str, told: str, tmp_path: Path
) -> None:
    async def plant(flight: Flight) -> None:
        await flight.reaches("hold")
        streamer = flight.director.streamer
        assert streamer is not None
        assert isinstance(streamer.motion, Follow)
        streamer.motion = Planted(streamer.motion, flight.director.journal.time() + 0.5, wrong)

    longer = SMALL.replace("duration_s = 2.0", "duration_s = 8.0")
    flight = fly(tmp_path, "px4", plant, mission_of(tmp_path, longer))
    assert flight.result is not None
    assert flight.result.gate is not None
    assert reason in flight.result.gate.reasons
    assert not flight.result.completed
    assert flight.result.reason.startswith(told)
    assert flight.down_and_disarmed
    assert flight.result.lost == ()
    assert flight.truth_separation_m > 1.3
    table = np.load(flight.recorder.folder / "setpoints.npy")
    flying = [event for event in flight.events.splitlines() if json.loads(event).get("stage") == "hold"]
    since_s = json.loads(flying[0])["time_s"]
    for number in range(1, 5):
        own = table[(table["system_id"] == number) & (table["time_s"] > since_s)]
        steps = np.linalg.norm(np.diff(own["position_enu_m"], axis=0), axis=1)
        assert np.isfinite(own["position_enu_m"]).all()
        assert steps.max() < 8.0 * DT_S + LEAP_M
        assert own["position_enu_m"][:, 2].max() <= 30.0 + FENCE_M + 1e-5
