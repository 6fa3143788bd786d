"""Sightings from code of one's own, in place of those that a mission's target has as its source."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic
from fg_gcs.flight.sightings.sources import OnSighting
from fg_gcs.track.sightings import Sighting, isotropic


class OwnSightings:
    """Override :meth:`run` and call :meth:`put` there, or call it from anywhere on the flight's loop.

    One object serves one target of one flight.
    """

    def __init__(self) -> None:
        self._target = ""
        self._connected: OnSighting | None = None
        self._on_sighting: OnSighting | None = None  # while tracking is on
        self._on_failure: Callable[[str], None] | None = None
        self._task: asyncio.Task[None] | None = None

    async def run(self) -> None:
        """Do nothing; override it to produce sightings: it runs as a task from when tracking begins until it ends."""

    def put(self, position_enu_m: Sequence[float], sigma_m: float = 0.5, age_s: float = 0.0) -> None:
        """Hand in where the target was; ignored while nothing is tracked.

        Args:
            position_enu_m: east, north and up from the mission's origin [m].
            sigma_m: standard deviation along each axis [m].
            age_s: how long ago it was there [s].

        Raises:
            ValueError: these are no three numbers and two more.
        """
        place = np.array(position_enu_m, dtype=float)
        if place.shape != (3,) or np.ndim(sigma_m) or np.ndim(age_s):
            raise ValueError(
                f"a sighting at {position_enu_m!r}; accepted: three numbers, and one for sigma_m and age_s"
            )
        if self._on_sighting is not None:
            now_s = asyncio.get_running_loop().time()
            self._on_sighting(Sighting(self._target, now_s - age_s, place, isotropic(sigma_m), now_s))

    def connect(self, target: str, on_sighting: OnSighting, on_failure: Callable[[str], None]) -> None:
        """Serve a target (the flight calls this before :meth:`begin`)."""
        self._target = target
        self._connected = on_sighting
        self._on_failure = on_failure

    async def open(self) -> None:
        """Do nothing: there is nothing to open."""

    def begin(self, began_s: float, origin: Geodetic) -> None:
        """Let sightings come from now on (the flight calls this)."""
        self._on_sighting = self._connected
        self._task = asyncio.get_running_loop().create_task(self.run(), name=f"sightings of {self._target}")
        self._task.add_done_callback(self._ended)

    def truth(self, target: str, time_s: Array) -> Array | None:
        """Return nothing: where the target truly is, is not known here."""
        return None

    def known_until_s(self) -> float:
        """Return infinity: there is nothing to wait for."""
        return math.inf

    def close(self) -> None:
        """Let no more come (the flight calls this)."""
        self._on_sighting = None
        if self._task is not None:
            self._task.cancel()

    def _ended(self, task: asyncio.Task[None]) -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None and self._on_failure is not None:
            self._on_failure(f"the source of {self._target} failed and says no more: {error!r}")
