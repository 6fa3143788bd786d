from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.record.write.table import SETPOINTS, TELEMETRY, TICKS, Table, load

WIDTHS = st.dictionaries(st.from_regex(r"[a-z]{1,8}", fullmatch=True), st.integers(1, 4), min_size=1, max_size=5)
NUMBERS = st.floats(width=64)


@given(st.data(), WIDTHS)
def test_rows_come_back_as_columns(data: st.DataObject, widths: dict[str, int]) -> None:
    width = sum(widths.values())
    rows = data.draw(st.lists(st.lists(NUMBERS, min_size=width, max_size=width), max_size=20))
    table = Table(widths)
    for row in rows:
        table.append(row)
    columns = table.columns()
    assert list(columns) == list(widths)
    flat = [column.reshape(len(rows), widths[name]) for name, column in columns.items()]
    assert np.array_equal(np.concatenate(flat, axis=1), np.array(rows).reshape(-1, width), equal_nan=True)
    assert all(column.ndim == (1 if widths[name] == 1 else 2) for name, column in columns.items())


@pytest.mark.parametrize("widths", [TELEMETRY, SETPOINTS, TICKS])
@pytest.mark.parametrize("rows", [0, 1, 100])
def test_saved_tables_load_as_they_were_and_same_rows_give_the_same_bytes(
    tmp_path: Path, widths: dict[str, int], rows: int
) -> None:
    random = np.random.default_rng(5)
    cells = random.normal(size=(rows, sum(widths.values())))
    cells[: rows // 2, -1] = np.nan
    for name in ("first", "second"):
        table = Table(widths)
        for row in cells.tolist():
            table.append(row)
        table.save(tmp_path / f"{name}.npz")
    loaded = load(tmp_path / "first.npz")
    assert list(loaded) == list(widths)
    for name, column in table.columns().items():
        assert np.array_equal(loaded[name], column, equal_nan=True)
    assert (tmp_path / "first.npz").read_bytes() == (tmp_path / "second.npz").read_bytes()


def test_columns_are_copies() -> None:
    table = Table(TICKS)
    table.append((1.0, 2.0))
    table.columns()["time_s"][0] = 9.0
    assert table.columns()["time_s"][0] == 1.0
    table.append((3.0, 4.0))  # an exported buffer would refuse to grow
    assert table.columns()["late_s"].tolist() == [2.0, 4.0]


def test_what_is_no_table_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="missing"):
        load(tmp_path / "missing.npz")
    path = tmp_path / "table.npz"
    table = Table(TICKS)
    for k in range(100):
        table.append((k * 0.1, k**0.5))
    table.save(path)
    whole = path.read_bytes()
    middle = len(whole) // 4  # in the compressed numbers
    for damaged in (b"", b"these are words", whole[:-30], whole[:middle] + bytes(20) + whole[middle + 20 :]):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"table\.npz: damaged"):
            load(path)
    np.save(path.with_suffix(".npy"), np.zeros(3))
    with pytest.raises(ValueError, match="damaged"):
        load(path.with_suffix(".npy"))
