from __future__ import annotations

import math

import numpy as np
import pytest

from fg_gcs.core.separation import Fence
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.rules import ROUNDING, Peaks, broken, exceeded, limit_shares, outside, peaks_of, too_close

LIMITS = Limits(10.0, 5.0, climb_m_s=3.0, descent_m_s=2.0, jerk_m_s3=40.0)
RULES = Rules(LIMITS, 1.5, Fence((-50.0, -50.0, 3.0), (50.0, 50.0, 60.0)))
AT_LIMIT = Peaks(10.0, 5.0, 40.0, 3.0, 2.0)


def test_each_limit_bounds_the_peak_of_its_name() -> None:
    assert limit_shares(AT_LIMIT, LIMITS) == dict.fromkeys(Peaks._fields, 1.0)
    for name in Peaks._fields:
        assert exceeded(AT_LIMIT._replace(**{name: 1.001 * getattr(AT_LIMIT, name)}), LIMITS) == (name,)
    assert exceeded(AT_LIMIT._replace(speed_m_s=math.nan), LIMITS) == ("speed_m_s",)


def test_rounding_breaks_no_rule_and_what_is_more_than_rounding_does() -> None:
    less, more = 0.5 * ROUNDING, 2.0 * ROUNDING
    assert not exceeded(Peaks(*(value * (1.0 + less) for value in AT_LIMIT)), LIMITS)
    assert len(exceeded(Peaks(*(value * (1.0 + more) for value in AT_LIMIT)), LIMITS)) == len(AT_LIMIT)
    assert not outside(less)
    assert outside(more)
    assert outside(math.nan)
    assert not too_close(1.5 * (1.0 - less), 1.5)
    assert too_close(1.5 * (1.0 - more), 1.5)
    assert too_close(math.nan, 1.5)


def test_broken_rules_are_named_limits_first() -> None:
    assert broken(AT_LIMIT, 0.0, 1.5, RULES) == ()
    assert broken(AT_LIMIT._replace(jerk_m_s3=41.0), 0.1, 1.4, RULES) == ("jerk", "separation", "fence")
    twice = Peaks(*(2.0 * value for value in AT_LIMIT))
    assert broken(twice, 0.0, 1.5, RULES) == ("speed", "acceleration", "jerk", "climb", "descent")


def test_peaks_are_those_of_the_vehicle_and_the_instant_where_they_are_largest() -> None:
    time_s = np.array([0.0, 0.5, 0.5 + 1e-6, 1.0])  # two instants that are one: a step between them is no jerk
    velocity, acceleration = np.zeros((2, 4, 2, 3))
    velocity[1, 0] = (3.0, 4.0, -12.0)
    velocity[2, 1] = (0.0, 0.0, 2.0)
    acceleration[2:, 1] = (0.0, 1.0, 0.0)
    acceleration[3, 1] = (2.0, 1.0, 0.0)
    peaks = peaks_of(velocity, acceleration, time_s)
    assert peaks == pytest.approx(Peaks(13.0, math.sqrt(5.0), 2.0 / (0.5 - 1e-6), 2.0, 12.0))
