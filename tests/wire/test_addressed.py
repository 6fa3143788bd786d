import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.addressed import addressee, is_question
from fg_gcs.wire.codec import Codec, Frame, Message
from fg_gcs.wire.framing import Sender, id_bytes

KINDS = list(dialect.mavlink_map.values())


def frame_of(message: Message) -> Frame:
    (frame,) = Codec().receive(Sender(250, 190).pack(message))
    return frame


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.msgname)
def test_whatever_the_bytes_are_a_frame_is_for_somebody_or_nobody(kind: Any) -> None:  # noqa: ANN401 # pymavlink's
    draw, sender = random.Random(kind.id), Sender(250, 190)
    for _ in range(20):
        payload = draw.randbytes(draw.randrange(1, kind.unpacker.size + 1))
        (frame,) = Codec().receive(sender.finish(id_bytes(kind.id), bytes([kind.crc_extra]), payload))
        target = addressee(frame)
        assert target is None or 0 <= target <= 255
        assert is_question(frame) in (True, False)


@pytest.mark.parametrize(
    ("message", "target", "asks"),
    [
        (dialect.MAVLink_command_long_message(7, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0), 7, False),
        (dialect.MAVLink_command_long_message(7, 1, 512, 0, 1, 0, 0, 0, 0, 0, 0), 7, True),
        (dialect.MAVLink_command_long_message(7, 1, 511, 0, 1, 0, 0, 0, 0, 0, 0), 7, False),  # it changes a stream
        (dialect.MAVLink_command_int_message(7, 1, 6, 192, 0, 0, 0, 0, 0, 0, 0, 0, 0), 7, False),
        (dialect.MAVLink_set_mode_message(7, 1, 4), 7, False),
        (dialect.MAVLink_manual_control_message(7, 0, 0, 0, 0, 0), 7, False),
        (dialect.MAVLink_param_set_message(7, 1, b"X", 1.0, 9), 7, False),
        (dialect.MAVLink_param_request_list_message(7, 1), 7, True),
        (dialect.MAVLink_mission_request_list_message(7, 1), 7, True),
        (dialect.MAVLink_mission_clear_all_message(7, 1), 7, False),
        (dialect.MAVLink_setup_signing_message(7, 1, [0] * 32, 0), 7, False),
        (dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), None, False),
        (dialect.MAVLink_timesync_message(0, 5), None, False),
        (dialect.MAVLink_ping_message(0, 5, 7, 1), None, False),
        (dialect.MAVLink_system_time_message(0, 5), None, False),
    ],
)
def test_commands_questions_and_what_is_said_to_nobody(message: Message, target: int | None, asks: bool) -> None:
    assert (addressee(frame_of(message)), is_question(frame_of(message))) == (target, asks)
