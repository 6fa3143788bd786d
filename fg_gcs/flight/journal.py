"""What a flight says about itself: events, its stages with their times, and what routers and vehicles report."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from fg_gcs.link.router import Router
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.vehicle import Vehicle

STAGES = ("connect", "prepare", "plan", "take-off", "gather", "approach", "hold", "home", "land")


class Journal:
    """Writes events with the loop's time.

    Attributes:
        stage: the present stage.
        stages: begin and end of every stage so far, since the run's start [s].
        stage_begins_s: the loop's time at which the present stage began.
        stage_ends_s: the loop's time at which the present stage should end, where that is known.
    """

    def __init__(self, recorder: Recorder) -> None:
        """Write into the run's recorder."""
        self.recorder = recorder
        self.stage = STAGES[0]
        self.stages: dict[str, tuple[float, float]] = {}
        self.stage_ends_s: float | None = None
        self._time = asyncio.get_running_loop().time
        self.stage_begins_s = self._time()

    def event(self, kind: str, text: str, **data: object) -> None:
        """Write down what happened now."""
        self.recorder.event(self._time(), kind, text, **data)

    @contextmanager
    def in_stage(self, stage: str) -> Iterator[None]:
        """Mark what runs inside as one stage of the flight."""
        self.stage, self.stage_begins_s, self.stage_ends_s = stage, self._time(), None
        began_s = self.recorder.since_start_s(self._time())
        begin_s = self.stages.get(stage, (began_s, began_s))[0]  # a way home broken off goes on as another way home
        self.event("stage", stage, stage=stage)
        self.recorder.know(stages={**self.stages, stage: (begin_s, None)})
        try:
            yield
        finally:
            self.stages[stage] = (begin_s, self.recorder.since_start_s(self._time()))
            self.recorder.know(stages=dict(self.stages))

    def drain(self, router: Router, vehicles: Iterable[Vehicle]) -> None:
        """Take out and write down what the router and the vehicles have to say."""
        while router.notices:
            self.event("notice", router.notices.popleft())
        for vehicle in vehicles:
            while vehicle.texts:
                text = vehicle.texts.popleft()
                self.event("text", f"vehicle {vehicle.system_id}: {text.text}", severity=text.severity)
            while vehicle.changes:
                after = vehicle.changes.popleft().after
                self.event("phase", f"vehicle {vehicle.system_id}: {after.value}", phase=after.name)
