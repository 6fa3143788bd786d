"""What is left in a battery and what its voltage says, as the autopilots' own SITL batteries show it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BatteryProfile:
    """Remaining charge falls evenly while armed, down to `least`; the voltage goes with it."""

    full: float  # [%]
    drain_per_s: float  # [% a second] armed
    least: int  # [%] a SITL battery that sinks no further
    cells: int
    full_cell_v: float
    empty_cell_v: float


class Battery:
    """One vehicle's battery.

    Args:
        profile: of its kind.
    """

    def __init__(self, profile: BatteryProfile) -> None:
        self.profile = profile
        self._percent = profile.full
        self._least: float = profile.least
        self.used_s = 0.0  # armed time in all

    def use(self, seconds: float) -> None:
        """Be armed for a while."""
        self.used_s += seconds
        self._percent = max(self._percent - self.profile.drain_per_s * seconds, min(self._least, self._percent))

    def fall_to(self, share: float) -> None:
        """Have no more than a share of the charge left, and go on from there, to nothing if it has to be."""
        self._percent = min(self._percent, 100.0 * share)
        self._least = 0.0

    @property
    def percent(self) -> int:
        """What is left, as SYS_STATUS says it."""
        return round(self._percent)

    @property
    def share(self) -> float:
        """What is left, 0 to 1."""
        return self._percent / 100.0

    @property
    def voltage_v(self) -> float:
        """Of the whole battery [V]."""
        return self.profile.cells * self.cell_v

    @property
    def cell_v(self) -> float:
        """Of one cell [V]."""
        own = self.profile
        return own.empty_cell_v + (own.full_cell_v - own.empty_cell_v) * self.share
