"""How each MAVLink message lies on the wire: the only file that knows pymavlink, whose dialect has the layouts.

Messages are packed and read here with precompiled `struct` layouts, byte for byte and value for value as pymavlink
does, without its objects.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from sitl_mock.messages import Fields

NUMPY_TYPES = MappingProxyType(
    {
        "B": "<u1",
        "b": "<i1",
        "H": "<u2",
        "h": "<i2",
        "I": "<u4",
        "i": "<i4",
        "Q": "<u8",
        "q": "<i8",
        "f": "<f4",
        "d": "<f8",
    }
)


class Layout:
    """One message.

    Attributes:
        name: of the message.
        id: of the message.
        id_bytes: the id as it stands in a MAVLink 2 header.
        crc_extra: what its checksum covers beside the frame.
        size: of the whole payload, in bytes.
        names: its fields in the order of the wire.
        unpack_whole: from a whole payload to its values, where there are no texts and arrays.
    """

    def __init__(self, kind: Any) -> None:  # noqa: ANN401  # one of pymavlink's message classes
        self.name: str = kind.msgname
        self.id: int = kind.id
        self.id_bytes = self.id.to_bytes(3, "little")
        self.crc_extra = bytes([kind.crc_extra])
        self.names: tuple[str, ...] = tuple(kind.ordered_fieldnames)
        self._struct = struct.Struct(kind.unpacker.format)
        self.unpack_whole = self._struct.unpack  # of a whole payload without texts and arrays
        self.size = self._struct.size
        types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
        # The number of elements of each field that is an array of numbers; texts are one element.
        lengths = zip(self.names, kind.lengths, kind.array_lengths, strict=True)
        self._arrays = {name: length for name, length, array in lengths if array and types[name] != "char"}
        self._texts = tuple(name for name in self.names if types[name] == "char")
        self._plain = not self._arrays and not self._texts
        self._codes = [chr(code) for code in kind.native_format[1:]]

    def pack(self, fields: Fields) -> bytes:
        """The payload, whole; fields that are not given are zero.

        Raises:
            struct.error, OverflowError: a field cannot hold its number.
        """
        if not self._arrays:
            return self._struct.pack(*[fields.get(name, b"" if name in self._texts else 0) for name in self.names])
        values: list[Any] = []
        for name in self.names:
            length = self._arrays.get(name)
            if length is None:
                values.append(fields.get(name, b"" if name in self._texts else 0))
            else:
                values += fields.get(name, [0] * length)
        return self._struct.pack(*values)

    def unpack(self, payload: bytes) -> tuple[Any, ...]:
        """The values in the order of the wire; what MAVLink 2 cut off is zero. Texts are `str`, arrays `list`."""
        values = self._struct.unpack(payload[: self.size].ljust(self.size, b"\0"))
        if self._plain:
            return values
        found: list[Any] = []
        k = 0
        for name in self.names:
            length = self._arrays.get(name, 1)
            value: Any = list(values[k : k + length]) if name in self._arrays else values[k]
            if name in self._texts:
                value = value.split(b"\0", 1)[0].decode("ascii", errors="replace")
            found.append(value)
            k += length
        return tuple(found)

    def rows(self, count: int) -> NDArray[np.void]:
        """An array of `count` empty payloads whose fields are the message's: `tobytes` packs all of them at once.

        Raises:
            ValueError: the message has texts.
        """
        if self._texts:
            raise ValueError(f"{self.name} has texts")
        types = [
            (name, NUMPY_TYPES[code], self._arrays[name]) if name in self._arrays else (name, NUMPY_TYPES[code])
            for name, code in zip(self.names, self._codes, strict=True)
        ]
        return np.zeros(count, np.dtype(types))


@cache
def layout(name: str) -> Layout:
    """The layout of a message.

    Raises:
        KeyError: the dialect has no such message.
    """
    return Layout(_KINDS[name])


@cache
def layout_of_id(number: int) -> Layout | None:
    """The layout of the message with an id; None: the dialect does not have it."""
    kind = dialect.mavlink_map.get(number)
    return None if kind is None else layout(kind.msgname)


def is_message(name: str) -> bool:
    """Whether the dialect has a message of this name."""
    return name in _KINDS


_KINDS: Mapping[str, Any] = MappingProxyType({row.msgname: row for row in dialect.mavlink_map.values()})
