"""Where outgoing MAVLink 2 frames are finished, all of them: sequence number, flags, addresses and checksum.

Whoever has a payload gives it to `Sender.finish`, and whoever has those of a whole swarm to a `Round`, so that what
holds for every frame, such as a signature, has one home.
"""

import struct
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.codec import GCS_COMPONENT, GCS_SYSTEM, Message

Frames = NDArray[np.uint8]  # (V, size): whole frames of one kind and size, one a row

HEADER_BYTES: Final = 10
CHECKSUM_BYTES: Final = 2

_MAGIC: Final = b"\xfd"
_NO_FLAGS: Final = 0
# Length, incompatible and compatible flags, sequence, system, component, message id: what the checksum covers as well.
_pack_header: Final = struct.Struct("<BBBBBB3s").pack  # bound once: one attribute lookup less for every frame
_pack_checksum: Final = struct.Struct("<H").pack
_checksum: Final = crc16.mcrf4xx
_packer: Final[Any] = dialect.MAVLink(None)


def id_bytes(message_id: int) -> bytes:
    """Return a message id as it stands in a header: three bytes, the low one first."""
    return message_id.to_bytes(3, "little")


class Counts:
    """The next sequence numbers of links that often send together, side by side: one pass of an array takes them all.

    Attributes:
        numbers: 0 to 255, one a link.
        is_whole: All links that began here still count here.
    """

    __slots__ = ("is_whole", "numbers")

    def __init__(self, count: int) -> None:
        self.numbers = bytearray(count)
        self.is_whole = True


class Sender:
    """Numbers and finishes outgoing MAVLink 2 frames for one link.

    Args:
        system_id: Our system id.
        component_id: Our component id.
    """

    def __init__(self, system_id: int = GCS_SYSTEM, component_id: int = GCS_COMPONENT) -> None:
        self.system_id = system_id
        self.component_id = component_id
        self._counts, self._place = Counts(1), 0  # around and around: peers count losses by the gaps

    def next_sequence(self) -> int:
        """Return the sequence number of the frame that leaves next, and count it."""
        numbers, place = self._counts.numbers, self._place
        sequence = numbers[place]
        numbers[place] = (sequence + 1) & 0xFF
        return sequence

    def count_in(self, counts: Counts, place: int) -> None:
        """Go on counting at a place of a table."""
        counts.numbers[place] = self._counts.numbers[self._place]
        self._counts.is_whole = False
        self._counts, self._place = counts, place

    def finish(self, message_id: bytes, crc_extra: bytes, payload: bytes) -> bytes:
        """Return the whole frame around a payload, with the next sequence number.

        Args:
            message_id: See `id_bytes`.
            crc_extra: The dialect's extra byte of this kind of message, which goes into the checksum.
            payload: Without trailing zeros, except that the first byte always stays.
        """
        size, sequence = len(payload), self.next_sequence()
        body = (
            _pack_header(size, _NO_FLAGS, _NO_FLAGS, sequence, self.system_id, self.component_id, message_id) + payload
        )
        return _MAGIC + body + _pack_checksum(_checksum(body + crc_extra))

    def pack(self, message: Message) -> bytes:
        """Return the frame of ``message``.

        Raises:
            struct.error: A field cannot hold its number; no sequence number is used.
        """
        return self.finish(*laid_out(message))


class LaidOut(NamedTuple):
    """What of a message is the same for every link: what `Sender.finish` takes."""

    message_id: bytes
    crc_extra: bytes
    payload: bytes


def laid_out(message: Message) -> LaidOut:
    """Return the payload of a message.

    Raises:
        struct.error: A field cannot hold its number.
    """
    message.pack(_packer)  # pymavlink lays out the payload only when it packs a whole frame of its own
    return LaidOut(id_bytes(message.get_msgId()), bytes([message.crc_extra]), bytes(message.get_payload()))


class Round:
    """Frames of one kind and size, each for a link of its own, that leave together again and again.

    Args:
        payloads: What is the same in every round stands in its place already, the rest is zero; shape (V, size). No
            payload may end with a zero.
        senders: Of the frames' links, in their order; a link that has several frames numbers them in that order.
        message_id: See `id_bytes`.
        crc_extra: The dialect's extra byte of this kind of message.
    """

    def __init__(self, payloads: Frames, senders: Sequence[Sender], message_id: bytes, crc_extra: bytes) -> None:
        self._senders = senders
        self._counts: Counts | None = None  # once they count side by side
        self._frames = made = payloads.copy()
        made[:, 0] = _MAGIC[0]
        made[:, 1] = made.shape[1] - HEADER_BYTES - CHECKSUM_BYTES
        made[:, 2:4] = _NO_FLAGS
        made[:, 5] = [sender.system_id for sender in senders]
        made[:, 6] = [sender.component_id for sender in senders]
        made[:, 7:10] = np.frombuffer(message_id, np.uint8)
        made[:, -2] = crc_extra[0]  # right behind the payload, where the checksum takes it in and then its place

    def frames(self) -> Frames:
        """Return new frames, for what is another in this round to be filled in and for `finish`."""
        return self._frames.copy()

    def finish(self, frames: Frames) -> None:
        """Finish frames in place: what `Sender.finish` does, in one pass."""
        frames[:, 4] = self._numbers()
        data, size = frames.tobytes(), frames.shape[1]
        covered = size - CHECKSUM_BYTES
        checksums = [_checksum(data[start : start + covered]) for start in range(1, len(data), size)]
        frames[:, -2:] = np.array(checksums, "<u2").view(np.uint8).reshape(-1, CHECKSUM_BYTES)

    def _numbers(self) -> NDArray[np.uint8] | list[int]:
        """Return the next sequence numbers, and count them."""
        if self._counts is None or not self._counts.is_whole:
            if len(set(map(id, self._senders))) < len(self._senders):
                return [sender.next_sequence() for sender in self._senders]
            self._counts = Counts(len(self._senders))
            for place, sender in enumerate(self._senders):
                sender.count_in(self._counts, place)
        counting = np.frombuffer(self._counts.numbers, np.uint8)
        numbers = counting.copy()
        counting += 1  # and around
        return numbers


def same_for_all(message: LaidOut, senders: Sequence[Sender]) -> Frames:
    """Return the frames of one message to many links, each numbered by its link's sender, shape (V, size)."""
    size = HEADER_BYTES + len(message.payload) + CHECKSUM_BYTES
    payloads = np.zeros((len(senders), size), np.uint8)
    payloads[:, HEADER_BYTES:-CHECKSUM_BYTES] = np.frombuffer(message.payload, np.uint8)
    together = Round(payloads, senders, message.message_id, message.crc_extra)
    frames = together.frames()
    together.finish(frames)
    return frames
