"""Bringing vehicles down, each by itself, whatever the others do: asked until it is on the ground, motors off."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

from fg_gcs.flight.custody import Custody
from fg_gcs.flight.fleet import STEP_S, Fleet
from fg_gcs.flight.journal import Journal
from fg_gcs.flight.policy import Care
from fg_gcs.flight.streamer import Streamer
from fg_gcs.link.clock import ticks
from fg_gcs.wire.commands import disarm, land
from fg_gcs.wire.dialogue import Dialogue, Request, State
from fg_gcs.wire.messages import HEARTBEAT
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.vehicle import Vehicle

ON_GROUND_M = 0.3  # lower than this a vehicle is disarmed rather than landed
SURE_S = 1.0  # a heartbeat so long after the first command tells: an arm command that was under way has come by then
SINK_M_S = 0.3  # slowest landing: PX4's last metre
LANDING_SPARE_S = 20.0  # on top: switching modes, detecting the ground, disarming 2 s later
RETURN_S = 180.0  # that one is left alone at least which returns: a swarm needs up to two minutes for it
AGAIN_S = 1.0  # between two dialogues that came to nothing


@dataclass(slots=True)
class _Descent:
    """One vehicle on its way down."""

    began_s: float
    patience_s: float  # how long it may be silent
    left_s: float  # since when somebody else has it: it is left alone for a while; infinite: nobody has
    mode: int | None  # in which they have it
    returns: bool  # by itself: nobody has it
    dialogue: Dialogue | None = None
    tried: set[str] = field(default_factory=set)  # names of what it refused
    next_s: float = 0.0  # when to ask again


class Descents:
    """Brings vehicles down: run it as a task from before the first one is asked to arm.

    Args:
        fleet: the vehicles.
        streamer: sends those no more setpoints that come down.
        custody: knows whom somebody else has.
        journal: where to tell of it.
        taken_wait_s: how long one that somebody else has is left alone [s].

    Attributes:
        given_up: rows of vehicles that were silent for longer than any landing takes.
        turned_s: the loop's time of the newest sign of life [s].
    """

    def __init__(
        self, fleet: Fleet, streamer: Streamer, custody: Custody, journal: Journal, taken_wait_s: float
    ) -> None:
        self.given_up: set[int] = set()
        self.turned_s = -math.inf
        self._fleet, self._streamer, self._custody, self._journal = fleet, streamer, custody, journal
        self._taken_wait_s = taken_wait_s
        self._under_way: dict[int, _Descent] = {}
        self._time = journal.time

    def begin(self, rows: Iterable[int], returning: Collection[int] = ()) -> None:
        """Send these vehicles no more setpoints, and bring them down.

        Args:
            rows: of the fleet.
            returning: those of them that return as is set for this flight, and wait above their pads for each other.
        """
        rows, now_s = list(rows), self._time()
        self._streamer.release(rows)
        for row in rows:
            if row not in self._under_way:
                vehicle = self._fleet.vehicles[row]
                height_m = max(vehicle.height_m or 0.0, 0.0)
                left_s = now_s if self._custody.care(row) is Care.LEAVE else math.inf
                patience_s = LANDING_SPARE_S + height_m / SINK_M_S
                self._under_way[row] = _Descent(now_s, patience_s, left_s, vehicle.mode, row in returning)

    def is_begun(self, row: int) -> bool:
        """Say whether a vehicle is being brought down, or was."""
        return row in self._under_way

    async def until_down(self, rows: Iterable[int]) -> None:
        """Wait until each of these is on the ground with its motors off, or was silent for longer than that takes."""
        waiting = set(rows)
        async for _ in ticks(self._time(), STEP_S):
            if all(self.is_down(row) or row in self.given_up for row in waiting):
                return

    def is_down(self, row: int) -> bool:
        """Say whether a vehicle is seen on the ground, motors off, since it was asked to come down."""
        descent, vehicle = self._under_way.get(row), self._fleet.vehicles[row]
        if descent is None or vehicle.armed or vehicle.phase is Phase.LOST:
            return False
        return vehicle.message_at_s.get(HEARTBEAT, 0.0) >= descent.began_s + SURE_S

    async def run(self) -> None:
        """Ask, and ask again."""
        async for _ in ticks(self._time(), STEP_S):
            self.turned_s = self._time()
            for row, descent in list(self._under_way.items()):
                if not self.is_down(row):
                    self._step(row, descent)

    def _step(self, row: int, descent: _Descent) -> None:
        now_s, vehicle = self._time(), self._fleet.vehicles[row]
        silent_s = now_s - max(vehicle.heard_at_s, descent.began_s)
        if silent_s > descent.patience_s:
            self.given_up.add(row)
        elif silent_s < AGAIN_S:
            self.given_up.discard(row)
        if self._is_left(vehicle, descent, now_s):
            descent.dialogue = None
            return
        if descent.dialogue is None and now_s >= descent.next_s:
            request = self._request(vehicle, descent)
            descent.dialogue = None if request is None else Dialogue(vehicle, request)
        if descent.dialogue is None:
            return
        for message in descent.dialogue.step(now_s):
            self._fleet.router.send_message(vehicle.address, message)
        state = descent.dialogue.state
        if state is State.REFUSED:
            self._refused(descent, descent.dialogue)
        if state is not State.PENDING:
            descent.dialogue, descent.next_s = None, now_s + (0.0 if state is State.DONE else AGAIN_S)

    def _is_left(self, vehicle: Vehicle, descent: _Descent, now_s: float) -> bool:
        """Say whether somebody else has a vehicle, and may go on having it for a while."""
        others = vehicle.phase is Phase.TAKEN and vehicle.mode not in (descent.mode, vehicle.profile.land_mode)
        if others:  # a mode of somebody else's, and newer than the last one that was left alone
            descent.left_s, descent.mode = now_s, vehicle.mode
        if math.isinf(descent.left_s):
            return False
        waits_s = max(self._taken_wait_s, RETURN_S if descent.returns else 0.0)
        blocked = not descent.returns and self._custody.is_blocked(self._fleet.row_of[vehicle.address])
        if now_s - descent.left_s < waits_s and not blocked:
            return True
        if blocked:
            text = f"vehicle {vehicle.address} is in {vehicle.mode_name}, which leads it to where another one is"
            self._journal.event("notice", f"{text}, so it is landed")
            descent.left_s = math.inf
            return False
        text = f"vehicle {vehicle.address} is in {vehicle.mode_name}; nobody has brought it down for {waits_s:g} s"
        self._journal.event("notice", f"{text}, so it is landed")
        descent.left_s = math.inf
        return False

    def _request(self, vehicle: Vehicle, descent: _Descent) -> Request | None:
        """Return what to ask a vehicle for now."""
        low = (vehicle.height_m or 0.0) < ON_GROUND_M
        stands = not vehicle.airborne or self._time() - descent.began_s > descent.patience_s
        if low and stands and ("disarm" not in descent.tried or self._time() - descent.began_s > descent.patience_s):
            return disarm()
        landing = vehicle.armed and vehicle.mode == vehicle.profile.land_mode == vehicle.commanded_mode
        return None if landing and self._time() - vehicle.heard_at_s < AGAIN_S else land()

    def _refused(self, descent: _Descent, dialogue: Dialogue) -> None:
        name = dialogue.request.name
        if name not in descent.tried:
            descent.tried.add(name)
            self._journal.event("warning", f"{dialogue.reason}; it is asked again")
