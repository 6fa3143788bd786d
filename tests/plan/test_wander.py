"""How often vehicles that wander come too near: against wanders that are drawn, and what is done about it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.errors import PlanError
from fg_gcs.plan.flight_plan import compile_flight, least_wide
from fg_gcs.plan.wander import RISK, Part, Wander, least_pads, least_times, risk_of
from tests.plan.scenes import task as at_rest
from tests.plan.scenes import tops

SIGMA_M = np.array([0.3, 0.15, 0.2])
SEPARATION_M = 1.0


def pair_at(gap_m: tuple[float, float, float], seconds: float) -> Part:
    """Two vehicles that rest side by side."""
    places = np.array([[(0.0, 0.0, 10.0), np.add((0.0, 0.0, 10.0), gap_m)]])
    return Part("hold", places, np.zeros_like(places), np.array([seconds]))


def wander(count: int, times: float = 1.0) -> Wander:
    return Wander(np.tile(times * SIGMA_M, (count, 1)), hold_s=10.0)


@pytest.mark.parametrize("gap_m", [(2.4, 0.0, 0.0), (0.0, 1.7, 0.0), (1.2, 1.2, 0.8)])
def test_breaches_are_at_least_as_few_as_is_said(gap_m: tuple[float, float, float]) -> None:
    """Smooth wanders are drawn as often as it takes to see a hundred of those expected, and no more of them come."""
    seconds, step_s, slow_s = 20.0, 0.1, 1.0
    flights = 4000
    random = np.random.default_rng(3)
    count = round(seconds / step_s)
    noise = random.standard_normal((2, flights, count + 600, 3))
    kernel = np.exp(-0.5 * (np.arange(-300, 301) * step_s / slow_s) ** 2)  # correlated over sqrt(2) of its width
    kernel /= np.sqrt((kernel**2).sum())
    spectrum = np.fft.rfft(kernel, count + 600)
    drawn = np.fft.irfft(np.fft.rfft(noise, axis=2) * spectrum[None, None, :, None], count + 600, axis=2)
    moved = drawn[:, :, 600:] * SIGMA_M
    distances = np.linalg.norm(np.array(gap_m) + moved[1] - moved[0], axis=2)
    broken = (distances.min(axis=1) < SEPARATION_M).mean()
    said = risk_of([pair_at(gap_m, seconds)], wander(2), SEPARATION_M).breaches
    assert broken <= 1.1 * said  # what is drawn crosses its mean 1 / (2 pi sqrt(2)) times a second: 0.11
    assert said <= 6.0 * broken  # and the bound is no idle one: noise across a pair parts it, which is not counted


def test_what_all_do_alike_brings_nobody_nearer() -> None:
    part = pair_at((2.0, 0.0, 0.0), 10.0)
    along, across = np.array([[[5.0, 0.0, 0.0]] * 2]), np.array([[[0.0, 5.0, 0.0]] * 2])
    still = wander(2)._replace(lag_s=0.1)
    without = risk_of([part], still, SEPARATION_M).breaches
    assert risk_of([part._replace(velocity_m_s=across)], still, SEPARATION_M).breaches == pytest.approx(without)
    assert risk_of([part._replace(velocity_m_s=along)], still, SEPARATION_M).breaches > 2.0 * without


@given(st.floats(0.15, 7.5))
def test_the_least_size_is_the_one_from_which_on_the_risk_is_kept(least: float) -> None:
    found = least_times(lambda times: RISK * (least / times) ** 4)
    assert found is not None
    assert found == pytest.approx(least, rel=0.006)
    assert found >= least


def test_where_none_is_wide_enough_there_is_none() -> None:
    assert least_times(lambda times: 1.0) is None


def test_pads_as_far_apart_as_is_said_are_safe() -> None:
    places = tops(9)
    times = least_pads(places, wander(9, 4.0), SEPARATION_M)
    assert times > 1.0
    part = Part("pads", times * places[None], np.zeros((1, 9, 3)), np.array([30.0]))
    assert risk_of([part], wander(9, 4.0), SEPARATION_M).breaches <= 0.5 * RISK


def test_a_flight_that_is_too_narrow_is_refused_with_the_edge_that_would_do() -> None:
    task = replace(at_rest(), wander=wander(9, 1.2))
    above = 3.0 * tops(9) * (1.0, 1.0, 0.0) + (0.0, 0.0, 4.0)
    with pytest.raises(PlanError, match=r"the smallest edge that is safe is ([\d.]+) m") as refused:
        compile_flight(task, above, time.perf_counter)
    named_m = float(str(refused.value).split(" is safe is ")[1].split(" m")[0])
    least = least_wide(task, above)
    assert least is not None
    assert named_m == pytest.approx(least * task.edge_m, abs=0.05)
    made = compile_flight(replace(task, widens=True), above, time.perf_counter)
    assert made.task.edge_m == pytest.approx(named_m, abs=0.05)
    assert made.risk is not None
    assert made.risk.is_kept
    flown = compile_flight(task.times_as_wide(1.001 * least), above, time.perf_counter)
    assert flown.risk is not None
    with pytest.raises(PlanError):
        compile_flight(task.times_as_wide(0.98 * least), above, time.perf_counter)


def test_who_does_not_wander_flies_as_before() -> None:
    task = at_rest()
    plain = compile_flight(task, tops(9), time.perf_counter)
    still = compile_flight(replace(task, wander=wander(9, 0.0)), tops(9), time.perf_counter)
    assert plain.risk is None
    assert still.risk is not None
    assert still.risk.breaches == 0.0
    assert still.approach.duration_s == plain.approach.duration_s
