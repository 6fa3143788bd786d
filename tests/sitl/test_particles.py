"""Laws of the particle dynamics, without any autopilot."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest

from sitl_mock.physics.constants import load_physics
from sitl_mock.physics.reference import ALL, NONE, Limits, Reference, Vec3
from sitl_mock.physics.swarm import Swarm, enu_from_ned
from tests.sitl.reference_particles import GRAVITY_M_S2, YAW_RATE_RAD_S, ReferenceParticles

PHYSICS = load_physics()
LIMITS = Limits(speed_m_s=12.0, climb_m_s=3.0, descent_m_s=1.5, acceleration_m_s2=3.0, step_gain_per_s=1.0)
DT_S = PHYSICS.time.step_s


def swarm(height_m: float = 0.0, vehicles: int = 1, wind_m_s: float = 0.0, seed: int = 0) -> Swarm:
    pads = np.array([(5.0 * k, 0.0, -height_m) for k in range(vehicles)])
    return Swarm(PHYSICS, pads, wind_m_s, np.random.default_rng(seed))


def fly(particles: Swarm, row: int, reference: Reference, limits: Limits = LIMITS) -> None:
    particles.commands.set(row, reference, limits, PHYSICS.tracking)
    particles.commands.flying[row] = True


def test_every_step_obeys_the_discrete_dynamics() -> None:
    """x+ = x + v dt + u dt^2 / 2 and v+ = v + u dt, in the air, on the ground, falling and in wind."""
    random = np.random.default_rng(7)
    particles = swarm(2.0, vehicles=4, wind_m_s=5.0)
    for step in range(3000):
        if step % 100 == 0:
            for row in range(3):  # the fourth is never commanded: it falls and rests
                place: Vec3 = tuple(random.uniform(-20.0, 5.0, 3).tolist())
                fly(particles, row, Reference(place, position_used=ALL, yaw_rad=random.uniform(-3.0, 3.0)))
        x, v = particles.position_m.copy(), particles.velocity_m_s.copy()
        particles.step()
        u = particles.acceleration_m_s2
        np.testing.assert_allclose(particles.position_m, x + v * DT_S + 0.5 * u * DT_S**2, atol=1e-12)
        np.testing.assert_allclose(particles.velocity_m_s, v + u * DT_S, atol=1e-12)


@pytest.mark.parametrize("wind_m_s", [(0.0, 0.0, 0.0), (3.0, -4.0, 0.0)])
def test_compiled_particles_are_the_equations(wind_m_s: Vec3) -> None:
    """Random references of every kind, up and down to the ground: the compiled step and NumPy stay together."""
    random = np.random.default_rng(11)
    pads = np.array([(6.0 * k, 0.0, -3.0 * k) for k in range(6)])
    compiled = Swarm(PHYSICS, pads, 0.0, np.random.default_rng(0))
    compiled.disturbances.wind_m_s[:] = wind_m_s
    written = ReferenceParticles(PHYSICS, pads, np.array(wind_m_s))
    kinds = [(ALL, NONE), (NONE, ALL), (ALL, ALL), (NONE, NONE), ((True, True, False), (False, False, True))]
    for step in range(4000):
        if step % 50 == 0:
            for row in range(6):
                position, velocity, acceleration = (
                    tuple(random.normal(0.0, size, 3).tolist()) for size in (15.0, 3.0, 2.0)
                )
                used, given = kinds[random.integers(len(kinds))]
                yaw = None if random.random() < 0.3 else random.uniform(-4.0, 4.0)
                since_s, lapses = compiled.time_s - random.uniform(0.0, 0.3), random.random() < 0.5
                reference = Reference(
                    position, velocity, acceleration, used, given, yaw, random.normal(), since_s, 0.2, lapses
                )
                flying = random.random() < 0.95
                for commands in (compiled.commands, written.commands):
                    commands.set(row, reference, LIMITS, PHYSICS.tracking)
                    commands.flying[row] = flying
        compiled.step()
        written.step()
        for name in ("position_m", "velocity_m_s", "acceleration_m_s2", "yaw_rad", "yaw_rate_rad_s", "in_contact"):
            np.testing.assert_allclose(getattr(compiled, name), getattr(written, name), rtol=0.0, atol=1e-9)
        # Rounding does not add up: both go on from the same state.
        compiled.position_m[:], compiled.velocity_m_s[:] = written.position_m, written.velocity_m_s


def test_without_disturbances_the_estimate_is_the_truth() -> None:
    particles = swarm(10.0, vehicles=3, wind_m_s=4.0)
    fly(particles, 0, Reference((5.0, 0.0, -10.0), position_used=ALL))
    for _ in range(300):
        particles.step()
        np.testing.assert_array_equal(particles.estimated_position_m, particles.position_m)
        np.testing.assert_array_equal(particles.estimated_velocity_m_s, particles.velocity_m_s)


def test_no_command_exceeds_what_the_body_can() -> None:
    random = np.random.default_rng(3)
    particles = swarm(500.0, vehicles=8)
    wild = Limits(1e3, 1e3, 1e3, 1e3, 5.0)
    for step in range(2500):
        if step % 50 == 0:
            for row in range(8):
                velocity: Vec3 = tuple(random.uniform(-100.0, 100.0, 3).tolist())
                acceleration: Vec3 = tuple(random.uniform(-50.0, 50.0, 3).tolist())
                yaw_rate = random.uniform(-9.0, 9.0)
                moving = Reference(ALL_ZERO, velocity, acceleration, NONE, ALL, None, yaw_rate, particles.time_s, 0.1)
                fly(particles, row, moving, wild)
        particles.step()
        assert np.linalg.norm(particles.velocity_m_s, axis=1).max() <= PHYSICS.body.speed_m_s + 1e-9
        limit_m_s2 = PHYSICS.body.acceleration_m_s2 + 1e-9
        slow = np.linalg.norm(particles.velocity_m_s, axis=1) < PHYSICS.body.speed_m_s - 1e-6
        assert np.linalg.norm(particles.acceleration_m_s2[slow], axis=1).max(initial=0.0) <= limit_m_s2
        assert np.abs(particles.yaw_rate_rad_s).max() <= YAW_RATE_RAD_S + 1e-12


ALL_ZERO: Vec3 = (0.0, 0.0, 0.0)


def test_rest_on_the_ground_is_exact() -> None:
    particles = swarm()
    for _ in range(500):
        particles.step()
    np.testing.assert_array_equal(particles.position_m, np.zeros((1, 3)))
    np.testing.assert_array_equal(particles.velocity_m_s, np.zeros((1, 3)))


@pytest.mark.parametrize("wind_m_s", [0.0, 8.0])
def test_touch_down_is_soft_and_ends_at_pad_height(wind_m_s: float) -> None:
    particles = swarm(1.0, wind_m_s=wind_m_s)
    fly(particles, 0, Reference(velocity_ned_m_s=(0.0, 0.0, 0.5), velocity_used=ALL))
    depths, jumps = [], []
    for _ in range(1500):
        before = particles.position_m.copy()
        particles.step()
        depths.append(particles.position_m[0, 2])
        jumps.append(float(np.abs(particles.position_m - before).max()))
    assert max(depths) < 0.02
    assert max(jumps) < 2.0 * 0.5 * DT_S + 0.02 * wind_m_s * DT_S  # never faster than it came
    assert depths[-1] == pytest.approx(0.0, abs=1e-3)
    assert particles.velocity_m_s[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)


def test_fall_ends_on_the_ground() -> None:
    particles = swarm(10.0)
    speeds = []
    for _ in range(1500):
        particles.step()
        speeds.append(float(particles.velocity_m_s[0, 2]))
    assert max(speeds) == pytest.approx(math.sqrt(2.0 * GRAVITY_M_S2 * 10.0), rel=0.01)
    assert particles.position_m[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert particles.impact_m_s[0] == pytest.approx(max(speeds), rel=0.01)


def test_target_runs_on_exactly_as_long_as_it_is_carried() -> None:
    """A reference with constant acceleration is followed without a new setpoint, and holds where it lapses."""
    particles = swarm(50.0)
    moving = Reference((0.0, 0.0, -50.0), (1.0, 0.0, 0.0), (0.5, 0.0, 0.0), ALL, ALL, 0.0, 0.0, 0.0, 2.0, lapses=True)
    particles.velocity_m_s[0] = (1.0, 0.0, 0.0)
    fly(particles, 0, moving)
    while particles.time_s < 1.99:
        particles.step()
        t = particles.time_s
        assert particles.position_m[0, 0] == pytest.approx(t + 0.25 * t * t, abs=0.02)
    for _ in range(2500):
        particles.step()
    assert particles.position_m[0] == pytest.approx([3.0, 0.0, -50.0], abs=0.01)


def test_yaw_turns_the_short_way() -> None:
    particles = swarm(10.0)
    particles.yaw_rad[0] = math.radians(170.0)
    fly(particles, 0, Reference((0.0, 0.0, -10.0), position_used=ALL, yaw_rad=math.radians(-170.0)))
    for _ in range(500):
        particles.step()
        assert abs(particles.yaw_rad[0]) >= math.radians(169.9)
    assert particles.yaw_rad[0] == pytest.approx(math.radians(-170.0), abs=0.01)


def test_state_between_steps_is_exact() -> None:
    particles = swarm(10.0)
    fly(particles, 0, Reference((5.0, 0.0, -10.0), position_used=ALL))
    for _ in range(100):
        particles.step()
        end = particles.at(particles.time_s + DT_S)
        start = particles.at(particles.time_s)
        np.testing.assert_array_equal(start[0], particles.position_m)
        u = particles.acceleration_m_s2
        np.testing.assert_allclose(end[1], particles.velocity_m_s + u * DT_S, atol=1e-12)


def test_wind_is_a_number() -> None:
    """Same seed, same flight; other seed, other flight; no wind, no seed in the flight."""

    def flown(wind_m_s: float, seed: int) -> bytes:
        particles = swarm(10.0, wind_m_s=wind_m_s, seed=seed)
        fly(particles, 0, Reference((0.0, 0.0, -10.0), position_used=ALL))
        for _ in range(250):
            particles.step()
        return particles.position_m.tobytes()

    assert flown(5.0, 1) == flown(5.0, 1)
    assert flown(5.0, 1) != flown(5.0, 2)
    assert flown(0.0, 1) == flown(0.0, 2)


def test_enu_and_ned_are_each_other_s_inverse() -> None:
    vectors = np.random.default_rng(0).normal(size=(10, 3))
    np.testing.assert_array_equal(enu_from_ned(enu_from_ned(vectors)), vectors)
    np.testing.assert_array_equal(enu_from_ned(np.array([[1.0, 2.0, 3.0]])), [[2.0, 1.0, -3.0]])


NO_COMPILER = """
import sys
import numpy as np
import sitl_mock.__main__, sitl_mock.host.server
from sitl_mock.physics.constants import load_physics
from sitl_mock.physics.swarm import Swarm

swarm = Swarm(load_physics(), np.zeros((0, 3)), 0.0, np.random.default_rng(0))
swarm.step(3)
print(swarm.time_s, "numba" in sys.modules)
"""


def test_the_compiler_is_loaded_where_something_flies_and_not_before() -> None:
    ran = subprocess.run([sys.executable, "-c", NO_COMPILER], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["0.03", "False"]
