"""What was learnt of firmwares outlives a run, and nothing that lies in the folder harms one."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fg_gcs.record.write.kept_calibrations import MOST_KEPT, NAME, Calibration, KeptCalibrations

numbers = st.floats(0.0, 10.0)


@given(st.dictionaries(st.text(max_size=20), st.builds(Calibration, numbers, numbers, numbers), max_size=5))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_is_kept_is_read(tmp_path: Path, found: dict[str, Calibration]) -> None:
    kept = KeptCalibrations(tmp_path / "state")
    kept.keep(found)
    assert {name: kept.read()[name] for name in found} == found


def test_others_stay_and_the_oldest_are_forgotten(tmp_path: Path) -> None:
    kept, one = KeptCalibrations(tmp_path), Calibration(0.3, 1.0, 0.1)
    for k in range(MOST_KEPT + 3):
        kept.keep({f"firmware {k}": one._replace(lag_s=0.001 * k)})
    assert list(kept.read()) == [f"firmware {k}" for k in range(3, MOST_KEPT + 3)]
    assert list(tmp_path.iterdir()) == [tmp_path / NAME]


@pytest.mark.parametrize(
    "data",
    [b"", b"\xff", b"[]", b"3", b'{"a": 3}', b'{"a": {"wander_m": 1}}', b'{"a": null}', b"{" * 70_000]
    + [b'{"a": {"wander_m": %s, "drag_per_s": 0, "lag_s": 0}}' % bad for bad in (b"-1", b"NaN", b"Infinity", b'"x"')],
)
def test_what_cannot_be_read_is_not_there(data: bytes, tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes(data)
    assert KeptCalibrations(tmp_path).read() == {}
