"""The vehicles of one flight, in the order of their addresses, and how they are asked for things."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic, LocalFrames, Seen, geodetic_from_enu, swap_ned_enu
from fg_gcs.errors import VehicleError
from fg_gcs.flight.located import Located, located
from fg_gcs.flight.origins import MOVED_M, away_m
from fg_gcs.link.clock import ticks
from fg_gcs.link.router import Router
from fg_gcs.record.write.layouts import TELEMETRY
from fg_gcs.wire.address import VehicleAddress, vehicles_named
from fg_gcs.wire.codec import Message
from fg_gcs.wire.dialogue import Exchange, Question, State
from fg_gcs.wire.phases import Phase
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
        frames: the vehicles' own in the mission's; none before they are learnt.
        origin: where the mission's (0, 0, 0) is, once that is known.
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
        self.frames: LocalFrames | None = None
        self.origin: Geodetic | None = None

    def learn_frames(self, origin: Geodetic | None, first_pad_enu_m: Array, around_enu_m: Array) -> None:
        """Join every vehicle's own frame to the mission's, while all stand on the ground.

        Horizontally by the geodetic origins that they report; vertically each vehicle's ground is height 0, because
        the altitudes of simulated GPS origins differ by more than a metre.

        Args:
            origin: where the mission's origin is; None: so that the first vehicle stands on the first pad.
            first_pad_enu_m: that pad, shape (2,) [m].
            around_enu_m: where they fly together, shape (3,) [m; ENU].

        Raises:
            VehicleError: a vehicle has not told its origin or its position, or the frame that it tells positions in
                lies elsewhere than it says.
        """
        missing = [v.address for v in self.vehicles if v.origin is None or v.ground_ned_m is None]
        if missing:
            raise VehicleError(f"{vehicles_named(missing)} did not tell origin or position")
        for vehicle in self.vehicles:
            found_m = away_m(vehicle)
            if found_m is not None and found_m > MOVED_M:
                raise VehicleError(
                    f"vehicle {vehicle.address}: its local frame lies {found_m:.1f} m from where GPS_GLOBAL_ORIGIN "
                    "says, by its own positions; start it again"
                )
        grounds = [v.ground_ned_m for v in self.vehicles if v.ground_ned_m]
        seen = [
            Seen(v.profile.globe, Geodetic(*v.origin), ground[2])
            for v, ground in zip(self.vehicles, grounds, strict=True)
            if v.origin
        ]
        if origin is None:
            away = np.append(np.asarray(first_pad_enu_m), 0.0) - swap_ned_enu(np.array([*grounds[0][:2], 0.0]))
            origin = geodetic_from_enu(-away, seen[0].origin)
        self.origin, self.frames = origin, LocalFrames.joined(seen, origin, around_enu_m)

    def learn_frames_in_flight(self) -> None:
        """Join the vehicles' own frames to that of the first one, by the origins that they report.

        Their grounds are not known; heights count from the first one's origin, as well as the others' altitudes tell.

        Raises:
            VehicleError: a vehicle has not told its origin or its position.
        """
        missing = [v.address for v in self.vehicles if v.origin is None or v.position_ned_m is None]
        if missing:
            raise VehicleError(f"{vehicles_named(missing)} did not tell origin or position")
        origins = [Geodetic(*v.origin) for v in self.vehicles if v.origin is not None]
        self.origin = origins[0]
        seen = [
            Seen(v.profile.globe, origin, origin.altitude_m - self.origin.altitude_m)
            for v, origin in zip(self.vehicles, origins, strict=True)
        ]
        self.frames = LocalFrames.joined(seen, self.origin, np.zeros(3))

    def move_origin(self, row: int, by_enu_m: Array) -> None:
        """Join a vehicle's own frame, which has moved in flight, to the mission's anew; its ground stays where it is.

        Args:
            row: of the vehicle.
            by_enu_m: by how much it has moved, shape (3,) [m; ENU].
        """
        self.frames = self.known_frames.moved(row, by_enu_m)
        state = self.states[row]
        north, east, down = swap_ned_enu(np.asarray(by_enu_m)).tolist()
        ground = state.ground_north_m - north, state.ground_east_m - east, state.ground_down_m - down
        self.states.set_ground(row, *ground)

    @property
    def known_frames(self) -> LocalFrames:
        """The vehicles' own frames, where none can be without them."""
        assert self.frames is not None, "learnt before anything flies"
        return self.frames

    @property
    def armed(self) -> NDArray[np.bool_]:
        """Whose motors run, by the newest telemetry, shape (V,)."""
        return np.array([vehicle.armed for vehicle in self.vehicles], dtype=bool)

    def located(self, now_s: float) -> Located:
        """Return where all vehicles are at one instant of the loop's time [s], with age and uncertainty."""
        return located(self.states, self.known_frames, now_s)

    def positions_enu_m(self, now_s: float | None = None) -> Array:
        """Return where the vehicles are, shape (V, 3) [m; ENU].

        Args:
            now_s: at this instant, see :meth:`located` [s]; None: the newest samples as they came.
        """
        if now_s is not None:
            return self.located(now_s).position_enu_m
        return self.known_frames.enu_m(swap_ned_enu(self.states.position_ned_m))

    def position_enu_m(self, vehicle: Vehicle) -> tuple[float, float, float] | None:
        """Return where a vehicle is [m; ENU]; None while its position or its frame is not known."""
        row = self.row_of.get(vehicle.address)
        if row is None or self.frames is None or vehicle.position_ned_m is None:
            return None
        return self.frames.one_enu_m(row, vehicle.position_ned_m)

    def telemetry_row(self, vehicle: Vehicle, time_s: float) -> tuple[float | bytes, ...] | None:
        """Return a vehicle's newest state as a row of the telemetry table; None while it or its frame is not known.

        Args:
            vehicle: any vehicle.
            time_s: since the run's start [s].
        """
        row = self.row_of.get(vehicle.address)
        if row is None or self.frames is None:
            return None
        north, east, down, v_north, v_east, v_down, boot_time_s, _, _, _, ground_down, yaw_rad, *_ = (
            self.states.numbers(row)
        )
        if math.isnan(north):
            return None
        place = (*self.frames.one_enu_m(row, (north, east, down)), v_east, v_north, -v_down)
        return (time_s, self._names[row], vehicle.system_id, *place, yaw_rad, boot_time_s, ground_down - down)

    def addresses_of(self, rows: NDArray[np.int_]) -> tuple[VehicleAddress, ...]:
        """Return the addresses of the vehicles at some rows; the same tuple as long as the rows are the same."""
        latest, addresses = self._addressed
        if not np.array_equal(rows, latest):
            addresses = tuple(self.vehicles[row].address for row in rows.tolist())
            self._addressed = rows, addresses
        return addresses

    async def ask(
        self, vehicles: Iterable[Vehicle], script: Callable[[Vehicle], Iterable[Question]], at_once: int = 1
    ) -> None:
        """Work through each vehicle's questions in their order, all vehicles side by side.

        Args:
            vehicles: whom to ask.
            script: the questions for a vehicle; each is taken out when it can be asked.
            at_once: how many questions a vehicle may have at a time; more than one if their answers cannot be confused.

        Raises:
            NotDone: one line with everything that was refused or timed out; all else was finished first.
        """
        running = [Script(vehicle, script(vehicle), at_once) for vehicle in vehicles]
        loop = asyncio.get_running_loop()
        async for _ in ticks(loop.time(), STEP_S):
            for one in running:
                for message in one.step(loop.time()):
                    self.router.send_message(one.vehicle.address, message)
            if all(one.done for one in running):
                break
        failed = [one for one in running if one.failures]
        if failed:
            text = "; ".join(reason for one in failed for reason in one.failures)
            raise NotDone([one.vehicle for one in failed], text)


