"""Laws of the measured dynamics: hover, steps, ground, wind, faults, seeds. The tracking tables are in a file apart."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sitl_mock import profiles
from sitl_mock.physics.arrays import Array
from sitl_mock.physics.flight_model import FlightModel, read_flight_model
from sitl_mock.physics.reference import ALL, Limits, Reference, Vec3
from sitl_mock.physics.swarm import Swarm
from tests.sitl.tracking_runs import PHYSICS, command, quiet, quiet_swarm

AUTOPILOTS = ("ardupilot", "px4")
HIGH = np.array([[0.0, 0.0, -10.0]])
DT_S = PHYSICS.time.step_s


def hold(swarm: Swarm, autopilot: str) -> Array:
    """Every vehicle stays where it is."""
    places_m = swarm.position_m.copy()
    for row, place in enumerate(places_m.tolist()):
        command(swarm, row, autopilot, Reference(tuple(place), position_used=ALL, yaw_rad=0.0, since_s=swarm.time_s))
    swarm.commands.flying[:] = True
    return places_m


def real_swarm(autopilot: str, vehicles: int, seed: int = 0, height_m: float = 10.0, wind_m_s: float = 0.0) -> Swarm:
    pads = np.array([(5.0 * k, 0.0, -height_m) for k in range(vehicles)])
    return Swarm(PHYSICS, pads, wind_m_s, np.random.default_rng(seed), profiles.flight_model(autopilot))


def flown(swarm: Swarm, until_s: float, every: int = 10) -> tuple[Array, Array]:
    """True and estimated positions (T, V, 3) from now on."""
    true_m, estimated_m = [], []
    while swarm.time_s < until_s:
        swarm.step(every)
        true_m.append(swarm.position_m.copy())
        estimated_m.append(swarm.estimated_position_m.copy())
    return np.array(true_m), np.array(estimated_m)


# -- what was measured besides the tracking tables --------------------------------------------------------------------


def test_px4_wanders_in_hover_as_measured() -> None:
    """40 s: estimate minus setpoint 0.15, 0.37, 0.08 m, truth minus setpoint 0.26, 0.57, 0.22 m, speed 0.32 m/s rms."""
    swarm = real_swarm("px4", 100)
    places_m = hold(swarm, "px4")
    swarm.step(2000)
    true_m, estimated_m = flown(swarm, swarm.time_s + 40.0)
    estimated_std_m = (estimated_m - places_m).std(axis=0).mean(axis=0)
    true_std_m = (true_m - places_m).std(axis=0).mean(axis=0)
    assert estimated_std_m == pytest.approx([0.15, 0.37, 0.08], rel=0.2)
    assert true_std_m == pytest.approx([0.26, 0.57, 0.22], rel=0.2)
    velocity_m_s = np.diff(true_m, axis=0) / (10 * DT_S)
    assert np.sqrt((velocity_m_s**2).sum(axis=2).mean()) == pytest.approx(0.32, rel=0.2)
    errors_m = np.sqrt(((true_m - estimated_m) ** 2).mean(axis=0))  # of each vehicle
    assert 0.1 < np.median(errors_m[:, 0]) < np.median(errors_m[:, 1]) < 0.3
    assert 0.2 < np.quantile(errors_m[:, 2], 0.9) < 0.7


def test_ardupilot_hovers_as_measured() -> None:
    """Estimate 0.003-0.005 m (standard deviation), about 0.02 m from the truth."""
    swarm = real_swarm("ardupilot", 100)
    places_m = hold(swarm, "ardupilot")
    swarm.step(8000)
    true_m, estimated_m = flown(swarm, swarm.time_s + 40.0)
    assert (estimated_m - places_m).std(axis=0).mean(axis=0) == pytest.approx([0.004] * 3, abs=0.001)
    assert np.sqrt(((true_m - estimated_m) ** 2).mean()) == pytest.approx(0.02, rel=0.25)


@pytest.mark.parametrize(
    ("autopilot", "axis", "way_m", "seconds"),
    [
        ("px4", 0, 10.0, (0.89, 1.74, 2.97)),
        ("px4", 2, -3.0, (0.37, 0.96, 2.31)),
        ("px4", 2, 3.0, (0.52, 1.47, 2.83)),
    ],
)
def test_steps_take_as_long_as_measured(
    autopilot: str, axis: int, way_m: float, seconds: tuple[float, float, float]
) -> None:
    """10, 50 and 90 % of a step of position."""
    swarm = quiet_swarm(autopilot, HIGH)
    hold(swarm, autopilot)
    swarm.step(500)
    before_m = swarm.position_m[0].copy()
    place = before_m.tolist()
    place[axis] += way_m
    command(swarm, 0, autopilot, Reference(tuple(place), position_used=ALL, yaw_rad=0.0, since_s=swarm.time_s))
    true_m, _ = flown(swarm, swarm.time_s + 15.0, every=1)
    shares = (true_m[:, 0, axis] - before_m[axis]) / way_m
    taken_s = [DT_S * (1 + int(np.argmax(shares > share))) for share in (0.1, 0.5, 0.9)]
    assert taken_s == pytest.approx(seconds, rel=0.2)
    assert (shares.max() - 1.0) * abs(way_m) < 0.9


def test_ardupilot_overshoots_a_step_a_little() -> None:
    """10 m: 0.3 m too far, there after about 6 s."""
    swarm = quiet_swarm("ardupilot", HIGH)
    command(swarm, 0, "ardupilot", Reference((10.0, 0.0, -10.0), position_used=ALL, yaw_rad=0.0))
    true_m, _ = flown(swarm, 15.0, every=1)
    assert true_m[:, 0, 0].max() - 10.0 == pytest.approx(0.3, abs=0.06)
    assert np.abs(true_m[600:, 0, 0] - 10.0).max() < 0.35


def test_px4_turns_as_measured() -> None:
    """90 degrees: half of it after 0.66 s, 90 % after 0.92 s, no overshoot."""
    swarm = quiet_swarm("px4", HIGH)
    command(swarm, 0, "px4", Reference((0.0, 0.0, -10.0), position_used=ALL, yaw_rad=0.5 * math.pi))
    turned = []
    for _ in range(400):
        swarm.step()
        turned.append(float(swarm.yaw_rad[0]) / (0.5 * math.pi))
    taken_s = [DT_S * (1 + int(np.argmax(np.array(turned) > share))) for share in (0.5, 0.9)]
    assert taken_s == pytest.approx((0.66, 0.92), rel=0.2)
    assert max(turned) < 1.01


def test_ardupilot_climbs_as_measured() -> None:
    """NAV_TAKEOFF to 10 m: from 0.1 m 5.54 s to 9.5 m and 6.24 s to 9.9 m, at most 2.54 m/s, no overshoot."""
    swarm = quiet_swarm("ardupilot", np.zeros((1, 3)))
    command(swarm, 0, "ardupilot", Reference((0.0, 0.0, -10.0), position_used=ALL, yaw_rad=0.0))
    true_m, _ = flown(swarm, 15.0, every=1)
    heights_m = -true_m[:, 0, 2]
    first_s, second_s, third_s = (DT_S * int(np.argmax(heights_m > height)) for height in (0.1, 9.5, 9.9))
    assert (second_s - first_s, third_s - first_s) == pytest.approx((5.54, 6.24), rel=0.05)
    assert np.diff(heights_m).max() / DT_S == pytest.approx(2.54, rel=0.05)
    assert heights_m.max() < 10.05


def test_px4_plans_the_way_to_its_own_targets() -> None:
    """A client's step tilts to the limit at once; DO_REPOSITION by 10 m takes 6 s and keeps to PX4's own limits."""
    fastest, steepest = {}, {}
    for planned in (False, True):
        swarm = quiet_swarm("px4", HIGH)
        hold(swarm, "px4")
        swarm.step(500)
        step = Reference((10.0, 0.0, -10.0), position_used=ALL, yaw_rad=0.0, planned=planned)
        swarm.commands.set(0, step, Limits(5.0, 3.0, 1.5, 3.0, 0.95), PHYSICS.tracking)
        speeds, leans = [], []
        for _ in range(800):
            swarm.step()
            speeds.append(float(swarm.velocity_m_s[0, 0]))
            leans.append(float(np.abs(swarm.pitch_rad[0])))
        fastest[planned], steepest[planned] = max(speeds), max(leans)
        assert swarm.position_m[0, 0] == pytest.approx(10.0, abs=0.8)
    assert fastest[True] < 3.5 < fastest[False]
    assert steepest[True] < 0.45 < steepest[False]


def test_ardupilot_runs_on_until_its_timeout() -> None:
    """Velocity 3 m/s, then silence: 3 s on, 11.9 m from the last message to rest, slower than 0.1 m/s after 5.2 s."""
    swarm = quiet_swarm("ardupilot", HIGH)
    for tick in range(400):
        if tick % 5 == 0:
            moving = Reference(velocity_ned_m_s=(3.0, 0.0, 0.0), velocity_used=ALL, yaw_rad=0.0, since_s=swarm.time_s)
            command(swarm, 0, "ardupilot", running_on(moving, 3.0))
        swarm.step()
    last_m, last_s = float(swarm.position_m[0, 0]), swarm.commands.since_s[0]
    swarm.step(290)
    assert swarm.velocity_m_s[0, 0] == pytest.approx(3.0, rel=0.02)
    while abs(swarm.velocity_m_s[0, 0]) > 0.1:
        swarm.step()
    assert swarm.time_s - last_s == pytest.approx(5.2, rel=0.1)
    swarm.step(500)
    assert swarm.position_m[0, 0] - last_m == pytest.approx(11.9, rel=0.05)


def running_on(reference: Reference, carry_s: float) -> Reference:
    return Reference(
        reference.position_ned_m,
        reference.velocity_ned_m_s,
        reference.acceleration_ned_m_s2,
        reference.position_used,
        reference.velocity_used,
        reference.yaw_rad,
        since_s=reference.since_s,
        carry_s=carry_s,
        lapses=True,
    )


def test_px4_holds_a_setpoint_until_the_next() -> None:
    """A lone setpoint with velocity pulls to its own place, not to where it would have moved on."""
    swarm = quiet_swarm("px4", HIGH)
    moving = Reference((0.0, 0.0, -10.0), (2.0, 0.0, 0.0), position_used=ALL, velocity_used=ALL, carry_s=0.1)
    command(swarm, 0, "px4", moving)
    swarm.step(50)
    np.testing.assert_array_equal(swarm.target_m[0], [0.0, 0.0, -10.0])


# -- ground, wind -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_up_and_down_again(autopilot: str) -> None:
    swarm = real_swarm(autopilot, 3, height_m=0.0)
    swarm.step(200)
    np.testing.assert_array_equal(swarm.position_m[:, 2], 0.0)
    assert swarm.in_contact.all()
    for row in range(3):
        command(swarm, row, autopilot, Reference((5.0 * row, 0.0, -5.0), position_used=ALL, yaw_rad=0.0))
    swarm.commands.flying[:] = True
    swarm.step(1500)
    assert swarm.position_m[:, 2] == pytest.approx([-5.0] * 3, abs=1.0)
    assert not swarm.in_contact.any()
    for row in range(3):
        level = (True, True, False)
        sinking = Reference((5.0 * row, 0.0, 0.0), (0.0, 0.0, 0.5), (0.0, 0.0, 0.0), level, (False, False, True))
        command(swarm, row, autopilot, sinking)
    fastest = 0.0
    for _ in range(2500):
        swarm.step()
        fastest = max(fastest, float(swarm.velocity_m_s[:, 2].max()))
    assert swarm.in_contact.all()
    assert fastest < 1.2
    swarm.commands.flying[:] = False
    swarm.step(300)
    np.testing.assert_allclose(swarm.position_m[:, 2], 0.0, atol=1e-6)
    np.testing.assert_allclose(swarm.velocity_m_s, 0.0, atol=1e-6)
    assert np.abs((swarm.roll_rad, swarm.pitch_rad)).max() == 0.0


def test_ardupilot_holds_in_wind_as_measured() -> None:
    """Within 0.05 m in 8 m/s of steady wind, leaning into it."""
    swarm = quiet_swarm("ardupilot", HIGH)
    places_m = hold(swarm, "ardupilot")
    swarm.disturbances.wind_m_s[0] = (-8.0, 0.0, 0.0)
    swarm.step(3000)
    true_m, _ = flown(swarm, swarm.time_s + 10.0)
    assert np.abs(true_m - places_m).max() < 0.05
    drag_m_s2 = 8.0 * (0.243 + 0.0345 * 8.0)
    assert swarm.pitch_rad[0] == pytest.approx(-math.atan(drag_m_s2 / 9.80665), abs=0.01)
    assert swarm.roll_rad[0] == pytest.approx(0.0, abs=0.01)


def test_attitude_is_that_of_the_thrust() -> None:
    """Roll and pitch turn the upward axis of the body into the thrust, at any heading."""
    random = np.random.default_rng(5)
    swarm = Swarm(PHYSICS, np.array([(5.0 * k, 0.0, -30.0) for k in range(8)]), 0.0, random)
    for row in range(8):
        place: Vec3 = tuple(random.uniform(-20.0, 20.0, 3).tolist())
        command(swarm, row, "px4", Reference(place, position_used=ALL, yaw_rad=random.uniform(-3.0, 3.0)))
    swarm.commands.flying[:] = True
    swarm.step(60)
    thrust = swarm.acceleration_m_s2 - [0.0, 0.0, 9.80665]
    roll, pitch, yaw = swarm.roll_rad, swarm.pitch_rad, swarm.yaw_rad
    # Minus the third column of the rotation matrix of yaw, pitch, roll
    up = -np.stack(
        (
            np.cos(yaw) * np.sin(pitch) * np.cos(roll) + np.sin(yaw) * np.sin(roll),
            np.sin(yaw) * np.sin(pitch) * np.cos(roll) - np.cos(yaw) * np.sin(roll),
            np.cos(pitch) * np.cos(roll),
        ),
        axis=1,
    )
    np.testing.assert_allclose(up, thrust / np.linalg.norm(thrust, axis=1)[:, None], atol=0.02)  # yaw has turned on
    assert np.abs(roll).max() > 0.05


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_gusts_push_and_pass(autopilot: str) -> None:
    swarm = quiet_swarm(autopilot, HIGH)
    places_m = hold(swarm, autopilot)
    swarm.step(1000)
    swarm.disturbances.gust_m_s[0] = 2.0
    gusty_m, _ = flown(swarm, swarm.time_s + 30.0)
    swarm.disturbances.gust_m_s[0] = 0.0
    swarm.step(4000)
    assert np.abs(gusty_m - places_m).max() > 0.1
    assert np.abs(swarm.position_m - places_m).max() < 0.05


# -- faults -----------------------------------------------------------------------------------------------------------


def test_a_dead_motor_falls_as_measured() -> None:
    """ArduPilot's SITL falls from 10 m in 1.7 s and hits the ground at 10.6 m/s."""
    swarm = quiet_swarm("ardupilot", HIGH)
    hold(swarm, "ardupilot")
    swarm.step(300)
    begun_s, swarm.disturbances.thrust_share[0] = swarm.time_s, 0.0
    while not swarm.in_contact[0]:
        swarm.step()
    assert swarm.time_s - begun_s == pytest.approx(1.7, rel=0.05)
    swarm.step(100)
    assert swarm.impact_m_s[0] == pytest.approx(10.6, rel=0.05)


