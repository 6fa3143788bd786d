"""MAVLink bytes to messages and back, for one peer address; knows no socket and no clock.

Frames are cut out and checked here and not by pymavlink's own stream parser: after a false start byte that parser
swallows up to 280 bytes, and with them whole good frames. Here a frame that does not check out costs one byte, so text
noise (ArduPilot greets in plain text) and cut datagrams lose nothing behind them.

What a frame says is read only if it is asked for: most kinds never are, those that come often have readers of their
own (`fg_gcs.wire.messages`), pymavlink reads the rest.
"""

import re
from collections.abc import Mapping
from struct import Struct
from types import MappingProxyType
from typing import Any, Final, NamedTuple, Protocol

from fastcrc import crc16
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.messages import READERS

GCS_SYSTEM: Final = 255  # ArduPilot's GCS failsafe listens to heartbeats of this system only
GCS_COMPONENT: Final = 190  # MAV_COMP_ID_MISSIONPLANNER: PX4 explains a refused OFFBOARD only to this component

MAGIC_V2: Final = 0xFD  # first byte of a frame of MAVLink 2

_MAGIC_V1: Final = 0xFE
_find_magic: Final = re.compile(b"[\xfd\xfe]").search
_HEADER_V1_BYTES: Final = 6
_HEADER_V2_BYTES: Final = 10
_CHECKSUM_BYTES: Final = 2
_SIGNED: Final = 0x01
_SIGNATURE_BYTES: Final = 13
# Length, flags that must be understood, flags that need not be, sequence, system, component, message id in two parts
_unpack_v2: Final = Struct("<xBBBBBBHB").unpack_from
_unpack_v1: Final = Struct("<xBBBBB").unpack_from  # the same without flags
_checksum: Final = crc16.mcrf4xx
# The byte of each kind of message that goes into the checksum behind all others, so that both sides mean the same kind
_CRC_EXTRAS: Final[Mapping[int, bytes]] = MappingProxyType(
    {identity: bytes([kind.crc_extra]) for identity, kind in dialect.mavlink_map.items()}
)


class Message(Protocol):
    """One MAVLink message: pymavlink's message class seen through a thin type; fields are plain attributes."""

    def get_msgId(self) -> int:
        """Message id, negative for a message the dialect does not know."""

    def get_type(self) -> str:
        """Name such as ``HEARTBEAT``; ``UNKNOWN_410`` for a message the dialect does not know."""

    def get_srcSystem(self) -> int:
        """System id of the sender."""

    def get_srcComponent(self) -> int:
        """Component id of the sender."""

    def get_msgbuf(self) -> bytes | bytearray:
        """The whole frame as it was on the wire: what a tlog holds."""

    def __getattr__(self, field: str) -> Any: ...  # noqa: ANN401 - a field's type depends on the message


class Frame(NamedTuple):
    """A good frame, which passes for pymavlink's message: its fields are read when they are asked for.

    Whoever reads several of them reads them together, by `fields`.
    """

    raw: bytes  # the whole frame as it was on the wire
    message_id: int
    system_id: int  # of the sender, as the component
    component_id: int
    payload: bytes  # trailing zeros may be cut off

    def fields(self) -> Any:  # noqa: ANN401 - depends on the message
        """Return what a known message says: one of `fg_gcs.wire.messages`, or else pymavlink's own object."""
        read = READERS.get(self.message_id)
        return dialect.MAVLink(None).decode(bytearray(self.raw)) if read is None else read(self.payload)

    def get_msgId(self) -> int:
        """Message id, negative for a message the dialect does not know."""
        return self.message_id if self.message_id in _CRC_EXTRAS else dialect.MAVLINK_MSG_ID_UNKNOWN

    def get_type(self) -> str:
        """Name such as ``HEARTBEAT``; ``UNKNOWN_410`` for a message the dialect does not know."""
        kind = dialect.mavlink_map.get(self.message_id)
        return f"UNKNOWN_{self.message_id}" if kind is None else kind.msgname

    def get_seq(self) -> int:
        """Sequence number."""
        return self.raw[4] if self.raw[0] == MAGIC_V2 else self.raw[2]

    def get_srcSystem(self) -> int:
        """System id of the sender."""
        return self.system_id

    def get_srcComponent(self) -> int:
        """Component id of the sender."""
        return self.component_id

    def get_msgbuf(self) -> bytes:
        """The whole frame as it was on the wire: what a tlog holds."""
        return self.raw

    def __getattr__(self, field: str) -> Any:  # noqa: ANN401 - a field's type depends on the message
        if not is_known(self):
            raise AttributeError(field)
        return getattr(self.fields(), field)


