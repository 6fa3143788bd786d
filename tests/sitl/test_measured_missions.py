"""What helps PX4 follow: the approach and the hold of `sitl.toml`, streamed to the physics as a real PX4 got them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fg_gcs.experiment.measured import as_recorded
from fg_gcs.mission import parse_mission
from fg_gcs.plan.trajectory import Sample
from fg_gcs.run.planning import plan
from sitl_mock import profiles
from sitl_mock.physics.arrays import Array
from sitl_mock.physics.reference import ALL, Reference
from sitl_mock.physics.swarm import Swarm, enu_from_ned
from tests.sitl.tracking_runs import PHYSICS, SETTLING_S, command

MISSION = Path(__file__).parents[2] / "missions" / "sitl.toml"
RATE_HZ, HOLD_S = 50.0, 10.0
SINGLE_RUN_M = 0.3  # the record's own repeatability: one run of one vehicle; here nine fly


@pytest.fixture(scope="module")
def approach() -> tuple[Sample, float]:
    """The plan's samples, denser than the stream, from before its beginning to the end of the hold; its duration."""
    made = plan(parse_mission(as_recorded(MISSION.read_text()))).flight.approach
    times_s = np.arange(-SETTLING_S, made.duration_s + HOLD_S + 1.0, PHYSICS.time.step_s)
    return made.sample(times_s), made.duration_s


def errors(sample: Sample, gain_per_s: float, lead_s: float) -> Array:
    """Distances (T, V) between the plan and the estimates, every physics step of approach and hold.

    Args:
        sample: of the plan.
        gain_per_s: acceleration sent = planned + gain times planned horizontal velocity.
        lead_s: setpoints are those of so much later.
    """
    swarm = Swarm(
        PHYSICS, enu_from_ned(sample.position_m[0]), 0.0, np.random.default_rng(4), profiles.flight_model("px4")
    )
    swarm.commands.flying[:] = True
    every, lead = round(1.0 / (RATE_HZ * PHYSICS.time.step_s)), round(lead_s / PHYSICS.time.step_s)
    found = []
    for k in range(len(sample.position_m) - lead):
        if k % every == 0:
            position, velocity, acceleration = (enu_from_ned(array[k + lead]) for array in sample)
            acceleration = acceleration + gain_per_s * velocity * (1.0, 1.0, 0.0)
            for row, (p, v, a) in enumerate(
                zip(position.tolist(), velocity.tolist(), acceleration.tolist(), strict=True)
            ):
                command(
                    swarm,
                    row,
                    "px4",
                    Reference(tuple(p), tuple(v), tuple(a), ALL, ALL, 0.0, since_s=swarm.time_s),
                )
        found.append(np.linalg.norm(enu_from_ned(sample.position_m[k]) - swarm.estimated_position_m, axis=1))
        swarm.step()
    return np.array(found)


def rms(errors_m: Array) -> float:
    return float(np.sqrt((errors_m**2).mean()))


def test_what_helps_px4_follow(approach: tuple[Sample, float]) -> None:
    """Errors in approach and hold, rms, of the record; and each help is one."""
    sample, duration_s = approach
    record = {  # gain [1/s], lead [s]
        (0.0, 0.0): (1.17, 0.94),
        (0.0, 0.25): (0.71, 0.90),
        (0.5, 0.0): (0.84, 0.41),
        (1.0, 0.0): (0.51, 0.50),
        (1.0, 0.15): (0.61, 0.43),
    }
    flown = {}
    for (gain_per_s, lead_s), figures_m in record.items():
        found = errors(sample, gain_per_s, lead_s)
        times_s = np.arange(len(found)) * PHYSICS.time.step_s - SETTLING_S
        flying = (times_s > 0.0) & (times_s <= duration_s)
        holding = (times_s > duration_s) & (times_s < duration_s + HOLD_S)
        flown[gain_per_s, lead_s] = (rms(found[flying]), rms(found[holding]))
        assert flown[gain_per_s, lead_s] == pytest.approx(figures_m, rel=0.2, abs=SINGLE_RUN_M)
    planned, *helped = flown.values()
    assert all(approach_m < 0.8 * planned[0] for approach_m, _ in helped)
    assert flown[1.0, 0.0][1] < 0.6 * planned[1]  # only the gain helps the hold: the integrator has learnt no drag
    assert flown[0.0, 0.25][1] > 0.8 * planned[1]
