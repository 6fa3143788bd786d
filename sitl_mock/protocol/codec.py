"""Bytes <-> messages for one vehicle on one link: frames are cut, checked and finished here."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray

from sitl_mock.messages import Fields, Received
from sitl_mock.protocol.layouts import Layout, layout, layout_of_id
from sitl_mock.protocol.signing import SIGNATURE_BYTES, SIGNED, Signing

COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1
MAGIC_V1, MAGIC_V2 = 0xFE, 0xFD
HEADER_V1_BYTES, HEADER_V2_BYTES, CHECKSUM_BYTES = 6, 10, 2
LONGEST_FRAME_BYTES = HEADER_V2_BYTES + 255 + CHECKSUM_BYTES + SIGNATURE_BYTES

# Length, incompatible and compatible flags, sequence, system, component, message id.
_pack_header = struct.Struct("<BBBBBB3s").pack
_pack_checksum = struct.Struct("<H").pack
_checksum = crc16.mcrf4xx
_SETPOINT = layout("SET_POSITION_TARGET_LOCAL_NED")
SETPOINT_BYTES = (
    HEADER_V2_BYTES + _SETPOINT.size + CHECKSUM_BYTES
)  # its last byte, the frame, is not 0: never shortened
UNSIGNED_BEGIN, SIGNED_BEGIN = bytes([MAGIC_V2, _SETPOINT.size, 0]), bytes([MAGIC_V2, _SETPOINT.size, SIGNED])


class Codec:
    """MAVLink 2 out, MAVLink 1 and 2 in.

    Args:
        signing: signs what goes out and judges what comes in, if it has a key.
        link: index of the remote, which is the link's id in signatures.

    Attributes:
        bad_bytes: bytes that belonged to no good frame.
        unsendable: messages that had a number too large for its field.
        sequence: number of the next frame, 0 to 255, around and around: peers count losses by its gaps.
    """

    def __init__(self, signing: Signing | None = None, link: int = 0) -> None:
        self.signing = signing
        self.link = link
        self.bad_bytes = 0
        self.unsendable = 0
        self.sequence = 0

    def decode(self, data: bytes) -> list[Received]:
        """All good messages in a datagram; anything else is dropped and counted. Never raises.

        A datagram holds whole frames: nothing of it is kept for the next one.
        """
        return list(self._messages(data))

    def encode(self, name: str, fields: Fields, system_id: int) -> bytes:
        """One frame with the next sequence number; empty if a field cannot hold its number."""
        message = layout(name)
        try:
            payload = message.pack(fields)
        except (struct.error, OverflowError):
            # A vehicle thrown to the end of a float has nothing sensible to say.
            self.unsendable += 1
            return b""
        return self.finish(message, payload, system_id)

    def finish(self, message: Layout, payload: bytes, system_id: int) -> bytes:
        """The whole frame around a whole payload, with the next sequence number."""
        sequence = self.sequence
        self.sequence = (sequence + 1) & 0xFF
        short = payload.rstrip(b"\0") or b"\0"  # MAVLink 2 leaves zeros at the end out, but the first byte stays
        signs = self.signing is not None and self.signing.is_on
        body = _pack_header(len(short), signs, 0, sequence, system_id, COMPONENT, message.id_bytes) + short
        frame = b"\xfd" + body + _pack_checksum(_checksum(body + message.crc_extra))
        return self.signed(frame) if signs else frame

    def signed(self, frame: bytes) -> bytes:
        """A frame with its signature."""
        assert self.signing is not None
        return frame + self.signing.signature(frame, self.link)

    def _messages(self, data: bytes) -> Iterator[Received]:
        start, end = 0, len(data)
        while start < end:
            stop = self._frame_end(data, start)
            if stop is None:  # no frame begins here
                self.bad_bytes += 1
                start += 1
                continue
            message = _message(data, start, stop)
            if message is not None and (self.signing is None or self.signing.takes(data[start:stop])):
                yield message
            start = stop

    @staticmethod
    def _frame_end(data: bytes, start: int) -> int | None:
        """The index behind a good frame, or one whose message is not known, at `start`; None if there is none."""
        magic, left = data[start], len(data) - start
        if magic not in (MAGIC_V1, MAGIC_V2) or left < HEADER_V1_BYTES + CHECKSUM_BYTES:
            return None
        header = HEADER_V2_BYTES if magic == MAGIC_V2 else HEADER_V1_BYTES
        body_end = start + header + data[start + 1]
        end = body_end + CHECKSUM_BYTES
        if magic == MAGIC_V2:
            if left < HEADER_V2_BYTES + CHECKSUM_BYTES or data[start + 2] & ~SIGNED:
                return None
            end += SIGNATURE_BYTES if data[start + 2] & SIGNED else 0
        if end > len(data):
            return None
        message = layout_of_id(_id(data, start))
        if message is None:
            return end
        checksum = int.from_bytes(data[body_end : body_end + CHECKSUM_BYTES], "little")
        return end if _checksum(data[start + 1 : body_end] + message.crc_extra) == checksum else None


def plain_setpoint(data: bytes, signed: bool) -> tuple[Any, ...] | None:
    """The values of a datagram that is one good SET_POSITION_TARGET_LOCAL_NED frame, in the order of the wire.

    None for anything else, and for one that is written in another way than usual: `Codec.decode` reads it then. The
    signature of a signed one is not looked at.
    """
    size, begin = (SETPOINT_BYTES + SIGNATURE_BYTES, SIGNED_BEGIN) if signed else (SETPOINT_BYTES, UNSIGNED_BEGIN)
    if len(data) != size or data[:3] != begin or data[7:10] != _SETPOINT.id_bytes:
        return None
    covered = SETPOINT_BYTES - CHECKSUM_BYTES
    if _checksum(data[1:covered] + _SETPOINT.crc_extra) != int.from_bytes(data[covered:SETPOINT_BYTES], "little"):
        return None
    return _SETPOINT.unpack_whole(data[HEADER_V2_BYTES:covered])


def encode_rows(
    message: Layout, rows: NDArray[np.void], codecs: Sequence[Codec], system_ids: Sequence[int]
) -> list[bytes]:
    """The frames of many payloads of one message, see `Layout.rows`; one codec and one system id each."""
    data, size, id_bytes, crc_extra = rows.tobytes(), message.size, message.id_bytes, message.crc_extra
    frames = []
    # As `Codec.finish`, without its calls: this is where most bytes of the simulator come from.
    for start, codec, system_id in zip(range(0, len(data), size), codecs, system_ids, strict=True):
        short = data[start : start + size].rstrip(b"\0") or b"\0"
        sequence = codec.sequence
        codec.sequence = (sequence + 1) & 0xFF
        signs = codec.signing is not None and codec.signing.is_on
        body = _pack_header(len(short), signs, 0, sequence, system_id, COMPONENT, id_bytes) + short
        frame = b"\xfd" + body + _pack_checksum(_checksum(body + crc_extra))
        frames.append(codec.signed(frame) if signs else frame)
    return frames


def _id(data: bytes, start: int) -> int:
    """The id of the message whose frame begins at `start`."""
    if data[start] == MAGIC_V1:
        return data[start + 5]
    return int.from_bytes(data[start + 7 : start + 10], "little")


def _message(data: bytes, start: int, stop: int) -> Received | None:
    """The message of a good frame; None if the dialect does not have it."""
    kind = layout_of_id(_id(data, start))
    if kind is None:
        return None
    first = data[start] == MAGIC_V1
    begin = start + (HEADER_V1_BYTES if first else HEADER_V2_BYTES)
    system, component = data[start + (3 if first else 5)], data[start + (4 if first else 6)]
    values = kind.unpack(data[begin : begin + data[start + 1]])
    return Received(kind.name, system, component, kind.names, values)


def first_message_id(data: bytes) -> int | None:
    """The id of the message that a datagram begins with; None if no frame begins there."""
    shortest = {MAGIC_V1: HEADER_V1_BYTES, MAGIC_V2: HEADER_V2_BYTES}.get(data[0] if data else 0)
    return None if shortest is None or len(data) < shortest else _id(data, 0)
