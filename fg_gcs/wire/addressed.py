"""What another station wants of a vehicle, as far as the frame tells: whom it is for, and whether it only asks."""

from types import MappingProxyType
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.codec import Frame, is_known
from fg_gcs.wire.messages import READERS

_TARGETS: Final = MappingProxyType(  # the field that names the vehicle, by message; said to everybody: none
    {
        identity: next(name for name in ("target_system", "target") if name in kind.fieldnames)
        for identity, kind in dialect.mavlink_map.items()
        if {"target_system", "target"} & set(kind.fieldnames)
        and identity not in READERS
        and identity not in (dialect.MAVLINK_MSG_ID_PING, dialect.MAVLINK_MSG_ID_COMMAND_ACK)
    }
)
_QUESTIONS: Final = frozenset(
    {
        dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
        dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
        dialect.MAVLINK_MSG_ID_MISSION_REQUEST_LIST,
        dialect.MAVLINK_MSG_ID_MISSION_REQUEST,
        dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
        dialect.MAVLINK_MSG_ID_MISSION_ACK,
        dialect.MAVLINK_MSG_ID_LOG_REQUEST_LIST,
    }
)
_COMMANDS: Final = frozenset({dialect.MAVLINK_MSG_ID_COMMAND_LONG, dialect.MAVLINK_MSG_ID_COMMAND_INT})
_ASKING_COMMANDS: Final = frozenset(
    {
        dialect.MAV_CMD_GET_MESSAGE_INTERVAL,
        dialect.MAV_CMD_REQUEST_MESSAGE,
        dialect.MAV_CMD_REQUEST_PROTOCOL_VERSION,
        dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
        dialect.MAV_CMD_GET_HOME_POSITION,
    }
)


def addressee(frame: Frame) -> int | None:
    """Return the system id that a frame is for, 0: for all; None: it is said to nobody in particular, as heartbeats."""
    field = _TARGETS.get(frame.message_id)
    target: int | None = None if field is None else getattr(frame, field)
    return target


def is_question(frame: Frame) -> bool:
    """Tell whether a frame asks a vehicle for what it knows, and changes nothing."""
    if frame.message_id in _COMMANDS:
        return is_known(frame) and frame.command in _ASKING_COMMANDS
    return frame.message_id in _QUESTIONS