@pytest.mark.parametrize("autopilot", [*AUTOPILOTS, None])
def test_a_weak_motor_limits_the_climb_and_then_the_flight(autopilot: str | None) -> None:
    """With 60 % of the thrust it climbs later, with 30 % it sinks, with none it falls."""
    speeds, heights = [], []
    for share in (1.0, 0.6, 0.3, 0.0):
        swarm = some_swarm(autopilot)
        hold(swarm, autopilot or "px4")
        swarm.position_m[0, 2] = -100.0
        command(swarm, 0, autopilot or "px4", Reference((0.0, 0.0, -130.0), position_used=ALL))
        swarm.disturbances.thrust_share[0] = share
        swarm.step(250)
        speeds.append(float(-swarm.velocity_m_s[0, 2]))
        heights.append(float(-swarm.position_m[0, 2]))
    assert sorted(heights, reverse=True) == heights
    assert heights[0] - heights[1] > 0.05
    assert speeds[1] > 0.3
    assert speeds[2] < -1.0
    assert speeds[3] < -6.0


def some_swarm(autopilot: str | None) -> Swarm:
    """One quiet vehicle high up: measured, or the paper's particle."""
    model: FlightModel | None = None if autopilot is None else quiet(profiles.flight_model(autopilot))
    return Swarm(PHYSICS, HIGH, 0.0, np.random.default_rng(0), model)


