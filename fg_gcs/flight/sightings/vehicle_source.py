"""Sightings from MAVLink vehicles that say where they are."""

from __future__ import annotations

import asyncio
import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from typing import Any

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic, enu_from_geodetic
from fg_gcs.flight.sightings.senders import SenderClocks, Senders, SightingQueue
from fg_gcs.flight.sightings.sources import OnRefused, OnSighting, shifted
from fg_gcs.link.endpoint import Address, Wire, parse_endpoint
from fg_gcs.link.opening import open_wire
from fg_gcs.mission.target_tables import MovingTarget, VehicleSource
from fg_gcs.scenario.sensor import Sensor
from fg_gcs.track.sightings import Sighting, Verdict, isotropic
from fg_gcs.wire.codec import MAGIC_V2, Codec, Frame, is_known
from fg_gcs.wire.messages import GLOBAL_POSITION_INT

MOST_WORK = 512  # of reading one datagram, see `Codec.receive`: half a millisecond
MOST_REPORTS = 2000  # kept of a simulated vehicle: at 100 Hz 10 s, and the truth is written down far sooner
CARRIED_S = 1.0  # how far the last two reports say where a simulated vehicle goes on to
MOST_ALTITUDE_M = 1e5  # nothing that flies on air is higher


class VehicleReportSource:
    """MAVLink vehicles that say where they are, all that come to one port.

    A simulated one tells the truth, which the target's sensor then spoils. Of a real one what it says is a sighting,
    true when its own stamp says, less the sensor's delay: where its link falls behind, the stamps do.

    Args:
        targets: whose sources are vehicles.
        endpoint: where they come.
        on_sighting: gets the sightings.
        on_refused: gets the reasons why messages gave none, and how many.
        tell: gets lines for people about senders.
    """

    def __init__(
        self,
        targets: list[MovingTarget],
        endpoint: str,
        on_sighting: OnSighting,
        on_refused: OnRefused,
        tell: Callable[[str], None],
    ) -> None:
        self._endpoint = endpoint
        self._on_sighting, self._on_refused = on_sighting, on_refused
        self._vehicles: dict[tuple[int, str], MovingTarget] = {
            (target.source.system_id, target.source.message): target
            for target in targets
            if isinstance(target.source, VehicleSource)
        }
        self._sensors = {
            target.name: Sensor(target.name, target.sensor.settings(), target.sensor.seed)
            for target in targets
            if target.simulated
        }
        self._reports = {name: _Reports() for name in self._sensors}
        self._system_ids = frozenset(system_id for system_id, _ in self._vehicles)
        self._codec = Codec(datagrams=True)  # nothing is kept from one to the next, so it serves all senders
        self._senders, self._clocks = Senders(), SenderClocks(tell)
        self._queue = SightingQueue(on_sighting)
        self._wire: Wire | None = None
        self._began: tuple[float, Geodetic] | None = None

    async def open(self) -> None:
        """Open the port.

        Raises:
            LinkError: it is taken.
        """
        self._wire = await open_wire(parse_endpoint(self._endpoint), self._receive)

    def begin(self, began_s: float, origin: Geodetic) -> None:
        """Read messages from now on."""
        self._began = (began_s, origin)

    def truth(self, target: str, time_s: Array) -> Array | None:
        """Return where a simulated vehicle was by its own reports, (T,) [s] to (T, 3) [m; ENU]; NaN where unknown."""
        reports = self._reports.get(target)
        return None if reports is None else reports.at(np.asarray(time_s, dtype=float))

    def known_until_s(self) -> float:
        """Return when the simulated vehicle that is heard least had its last report [s]."""
        return min((reports.known_until_s for reports in self._reports.values()), default=math.inf)

    def close(self) -> None:
        """Close the port; what a sensor still has under way is lost."""
        self._began = None
        self._queue.close()
        if self._wire is not None:
            self._wire.close()

    def _receive(self, wire: Wire, address: Address, data: bytes) -> None:
        if self._began is None:
            return
        now_s = asyncio.get_running_loop().time()
        promising = len(data) > 5 and (data[5] if data[0] == MAGIC_V2 else data[3]) in self._system_ids
        if self._senders.exceeded(address, promising, now_s):
            self._on_refused(Verdict.FLOOD, 1)
            return
        for frame in self._codec.receive(data, MOST_WORK):
            target = self._vehicles.get((frame.system_id, frame.get_type())) if is_known(frame) else None
            if target is not None:
                self._senders.sent_sightings(address, 1, now_s)
                self._take(target, frame, address, now_s, *self._began)
        if self._codec.waiting:
            self._codec.restart()
            self._on_refused(Verdict.FLOOD, 1)

    def _take(
        self, target: MovingTarget, frame: Frame, address: Address, now_s: float, began_s: float, origin: Geodetic
    ) -> None:
        said = frame.fields()
        place = _place(frame, said)
        if place is None:
            self._on_refused(Verdict.MALFORMED, 1)
            return
        position = enu_from_geodetic(place, origin)
        sensor = self._sensors.get(target.name)
        if sensor is None:
            covariance, true_s = isotropic(target.sensor.sigma_m), now_s
            stamp_s = (said.time_boot_ms if frame.message_id == GLOBAL_POSITION_INT else said.timestamp) / 1e3
            if stamp_s > 0.0:  # otherwise it does not know the time
                true_s = stamp_s + self._clocks.offset_s(address, target.name, stamp_s, now_s)
            self._queue.put([Sighting(target.name, true_s - target.sensor.delay_s, position, covariance, now_s)])
            return
        self._reports[target.name].add(now_s, position)
        sighting = sensor.measure(now_s - began_s, position)
        if sighting is not None:
            asyncio.get_running_loop().call_at(began_s + sighting.received_s, self._arrive, sighting)

    def _arrive(self, sighting: Sighting) -> None:
        if self._began is not None:
            self._on_sighting(shifted(sighting, self._began[0], asyncio.get_running_loop().time()))


