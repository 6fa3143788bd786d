"""From a recorder's tables to the figures of the flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fg_gcs.record.figures import figures, flown
from fg_gcs.record.recorder import Recorder


def evaluate(
    recorder: Recorder, stages: Mapping[str, tuple[float, float]], rim: Sequence[int], target_enu_m: Sequence[float]
) -> dict[str, float | None]:
    """Return the flown figures of a run."""
    telemetry, setpoints = recorder.telemetry.columns(), recorder.setpoints.columns()
    series = flown(telemetry, setpoints, stages, np.array(rim, dtype=float), np.array(target_enu_m))
    return figures(series, recorder.ticks.columns(), setpoints, stages)
