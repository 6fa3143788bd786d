"""What is computed of vehicles that stop hearing us is what comes of it in flight, by the simulator's truth."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fg_gcs.flight.lost_links import expected_rule
from fg_gcs.mission import parse_mission
from fg_gcs.plan.flight_plan import compile_flight
from fg_gcs.plan.lost_link import SPARE_M
from fg_gcs.run.planning import PROFILES
from fg_gcs.run.trial import Trial, judge
from tests.flight.harness import SMALL

# As fast as both autopilots can by their own parameters, so that the flight is planned as it is here; two leaders
# have another vehicle right behind them
LIMITS = "speed_m_s = 8.0\nacceleration_m_s2 = 2.5\nclimb_m_s = 2.5\ndescent_m_s = 1.5\njerk_m_s3 = 5.0"
MISSION = parse_mission(
    SMALL.replace("speed_m_s = 8.0\nacceleration_m_s2 = 4.0", LIMITS)
    .replace("[-6.0, 10.0, 12.0]", "[25.0, 10.0, 12.0]")
    .replace('shape = "hemisphere"\nleaders = 3\nfollowers = 1\nedge_m = 6.0', 'shape = "custom"')
    .replace(
        "normal_enu",
        "leaders_yz_m = [[-3.0, -2.0], [3.0, -2.0], [0.0, 4.0]]\nfollowers_xyz_m = [[-2.2, 3.0, -2.0]]\nnormal_enu",
    )
)
TOO_CAREFUL = 2.0  # times as far as computed


@pytest.mark.parametrize(("autopilot", "direction"), [("px4", "both"), ("ardupilot", "to_vehicle")])
def test_at_the_worst_moment_nobody_comes_nearer_than_computed(autopilot: str, direction: str) -> None:
    task = replace(MISSION.task(), lost_link=expected_rule(MISSION, PROFILES[autopilot]))
    made = compile_flight(task, MISSION.tops_enu_m(), lambda: 0.0)
    worst = made.faults["approach"].nearest
    assert made.faults["approach"].slower > 1.0
    deaf = worst.pair[0] + 1
    moment = {"vehicles": [deaf], "stage": "approach", "at_s": round(worst.heard_s, 2)}
    found = judge(Trial(MISSION, autopilot, impairments=({"direction": direction, "loss": 1.0, **moment},)))
    assert found.broken == []
    assert found.result is not None
    flown = found.result.flight.plan
    assert flown is not None
    assert flown.faults["approach"].nearest.distance_m == pytest.approx(worst.distance_m, abs=0.05)
    noticed = f"vehicle {deaf} is silent" if direction == "both" else f"vehicle {deaf} does not seem to hear us"
    assert any(noticed in event for event in found.events)
    assert worst.distance_m - SPARE_M <= found.closest_unhearing_m <= TOO_CAREFUL * worst.distance_m
