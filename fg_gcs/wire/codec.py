"""MAVLink bytes to messages and back, for one peer address; knows no socket and no clock.

Frames are cut out and checked here and not by pymavlink's own stream parser: after a false start byte that parser
swallows up to 280 bytes, and with them whole good frames. Here a frame that does not check out costs one byte, so text
noise (ArduPilot greets in plain text) and cut datagrams lose nothing behind them. Reading may stop after some work and
go on later, so that no bytes, however many or hostile, hold a loop up.

What a frame says is read only if it is asked for: most kinds never are, those that come often have readers of their
own (`fg_gcs.wire.messages`), pymavlink reads the rest.
"""

import math
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

MAGIC_V2: Final = 0xFD  # the first byte of a frame of MAVLink 2
SIGNED: Final = 0x01  # the flag that must be understood of a frame with a signature
SIGNATURE_BYTES: Final = 13  # link id, time stamp and signature, behind the checksum
FALSE_START_WORK: Final = 1  # what a byte costs at which no frame begins: some two microseconds
FRAME_WORK: Final = 8  # what a good frame costs, with all that is done with it

_MAGIC_V1: Final = 0xFE
_MAGICS: Final = (_MAGIC_V1, MAGIC_V2)
_find_magic: Final = re.compile(b"[\xfd\xfe]").search
_HEADER_V1_BYTES: Final = 6
_HEADER_V2_BYTES: Final = 10
_CHECKSUM_BYTES: Final = 2
# Length, flags that must be understood, flags that need not be, sequence, system, component, message id in two parts
_unpack_v2: Final = Struct("<xBBBBBBHB").unpack_from
_unpack_v1: Final = Struct("<xBBBBB").unpack_from  # the same without flags
_checksum: Final = crc16.mcrf4xx
# The byte of each kind of message that goes into the checksum behind all others, so that both sides mean the same kind
_CRC_EXTRAS: Final[Mapping[int, bytes]] = MappingProxyType(
    {identity: bytes([kind.crc_extra]) for identity, kind in dialect.mavlink_map.items()}
)
_LENGTHS: Final[Mapping[int, int]] = (
    MappingProxyType(  # the longest payload of each kind that the dialect knows [bytes]
        {identity: kind.unpacker.size for identity, kind in dialect.mavlink_map.items()}
    )
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

    Args:
        datagrams: The bytes come in datagrams, each of which holds whole frames: what is cut off at the end of one was
            never a frame. Otherwise they are a stream, and an unfinished frame waits for its other half.

    Attributes:
        bad_bytes: Bytes thrown away because no good frame begins there.
        frames: Good frames so far, unknown ones included.
        unknown_messages: Frames whose message id the dialect does not know (PX4 sends some all the time).
        waiting: Reading has stopped early, see `receive`.
    """

    def __init__(self, *, datagrams: bool = False) -> None:
        self.bad_bytes = 0
        self.frames = 0
        self.unknown_messages = 0
        self.waiting = False
        self._datagrams = datagrams
        self._buffer = b""
        self._start = 0  # of what is not read yet

    def receive(self, data: bytes, most_work: float = math.inf) -> list[Frame]:
        """Return the frames that ``data`` completes; never raises, whatever the bytes are.

        Unknown messages are among them (see `is_known`), because the log wants their bytes. A frame with flags that
        must be understood and are not is dropped whole: what its payload holds was said to somebody else.

        Args:
            data: What has come, or nothing to go on with what waits. While something waits, no new datagram is taken.
            most_work: Stop after so much work, in `FALSE_START_WORK` and `FRAME_WORK`; what is left then waits.
        """
        buffer, start = data, 0
        if self._buffer:
            buffer, start = (self._buffer[self._start :] + data, 0) if data else (self._buffer, self._start)
        size, bad_bytes, look = len(buffer), 0, self._look
        frames: list[Frame] = []
        while start < size and most_work > 0:
            found = look(buffer, start, size)
            if found.__class__ is Frame:
                frames.append(found)
                start += len(found.raw)
                most_work -= FRAME_WORK
            elif found:
                bad_bytes += found  # type: ignore[operator] # no frame, so a number; `isinstance` takes far longer
                start += found  # type: ignore[operator]
                most_work -= FALSE_START_WORK
            else:
                break
        if frames:
            self.frames += len(frames)
        if bad_bytes:
            self.bad_bytes += bad_bytes
        if start == size:
            self._buffer, self.waiting = b"", False
        else:
            self.waiting = most_work <= 0
            self._buffer, self._start = (buffer, start) if self.waiting else (buffer[start:], 0)
        return frames

    def restart(self) -> None:
        """Throw an unfinished frame away: what comes next is not its other half, but a new connection's beginning."""
        if self._buffer:
            self.bad_bytes += len(self._buffer) - self._start
        self._buffer, self.waiting = b"", False

    def _look(self, buffer: bytes, start: int, size: int) -> Frame | int:
        """Return what begins at ``start``: a frame, or so many bytes that are none; 0 where more must come to tell."""
        magic = buffer[start]
        if magic == MAGIC_V2:
            begin = start + _HEADER_V2_BYTES
            if begin > size:
                return self._datagrams
            length, flags, _, _, system_id, component_id, low, high = _unpack_v2(buffer, start)
            message_id = low | high << 16
        elif magic == _MAGIC_V1:
            begin, flags = start + _HEADER_V1_BYTES, 0
            if begin > size:
                return self._datagrams
            length, _, system_id, component_id, message_id = _unpack_v1(buffer, start)
        else:
            found = _find_magic(buffer, start)
            return (size if found is None else found.start()) - start
        behind = begin + length
        end = behind + _CHECKSUM_BYTES
        crc_extra = _CRC_EXTRAS.get(message_id)
        if flags:
            end += SIGNATURE_BYTES if flags & SIGNED else 0
            if flags != SIGNED:
                return self._flagged(buffer, start, behind, end, crc_extra)
        if end > size:
            if self._datagrams:
                return 1
            # A stream: wait for the rest, unless this looks like no frame and good ones are held back by it
            waits = length <= _LENGTHS.get(message_id, -1) or not self._good_frame_behind(buffer, start, size)
            return 0 if waits else 1
        if crc_extra is None:
            # Without the dialect's extra byte its checksum verifies nothing: it counts if a frame, or nothing, follows.
            if end < size and buffer[end] not in _MAGICS:
                return 1
            self.unknown_messages += 1
        elif _checksum(buffer[start + 1 : behind] + crc_extra) != buffer[behind] | buffer[behind + 1] << 8:
            return 1
        return Frame(buffer[start:end], message_id, system_id, component_id, buffer[begin:behind])

    def _flagged(self, buffer: bytes, start: int, behind: int, end: int, crc_extra: bytes | None) -> int:
        """Return how many bytes a frame takes that has unknown flags, one if these bytes are none; 0: see `_look`.

        The flags may change its checksum as well, so it counts, too, if a frame, or nothing, follows.
        """
        size = len(buffer)
        if end > size:
            return int(self._datagrams)
        is_right = crc_extra is not None and _checksum(buffer[start + 1 : behind] + crc_extra) == int.from_bytes(
            buffer[behind : behind + _CHECKSUM_BYTES], "little"
        )
        return end - start if is_right or end == size or buffer[end] in _MAGICS else 1

    @classmethod
    def _good_frame_behind(cls, buffer: bytes, start: int, size: int) -> bool:
        """Tell whether a whole known frame that checks out begins somewhere behind ``start``."""
        probe = cls(datagrams=True)
        found = _find_magic(buffer, start + 1)
        while found is not None:
            frame = probe._look(buffer, found.start(), size)
            if isinstance(frame, Frame) and is_known(frame):
                return True
            found = _find_magic(buffer, found.start() + 1)
        return False
