"""Frames and payloads: byte for byte and value for value what pymavlink packs and reads."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from sitl_mock.protocol.codec import Codec, encode_rows
from sitl_mock.protocol.layouts import NUMPY_TYPES, layout
from sitl_mock.protocol.signing import Signing, SigningTime

NAMES = sorted(row.msgname for row in dialect.mavlink_map.values())
OFTEN = (
    "HEARTBEAT",
    "LOCAL_POSITION_NED",
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "GLOBAL_POSITION_INT",
    "SYS_STATUS",
    "EXTENDED_SYS_STATE",
    "SET_POSITION_TARGET_LOCAL_NED",
    "POSITION_TARGET_LOCAL_NED",
    "COMMAND_LONG",
    "PARAM_SET",
    "PARAM_VALUE",
    "STATUSTEXT",
    "BATTERY_STATUS",
)


def message_of(name: str, payload: bytes) -> Any:  # noqa: ANN401 - one of pymavlink's classes
    """The message that pymavlink reads out of a whole payload."""
    frame = framed(name, payload, version=2)
    return dialect.MAVLink(None).decode(bytearray(frame))


def framed(name: str, payload: bytes, version: int, sequence: int = 0) -> bytes:
    """A frame by the protocol's own words, with nothing cut off."""
    kind = dialect.mavlink_map[layout(name).id]
    if version == 2:
        body = struct.pack("<BBBBBB", len(payload), 0, 0, sequence, 7, 1) + kind.id.to_bytes(3, "little") + payload
        start = b"\xfd"
    else:
        body = struct.pack("<BBBBB", len(payload), sequence, 7, 1, kind.id) + payload
        start = b"\xfe"
    checksum = dialect.x25crc(body + bytes([kind.crc_extra])).crc
    return bytes(start + body + struct.pack("<H", checksum))


def same(ours: Any, theirs: Any) -> bool:  # noqa: ANN401 - any field
    if isinstance(ours, list):
        return len(ours) == len(theirs) and all(same(a, b) for a, b in zip(ours, theirs, strict=True))
    if isinstance(ours, float) and math.isnan(ours):
        return isinstance(theirs, float) and math.isnan(theirs)
    return bool(ours == theirs)


@given(st.sampled_from(NAMES), st.binary(max_size=255))
@settings(max_examples=600, deadline=None)
def test_every_message_reads_as_pymavlink_reads_it(name: str, data: bytes) -> None:
    payload = data[: layout(name).size].ljust(layout(name).size, b"\0")
    theirs = message_of(name, payload)
    short = payload.rstrip(b"\0") or b"\0"
    (ours,) = Codec().decode(framed(name, short, version=2))
    assert (ours.name, ours.system, ours.component) == (name, 7, 1)
    assert list(ours.fields) == theirs.ordered_fieldnames
    assert all(same(value, getattr(theirs, field)) for field, value in ours.fields.items())


@given(st.sampled_from(OFTEN), st.binary(min_size=60, max_size=80))
@settings(max_examples=400, deadline=None)
def test_every_message_packs_as_pymavlink_packs_it(name: str, data: bytes) -> None:
    payload = data[: layout(name).size].ljust(layout(name).size, b"\0")
    theirs = message_of(name, payload)
    fields = {field: getattr(theirs, field) for field in theirs.fieldnames}
    fields = {field: v.encode("ascii", "replace") if isinstance(v, str) else v for field, v in fields.items()}
    again = type(theirs)(**fields)
    packer = dialect.MAVLink(None, srcSystem=42, srcComponent=1)
    codec = Codec()
    for sequence in range(3):
        packer.seq = sequence
        assert codec.encode(name, fields, 42) == bytes(again.pack(packer))


@given(st.sampled_from(NAMES), st.binary(max_size=255))
@settings(max_examples=200, deadline=None)
def test_version_1_frames_are_read_too(name: str, data: bytes) -> None:
    whole = layout(name)
    if whole.id > 255:
        return
    payload = data[: whole.size].ljust(whole.size, b"\0")
    (ours,) = Codec().decode(framed(name, payload, version=1))
    theirs = message_of(name, payload)
    assert all(same(value, getattr(theirs, field)) for field, value in ours.fields.items())


@given(st.lists(st.one_of(st.binary(max_size=40), st.just(framed("HEARTBEAT", bytes(9), 2))), max_size=6))
@settings(deadline=None)
def test_noise_costs_no_good_frame(pieces: list[bytes]) -> None:
    """Whatever lies between frames, unless it claims to be the beginning of one."""
    good = framed("HEARTBEAT", bytes(9), 2)
    quiet = [piece if piece == good else piece.translate(None, delete=b"\xfd\xfe") for piece in pieces]
    codec = Codec()
    assert len(codec.decode(b"".join(quiet))) == quiet.count(good)
    assert codec.bad_bytes == sum(len(piece) for piece in quiet if piece != good)


