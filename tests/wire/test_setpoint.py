import math
import random
import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import FgError
from fg_gcs.wire import commands
from fg_gcs.wire.codec import GCS_COMPONENT, GCS_SYSTEM, Codec
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.setpoint import LARGEST, TYPE_MASK, Setpoint, UnsafeSetpoint, pack_setpoint


def random_setpoint(draw: random.Random) -> Setpoint:
    def triple() -> tuple[float, float, float]:
        # Zeros on purpose: MAVLink 2 cuts trailing zeros off a payload.
        a, b, c = (draw.choice((0.0, draw.uniform(-500.0, 500.0))) for _ in range(3))
        return a, b, c

    return Setpoint(triple(), triple(), triple(), draw.choice((0.0, draw.uniform(-math.pi, math.pi))))


def test_bytes_equal_pymavlinks() -> None:
    draw = random.Random(3)
    ours, theirs = Sender(), dialect.MAVLink(None, srcSystem=GCS_SYSTEM, srcComponent=GCS_COMPONENT)
    for number in range(1000):
        theirs.seq = number % 256
        setpoint, system_id, time_ms = random_setpoint(draw), draw.randrange(1, 255), draw.randrange(2**32)
        message = dialect.MAVLink_set_position_target_local_ned_message(
            time_ms,
            system_id,
            1,
            dialect.MAV_FRAME_LOCAL_NED,
            TYPE_MASK,
            *setpoint.position_ned_m,
            *setpoint.velocity_ned_m_s,
            *setpoint.acceleration_ned_m_s2,
            setpoint.yaw_ned_rad,
            0.0,
        )
        assert pack_setpoint(setpoint, system_id, ours, time_ms) == bytes(message.pack(theirs))


def test_the_codec_reads_back_what_was_packed() -> None:
    draw = random.Random(4)
    sender, codec = Sender(), Codec()
    for _ in range(100):
        setpoint = random_setpoint(draw)
        (message,) = codec.receive(pack_setpoint(setpoint, 9, sender))
        expected = np.array(
            [*setpoint.position_ned_m, *setpoint.velocity_ned_m_s, *setpoint.acceleration_ned_m_s2], np.float32
        )
        got = [message.x, message.y, message.z, message.vx, message.vy, message.vz]
        assert [*got, message.afx, message.afy, message.afz] == expected.tolist()
        assert message.yaw == struct.unpack("<f", struct.pack("<f", setpoint.yaw_ned_rad))[0]
        assert (message.target_system, message.target_component, message.coordinate_frame) == (9, 1, 1)
        assert message.type_mask == 0x800


def test_numpy_rows_pack_like_floats() -> None:
    rows = np.arange(9.0).reshape(3, 3)
    plain = Setpoint((0.0, 1.0, 2.0), (3.0, 4.0, 5.0), (6.0, 7.0, 8.0), 0.5)
    assert pack_setpoint(Setpoint(rows[0], rows[1], rows[2], 0.5), 1, Sender()) == pack_setpoint(plain, 1, Sender())


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 2.0 * LARGEST, -1e9, 1e300])
@pytest.mark.parametrize("place", range(10))
def test_no_unsafe_number_leaves(bad: float, place: int) -> None:
    numbers = [1.0] * 10
    numbers[place] = bad
    a, b, c, d, e, f, g, h, i, yaw = numbers
    setpoint = Setpoint((a, b, c), (d, e, f), (g, h, i), yaw)
    sender = Sender()
    with pytest.raises(UnsafeSetpoint, match="setpoint for vehicle 4 is not finite or beyond 1e") as caught:
        pack_setpoint(setpoint, 4, sender)
    assert (caught.value.system_id, caught.value.setpoint) == (4, setpoint)
    assert isinstance(caught.value, FgError)
    assert sender.pack(commands.heartbeat())[4] == 0  # the sequence number of the next frame