@pytest.mark.parametrize("autopilot", [*AUTOPILOTS, None])
def test_an_estimate_that_is_off_moves_the_vehicle(autopilot: str | None) -> None:
    """Control is by the estimate: where that is 3 m too far north, the vehicle is 3 m too far south."""
    swarm = some_swarm(autopilot)
    places_m = hold(swarm, autopilot or "px4")
    swarm.disturbances.estimate_offset_m[0] = (3.0, 0.0, 0.5)
    swarm.step(4000)
    np.testing.assert_allclose(swarm.estimated_position_m, places_m, atol=0.02)
    np.testing.assert_allclose(swarm.position_m, places_m - [3.0, 0.0, 0.5], atol=0.02)


@pytest.mark.parametrize("autopilot", [*AUTOPILOTS, None])
def test_noise_has_the_size_it_is_given(autopilot: str | None) -> None:
    swarm = some_swarm(autopilot)
    hold(swarm, autopilot or "px4")
    swarm.disturbances.estimate_noise_m[0] = 0.5
    true_m, estimated_m = flown(swarm, 60.0, every=1)
    errors_m = (estimated_m - true_m)[:, 0]
    assert errors_m.std(axis=0) == pytest.approx([0.5] * 3, rel=0.05)
    assert np.abs(np.corrcoef(errors_m.T) - np.eye(3)).max() < 0.05
    assert np.abs(np.mean(errors_m[1:] * errors_m[:-1], axis=0)).max() < 0.02  # white


