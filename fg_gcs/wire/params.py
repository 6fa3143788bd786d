"""Parameter values as they travel in the float field of PARAM_VALUE and PARAM_SET.

PX4 lays the bytes of an integer into the float, ArduPilot casts it (measured, see docs/autopilots).
"""

import math
import struct
from enum import Enum
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import FgError
from fg_gcs.wire.codec import Message

REAL32: Final[int] = dialect.MAV_PARAM_TYPE_REAL32

_INTEGER_LAYOUTS: Final[dict[int, struct.Struct]] = {
    dialect.MAV_PARAM_TYPE_UINT8: struct.Struct("<Bxxx"),
    dialect.MAV_PARAM_TYPE_INT8: struct.Struct("<bxxx"),
    dialect.MAV_PARAM_TYPE_UINT16: struct.Struct("<Hxx"),
    dialect.MAV_PARAM_TYPE_INT16: struct.Struct("<hxx"),
    dialect.MAV_PARAM_TYPE_UINT32: struct.Struct("<I"),
    dialect.MAV_PARAM_TYPE_INT32: struct.Struct("<i"),
}
_FLOAT: Final = struct.Struct("<f")
_MOST_EXACT: Final = 2**24  # integers beyond this do not survive a cast to float32


class Encoding(Enum):
    """How an integer travels in the float field of a parameter message."""

    BYTEWISE = "byte by byte"
    CAST = "cast to float"


class UnsafeParameter(FgError):
    """A parameter value that its type, or the way it travels, cannot carry exactly."""

    def __init__(self, name: str, value: float, param_type: int) -> None:
        self.name, self.value, self.param_type = name, value, param_type
        super().__init__(f"parameter {name}: {value!r} does not fit into MAVLink parameter type {param_type}")


def decode(message: Message, encoding: Encoding) -> float:
    """Return the value of a PARAM_VALUE as the autopilot means it (may be NaN: PX4 stores even that).

    The bytes of the frame are read, not pymavlink's float: on its way through a float an integer whose bits look like
    a signalling NaN changes.
    """
    layout = _INTEGER_LAYOUTS.get(message.param_type)
    if encoding is Encoding.CAST or layout is None:
        return float(message.param_value)
    frame = message.get_msgbuf()
    start = 10 if frame[0] == 0xFD else 6
    (value,) = layout.unpack(bytes(frame[start : start + 4]))
    return float(value)


def encode(name: str, value: float, param_type: int, encoding: Encoding) -> float:
    """Return what to put into the float field of PARAM_SET so that the autopilot stores ``value``.

    Raises:
        UnsafeParameter: The value is not finite, not an integer where the type is one, out of the type's range, or
            not exact on the wire (autopilots check no range themselves: they store what comes).
    """
    layout = _INTEGER_LAYOUTS.get(param_type)
    if not math.isfinite(value) or (layout is None and param_type != REAL32):
        raise UnsafeParameter(name, value, param_type)
    try:
        if layout is None:
            return _unpack_float(_FLOAT.pack(value))
        if value != int(value):
            raise UnsafeParameter(name, value, param_type)
        carried = layout.pack(int(value))
    except (struct.error, OverflowError) as error:
        raise UnsafeParameter(name, value, param_type) from error
    if encoding is Encoding.CAST:
        if abs(value) > _MOST_EXACT:
            raise UnsafeParameter(name, value, param_type)
        return float(value)
    as_float = _unpack_float(carried)
    if _FLOAT.pack(as_float) != carried:  # a signalling NaN: the processor would set its quiet bit
        raise UnsafeParameter(name, value, param_type)
    return as_float


def same(value: float, other: float) -> bool:
    """Tell whether two parameter values are equal as float32, the finest that the wire can carry."""
    try:
        return _FLOAT.pack(value) == _FLOAT.pack(other) or value == other
    except OverflowError:
        return False


def _unpack_float(four_bytes: bytes) -> float:
    value: float = _FLOAT.unpack(four_bytes)[0]
    return value