class Script:
    """What one vehicle is asked, some of it at a time; after a failure nothing new is begun.

    Attributes:
        vehicle: whom it is for.
        failures: a line for each question that was refused or timed out.
        done: nothing is asked any more.
    """

    def __init__(self, vehicle: Vehicle, questions: Iterable[Question], at_once: int) -> None:
        self.vehicle = vehicle
        self.failures: list[str] = []
        self.done = False
        self._questions = iter(questions)
        self._at_once = at_once
        self._asked: list[Exchange] = []

    def step(self, now_s: float) -> list[Message]:
        """Return the messages to send now."""
        if self.done:
            return []
        messages: list[Message] = []
        for exchange in self._asked:
            messages += exchange.step(now_s)
        self.failures += [one.reason for one in self._asked if one.state in (State.REFUSED, State.TIMED_OUT)]
        self._asked = [one for one in self._asked if one.state is State.PENDING]
        if self.failures and self.vehicle.phase is Phase.LOST:
            self._asked.clear()  # what takes its time for vehicles that are heard
        if not self.failures:
            for question in islice(self._questions, self._at_once - len(self._asked)):
                exchange = question.dialogue(self.vehicle)
                messages += exchange.step(now_s)
                self._asked.append(exchange)
        self.done = not self._asked
        return messages


class NotDone(VehicleError):
    """Vehicles that did not do what they were to do.

    Args:
        vehicles: which.
        text: what they did not do, and why as far as they told, in one line.
    """

    def __init__(self, vehicles: Iterable[Vehicle], text: str) -> None:
        self.vehicles = tuple(vehicles)
        super().__init__(text)


class NotInTime(NotDone):
    """Vehicles that did not do something in time.

    Args:
        vehicles: which.
        what: what they did not do, as in "did not land".
        timeout_s: how long they had [s].
    """

    def __init__(self, vehicles: Sequence[Vehicle], what: str, timeout_s: float) -> None:
        self.what, self.timeout_s = what, timeout_s
        subject = vehicles_named(vehicle.address for vehicle in vehicles)
        super().__init__(vehicles, f"{subject} did not {what} within {timeout_s:g} s")


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
