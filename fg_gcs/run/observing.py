"""Who watches a run from outside: called by it, never waited for, and never able to harm it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final

from fg_gcs.errors import LinkError
from fg_gcs.flight.director import Director
from fg_gcs.flight.snapshot import RunEvent, Snapshot
from fg_gcs.flight.snapshot_maker import SnapshotMaker
from fg_gcs.link.broadcast import LineBroadcast
from fg_gcs.record.write.recorder import Recorder

SOCKET: Final = "live.sock"  # in the run's folder: one snapshot a line, as JSON


class Observer:
    """Does nothing; override what you want to hear of.

    All methods are called on the flight's own loop, so they have to be quick: a few milliseconds. One that raises is
    told of in an event, and called no more.
    """

    def started(self, director: Director) -> None:
        """Take the flight's handle: :meth:`Director.interrupt` stops it: first home, then by a verified landing."""

    def event(self, event: RunEvent) -> None:
        """Take what has just happened."""

    def snapshot(self, snapshot: Snapshot) -> None:
        """Take the newest picture of the run; they come at most `FlyOptions.snapshot_hz` times a second."""


class Audience:
    """All observers of one run, and the programs that read its socket."""

    def __init__(self, observers: Sequence[Observer], recorder: Recorder, broadcast: LineBroadcast | None) -> None:
        """Take the observers; :meth:`open` opens the socket as well."""
        self._observers = list(observers)
        self._pictured = [each for each in observers if type(each).snapshot is not Observer.snapshot]
        self._recorder = recorder
        self._broadcast = broadcast
        self._maker: SnapshotMaker | None = None
        self._time = asyncio.get_running_loop().time
        recorder.listeners.append(self._heard)

    @classmethod
    @asynccontextmanager
    async def open(
        cls, observers: Sequence[Observer], recorder: Recorder, folder: Path | None
    ) -> AsyncIterator[Audience]:
        """Open the socket in a folder, unless that is None; without one the flight goes on all the same."""
        broadcast, problem = None, ""
        if folder is not None:
            try:
                broadcast = await LineBroadcast.open(folder, SOCKET)
            except LinkError as error:
                problem = str(error)
        audience = cls(observers, recorder, broadcast)
        if problem:
            recorder.event(audience._time(), "notice", f"no snapshots for other programs: {problem}")
        try:
            yield audience
        finally:
            if broadcast is not None:
                broadcast.close()

    def watch(self, director: Director, snapshot_hz: float) -> None:
        """Hand out snapshots of a flight from now on, at most so many a second [Hz]."""
        self._maker = SnapshotMaker(director, self, snapshot_hz)
        director.in_good_moments = self._maker.good_moment
        self._every(lambda observer: observer.started(director), self._observers)

    def wanted(self) -> bool:
        """Tell whether anything reads snapshots now."""
        return bool(self._pictured) or (self._broadcast is not None and self._broadcast.has_readers)

    def take(self, snapshot: Snapshot) -> None:
        """Hand a snapshot to all observers and readers."""
        self._every(lambda observer: observer.snapshot(snapshot), self._pictured)
        if self._broadcast is not None and self._broadcast.has_readers:
            self._broadcast.send(snapshot.to_json())

    def _heard(self, time_s: float, kind: str, text: str) -> None:
        event = RunEvent(time_s, kind, text)
        if self._maker is not None:
            self._maker.event(event)
        self._every(lambda observer: observer.event(event), self._observers)

    def _every(self, call: Callable[[Observer], None], observers: list[Observer]) -> None:
        for observer in tuple(observers):
            try:
                call(observer)
            except (Exception, SystemExit, asyncio.CancelledError) as error:  # whatever it is, it is the observer's own
                for known in (self._observers, self._pictured):
                    if observer in known:
                        known.remove(observer)
                text = f"observer {type(observer).__name__} failed and hears no more: {error!r}"
                self._recorder.event(self._time(), "warning", text)
