"""A face is turned about its normal so that nobody is above anybody, and the flight then says so."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.core.formation import Pose, facing, hemisphere, rolled
from fg_gcs.mission import parse_mission
from fg_gcs.plan.roll import MOST_DEG, STEP_DEG, apart_m, clearest_roll
from fg_gcs.run.planning import plan
from tests.flight.harness import UPRIGHT

DIRECTIONS = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda way: np.linalg.norm(way) > 0.1)
ANGLES = st.floats(-math.pi, math.pi)


@given(DIRECTIONS, ANGLES, ANGLES)
def test_a_roll_keeps_the_normal_and_rolls_add_up(way: tuple[float, float, float], one: float, other: float) -> None:
    attitude = facing(np.array(way))
    turned = rolled(attitude, one)
    np.testing.assert_allclose(turned[:, 0], attitude[:, 0], atol=1e-12)
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rolled(turned, other), rolled(attitude, one + other), atol=1e-12)
    np.testing.assert_allclose(rolled(turned, -one), attitude, atol=1e-12)


def test_a_roll_is_counter_clockwise_as_seen_from_the_target() -> None:
    turned = rolled(np.eye(3), math.radians(90.0))  # the target lies in the direction of x, and sees y to its left
    np.testing.assert_allclose(turned[:, 1], (0.0, 0.0, 1.0), atol=1e-12)


@given(DIRECTIONS, st.integers(3, 8), st.floats(0.5, 2.0))
def test_no_other_roll_leaves_more_room(way: tuple[float, float, float], leaders: int, scale: float) -> None:
    slots_m = hemisphere(leaders, leaders + 1, 5.0).slots_m
    pose = Pose(np.zeros(3), facing(np.array(way)), scale)
    found = clearest_roll(slots_m, [pose])
    assert abs(found.by_deg) <= MOST_DEG
    turned = pose._replace(rotation=rolled(pose.rotation, math.radians(found.by_deg)))
    assert found.apart_m == pytest.approx(apart_m(slots_m, [turned]))
    for by_deg in np.arange(-MOST_DEG, MOST_DEG, 7.0):
        other = pose._replace(rotation=rolled(pose.rotation, math.radians(by_deg)))
        farthest_m = float(np.linalg.norm(slots_m, axis=1).max()) * scale
        spare_m = 2.0 * farthest_m * math.radians(STEP_DEG) / 2.0  # half a step, by both of a pair
        assert apart_m(slots_m, [other]) <= found.apart_m + spare_m + 0.01


def test_what_a_mission_is_told_to_do_helps() -> None:
    upright = plan(parse_mission(UPRIGHT))
    told = re.search(r"turned by (-?\d+) degrees .* gather (\d+\.\d\d) m", "\n".join(upright.in_fault))
    assert told is not None
    text = UPRIGHT.replace("normal_enu = [1.0, 0.0, 0.0]", f"normal_enu = [1.0, 0.0, 0.0]\nroll_deg = {told[1]}.0")
    mission = parse_mission(text)
    task = mission.task()
    assert apart_m(task.formation.slots_m, [task.start]) == pytest.approx(float(told[2]), abs=0.005)
    turned = plan(mission)
    assert not any("turned by" in line for line in turned.in_fault)
    assert upright.flight.faults["approach"].fall.distance_m < 0.5 < turned.flight.faults["approach"].fall.distance_m
    assert upright.flight.alone.landing.bad > 0.0 == turned.flight.alone.landing.bad
    assert turned.flight.alone.heights_m is None  # nobody need return
