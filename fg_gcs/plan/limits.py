"""What a plan must keep: the limits of the vehicles, the space they may use and the distance between them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fg_gcs.core.separation import Fence


@dataclass(frozen=True)
class Limits:
    """Limits of every vehicle; ``climb`` and ``descent`` bound the vertical part of the speed apart."""

    speed_m_s: float  # norm of the velocity
    acceleration_m_s2: float  # norm of the acceleration
    climb_m_s: float = np.inf
    descent_m_s: float = np.inf
    jerk_m_s3: float = np.inf  # norm of the acceleration's derivative

    def lowered_to(self, **others: float) -> Limits:
        """Return the smaller of each limit and the given one, by the names of the fields."""
        return replace(self, **{name: min(getattr(self, name), value) for name, value in others.items()})

    def beyond(self, times: float) -> Limits:
        """Return limits with so many times the acceleration and the jerk."""
        return replace(self, acceleration_m_s2=times * self.acceleration_m_s2, jerk_m_s3=times * self.jerk_m_s3)


@dataclass(frozen=True)
class Rules:
    """All that a plan is checked against."""

    limits: Limits
    separation_m: float  # no pair of vehicles comes closer
    fence: Fence  # no vehicle leaves this box; its lower face is the floor
    room_m: float = 0.0  # that lines between places keep beside the separation, where there is room: for wander
