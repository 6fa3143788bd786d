import random
from collections.abc import Sequence
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.codec import FRAME_WORK, Codec, Message, is_known
from fg_gcs.wire.framing import Sender


def heartbeats(count: int, system_id: int = 7) -> list[bytes]:
    sender = Sender(system_id, 1)
    return [sender.pack(dialect.MAVLink_heartbeat_message(2, 12, 1, k, 3, 3)) for k in range(count)]


HEARTBEATS = heartbeats(32)


def modes(messages: Sequence[Message]) -> list[int]:
    return [message.custom_mode for message in messages]


def unknown_frame(identity: int = 410, payload: bytes = b"\x01\x02\x03") -> bytes:
    return bytes([0xFD, len(payload), 0, 0, 5, 1, 1]) + identity.to_bytes(3, "little") + payload + b"\xaa\xbb"


def test_what_a_sender_packs_a_codec_reads() -> None:
    frames = heartbeats(300)
    codec = Codec()
    messages = codec.receive(b"".join(frames))
    assert modes(messages) == list(range(300))
    assert [bytes(message.get_msgbuf()) for message in messages] == frames
    assert [message.get_seq() for message in messages] == [k % 256 for k in range(300)]
    assert {(message.get_srcSystem(), message.get_srcComponent()) for message in messages} == {(7, 1)}
    assert (codec.frames, codec.bad_bytes, codec.unknown_messages) == (300, 0, 0)


def test_mavlink_1_is_read_too() -> None:
    packer = dialect.MAVLink(None, 3, 1)
    frame = dialect.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3).pack(packer, force_mavlink1=True)
    assert frame[0] == 0xFE
    (message,) = Codec().receive(frame)
    assert (message.get_srcSystem(), message.custom_mode) == (3, 4)


def test_a_signed_frame_is_read_without_checking_the_signature() -> None:
    packer = dialect.MAVLink(None, 3, 1)
    packer.signing.secret_key, packer.signing.sign_outgoing = bytes(32), True
    frame = dialect.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3).pack(packer)
    codec = Codec()
    assert modes(codec.receive(frame + heartbeats(1)[0])) == [4, 0]
    assert codec.bad_bytes == 0


@given(cuts=st.lists(st.integers(0, 10 * 21), max_size=8))
def test_frames_may_be_cut_anywhere(cuts: list[int]) -> None:
    stream = b"".join(heartbeats(10))
    edges = [0, *sorted(cuts), len(stream)]
    codec = Codec()
    messages = [m for a, b in pairwise(edges) for m in codec.receive(stream[a:b])]
    assert modes(messages) == list(range(10))
    assert codec.bad_bytes == 0


@given(cut=st.integers(1, 20), noise=st.binary(max_size=30))
def test_after_a_restart_no_half_frame_waits_for_its_other_half(cut: int, noise: bytes) -> None:
    codec, (whole, halved) = Codec(), heartbeats(2)
    codec.receive(whole + noise + halved[:cut])
    codec.restart()
    assert codec.frames == 1
    assert codec.bad_bytes == len(noise) + cut
    assert modes(codec.receive(whole)) == [0]


def test_text_noise_around_frames_costs_no_frame() -> None:
    noise = b"\n\nInit ArduCopter V4.7.0-dev\n\nFree RAM: 131072\n"
    codec = Codec()
    messages = codec.receive(noise + noise.join(heartbeats(5)) + noise)
    assert modes(messages) == list(range(5))
    assert codec.bad_bytes == 6 * len(noise)


def test_false_starts_and_cut_frames_cost_no_frame_behind_them() -> None:
    frames = heartbeats(30)
    for cut in range(1, len(frames[0])):
        codec = Codec()
        messages = codec.receive(frames[0][:cut] + b"".join(frames[1:]) + bytes([0xFD, 0xFF, 0x00]))
        # The frame that follows a torn one may serve as its missing end, and is found again afterwards.
        assert modes(messages) == list(range(1, 30)), cut
        assert codec.bad_bytes >= cut


