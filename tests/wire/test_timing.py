"""Links made up by their loss, delay and jitter, and what is measured of them."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fg_gcs.wire.sequence import STEP_S, SequenceCounter
from fg_gcs.wire.timing import CONSISTENT, MOST_LATE_S, PACE_S, BootClock, LinkQuality, LinkTiming


class Link(NamedTuple):
    """One direction of a link."""

    loss: float = 0.0
    delay_s: float = 0.15
    jitter_s: float = 0.0  # up or down
    doubled: float = 0.0

    def arrivals(self, draw: random.Random, sent_s: float) -> list[float]:
        """Return when what is sent arrives: never, once or twice."""
        copies = (draw.random() >= self.loss) * (1 + (draw.random() < self.doubled))
        return [sent_s + self.delay_s + draw.uniform(-self.jitter_s, self.jitter_s) for _ in range(copies)]


PERFECT = Link()
BAD = Link(0.3, 0.15, 0.05, 0.1)


class Arrival(NamedTuple):
    at_s: float
    sequence: int
    tail: bytes
    sent_s: float


def stream(
    draw: random.Random, rate_hz: float, link: Link, duration_s: float, first: int = 0, name: str = "a"
) -> list[Arrival]:
    """Return the frames of one sender, in the order of sending."""
    found = []
    for k in range(int(duration_s * rate_hz)):
        sent_s = k / rate_hz
        tail = f"{name}{k}".encode()
        found += [
            Arrival(at_s, (first + k) % 256, tail, sent_s) for at_s in link.arrivals(draw, sent_s + draw.random() / 1e4)
        ]
    return found


def count(arrivals: list[Arrival], counter: SequenceCounter) -> Iterator[SequenceCounter]:
    """Let frames be counted; yield twice a second."""
    due_s = STEP_S
    for arrival in sorted(arrivals):
        while arrival.at_s > due_s:
            counter.roll(due_s)
            due_s += STEP_S
            yield counter
        counter.add(arrival.sequence, arrival.tail, arrival.at_s)


RATES = st.sampled_from([10.0, 50.0, 120.0, 370.0])
LINKS = st.builds(
    Link,
    delay_s=st.just(0.15),
    loss=st.sampled_from([0.0, 0.02, 0.2, 0.3, 0.5]),
    jitter_s=st.sampled_from([0.0, 0.01, 0.05]),
    doubled=st.sampled_from([0.0, 0.1]),
)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), rate_hz=RATES, link=LINKS, first=st.integers(0, 255))
def test_loss_is_measured_and_one_sender_is_never_taken_for_two(
    seed: int, rate_hz: float, link: Link, first: int
) -> None:
    counter = SequenceCounter()
    arrivals = stream(random.Random(seed), rate_hz, link, 20.0, first)
    losses = []
    for now in count(arrivals, counter):
        assert not now.interleaved
        losses.append(now.loss)
    sigma = math.sqrt(link.loss * (1.0 - link.loss) / (5.0 * rate_hz))
    in_the_air = 2.0 * link.jitter_s / 5.0 + 1.0 / (5.0 * rate_hz)  # those that will come yet, late
    for loss in losses[12:]:
        assert loss == pytest.approx(link.loss, abs=5.0 * sigma + in_the_air + 0.01)


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    rate_hz=st.sampled_from([20.0, 50.0, 370.0]),
    link=st.sampled_from([Link(), Link(0.2, jitter_s=0.02), Link(0.0, jitter_s=0.02)]),
    apart=st.integers(0, 255),
)
def test_two_senders_under_one_id_are_noticed_whatever_their_numbers(
    seed: int, rate_hz: float, link: Link, apart: int
) -> None:
    draw, counter = random.Random(seed), SequenceCounter()
    both = stream(draw, rate_hz, link, 25.0) + stream(draw, rate_hz, link, 25.0, apart, "b")
    seen = [now.interleaved for now in count(both, counter)]
    assert any(seen[: int(12.0 / STEP_S)])
    assert sum(seen[-20:]) > 10


@pytest.mark.parametrize("silent_s", [0.3, 2.0, 6.0])
@pytest.mark.parametrize("rate_hz", [25.0, 370.0])
def test_a_silence_counts_as_loss_and_is_no_second_sender(silent_s: float, rate_hz: float) -> None:
    counter = SequenceCounter()
    whole = stream(random.Random(3), rate_hz, Link(jitter_s=0.05), 30.0)
    arrivals = [arrival for arrival in whole if not 10.0 <= arrival.sent_s < 10.0 + silent_s]
    worst = 0.0
    for now in count(arrivals, counter):
        assert not now.interleaved
        worst = max(worst, 0.0 if math.isnan(now.loss) else now.loss)
    assert worst == pytest.approx(min(silent_s / 5.0, 1.0), abs=0.2)


@pytest.mark.parametrize("last", range(0, 256, 17))
def test_a_restart_of_the_numbers_is_no_second_sender(last: int) -> None:
    counter = SequenceCounter()
    before = stream(random.Random(1), 50.0, PERFECT, 10.0, last)
    again = [
        arrival._replace(at_s=arrival.at_s + 11.0) for arrival in stream(random.Random(2), 50.0, PERFECT, 10.0, 0, "b")
    ]
    assert sum(now.interleaved for now in count(before + again, counter)) == 0


def exchange(
    draw: random.Random, out: Link, back: Link, booted_s: float, duration_s: float, *, answers: bool = True
) -> LinkTiming:
    """Let a vehicle send 25 samples and us two requests a second; return what we measure."""
    timing, events = LinkTiming(), list[tuple[float, int, float, float]]()
    for k in range(int(25 * duration_s)):
        sent_s = k / 25.0
        events += [(at_s, 1, sent_s, k) for at_s in back.arrivals(draw, sent_s)]
    for k in range(int(2 * duration_s)):
        sent_s = 0.5 * k
        events.append((sent_s, 0, sent_s, 0))
        for there_s in out.arrivals(draw, sent_s) if answers else ():
            events += [(at_s, 2, sent_s, there_s) for at_s in back.arrivals(draw, there_s)]
    for at_s, kind, sent_s, extra in sorted(events):
        if at_s > duration_s:
            break
        if kind == 0:
            timing.roll(at_s)
            timing.asked(round(sent_s * 1e9), at_s)
        elif kind == 1:
            timing.sequence.add(int(extra) % 256, b"%d" % int(extra), at_s)
            timing.clock.stamped(sent_s - booted_s, at_s)
        else:
            timing.answered(round((extra - booted_s) * 1e9), round(sent_s * 1e9), at_s)
    return timing


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), booted_s=st.floats(-1e5, -1.0))
def test_a_symmetric_link_is_measured_through_its_jitter(seed: int, booted_s: float) -> None:
    quality = exchange(random.Random(seed), BAD, BAD, booted_s, 30.0).quality
    assert quality.offset_s == pytest.approx(booted_s, abs=0.04)
    assert quality.delay_s == pytest.approx(0.15, abs=0.03)
    assert quality.jitter_s == pytest.approx(0.033, abs=0.025)
    assert quality.loss_in == pytest.approx(0.3, abs=0.2)
    assert quality.loss_out == pytest.approx(0.3, abs=0.45)
    assert quality.unfit() is None


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), jitter_s=st.floats(0.0, 0.1))
def test_jitter_of_one_direction_does_not_move_the_offset(seed: int, jitter_s: float) -> None:
    still, shaking = Link(0.0, 0.05), Link(0.0, 0.05 + jitter_s, jitter_s)  # the least delay is 50 ms both ways
    for out, back in ((still, shaking), (shaking, still)):
        timing = exchange(random.Random(seed), out, back, -7.0, 60.0)
        assert timing.quality.offset_s == pytest.approx(-7.0, abs=0.015)


def test_without_answers_the_least_delay_stands_for_none() -> None:
    quality = exchange(random.Random(1), BAD, Link(0.2, 0.15, 0.05), -7.0, 30.0, answers=False).quality
    assert quality.offset_s == pytest.approx(-7.0 + 0.1, abs=0.02)
    assert math.isnan(quality.delay_s)
    assert math.isnan(quality.loss_out)
    assert quality.unfit() is None


def test_a_link_that_falls_behind_does_not_move_the_offset() -> None:
    timing = exchange(random.Random(1), Link(), Link(), -7.0, 20.0)
    for k in range(1000):
        sent_s = 20.0 + k / 25.0
        assert timing.clock.stamped(sent_s + 7.0, sent_s + 3.0) == pytest.approx(-7.0, abs=1e-6)
        timing.asked(k + 1, sent_s)
        timing.answered(round((sent_s + 0.15 + 7.0) * 1e9), k + 1, sent_s + 3.0)


def test_timesync_of_another_clock_still_tells_the_delay() -> None:
    timing = LinkTiming()
    for k in range(50):
        sent_s = k / 10.0
        timing.asked(k + 1, sent_s)
        timing.clock.stamped(100.0 + sent_s, sent_s + 0.1)
        timing.answered(round((1.7e9 + sent_s + 0.1) * 1e9), k + 1, sent_s + 0.2)
    assert timing.quality.offset_s == pytest.approx(-100.0, abs=1e-3)
    assert timing.quality.delay_s == pytest.approx(0.1)


def test_answers_to_others_and_doubled_ones_say_nothing() -> None:
    timing = LinkTiming()
    timing.answered(1, 2, 0.0)
    timing.asked(5, 0.0)
    timing.answered(10**9, 5, 0.2)
    timing.answered(10**18, 5, 0.3)
    assert timing.quality.requests == 1
    assert timing.quality.delay_s == pytest.approx(0.1)


@given(order=st.lists(st.integers(1, 40), min_size=1, max_size=60))
def test_an_older_sample_never_replaces_a_newer_one(order: list[int]) -> None:
    clock, newest = BootClock(), 0
    for k, number in enumerate(order):
        taken = clock.stamped(1000.0 + number / 25.0, 2.0 + k / 100.0)
        assert (taken is not None) == (number >= newest)
        newest = max(newest, number)


@given(before_s=st.floats(MOST_LATE_S + 5.0, 1e6), after_s=st.floats(0.0, 100.0))
def test_a_restart_is_believed_after_a_few_samples_that_agree(before_s: float, after_s: float) -> None:
    clock = BootClock()
    for k in range(20):
        assert clock.stamped(before_s + k / 25.0, k / 25.0) is not None
    after_s = min(after_s, before_s - MOST_LATE_S - 1.0)
    taken = [clock.stamped(after_s + k / 25.0, 3.0 + k / 25.0) is not None for k in range(10)]
    assert taken == [False] * (CONSISTENT - 1) + [True] * (11 - CONSISTENT)
    assert clock.offset_s == pytest.approx(3.0 - after_s, abs=1e-3)


@given(by_s=st.one_of(st.floats(-1e4, -MOST_LATE_S - 2.0), st.floats(0.1, 1e4)))
def test_a_clock_that_jumps_is_followed_within_two_seconds(by_s: float) -> None:
    clock = BootClock()
    for k in range(100):
        clock.stamped(2e4 + k / 25.0, k / 25.0)
    taken = [clock.stamped(2e4 + by_s + k / 25.0, k / 25.0) is not None for k in range(100, 150)]
    assert all(taken[-1:])
    assert clock.offset_s == pytest.approx(-2e4 - by_s, abs=1e-3)


def test_a_link_that_was_stuck_and_empties_itself_is_no_clock_that_jumped() -> None:
    clock = BootClock()
    for k in range(250):
        clock.stamped(1000.0 + k / 25.0, k / 25.0)
    old = [clock.stamped(1000.0 + k / 25.0, 10.0 + k / 1e4) is not None for k in range(100)]
    assert not any(old)
    assert clock.offset_s == pytest.approx(-1000.0, abs=1e-3)


def test_one_stale_or_mad_stamp_changes_nothing() -> None:
    clock = BootClock()
    for k in range(200):
        assert clock.stamped(500.0 + k / 25.0, k / 25.0) is not None
        for mad in (0.5, 1e6 + k, 499.0, 4294967.0):
            assert clock.stamped(mad, k / 25.0) is None
    assert clock.offset_s == pytest.approx(-500.0, abs=1e-6)


def test_two_clocks_under_one_id_are_noticed() -> None:
    timing = LinkTiming()
    for k in range(100):
        timing.clock.stamped(500.0 + k / 25.0, k / 25.0)
        timing.clock.stamped(20.0 + k / 25.0, k / 25.0 + 0.01)
        if k % 12 == 0:
            timing.roll(k / 25.0)
    assert timing.doubled == "their times since boot differ"
    assert timing.clock.offset_s == pytest.approx(-500.0, abs=1e-6)


@pytest.mark.parametrize(
    ("quality", "reason"),
    [
        (LinkQuality(0.0, 0.0, 0.0, 0.0, 0.0, 32), None),
        (LinkQuality(math.nan, math.nan, math.nan, math.nan, math.nan), None),
        (LinkQuality(0.3, 0.3, 0.15, 0.034, 0.0, 32), None),
        (LinkQuality(0.3, 0.6, 0.15, 0.034, 0.0, 4), None),  # four requests prove nothing
        (LinkQuality(0.6, 0.3, 0.1, 0.0, 0.0, 32), "60 % of its frames are lost (most 50 %)"),
        (LinkQuality(0.0, 0.8, 0.1, 0.0, 0.0, 32), "80 % of ours are lost on the way to it (most 50 %)"),
        (LinkQuality(0.0, 0.0, 1.5, 0.0, 0.0, 32), "the delay of one way is 1.50 s (most 1 s)"),
    ],
)
def test_a_link_is_judged_by_its_figures(quality: LinkQuality, reason: str | None) -> None:
    assert quality.unfit() == reason


def test_a_vehicle_is_asked_the_more_often_in_vain_before_it_counts_as_deaf_the_more_its_link_loses() -> None:
    def misses(each_way: float) -> float:
        return LinkQuality(each_way, each_way, 0.0, 0.0, 0.0, 64).misses

    assert misses(0.0) == 0.0
    assert misses(0.2) == pytest.approx(11.3, abs=0.1)
    assert misses(0.05) < misses(0.1) < misses(0.2) < misses(0.3) < misses(0.9)
    assert math.isfinite(misses(1.0))
    assert LinkQuality(math.nan, math.nan, 0.0, 0.0, 0.0).misses == 0.0


@given(rate=st.floats(0.3, 2.0), jitter_s=st.floats(0.0, 0.05), loss=st.floats(0.0, 0.5), seed=st.integers(0, 99))
def test_pace_is_that_of_the_vehicles_clock_whatever_the_link(
    rate: float, jitter_s: float, loss: float, seed: int
) -> None:
    """Each way takes up to the jitter longer; the answer's middle is off by half of that at most."""
    draw, timing, spans_s = random.Random(seed), LinkTiming(), []
    for k in range(60):
        asked_s = 0.5 * k
        timing.asked(k, asked_s)
        there_s = asked_s + 0.01 + draw.uniform(0.0, jitter_s)
        if draw.random() >= loss:
            timing.answered(round(1e9 * rate * (there_s + 100.0)), k, there_s + 0.01 + draw.uniform(0.0, jitter_s))
            spans_s.append(asked_s)
        pace = timing.pace()
        if math.isfinite(pace):
            span_s = min(spans_s[-1] - spans_s[0], 15.5)
            assert abs(pace - rate) <= 2.0 * rate * jitter_s / max(span_s - jitter_s, PACE_S - jitter_s) + 1e-6
        else:
            assert spans_s == [] or spans_s[-1] - spans_s[0] < PACE_S + jitter_s
    assert math.isnan(timing.pace(asked_s - 1.0)), "nothing that was answered earlier counts"


def test_a_vehicle_that_starts_again_has_a_pace_of_its_own() -> None:
    timing = LinkTiming()
    for k in range(20):
        timing.asked(k, 0.5 * k)
        timing.answered(round(1e9 * (0.5 * k if k < 10 else 0.4 * (k - 9))), k, 0.5 * k)
    assert timing.pace() == pytest.approx(0.8)
