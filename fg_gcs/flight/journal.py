"""What a flight says about itself: events, its stages with their times, and what routers and vehicles report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from fg_gcs.link.router import Router
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import VehicleAddress, vehicles_named
from fg_gcs.wire.phases import Phase, PhaseEvent
from fg_gcs.wire.vehicle import Vehicle

STAGES = ("connect", "prepare", "plan", "take-off", "gather", "approach", "hold", "home", "land")


class Journal:
    """Writes events with the flight's time, and keeps its clock.

    Attributes:
        time: the flight's clock, that of the loop it runs on [s].
        stage: the present stage.
        stages: begin and end of every stage so far, since the run's start [s].
        stage_begins_s: the loop's time at which the present stage began.
        stage_ends_s: the loop's time at which the present stage should end, where that is known.
    """

    def __init__(self, recorder: Recorder, time: Callable[[], float]) -> None:
        """Write into the run's recorder, by a clock [s]."""
        self.time = time
        self.recorder = recorder
        self.stage = STAGES[0]
        self.stages: dict[str, tuple[float, float]] = {}
        self.stage_ends_s: float | None = None
        self.stage_begins_s = self.time()

    def event(self, kind: str, text: str, **data: object) -> None:
        """Write down what happened now."""
        self.recorder.event(self.time(), kind, text, **data)

    @contextmanager
    def in_stage(self, stage: str) -> Iterator[None]:
        """Mark what runs inside as one stage of the flight."""
        self.stage, self.stage_begins_s, self.stage_ends_s = stage, self.time(), None
        began_s = self.recorder.since_start_s(self.time())
        begin_s = self.stages.get(stage, (began_s, began_s))[0]  # a way home broken off goes on as another way home
        self.event("stage", stage, stage=stage)
        self.recorder.know(stages={**self.stages, stage: (begin_s, None)})
        try:
            yield
        finally:
            self.stages[stage] = (begin_s, self.recorder.since_start_s(self.time()))
            self.recorder.know(stages=dict(self.stages))

    def drain(self, router: Router, vehicles: Iterable[Vehicle]) -> None:
        """Take out and write down what the router and the vehicles have to say, together what many say alike."""
        while router.notices:
            self.event("notice", router.notices.popleft())
        texts: dict[tuple[str, int], set[VehicleAddress]] = {}
        changes: dict[tuple[Phase, PhaseEvent, Phase], set[VehicleAddress]] = {}
        for vehicle in vehicles:
            while vehicle.texts:
                text = vehicle.texts.popleft()
                texts.setdefault((text.text, text.severity), set()).add(vehicle.address)
            while vehicle.changes:
                change = vehicle.changes.popleft()
                changes.setdefault((change.before, change.event, change.after), set()).add(vehicle.address)
        for (said, severity), addresses in texts.items():
            self.event("text", f"{vehicles_named(addresses)}: {said}", severity=severity)
        for (before, event, after), addresses in changes.items():
            names = {"phase": after.name, "before": before.name, "because": event.name}
            self.event("phase", f"{vehicles_named(addresses)}: {after.value}", **names)