def test_unknown_messages_are_counted_and_kept_for_the_log() -> None:
    codec = Codec()
    first, second = heartbeats(2)
    messages = codec.receive(first + unknown_frame() + second)
    assert [message.get_type() for message in messages] == ["HEARTBEAT", "UNKNOWN_410", "HEARTBEAT"]
    assert [is_known(message) for message in messages] == [True, False, True]
    assert bytes(messages[1].get_msgbuf()) == unknown_frame()
    assert (codec.unknown_messages, codec.bad_bytes) == (1, 0)


def test_noise_that_looks_like_an_unknown_message_does_not_swallow_frames() -> None:
    codec = Codec()
    fake = bytes([0xFD, 30, 0, 0, 5, 1, 1, 0xFF, 0xFF, 0x01])  # claims thirty bytes which are really a frame
    frames = heartbeats(3)
    assert modes([m for m in codec.receive(fake + b"".join(frames)) if is_known(m)]) == [0, 1, 2]


def test_unknown_incompatibility_flags_are_dropped() -> None:
    body = bytearray(heartbeats(1)[0][1:-2])
    body[1] = 0x04
    checksum: int = dialect.x25crc(bytes(body) + bytes([dialect.MAVLink_heartbeat_message.crc_extra])).crc
    frame = b"\xfd" + bytes(body) + checksum.to_bytes(2, "little")
    codec = Codec()
    assert modes(codec.receive(frame + heartbeats(1)[0])) == [0]
    assert codec.bad_bytes == len(frame)


@given(
    flags=st.integers(2, 255),
    identity=st.integers(0, 0xFFFFFF),
    before=st.integers(0, 2),
    behind=st.integers(0, 2),
    datagrams=st.booleans(),
)
def test_flag_frame_a_frame_with_unknown_flags_is_dropped_whole(
    flags: int, identity: int, before: int, behind: int, datagrams: bool
) -> None:
    first, inner, last = heartbeats(before), heartbeats(1, system_id=99)[0], heartbeats(behind)
    outer = bytes([0xFD, len(inner), flags, 0, 0, 9, 1]) + identity.to_bytes(3, "little") + inner + b"\0\0"
    outer += bytes(13) if flags & 1 else b""
    codec = Codec(datagrams=datagrams)
    found = codec.receive(b"".join((*first, outer, *last)))
    assert [bytes(message.get_msgbuf()) for message in found] == [*first, *last]
    assert codec.bad_bytes == len(outer)


def test_flag_frame_a_frame_with_unknown_flags_is_dropped_whole_from_the_pieces_of_a_stream() -> None:
    inner = heartbeats(1)[0]
    stream = bytes([0xFD, len(inner), 0x02, 0, 0, 9, 1, 1, 2, 3]) + inner + b"\0\0" + inner
    for cut in range(1, len(stream)):
        codec = Codec()
        found = codec.receive(stream[:cut]) + codec.receive(stream[cut:])
        assert len(found) == 1, cut


@given(stray=st.binary(max_size=12), datagrams=st.booleans())
def test_stray_bytes_hold_no_frames_back(stray: bytes, datagrams: bool) -> None:
    frames = heartbeats(40)  # those that a false start may claim are at most 280 bytes, the first fourteen
    found = Codec(datagrams=datagrams).receive(stray + b"".join(frames))
    assert modes([message for message in found if is_known(message)])[-25:] == list(range(15, 40))


def test_three_stray_bytes_hold_no_heartbeat_back() -> None:
    frames = heartbeats(13)
    for stray in (b"\xfd\xff\x00", b"\xfe\xff\x00", b"\xfd\xff\x01"):
        for datagrams in (False, True):
            assert modes(Codec(datagrams=datagrams).receive(stray + b"".join(frames))) == list(range(13))


