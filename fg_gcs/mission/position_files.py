"""Files of positions that a mission names, as whoever loads the mission has read them."""

from __future__ import annotations

from fg_gcs.errors import MissionError
from fg_gcs.track.sightings import Sighting, parse_csv

FILES = "files"  # the key of the validation context under which the loader states them, by the paths in the mission


class PositionFile:
    """A CSV file of targets' positions; each is taken apart once, however often it is asked for.

    Attributes:
        name: that errors have.
        data: what is in it; empty when it could not be read.
    """

    def __init__(self, name: str, data: bytes, problem: str | None = None) -> None:
        """Take what was read, or what went wrong with that."""
        self.name = name
        self.data = data
        self._problem = problem
        self._rows: dict[float, list[Sighting]] = {}

    def rows(self, target: str, sigma_m: float) -> list[Sighting]:
        """Return a target's rows, in the file's order; those that do not say how sure they are get a deviation [m].

        Raises:
            MissionError: the file could not be read, is no CSV file, or has no row of the target; one line.
        """
        if self._problem is not None:
            raise MissionError(f"{self.name}: {self._problem}")
        if sigma_m not in self._rows:
            self._rows[sigma_m] = parse_csv(self.data, self.name, sigma_m)
        rows = [row for row in self._rows[sigma_m] if row.target == target]
        if not rows:
            raise MissionError(f"{self.name}: no line of target {target!r}; accepted: one or more")
        return rows

    def __eq__(self, other: object) -> bool:
        """Two files are the same if the same is in them."""
        return isinstance(other, PositionFile) and self.data == other.data

    def __hash__(self) -> int:
        return hash(self.data)
