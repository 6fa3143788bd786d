"""Files that hold a signing key: whoever reads one can fly the swarm, so they must be their owner's alone."""

from __future__ import annotations

import hashlib
import os
import re
import stat
from pathlib import Path
from typing import Final

from fg_gcs.errors import MissionError
from fg_gcs.wire.signing import KEY_BYTES

FORMS: Final = "32 bytes, 64 hexadecimal digits, or a passphrase in one line"
_MOST_BYTES: Final = 4096
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO
_HEXADECIMAL: Final = re.compile(rf"[0-9a-fA-F]{{{2 * KEY_BYTES}}}")


def read_key(path: Path) -> bytes:
    """Return the key that a file holds.

    A line of text is 64 hexadecimal digits, or a passphrase whose SHA-256 is the key, as MAVProxy makes one; anything
    else is the key itself.

    Raises:
        MissionError: It cannot be read, somebody else may read it, or it holds no key.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # nobody is waited for at a pipe
        with os.fdopen(descriptor, "rb") as file:
            mode = os.fstat(descriptor).st_mode
            data = file.read(_MOST_BYTES + 1) if stat.S_ISREG(mode) else b""
    except OSError as error:
        raise MissionError(f"signing key {path}: {error.strerror or error}") from error
    if not stat.S_ISREG(mode):
        raise MissionError(f"signing key {path}: not a file")
    if mode & _OTHERS:
        raise MissionError(f"signing key {path}: others can read it (mode {mode & 0o777:03o}); chmod 600 {path}")
    key = _key_in(data)
    if key is None:
        raise MissionError(f"signing key {path}: it holds no key; accepted: {FORMS}")
    return key


def _key_in(data: bytes) -> bytes | None:
    """Return the key that bytes stand for; None: there is none. All zeros would turn signing off."""
    if len(data) > _MOST_BYTES:
        return None
    try:
        line = re.sub(r"\r?\n\Z", "", data.decode())
    except UnicodeDecodeError:
        line = ""
    if line.strip() and line.isprintable():  # 32 random bytes that read so: one key in 10^17 or less
        data = bytes.fromhex(line) if _HEXADECIMAL.fullmatch(line) else hashlib.sha256(line.encode()).digest()
    return data if len(data) == KEY_BYTES and any(data) else None