@pytest.mark.parametrize("autopilot", [*AUTOPILOTS, None])
def test_a_frozen_estimate_stands_still_while_the_vehicle_flies_away(autopilot: str | None) -> None:
    swarm = some_swarm(autopilot)
    moving = Reference((0.0, 0.0, -10.0), (2.0, 0.0, 0.0), (0.0, 0.0, 0.0), ALL, ALL, carry_s=60.0)
    command(swarm, 0, autopilot or "px4", moving)
    swarm.commands.flying[0] = True
    swarm.step(100)
    swarm.disturbances.estimate_frozen[0] = True
    frozen = swarm.estimated_position_m.copy(), swarm.estimated_velocity_m_s.copy()
    swarm.step(300)
    np.testing.assert_array_equal((swarm.estimated_position_m, swarm.estimated_velocity_m_s), frozen)
    np.testing.assert_array_equal(swarm.estimated_at(swarm.time_s + DT_S), frozen)
    away_m = float(np.abs(swarm.position_m - frozen[0]).max())
    assert away_m > 0.5
    swarm.disturbances.estimate_frozen[0] = False
    swarm.step()
    np.testing.assert_allclose(swarm.estimated_position_m, swarm.position_m, atol=1e-9)


@pytest.mark.parametrize("autopilot", [*AUTOPILOTS, None])
def test_without_gps_the_estimate_drifts_ever_faster_and_comes_back(autopilot: str | None) -> None:
    swarm = some_swarm(autopilot)
    places_m = hold(swarm, autopilot or "px4")
    swarm.disturbances.gps_lost[0] = True
    swarm.step(1000)
    early_m = float(np.linalg.norm(swarm.estimated_position_m - swarm.position_m))
    swarm.step(1000)
    late_m = float(np.linalg.norm(swarm.estimated_position_m - swarm.position_m))
    assert late_m > 2.5 * early_m > 1.0
    assert abs(swarm.position_m[0, 2] - places_m[0, 2]) < 0.05  # the barometer keeps the height
    swarm.disturbances.gps_lost[0] = False
    swarm.step(6000)
    np.testing.assert_allclose(swarm.position_m, places_m, atol=0.05)


