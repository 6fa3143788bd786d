"""What a sensor makes of a target: noise, delay, gaps and wild values, the same for the same seed."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.scenario.motions import TrueMotion
from fg_gcs.track.sightings import Sighting, isotropic


@dataclass(frozen=True)
class SensorSettings:
    """How good a sensor is; times count from when tracking begins."""

    rate_hz: float = 10.0  # measurements a second
    sigma_m: float = 0.5  # standard deviation of the error along each axis
    delay_s: float = 0.1  # from the measurement to the arrival of the sighting
    jitter_s: float = 0.0  # measurements are this much early or late at most, evenly spread
    drop: float = 0.0  # share of the sightings that never arrive
    outliers: float = 0.0  # share of the sightings that are wild, with nothing to tell them by
    outlier_m: float = 20.0  # how far off those are, in any direction
    silence_s: tuple[tuple[float, float], ...] = ()  # from, to: nothing that is true then is seen

    def __post_init__(self) -> None:
        """Refuse what no sensor is like.

        Raises:
            ValueError: a rate that is not above 0, a negative number, a share above 1, or one that is not finite.
        """
        for name, value in vars(self).items():
            if name != "silence_s" and not 0.0 <= value < math.inf:
                raise ValueError(f"{name} must be a finite number, 0 or more, got {value}")
        if self.rate_hz == 0.0:
            raise ValueError("rate_hz must be above 0")
        if self.drop > 1.0 or self.outliers > 1.0:
            raise ValueError("drop and outliers are shares, 0 to 1")


class Measurement(NamedTuple):
    """What came of one measurement."""

    received_s: float  # when the sighting arrives, or would have arrived
    sighting: Sighting | None  # None: it failed


class Sensor:
    """Measures one target's place. Which measurements fail, and by how much they err, depends on target and seed alone.

    Args:
        target: name of the target; sensors of several targets with one seed err each by itself.
        settings: how good it is.
        seed: of everything random, 0 or more.
    """

    def __init__(self, target: str, settings: SensorSettings, seed: int) -> None:
        self.target = target
        self.settings = settings
        self._seed = (seed, *target.encode())
        self._covariance_m2 = isotropic(settings.sigma_m)
        self._random = np.random.default_rng(self._seed)

    def measure(self, time_s: float, position_enu_m: Array) -> Sighting | None:
        """Return the next sighting, None if the measurement fails.

        Args:
            time_s: when it is taken.
            position_enu_m: where the target then is, shape (3,) [m; ENU].
        """
        return self._seen(self._random, time_s, position_enu_m)

    def measurements(self, motion: TrueMotion) -> Iterator[Measurement]:
        """Yield all measurements of a motion for ever, in the order of arrival; every call begins anew.

        They are taken at ``k / rate_hz``, give or take the jitter, and never before time 0. Those that fail are among
        them, so that the next one always comes at once, even if the sensor never sees anything again.
        """
        random, settings = np.random.default_rng(self._seed), self.settings
        waiting: list[tuple[float, int, Sighting | None]] = []
        for k in itertools.count():
            nominal_s = k / settings.rate_hz
            # Later ones cannot come before this one at its earliest
            while waiting and waiting[0][0] <= nominal_s - settings.jitter_s:
                time_s, _, sighting = heapq.heappop(waiting)
                yield Measurement(time_s + settings.delay_s, sighting)
            time_s = max(nominal_s + settings.jitter_s * random.uniform(-1.0, 1.0), 0.0)
            heapq.heappush(waiting, (time_s, k, self._seen(random, time_s, motion.at(np.array([time_s]))[0][0])))

    def _seen(self, random: np.random.Generator, time_s: float, position_enu_m: Array) -> Sighting | None:
        """Every measurement takes the same number of draws, so that no setting changes what the others do."""
        settings = self.settings
        dropped, wild = random.random(2) < (settings.drop, settings.outliers)
        noise, direction = random.standard_normal((2, 3))
        if dropped or any(begin <= time_s < end for begin, end in settings.silence_s):
            return None
        seen = position_enu_m + settings.sigma_m * noise
        if wild:
            seen = seen + settings.outlier_m * direction / np.linalg.norm(direction)
        return Sighting(self.target, time_s, seen, self._covariance_m2, time_s + settings.delay_s)
