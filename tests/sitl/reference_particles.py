"""The paper's particle written out once more, in NumPy over all vehicles: what the compiled step is held against.

x+ = x + v dt + u dt^2 / 2        v+ = v + u dt
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sitl_mock.physics.arrays import Array
from sitl_mock.physics.constants import Physics
from sitl_mock.physics.swarm import Commands

TINY = 1e-9
GRAVITY_M_S2, YAW_GAIN_PER_S, YAW_RATE_RAD_S = 9.80665, 4.0, 1.5


class ReferenceParticles:
    """State and inner loops of V vehicles, one NumPy expression per equation.

    Args:
        physics: all numbers.
        pads_ned_m: (V, 3) where the vehicles stand at the start; world NED, z = 0 is the ground.
        wind_m_s: (3,) steady wind without gusts; zeros are still air.
    """

    def __init__(self, physics: Physics, pads_ned_m: Array, wind_m_s: Array) -> None:
        vehicles = len(pads_ned_m)
        self.physics = physics
        self.time_s = 0.0
        self.position_m = np.array(pads_ned_m, dtype=np.float64)  # (V, 3) world NED
        self.velocity_m_s = np.zeros((vehicles, 3))
        self.acceleration_m_s2 = np.zeros((vehicles, 3))  # the u of the last step
        self.yaw_rad = np.zeros(vehicles)
        self.yaw_rate_rad_s = np.zeros(vehicles)
        self.commands = Commands(vehicles)
        self._correction_m_s2 = np.zeros((vehicles, 3))
        self._integral_m_s2 = np.zeros((vehicles, 3))
        self._windy = bool(np.any(wind_m_s))
        self._body_m_s2 = np.full(vehicles, physics.body.acceleration_m_s2)  # (V,)
        self._integral_bound_m_s2 = np.full(vehicles, physics.tracking.integral_bound_m_s2)  # (V,)
        self._wind_m_s = wind_m_s
        self._steps = 0

    @property
    def in_contact(self) -> NDArray[np.bool_]:
        """(V,) whether a vehicle stands on the ground."""
        return self.position_m[:, 2] > -self.physics.ground.contact_m

    def step(self) -> None:
        """Advance every vehicle by one physics step."""
        dt_s = self.physics.time.step_s
        u = self._bounded_speed(self._grounded(self._command()), dt_s)
        self.position_m += self.velocity_m_s * dt_s + u * (0.5 * dt_s * dt_s)
        self.velocity_m_s += u * dt_s
        self.acceleration_m_s2 = u
        self._turn(dt_s)
        self._steps += 1
        self.time_s = self._steps * dt_s

    def _command(self) -> Array:
        """(V, 3) acceleration that the autopilots ask for: feed-forward plus bounded, smoothed PID correction."""
        c, tracking = self.commands, self.physics.tracking
        age_s = np.maximum(self.time_s - c.since_s, 0.0)
        run_s = np.minimum(age_s, c.carry_s)[:, None]
        over = c.lapses & (age_s > c.carry_s)  # the stream stopped: the target stands where it ran to
        live = (~over)[:, None]
        velocity_m_s = (c.velocity_m_s + c.acceleration_m_s2 * run_s) * live
        target_m = c.position_m + c.velocity_m_s * run_s + c.acceleration_m_s2 * (0.5 * run_s * run_s)
        feed_m_s2 = c.acceleration_m_s2 * live

        error_m = (target_m - self.position_m) * c.position_used
        wanted_m_s = velocity_m_s + self._approach(error_m)
        wanted_m_s, feed_m_s2 = self._speed_limited(wanted_m_s, feed_m_s2)
        controlled = np.maximum(c.controlled, over[:, None])
        miss_m_s = (wanted_m_s - self.velocity_m_s) * controlled
        raw_m_s2 = _shortened(tracking.velocity_gain_per_s * miss_m_s, c.correction_m_s2)
        share = self.physics.time.step_s / tracking.smoothing_s
        self._correction_m_s2 += (raw_m_s2 - self._correction_m_s2) * share
        self._correction_m_s2 *= c.flying[:, None]
        # Corrections may turn a fed-forward acceleration but hardly lengthen it: a plan at its limit stays there.
        longest_m_s2 = np.maximum(
            (1.0 + tracking.headroom) * np.sqrt(np.einsum("vi,vi->v", feed_m_s2, feed_m_s2)), c.correction_m_s2
        )
        asked_m_s2 = _shortened(feed_m_s2 + self._correction_m_s2, longest_m_s2)
        if self._windy:
            asked_m_s2 += self._against_wind(miss_m_s)
        return _shortened(asked_m_s2, self._body_m_s2)

    def _against_wind(self, miss_m_s: Array) -> Array:
        """(V, 3) integral of the velocity error: it only has to answer wind, so in still air it is left out."""
        tracking, c = self.physics.tracking, self.commands
        asked_m_s2 = tracking.velocity_gain_per_s * np.abs(miss_m_s)
        near = asked_m_s2 < c.correction_m_s2[:, None]  # a saturated loop is on its way, nothing to learn from
        self._integral_m_s2 += miss_m_s * near * (tracking.integral_gain_per_s2 * self.physics.time.step_s)
        self._integral_m_s2 *= c.flying[:, None]
        return _shortened(self._integral_m_s2, self._integral_bound_m_s2)

    def _approach(self, error_m: Array) -> Array:
        """(V, 3) velocity towards the target: proportional when near, braking at constant deceleration when far."""
        c = self.commands
        gain = c.position_gain_per_s
        brake_m_s2 = self.physics.tracking.braking_share * c.correction_m_s2
        near_m = brake_m_s2 / (gain * gain)
        horizontal_m = np.hypot(error_m[:, 0], error_m[:, 1])
        vertical_m = np.abs(error_m[:, 2])
        factor = np.empty_like(error_m)
        for distance_m, axes in ((horizontal_m, slice(0, 2)), (vertical_m, slice(2, 3))):
            far_m_s = np.sqrt(2.0 * brake_m_s2 * np.maximum(distance_m - 0.5 * near_m, 0.0))
            factor[:, axes] = np.where(distance_m < near_m, gain, far_m_s / np.maximum(distance_m, TINY))[:, None]
        return error_m * factor

    def _speed_limited(self, wanted_m_s: Array, feed_m_s2: Array) -> tuple[Array, Array]:
        """The wanted velocity within the parameters' limits; where it was cut, no feed-forward pushes outwards."""
        c = self.commands
        horizontal_m_s = np.hypot(wanted_m_s[:, 0], wanted_m_s[:, 1])
        allowed_m_s = c.speed_m_s + c.speed_headroom_m_s
        vertical_m_s = np.minimum(
            np.maximum(wanted_m_s[:, 2], -(c.climb_m_s + c.speed_headroom_m_s)), c.descent_m_s + c.speed_headroom_m_s
        )
        too_fast = horizontal_m_s > allowed_m_s
        too_steep = vertical_m_s != wanted_m_s[:, 2]
        if not (too_fast.any() or too_steep.any()):
            return wanted_m_s, feed_m_s2
        limited_m_s = wanted_m_s.copy()
        limited_m_s[:, :2] *= np.minimum(1.0, allowed_m_s / np.maximum(horizontal_m_s, TINY))[:, None]
        limited_m_s[:, 2] = vertical_m_s
        feed_m_s2 = feed_m_s2.copy()
        outwards = too_fast & (np.einsum("vi,vi->v", feed_m_s2[:, :2], wanted_m_s[:, :2]) > 0.0)
        feed_m_s2[outwards, :2] = 0.0
        feed_m_s2[too_steep & (feed_m_s2[:, 2] * wanted_m_s[:, 2] > 0.0), 2] = 0.0
        return limited_m_s, feed_m_s2

    def _grounded(self, u: Array) -> Array:
        """(V, 3) acceleration with gravity (motors not lifting), wind in the air, and the ground's support."""
        ground, flying = self.physics.ground, self.commands.flying
        z_m, fall_m_s = self.position_m[:, 2], self.velocity_m_s[:, 2]
        contact = self.in_contact
        if self._windy:
            u = u + self.physics.wind.drag_per_s * self._wind_m_s * (flying & ~contact)[:, None]
        falling_m_s2 = np.where(flying, u[:, 2], GRAVITY_M_S2)
        touching = (z_m >= 0.0) | (contact & ~flying)
        support_m_s2 = -ground.stiffness_per_s2 * z_m - ground.damping_per_s * fall_m_s
        u[:, 2] = np.where(touching, np.minimum(falling_m_s2, support_m_s2), falling_m_s2)
        # Motors off just above the pad: the spring pulls down too, so that a rest is exactly at pad height.
        u[:, 2] = np.where(touching & ~flying, support_m_s2, u[:, 2])
        resting = contact & (falling_m_s2 >= 0.0)
        u[:, :2] = np.where(resting[:, None], -ground.friction_per_s * self.velocity_m_s[:, :2], u[:, :2])
        u[:, :2] *= (flying | resting)[:, None]
        return u

    def _bounded_speed(self, u: Array, dt_s: float) -> Array:
        """(V, 3) acceleration after which no flying vehicle exceeds the body's speed."""
        after_m_s = self.velocity_m_s + u * dt_s
        speed_m_s = np.sqrt(np.einsum("vi,vi->v", after_m_s, after_m_s))
        fast = (speed_m_s > self.physics.body.speed_m_s) & self.commands.flying
        if fast.any():
            scale = self.physics.body.speed_m_s / speed_m_s[fast]
            u[fast] = (after_m_s[fast] * scale[:, None] - self.velocity_m_s[fast]) / dt_s
        return u

    def _turn(self, dt_s: float) -> None:
        """Yaw at a bounded rate, the short way round."""
        c = self.commands
        miss_rad = np.remainder(c.yaw_rad - self.yaw_rad + math.pi, 2.0 * math.pi) - math.pi
        rate_rad_s = np.where(c.yaw_used, YAW_GAIN_PER_S * miss_rad, c.yaw_rate_rad_s) * c.flying
        self.yaw_rate_rad_s = np.minimum(np.maximum(rate_rad_s, -YAW_RATE_RAD_S), YAW_RATE_RAD_S)
        turned_rad = self.yaw_rad + self.yaw_rate_rad_s * dt_s
        self.yaw_rad = np.remainder(turned_rad + math.pi, 2.0 * math.pi) - math.pi


def _shortened(vectors: Array, longest: Array) -> Array:
    """Vectors (V, 3) scaled down to at most `longest` (V,)."""
    length = np.sqrt(np.einsum("vi,vi->v", vectors, vectors))
    scaled: Array = vectors * np.minimum(1.0, longest / np.maximum(length, TINY))[:, None]
    return scaled
