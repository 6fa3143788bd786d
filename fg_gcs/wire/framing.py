"""Where outgoing MAVLink 2 frames are finished, all of them: sequence number, flags, addresses, checksum, signature.

Whoever has a payload gives it to `Sender.finish`, and whoever has those of a whole swarm to a `Round`, so that what
holds for every frame has one home.
"""

import struct
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.codec import GCS_COMPONENT, GCS_SYSTEM, SIGNATURE_BYTES, SIGNED, Message
from fg_gcs.wire.signing import Signature

# (V, size): whole frames of one kind and size, one a row. Where only some of them are signed, the others end with zeros
# in place of a signature, see `as_sent`.
Frames = NDArray[np.uint8]

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
        signature: What signs them; None: they are not signed.
    """

    def __init__(
        self, system_id: int = GCS_SYSTEM, component_id: int = GCS_COMPONENT, signature: Signature | None = None
    ) -> None:
        self.system_id = system_id
        self.component_id = component_id
        self.signature = signature
        self.flags = _NO_FLAGS if signature is None else SIGNED
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
            _pack_header(size, self.flags, _NO_FLAGS, sequence, self.system_id, self.component_id, message_id) + payload
        )
        frame = _MAGIC + body + _pack_checksum(_checksum(body + crc_extra))
        return frame if self.signature is None else frame + self.signature.of(frame)

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
        self._size = size = payloads.shape[1]  # without signatures
        self._signing = [(row, sender.signature) for row, sender in enumerate(senders) if sender.signature is not None]
        room = SIGNATURE_BYTES if self._signing else 0
        self._frames = made = np.pad(payloads, ((0, 0), (0, room)))
        made[:, 0] = _MAGIC[0]
        made[:, 1] = size - HEADER_BYTES - CHECKSUM_BYTES
        made[:, 2] = [sender.flags for sender in senders]
        made[:, 3] = _NO_FLAGS
        made[:, 5] = [sender.system_id for sender in senders]
        made[:, 6] = [sender.component_id for sender in senders]
        made[:, 7:10] = np.frombuffer(message_id, np.uint8)
        made[:, size - CHECKSUM_BYTES] = crc_extra[0]  # behind the payload: the checksum takes it in, then its place

    def frames(self) -> Frames:
        """Return new frames, for what is another in this round to be filled in and for `finish`."""
        return self._frames.copy()

    def finish(self, frames: Frames) -> None:
        """Finish frames in place: what `Sender.finish` does, in one pass."""
        frames[:, 4] = self._numbers()
        data, width, size = frames.tobytes(), frames.shape[1], self._size
        covered = size - CHECKSUM_BYTES
        checksums = [_checksum(data[start : start + covered]) for start in range(1, len(data), width)]
        frames[:, covered:size] = np.array(checksums, "<u2").view(np.uint8).reshape(-1, CHECKSUM_BYTES)
        if self._signing:
            data = frames.tobytes()
            tails = b"".join(signature.of(data[row * width : row * width + size]) for row, signature in self._signing)
            rows = slice(None) if len(self._signing) == len(frames) else [row for row, _ in self._signing]
            frames[rows, size:] = np.frombuffer(tails, np.uint8).reshape(-1, SIGNATURE_BYTES)

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


def as_sent(frames: Frames) -> Frames:
    """Return frames of which none is signed, among others that are: without the room for a signature."""
    return np.ascontiguousarray(frames[:, :-SIGNATURE_BYTES])


def same_for_all(message: LaidOut, senders: Sequence[Sender]) -> Frames:
    """Return the frames of one message to many links, each numbered by its link's sender, shape (V, size)."""
    size = HEADER_BYTES + len(message.payload) + CHECKSUM_BYTES
    payloads = np.zeros((len(senders), size), np.uint8)
    payloads[:, HEADER_BYTES:-CHECKSUM_BYTES] = np.frombuffer(message.payload, np.uint8)
    together = Round(payloads, senders, message.message_id, message.crc_extra)
    frames = together.frames()
    together.finish(frames)
    return frames
