"""Frames are told apart by their sequence numbers: late, twice, from the past, or of a sender that started again."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.codec import Codec, Frame
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.order import BEHIND, FrameOrder

PERIOD_S = 1.0 / 60.0  # of frames of one vehicle in flight


def frames(count: int, first: int = 0) -> list[Frame]:
    """Return the frames that a vehicle sends one after the other; no two are alike."""
    sender, codec = Sender(1, 1), Codec()
    packed = [sender.pack(dialect.MAVLink_system_time_message(first + number, 0)) for number in range(count)]
    return [frame for data in packed for frame in codec.receive(data)]


def heard(arrivals: list[tuple[float, Frame]]) -> list[tuple[int, Frame]]:
    """Return what is believed of frames that arrive at some times, in the order in which it is."""
    order, placed = FrameOrder(), list[tuple[int, Frame]]()
    for at_s, frame in sorted(arrivals, key=lambda one: one[0]):
        index = order.place(frame, at_s)
        placed += [(index, frame)] if index >= 0 else [(of_held, held) for held, of_held in order.released()]
    return placed


def are_in_order(placed: list[tuple[int, Frame]]) -> bool:
    """Tell whether indices grow as the frames were sent, and each came once."""
    by_index = [frame.fields().time_unix_usec for _, frame in sorted(placed, key=lambda one: one[0])]
    return by_index == sorted(set(by_index))


@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.1, 0.3]), st.sampled_from([0.0, 0.1]), st.floats(0.0, 0.5))
def test_loss_jitter_and_doubles_change_no_order_and_lose_nothing(
    seed: int, loss: float, jitter_s: float, double: float
) -> None:
    draw = random.Random(seed)
    arrivals: list[tuple[float, Frame]] = []
    for number, frame in enumerate(frames(600)):
        if number and draw.random() < loss:  # the first one says where they begin
            continue
        for _ in range(1 + (draw.random() < double)):
            arrivals.append((number * PERIOD_S + draw.random() * jitter_s * (number > 0), frame))
    arrivals.sort(key=lambda one: one[0])
    placed = heard(arrivals)
    assert are_in_order(placed)
    assert {frame for _, frame in placed} == {frame for _, frame in arrivals}


@pytest.mark.parametrize("late_s", [0.05, 0.3, 1.0, 3.0])
@given(number=st.integers(0, 300), loss=st.sampled_from([0.0, 0.2]), seed=st.integers(0, 2**32))
def test_a_frame_that_comes_late_a_second_time_is_dropped(late_s: float, number: int, loss: float, seed: int) -> None:
    draw = random.Random(seed)
    sent = frames(600)
    arrivals = [(k * PERIOD_S, frame) for k, frame in enumerate(sent) if k in (0, number) or draw.random() >= loss]
    again = (number * PERIOD_S + late_s + 1e-3, sent[number])
    assert heard([*arrivals, again]) == heard(arrivals)


@given(st.integers(1, 2000), st.integers(1, 300))
def test_a_burst_of_losses_of_any_length_is_survived(lost: int, before: int) -> None:
    sent = frames(before + lost + 60)
    arrivals = [(k * PERIOD_S, frame) for k, frame in enumerate(sent) if not before <= k < before + lost]
    placed = heard(arrivals)
    assert are_in_order(placed)
    assert [frame for _, frame in placed][-30:] == sent[-30:]


@given(st.integers(1, 600), st.floats(0.6, 30.0), st.integers(0, 255))
def test_a_sender_that_starts_again_is_heard_within_a_moment(before: int, away_s: float, first: int) -> None:
    old, new = frames(before), frames(first + 60, first=1000)[first:]
    back_s = before * PERIOD_S + away_s
    arrivals = [(k * PERIOD_S, frame) for k, frame in enumerate(old)]
    arrivals += [(back_s + k * PERIOD_S, frame) for k, frame in enumerate(new)]
    placed = heard(arrivals)
    assert are_in_order(placed)
    assert {frame for _, frame in placed} >= set(old) | set(new[-50:])


def test_a_slow_sender_that_starts_again_is_heard_with_its_second_heartbeat() -> None:
    old, new = frames(BEHIND), frames(3, first=1000)
    arrivals = [(float(k), frame) for k, frame in enumerate(old)]
    arrivals += [(100.0 + k, frame) for k, frame in enumerate(new)]
    placed = heard(arrivals)
    assert [frame for _, frame in placed] == old + new
    assert are_in_order(placed)


def test_several_stale_frames_of_one_datagram_confirm_nothing() -> None:
    sent = frames(400)
    arrivals = [(k * PERIOD_S, frame) for k, frame in enumerate(sent)]
    stale = [(300 * PERIOD_S + 1e-3, frame) for frame in sent[120:130]]
    assert heard(arrivals + stale) == heard(arrivals)
