import random
import time
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire import commands
from fg_gcs.wire.codec import Codec, Frame
from fg_gcs.wire.framing import Sender, as_sent, laid_out, same_for_all
from fg_gcs.wire.setpoint import NUMBERS, SetpointRound
from fg_gcs.wire.signing import (
    NEW_STREAM_UNITS,
    REORDERED,
    SETUP_SIGNING,
    UNITS_PER_S,
    Refusal,
    Signing,
    Stamps,
    Stream,
    stamp_of,
)
from fg_gcs.wire.timing import timesync

KEY, OTHER_KEY = bytes(range(32)), bytes(range(1, 33))
NOW = stamp_of(1_700_000_000.0)


def signing(key: bytes = KEY, start: int = NOW, *, sets_up: bool = False) -> Signing:
    return Signing(key, Stamps(lambda: 0.0, start), sets_up=sets_up)


def pymavlinks(key: bytes, link_id: int, stamp: int, system_id: int = 255, component_id: int = 190) -> dialect.MAVLink:
    mav = dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
    mav.signing.secret_key, mav.signing.link_id, mav.signing.timestamp = key, link_id, stamp
    mav.signing.sign_outgoing = True
    return mav


def frames_of(data: bytes) -> list[Frame]:
    return Codec().receive(data)


def vehicle_frames(count: int, key: bytes = KEY, start: int = NOW, system_id: int = 1) -> list[Frame]:
    """What a vehicle says, frame by frame, each with a later stamp."""
    sender = Sender(system_id, 1, signing(key, start).signature(7))
    position = laid_out(dialect.MAVLink_local_position_ned_message(1, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0))
    return [frame for _ in range(count) for frame in frames_of(sender.finish(*position))]


def test_frames_are_signed_byte_for_byte_as_pymavlink_signs_them() -> None:
    ours = Sender(signature=signing().signature(9))
    theirs = pymavlinks(KEY, 9, NOW + 1)
    for count, message in enumerate([commands.heartbeat(), timesync(2**40)] * 3):
        theirs.seq = count
        assert ours.pack(message) == bytes(message.pack(theirs))


@given(signed=st.lists(st.booleans(), min_size=1, max_size=12))
def test_a_round_is_signed_as_its_frames_are_one_by_one(signed: list[bool]) -> None:
    numbers = np.random.default_rng(1).normal(size=(len(signed), NUMBERS))

    def senders() -> list[Sender]:
        ours = signing()  # one clock for all links
        return [Sender(signature=ours.signature(link) if signs else None) for link, signs in enumerate(signed)]

    together = SetpointRound(range(1, len(signed) + 1), senders()).pack(numbers)
    alone = senders()
    for row, (sender, signs) in enumerate(zip(alone, signed, strict=True)):
        sent = together[row : row + 1]
        data = (sent if signs or not any(signed) else as_sent(sent)).tobytes()
        (frame,) = frames_of(data)
        assert data == sender.finish(data[7:10], _crc_extra(frame), frame.payload)


def _crc_extra(frame: Frame) -> bytes:
    return bytes([dialect.mavlink_map[frame.message_id].crc_extra])


def test_heartbeats_to_many_links_are_signed() -> None:
    ours, judge = signing(), signing()
    senders = [Sender(signature=ours.signature(link)) for link in range(40)]
    for row in same_for_all(laid_out(commands.heartbeat()), senders):
        (frame,) = frames_of(row.tobytes())
        assert judge.refusal(frame) is None
    assert judge.counts == dict.fromkeys(Refusal, 0)


def test_pymavlink_takes_what_we_sign_and_refuses_it_a_second_time() -> None:
    sender, mav = Sender(signature=signing().signature(3)), pymavlinks(KEY, 0, NOW, 1, 1)
    for _ in range(20):
        data = sender.pack(commands.heartbeat())
        (message,) = mav.parse_buffer(data)
        assert message.get_signed()
        with pytest.raises(dialect.MAVError, match="signature"):
            mav.parse_buffer(data)


def test_what_pymavlink_signs_is_taken_once() -> None:
    judge, mav = signing(), pymavlinks(KEY, 2, NOW, 1, 1)
    for _ in range(20):
        (frame,) = frames_of(bytes(commands.heartbeat().pack(mav)))
        assert judge.refusal(frame) is None
        assert judge.refusal(frame) is Refusal.REPLAYED
    assert judge.counts == {Refusal.UNSIGNED: 0, Refusal.FORGED: 0, Refusal.REPLAYED: 20}


def attacks() -> Iterator[Frame]:
    """100,000 frames of somebody without the key who has heard everything."""
    heard = vehicle_frames(400)
    unsigned = Sender(1, 1)
    forged = vehicle_frames(400, OTHER_KEY, NOW + 10 * UNITS_PER_S)
    draw = random.Random(4)
    for _ in range(100_000):
        match draw.randrange(4):
            case 0:
                yield draw.choice(heard)
            case 1:
                (frame,) = frames_of(unsigned.pack(commands.heartbeat()))
                yield frame
            case 2:
                yield draw.choice(forged)
            case _:  # a good frame with one bit of stamp, link id or signature turned
                frame = draw.choice(heard)
                raw = bytearray(frame.raw)
                raw[-draw.randrange(1, 14)] ^= 1 << draw.randrange(8)
                yield frame._replace(raw=bytes(raw))


