"""A swarm that is left alone: computed before arming, and as the simulator's vehicles do it."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from fg_gcs.core.separation import Fence
from fg_gcs.mission import Mission, parse_mission
from fg_gcs.plan.by_themselves import LEAST_M, ON_GROUND_M, ByThemselves, _nearest_pairs, by_themselves
from fg_gcs.plan.flight_plan import FlightPlan, compile_flight
from fg_gcs.run.trial import Trial, judge
from tests.flight.harness import AUTOPILOTS, UPRIGHT


@cache
def planned(text: str) -> tuple[Mission, FlightPlan, np.ndarray]:
    mission = parse_mission(text)
    pads = np.c_[mission.pads_enu_m(), np.zeros(mission.swarm.vehicles)]
    tops = pads.copy()
    tops[:, 2] = mission.takeoff.height_m
    return mission, compile_flight(mission.task(), tops, lambda: 0.0), pads


def chosen(text: str, fence: Fence | None = None) -> ByThemselves:
    mission, plan, pads = planned(text)
    rules = mission.task().rules
    parts = {"gather": plan.gather, "approach": plan.approach, "home": plan.home}
    return by_themselves(parts, pads, fence or rules.fence, rules.separation_m)


def test_an_upright_formation_returns_at_heights_in_the_order_of_the_vehicles() -> None:
    mission, plan, _ = planned(UPRIGHT)
    found = chosen(UPRIGHT)
    assert found.heights_m is not None
    assert found.landing.closest_m < 0.5
    assert found.vanished.bad < found.landing.bad
    heights = plan.approach.sample(np.array([plan.approach.duration_s])).position_m[0, :, 2]
    order = np.argsort(heights, kind="stable")
    steps = np.diff(found.heights_m[order])
    assert (steps >= 1.1 * mission.task().rules.separation_m - 1e-9).all()
    assert found.heights_m.max() <= mission.task().rules.fence.high_enu_m[2]
    assert 5.0 <= found.waits_s <= 60.0


def test_where_the_fence_leaves_no_room_above_they_land_and_that_is_told() -> None:
    mission, _, _ = planned(UPRIGHT)
    fence = mission.task().rules.fence
    low = Fence(fence.low_enu_m, (*fence.high_enu_m[:2], 14.0))
    found = chosen(UPRIGHT, low)
    assert found.heights_m is None
    assert found.vanished == found.landing
    assert found.vanished.bad > 0.3
    assert found.vanished.stage in ("gather", "approach", "home")


def test_where_nobody_is_above_another_they_land() -> None:
    text = UPRIGHT.replace("normal_enu = [1.0, 0.0, 0.0]", "normal_enu = [0.0, 0.0, 1.0]").replace(
        "position_enu_m = [12.0, 0.0, 12.0]", "position_enu_m = [0.0, 0.0, 18.0]"
    )
    found = chosen(text)
    assert found.heights_m is None
    assert found.landing.bad == 0.0
    assert found.landing.closest_m > LEAST_M


@pytest.mark.parametrize("vehicles", [2, 7])
def test_the_nearest_pair_of_each_moment_is_that_of_all_pairs_off_the_ground(vehicles: int) -> None:
    ways = np.random.default_rng(vehicles).uniform(-3.0, 3.0, (4, vehicles, 20, 3))
    high = ways[..., 2] > ON_GROUND_M
    away_m = np.linalg.norm(ways[:, :, None] - ways[:, None], axis=-1)
    away_m[~(high[:, :, None] | high[:, None])] = np.inf
    away_m[:, np.eye(vehicles, dtype=bool)] = np.inf
    for found, distances_m in zip(_nearest_pairs(ways), away_m, strict=True):
        assert found[0] == pytest.approx(distances_m.min(), abs=1e-9)
        assert distances_m[int(found[1]), int(found[2])].min() == distances_m.min()


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_vehicles_that_are_left_alone_come_no_nearer_than_computed(autopilot: str) -> None:
    gone = {"direction": "both", "loss": 1.0, "stage": "hold", "at_s": 1.0}
    found = judge(Trial(parse_mission(UPRIGHT), autopilot, impairments=(gone,)))
    assert found.broken == []  # all are down two minutes after the end, too
    assert found.result is not None
    assert found.result.summary["vanished_returns"] is True
    assert found.closest_unhearing_m > 1.2


def test_one_that_is_left_alone_hovers_until_the_others_are_gone() -> None:
    deaf = {"direction": "both", "loss": 1.0, "stage": "hold", "at_s": 1.0, "vehicles": [2]}
    found = judge(Trial(parse_mission(UPRIGHT), "ardupilot", impairments=(deaf,)))
    assert found.broken == []
    assert 1.2 < found.closest_unhearing_m < math.inf
