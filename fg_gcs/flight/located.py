"""Where a swarm is at one instant, how old that knowledge is, and how sure."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import LocalFrames
from fg_gcs.wire.states import VELOCITIES_S, StateTable

MOST_CARRIED_S: Final = 0.5  # a sample is carried on for so long: what a vehicle did is then no longer what it does
MOST_ACCELERATION_M_S2: Final = 5.0  # of any vehicle that flies within its mission's limits
POSITION_SIGMA_M: Final = 0.1  # of an autopilot's estimate: real PX4 wanders by 0.1 to 0.3 m in a minute
VELOCITY_SIGMA_M_S: Final = 0.1
CLOCK_SIGMA_S: Final = 0.01  # of a vehicle's clock against ours, through 150 +- 50 ms


class Located(NamedTuple):
    """Where V vehicles are at one instant; of one that was never heard NaN, at an infinite age.

    Attributes:
        time_s: The instant [s; loop time].
        position_enu_m: Shape (V, 3) [m; ENU].
        velocity_enu_m_s: Of the newest samples, shape (V, 3) [m/s; ENU].
        age_s: Time since the newest samples were true, shape (V,) [s].
        sigma_m: How far the true positions may be from these, one standard deviation where the vehicles go on as they
            did and a bound where they do what they can, shape (V,) [m].
    """

    time_s: float
    position_enu_m: Array
    velocity_enu_m_s: Array
    age_s: Array
    sigma_m: Array


def located(
    states: StateTable, frames: LocalFrames, now_s: float, acceleration_m_s2: float = MOST_ACCELERATION_M_S2
) -> Located:
    """Bring the newest samples of all vehicles to one instant, p + v t + a t^2 / 2.

    Samples count from when they were true by the vehicles' own stamps, not from when they came. The acceleration is
    the change from a velocity some tenths of a second before, see `StateTable.earlier_ned_m_s`. The uncertainty is
    sigma = sigma_p + (sigma_v + |v| sigma_t / t) t + a_max t^2 / 2, and all of |v| t from where nothing is carried on.

    Args:
        states: The newest samples.
        frames: The vehicles' own.
        now_s: The instant [s; loop time].
        acceleration_m_s2: The most that a vehicle accelerates [m/s^2].
    """
    measured_s, earlier = states.measured_at_s, states.earlier_ned_m_s
    age_s = states.ages_s(now_s)
    carried_s = np.minimum(age_s, MOST_CARRIED_S)
    span_s = measured_s - earlier[:, 3]
    curve = np.zeros_like(age_s)  # without two velocities that are neither close together nor far apart
    np.divide(
        0.5 * carried_s * carried_s, span_s, out=curve, where=(span_s >= VELOCITIES_S) & (span_s < MOST_CARRIED_S)
    )
    places, velocities = np.empty((2, len(measured_s), 3))
    squares = np.zeros(len(measured_s))
    for axis, to in enumerate((1, 0, 2)):  # axis by axis, because NumPy is slow with rows of three
        velocity = states.velocity_ned_m_s[:, axis]
        change = (velocity - earlier[:, axis]) * curve
        change += velocity * carried_s
        np.add(states.position_ned_m[:, axis], change, out=places[:, to])
        velocities[:, to] = velocity
        squares += velocity * velocity
    for down in (places[:, 2], velocities[:, 2]):
        np.negative(down, out=down)
    places = frames.enu_m(places)
    speed_m_s = np.sqrt(squares)
    sigma_m = (
        POSITION_SIGMA_M
        + VELOCITY_SIGMA_M_S * age_s
        + speed_m_s * (CLOCK_SIGMA_S + age_s - carried_s)
        + 0.5 * acceleration_m_s2 * age_s * age_s
    )
    return Located(now_s, places, velocities, age_s, sigma_m)
