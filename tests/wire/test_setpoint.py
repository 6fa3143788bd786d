import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.core.admissible import LARGEST
from fg_gcs.wire.codec import GCS_COMPONENT, GCS_SYSTEM, Codec
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.setpoint import NUMBERS, TYPE_MASK, SetpointRound

Numbers = NDArray[np.float64]

FLOATS = st.one_of(st.just(0.0), st.floats(-LARGEST, LARGEST))  # zeros on purpose: MAVLink 2 cuts trailing ones off
SWARMS = st.integers(0, 12).flatmap(lambda count: arrays.arrays(np.float64, (count, NUMBERS), elements=FLOATS))


def theirs(numbers: list[float], system_id: int, sequence: int) -> bytes:
    """What pymavlink packs."""
    packer = dialect.MAVLink(None, srcSystem=GCS_SYSTEM, srcComponent=GCS_COMPONENT)
    packer.seq = sequence
    message = dialect.MAVLink_set_position_target_local_ned_message(
        0, system_id, 1, dialect.MAV_FRAME_LOCAL_NED, TYPE_MASK, *numbers, 0.0
    )
    return bytes(message.pack(packer))


@given(numbers=SWARMS, draw=st.data())
def test_bytes_equal_pymavlinks(numbers: Numbers, draw: st.DataObject) -> None:
    count = len(numbers)
    system_ids = draw.draw(st.lists(st.integers(1, 250), min_size=count, max_size=count))
    before = draw.draw(st.lists(st.integers(0, 255), min_size=count, max_size=count))
    senders = [Sender() for _ in range(count)]
    for sender, sent in zip(senders, before, strict=True):
        for _ in range(sent):
            sender.next_sequence()
    frames = SetpointRound(system_ids, senders).pack(numbers)
    for frame, *wanted in zip(frames, numbers.tolist(), system_ids, before, strict=True):
        assert frame.tobytes() == theirs(*wanted)


def test_vehicles_behind_one_link_share_its_sequence_numbers() -> None:
    shared, own = Sender(), Sender()
    setpoints = SetpointRound([1, 2, 3, 4], [shared, shared, own, shared])
    for start in range(0, 900, 3):
        frames = setpoints.pack(np.ones((4, NUMBERS)))
        assert frames[:, 4].tolist() == [start % 256, (start + 1) % 256, start // 3 % 256, (start + 2) % 256]


@given(numbers=SWARMS)
def test_the_codec_reads_back_what_was_packed(numbers: Numbers) -> None:
    codec, ids = Codec(), list(range(1, len(numbers) + 1))
    heard = codec.receive(SetpointRound(ids, [Sender()] * len(numbers)).pack(numbers).tobytes())
    assert (len(heard), codec.bad_bytes) == (len(numbers), 0)
    for message, row, system_id in zip(heard, numbers, ids, strict=True):
        said = message.fields()
        got = [said.x, said.y, said.z, said.vx, said.vy, said.vz, said.afx, said.afy, said.afz, said.yaw]
        assert got == row.astype(np.float32).tolist()
        assert (said.target_system, said.target_component, said.coordinate_frame) == (system_id, 1, 1)
        assert (said.type_mask, said.yaw_rate, said.time_boot_ms) == (0x800, 0.0, 0)
