"""What profiles say of wander is what simulated vehicles with the measured dynamics do."""

from __future__ import annotations

import numpy as np
import pytest

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import swap_ned_enu
from fg_gcs.flight.wander import LOOKS_S, step_m
from fg_gcs.plan.wander import CROSSES_PER_S
from fg_gcs.wire.autopilots import ARDUPILOT, PX4, AutopilotProfile
from sitl_mock.physics.flight_model import FlightModel
from sitl_mock.physics.swarm import Swarm
from sitl_mock.profiles import flight_model
from tests.sitl.test_measured import hold
from tests.sitl.tracking_runs import PHYSICS

COUNT, SETTLES_S, WATCHED_S = 60, 60.0, 100.0
PROFILES = pytest.mark.parametrize("profile", [PX4, ARDUPILOT], ids=lambda profile: profile.name)


def looks(model: FlightModel, height_m: float) -> tuple[Array, Array]:
    """Truth and estimate of vehicles that are to stay where they are, without what all do alike, (T, V, 3) [m; ENU]."""
    pads = np.array([(5.0 * k, 0.0, -height_m) for k in range(COUNT)])
    swarm = Swarm(PHYSICS, pads, 0.0, np.random.default_rng(0), model)
    if height_m:
        hold(swarm, "px4")  # limits of its own modes alone differ
    swarm.step(round(SETTLES_S / PHYSICS.time.step_s))
    found = []
    while swarm.time_s < SETTLES_S + WATCHED_S:
        swarm.step(round(LOOKS_S / PHYSICS.time.step_s))
        found.append((swarm.position_m - pads, swarm.estimated_position_m - pads))
    off = swap_ned_enu(np.array(found))  # (T, 2, V, 3)
    off -= off.mean(axis=2, keepdims=True)
    return off[:, 0], off[:, 1]


def rms(errors_m: Array) -> float:
    return float(np.sqrt((errors_m[..., :2] ** 2).sum(axis=2).mean()))


@PROFILES
def test_in_the_air(profile: AutopilotProfile) -> None:
    wander = profile.wander
    true_m, estimated_m = looks(flight_model(profile.name.lower()), 10.0)
    assert np.sqrt((true_m**2).mean(axis=(0, 1))) == pytest.approx(wander.hover_enu_m, rel=0.2, abs=0.005)
    assert rms(estimated_m) == pytest.approx(wander.shown_m, rel=0.2)
    passes = ((true_m[:-1] < 0.0) & (true_m[1:] >= 0.0)).sum(axis=0).mean(axis=0) / WATCHED_S
    assert (passes <= CROSSES_PER_S).all(), passes


@PROFILES
def test_on_the_ground(profile: AutopilotProfile) -> None:
    _, estimated_m = looks(flight_model(profile.name.lower()), 0.0)
    step = float(np.sqrt((step_m(estimated_m) ** 2).mean()))
    assert step == pytest.approx(profile.wander.ground_step_m, rel=0.1)


def test_vehicles_hover_as_far_off_as_they_are_told_to() -> None:
    model = flight_model("px4")
    for noisy, level_m in ((model, model.hover_m), (model.noisy(0.3), 0.3)):
        assert rms(looks(noisy, 10.0)[0]) == pytest.approx(level_m, rel=0.1)
