"""Where outgoing MAVLink 2 frames are finished, all of them: sequence number, flags, addresses and checksum.

Whoever has a payload gives it to `Sender.finish`, the hot path of setpoints (`fg_gcs.wire.setpoint`) as well, so that
what holds for every frame, such as a signature, has one home.
"""

import struct
from typing import Any, Final

from fastcrc import crc16
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.codec import GCS_COMPONENT, GCS_SYSTEM, Message

_MAGIC: Final = b"\xfd"
_NO_FLAGS: Final = 0
# Length, incompatible and compatible flags, sequence, system, component, message id: what the checksum covers as well.
_pack_header: Final = struct.Struct("<BBBBBB3s").pack  # bound once: one attribute lookup less for every setpoint
_pack_checksum: Final = struct.Struct("<H").pack
_checksum: Final = crc16.mcrf4xx


def id_bytes(message_id: int) -> bytes:
    """Return a message id as it stands in a header: three bytes, the low one first."""
    return message_id.to_bytes(3, "little")


class Sender:
    """Numbers and finishes outgoing MAVLink 2 frames for one link.

    Args:
        system_id: Our system id.
        component_id: Our component id.
    """

    def __init__(self, system_id: int = GCS_SYSTEM, component_id: int = GCS_COMPONENT) -> None:
        self.system_id = system_id
        self.component_id = component_id
        self._sequence = 0  # 0 to 255, around and around: peers count losses by its gaps
        self._packer: Any = dialect.MAVLink(None)

    def finish(self, message_id: bytes, crc_extra: bytes, payload: bytes) -> bytes:
        """Return the whole frame around a payload, with the next sequence number.

        Args:
            message_id: See `id_bytes`.
            crc_extra: The dialect's extra byte of this kind of message, which goes into the checksum.
            payload: Without trailing zeros, except that the first byte always stays.
        """
        sequence = self._sequence
        self._sequence = (sequence + 1) & 0xFF
        body = (
            _pack_header(len(payload), _NO_FLAGS, _NO_FLAGS, sequence, self.system_id, self.component_id, message_id)
            + payload
        )
        return _MAGIC + body + _pack_checksum(_checksum(body + crc_extra))

    def pack(self, message: Message) -> bytes:
        """Return the frame of ``message``.

        Raises:
            struct.error: A field cannot hold its number; no sequence number is used.
        """
        message.pack(self._packer)  # pymavlink lays out the payload only when it packs a whole frame of its own
        return self.finish(id_bytes(message.get_msgId()), bytes([message.crc_extra]), bytes(message.get_payload()))
