"""Columnar tables of numbers that grow row by row and are saved as one compressed NumPy archive."""

from __future__ import annotations

import zlib
from array import array
from collections.abc import Mapping, Sequence
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from fg_gcs.core.arrays import Array

Columns = Mapping[str, Array]

TELEMETRY: dict[str, int] = {  # width of each column
    "time_s": 1,  # when the ground station received it, since the start of the run
    "system_id": 1,
    "position_enu_m": 3,
    "velocity_enu_m_s": 3,
    "yaw_rad": 1,  # clockwise from north; NaN until known
    "boot_time_s": 1,  # the vehicle's own clock
    "height_m": 1,  # above the vehicle's own ground
}
SETPOINTS: dict[str, int] = {
    "time_s": 1,  # the instant the setpoint is meant for, since the start of the run
    "system_id": 1,
    "position_enu_m": 3,
    "velocity_enu_m_s": 3,
    "acceleration_enu_m_s2": 3,
    "yaw_rad": 1,
}
TICKS: dict[str, int] = {"time_s": 1, "late_s": 1}
SIGHTINGS: dict[str, int] = {  # those of a form that could be looked at; the others are only counted
    "time_s": 1,  # its stamp: when it was true, since the start of the run
    "received_s": 1,
    "target": 1,  # index among the mission's; -1: none of them
    "position_enu_m": 3,
    "verdict": 1,  # index among those of fg_gcs.track.sightings.Verdict
}
REPLANS: dict[str, int] = {
    "time_s": 1,  # when the present state was looked at, since the start of the run
    "sighted_s": 1,  # when the oldest sighting came that had waited for it; NaN: none had
    "planned_s": 1,  # when it was done; in virtual time that is the same
    "mode": 1,  # index among those of fg_gcs.track.follow.replanner.Mode
    "taken": 1,  # 1: there is a new trajectory, 0: the one before goes on
    "position_enu_m": 3,  # the targets' centre by the estimate
    "velocity_enu_m_s": 3,
    "age_s": 1,  # of the estimate
    "radius_m": 1,  # of the ball that the face should cover
    "error_m": 1,  # distance of the commanded formation's centre from the estimate
}
TRUTH: dict[str, int] = {  # where the targets truly were, if that is known
    "time_s": 1,
    "target": 1,
    "position_enu_m": 3,
}


class Table:
    """Rows of floats under named columns."""

    def __init__(self, columns: Mapping[str, int]) -> None:
        """Take the width of every column, by its name and in its order."""
        self._columns = dict(columns)
        self._width = sum(columns.values())
        self._cells = array("d")

    def append(self, row: Sequence[float]) -> None:
        """Add a row.

        Raises:
            ValueError: the row has not as many numbers as all columns are wide.
        """
        if len(row) != self._width:
            raise ValueError(f"a row of {len(row)} numbers for a table that is {self._width} wide")
        self._cells.extend(row)

    def columns(self) -> dict[str, Array]:
        """Return copies of all columns by name, of shape (rows,) or (rows, width)."""
        cells = np.array(self._cells).reshape(-1, self._width)
        edges = np.cumsum([0, *self._columns.values()])
        return {
            name: cells[:, edge] if width == 1 else cells[:, edge : edge + width]
            for (name, width), edge in zip(self._columns.items(), edges[:-1], strict=True)
        }

    def save(self, path: Path) -> None:
        """Write all columns; the same rows give the same bytes."""
        np.savez_compressed(path, allow_pickle=False, **self.columns())


def load(path: Path) -> dict[str, Array]:
    """Return the columns of a saved table.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is not such a table.
    """
    try:
        with path.open("rb") as file, np.lib.npyio.NpzFile(file, own_fid=False, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (BadZipFile, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: damaged: {error}") from error
