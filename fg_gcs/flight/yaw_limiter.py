"""The stage between a motion and its bytes that keeps noses from jumping."""

from __future__ import annotations

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import turned_towards
from fg_gcs.flight.motions import Headings

YAW_RATE_RAD_S = 1.0  # autopilots turn about as fast; what the target does, and noise in its estimate, makes no jumps


class YawRateLimiter:
    """Turns V headings towards wanted ones the short way, no faster than `YAW_RATE_RAD_S`.

    Args:
        headings: Where noses point, and when.
    """

    def __init__(self, headings: Headings) -> None:
        self._headings = headings

    def turn(self, wanted_rad: Array, now_s: float) -> Array:
        """Return how far noses have turned by now.

        Args:
            wanted_rad: Headings to turn to, shape (V,) [rad].
            now_s: Reading of the loop's clock [s]; one that is not later turns nothing.

        Returns:
            Headings, shape (V,) [rad; -pi to pi].
        """
        before_s, before = self._headings
        yaw = turned_towards(before, wanted_rad, YAW_RATE_RAD_S * max(now_s - before_s, 0.0))
        known = np.where(np.isfinite(yaw), yaw, before)  # one that is not a number is none to turn on from
        self._headings = Headings(max(now_s, before_s), known)
        return yaw
