"""All vehicles: one row each of the tables in `records`, moved by the compiled step in `kernels`.

    x+ = x + v dt + u dt^2 / 2        v+ = v + u dt

`u` is everything. The paper's particle: feed-forward, PID correction, ground, gravity and wind, after all bounds.
Measured dynamics: thrust along an attitude that lags, gravity, drag and ground, under a real autopilot's control law,
which flies by an estimate. V: vehicles. World NED has its origin on the flat ground (z = 0); NED because the wire and
the autopilots think in it, so that only `Simulator.positions_enu_m` and its like turn signs.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl_mock.physics.arrays import Array
from sitl_mock.physics.constants import Physics, PositionLoop
from sitl_mock.physics.flight_model import LAWS, FlightModel
from sitl_mock.physics.records import COMMAND, DISTURBANCE, STATE, WORLD
from sitl_mock.physics.reference import Limits, Reference, Vec3

LEVEL = (0.0, 0.0, -1.0)
LEAST_LIFT = 0.01  # of the thrust's upward part: keeps attitudes from turning over


def enu_from_ned(vectors_ned: Array) -> Array:
    """Swap axes (V, 3) NED -> ENU (its own inverse)."""
    return vectors_ned[:, [1, 0, 2]] * (1.0, 1.0, -1.0)


class Commands:
    """The references of all vehicles as arrays, one row per vehicle: views of one table."""

    def __init__(self, vehicles: int) -> None:
        self.table = np.zeros(vehicles, COMMAND)
        self.position_m: Array = self.table["position_m"]  # (V, 3)
        self.velocity_m_s: Array = self.table["velocity_m_s"]  # (V, 3)
        self.acceleration_m_s2: Array = self.table["acceleration_m_s2"]  # (V, 3)
        self.position_used: Array = self.table["position_used"]  # (V, 3), 0 or 1
        self.velocity_given: Array = self.table["velocity_given"]  # (V, 3), 0 or 1
        self.controlled: Array = self.table["controlled"]  # (V, 3), 0 or 1: position or velocity is controlled
        self.position_gain_per_s: Array = self.table["position_gain_per_s"]  # (V,), as are all below
        self.speed_headroom_m_s: Array = self.table["speed_headroom_m_s"]
        self.yaw_rad: Array = self.table["yaw_rad"]
        self.yaw_rate_rad_s: Array = self.table["yaw_rate_rad_s"]
        self.yaw_used: NDArray[np.bool_] = self.table["yaw_used"]
        self.since_s: Array = self.table["since_s"]
        self.carry_s: Array = self.table["carry_s"]
        self.lapses: NDArray[np.bool_] = self.table["lapses"]
        self.planned: Array = self.table["planned"]  # 0 or 1
        self.speed_m_s: Array = self.table["speed_m_s"]
        self.climb_m_s: Array = self.table["climb_m_s"]
        self.descent_m_s: Array = self.table["descent_m_s"]
        self.correction_m_s2: Array = self.table["correction_m_s2"]
        self.flying: NDArray[np.bool_] = self.table["flying"]
        for column in (self.position_gain_per_s, self.speed_m_s, self.climb_m_s, self.descent_m_s):
            column[:] = 1.0
        self.correction_m_s2[:] = 1.0
        self._bytes = self.table.view(np.uint8).data if vehicles else memoryview(b"")
        assert COMMAND.fields is not None
        self._yaw_offset, self._since_offset = (COMMAND.fields[name][1] for name in ("yaw_rad", "since_s"))

    def stream(
        self, row: int, position_m: Vec3, velocity_m_s: Vec3, acceleration_m_s2: Vec3, yaw_rad: float, since_s: float
    ) -> None:
        """Replace the target of a vehicle whose reference stays what it is otherwise."""
        # Straight into the bytes: a tenth of what five assignments to columns take.
        start = row * COMMAND.itemsize
        TARGET.pack_into(self._bytes, start, *position_m, *velocity_m_s, *acceleration_m_s2)
        YAW.pack_into(self._bytes, start + self._yaw_offset, yaw_rad)
        YAW.pack_into(self._bytes, start + self._since_offset, since_s)

    def set(self, row: int, reference: Reference, limits: Limits, tracking: PositionLoop) -> None:
        """Replace the reference of one vehicle, which flies from now on until `flying` says otherwise."""
        step = reference.is_step
        used, given = reference.position_used, reference.velocity_used
        # A whole row at once, in the order of its columns: column by column would take four times as long.
        self.table[row] = (
            reference.position_ned_m,
            reference.velocity_ned_m_s,
            reference.acceleration_ned_m_s2,
            used,
            given,
            (used[0] or given[0], used[1] or given[1], used[2] or given[2]),
            limits.step_gain_per_s if step else tracking.position_gain_per_s,
            0.0 if step else tracking.speed_headroom_m_s,
            0.0 if reference.yaw_rad is None else reference.yaw_rad,
            reference.yaw_rate_rad_s,
            reference.yaw_rad is not None,
            reference.since_s,
            reference.carry_s,
            reference.lapses,
            reference.planned,
            limits.speed_m_s,
            limits.climb_m_s,
            limits.descent_m_s,
            limits.acceleration_m_s2,
            True,
        )


TARGET = struct.Struct("=9d")  # the first columns of a command: position, velocity, acceleration
YAW = struct.Struct("=d")


class Disturbances:
    """What goes wrong, as arrays that whoever makes faults writes: views of one table, read at every step."""

    def __init__(self, vehicles: int) -> None:
        self.table = np.zeros(vehicles, DISTURBANCE)
        self.estimate_offset_m: Array = self.table["estimate_offset_m"]  # (V, 3) added to the estimated position
        self.estimate_noise_m: Array = self.table["estimate_noise_m"]  # (V,) white, on each axis, standard deviation
        self.estimate_frozen: NDArray[np.bool_] = self.table["estimate_frozen"]  # (V,) the estimate stands still
        self.gps_lost: NDArray[np.bool_] = self.table["gps_lost"]  # (V,) the horizontal estimate drifts away
        self.wind_m_s: Array = self.table["wind_m_s"]  # (V, 3) mean
        self.gust_m_s: Array = self.table["gust_m_s"]  # (V,) standard deviation of gusts on each axis
        self.thrust_share: Array = self.table["thrust_share"]  # (V,) of the greatest thrust; 0: a motor is dead
        self.thrust_share[:] = 1.0
        self._usual = self.table.copy()

    def make_usual(self) -> None:
        """What is written now is what there is without faults."""
        self._usual = self.table.copy()

    def clear(self) -> None:
        """Leave only what there is without faults."""
        self.table[:] = self._usual


class Pair(NamedTuple):
    """Two vehicles, by row, and the least distance of their centres."""

    first: int
    second: int
    distance_m: float


class Swarm:
    """State and inner loops of V vehicles. All arrays are views that `step` writes into.

    Args:
        physics: all numbers of the world and of particles.
        pads_ned_m: (V, 3) where the vehicles stand at the start; world NED, z = 0 is the ground.
        wind_m_s: mean speed of the wind, direction and gusts drawn from `random`; 0 is still air.
        random: generator of wind, of the estimator's errors and of what differs from vehicle to vehicle.
        model: what flies; None: the paper's particle.
    """

    def __init__(
        self,
        physics: Physics,
        pads_ned_m: Array,
        wind_m_s: float,
        random: np.random.Generator,
        model: FlightModel | None = None,
    ) -> None:
        vehicles = len(pads_ned_m)
        self.physics = physics
        self.model = physics.particle if model is None else model
        self.time_s = 0.0
        self._steps = 0
        heading, differences = random.uniform(0.0, 2.0 * math.pi), random.spawn(1)[0]
        self._state = np.zeros(vehicles, STATE)
        self._state["random_state"] = random.integers(0, 2**64, vehicles, dtype=np.uint64)
        self._models, self._factors = self.model.table(vehicles, differences)
        self._world = _world(physics)
        self.position_m: Array = self._state["position_m"]  # (V, 3) true
        self.velocity_m_s: Array = self._state["velocity_m_s"]  # (V, 3) true
        self.acceleration_m_s2: Array = self._state["acceleration_m_s2"]  # (V, 3) the u of the last step
        self.yaw_rad: Array = self._state["yaw_rad"]  # (V,)
        self.yaw_rate_rad_s: Array = self._state["yaw_rate_rad_s"]  # (V,)
        self.estimated_position_m: Array = self._state["estimated_position_m"]  # (V, 3) as the autopilot believes
        self.estimated_velocity_m_s: Array = self._state["estimated_velocity_m_s"]  # (V, 3)
        self.target_m: Array = self._state["target_m"]  # (V, 3) what the control law aims at
        self.target_m_s: Array = self._state["target_m_s"]  # (V, 3) velocity that it controls to
        self.in_contact: NDArray[np.bool_] = self._state["in_contact"]  # (V,) stands on the ground
        self.impact_m_s: Array = self._state["impact_m_s"]  # (V,) speed at which it touched the ground last
        self.commands = Commands(vehicles)
        self.disturbances = Disturbances(vehicles)
        self.position_m[:] = self.estimated_position_m[:] = pads_ned_m
        self.in_contact[:] = self.position_m[:, 2] > -physics.ground.contact_m
        self._state["upward"][:, 2] = -1.0
        self.disturbances.wind_m_s[:] = wind_m_s * np.array([math.cos(heading), math.sin(heading), 0.0])
        self.disturbances.gust_m_s[:] = physics.wind.gust_share * wind_m_s
        self.disturbances.make_usual()
        if vehicles:
            # Machine code is compiled or loaded now: in flight nothing waits for it.
            self._advance(0)
            self.pairs_within(0.0)
            self.closest_pair(np.zeros(vehicles, dtype=np.bool_))

    def step(self, steps: int = 1) -> None:
        """Advance every vehicle by a number of physics steps; what is commanded does not change meanwhile."""
        if len(self._state):
            self._advance(steps)
        self._steps += steps
        self.time_s = self._steps * self.physics.time.step_s

    def _advance(self, steps: int) -> None:
        from sitl_mock.physics import kernels  # loads the compiler: only where something flies

        tables = (self._state, self.commands.table, self.disturbances.table, self._models, self._world)
        dt_s = self.physics.time.step_s
        if self.model.law is None:
            kernels.step_particles(*tables, self._steps, dt_s, steps)
        else:
            kernels.step_measured(*tables, LAWS.index(self.model.law), self._steps, dt_s, steps)

    def set_parameter(self, row: int, name: str, value: float) -> None:
        """Give a vehicle's control law or airframe the value of an autopilot's parameter, in the parameter's own unit.

        Parameters that the flight model does not use are ignored; so are values that are not positive.
        """
        column, scale = self.model.parameters.get(name, ("", 1.0))
        if column and value > 0.0:
            factors = self._factors.get(column)
            self._models[column][row] = value * scale * (1.0 if factors is None else factors[row])

    @property
    def pitch_rad(self) -> Array:
        """(V,) attitude that points the thrust where it goes; level on the ground."""
        forward, _, lift = self._thrust()
        return np.arctan2(-forward, lift)

    @property
    def roll_rad(self) -> Array:
        """(V,) likewise."""
        forward, right, lift = self._thrust()
        return np.arctan2(right, np.hypot(forward, lift))

    def _thrust(self) -> tuple[Array, Array, Array]:
        """(V,) each: the thrust's direction ahead, to the right and up, as seen along the vehicle's heading."""
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        north, east, down = np.where(self.in_contact[:, None], LEVEL, self._state["upward"]).T
        return cos * north + sin * east, cos * east - sin * north, np.maximum(-down, LEAST_LIFT)

    def at(self, time_s: float) -> tuple[Array, Array]:
        """True positions and velocities (V, 3) at a time inside the present step: exact, because u is held.

        Args:
            time_s: not before `self.time_s` and at most one step behind it; else the nearer end is given.
        """
        return self._ahead(self.position_m, self.velocity_m_s, time_s)

    def estimated_at(self, time_s: float) -> tuple[Array, Array]:
        """What the autopilots believe: positions and velocities (V, 3) at a time inside the present step."""
        position_m, velocity_m_s = self._ahead(self.estimated_position_m, self.estimated_velocity_m_s, time_s)
        frozen = self.disturbances.estimate_frozen
        if frozen.any():
            position_m[frozen] = self.estimated_position_m[frozen]
            velocity_m_s[frozen] = self.estimated_velocity_m_s[frozen]
        return position_m, velocity_m_s

    def pairs_within(self, limit_m: float, span_s: float | None = None) -> list[Pair]:
        """Pairs whose centres came closer than a limit during the last physics step.

        Args:
            limit_m: distance [m].
            span_s: look back so much instead, along the present motion.
        """
        from sitl_mock.physics import encounters

        return [Pair(*pair) for pair in encounters.pairs_within(self._before(span_s), self.position_m, limit_m)]

    def closest_pair(self, airborne: NDArray[np.bool_], span_s: float | None = None) -> Pair | None:
        """The pair of marked vehicles that came closest during the last step, or None: fewer than two are marked.

        Args:
            airborne: (V,) which vehicles count.
            span_s: as of `pairs_within`.
        """
        from sitl_mock.physics import encounters

        pair = Pair(*encounters.closest_pair(self._before(span_s), self.position_m, airborne))
        return pair if pair.first >= 0 else None

    def _before(self, span_s: float | None) -> Array:
        """(V, 3) where the vehicles were; exact for the last step, because its acceleration was held."""
        back_s = self.physics.time.step_s if span_s is None else span_s
        return self.position_m - self.velocity_m_s * back_s + self.acceleration_m_s2 * (0.5 * back_s * back_s)

    def _ahead(self, position_m: Array, velocity_m_s: Array, time_s: float) -> tuple[Array, Array]:
        ahead_s = min(max(time_s - self.time_s, 0.0), self.physics.time.step_s)
        u = self.acceleration_m_s2
        return position_m + velocity_m_s * ahead_s + u * (0.5 * ahead_s * ahead_s), velocity_m_s + u * ahead_s


def _world(physics: Physics) -> NDArray[np.void]:
    """(1,) the numbers of particles and ground that kernels read."""
    world = np.zeros(1, WORLD)
    loop, ground, wind = physics.tracking, physics.ground, physics.wind
    for name in ("velocity_gain_per_s", "integral_gain_per_s2", "smoothing_s", "headroom", "braking_share"):
        world[name] = getattr(loop, name)
    for name in ("stiffness_per_s2", "damping_per_s", "friction_per_s", "contact_m"):
        world[name] = getattr(ground, name)
    world["integral_bound_m_s2"] = loop.integral_bound_m_s2
    world["body_speed_m_s"] = physics.body.speed_m_s
    world["body_acceleration_m_s2"] = physics.body.acceleration_m_s2
    world["wind_drag_per_s"] = wind.drag_per_s
    world["gust_time_s"] = wind.gust_time_s
    return world