def test_none_of_100000_replayed_unsigned_and_forged_frames_is_taken() -> None:
    judge = signing()
    assert all(judge.refusal(frame) is None for frame in vehicle_frames(400))
    assert all(judge.refusal(frame) is not None for frame in attacks())
    assert sum(judge.counts.values()) == 100_000
    assert min(judge.counts.values()) > 10_000


@given(st.integers(0, 2**32), st.integers(1, REORDERED))
def test_each_frame_is_taken_once_however_the_link_reorders_and_doubles_it(seed: int, reach: int) -> None:
    draw = random.Random(seed)
    stream, taken = Stream(NOW - 1), list[int]()
    sent = [NOW + 3 * index for index in range(600)]
    # Each is late by less than `reach` places
    arrivals = sorted((index + draw.random() * (reach - 1), stamp) for index, stamp in enumerate(sent))
    for _, stamp in arrivals:
        taken += [stamp] * stream.add(stamp)
        assert not stream.add(stamp)
    assert sorted(taken) == sent


def test_nothing_is_taken_that_is_a_minute_behind_its_stream() -> None:
    stream = Stream(NOW)
    assert stream.add(NOW + NEW_STREAM_UNITS + 2)
    assert not stream.add(NOW + 2)
    assert stream.add(NOW + 3)


@given(st.lists(st.integers(0, 5000), max_size=3000))
def test_a_stream_takes_no_stamp_twice(steps: list[int]) -> None:
    stream, taken = Stream(-1), set[int]()
    for stamp in steps:
        if stream.add(stamp):
            assert stamp not in taken
            taken.add(stamp)


@pytest.mark.parametrize(("behind_s", "refusal"), [(-3600.0, None), (59.0, None), (61.0, Refusal.REPLAYED)])
def test_a_new_sender_is_at_most_a_minute_behind(behind_s: float, refusal: Refusal | None) -> None:
    (frame,) = vehicle_frames(1, start=NOW - int(behind_s * UNITS_PER_S))
    assert signing().refusal(frame) is refusal


def test_our_clock_follows_one_that_is_ahead() -> None:
    """Ours was set back an hour: vehicles take our frames all the same."""
    ours, hour = signing(start=NOW - 3600 * UNITS_PER_S), 3600 * UNITS_PER_S
    (frame,) = vehicle_frames(1)
    assert ours.refusal(frame) is None
    (answer,) = frames_of(Sender(signature=ours.signature(0)).pack(commands.heartbeat()))
    assert signing(start=NOW).refusal(answer) is None
    assert int.from_bytes(answer.raw[-12:-6], "little") > NOW > NOW - hour


@given(st.lists(st.one_of(st.floats(0.0, 10.0), st.integers(0, 2**48 - 1)), max_size=60))
def test_stamps_never_run_back_and_none_is_used_twice(steps: list[float | int]) -> None:
    now_s = 0.0
    stamps, before = Stamps(lambda: now_s, NOW), NOW
    for step in steps:
        if isinstance(step, int):
            stamps.hear(step)
        else:
            now_s += step
        stamp = stamps.take()
        assert before < stamp < 2**48
        before = stamp


def test_a_clock_that_is_broken_does_not_lead_ours_to_the_end_of_time() -> None:
    for start in (2**48 - 1, 10**15 - 1):
        stamps = Stamps(lambda: 0.0, start)
        stamps.hear(2**48 - 1)
        assert len(Signing(KEY, stamps).signature(0).of(b"frame")) == 13


def test_what_flies_with_an_autopilot_does_not_sign_for_it() -> None:
    judge = signing(sets_up=True)
    (frame,) = frames_of(Sender(1, 191, signing().signature(0)).pack(commands.heartbeat()))
    assert judge.refusal(frame) is None
    assert judge.signed == set()


def test_a_radio_is_heard_though_it_has_no_key_but_not_as_a_vehicle() -> None:
    status = dialect.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7)
    for system_id, component_id, refusal in ((51, 68, None), (1, 1, Refusal.UNSIGNED)):
        (frame,) = frames_of(Sender(system_id, component_id).pack(status))
        assert signing().refusal(frame) is refusal


def test_while_vehicles_get_their_key_those_that_have_not_signed_yet_are_heard() -> None:
    judge = signing(sets_up=True)
    (plain,) = frames_of(Sender(1, 1).pack(commands.heartbeat()))
    assert judge.refusal(plain) is None
    assert judge.refusal(vehicle_frames(1)[0]) is None
    assert judge.signed == {1}
    assert judge.refusal(plain) is Refusal.UNSIGNED
    (other,) = frames_of(Sender(2, 1).pack(commands.heartbeat()))
    assert judge.refusal(other) is None
    judge.rely()
    assert judge.refusal(other) is Refusal.UNSIGNED


def test_the_message_that_gives_a_key_holds_it() -> None:
    message = signing().set_up(7)
    assert (message.get_msgId(), message.target_system, bytes(message.secret_key)) == (SETUP_SIGNING, 7, KEY)
    assert message.initial_timestamp == NOW


def test_stamps_count_from_2015() -> None:
    assert stamp_of(time.mktime((1990, 1, 1, 0, 0, 0, 0, 0, 0))) == 0
    assert stamp_of(1_420_070_401.0) == UNITS_PER_S
