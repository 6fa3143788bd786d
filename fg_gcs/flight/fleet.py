"""The vehicles of one flight, in the order of their addresses, and how they are asked for things."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic, LocalFrame, enu_from_geodetic, geodetic_from_enu, swap_ned_enu
from fg_gcs.errors import VehicleError
from fg_gcs.flight.located import Located, located
from fg_gcs.link.clock import ticks
from fg_gcs.link.router import Router
from fg_gcs.record.write.layouts import TELEMETRY
from fg_gcs.wire.address import VehicleAddress, vehicles_named
from fg_gcs.wire.commands import Dialogue, Request, State
from fg_gcs.wire.states import StateTable
from fg_gcs.wire.vehicle import Vehicle

STEP_S = 0.02  # dialogues and conditions are checked this often: faster than any acknowledgement but PX4's first


class Fleet:
    """Row v of every array belongs to ``vehicles[v]``; frames are known after :meth:`learn_frames`.

    Whoever else speaks is a stranger from now on, see `Router.count_only`.

    Attributes:
        vehicles: in ascending order of their addresses.
        states: where they are and how they move, in their own frames, as telemetry comes.
        networks: names of their networks as tables have them, shape (V,).
        system_ids: shape (V,).
        origins_enu_m: of the vehicles' own frames in the mission's, shape (V, 3) once they are known [m; ENU].
    """

    def __init__(self, router: Router, vehicles: Sequence[Vehicle]) -> None:
        """Take the vehicles in ascending order of their addresses."""
        self.router = router
        self.vehicles = tuple(vehicles)
        self.states = StateTable(len(self.vehicles))
        for row, vehicle in enumerate(self.vehicles):
            vehicle.keep_state_in(self.states, row)
        self.row_of = {vehicle.address: row for row, vehicle in enumerate(self.vehicles)}
        self._addressed: tuple[NDArray[np.int_], tuple[VehicleAddress, ...]] = (np.empty(0, dtype=int), ())
        self._names = [TELEMETRY.text("network", vehicle.address.network) for vehicle in self.vehicles]
        self.networks = np.array(self._names)
        self.system_ids = np.array([v.address.system_id for v in self.vehicles])
        router.count_only(self.row_of)
        self.frames: tuple[LocalFrame, ...] = ()
        self.origins_enu_m = np.empty((0, 3))

    def learn_frames(self, origin: Geodetic | None, first_pad_enu_m: Array) -> None:
        """Join every vehicle's own frame to the mission's, while all stand on the ground.

        Horizontally by the geodetic origins that they report; vertically each vehicle's ground is height 0, because
        the altitudes of simulated GPS origins differ by more than a metre.

        Args:
            origin: where the mission's origin is; None: so that the first vehicle stands on the first pad.
            first_pad_enu_m: that pad, shape (2,) [m].

        Raises:
            VehicleError: a vehicle has not told its origin or its position.
        """
        missing = [v.address for v in self.vehicles if v.origin is None or v.ground_ned_m is None]
        if missing:
            raise VehicleError(f"{vehicles_named(missing)} did not tell origin or position")
        places = [(Geodetic(*v.origin), v.ground_ned_m) for v in self.vehicles if v.origin and v.ground_ned_m]
        if origin is None:
            own_origin, ground = places[0]
            away = np.append(np.asarray(first_pad_enu_m), 0.0) - swap_ned_enu(np.array([*ground[:2], 0.0]))
            origin = geodetic_from_enu(-away, own_origin)
        for own_origin, ground in places:
            east, north, _ = enu_from_geodetic(own_origin, origin).tolist()
            self.frames += (LocalFrame((east, north, ground[2])),)
        self.origins_enu_m = np.array([frame.origin_enu_m for frame in self.frames])

    def located(self, now_s: float) -> Located:
        """Return where all vehicles are at one instant of the loop's time [s], with age and uncertainty."""
        return located(self.states, self.origins_enu_m, now_s)

    def positions_enu_m(self, now_s: float | None = None) -> Array:
        """Return where the vehicles are, shape (V, 3) [m; ENU].

        Args:
            now_s: at this instant, see :meth:`located` [s]; None: the newest samples as they came.
        """
        if now_s is not None:
            return self.located(now_s).position_enu_m
        positions: Array = swap_ned_enu(self.states.position_ned_m) + self.origins_enu_m
        return positions

    def position_enu_m(self, vehicle: Vehicle) -> tuple[float, float, float] | None:
        """Return where a vehicle is [m; ENU]; None while its position or its frame is not known."""
        row = self.row_of.get(vehicle.address)
        if row is None or not self.frames or vehicle.position_ned_m is None:
            return None
        return self.frames[row].enu_from_ned(vehicle.position_ned_m)

    def telemetry_row(self, vehicle: Vehicle, time_s: float) -> tuple[float | bytes, ...] | None:
        """Return a vehicle's newest state as a row of the telemetry table; None while it or its frame is not known.

        Args:
            vehicle: any vehicle.
            time_s: since the run's start [s].
        """
        row = self.row_of.get(vehicle.address)
        if row is None or not self.frames:
            return None
        north, east, down, v_north, v_east, v_down, boot_time_s, _, _, _, ground_down, yaw_rad = self.states.numbers(
            row
        )
        if math.isnan(north):
            return None
        x, y, z = self.frames[row].origin_enu_m  # as `LocalFrame.enu_from_ned`, of which thousands come in a second
        place = (x + east, y + north, z - down, v_east, v_north, -v_down)
        return (time_s, self._names[row], vehicle.system_id, *place, yaw_rad, boot_time_s, ground_down - down)

    def addresses_of(self, rows: NDArray[np.int_]) -> tuple[VehicleAddress, ...]:
        """Return the addresses of the vehicles at some rows; the same tuple as long as the rows are the same."""
        latest, addresses = self._addressed
        if not np.array_equal(rows, latest):
            addresses = tuple(self.vehicles[row].address for row in rows.tolist())
            self._addressed = rows, addresses
        return addresses

    async def ask(self, vehicles: Iterable[Vehicle], script: Callable[[Vehicle], Iterable[Request]]) -> None:
        """Work through each vehicle's requests, one after the other, all vehicles side by side.

        Raises:
            VehicleError: one line with every request that was refused or timed out; the others were finished first.
        """
        failures: list[str] = []
        scripts = [(vehicle, iter(script(vehicle))) for vehicle in vehicles]
        running = [self._next(vehicle, requests) for vehicle, requests in scripts]
        loop = asyncio.get_running_loop()
        async for _ in ticks(loop.time(), STEP_S):
            for index, (vehicle, requests) in enumerate(scripts):
                dialogue = running[index]
                if dialogue is None:
                    continue
                message = dialogue.step(loop.time())
                if message is not None:
                    self.router.send_message(vehicle.address, message)
                if dialogue.state is State.DONE:
                    running[index] = self._next(vehicle, requests)
                elif dialogue.state is not State.PENDING:
                    failures.append(dialogue.reason)
                    running[index] = None
            if not any(running):
                break
        if failures:
            raise VehicleError("; ".join(failures))

    @staticmethod
    def _next(vehicle: Vehicle, requests: Iterable[Request]) -> Dialogue | None:
        request = next(iter(requests), None)
        return None if request is None else Dialogue(vehicle, request)


class NotInTime(VehicleError):
    """Vehicles that did not do something in time.

    Args:
        waiting: the vehicles.
        what: what they did not do, as in "did not land".
        timeout_s: how long they had [s].
    """

    def __init__(self, waiting: Sequence[Vehicle], what: str, timeout_s: float) -> None:
        self.waiting, self.what, self.timeout_s = tuple(waiting), what, timeout_s
        subject = vehicles_named(vehicle.address for vehicle in waiting)
        super().__init__(f"{subject} did not {what} within {timeout_s:g} s")


async def until(waiting: Callable[[], Sequence[Vehicle]], timeout_s: float, what: str) -> None:
    """Wait until there is no vehicle to wait for any more.

    Args:
        waiting: the vehicles that have not done it yet.
        timeout_s: how long to wait [s].
        what: what they are to do, in the words that follow "did not".

    Raises:
        NotInTime: with the vehicles that have not done it after ``timeout_s``.
    """
    async for k, late_s in ticks(asyncio.get_running_loop().time(), STEP_S):
        vehicles = waiting()
        if not vehicles:
            return
        if k * STEP_S + late_s >= timeout_s:
            raise NotInTime(vehicles, what, timeout_s)
