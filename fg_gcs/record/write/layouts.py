"""What the tables of a run hold, and how their rows lie on disk: NumPy's own ``.npy``, made to grow.

A file begins with NumPy's header, in which there is room for the number of rows to grow; behind it come the rows, each
packed without gaps. Rows are appended first and counted after that, in place, so ``numpy.load`` opens the file at any
moment of the flight, and after a crash: it reads the rows that are counted and ignores what lies behind them.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]  # by name, each of shape (rows,) or (rows, width)

MAGIC = b"\x93NUMPY\x01\x00"
DIGITS = 20  # room for the number of rows
ALIGNMENT = 64  # of the first row, as NumPy writes it
NUMPY_TYPES = {"d": "<f8", "i": "<i4", "?": "|b1"}


class Column(NamedTuple):
    """A table's column."""

    name: str
    code: str = "d"  # as in `struct`: d a float, i an integer, ? a truth value, 16s a text of up to 16 bytes of UTF-8
    width: int = 1  # cells a row


class TableLayout:
    """The columns of a table and their bytes.

    Attributes:
        name: of the table.
        file_name: of its file.
        columns: in their order.
        dtype: of a row.
    """

    def __init__(self, name: str, *columns: Column) -> None:
        """Take the columns in their order."""
        self.name = name
        self.file_name = f"{name}.npy"
        self.columns = columns
        self.dtype = np.dtype([_field(column) for column in columns])
        cells = [column.code for column in columns for _ in range(column.width)]
        self._packer = struct.Struct("<" + "".join(cells))
        self._texts = [(place, int(code[:-1])) for place, code in enumerate(cells) if code.endswith("s")]
        text = f"{{'descr': {self.dtype.descr!r}, 'fortran_order': False, 'shape': ({'#' * DIGITS},), }}"
        length = -(-(len(MAGIC) + 2 + len(text) + 1) // ALIGNMENT) * ALIGNMENT - len(MAGIC) - 2
        self._header = MAGIC + struct.pack("<H", length) + (text.ljust(length - 1) + "\n").encode()
        self.count_offset = self._header.index(b"#")

    @property
    def row_bytes(self) -> int:
        """Length of a row."""
        return self._packer.size

    def text(self, name: str, text: str) -> bytes:
        """Return a text's bytes as a column has them, for rows that have the same one again and again.

        Raises:
            KeyError: there is no such column of texts.
        """
        sizes = {column.name: int(column.code[:-1]) for column in self.columns if column.code.endswith("s")}
        return _utf8(text, sizes[name])

    def pack(self, row: Sequence[float | str | bytes]) -> bytes:
        """Return a row's bytes; a text that is too long is cut between two characters.

        Args:
            row: a value for every cell of every column, in their order; a text may be given as its bytes, see `text`.

        Raises:
            struct.error: there are more or fewer of them, or one is not what its column holds.
        """
        cells: list[Any] = list(row)
        for place, size in self._texts:
            if not isinstance(cells[place], bytes):
                cells[place] = _utf8(str(cells[place]), size)
        return self._packer.pack(*cells)

    def time_s(self, rows: bytes, index: int) -> float:
        """Return the first cell, the time, of one of the packed rows [s]."""
        time_s: float = self._packer.unpack_from(rows, index * self.row_bytes)[0]
        return time_s

    def header(self) -> bytes:
        """Return what an empty table's file holds."""
        return self._header.replace(b"#" * DIGITS, self.count(0))

    @staticmethod
    def count(rows: int) -> bytes:
        """Return a number of rows as the header has it, at ``count_offset``."""
        return str(rows).ljust(DIGITS).encode()

    def columns_of(self, rows: NDArray[Any] | Columns) -> dict[str, NDArray[Any]]:
        """Return packed rows, of shape (rows,) and this layout's type, or their cells by name; texts as ``str``."""
        columns = {column.name: rows[column.name] for column in self.columns}
        return {
            name: _texts(cells) if cells.dtype.kind == "S" else np.ascontiguousarray(cells)
            for name, cells in columns.items()
        }

    def table(self, rows: Iterable[Sequence[float | str]]) -> dict[str, NDArray[Any]]:
        """Return rows as the columns that are read back once they are written.

        Raises:
            struct.error: a row does not fit.
        """
        packed = b"".join(self.pack(row) for row in rows)
        return self.columns_of(np.frombuffer(bytearray(packed), self.dtype))


def _field(column: Column) -> tuple[Any, ...]:
    kind = NUMPY_TYPES.get(column.code) or f"|S{column.code[:-1]}"
    return (column.name, kind) if column.width == 1 else (column.name, kind, (column.width,))


def _texts(cells: NDArray[np.bytes_]) -> NDArray[np.str_]:
    """Return UTF-8 as text; a column of millions that all say the same is that text once, and read-only."""
    if len(cells) and (cells == cells[0]).all():
        return np.broadcast_to(np.char.decode(cells[0], "utf-8", "replace"), len(cells))
    return np.char.decode(cells, "utf-8", "replace")


def _utf8(text: str, most_bytes: int) -> bytes:
    return text.encode("utf-8", "replace")[:most_bytes].decode("utf-8", "ignore").encode()


TELEMETRY = TableLayout(
    "telemetry",
    Column("time_s"),  # when the ground station received it, since the start of the run
    Column("network", "16s"),
    Column("system_id", "i"),
    Column("position_enu_m", width=3),
    Column("velocity_enu_m_s", width=3),
    Column("yaw_rad"),  # clockwise from north; NaN until known
    Column("boot_time_s"),  # the vehicle's own clock
    Column("height_m"),  # above the vehicle's own ground
)
SETPOINTS = TableLayout(
    "setpoints",
    Column("time_s"),  # the instant the setpoint is meant for, since the start of the run
    Column("network", "16s"),
    Column("system_id", "i"),
    Column("position_enu_m", width=3),
    Column("velocity_enu_m_s", width=3),
    Column("acceleration_enu_m_s2", width=3),
    Column("yaw_rad"),
)
TICKS = TableLayout("ticks", Column("time_s"), Column("late_s"))
SIGHTINGS = TableLayout(  # those of a form that could be judged; the others are only counted
    "sightings",
    Column("time_s"),  # its stamp: when it was true, since the start of the run
    Column("received_s"),
    Column("target", "32s"),  # name among the mission's; empty: none of them
    Column("position_enu_m", width=3),
    Column("verdict", "16s"),  # name of a fg_gcs.track.sightings.Verdict, in lower case
)
REPLANS = TableLayout(
    "replans",
    Column("time_s"),  # when planning began, since the start of the run
    Column("sighted_s"),  # when the oldest sighting came that had waited for it; NaN: none had
    Column("planned_s"),  # when it was done; in virtual time that is the same
    Column("mode", "16s"),  # name of a fg_gcs.track.follow.replanner.FollowMode, in lower case
    Column("taken", "?"),  # there is a new trajectory; if not, the one before goes on
    Column("position_enu_m", width=3),  # the targets' centre by the estimate
    Column("velocity_enu_m_s", width=3),
    Column("age_s"),  # of the estimate
    Column("radius_m"),  # of the ball that the face should cover
    Column("error_m"),  # distance of the commanded formation's centre from the estimate
)
TRUTH = TableLayout(  # where the targets truly were, if that is known: at each instant all of them, in their order
    "truth",
    Column("time_s"),
    Column("target", "32s"),
    Column("position_enu_m", width=3),
)
LAYOUTS = (TELEMETRY, SETPOINTS, TICKS, SIGHTINGS, REPLANS, TRUTH)
