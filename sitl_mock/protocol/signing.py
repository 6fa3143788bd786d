"""MAVLink 2 signing as autopilots do it: strictly rising time stamps, and nothing unsigned but a radio's word."""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path

KEY_BYTES = 32
SIGNATURE_BYTES = 13  # link id, 48 bits of time stamp, 48 bits of digest
SIGNED = 0x01  # the incompatibility flag of a frame that has one
EPOCH_UNIX_S = 1_420_070_400  # 2015-01-01: where time stamps begin
STAMPS_PER_S = 100_000
MOST_STAMP = (1 << 48) - 1
MINUTE_STAMPS = 60 * STAMPS_PER_S
RADIO_STATUS = 109
MOST_KEY_FILE_BYTES = 4096


class SigningTime:
    """What time it is, for all vehicles.

    Args:
        epoch_s: Unix time when simulated time was 0.

    Attributes:
        now_s: simulated time; whoever lets it go on says so.
    """

    def __init__(self, epoch_s: float) -> None:
        self.now_s = 0.0
        self._epoch_s = epoch_s

    def stamp(self) -> int:
        """The present time as a stamp."""
        return max(0, round((self._epoch_s + self.now_s - EPOCH_UNIX_S) * STAMPS_PER_S))


class Signing:
    """What one vehicle knows about signing, whatever the link.

    Args:
        time: of the world.
        key: without one everything is taken, and nothing is signed.

    Attributes:
        refused: frames that were not signed as they should have been, or came again.
    """

    def __init__(self, time: SigningTime, key: bytes | None) -> None:
        self.refused = 0
        self._time = time
        self._key = key
        self._stamp = 0  # the newest, own or heard
        self._newest: dict[tuple[int, int, int], int] = {}  # by link id, system and component

    @property
    def is_on(self) -> bool:
        """Whether frames are signed."""
        return self._key is not None

    def set_up(self, key: bytes, stamp: int) -> None:
        """Take a key, or, where it is all zeros, forget the one that there is."""
        self._key = key if any(key) else None
        self._stamp = max(self._stamp, stamp)

    def signature(self, frame: bytes, link: int) -> bytes:
        """What follows a frame."""
        assert self._key is not None
        self._stamp = min(max(self._stamp + 1, self._time.stamp()), MOST_STAMP)
        tail = bytes([link & 0xFF]) + self._stamp.to_bytes(6, "little")
        return tail + hashlib.sha256(self._key + frame + tail).digest()[:6]

    def takes(self, frame: bytes) -> bool:
        """Whether a good frame is taken; count it if not."""
        if self._key is None or self._is_good(frame, self._key):
            return True
        self.refused += 1
        return False

    def _is_good(self, frame: bytes, key: bytes) -> bool:
        if frame[0] != 0xFD or not frame[2] & SIGNED:
            return frame[0] == 0xFD and int.from_bytes(frame[7:10], "little") == RADIO_STATUS
        if hashlib.sha256(key + frame[:-6]).digest()[:6] != frame[-6:]:
            return False
        stamp, stream = int.from_bytes(frame[-12:-6], "little"), (frame[-13], frame[5], frame[6])
        oldest = self._newest.get(stream)
        if stamp <= (max(self._stamp, self._time.stamp()) - MINUTE_STAMPS if oldest is None else oldest):
            return False
        self._newest[stream] = stamp
        self._stamp = max(self._stamp, stamp)
        return True


def read_key(path: Path) -> bytes:
    """Read a key file: 32 bytes as they are, or a line of text: 64 hexadecimal digits, or a passphrase.

    Raises:
        ValueError: it cannot be read, others may read it, or it holds no key; one line that says which.
    """
    try:
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:  # nobody is waited for at a pipe
            mode = os.fstat(file.fileno()).st_mode
            data = file.read(MOST_KEY_FILE_BYTES + 1) if stat.S_ISREG(mode) else b""
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror or error}") from error
    if mode & 0o077:
        raise ValueError(f"{path}: others can read this key (chmod 600 makes it yours alone)")
    text = data.decode("utf-8", "replace").removesuffix("\n").removesuffix("\r")
    if text.isprintable() and text.strip() and "\ufffd" not in text and len(data) <= MOST_KEY_FILE_BYTES:
        is_hex = len(text) == 2 * KEY_BYTES and all(digit in "0123456789abcdefABCDEF" for digit in text)
        data = bytes.fromhex(text) if is_hex else hashlib.sha256(text.encode()).digest()
    if len(data) != KEY_BYTES or not any(data):
        raise ValueError(f"{path}: no key: 32 bytes, 64 hexadecimal digits or a passphrase in one line is one")
    return data
