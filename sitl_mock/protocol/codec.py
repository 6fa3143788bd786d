"""Bytes <-> messages for one vehicle on one link: the only file that knows pymavlink (its dialect module)."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from sitl_mock.messages import Fields, Received

COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1
CLASSES: Mapping[str, Any] = MappingProxyType({row.msgname: row for row in dialect.mavlink_map.values()})


class Codec:
    """MAVLink 2 out, MAVLink 1 and 2 in.

    Attributes:
        bad_bytes: bytes that belonged to no good frame.
        unsendable: messages that had a number too large for its field.
    """

    def __init__(self) -> None:
        self._parser = dialect.MAVLink(None)
        self._parser.robust_parsing = True
        self._packer = dialect.MAVLink(None, srcSystem=1, srcComponent=COMPONENT)
        self.bad_bytes = 0
        self.unsendable = 0

    def decode(self, data: bytes) -> list[Received]:
        """All good messages in a datagram; anything else is dropped and counted. Never raises."""
        # A datagram holds whole frames: leftovers of the last one are noise that would spoil this one.
        self._parser.buf.clear()
        self._parser.buf_index = 0
        self._parser.expected_length = dialect.HEADER_LEN_V1 + 2
        good = []
        for message in self._parse(data):
            kind = message.get_type()
            if kind == "BAD_DATA":
                self.bad_bytes += len(message.data)
            elif not kind.startswith("UNKNOWN"):
                fields = {name: getattr(message, name) for name in message.fieldnames}
                good.append(Received(kind, message.get_srcSystem(), message.get_srcComponent(), fields))
        return good

    def _parse(self, data: bytes) -> list[Any]:
        try:
            return self._parser.parse_buffer(data) or []
        except (dialect.MAVError, struct.error, ValueError, IndexError, TypeError):
            # pymavlink's parser lets a few malformed frames through as exceptions of these kinds.
            self.bad_bytes += len(data)
            return []

    def encode(self, name: str, fields: Fields, system_id: int) -> bytes:
        """One frame with the next sequence number; empty if a field cannot hold its number."""
        message = CLASSES[name](**fields)
        self._packer.srcSystem = system_id
        try:
            raw = bytes(message.pack(self._packer))
        except (struct.error, OverflowError):
            # A vehicle thrown to the end of a float has nothing sensible to say.
            self.unsendable += 1
            return b""
        self._packer.seq = (self._packer.seq + 1) % 256  # pack() does not advance it
        return raw
