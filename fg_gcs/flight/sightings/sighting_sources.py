"""Where the sightings of a mission's moving targets come from, all ways behind one door."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic
from fg_gcs.flight.sightings.own_source import OwnSightings
from fg_gcs.flight.sightings.sources import DatagramSource, OnRefused, OnSighting, SightingSource, TimedSource
from fg_gcs.flight.sightings.vehicle_source import VehicleReportSource
from fg_gcs.mission.target_tables import CsvSource, MovingTarget, ScriptSource, UdpSource, VehicleSource
from fg_gcs.scenario.motions import TrueMotion
from fg_gcs.scenario.sensor import Measurement, Sensor

SIMULATED_ENDPOINT: Final = "udpin:127.0.0.1:14560"  # beside 14550, where the swarm comes


class Substitutes(NamedTuple):
    """What comes in the place of a mission's own sources, by the names of the targets.

    Attributes:
        simulated_endpoint: where simulated target vehicles come.
        motions: true motions, behind the sensors that the mission describes.
        sightings: sources of one's own.
    """

    simulated_endpoint: str = SIMULATED_ENDPOINT
    motions: Mapping[str, TrueMotion] = MappingProxyType({})
    sightings: Mapping[str, OwnSightings] = MappingProxyType({})


class SightingSources:
    """Opens what the targets need, and hands on their sightings from :meth:`begin` to :meth:`close`.

    The clock is that of the running loop: a sighting's times are loop times. Both callbacks are called by the loop.

    Attributes:
        endpoints: where sightings of a target are waited for, by its name, of those that come over the network.

    Args:
        targets: the mission's.
        on_sighting: gets every sighting as it arrives; whether to believe it is not decided here.
        on_refused: gets reason and number of what arrived but was no sighting.
        substitutes: what comes in the place of the mission's sources.
        on_failure: gets a line of text when a source of one's own fails, or when a sender's clock or link does.
        unix_s: turns the loop's time into Unix time [s]; None: stamps by Unix time are refused.

    Raises:
        MissionError: a target's file cannot be read, or something in it is wrong.
    """

    def __init__(
        self,
        targets: Sequence[MovingTarget],
        on_sighting: OnSighting,
        on_refused: OnRefused,
        substitutes: Substitutes,
        on_failure: Callable[[str], None],
        unix_s: Callable[[float], float] | None = None,
    ) -> None:
        self.endpoints: dict[str, str] = {}
        self._sources: dict[str, SightingSource] = {}  # by target
        by_endpoint: dict[str, list[MovingTarget]] = {}
        for target in targets:
            own_source, own_motion = substitutes.sightings.get(target.name), substitutes.motions.get(target.name)
            if own_source is not None:
                own_source.connect(target.name, on_sighting, on_failure)
                self._sources[target.name] = own_source
                continue
            if own_motion is not None:
                self._sources[target.name] = _scripted(target, own_motion, on_sighting)
                continue
            match target.source:
                case ScriptSource():
                    motion = target.true_motion()
                    assert motion is not None, "the loader refuses scripts without a motion"
                    self._sources[target.name] = _scripted(target, motion, on_sighting)
                case CsvSource():
                    self._sources[target.name] = TimedSource(_replayed(target), on_sighting, None)
                case UdpSource(endpoint=endpoint):
                    self.endpoints[target.name] = endpoint
                    self._sources[target.name] = DatagramSource(
                        target, endpoint, on_sighting, on_refused, on_failure, unix_s
                    )
                case VehicleSource(endpoint=own):
                    self.endpoints[target.name] = own or substitutes.simulated_endpoint
                    by_endpoint.setdefault(self.endpoints[target.name], []).append(target)
        for endpoint, vehicles in by_endpoint.items():
            source = VehicleReportSource(vehicles, endpoint, on_sighting, on_refused, on_failure)
            self._sources |= {target.name: source for target in vehicles}
        self._names = [target.name for target in targets]

    async def open(self) -> None:
        """Open all ports.

        Raises:
            LinkError: one is taken; none stays open.
        """
        try:
            for source in self._every():
                await source.open()
        except BaseException:
            self.close()
            raise

    def begin(self, origin: Geodetic) -> None:
        """Begin tracking now: scripts and recordings start, and what arrives is handed on.

        Args:
            origin: where on Earth the mission's (0, 0, 0) is.
        """
        now_s = asyncio.get_running_loop().time()
        for source in self._every():
            source.begin(now_s, origin)

    def truth(self, time_s: Array) -> Array | None:
        """Return where the targets truly were, in the mission's order; None unless that is known of all of them.

        Args:
            time_s: loop times, shape (T,), not before tracking began [s].

        Returns:
            Shape (T, C, 3) [m; ENU]; NaN where a simulated vehicle did not say anything.
        """
        found = [self._sources[name].truth(name, time_s) for name in self._names]
        known = [each for each in found if each is not None]
        return np.stack(known, axis=1) if len(known) == len(found) else None

    def known_until_s(self) -> float:
        """Return the loop's time up to which true places will not be known any better; infinite for made-up targets."""
        return min(feed.known_until_s() for feed in self._every())

    def close(self) -> None:
        """Hand on no more and close all ports; may be called twice."""
        for source in self._every():
            source.close()

    def _every(self) -> list[SightingSource]:
        return list(dict.fromkeys(self._sources.values()))


def _scripted(target: MovingTarget, motion: TrueMotion, on_sighting: OnSighting) -> TimedSource:
    """Return the source of a target that moves so, seen by the sensor that the mission describes."""
    sensor = Sensor(target.name, target.sensor.settings(), target.sensor.seed)
    return TimedSource(sensor.measurements(motion), on_sighting, motion)


def _replayed(target: MovingTarget) -> Iterator[Measurement]:
    """Return what a recording holds; a sighting arrives when it was true, or at once if that was before the start."""
    return iter([Measurement(max(row.time_s, 0.0), row) for row in target.replay()])