# -- seeds, parameters ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_seed_is_a_flight_and_vehicles_do_not_disturb_each_other(autopilot: str) -> None:
    def track(seed: int, vehicles: int, every: int) -> Array:
        swarm = real_swarm(autopilot, vehicles, seed, wind_m_s=3.0)
        hold(swarm, autopilot)
        swarm.disturbances.gps_lost[1] = True
        swarm.disturbances.estimate_noise_m[0] = 0.3
        return flown(swarm, 10.0, every)[0][-1, :2]

    assert track(1, 4, 10).tobytes() == track(1, 4, 10).tobytes()
    assert track(1, 4, 10).tobytes() == track(1, 4, 1).tobytes()  # steps one by one or together
    assert track(1, 4, 10).tobytes() == track(1, 9, 10).tobytes()
    assert track(1, 4, 10).tobytes() != track(2, 4, 10).tobytes()


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_vehicles_differ_a_little(autopilot: str) -> None:
    """Told the same, they arrive by a few per cent earlier or later."""
    model = profiles.flight_model(autopilot)
    same = FlightModel(model.law, quiet(model).values, model.spread, model.parameters)
    swarm = Swarm(PHYSICS, np.tile(HIGH, (30, 1)), 0.0, np.random.default_rng(3), same)
    for row in range(30):
        command(swarm, row, autopilot, Reference((40.0, 0.0, -10.0), position_used=ALL, yaw_rad=0.0))
    swarm.commands.flying[:] = True
    swarm.step(300)
    way_m = swarm.position_m[:, 0]
    assert 0.0005 < way_m.std() / way_m.mean() < 0.05