def is_known(frame: Frame) -> bool:
    """Tell whether the dialect knows this message, so that its fields can be read."""
    return frame.message_id in _CRC_EXTRAS


class Codec:
    """Bytes from one peer address to frames.

    Attributes:
        bad_bytes: Bytes thrown away because no good frame begins there.
        frames: Good frames so far, unknown ones included.
        unknown_messages: Frames whose message id the dialect does not know (PX4 sends some all the time).
    """

    def __init__(self) -> None:
        self.bad_bytes = 0
        self.frames = 0
        self.unknown_messages = 0
        self._rest = b""

    def receive(self, data: bytes) -> list[Frame]:
        """Return the frames that ``data`` completes; never raises, whatever the bytes are.

        Unknown messages are among them (see `is_known`), because the log wants their bytes. An unfinished frame is
        kept until the next call.
        """
        buffer = self._rest + data if self._rest else data
        size = len(buffer)
        frames: list[Frame] = []
        start = 0
        while start < size:
            magic = buffer[start]
            if magic not in (_MAGIC_V1, MAGIC_V2):
                found = _find_magic(buffer, start)
                after = size if found is None else found.start()
                self.bad_bytes += after - start
                start = after
                continue
            end = _frame_end(buffer, start)
            if end is not None and end > size:
                break
            frame = None if end is None else self._frame(buffer, start, end)
            if end is None or frame is None:
                self.bad_bytes += 1
                start += 1
            else:
                frames.append(frame)
                start = end
        self._rest = buffer[start:]
        self.frames += len(frames)
        return frames

    def restart(self) -> None:
        """Throw an unfinished frame away: what comes next is not its other half, but a new connection's beginning."""
        self.bad_bytes += len(self._rest)
        self._rest = b""

    def _frame(self, buffer: bytes, start: int, end: int) -> Frame | None:
        """Frame of the complete bytes ``[start, end)``, None if it does not check out."""
        if buffer[start] == MAGIC_V2:
            length, _, _, _, system_id, component_id, low, high = _unpack_v2(buffer, start)
            message_id, begin = low | high << 16, start + _HEADER_V2_BYTES
        else:
            length, _, system_id, component_id, message_id = _unpack_v1(buffer, start)
            begin = start + _HEADER_V1_BYTES
        behind, crc_extra = begin + length, _CRC_EXTRAS.get(message_id)
        if crc_extra is None:
            # Without the dialect's extra byte its checksum verifies nothing: it counts if a frame, or nothing, follows.
            if end < len(buffer) and buffer[end] not in (_MAGIC_V1, MAGIC_V2):
                return None
            self.unknown_messages += 1
        elif _checksum(buffer[start + 1 : behind] + crc_extra) != buffer[behind] | buffer[behind + 1] << 8:
            return None
        return Frame(buffer[start:end], message_id, system_id, component_id, buffer[begin:behind])


def _frame_end(buffer: bytes, start: int) -> int | None:
    """Index behind the frame at ``start`` (may lie beyond the buffer), None if no frame can begin there."""
    if len(buffer) < start + 3:
        return start + 3
    if buffer[start] == _MAGIC_V1:
        return start + _HEADER_V1_BYTES + buffer[start + 1] + _CHECKSUM_BYTES
    end = start + _HEADER_V2_BYTES + buffer[start + 1] + _CHECKSUM_BYTES
    incompatible = buffer[start + 2]
    if incompatible == 0:
        return end
    # MAVLink 2: a frame with unknown incompatibility flags must be dropped
    return end + _SIGNATURE_BYTES if incompatible == _SIGNED else None
