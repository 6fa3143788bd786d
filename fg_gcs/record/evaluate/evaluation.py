"""From what was recorded to what it means: series over time, and the figures of the flight."""

from __future__ import annotations

from dataclasses import fields
from functools import cached_property
from pathlib import Path

import numpy as np

from fg_gcs.record.evaluate.figures import FLOWN_KEYS, Flown, Whereabouts, figures, flown
from fg_gcs.record.evaluate.tracking import (
    KEYS,
    Followed,
    commanded_steps,
    coverage_after_facing,
    estimated_centre,
    tracking_figures,
    true_centre,
)
from fg_gcs.record.read.run import RecordedRun, RunError, load_run
from fg_gcs.record.read.summary import as_number


class EvaluatedRun(RecordedRun):
    """A recorded run and what follows from it; everything is computed when it is first asked for, and once."""

    @classmethod
    def of(cls, run: RecordedRun) -> EvaluatedRun:
        """Return the same run, to be evaluated."""
        return cls(**{field.name: getattr(run, field.name) for field in fields(run)})

    @cached_property
    def followed(self) -> Followed | None:
        """What was tracked; None where nothing moved or it was not tracked, or the mission file is not understood."""
        mission, tracking = self.mission, self.summary.table("tracking")
        began_s = as_number(tracking.get("began_s"))
        if mission is None or mission.targets is None or began_s is None:
            return None
        ended_s = as_number(tracking.get("ended_s"))
        task = mission.task()
        return Followed(
            began_s,
            self.last_s if ended_s is None else min(ended_s, self.last_s),
            as_number(tracking.get("caught_s")),
            tuple(target.weight for target in mission.targets),
            task.formation.leaders_m,
            task.hold_depth_m,
            mission.track.capture_m,
            mission.track.lost_after_s,
        )

    @cached_property
    def true_target(self) -> Whereabouts | None:
        """Where the centre of moving targets truly was, if that is known."""
        return None if self.followed is None else true_centre(self.truth, self.followed.weights)

    @cached_property
    def estimated_target(self) -> Whereabouts | None:
        """Where the centre of moving targets was believed to be."""
        return None if self.followed is None else estimated_centre(self.replans)

    @cached_property
    def series(self) -> Flown | None:
        """The flight's series, or None when there are too few samples for any."""
        known = self.target_enu_m if self.followed is None else None
        at_rest = Whereabouts.standing(np.full(3, np.nan) if known is None else known)
        target = self.true_target or self.estimated_target or at_rest
        return flown(self.telemetry, self.setpoints, self.stages, self.leaders, target)

    @cached_property
    def figures(self) -> dict[str, object]:
        """The flown figures by the names of the command line's JSON, those of the tracking among them.

        Flux and coverage are those of the true target, where that is known, else of the estimate.
        """
        result: dict[str, object] = {**figures(self.series, self.ticks, self.setpoints, self.stages)}
        followed, series = self.followed, self.series
        if followed is None:
            return result | dict.fromkeys(KEYS) | {"replans": 0, "found_again_s": []}
        result |= tracking_figures(series, self.leaders, followed, self.tables)
        limit_m_s2 = self.summary.limit("acceleration_m_s2")
        if limit_m_s2 is not None:
            ends_s = self.stages["home"][1] if "home" in self.stages else followed.ended_s
            steps = commanded_steps(self.setpoints, (followed.began_s, ends_s), limit_m_s2)
            names = "commanded_position_step_max_m", "commanded_velocity_step_max_m_s"
            result |= dict(zip(names, steps, strict=True))
        caught_s = followed.ended_s if followed.caught_s is None else followed.caught_s
        covered = None if series is None else coverage_after_facing(series, (followed.began_s, caught_s))
        return result | {"coverage_min_after_facing": covered}

    def number(self, key: str) -> float | None:
        """Return a figure of the summary, or, of a run that did not come to its end, as it follows from the tables."""
        if self.is_summed_up or key not in self.figures:
            return self.summary.number(key)
        return as_number(self.figures[key])

    @property
    def is_summed_up(self) -> bool:
        """Whether the summary has the flown figures already."""
        return FLOWN_KEYS[0] in self.summary.values

    @cached_property
    def found_again_s(self) -> tuple[float | None, ...]:
        """How long after the first new sighting a lost target was caught again, each time [s]; None: never."""
        if self.is_summed_up or self.followed is None:
            return self.summary.durations("found_again_s")
        found = self.figures["found_again_s"]
        assert isinstance(found, list)
        return tuple(found)


def evaluated(folder: Path) -> EvaluatedRun:
    """Read a run's folder to evaluate it.

    Raises:
        RunError: it is not the folder of a run.
    """
    return EvaluatedRun.of(load_run(folder))


def flown_figures(folder: Path) -> dict[str, object]:
    """Return the figures that follow from a run's folder; None where its recording does not give any."""
    try:
        return evaluated(folder).figures
    except RunError:  # the folder is gone
        return dict.fromkeys((*FLOWN_KEYS, *KEYS)) | {"replans": 0, "found_again_s": []}
