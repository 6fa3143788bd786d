"""From a recorder's tables to the figures of the flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fg_gcs.record.evaluate.figures import Whereabouts, figures, flown
from fg_gcs.record.evaluate.tracking import (
    Followed,
    commanded_steps,
    coverage_after_facing,
    estimated_centre,
    tracking_figures,
    true_centre,
)
from fg_gcs.record.write.recorder import TABLES, TRACKING_TABLES, Recorder


def evaluate(
    recorder: Recorder, stages: Mapping[str, tuple[float, float]], leaders: Sequence[int], target_enu_m: Sequence[float]
) -> dict[str, float | None]:
    """Return the flown figures of a run around a target at rest, surrounded by the leaders of these system ids."""
    telemetry, setpoints = recorder.telemetry.columns(), recorder.setpoints.columns()
    target = Whereabouts.standing(np.array(target_enu_m))
    series = flown(telemetry, setpoints, stages, leaders, target)
    return figures(series, recorder.ticks.columns(), setpoints, stages)


def evaluate_tracking(
    recorder: Recorder,
    stages: Mapping[str, tuple[float, float]],
    leaders: Sequence[int],
    followed: Followed,
    acceleration_m_s2: float,
) -> dict[str, object]:
    """Return the flown figures of a run that tracked, those of the tracking among them.

    Flux and coverage are those of the true target, where that is known, else of the estimate. The leaders are system
    ids in their winding order.
    """
    tables = {name: getattr(recorder, name).columns() for name in (*TABLES, *TRACKING_TABLES)}
    target = true_centre(tables["truth"], followed.weights) or estimated_centre(tables["replans"])
    unknown = Whereabouts.standing(np.full(3, np.nan))
    series = flown(tables["telemetry"], tables["setpoints"], stages, leaders, target or unknown)
    result: dict[str, object] = {**figures(series, tables["ticks"], tables["setpoints"], stages)}
    result |= tracking_figures(series, leaders, followed, tables)
    ends_s = stages["home"][1] if "home" in stages else followed.ended_s
    steps = commanded_steps(tables["setpoints"], (followed.began_s, ends_s), acceleration_m_s2)
    result |= dict(zip(("commanded_position_step_max_m", "commanded_velocity_step_max_m_s"), steps, strict=True))
    caught_s = followed.ended_s if followed.caught_s is None else followed.caught_s
    covered = None if series is None else coverage_after_facing(series, (followed.began_s, caught_s))
    return result | {"coverage_min_after_facing": covered}