class _Reports:
    """Where a simulated vehicle said it was: the truth, as far as it is known."""

    def __init__(self) -> None:
        self._times_s: list[float] = []
        self._positions: list[Array] = []

    def add(self, time_s: float, position_enu_m: Array) -> None:
        """Keep one more; of two at one time the first."""
        if self._times_s and time_s <= self._times_s[-1]:
            return
        self._times_s.append(time_s)
        self._positions.append(position_enu_m)
        if len(self._times_s) > MOST_REPORTS:
            del self._times_s[: MOST_REPORTS // 2], self._positions[: MOST_REPORTS // 2]

    @property
    def known_until_s(self) -> float:
        """Time of the last report [s]; minus infinity while there are no two."""
        return self._times_s[-1] if len(self._times_s) > 1 else -math.inf

    def at(self, time_s: Array) -> Array:
        """Interpolate between reports, (T,) [s] to (T, 3) [m; ENU], and a little beyond the last; NaN elsewhere."""
        if len(self._times_s) < 2 or not len(time_s):
            return np.full((len(time_s), 3), np.nan)
        first = max(bisect_right(self._times_s, float(np.min(time_s))) - 1, 0)
        last = max(bisect_left(self._times_s, float(np.max(time_s))) + 1, first + 2)
        times, positions = np.array(self._times_s[first:last]), np.array(self._positions[first:last])
        if last >= len(self._times_s):
            rate = (self._positions[-1] - self._positions[-2]) / (self._times_s[-1] - self._times_s[-2])
            times = np.append(times, times[-1] + CARRIED_S)
            positions = np.concatenate((positions, [positions[-1] + CARRIED_S * rate]))
        return np.stack([np.interp(time_s, times, axis, left=np.nan, right=np.nan) for axis in positions.T], axis=1)


def _place(frame: Frame, said: Any) -> Geodetic | None:  # noqa: ANN401 - depends on the message
    """Return where a GLOBAL_POSITION_INT or a FOLLOW_TARGET says that its sender is, None if that is no place."""
    altitude_m = said.alt / 1e3 if frame.message_id == GLOBAL_POSITION_INT else said.alt
    place = Geodetic(said.lat / 1e7, said.lon / 1e7, altitude_m)
    unknown = place.latitude_deg == place.longitude_deg == 0.0  # what vehicles say before they know
    inside = abs(place.latitude_deg) <= 90.0 and abs(place.longitude_deg) <= 180.0 and abs(altitude_m) < MOST_ALTITUDE_M
    return place if inside and not unknown else None
