import math
import random
import struct

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.codec import Codec, Message
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.params import REAL32, Encoding, UnsafeParameter, decode, encode, same

RANGES = {
    dialect.MAV_PARAM_TYPE_UINT8: (0, 2**8 - 1),
    dialect.MAV_PARAM_TYPE_INT8: (-(2**7), 2**7 - 1),
    dialect.MAV_PARAM_TYPE_UINT16: (0, 2**16 - 1),
    dialect.MAV_PARAM_TYPE_INT16: (-(2**15), 2**15 - 1),
    dialect.MAV_PARAM_TYPE_UINT32: (0, 2**32 - 1),
    dialect.MAV_PARAM_TYPE_INT32: (-(2**31), 2**31 - 1),
}


def over_the_wire(carried: float, param_type: int) -> Message:
    (message,) = Codec().receive(
        Sender(1, 1).pack(dialect.MAVLink_param_value_message(b"P", carried, param_type, 1, 0))
    )
    return message


def is_signalling(value: int) -> bool:
    bits = value & 0xFFFFFFFF
    return bits & 0x7F800000 == 0x7F800000 and not bits & 0x00400000 and bool(bits & 0x003FFFFF)


@pytest.mark.parametrize("param_type", RANGES)
@pytest.mark.parametrize("encoding", Encoding)
def test_integers_come_back(param_type: int, encoding: Encoding) -> None:
    draw = random.Random(param_type)
    low, high = RANGES[param_type]
    values = [low, high, 0, 1, max(low, -1), *(draw.randint(low, high) for _ in range(200))]
    for value in values:
        exact = abs(value) <= 2**24 if encoding is Encoding.CAST else not is_signalling(value)
        if exact:
            assert decode(over_the_wire(encode("P", value, param_type, encoding), param_type), encoding) == value
        else:
            with pytest.raises(UnsafeParameter):
                encode("P", value, param_type, encoding)


@pytest.mark.parametrize("encoding", Encoding)
def test_floats_come_back_as_float32(encoding: Encoding) -> None:
    draw = random.Random(5)
    for _ in range(200):
        value = draw.uniform(-1e3, 1e3)
        assert same(decode(over_the_wire(encode("P", value, REAL32, encoding), REAL32), encoding), value)


def test_an_integer_that_looks_like_a_signalling_nan_is_read_exactly() -> None:
    frame = Sender(1, 1).pack(dialect.MAVLink_param_value_message(b"P", 1.0, dialect.MAV_PARAM_TYPE_INT32, 1, 0))
    payload = struct.pack("<i", -8388607) + frame[14:-2]
    crc = dialect.x25crc(frame[1:10] + payload + bytes([dialect.MAVLink_param_value_message.crc_extra])).crc
    (message,) = Codec().receive(frame[:10] + payload + struct.pack("<H", crc))
    assert decode(message, Encoding.BYTEWISE) == -8388607


@pytest.mark.parametrize(
    ("value", "param_type"),
    [
        (math.nan, REAL32),
        (math.inf, REAL32),
        (1e39, REAL32),
        (1.5, dialect.MAV_PARAM_TYPE_INT32),
        (300, dialect.MAV_PARAM_TYPE_INT8),
        (-1, dialect.MAV_PARAM_TYPE_UINT32),
        (math.nan, dialect.MAV_PARAM_TYPE_INT32),
        (1.0, 77),
    ],
)
@pytest.mark.parametrize("encoding", Encoding)
def test_what_does_not_fit_is_refused(value: float, param_type: int, encoding: Encoding) -> None:
    with pytest.raises(UnsafeParameter, match="parameter SPEED") as caught:
        encode("SPEED", value, param_type, encoding)
    assert caught.value.param_type == param_type


def test_same_is_equality_of_float32() -> None:
    assert same(0.1, struct.unpack("<f", struct.pack("<f", 0.1))[0])
    assert not same(0.1, 0.1001)
    assert not same(1.0, 1e300)
    assert same(0.0, -0.0)
