"""From the ground to the ground: flies the plans of a prepared fleet, watches it, and brings it down in any case."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Sequence
from contextlib import suppress
from functools import partial

import numpy as np

from fg_gcs.core.frames import Geodetic
from fg_gcs.errors import PlanError, VehicleError
from fg_gcs.flight.fleet import STEP_S, Fleet, until
from fg_gcs.flight.journal import Journal
from fg_gcs.flight.motions import Brake, Follow, FormationMotion, Motion, Rest
from fg_gcs.flight.safety import CONSEQUENCES, Action, Finding, Kind, faults, findings
from fg_gcs.flight.streamer import Streamer
from fg_gcs.flight.target_follower import TargetFollower
from fg_gcs.link.clock import ticks
from fg_gcs.mission.model import Mission
from fg_gcs.plan.flight_plan import FlightPlan, Task, plan_home
from fg_gcs.plan.verification import CheckedPlan, check
from fg_gcs.wire.address import VehicleAddress, vehicles_named
from fg_gcs.wire.autopilots import TakeOff
from fg_gcs.wire.commands import arm, disarm, land, set_mode, take_off
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.vehicle import Vehicle

WATCH_S = 0.1  # faults are sought this often: at 10 m/s a metre of way
ARRIVED_M = 1.0  # a vehicle this close to where it should rest has arrived: real PX4 wanders by 0.5 m while it hovers
STILL_M = 0.1  # and this close it has settled; plans start from there, or after STILL_S all the same
STILL_S = 3.0
ON_GROUND_M = 0.3  # lower than this a vehicle is disarmed rather than landed
SETTLE_S = 10.0  # how long arriving may take after a plan has ended
CLIMB_M_S = 0.5  # slowest climb to wait for at take-off
SINK_M_S = 0.3  # slowest landing: PX4's last metre
LANDING_SPARE_S = 20.0  # on top: switching modes, detecting the ground, disarming 2 s later

WATCHED = {  # on the way up all are still below the floor, and the take-off itself reports one that disarms there
    "take-off": frozenset(Kind) - {Kind.FENCE, Kind.DISARMED},
    **dict.fromkeys(("gather", "approach", "hold", "home"), frozenset(Kind)),
}


class Sortie:
    """One flight of a fleet that is ready to arm, along plans that are verified."""

    def __init__(
        self,
        fleet: Fleet,
        mission: Mission,
        task: Task,
        plan: FlightPlan,
        journal: Journal,
        abort: Callable[[str], None],
    ) -> None:
        """Prepare to fly.

        Args:
            fleet: vehicles with their frames.
            mission: what to fly.
            task: the mission under the limits that the vehicles really have.
            plan: the task's plans from where the vehicles stand.
            journal: where to say what happens.
            abort: called with a reason when a fault asks for it.
        """
        self.streamer = Streamer(fleet, journal.recorder, mission.stream.rate_hz)
        self._fleet = fleet
        self._mission = mission
        self._task = task
        self._plan = plan
        self._journal = journal
        self._abort = abort
        self._target_follower: TargetFollower | None = None
        self._tops_m = plan.gather.sample(np.zeros(1)).position_m[0]  # (V, 3) above the pads
        self._known_faults: set[tuple[Kind, tuple[VehicleAddress, ...]]] = set()
        self._time = journal.time

    async def fly(self) -> None:
        """Take off, fly all plans, land.

        Raises:
            VehicleError: a vehicle refused, or did not do what it was told in time.
        """
        all_rows = range(len(self._fleet.vehicles))
        await self._gather(all_rows)
        with self._journal.in_stage("approach"):
            await self._stream(all_rows, self._plan.approach)
        with self._journal.in_stage("hold"):
            self._journal.stage_ends_s = self._time() + self._mission.hold.duration_s
            await asyncio.sleep(self._mission.hold.duration_s)
        with self._journal.in_stage("home"):
            await self._stream(all_rows, self._plan.home)
            await self._settle(all_rows, "the places above the pads")
        with self._journal.in_stage("land"):
            await self._land(all_rows)

    async def track(self, target_follower: TargetFollower, origin: Geodetic) -> None:
        """Take off, gather, catch what moves and stay around it, fly home from there, land.

        Args:
            target_follower: whose sources are open.
            origin: where on Earth the mission's (0, 0, 0) is.

        Raises:
            VehicleError: a vehicle did not do as told, or the target follower was given up.
        """
        await self._gather(range(len(self._fleet.vehicles)))
        with self._journal.in_stage("approach"):
            self._target_follower = target_follower
            target_follower.begin(origin)
            await self._followed(target_follower, lambda: target_follower.caught_s is not None)
        with self._journal.in_stage("hold"):
            ends_s = self._journal.stage_ends_s = (target_follower.caught_s or 0.0) + self._mission.hold.duration_s
            await self._followed(target_follower, lambda: self._time() >= ends_s)
        try:
            await self._home_from_anywhere()
        except PlanError as error:
            raise VehicleError(f"there is no way home: {error}") from error

    async def bring_down(self, patience: Callable[[Awaitable[None]], Awaitable[None]]) -> None:
        """Get every vehicle that still obeys onto the ground: home on checked lines if possible, else on the spot.

        Args:
            patience: runs the way home and raises :class:`VehicleError` when it is interrupted once more.
        """
        await self._disarm_the_low()
        if not self._obeying():
            return
        try:
            await patience(self._home_from_anywhere())
        except (VehicleError, PlanError) as error:
            self._journal.event("abort", f"landing on the spot: {error}")
            try:
                with self._journal.in_stage("land"):
                    await self._land(self._obeying())
            except VehicleError as again:
                self._journal.event("warning", str(again))

    async def watch(self) -> None:
        """Look for faults while plans are flown, and act on each once: run it as a task."""
        async for _ in ticks(self._time(), WATCH_S):
            watched = WATCHED.get(self._journal.stage, frozenset())
            for fault in faults(self._new(watched), self._task.rules):
                self._journal.event(
                    "fault",
                    fault.text,
                    fault=fault.kind.name.lower(),
                    vehicles=[vehicle.label for vehicle in fault.vehicles],
                )
                if fault.kind in (Kind.LOST, Kind.TAKEN):
                    self.streamer.release(self._fleet.row_of[vehicle] for vehicle in fault.vehicles)
                if CONSEQUENCES[fault.kind] is Action.ABORT:
                    self._abort(fault.text)

    def _new(self, watched: Collection[Kind]) -> list[Finding]:
        """Return what is wrong now, of some kinds, and was not before."""
        fleet, now_s = self._fleet, self._time()
        found = findings(
            fleet.vehicles, fleet.positions_enu_m(now_s), fleet.states.position_at_s, self._task.rules, now_s
        )
        new = [one for one in found if one.kind in watched and (one.kind, one.vehicles) not in self._known_faults]
        self._known_faults.update((one.kind, one.vehicles) for one in new)
        return new

    # --- as planned ----------------------------------------------------------------------------------------------

    async def _gather(self, all_rows: Sequence[int]) -> None:
        with self._journal.in_stage("take-off"):
            await self._take_off()
        with self._journal.in_stage("gather"):
            await self._stream(all_rows, self._plan.gather)
            await self._settle(all_rows, "the formation")

    async def _take_off(self) -> None:
        """Lift every vehicle to the place above its pad, each autopilot in its own way."""
        fleet, streamer = self._fleet, self.streamer
        all_rows = range(len(fleet.vehicles))
        by_setpoint = [v for v in fleet.vehicles if v.profile.take_off is TakeOff.BY_SETPOINT]
        by_command = [v for v in fleet.vehicles if v.profile.take_off is TakeOff.BY_COMMAND]
        height_m = self._mission.takeoff.height_m
        ground = fleet.positions_enu_m()
        streamer.motion = Rest(all_rows, ground, self._plan.gather.yaw_rad(ground))
        streamer.engage(fleet.row_of[v.address] for v in by_setpoint)
        await fleet.ask(fleet.vehicles, lambda vehicle: [set_mode(vehicle.profile.streaming_mode), arm()])
        streamer.motion = Rest(all_rows, self._tops_m, self._plan.gather.yaw_rad(self._tops_m))
        await fleet.ask(by_command, lambda vehicle: [take_off(height_m, CLIMB_M_S)])
        streamer.engage(all_rows)  # the last of them is in the air: setpoints cancel no take-off any more
        await self._settle(all_rows, f"the take-off height of {height_m:g} m", SETTLE_S + height_m / CLIMB_M_S)

    async def _stream(self, rows: Sequence[int], plan: CheckedPlan) -> None:
        motion = Follow(rows, plan, self._time())
        self.streamer.motion = motion
        self._journal.stage_ends_s = motion.end_s
        await asyncio.sleep(plan.duration_s)

    async def _followed(self, target_follower: TargetFollower, done: Callable[[], bool]) -> None:
        """Wait until something is reached.

        Raises:
            VehicleError: there is no sense in waiting any longer; says why.
        """
        async for _ in ticks(self._time(), STEP_S):
            if done():
                return
            reason = target_follower.give_up_reason()
            if reason is not None:
                raise VehicleError(reason)

    async def _settle(self, rows: Sequence[int], where: str, timeout_s: float = SETTLE_S) -> None:
        """Wait until the vehicles have arrived where the motion has come to rest."""
        await until(partial(self._away, rows, ARRIVED_M), timeout_s, f"arrive at {where}")
        with suppress(VehicleError):  # in wind, or with a noisy estimate, none ever stands still
            await until(partial(self._away, rows, STILL_M), STILL_S, f"come to rest at {where}")

    def _away(self, rows: Sequence[int], least_m: float) -> list[Vehicle]:
        """Return the vehicles that are no closer than that to where the present motion wants them [m]."""
        motion, fleet = self.streamer.motion, self._fleet
        if motion is None:
            return [fleet.vehicles[row] for row in rows]
        wanted = np.full((len(fleet.vehicles), 3), np.nan)
        wanted[np.asarray(motion.rows)] = motion.at(self._time()).position_m
        errors_m = np.linalg.norm(wanted - fleet.positions_enu_m(), axis=1)
        return [fleet.vehicles[row] for row in rows if not errors_m[row] < least_m]  # NaN: not known

    async def _land(self, rows: Sequence[int]) -> None:
        """Land vehicles on the spot, and wait until they are disarmed."""
        vehicles = [self._fleet.vehicles[row] for row in rows]
        try:
            await self._fleet.ask(vehicles, lambda vehicle: [land()])
        finally:
            self.streamer.release(rows)
        highest_m = max((vehicle.height_m or 0.0 for vehicle in vehicles), default=0.0)
        wait_s = LANDING_SPARE_S + highest_m / SINK_M_S
        await until(
            lambda: [vehicle for vehicle in vehicles if vehicle.armed and vehicle.phase is not Phase.LOST],
            wait_s,
            "land and disarm",
        )
        lost = [vehicle.address for vehicle in vehicles if vehicle.phase is Phase.LOST]
        if lost:
            raise VehicleError(f"lost while landing: {vehicles_named(lost)}")

    # --- when something is wrong ---------------------------------------------------------------------------------

    async def _disarm_the_low(self) -> None:
        """Disarm the vehicles that have not really lifted off; one that does not disarm is landed with the others."""
        low = [row for row in self._obeying() if (self._fleet.vehicles[row].height_m or 0.0) < ON_GROUND_M]
        self.streamer.release(low)
        try:
            await self._fleet.ask([self._fleet.vehicles[row] for row in low], lambda vehicle: [disarm()])
        except VehicleError as error:
            self._journal.event("warning", f"{error}; landing instead")

    async def _home_from_anywhere(self) -> None:
        """Come to rest, fly home on lines checked from where every vehicle is told to be, land.

        Raises:
            PlanError: there are no such lines.
            VehicleError: a vehicle does not do as told.
        """
        if not isinstance(self.streamer.motion, Follow | FormationMotion):
            raise VehicleError("every vehicle is above its own pad")
        with self._journal.in_stage("home"):
            still = await self._at_rest(self.streamer.motion)
            rows = self._obeying()
            await self._stream(rows, self._way_home(still, rows))
            await self._settle(rows, "the places above the pads")
        with self._journal.in_stage("land"):
            await self._land(rows)

    async def _at_rest(self, motion: Follow | FormationMotion) -> Motion:
        """Stop on the path, or on the trajectory that is verified for it; return the motion that rests."""
        if isinstance(motion, Follow):
            brake = self.streamer.motion = Brake(motion, self._time())
            await asyncio.sleep(brake.end_s - self._time())
            return brake
        assert self._target_follower is not None, "nothing else moves a formation"
        resting, rests_s = self._target_follower.stop()
        await asyncio.sleep(rests_s - self._time())
        return resting

    def _way_home(self, still: Motion, rows: Sequence[int]) -> CheckedPlan:
        """Plan and verify the way home of those at ``rows`` from where they have come to rest."""
        places = still.at(self._time()).position_m[[list(still.rows).index(row) for row in rows]]
        others = [row for row, v in enumerate(self._fleet.vehicles) if row not in rows and v.armed]
        in_the_way = self._fleet.positions_enu_m()[others]  # lost or taken: as far as known, they stay where they are
        way = plan_home(places, self._tops_m[list(rows)], self._task, in_the_way)
        gaze_enu_m = self._task.target_enu_m if self._target_follower is None else self._target_follower.gaze_enu_m
        return check(way.pieces, self._task.rules, gaze_enu_m)

    def _obeying(self) -> list[int]:
        """Rows of the vehicles that are armed, or may be, and that are heard and not taken over."""
        return [
            row
            for row, vehicle in enumerate(self._fleet.vehicles)
            if vehicle.may_be_armed and vehicle.phase not in (Phase.LOST, Phase.TAKEN)
        ]
