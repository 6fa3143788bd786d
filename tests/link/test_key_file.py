import hashlib
import os
from pathlib import Path

import pytest

from fg_gcs.errors import MissionError
from fg_gcs.link.key_file import read_key
from sitl_mock import read_key as read_key_of_the_simulator

RAW = bytes(range(200, 232))


def written(tmp_path: Path, data: bytes, mode: int = 0o600) -> Path:
    path = tmp_path / "swarm.key"
    path.write_bytes(data)
    path.chmod(mode)
    return path


@pytest.mark.parametrize(
    ("data", "key"),
    [
        (RAW, RAW),
        (RAW.hex().encode(), RAW),
        (RAW.hex().upper().encode() + b"\n", RAW),
        (b"correct horse battery staple\n", hashlib.sha256(b"correct horse battery staple").digest()),
        (b"a line of 31 letters, and return\n"[1:], hashlib.sha256(b" line of 31 letters, and return").digest()),
        ("Zürich\r\n".encode(), hashlib.sha256("Zürich".encode()).digest()),
        (b"00" * 31, hashlib.sha256(b"00" * 31).digest()),
    ],
)
def test_both_sides_read_every_form_alike(data: bytes, key: bytes, tmp_path: Path) -> None:
    path = written(tmp_path, data)
    assert read_key(path) == key
    assert read_key_of_the_simulator(path) == key


@pytest.mark.parametrize(
    "data", [b"", b"\n", b"   ", b"two\nlines\n", bytes(32), b"00" * 32, RAW[1:], RAW + b"\0", b"x" * 5000]
)
def test_what_is_no_key_is_refused_with_the_forms(data: bytes, tmp_path: Path) -> None:
    path = written(tmp_path, data)
    with pytest.raises(
        MissionError, match="it holds no key; accepted: 32 bytes, 64 hexadecimal digits, or a passphrase"
    ):
        read_key(path)
    with pytest.raises(ValueError, match="no key: 32 bytes"):
        read_key_of_the_simulator(path)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o644, 0o660, 0o610, 0o601, 0o602, 0o777])
def test_a_key_that_others_can_have_is_refused(mode: int, tmp_path: Path) -> None:
    path = written(tmp_path, RAW, mode)
    with pytest.raises(MissionError, match=rf"others can read it \(mode {mode:03o}\); chmod 600 .*swarm.key"):
        read_key(path)
    with pytest.raises(ValueError, match="others can read this key"):
        read_key_of_the_simulator(path)


def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match="No such file"):
        read_key(tmp_path / "nothing")
    with pytest.raises(MissionError, match="Is a directory"):
        read_key(tmp_path)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe, 0o600)
    with pytest.raises(MissionError, match="not a file"):
        read_key(pipe)
    with pytest.raises(ValueError, match="no key"):
        read_key_of_the_simulator(pipe)
