"""From the ground to the ground along verified plans: the flight as planned, and every way down from anywhere in it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic
from fg_gcs.errors import VehicleError
from fg_gcs.flight.context import Context
from fg_gcs.flight.descents import Descents
from fg_gcs.flight.fleet import STEP_S, until
from fg_gcs.flight.motions import Beside, Braking, Follow, Motion, Rest
from fg_gcs.flight.policy import Rung
from fg_gcs.flight.target_follower import TargetFollower
from fg_gcs.flight.wander import in_the_air
from fg_gcs.link.clock import ticks
from fg_gcs.plan.flight_plan import FlightPlan
from fg_gcs.plan.keep_clear import Column
from fg_gcs.plan.landing import part, with_room
from fg_gcs.plan.lost_link import keeping_apart
from fg_gcs.plan.trajectory import Trajectory
from fg_gcs.plan.verification import CheckedPlan, check
from fg_gcs.plan.wander import parts_of, risk_of, too_often
from fg_gcs.plan.way_home import plan_home
from fg_gcs.wire.address import vehicles_named
from fg_gcs.wire.autopilots import TakeOff
from fg_gcs.wire.commands import arm, set_mode, take_off
from fg_gcs.wire.vehicle import Vehicle

ARRIVED_M = 1.0  # a vehicle this close to where it should rest has arrived: real PX4 wanders by 0.5 m while it hovers
STILL_M = 0.1  # and this close it has settled; plans start from there, or after STILL_S all the same
STILL_S = 3.0
SETTLE_S = 10.0  # how long arriving may take after a plan has ended
CLIMB_M_S = 0.5  # slowest climb to wait for at take-off
HEARD_S = 2.0  # how long vehicles have to tell where they are after this program stood still
LET_GO_S = 5.0  # how long vehicles have to begin to land before the program ends all the same
MOST_GENTLY = 30  # vehicles of which it is computed in flight: within a tenth of a second
SLOWEST_HOME = 4.0  # times slower that a way home is flown after a fault, for the sake of another one
MOST_RISK = 0.01  # pairs too near in a flight, from which on it is not flown as planned once that shows in the air
STREAMED_S = 1.0  # how long setpoints run before the mode is asked for that needs them


class Sortie:
    """One flight of a fleet that is ready to arm.

    Args:
        context: the flight.
        plan: the task's plans from where the vehicles stand.
        descents: bring vehicles down; they run as a task.
        target_follower: of moving targets, its sources open; None: the target rests.

    Attributes:
        wander_m: how far each vehicle was seen to wander where they gathered, rms, as seen from above, shape (V,) [m];
            None: nobody looked.
    """

    def __init__(
        self, context: Context, plan: FlightPlan, descents: Descents, target_follower: TargetFollower | None
    ) -> None:
        self._context = context
        self._fleet, self._streamer, self._journal = context.fleet, context.streamer, context.journal
        self._custody, self._task, self._mission = context.custody, context.task, context.mission
        self._plan = plan
        self._descents = descents
        self._target_follower = target_follower
        self._time = context.journal.time
        self.wander_m: Array | None = None
        self._motion: Follow | None = None  # of those that fly, while others stay beside them
        self._where_stalled: Rest | None = None  # where they came to rest after this program stood still

    async def as_planned(self, origin: Geodetic) -> None:
        """Take off, gather, fly to the target and stay around it, fly home, land.

        Args:
            origin: where on Earth the mission's (0, 0, 0) is.

        Raises:
            VehicleError: a vehicle refused, or did not do what it was told in time; the target was given up.
            PlanError: there is no way home from a moving target.
        """
        all_rows = range(len(self._fleet.vehicles))
        with self._journal.in_stage("take-off"):
            await self._take_off()
        with self._journal.in_stage("gather"):
            await self._stream(all_rows, self._plan.gather)
            await self._settle(all_rows, "the formation")
            await self._measure()
        if self._target_follower is None:
            await self._to_the_target(all_rows)
        else:
            await self._after_the_target(self._target_follower, origin)

    async def _to_the_target(self, all_rows: Sequence[int]) -> None:
        hold_s = self._mission.hold.duration_s
        with self._journal.in_stage("approach"):
            await self._stream(all_rows, self._plan.approach)
        with self._journal.in_stage("hold"):
            self._journal.stage_ends_s = self._time() + hold_s
            await asyncio.sleep(hold_s)
        with self._journal.in_stage("home"):
            await self._stream(all_rows, self._plan.home)
            await self._settle(all_rows, "the places above the pads")
        await self._land(all_rows)

    async def _after_the_target(self, target_follower: TargetFollower, origin: Geodetic) -> None:
        with self._journal.in_stage("approach"):
            target_follower.begin(origin)
            await self._followed(target_follower, lambda: target_follower.caught_s is not None)
        with self._journal.in_stage("hold"):
            ends_s = (target_follower.caught_s or 0.0) + self._mission.hold.duration_s
            self._journal.stage_ends_s = target_follower.holds_until_s = ends_s
            await self._followed(target_follower, lambda: self._time() >= ends_s and target_follower.holds)
        await self._home()

    # --- ways down -----------------------------------------------------------------------------------------------

    async def way_down(self, rung: Rung) -> None:
        """Bring every vehicle that flies for us onto the ground, as a rung asks for; from anywhere, and again.

        Raises:
            PlanError: there are no verified lines for it.
            VehicleError: a vehicle does not do as told.
        """
        if not self._custody.flying():
            return
        match rung:
            case Rung.HOME:
                await self._home()
            case Rung.LANDING:
                await self._land_apart()
            case _:
                await self._land(self._custody.flying())

    async def let_go(self) -> None:
        """Command every vehicle that flies for us to land where it is, and wait no longer than until it does."""
        rows = self._custody.flying()
        self._descents.begin(rows)
        with suppress(VehicleError):
            await until(partial(self._not_landing, rows), LET_GO_S, "begin to land")

    def _not_landing(self, rows: Sequence[int]) -> list[Vehicle]:
        vehicles = [self._fleet.vehicles[row] for row in rows]
        return [vehicle for vehicle in vehicles if vehicle.armed and vehicle.mode != vehicle.profile.land_mode]

    async def _home(self) -> None:
        """Come to rest, fly home on lines verified from where every vehicle is told to be, land."""
        if not isinstance(self._present, Rest) or self._where_stalled is not None:
            with self._journal.in_stage("home"):
                still = await self._at_rest()
                rows = self._custody.flying()
                await self._fly_home(still, rows)
        await self._land(self._custody.flying())

    async def _fly_home(self, still: Motion, rows: Sequence[int]) -> None:
        """Fly to the places above the pads; whoever gets lost on the way is the policy's affair."""
        if not rows:
            return
        places, columns = self._places(still, rows), self._columns(still)
        way = await asyncio.to_thread(plan_home, places, self._context.tops_enu_m, self._task.rules, columns)
        plan = await asyncio.to_thread(self._gently, way.pieces)
        await self._stream(rows, plan, still)
        await self._settle(rows, "the places above the pads")

    def _gently(self, pieces: Sequence[Trajectory]) -> CheckedPlan:
        """Verify a way home, flown so slowly that another fault brings nobody too near, as far as that is slow enough.

        Raises:
            PlanError: it breaks a rule.
        """
        rule = self._task.lost_link
        if rule is None or len(self._fleet.vehicles) > MOST_GENTLY:
            return check(pieces, self._task.rules, self._gaze_enu_m)
        slow = replace(rule, remedy="slow")
        return keeping_apart(pieces, self._task.rules, self._gaze_enu_m, slow, SLOWEST_HOME).plan

    async def _land_apart(self) -> None:
        """Come to rest, part until each can come straight down, land."""
        if not isinstance(self._present, Rest) or self._where_stalled is not None:
            with self._journal.in_stage("spread"):
                still = await self._at_rest()
                rows = self._custody.flying()
                places, columns = self._places(still, rows), self._columns(still)
                pieces = await asyncio.to_thread(part, places, self._task.rules, columns)
                if pieces:
                    plan = await asyncio.to_thread(check, pieces, with_room(self._task.rules, places), self._gaze_enu_m)
                    await self._stream(rows, plan, still)
                    with suppress(VehicleError):  # they come down all the same, from where they have got to
                        await self._settle(rows, "the places to land")
        await self._land(self._custody.flying())

    @property
    def _present(self) -> Motion | None:
        """What moves the formation now: a plan, what follows the target, or nothing that has begun yet."""
        streamed = self._streamer.motion
        return self._motion if isinstance(streamed, Beside) else streamed

    def _places(self, still: Motion, rows: Sequence[int]) -> Array:
        """Where those at ``rows`` are told to rest, shape (V, 3) [m]."""
        places: Array = still.at(self._time()).position_m[[list(still.rows).index(row) for row in rows]]
        return places

    def _columns(self, still: Motion) -> list[Column]:
        """Where those may be by now that were given up; who still gets setpoints may hear them, and rest there."""
        for row, place in zip(still.rows, still.at(self._time()).position_m, strict=True):
            if not self._custody.counted_on(row) and self._streamer.engaged(row):
                self._custody.rests(row, place)
        columns = self._custody.columns()
        if columns:
            lost = vehicles_named(self._fleet.vehicles[row].address for row in self._custody.lost)
            text = f"ways keep clear of where {lost} may be"
            self._journal.event("clear", text, regions=[column._asdict() for column in columns])
        return columns

    async def _land(self, rows: Sequence[int]) -> None:
        """Land vehicles on the spot, and wait until they are on the ground, motors off.

        Raises:
            VehicleError: one fell silent on its way, or was disarmed in the air; the others are down.
        """
        with self._journal.in_stage("land"):
            self._descents.begin(rows)
            await self._descents.until_down(rows)
        lost = [self._fleet.vehicles[row].address for row in rows if not self._descents.is_down(row)]
        if lost:
            raise VehicleError(f"lost while landing: {vehicles_named(lost)}")
        fell = [self._fleet.vehicles[row].address for row in rows if self._fleet.vehicles[row].fell]
        if fell:
            raise VehicleError(f"disarmed in the air while landing: {vehicles_named(fell)}")

    async def _at_rest(self) -> Motion:
        """Stop on the path, or on the trajectory that is verified for it; return the motion that rests."""
        motion = self._present
        if motion is None:
            self._where_stalled = await self._where_they_are()
            return self._where_stalled
        if isinstance(motion, Rest):
            return motion
        if isinstance(motion, Braking):
            await asyncio.sleep(max(motion.end_s - self._time(), 0.0))
            return motion
        if isinstance(motion, Follow):
            before = self._streamer.motion
            if not motion.stops and motion.end_s > self._time():
                motion = self._move(motion.stopping(self._time()), before)
            await asyncio.sleep(max(motion.end_s - self._time(), 0.0))
            return self._streamer.motion or motion
        assert self._target_follower is not None, "nothing else moves a formation"
        resting, rests_s = self._target_follower.stop()
        await asyncio.sleep(rests_s - self._time())
        return resting

    async def _where_they_are(self) -> Rest:
        """Rest where the vehicles are by now: nothing was streamed for so long that they are not where they were told.

        Raises:
            VehicleError: one does not tell where it is, or does not come to rest.
        """
        rows, fleet, since_s = self._custody.flying(), self._fleet, self._time()
        if self._target_follower is not None:
            self._target_follower.close()

        def waiting() -> list[Vehicle]:
            return [fleet.vehicles[row] for row in rows if fleet.states.position_at_s[row] <= since_s]

        with suppress(VehicleError):  # who is silent is the policy's affair
            await until(waiting, HEARD_S, "tell where they are")
        places = fleet.positions_enu_m(self._time())[rows]
        still = Rest(rows, places, self._plan.gather.yaw_rad(places))
        self._streamer.motion = still
        await self._settle(rows, "rest")
        return still

    # --- as planned ----------------------------------------------------------------------------------------------

    async def _take_off(self) -> None:
        """Lift every vehicle to the place above its pad, each autopilot in its own way."""
        fleet, streamer, tops_m = self._fleet, self._streamer, self._context.tops_enu_m
        all_rows = range(len(fleet.vehicles))
        by_setpoint = [v for v in fleet.vehicles if v.profile.take_off is TakeOff.BY_SETPOINT]
        by_command = [v for v in fleet.vehicles if v.profile.take_off is TakeOff.BY_COMMAND]
        height_m = self._mission.takeoff.height_m
        ground = fleet.positions_enu_m()
        streamer.motion = Rest(all_rows, ground, self._plan.gather.yaw_rad(ground))
        streamer.engage(fleet.row_of[v.address] for v in by_setpoint)
        if by_setpoint:
            await asyncio.sleep(STREAMED_S)
        self._custody.asked.update(all_rows)
        await fleet.ask(fleet.vehicles, lambda vehicle: [set_mode(vehicle.profile.streaming_mode), arm()])
        streamer.motion = Rest(all_rows, tops_m, self._plan.gather.yaw_rad(tops_m))
        await fleet.ask(by_command, lambda vehicle: [take_off(height_m, CLIMB_M_S)])
        streamer.engage(row for row in all_rows if self._custody.counted_on(row))  # no take-off to cancel any more
        await self._settle(all_rows, f"the take-off height of {height_m:g} m", SETTLE_S + height_m / CLIMB_M_S)

    async def _measure(self) -> None:
        """Measure how far vehicles wander where they gather, unless that is known.

        Raises:
            VehicleError: so far that the flight as planned would not keep them apart.
        """
        expected, journal = self._task.wander, self._journal
        if expected is None or self._mission.limits.wander_m is not None:
            return
        gate = self._streamer.gate
        measured = await in_the_air(self._fleet, lambda: gate.told(self._time())[0], expected.sigma_m)
        if measured is None:
            return
        measured_m, least_m = measured
        self.wander_m = np.hypot(measured_m[:, 0], measured_m[:, 1])
        found, plan = expected._replace(sigma_m=np.maximum(expected.sigma_m, least_m)), self._plan
        ways = parts_of(plan.gather, plan.approach, plan.home, expected.hold_s)[1:]
        risk = risk_of(ways, found, self._task.rules.separation_m)
        level_m = float(np.sqrt((self.wander_m**2).mean()))
        journal.recorder.know(wander_in_the_air_m=level_m, wander_risk=risk.breaches)
        if found.level_m > expected.level_m:
            journal.event("wander", f"vehicles wander by {found.level_m:.2f} m, more than was to be expected")
        if risk.breaches > MOST_RISK:
            raise VehicleError(too_often(risk, found, self._task.rules.separation_m))

    async def _stream(self, rows: Sequence[int], plan: CheckedPlan, still: Motion | None = None) -> None:
        """Fly a plan to its end; while a vehicle is waited for, everybody rests on it.

        Args:
            rows: of those that it moves.
            plan: what to fly.
            still: the motion that it begins from; who was given up stays there until it can be landed.
        """
        motion = self._move(Follow.from_now(rows, plan, self._time()), still)
        self._journal.stage_ends_s = motion.end_s
        async for _ in ticks(self._time(), STEP_S):
            now_s = self._time()
            if self._custody.waits and not motion.stops and now_s < motion.end_s:
                motion = self._move(motion.stopping(now_s), still)
                self._journal.stage_ends_s = None
            elif not self._custody.waits and motion.stops and now_s >= motion.end_s:
                motion = self._move(motion.going_on(now_s), still)
                self._journal.stage_ends_s = motion.end_s
            elif not motion.stops and now_s >= motion.end_s:
                return

    def _move(self, motion: Follow, still: Motion | None = None) -> Follow:
        """Let a motion be streamed, and those that were given up stay; return it."""
        self._motion = motion
        staying = [] if still is None else [row for row in still.rows if row not in motion.rows]
        staying = [row for row in staying if self._streamer.engaged(row) and not self._descents.is_begun(row)]
        self._streamer.motion = motion
        if still is not None and staying:
            wanted, places = still.at(self._time()), [list(still.rows).index(row) for row in staying]
            self._streamer.motion = Beside(motion, staying, wanted.position_m[places], wanted.yaw_rad[places])
        return motion

    async def _followed(self, target_follower: TargetFollower, done: Callable[[], bool]) -> None:
        """Wait until something is reached; while a vehicle is waited for, everybody rests.

        Raises:
            VehicleError: there is no sense in waiting any longer; says why.
        """
        async for _ in ticks(self._time(), STEP_S):
            target_follower.rests(self._custody.waits)
            if done() and not self._custody.waits:
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
        motion, fleet = self._streamer.motion, self._fleet
        if motion is None:
            return [fleet.vehicles[row] for row in rows]
        wanted = np.full((len(fleet.vehicles), 3), np.nan)
        wanted[np.asarray(motion.rows)] = motion.at(self._time()).position_m
        errors_m = np.linalg.norm(wanted - fleet.positions_enu_m(), axis=1)
        return [fleet.vehicles[row] for row in rows if not errors_m[row] < least_m]  # NaN: not known

    @property
    def _gaze_enu_m(self) -> Array:
        """The point that noses are turned to, shape (3,) [m]."""
        return self._task.target_enu_m if self._target_follower is None else self._target_follower.gaze_enu_m