def test_parameters_reach_the_law() -> None:
    """PX4 with twice the gain comes closer; ArduPilot with more jerk starts sooner; others ignore what they lack."""

    def way_m(autopilot: str, name: str, value: float) -> float:
        swarm = quiet_swarm(autopilot, HIGH)
        swarm.set_parameter(0, name, value)
        command(swarm, 0, autopilot, Reference((5.0, 0.0, -10.0), position_used=ALL, yaw_rad=0.0))
        swarm.step(150)
        return float(swarm.position_m[0, 0])

    assert way_m("px4", "MPC_XY_P", 1.9) > 1.3 * way_m("px4", "MPC_XY_P", 0.95)
    assert way_m("px4", "SIH_KDV", 0.2) > way_m("px4", "SIH_KDV", 1.0)
    assert way_m("ardupilot", "PSC_JERK_XY", 20.0) > 1.1 * way_m("ardupilot", "PSC_JERK_XY", 5.0)
    assert way_m("px4", "PSC_JERK_XY", 20.0) == way_m("px4", "MPC_XY_P", 0.95)
    assert way_m("px4", "MPC_XY_P", -1.0) == way_m("px4", "MPC_XY_P", 0.95)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_every_step_obeys_the_discrete_dynamics(autopilot: str) -> None:
    swarm = real_swarm(autopilot, 4, wind_m_s=5.0)
    random = np.random.default_rng(7)
    for step in range(2000):
        if step % 100 == 0:
            for row in range(3):  # the fourth is never commanded: it falls and rests
                place: Vec3 = tuple(random.uniform(-20.0, 5.0, 3).tolist())
                command(swarm, row, autopilot, Reference(place, position_used=ALL, yaw_rad=random.uniform(-3.0, 3.0)))
                swarm.commands.flying[row] = True
        x, v = swarm.position_m.copy(), swarm.velocity_m_s.copy()
        swarm.step()
        u = swarm.acceleration_m_s2
        np.testing.assert_allclose(swarm.position_m, x + v * DT_S + 0.5 * u * DT_S**2, atol=1e-12)
        np.testing.assert_allclose(swarm.velocity_m_s, v + u * DT_S, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('law = "wild"\n[model]\n[spread]\n[parameters]', "lacks"),
        ('law = "direct"\n[model]\nwings = 2.0\n[spread]\n[parameters]', "no wings"),
    ],
)
def test_a_flight_model_says_what_is_wrong(text: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        read_flight_model(text)