@given(st.binary(max_size=300))
@settings(deadline=None)
def test_no_bytes_raise(data: bytes) -> None:
    codec = Codec()
    codec.decode(data)
    assert codec.bad_bytes <= len(data)


@pytest.mark.parametrize("cut", range(1, 21))
def test_a_frame_that_is_cut_is_none(cut: int) -> None:
    frame = framed("HEARTBEAT", bytes(range(9)), 2)
    assert Codec().decode(frame[:-cut]) == []


def test_a_signed_frame_is_read_without_its_signature() -> None:
    payload = bytes(range(9))
    body = struct.pack("<BBBBBB", 9, 1, 0, 0, 7, 1) + bytes(3) + payload
    extra = bytes([layout("HEARTBEAT").crc_extra[0]])
    frame = b"\xfd" + body + struct.pack("<H", dialect.x25crc(body + extra).crc) + bytes(13)
    assert [message.name for message in Codec().decode(frame + frame)] == ["HEARTBEAT"] * 2


def test_a_frame_with_a_flag_that_is_not_known_is_dropped() -> None:
    body = struct.pack("<BBBBBB", 9, 2, 0, 0, 7, 1) + bytes(3) + bytes(9)
    frame = b"\xfd" + body + struct.pack("<H", dialect.x25crc(body + layout("HEARTBEAT").crc_extra).crc)
    assert Codec().decode(frame) == []


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_rows_pack_as_one_by_one(data: st.DataObject) -> None:
    """Many payloads in one pass are the bytes of each alone."""
    name = data.draw(st.sampled_from([kind for kind in OFTEN if not any(c in kind for c in ("PARAM", "TEXT"))]))
    whole = layout(name)
    payloads = data.draw(st.lists(st.binary(min_size=whole.size, max_size=whole.size), min_size=1, max_size=5))
    rows = np.frombuffer(b"".join(payloads), whole.rows(0).dtype)
    many, single = [Codec() for _ in payloads], [Codec() for _ in payloads]
    together = list(encode_rows(whole, rows, many, list(range(1, len(payloads) + 1))))
    alone = [
        codec.encode(name, dict(zip(whole.names, whole.unpack(payload), strict=True)), system_id)
        for system_id, (codec, payload) in enumerate(zip(single, payloads, strict=True), start=1)
    ]
    # A NaN's own bits may change on the way through a Python float; nothing else may.
    assert [len(frame) for frame in together] == [len(frame) for frame in alone]
    for one, other in zip(together, alone, strict=True):
        (read, again) = Codec().decode(one)[0], Codec().decode(other)[0]
        assert all(same(a, b) for a, b in zip(read.values, again.values, strict=True))


def test_rows_have_the_types_of_the_wire() -> None:
    for code, kind in NUMPY_TYPES.items():
        assert struct.calcsize("<" + code) == np.dtype(kind).itemsize
    assert layout("LOCAL_POSITION_NED").rows(2).dtype.itemsize == layout("LOCAL_POSITION_NED").size


def test_a_number_that_does_not_fit_is_not_sent() -> None:
    codec = Codec()
    assert codec.encode("HEARTBEAT", {"type": 300}, 1) == b""
    assert codec.unsendable == 1
    assert codec.encode("HEARTBEAT", {"type": 2}, 1)[4] == 0  # no sequence number was used


def test_a_time_stamp_at_the_end_of_time_stops_no_vehicle() -> None:
    signing = Signing(SigningTime(0.0), None)
    signing.set_up(bytes([1]) * 32, 2**64 - 1)
    codec = Codec(signing)
    fields = dict.fromkeys(layout("HEARTBEAT").names, 3)
    assert [len(codec.encode("HEARTBEAT", fields, 1)) for _ in range(2)] == [10 + 9 + 2 + 13] * 2


@pytest.mark.parametrize("name", OFTEN)
def test_frames_are_signed_byte_for_byte_as_pymavlink_signs_them(name: str) -> None:
    key, payload = bytes(range(32)), bytes(range(1, layout(name).size + 1))
    message = message_of(name, payload)
    theirs = dialect.MAVLink(None, srcSystem=42, srcComponent=1)
    theirs.signing.secret_key, theirs.signing.link_id, theirs.signing.sign_outgoing = key, 3, True
    theirs.signing.timestamp = 1
    judge = dialect.MAVLink(None, srcSystem=255)
    judge.signing.secret_key = key
    codec = Codec(Signing(SigningTime(0.0), key), 3)
    for count in range(3):
        theirs.seq = count
        expected = bytes(message.pack(theirs))
        assert codec.finish(layout(name), payload, 42) == expected
        (read,) = judge.parse_buffer(expected)
        assert read.get_signed()
