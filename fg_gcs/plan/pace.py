"""How a plan's time passes: as it was planned, slower and slower until all rest on its path, or faster again."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array
from fg_gcs.plan.limits import Limits

SHORTEST_S = 0.5  # of a stop
SHARES = 12  # stops that are tried, from the quickest that brakes as a vehicle can to the gentlest
QUICKEST, GENTLEST = 1.5, 4.0  # times speed / acceleration: the cubic's steepest slope is 1.5 over its length
LOOKS = 24  # instants of a stop that are looked at
BEYOND = 1.1  # times the limits that a stop may take: real vehicles have more, and plans are at their limits already
AHEAD_S = 2.0  # how far a plan is looked ahead for the speed from which it has to stop


class Pace(NamedTuple):
    """How fast a plan's time passes: from ``begin_s`` on it changes within ``lasts_s`` to another rate, smoothly.

    The rate is a cubic with given values and slopes at both ends, the last slope 0. A rate r multiplies speeds;
    accelerations become ``a r^2 + v r'``.
    """

    begin_s: float  # the clock's reading [s]
    plan_s: float  # the plan's time then [s]
    before: float = 1.0  # rate then
    slope: float = 0.0  # its derivative then [1/s]
    after: float = 1.0  # rate in the end
    lasts_s: float = 0.0

    def at(self, now_s: float) -> tuple[float, float, float]:
        """Return the plan's time [s], its rate, and the rate's derivative [1/s]."""
        return changing(now_s - self.begin_s, self.plan_s, self.before, self.slope, self.after, self.lasts_s)

    def when(self, plan_s: float) -> float:
        """Return the clock's reading at which the plan's time is reached once the rate is steady; infinite if never."""
        end_s, rate, _ = self.at(self.begin_s + self.lasts_s)
        return self.begin_s + self.lasts_s + max(plan_s - end_s, 0.0) / rate if rate > 0.0 else np.inf


@kernel
def changing(
    passed: float, plan: float, before: float, slope: float, after: float, lasts: float
) -> tuple[float, float, float]:
    """A plan's time, its rate, and the rate's derivative, so long after the rate began to change; see `Pace`."""
    if passed >= lasts:
        whole = lasts * (0.5 * (before + after) + slope * lasts / 12.0)
        return plan + whole + after * (passed - lasts), after, 0.0
    if passed <= 0.0:
        return plan + before * passed, before, slope
    x, change, kick = passed / lasts, after - before, slope * lasts
    rate = before + kick * x * (1.0 - x) ** 2 + change * x**2 * (3.0 - 2.0 * x)
    rate_dot = (kick * (1.0 - x) * (1.0 - 3.0 * x) + change * 6.0 * x * (1.0 - x)) / lasts
    area = before * x + kick * x**2 * (0.5 - x * (2.0 / 3.0 - 0.25 * x)) + change * x**3 * (1.0 - 0.5 * x)
    return plan + lasts * area, rate, rate_dot


def stop_s(velocity_m_s: Array, acceleration_m_s2: Array, step_s: float, limits: Limits, pace: Pace) -> float:
    """Return how long a stop takes that is as quick as vehicles can fly it.

    Args:
        velocity_m_s: of the plan from the stop's beginning on, shape (T, V, 3).
        acceleration_m_s2: likewise.
        step_s: between two of these samples; there must be enough for the gentlest stop.
        limits: of every vehicle.
        pace: the present one; where it is at its beginning counts.
    """
    return float(
        stopping(
            velocity_m_s,
            acceleration_m_s2,
            0.0,
            step_s,
            limits.acceleration_m_s2,
            limits.jerk_m_s3,
            pace.before,
            pace.slope,
        )
    )


@kernel
def stopping(
    velocity: Array,
    acceleration: Array,
    start: float,
    step: float,
    most: float,
    jerk: float,
    before: float,
    slope: float,
) -> float:
    """How long a stop from a plan's time on lasts: the first tried that keeps acceleration and jerk, or the gentlest.

    Args:
        velocity: of the plan, shape (T, V, 3) [m/s].
        acceleration: likewise [m/s^2].
        start: the plan's time when it begins, 0 at the first sample [s].
        step: between two samples [s].
        most: acceleration limit [m/s^2].
        jerk: its limit, may be infinite [m/s^3].
        before: rate of the plan's time when it begins.
        slope: its derivative then [1/s].
    """
    last, vehicles = len(velocity) - 1, velocity.shape[1]
    speed2 = 0.0
    for i in range(min(int(start / step), last), min(int((start + AHEAD_S) / step) + 1, last) + 1):
        for v in range(vehicles):
            speed2 = max(speed2, velocity[i, v, 0] ** 2 + velocity[i, v, 1] ** 2 + velocity[i, v, 2] ** 2)
    unit = max(before, 0.5) * math.sqrt(speed2) / most
    lasts = SHORTEST_S
    felt = np.zeros((vehicles, 3))
    for share in range(SHARES):
        lasts = max(SHORTEST_S, (QUICKEST + (GENTLEST - QUICKEST) * share / (SHARES - 1)) * unit)
        good = True
        for look in range(LOOKS):
            time, rate, change = changing(lasts * look / LOOKS, start, before, slope, 0.0, lasts)
            i = min(int(time / step + 0.5), last)
            for v in range(vehicles):
                size2, turn2 = 0.0, 0.0
                for k in range(3):
                    a = acceleration[i, v, k] * rate * rate + velocity[i, v, k] * change
                    size2 += a * a
                    turn2 += (a - felt[v, k]) ** 2
                    felt[v, k] = a
                good = good and size2 <= (BEYOND * most) ** 2
                if look > 0:
                    good = good and turn2 <= (BEYOND * jerk * lasts / LOOKS) ** 2
            if not good:
                break
        if good:
            break
    return lasts
