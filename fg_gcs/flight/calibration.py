"""What is known of a fleet's firmwares from their last flight, and what this one adds to it."""

from __future__ import annotations

from statistics import median

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.flight.compensation import Compensation
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.journal import Journal
from fg_gcs.record.write.kept_calibrations import Calibration, KeptCalibrations

NOTHING = Calibration(0.0, 0.0, 0.0)


class FleetCalibration:
    """Knows what is kept of each vehicle's firmware; keeps what is learnt.

    Args:
        fleet: its versions known.
        kept: where; None: nowhere, as for simulated vehicles.
    """

    def __init__(self, fleet: Fleet, kept: KeptCalibrations | None) -> None:
        self._fleet, self._kept = fleet, kept
        known = {} if kept is None else kept.read()
        self._known = [known.get(vehicle.firmware, NOTHING) for vehicle in fleet.vehicles]

    @property
    def wander_m(self) -> Array:
        """How far each hovers off its place, rms, as seen from above, shape (V,) [m]; 0: that is not known."""
        return np.array([each.wander_m for each in self._known])

    @property
    def drag_and_lag(self) -> Array:
        """Drag [1/s] and lag [s] of each, shape (V, 2)."""
        return np.array([(each.drag_per_s, each.lag_s) for each in self._known])

    def keep(self, wander_m: Array | None, learnt: Compensation | None, journal: Journal) -> None:
        """Keep what a flight has taught.

        Args:
            wander_m: how far each vehicle was seen to wander, shape (V,) [m]; None: nobody looked.
            learnt: of drag and lag; None: nobody did.
            journal: told if it cannot be kept.
        """
        if self._kept is None or (wander_m is None and learnt is None):
            return
        firmwares: dict[str, list[int]] = {}
        for row, vehicle in enumerate(self._fleet.vehicles):
            firmwares.setdefault(vehicle.firmware, []).append(row)

        def of(values: Array | None, rows: list[int], known: float) -> float:
            return known if values is None else float(median(values[rows].tolist()))

        found = {}
        for name, rows in firmwares.items():
            old = self._known[rows[0]]
            drag = None if learnt is None else learnt.drag_per_s
            lead = None if learnt is None else learnt.lead_s
            found[name] = Calibration(
                of(wander_m, rows, old.wander_m), of(drag, rows, old.drag_per_s), of(lead, rows, old.lag_s)
            )
        try:
            self._kept.keep(found)
        except OSError as error:
            journal.event("notice", f"what was learnt of the vehicles is not kept: {error.strerror or error}")
