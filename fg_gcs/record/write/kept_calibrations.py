"""What was learnt of each firmware in flight, on disk for the next one: how far it wanders, its drag and its lag."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

NAME: Final = "calibrations"
MOST_BYTES: Final = 65_536
MOST_KEPT: Final = 100  # firmwares; the oldest are forgotten


class Calibration(NamedTuple):
    """What was learnt of a firmware.

    Attributes:
        wander_m: how far vehicles hover off their places, rms, as seen from above; 0: it was not measured [m].
        drag_per_s: median of its vehicles [1/s].
        lag_s: likewise [s].
    """

    wander_m: float
    drag_per_s: float
    lag_s: float


class KeptCalibrations:
    """The file of them in a folder.

    Args:
        folder: is made if it is not there.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / NAME

    def read(self) -> dict[str, Calibration]:
        """Return what is kept, by the firmwares' names; what cannot be read is not there."""
        with suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
            with self._path.open("rb") as file:
                tables = json.loads(file.read(MOST_BYTES))
            found = {
                str(name): Calibration(*(float(table[key]) for key in Calibration._fields))
                for name, table in tables.items()
            }
            return {name: each for name, each in found.items() if all(0.0 <= x < math.inf for x in each)}
        return {}

    def keep(self, found: Mapping[str, Calibration]) -> None:
        """Write down what was learnt, in place of what is there of the same firmwares.

        Raises:
            OSError: the disk does not take it.
        """
        old = {name: each for name, each in self.read().items() if name not in found}
        kept = dict(list((old | dict(found)).items())[-MOST_KEPT:])
        self._path.parent.mkdir(parents=True, exist_ok=True)
        new = self._path.with_name(f"{NAME}-{os.getpid()}.new")
        with new.open("w", encoding="utf-8") as file:
            json.dump({name: each._asdict() for name, each in kept.items()}, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        new.replace(self._path)
