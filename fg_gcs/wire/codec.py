"""MAVLink bytes to messages and back, for one peer address; knows no socket and no clock.

The frame boundaries are found here and not by pymavlink's own stream parser: after a false start byte that parser
swallows up to 280 bytes, and with them whole good frames. Here a frame that does not check out costs one byte, so text
noise (ArduPilot greets in plain text) and cut datagrams lose nothing behind them.
"""

from typing import Any, Final, Protocol

from pymavlink.dialects.v20 import all as dialect

GCS_SYSTEM: Final = 255  # ArduPilot's GCS failsafe listens to heartbeats of this system only
GCS_COMPONENT: Final = 190  # MAV_COMP_ID_MISSIONPLANNER: PX4 explains a refused OFFBOARD only to this component

_MAGIC_V1: Final = 0xFE
_MAGIC_V2: Final = 0xFD
_HEADER_BYTES: Final = {_MAGIC_V1: 6, _MAGIC_V2: 10}
_CHECKSUM_BYTES: Final = 2
_SIGNED: Final = 0x01
_SIGNATURE_BYTES: Final = 13


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

    def get_msgbuf(self) -> bytearray:
        """The whole frame as it was on the wire: what a tlog holds."""

    def get_payload(self) -> bytes:
        """The payload of the frame, trailing zeros cut off."""

    def __getattr__(self, field: str) -> Any: ...  # noqa: ANN401 - a field's type depends on the message


def is_known(message: Message) -> bool:
    """Tell whether the dialect knows this message, so that its sender and fields can be read."""
    return message.get_msgId() >= 0


class Codec:
    """Bytes from one peer address to messages.

    Attributes:
        bad_bytes: Bytes thrown away because no good frame begins there.
        frames: Good frames so far, unknown ones included.
        unknown_messages: Frames whose message id the dialect does not know (PX4 sends some all the time).
    """

    def __init__(self) -> None:
        self.bad_bytes = 0
        self.frames = 0
        self.unknown_messages = 0
        self._buffer = bytearray()
        self._decoder: Any = dialect.MAVLink(None)

    def receive(self, data: bytes) -> list[Message]:
        """Return the messages that ``data`` completes; never raises, whatever the bytes are.

        Unknown messages are among them (see `is_known`), because the log wants their bytes. An unfinished frame is
        kept until the next call.
        """
        self._buffer += data
        messages: list[Message] = []
        start = 0
        while (start := self._next_magic(start)) < len(self._buffer):
            end = self._frame_end(start)
            if end is None:
                self.bad_bytes += 1
                start += 1
            elif end > len(self._buffer):
                break
            elif (message := self._decode(start, end)) is None:
                self.bad_bytes += 1
                start += 1
            else:
                messages.append(message)
                start = end
        del self._buffer[:start]
        self.frames += len(messages)
        return messages

    def restart(self) -> None:
        """Throw an unfinished frame away: what comes next is not its other half, but a new connection's beginning."""
        self.bad_bytes += len(self._buffer)
        self._buffer.clear()

    def _next_magic(self, start: int) -> int:
        """Index of the next byte at or after ``start`` that may begin a frame, else the buffer's length."""
        buffer, found = self._buffer, start
        while found < len(buffer) and buffer[found] not in _HEADER_BYTES:
            found += 1
        self.bad_bytes += found - start
        return found

    def _frame_end(self, start: int) -> int | None:
        """Index behind the frame at ``start`` (may lie beyond the buffer), None if no frame can begin there."""
        buffer = self._buffer
        if len(buffer) < start + 3:
            return start + 3
        end = start + _HEADER_BYTES[buffer[start]] + buffer[start + 1] + _CHECKSUM_BYTES
        if buffer[start] == _MAGIC_V2:
            incompatible = buffer[start + 2]
            if incompatible & ~_SIGNED:
                return None  # MAVLink 2: a frame with unknown incompatibility flags must be dropped
            if incompatible & _SIGNED:
                end += _SIGNATURE_BYTES
        return end

    def _decode(self, start: int, end: int) -> Message | None:
        """Message of the complete frame ``[start, end)``, None if it does not check out."""
        try:
            message: Message = self._decoder.decode(self._buffer[start:end])
        except (dialect.MAVError, ValueError, TypeError):  # checksum, or a field that the message class refuses
            return None
        if not is_known(message):
            # Without the dialect's extra byte its checksum verifies nothing: it counts if a frame, or nothing, follows.
            if end < len(self._buffer) and self._buffer[end] not in _HEADER_BYTES:
                return None
            self.unknown_messages += 1
        return message
