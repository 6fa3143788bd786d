"""After a crash, or `kill -9`: takes vehicles that a run left in the air, and brings them down by a verified way."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.errors import PlanError, VehicleError
from fg_gcs.flight.custody import Custody
from fg_gcs.flight.descents import Descents
from fg_gcs.flight.fleet import Fleet, until
from fg_gcs.flight.gate import Gate
from fg_gcs.flight.journal import Journal
from fg_gcs.flight.motions import Follow, Rest
from fg_gcs.flight.policy import Care, Fault
from fg_gcs.flight.streamer import Streamer
from fg_gcs.flight.supervisor import Supervisor, bystander
from fg_gcs.link.router import Router
from fg_gcs.plan.landing import part, with_room
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.verification import check
from fg_gcs.wire.address import vehicles_named
from fg_gcs.wire.commands import request_origin, set_message_interval, set_mode
from fg_gcs.wire.dialogue import Request
from fg_gcs.wire.vehicle import Vehicle

STREAM_HZ = 20.0  # setpoints
STREAMED_S = 1.0  # how long setpoints run before the mode is asked for that needs them
KNOWN_S = 15.0  # how long vehicles have to tell where they are
SETTLE_M, SETTLE_S = 1.0, 10.0  # near enough to where a vehicle is told to be, and how long that may take
STREAMER_DOG_S, DESCENTS_DOG_S = 0.2, 0.5  # without a sign of life a task hangs


class Recovery:
    """Brings vehicles down that are armed, wherever they are.

    Args:
        router: through which they are heard.
        vehicles: those that are ours to bring down, ascending.
        rules: limits and separation to part by; the fence gives way where they are outside.
        journal: where to tell of it.
    """

    def __init__(self, router: Router, vehicles: Sequence[Vehicle], rules: Rules, journal: Journal) -> None:
        self._fleet = Fleet(router, vehicles)
        self._rules = rules
        self._journal = journal
        self._custody = Custody(self._fleet, np.zeros((len(vehicles), 3)), journal.time)
        gate = Gate(self._fleet, rules, lambda: self._custody.kept_clear)
        self._streamer = Streamer(self._fleet, journal.recorder, STREAM_HZ, gate)

    async def run(self) -> tuple[Vehicle, ...]:
        """Bring them down; return those that are not known to be down."""
        fleet, vehicles, custody = self._fleet, self._fleet.vehicles, self._custody
        rows = range(len(vehicles))
        custody.asked.update(rows)
        descents = Descents(fleet, self._streamer, custody, self._journal, 0.0)
        async with Supervisor(self._told, self._journal) as supervisor:
            supervisor.start(bystander("streamer", self._streamer.run, lambda: self._streamer.turned_s, STREAMER_DOG_S))
            supervisor.start(bystander("descents", descents.run, lambda: descents.turned_s, DESCENTS_DOG_S))
            try:
                await self._part(custody, descents)
            except (VehicleError, PlanError) as error:
                self._journal.event("warning", f"{error}; all land where they are")
            descents.begin(rows)
            await descents.until_down(rows)
        return tuple(vehicles[row] for row in rows if not descents.is_down(row))

    def _told(self, fault: Fault) -> None:
        """Nothing more follows: everybody lands in any case."""

    async def _part(self, custody: Custody, descents: Descents) -> None:
        """Learn where they are, hold them there, and part them until the air below each is clear.

        Raises:
            VehicleError: one does not tell where it is.
            PlanError: there is no way to part.
        """
        fleet = self._fleet
        await fleet.ask(fleet.vehicles, self._streams)
        fleet.learn_frames_in_flight()
        landing = self._alone_below()
        for row in landing:  # they come down already: PX4 would come back from its failsafe if it were sent setpoints
            custody.take(row, Care.LAND)
        descents.begin(landing)
        flying = [row for row, vehicle in enumerate(fleet.vehicles) if row not in landing and vehicle.airborne]
        if not flying:
            return
        places = fleet.positions_enu_m(self._journal.time())[flying]
        await self._hold(flying, places)
        columns = custody.columns()
        pieces = await asyncio.to_thread(part, places, self._rules, columns)
        if not pieces:
            return
        plan = await asyncio.to_thread(check, pieces, with_room(self._rules, places), places.mean(axis=0))
        self._journal.event("recover", f"{self._named(flying)} part before they land")
        motion = self._streamer.motion = Follow.from_now(flying, plan, self._journal.time())
        await asyncio.sleep(motion.end_s - self._journal.time())
        with suppress(VehicleError):  # they land all the same, from where they have got to
            await self._settle(flying, motion.at(motion.end_s).position_m, "the places to land")

    def _alone_below(self) -> list[int]:
        """Rows of the vehicles that land already, and meet nobody on their way down."""
        fleet = self._fleet
        flat = fleet.positions_enu_m(self._journal.time())[:, :2]
        apart = np.linalg.norm(flat[:, None] - flat[None, :], axis=2)
        np.fill_diagonal(apart, np.inf)
        alone = apart.min(axis=1, initial=np.inf) >= self._rules.separation_m
        return [row for row, vehicle in enumerate(fleet.vehicles) if _lands(vehicle) and alone[row]]

    async def _hold(self, rows: Sequence[int], places: Array) -> None:
        """Take vehicles, in whatever mode they are, and hold them where they are."""
        yaws = np.nan_to_num([self._fleet.vehicles[row].yaw_rad or 0.0 for row in rows])
        self._streamer.motion = Rest(rows, places, yaws)
        self._streamer.engage(rows)
        await asyncio.sleep(STREAMED_S)
        vehicles = [self._fleet.vehicles[row] for row in rows]
        await self._fleet.ask(vehicles, lambda vehicle: [set_mode(vehicle.profile.streaming_mode)])
        self._journal.event("recover", f"{self._named(rows)} held where they are")
        with suppress(VehicleError):
            await self._settle(rows, places, "where they were")

    async def _settle(self, rows: Sequence[int], places: Array, where: str) -> None:
        await until(partial(self._away, rows, places), SETTLE_S, f"arrive at {where}")

    def _away(self, rows: Sequence[int], places: Array) -> list[Vehicle]:
        errors_m = np.linalg.norm(self._fleet.positions_enu_m()[list(rows)] - places, axis=1).tolist()
        return [self._fleet.vehicles[row] for row, away_m in zip(rows, errors_m, strict=True) if not away_m < SETTLE_M]

    @staticmethod
    def _streams(vehicle: Vehicle) -> Iterator[Request]:
        for stream in vehicle.profile.streams():
            yield set_message_interval(stream.message_id, stream.rate_hz)
        yield replace(request_origin(), deadline_s=KNOWN_S)

    def _named(self, rows: Sequence[int]) -> str:
        return vehicles_named(self._fleet.vehicles[row].address for row in rows)


def _lands(vehicle: Vehicle) -> bool:
    """Say whether a vehicle comes down by itself."""
    return vehicle.mode == vehicle.profile.land_mode
