"""Poses on the way, kept as arrays: one row each, so that thousands cost no objects."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import overload

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Pose


class Poses(Sequence[Pose]):
    """A sequence of poses over one array; equal parts of it are views, not copies."""

    def __init__(self, rows: Array) -> None:
        """Take the rows, shape (K, 13): centre [m; ENU], rotation by rows, scale. The array is kept, not copied."""
        self.rows = rows

    @classmethod
    def of(cls, poses: Iterable[Pose]) -> Poses:
        """Copy poses into rows."""
        return cls(np.array([(*p.centre_enu_m, *np.ravel(p.rotation), p.scale) for p in poses]).reshape(-1, 13))

    @property
    def centres_enu_m(self) -> Array:
        """Centres of the face, shape (K, 3) [m; ENU]."""
        return self.rows[:, :3]

    @property
    def rotations(self) -> Array:
        """Template axes to ENU, shape (K, 3, 3)."""
        return self.rows[:, 3:12].reshape(-1, 3, 3)

    @property
    def scales(self) -> Array:
        """Times the template, shape (K,)."""
        return self.rows[:, 12]

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.rows)

    @overload
    def __getitem__(self, index: int) -> Pose: ...

    @overload
    def __getitem__(self, index: slice) -> Poses: ...

    def __getitem__(self, index: int | slice) -> Pose | Poses:
        """Return one pose, or part of the sequence."""
        if isinstance(index, slice):
            return Poses(self.rows[index])
        row = self.rows[index]
        return Pose(row[:3], row[3:12].reshape(3, 3), float(row[12]))

    def __iter__(self) -> Iterator[Pose]:
        """Iterate over the poses."""
        return map(Pose, self.centres_enu_m, self.rotations, self.scales.tolist())
