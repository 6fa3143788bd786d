"""A table of a run read back: what is there, and a line about what is not."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from fg_gcs.record.read.regular import regular
from fg_gcs.record.write.layouts import Columns, TableLayout
from fg_gcs.wire.address import VehicleAddress

MOST_S = 1e6  # since the start of a run: eleven days; a later time is none
VERSION = (1, 0)  # of NumPy's format
CHUNK_ROWS = 50_000  # read at once: an hour's table is never in memory twice


class ReadTable(NamedTuple):
    """A table's columns and what is wrong with its file, None if nothing is."""

    columns: Columns
    remark: str | None


def vehicles_in(columns: Columns) -> tuple[VehicleAddress, ...]:
    """Return the vehicles that a table with networks and system ids has rows of, ascending."""
    networks = np.unique(columns["network"]).tolist()
    ids = {name: np.unique(columns["system_id"][columns["network"] == name]).tolist() for name in networks}
    return tuple(VehicleAddress(name, system_id) for name in networks for system_id in ids[name])


def rows_of(columns: Columns, vehicle: VehicleAddress) -> NDArray[np.bool_]:
    """Return which rows of such a table are a vehicle's, shape (rows,)."""
    rows: NDArray[np.bool_] = (columns["system_id"] == vehicle.system_id) & (columns["network"] == vehicle.network)
    return rows


def read_table(path: Path, layout: TableLayout) -> ReadTable:
    """Read a table; rows that cannot be read are left out, and the remark says so. Never raises, whatever lies there.

    Args:
        path: of the file.
        layout: columns that it should have; those that are missing, in rows of an older version, have no values: NaN,
            0, or no text.
    """
    nothing = layout.columns_of(np.zeros(0, layout.dtype))
    try:
        with regular(path).open("rb") as file:
            cells, missing = _cells(file, layout)
    except OSError as error:
        return ReadTable(nothing, f"{path.name}: cannot be read: {error.strerror or error}")
    except Exception as error:  # NumPy's parser raises whatever Python's does: strange bytes are no fault of ours
        return ReadTable(nothing, f"{path.name}: not a table of {layout.name}: {' '.join(str(error).split())[:200]}")
    good = np.isfinite(cells["time_s"]) & (np.abs(cells["time_s"]) <= MOST_S)
    remarks = [] if missing is None else [missing]
    if not good.all():
        remarks.append(f"{np.count_nonzero(~good)} rows with an impossible time are left out")
        cells = {name: column[good] for name, column in cells.items()}
    remark = f"{path.name}: {'; '.join(remarks)}" if remarks else None
    return ReadTable(layout.columns_of(cells), remark)


def _cells(file: IO[bytes], layout: TableLayout) -> tuple[dict[str, NDArray[Any]], str | None]:
    """Return the columns of the rows that are there, in the layout's types, and how many more the header promises.

    Raises:
        Exception: the header is not that of such a table.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if npy.read_magic(file) != VERSION:
            raise ValueError("written in an unknown version of the format")
        shape, _, dtype = npy.read_array_header_1_0(file)  # parses literals only: nothing in it is ever run
    if len(shape) != 1 or dtype.names is None or dtype.hasobject or not dtype.itemsize:
        raise ValueError("its rows are not records")
    names = [column.name for column in layout.columns]
    wrong = [name for name in names if name in dtype.names and not _fits(dtype, layout.dtype, name)]
    absent = [name for name in names if name not in dtype.names]
    if wrong or "time_s" in absent or len(absent) > len(layout.columns) // 2:
        raise ValueError(f"the column {(wrong or absent)[0]} is {'another' if wrong else 'missing'}")
    there = (os.fstat(file.fileno()).st_size - file.tell()) // dtype.itemsize
    count = min(int(shape[0]), there)
    cells = {name: np.zeros((count, *layout.dtype[name].shape), layout.dtype[name].base) for name in names}
    for begin in range(0, count, CHUNK_ROWS):
        end = min(begin + CHUNK_ROWS, count)
        found = np.frombuffer(file.read((end - begin) * dtype.itemsize), dtype)
        for name in dtype.names:
            if name in cells:
                cells[name][begin:end] = found[name]
    for name in absent:
        if cells[name].dtype.kind == "f":
            cells[name][:] = np.nan
    remarks = [f"cut off: {count} of {shape[0]} rows are there"] if count < shape[0] else []
    remarks += [f"the column {name} is missing" for name in absent]
    return cells, "; ".join(remarks) or None


def _fits(found: np.dtype[Any], wanted: np.dtype[Any], name: str) -> bool:
    """Tell whether a column of a file has values of the kind that is wanted, and as many in a row."""
    one, other = found[name], wanted[name]
    alike = (one.base.kind == "S") == (other.base.kind == "S") and np.can_cast(one.base, other.base, "same_kind")
    return one.shape == other.shape and alike
