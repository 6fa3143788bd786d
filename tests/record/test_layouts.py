import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fg_gcs.record.read.tables import MOST_S, read_table
from fg_gcs.record.write.files import TableFile
from fg_gcs.record.write.layouts import LAYOUTS, TELEMETRY, TICKS, Column, TableLayout

WORDS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=4)  # up to 16 bytes
CELLS = {
    "d": st.floats(width=64),
    "i": st.integers(-(2**31), 2**31 - 1),
    "?": st.booleans(),
    "16s": WORDS,
    "32s": WORDS,
}
TIMES = st.floats(-MOST_S, MOST_S)


@st.composite
def tables(draw: st.DrawFn) -> tuple[TableLayout, list[list[float | str]]]:
    kinds = draw(st.lists(st.tuples(st.sampled_from(sorted(CELLS)), st.integers(1, 4)), max_size=4))
    columns = [Column(f"c{k}", code, 1 if code.endswith("s") else width) for k, (code, width) in enumerate(kinds)]
    layout = TableLayout("any", Column("time_s"), *columns)
    cells = [CELLS[column.code] for column in columns for _ in range(column.width)]
    return layout, draw(st.lists(st.tuples(TIMES, *cells).map(list), max_size=20))


def saved(path: Path, layout: TableLayout, rows: list[list[float | str]], *, at_once: bool = True) -> None:
    file = TableFile(path, layout)
    packed = [layout.pack(row) for row in rows]
    for data in [b"".join(packed)] if at_once else packed:
        if data:
            file.write(data, 0.0)
    file.close()


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(tables(), st.booleans())
def test_rows_come_back_as_they_were(
    tmp_path: Path, table: tuple[TableLayout, list[list[float | str]]], at_once: bool
) -> None:
    layout, rows = table
    path = tmp_path / layout.file_name
    saved(path, layout, rows, at_once=at_once)
    columns, remark = read_table(path, layout)
    assert remark is None
    place = 0
    for column in layout.columns:
        cells = [row[place : place + column.width] for row in rows]
        wanted = np.array(cells).reshape(len(rows), column.width)
        found = columns[column.name].reshape(len(rows), column.width)
        if column.code.endswith("s"):
            assert found.tolist() == wanted.tolist()
        else:
            assert np.array_equal(found, wanted.astype(found.dtype), equal_nan=found.dtype.kind == "f")
        place += column.width


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("rows", [0, 1, 100])
def test_numpy_opens_every_table_as_it_is_and_same_rows_give_the_same_bytes(
    tmp_path: Path, layout: TableLayout, rows: int
) -> None:
    random = np.random.default_rng(5)
    cells = {"d": lambda: random.normal(), "i": lambda: 7, "?": lambda: True}
    made = [
        [cells.get(column.code, lambda: "name")() for column in layout.columns for _ in range(column.width)]
        for _ in range(rows)
    ]
    for name in ("first", "second"):
        saved(tmp_path / f"{name}.npy", layout, made, at_once=name == "first")
    loaded = np.load(tmp_path / "first.npy", allow_pickle=False)
    assert loaded.dtype == layout.dtype
    assert len(loaded) == rows
    assert (tmp_path / "first.npy").read_bytes() == (tmp_path / "second.npy").read_bytes()
    assert len(layout.header()) % 64 == 0
    assert layout.row_bytes == layout.dtype.itemsize
    for name, column in layout.table(made).items():
        assert column.tolist() == read_table(tmp_path / "first.npy", layout).columns[name].tolist()


def test_texts_are_cut_between_characters_and_columns_are_text_again() -> None:
    layout = TableLayout("any", Column("time_s"), Column("name", "4s"))
    rows = [(0.0, "abc"), (1.0, "abcdef"), (2.0, "aa€"), (3.0, "a€b"), (4.0, "\ud800"), (5.0, "")]
    assert layout.table(rows)["name"].tolist() == ["abc", "abcd", "aa", "a€", "?", ""]


@pytest.mark.parametrize("row", [(), (1.0,), (1.0, 2.0, 3.0), (1.0, "late"), (1.0, None)])
def test_rows_that_do_not_fit_are_refused(row: tuple[float]) -> None:
    with pytest.raises(struct.error):
        TICKS.pack(row)


def test_rows_that_are_not_counted_yet_are_not_there_yet(tmp_path: Path) -> None:
    path = tmp_path / "ticks.npy"
    saved(path, TICKS, [[1.0, 2.0], [3.0, 4.0]])
    with path.open("ab") as file:
        file.write(TICKS.pack((5.0, 6.0)) + b"a part of one")
    assert np.load(path)["time_s"].tolist() == [1.0, 3.0]
    assert read_table(path, TICKS).columns["late_s"].tolist() == [2.0, 4.0]


def test_columns_are_copies(tmp_path: Path) -> None:
    columns = TELEMETRY.table([(1.0, "main", 1, *[0.0] * 9)])
    columns["position_enu_m"][0] = 9.0
    assert columns["velocity_enu_m_s"][0].tolist() == [0.0, 0.0, 0.0]
