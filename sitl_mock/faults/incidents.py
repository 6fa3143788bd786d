"""What vehicles truly hit: each other, or the ground. Whoever does has flown for the last time."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.physics.arrays import Array
from sitl_mock.physics.constants import BodyLimits
from sitl_mock.physics.swarm import Swarm


class Incident(NamedTuple):
    """Something that was hit.

    Attributes:
        time_s: simulated.
        kind: ``collision`` or ``ground_strike``.
        vehicles: system ids of those that it ended.
        position_enu_m: where; of a collision the middle; world.
        speeds_m_s: of each of them.
        closing_m_s: how fast they met, or how fast the ground was met.
    """

    time_s: float
    kind: str
    vehicles: tuple[int, ...]
    position_enu_m: tuple[float, float, float]
    speeds_m_s: tuple[float, ...]
    closing_m_s: float

    def __str__(self) -> str:
        east, north, up = self.position_enu_m
        place = f"at ({east:.1f}, {north:.1f}, {up:.1f}) m after {self.time_s:.2f} s, {self.closing_m_s:.1f} m/s fast"
        if self.kind == "collision":
            return f"vehicles {self.vehicles[0]} and {self.vehicles[1]} collided {place}"
        return f"vehicle {self.vehicles[0]} hit the ground {place}"


class Closest(NamedTuple):
    """The closest that two vehicles in the air ever came.

    Attributes:
        time_s: simulated.
        vehicles: their system ids.
        distance_m: of their centres.
    """

    time_s: float
    vehicles: tuple[int, int]
    distance_m: float


class Incidents:
    """Watches all vehicles of a fleet by the truth.

    Args:
        swarm: where they are.
        vehicles: their autopilots, in the order of the rows.
        body: what they are like.
        harmless: whatever is hit, they fly on; it is told all the same.

    Attributes:
        found: so far.
        closest: that two in the air ever came; None: there never were two.
    """

    def __init__(
        self, swarm: Swarm, vehicles: Sequence[Autopilot], body: BodyLimits, *, harmless: bool = False
    ) -> None:
        self.found: list[Incident] = []
        self.closest: Closest | None = None
        self._swarm = swarm
        self._vehicles = tuple(vehicles)
        self._body = body
        self._harmless = harmless
        self._near: set[tuple[int, int]] = set()  # pairs that are still as close as they were when they collided
        self._touched = swarm.in_contact.copy()

    def look(self, span_s: float) -> list[int]:
        """Compare all vehicles with each other and with the ground.

        Args:
            span_s: since the last time.

        Returns:
            Rows of the vehicles that were ended.
        """
        ended = self._strikes()
        if len(self._vehicles) > 1:
            ended += self._meetings(span_s)
        self._touched[:] = self._swarm.in_contact
        if self._harmless:
            return []
        for row in ended:
            self._vehicles[row].enter(self._swarm.time_s)
            self._vehicles[row].crash()
        return ended

    def _strikes(self) -> list[int]:
        """Vehicles that meet the ground faster than a landing does."""
        touching = np.flatnonzero(self._swarm.in_contact & ~self._touched)
        ended = []
        for row in touching.tolist():
            speed_m_s = float(self._swarm.impact_m_s[row])
            if speed_m_s < self._body.strike_m_s or self._vehicles[row].wrecked:
                continue
            self._add("ground_strike", (row,), self._swarm.position_m[row], (speed_m_s,), speed_m_s)
            ended.append(row)
        return ended

    def _meetings(self, span_s: float) -> list[int]:
        """Pairs of which at least one is in the air, and at least one is whole."""
        airborne = ~self._swarm.in_contact
        flying = int(airborne.sum())
        if not flying:
            return []
        pair = self._swarm.closest_pair(airborne, span_s)
        if pair is not None and (self.closest is None or pair.distance_m < self.closest.distance_m):
            ids = (self._vehicles[pair.first].system_id, self._vehicles[pair.second].system_id)
            self.closest = Closest(self._swarm.time_s, ids, pair.distance_m)
        if flying == len(airborne) and (pair is None or pair.distance_m >= self._body.width_m):
            self._near.clear()
            return []  # nobody can be met on the ground, and nobody came close in the air
        ended: list[int] = []
        before, self._near = self._near, set()
        for first, second, _ in self._swarm.pairs_within(self._body.width_m, span_s):
            both = (first, second)
            self._near.add(both)
            if both in before or not airborne[list(both)].any() or all(self._vehicles[row].wrecked for row in both):
                continue
            velocities = self._swarm.velocity_m_s[list(both)]
            speeds = tuple(np.linalg.norm(velocities, axis=1).tolist())
            middle_m = self._swarm.position_m[list(both)].mean(axis=0)
            self._add("collision", both, middle_m, speeds, float(np.linalg.norm(velocities[0] - velocities[1])))
            ended += [row for row in both if not self._vehicles[row].wrecked and row not in ended]
        return ended

    def _add(
        self, kind: str, rows: tuple[int, ...], place_ned_m: Array, speeds_m_s: tuple[float, ...], closing_m_s: float
    ) -> None:
        north_m, east_m, down_m = place_ned_m.tolist()
        ids = tuple(self._vehicles[row].system_id for row in rows)
        place = (east_m, north_m, -down_m)
        self.found.append(Incident(self._swarm.time_s, kind, ids, place, speeds_m_s, closing_m_s))

    def table(self) -> dict[str, Any]:
        """All that was seen, as JSON has it."""
        return {
            "incidents": [incident._asdict() | {"text": str(incident)} for incident in self.found],
            "closest": None if self.closest is None else self.closest._asdict(),
        }


def write_truth(path: Path, incidents: Incidents) -> None:
    """Write down what was seen, in place of what was there.

    Raises:
        OSError: it cannot be written.
    """
    draft = path.with_name(f".{path.name}.draft")
    draft.write_text(json.dumps(incidents.table(), indent=1) + "\n", encoding="utf-8")
    draft.replace(path)
