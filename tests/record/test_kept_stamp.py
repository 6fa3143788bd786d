import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.record.write.kept_stamp import KEEP_EVERY_S, NAME, RESERVE_S, KeptStamp
from fg_gcs.wire.signing import UNITS_PER_S


def test_nothing_is_kept_at_first(tmp_path: Path) -> None:
    assert KeptStamp(tmp_path).read() == 0


@given(st.lists(st.integers(0, 2**48), min_size=1, max_size=20))
def test_what_is_kept_is_ahead_of_every_stamp_that_was_used(stamps: list[int]) -> None:

    with tempfile.TemporaryDirectory() as folder:
        kept = KeptStamp(Path(folder))
        for stamp in stamps:
            kept.keep(stamp)
        assert KeptStamp(Path(folder)).read() == max(stamps) + int(RESERVE_S * UNITS_PER_S)


def test_a_writing_may_come_late() -> None:
    assert RESERVE_S > 2 * KEEP_EVERY_S


@pytest.mark.parametrize("data", [b"", b"\n", b"-5", b"1e9", b"9" * 40, b"\xff\xfe", b"12 34"])
def test_what_cannot_be_read_is_as_nothing(data: bytes, tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes(data)
    assert KeptStamp(tmp_path).read() == 0


def test_the_folder_is_made(tmp_path: Path) -> None:
    KeptStamp(tmp_path / "a" / "b").keep(7)
    assert [path.name for path in (tmp_path / "a" / "b").iterdir()] == [NAME]
