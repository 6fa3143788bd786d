import inspect
import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire import commands
from fg_gcs.wire.codec import Codec, Message
from fg_gcs.wire.framing import Sender, laid_out, same_for_all
from fg_gcs.wire.setpoint import NUMBERS, SetpointRound


def number(draw: random.Random, kind: str) -> int | float:
    """A number that fits into a field; zeros on purpose: MAVLink 2 cuts trailing zeros off a payload."""
    if kind in ("float", "double"):
        return draw.choice((0.0, draw.uniform(-1e3, 1e3)))
    bits = int("".join(filter(str.isdigit, kind)) or 8)
    return draw.choice((0, draw.randrange(2 ** (bits - 1))))


def random_message(draw: random.Random, kind: Any) -> Message:  # noqa: ANN401 - any of pymavlink's classes
    fields: dict[str, object] = {}
    lengths = dict(zip(kind.ordered_fieldnames, zip(kind.lengths, kind.array_lengths, strict=True), strict=True))
    for name, of in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        _, array_length = lengths[name]
        if of == "char" and array_length:
            fields[name] = bytes(draw.choices(b"abc\0", k=draw.randrange(array_length + 1)))
        elif array_length:
            fields[name] = [number(draw, of) for _ in range(array_length)]
        else:
            fields[name] = number(draw, of)
    accepted = inspect.signature(kind).parameters
    message: Message = kind(**{name: value for name, value in fields.items() if name in accepted})
    return message


KINDS = [kind for identity, kind in sorted(dialect.mavlink_map.items()) if identity < 500]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.msgname)
def test_every_message_is_framed_as_pymavlink_frames_it(kind: Any) -> None:  # noqa: ANN401
    draw = random.Random(kind.id)
    ours, theirs = Sender(255, 190), dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    for count in range(5):
        message = random_message(draw, kind)
        theirs.seq = count
        expected = bytes(message.pack(theirs))
        assert ours.pack(message) == expected


def test_sequence_numbers_go_around_whoever_asks_for_the_frame() -> None:
    sender = Sender()
    frames = []
    for _ in range(200):
        frames += [sender.pack(commands.heartbeat()), sender.finish(bytes(3), b"\x32", b"\x01")]
    assert [frame[4] for frame in frames] == [count % 256 for count in range(400)]


def test_a_field_that_cannot_hold_its_number_uses_no_sequence_number() -> None:
    sender = Sender()
    message: Message = dialect.MAVLink_heartbeat_message(6, 8, 0, 2**40, 4, 3)
    with pytest.raises(Exception, match="format"):
        sender.pack(message)
    assert sender.pack(commands.heartbeat())[4] == 0


def test_what_is_finished_is_read() -> None:
    (message,) = Codec().receive(Sender(3, 1).pack(commands.heartbeat()))
    assert (message.get_type(), message.get_srcSystem(), message.get_srcComponent()) == ("HEARTBEAT", 3, 1)


@given(st.lists(st.lists(st.integers(0, 5), min_size=1, max_size=6), min_size=1, max_size=40))
def test_every_link_numbers_its_frames_one_by_one_whoever_sends_together(rounds: list[list[int]]) -> None:
    senders = [Sender() for _ in range(6)]
    heartbeat = laid_out(commands.heartbeat())
    together = SetpointRound(range(1, 7), senders)
    sent: list[list[int]] = [[] for _ in senders]
    for links in rounds:
        for link, frame in zip(links, same_for_all(heartbeat, [senders[link] for link in links]), strict=True):
            (heard,) = Codec().receive(bytes(frame))
            assert (heard.get_type(), heard.get_srcSystem()) == ("HEARTBEAT", 255)
            sent[link].append(heard.get_seq())
        sent[links[0]].append(senders[links[0]].pack(commands.heartbeat())[4])
        for link, frame in enumerate(together.pack(np.zeros((6, NUMBERS)))):
            sent[link].append(frame[4])
    assert all(numbers == [count % 256 for count in range(len(numbers))] for numbers in sent)
