"""What is read here is what pymavlink reads: value for value, whatever the payload is."""

import math
import struct
from typing import Any

import pytest
from fastcrc import crc16
from hypothesis import assume, given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.codec import Codec, Frame, is_known
from fg_gcs.wire.messages import READERS

MAGIC_V1, MAGIC_V2 = 0xFE, 0xFD
KINDS = [dialect.mavlink_map[identity] for identity in READERS]
SIGNATURE_BYTES = 13


def framed(identity: int, payload: bytes, *, version: int = 2, signature: bytes = b"") -> bytes:
    """The frame of a payload of any length; a signature's bytes need not be right."""
    if version == 1:
        head = struct.pack("<BBBBB", len(payload), 7, 3, 1, identity)
    else:
        head = struct.pack("<BBBBBB", len(payload), bool(signature), 0, 7, 3, 1) + identity.to_bytes(3, "little")
    crc_extra = bytes([dialect.mavlink_map[identity].crc_extra])
    checksum = struct.pack("<H", crc16.mcrf4xx(head + payload + crc_extra))
    return bytes([MAGIC_V1 if version == 1 else MAGIC_V2]) + head + payload + checksum + signature


def values(message: Any, names: list[str]) -> list[object]:  # noqa: ANN401 - ours or pymavlink's
    """A message's fields, NaN as a text that equals itself."""
    found = [getattr(message, name) for name in names]
    return ["NaN" if isinstance(value, float) and math.isnan(value) else value for value in found]


PAYLOADS = st.one_of(
    st.binary(max_size=255),
    st.builds(lambda head, zeros: head + bytes(zeros), st.binary(max_size=60), st.integers(0, 60)),
    st.sampled_from([b"", b"\0", b"\xff" * 255, b"\x00\x00\x80\x7f" * 20, b"\x01\x00\x80\xff" * 20]),
)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.msgname)
def test_fields_have_the_names_and_the_order_of_the_wire(kind: Any) -> None:  # noqa: ANN401
    (frame,) = Codec().receive(framed(kind.id, bytes(kind.unpacker.size)))
    assert list(type(frame.fields())._fields) == kind.ordered_fieldnames
    assert frame.get_type() == kind.msgname


@given(kind=st.sampled_from(KINDS), payload=PAYLOADS, version=st.sampled_from([1, 2]), is_signed=st.booleans())
def test_what_comes_often_is_read_as_pymavlink_reads_it(
    kind: Any,  # noqa: ANN401
    payload: bytes,
    version: int,
    is_signed: bool,
) -> None:
    signature = bytes(range(SIGNATURE_BYTES)) if is_signed and version == 2 else b""
    assume(version == 2 or kind.id < 256)  # MAVLink 1 has ids of one byte
    data = framed(kind.id, payload, version=version, signature=signature)
    theirs = dialect.MAVLink(None).decode(bytearray(data))
    (ours,) = Codec().receive(data)
    assert values(ours.fields(), kind.ordered_fieldnames) == values(theirs, kind.ordered_fieldnames)
    assert (ours.get_msgId(), ours.get_type(), ours.get_seq()) == (kind.id, theirs.get_type(), theirs.get_seq())
    assert (ours.get_srcSystem(), ours.get_srcComponent()) == (theirs.get_srcSystem(), theirs.get_srcComponent())
    assert ours.get_msgbuf() == data


@given(identity=st.sampled_from(sorted(dialect.mavlink_map)), payload=PAYLOADS)
def test_whatever_checks_out_can_be_read(identity: int, payload: bytes) -> None:
    (frame,) = Codec().receive(framed(identity, payload))
    kind, fields = dialect.mavlink_map[identity], frame.fields()
    assert frame.get_type() == kind.msgname
    assert all(hasattr(fields, name) for name in kind.ordered_fieldnames)


def whole(stream: bytes) -> list[Frame]:
    return [frame for frame in Codec().receive(stream) if is_known(frame)]


@given(
    pieces=st.lists(
        st.one_of(
            st.binary(max_size=40),
            st.builds(lambda payload, version: framed(0, payload, version=version), PAYLOADS, st.sampled_from([1, 2])),
        ),
        max_size=12,
    ),
    cut=st.integers(0, 400),
)
def test_the_same_frames_come_out_of_a_stream_however_it_is_cut(pieces: list[bytes], cut: int) -> None:
    stream, codec = b"".join(pieces), Codec()
    frames = codec.receive(stream[:cut]) + codec.receive(stream[cut:])
    assert [frame.raw for frame in frames if is_known(frame)] == [frame.raw for frame in whole(stream)]


def test_an_unknown_message_has_no_fields() -> None:
    (frame,) = Codec().receive(bytes([MAGIC_V2, 1, 0, 0, 5, 1, 1]) + (410).to_bytes(3, "little") + b"\x01\xaa\xbb")
    with pytest.raises(AttributeError):
        _ = frame.custom_mode