@given(pieces=st.lists(st.binary(max_size=40), max_size=20), most=st.integers(1, 40), datagrams=st.booleans())
def test_reading_in_slices_reads_the_same(pieces: list[bytes], most: int, datagrams: bool) -> None:
    stream = b"".join(piece + frame for piece, frame in zip(pieces, heartbeats(len(pieces)), strict=True))
    at_once, sliced = Codec(datagrams=datagrams), Codec(datagrams=datagrams)
    wanted = at_once.receive(stream)
    found = sliced.receive(stream, most)
    while sliced.waiting:
        found += sliced.receive(b"", most)
    assert found == wanted
    assert (sliced.frames, sliced.bad_bytes) == (at_once.frames, at_once.bad_bytes)


@given(data=st.lists(st.sampled_from([b"\xfe", b"\xfd", *HEARTBEATS[:3]])), most=st.integers(1, 30))
def test_a_slice_does_no_more_work_than_it_may(data: list[bytes], most: int) -> None:
    codec, starts = Codec(datagrams=True), sum(map(len, data))
    for _ in range(starts + 1):
        frames = codec.receive(b"" if codec.frames + codec.bad_bytes else b"".join(data), most)
        assert len(frames) * FRAME_WORK < most + FRAME_WORK
        if not codec.waiting:
            break
    assert not codec.waiting
    false_starts = Codec(datagrams=True)
    false_starts.receive(b"\xfe\0" * 200, most)
    assert false_starts.bad_bytes <= 2 * most


@given(data=st.binary(max_size=600))
def test_of_a_datagram_nothing_is_kept(data: bytes) -> None:
    codec = Codec(datagrams=True)
    found = codec.receive(data)
    assert sum(len(message.get_msgbuf()) for message in found) + codec.bad_bytes == len(data)
    assert modes(codec.receive(heartbeats(1)[0])) == [0]


def hostile(draw: random.Random) -> bytes:
    """Return a datagram that means no good: noise, torn, flipped, doubled, flagged or made up."""
    frame = bytearray(draw.choice(HEARTBEATS))
    match draw.randrange(7):
        case 0:
            return draw.randbytes(draw.randrange(300))
        case 1:
            return bytes([draw.choice((0xFD, 0xFE)), draw.randrange(256)]) * draw.randrange(150)
        case 2:
            frame[draw.randrange(len(frame))] ^= 1 << draw.randrange(8)
        case 3:
            del frame[draw.randrange(len(frame)) :]
        case 4:
            frame[2] = draw.randrange(256)
        case 5:
            frame[1] = draw.randrange(256)
        case _:
            frame += draw.randbytes(draw.randrange(3)) + draw.choice(HEARTBEATS)
    return bytes(frame)


def test_a_hundred_thousand_hostile_datagrams_neither_raise_nor_grow() -> None:
    draw = random.Random(20)
    whole, stream, sent, taken = Codec(datagrams=True), Codec(), 0, 0
    for _ in range(100_000):
        data = hostile(draw)
        sent += len(data)
        taken += sum(len(frame.raw) for frame in whole.receive(data))
        for frame in stream.receive(data):
            if is_known(frame):
                frame.fields()
    assert taken + whole.bad_bytes == sent  # nothing is kept
    assert whole.frames > 10_000


def test_random_bytes_never_raise_and_memory_stays_bounded() -> None:
    draw = random.Random(1)
    codec = Codec()
    total = 0
    for _ in range(300):
        data = draw.randbytes(draw.randrange(400))
        total += len(data)
        consumed = sum(len(message.get_msgbuf()) for message in codec.receive(data))
        total -= consumed
    assert 0 <= total - codec.bad_bytes <= 280 + 13  # at most one unfinished frame is kept


def test_flipped_bits_never_raise_and_never_pass_as_the_frame_they_were() -> None:
    draw = random.Random(2)
    frames = heartbeats(300)
    accepted = 0
    for frame in frames:
        damaged = bytearray(frame)
        place = draw.randrange(8 * len(frame))
        damaged[place // 8] ^= 1 << place % 8
        accepted += sum(is_known(message) for message in Codec().receive(bytes(damaged)))
    assert accepted == 0
