"""What of a router's traffic is written down: all frames, and every position sample of the fleet."""

from __future__ import annotations

from collections.abc import Sequence

from fg_gcs.flight.fleet import Fleet
from fg_gcs.link.router import Direction
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import VehicleAddress
from fg_gcs.wire.codec import Frame
from fg_gcs.wire.framing import Frames
from fg_gcs.wire.messages import LOCAL_POSITION_NED
from fg_gcs.wire.vehicle import Vehicle


class LinkRecorder:
    """Listens to a router, see `Router.open`, and writes into a run's recorder.

    Attributes:
        fleet: whose positions are kept, once it is known and as soon as its frames are.
    """

    def __init__(self, recorder: Recorder) -> None:
        """Write into the run's recorder."""
        self.fleet: Fleet | None = None
        self._recorder = recorder
        self._samples: dict[VehicleAddress, int] = {}  # written down so far

    def tap(self, _direction: Direction, frames: Sequence[bytes] | Frames, now_s: float) -> None:
        """Write down frames of either direction."""
        self._recorder.frames(frames, now_s)

    def on_frame(self, vehicle: Vehicle, frame: Frame, now_s: float) -> None:
        """Write down where the vehicle is, if that is what it has said and it is news."""
        known = self._samples.get(vehicle.address)
        if frame.message_id == LOCAL_POSITION_NED and self.fleet is not None and vehicle.samples != known:
            self._samples[vehicle.address] = vehicle.samples
            row = self.fleet.telemetry_row(vehicle, self._recorder.since_start_s(now_s))
            if row is not None:
                self._recorder.telemetry.append(row)
