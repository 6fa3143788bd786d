"""One run from the first heartbeat to the last word: connects, prepares, plans, flies, and always comes back."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic, geodetic_from_enu
from fg_gcs.errors import MissionError, VehicleError
from fg_gcs.flight.discovery import discover
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.garbage import short_collections
from fg_gcs.flight.journal import Journal
from fg_gcs.flight.link_recorder import LinkRecorder
from fg_gcs.flight.preparation import Failsafes, prepare, vehicle_limits
from fg_gcs.flight.sightings.sighting_sources import Substitutes
from fg_gcs.flight.sortie import Sortie
from fg_gcs.flight.streamer import Streamer
from fg_gcs.flight.target_follower import TargetFollower, TrackingSummary
from fg_gcs.link.clock import ticks
from fg_gcs.link.endpoint import Endpoint
from fg_gcs.link.router import Counters, Router
from fg_gcs.mission.model import Mission
from fg_gcs.plan.flight_plan import FlightPlan, Task, compile_flight, plan_figures
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import MAIN, VehicleAddress, names, vehicles_named
from fg_gcs.wire.phases import Phase

DRAIN_S = 0.2  # how often everything is written down: soon enough for a person to read along, and after a crash


class Setup(NamedTuple):
    """How a run is connected."""

    networks: Mapping[str, tuple[Endpoint, ...]]  # by name, see `parse_networks`
    wait_s: float  # how long to wait for the vehicles' first heartbeats
    simulated: bool  # the vehicles are our own simulator's: the mission says where the world's origin is
    stopwatch: Callable[[], float]  # seconds, for planning times
    substitutes: Substitutes = Substitutes()  # for the sources of sightings that the mission names


@dataclass
class FlightResult:
    """How a run went."""

    completed: bool = False
    reason: str = ""  # why it was not
    stages: dict[str, tuple[float, float]] = field(default_factory=dict)  # begin and end since the run's start [s]
    plan: FlightPlan | None = None
    task: Task | None = None  # as planned: under the limits that the vehicles really have
    vehicles: tuple[VehicleAddress, ...] = ()  # those that took part, ascending
    vehicles_landed: int = 0
    lost: tuple[VehicleAddress, ...] = ()  # those that fell silent and did not come back
    not_down: tuple[VehicleAddress, ...] = ()  # those that are not known to be on the ground with their motors off
    late_ticks: int = 0
    counters: Counters | None = None
    tracking: TrackingSummary | None = None  # of missions with moving targets, once tracking has begun


class Director:
    """Flies one mission once.

    Attributes:
        result: what is known so far.
        fleet: the vehicles, once they are found.
        journal: the present stage and what was said.
        mission: what is flown.
        target_follower: of moving targets, once it is ready.
        streamer: the source of setpoints, once there is a plan.
        in_good_moments: called with the loop's time [s] when milliseconds of work delay no setpoint; must not raise.
    """

    def __init__(self, mission: Mission, setup: Setup, recorder: Recorder) -> None:
        """Prepare to fly; nothing is opened before :meth:`fly`."""
        self.result = FlightResult()
        self.fleet: Fleet | None = None
        self.journal = Journal(recorder, asyncio.get_running_loop().time)
        self.target_follower: TargetFollower | None = None
        self.streamer: Streamer | None = None
        self.in_good_moments: Callable[[float], None] | None = None
        self.mission = mission
        self._router: Router | None = None
        self._link_recorder = LinkRecorder(recorder)
        self._setup = setup
        self._interrupts: asyncio.Queue[str] = asyncio.Queue()
        self._failure: BaseException | None = None

    def interrupt(self, reason: str) -> None:
        """Stop the flight: the first time by flying home, a second time by landing on the spot."""
        self._interrupts.put_nowait(reason)

    def fail(self, context: dict[str, Any]) -> None:
        """Take an exception that came up in a callback of the event loop: a fault of ours, so the flight ends.

        It is raised by :meth:`fly` once all vehicles are down.
        """
        error = context.get("exception") or RuntimeError(context["message"])
        if self._failure is None:
            self._failure = error
            self.interrupt(f"internal error: {error!r}")

    @property
    def networks(self) -> tuple[str, ...]:
        """Names of the networks that the vehicles are in."""
        return tuple(self._setup.networks)

    @property
    def counters(self) -> Counters:
        """What went through the sockets so far."""
        return Counters.none() if self._router is None else self._router.counters

    def wanted_enu_m(self, now_s: float) -> Array:
        """Return where the vehicles are told to be, shape (V, 3) [m; ENU]; NaN where nothing is streamed."""
        fleet, streamer = self.fleet, self.streamer
        wanted = np.full((0 if fleet is None else len(fleet.vehicles), 3), np.nan)
        if streamer is not None and streamer.motion is not None:
            engaged = [row for row in streamer.motion.rows if streamer.engaged(row)]
            places = [place for place, row in enumerate(streamer.motion.rows) if streamer.engaged(row)]
            wanted[engaged] = streamer.motion.at(now_s).position_m[places]
        return wanted

    async def fly(self) -> FlightResult:
        """Fly the mission; returns with every vehicle that still obeys on the ground.

        Raises:
            LinkError: too few vehicles answered, or a port is taken.
            MissionError: the mission's vehicles are in a network that is not there.
            PlanError: the mission has no plan; nothing was armed.
        """
        networks = self._setup.networks
        wanted = self._wanted()
        router = self._router = await Router.open(
            networks, on_frame=self._link_recorder.on_frame, tap=self._link_recorder.tap
        )
        self.journal.event("open", f"listening at {_places(networks)}")
        background = [asyncio.create_task(router.keep_alive()), asyncio.create_task(self._drain(router))]
        try:
            with short_collections():
                await self._run(router, wanted, background)
        finally:
            for task in background:
                task.cancel()
            await asyncio.gather(*background, return_exceptions=True)
            self.journal.drain(router, self.fleet.vehicles if self.fleet else ())
            self.result.stages = self.journal.stages
            self.result.counters = router.counters
            router.close()
            if self.target_follower is not None:
                self.target_follower.close()
                self.result.tracking = self.target_follower.tracking
        if self._failure is not None:
            raise self._failure
        return self.result

    async def _run(
        self, router: Router, wanted: tuple[VehicleAddress, ...] | None, background: list[asyncio.Task[None]]
    ) -> None:
        failsafes: list[Failsafes] = []
        sorties: list[Sortie] = []

        async def on_the_ground() -> None:
            fleet = await self._connect(router, wanted)
            with self.journal.in_stage("prepare"):
                task = await self._prepare(fleet, failsafes)
            with self.journal.in_stage("plan"):
                plan = self._plan(fleet, task)
                sortie = Sortie(fleet, self.mission, task, plan, self.journal, self.interrupt)
                if self.mission.targets is not None:
                    self.target_follower = await self._listen(sortie.streamer, task, plan)
                sorties.append(sortie)

        try:
            await self._unless_interrupted(on_the_ground())
            sortie = sorties[0]
            self.streamer = sortie.streamer
            self.streamer.after_round = self._good_moment
            background += [asyncio.create_task(sortie.streamer.run()), asyncio.create_task(sortie.watch())]
            if self.target_follower is None:
                flight = sortie.fly()
            else:
                background.append(asyncio.create_task(self.target_follower.run()))
                flight = sortie.track(self.target_follower, self._origin())
            await self._unless_interrupted(self._all_alive(flight, background))
            self.result.completed = True
        except VehicleError as error:
            self.result.reason = str(error)
            self.journal.event("abort", f"aborting: {error}")
        finally:
            for sortie in sorties:
                if not self.result.completed:
                    await sortie.bring_down(self._unless_interrupted)
                self.result.late_ticks = sortie.streamer.late_ticks
            self._count()
            for failsafe in failsafes:
                await self._put_back(failsafe)

    def _wanted(self) -> tuple[VehicleAddress, ...] | None:
        """Return the vehicles that the mission names; None where any will do.

        Raises:
            MissionError: it names a network that is not there.
        """
        swarm, networks = self.mission.swarm, self._setup.networks
        if not (swarm.system_ids or self._setup.simulated):
            return None
        only = MAIN if len(networks) == 1 else None  # whatever the mission calls it
        wanted = [VehicleAddress(only or network or MAIN, system_id) for network, system_id in swarm.members()]
        elsewhere = sorted({address for address in wanted if address.network not in networks})
        if elsewhere:
            known = ", ".join(networks)
            raise MissionError(f"[swarm] system_ids: {names(elsewhere)} is in no network; the networks are {known}")
        if len(set(wanted)) < len(wanted):
            raise MissionError(
                "[swarm] system_ids: one network cannot have two vehicles of one id; connect all of them"
            )
        return tuple(sorted(wanted))

    async def _connect(self, router: Router, wanted: tuple[VehicleAddress, ...] | None) -> Fleet:
        setup, count = self._setup, self.mission.swarm.vehicles
        with self.journal.in_stage("connect"):
            found = await discover(router, setup.networks, count, wanted, setup.wait_s, self.journal)
            router.tell_shortages()
            self.fleet = self._link_recorder.fleet = Fleet(router, found)
            self.result.vehicles = tuple(self.fleet.row_of)
            kinds = sorted({vehicle.profile.name for vehicle in found})
            self.journal.event("vehicles", f"{vehicles_named(self.fleet.row_of)} answered ({', '.join(kinds)})")
        return self.fleet

    async def _prepare(self, fleet: Fleet, failsafes: list[Failsafes]) -> Task:
        """Get the fleet ready; return the mission's task under the limits that the vehicles really have."""
        task = self.mission.task()
        await prepare(fleet, self.journal)
        limits = vehicle_limits(fleet, task.rules.limits, self.journal)
        failsafes.append(Failsafes(fleet, self.journal))
        await failsafes[0].set()
        origin = self.mission.origin_geodetic() if self._knows_origin else None
        fleet.learn_frames(origin, self.mission.pads_enu_m()[0])
        self.journal.recorder.know(
            vehicles=len(fleet.vehicles),
            limits=vars(limits),
            separation_m=task.rules.separation_m,
            target_enu_m=task.target_enu_m,
        )
        return replace(task, rules=replace(task.rules, limits=limits))

    def _plan(self, fleet: Fleet, task: Task) -> FlightPlan:
        """Plan from where the vehicles really stand, and verify it, before anything is armed."""
        tops = fleet.positions_enu_m()
        tops[:, 2] = self.mission.takeoff.height_m
        plan = compile_flight(task, tops, self._setup.stopwatch)
        self.result.plan, self.result.task = plan, task
        ids = [vehicle.label for vehicle in fleet.row_of]
        leaders = [ids[row] for row in plan.rim_of]
        self.journal.recorder.know(leader_ids=leaders, **plan_figures(ids, plan))
        self.journal.event(
            "plan",
            f"{plan.figures.path_length_m:.1f} m for {len(plan.rim_of)} leaders in {plan.approach.duration_s:.1f} s, "
            f"never closer than {plan.separation.distance_m:.2f} m; "
            f"planned in {1e3 * (plan.plan_time_s + plan.timing_time_s):.0f} ms",
        )
        return plan

    @property
    def _knows_origin(self) -> bool:
        return self.mission.origin is not None or self._setup.simulated

    async def _listen(self, streamer: Streamer, task: Task, plan: FlightPlan) -> TargetFollower:
        """Open the sources of moving targets, before anything is armed."""
        setup = self._setup
        target_follower = TargetFollower(
            self.mission,
            task,
            task.formation.slots_m[plan.slot_of],
            streamer,
            self.journal,
            setup.stopwatch,
            setup.substitutes,
        )
        await target_follower.open()
        return target_follower

    def _origin(self) -> Geodetic:
        """Return where on Earth the mission's (0, 0, 0) is: as the file says, or as learnt from the first vehicle."""
        own = None if self.fleet is None else self.fleet.vehicles[0].origin
        if self._knows_origin or self.fleet is None or own is None:
            return self.mission.origin_geodetic()
        return geodetic_from_enu(-np.array(self.fleet.frames[0].origin_enu_m), Geodetic(*own))

    async def _unless_interrupted(self, work: Awaitable[None]) -> None:
        """Do the work, or stop it at the next interrupt.

        Raises:
            VehicleError: it was interrupted; says by what.
        """
        job = asyncio.ensure_future(work)
        stop = asyncio.ensure_future(self._interrupts.get())
        try:
            await asyncio.wait((job, stop), return_when=asyncio.FIRST_COMPLETED)
            if stop.done() and not job.done():
                raise VehicleError(stop.result())
            await job
        finally:
            for future in (job, stop):
                future.cancel()
            await asyncio.gather(job, stop, return_exceptions=True)

    @staticmethod
    async def _all_alive(work: Awaitable[None], background: list[asyncio.Task[None]]) -> None:
        """Do the work; a background task that ends, ends it too: none of them ever ends but by a fault of ours."""
        job = asyncio.ensure_future(work)
        try:
            await asyncio.wait((job, *background), return_when=asyncio.FIRST_COMPLETED)
            for task in background:
                if task.done():
                    task.result()
            await job
        finally:
            job.cancel()
            await asyncio.gather(job, return_exceptions=True)

    async def _drain(self, router: Router) -> None:
        """Write down what vehicles and router say while it happens, and all tables: run it as a task."""
        async for _ in ticks(self.journal.time(), DRAIN_S):
            self.journal.drain(router, self.fleet.vehicles if self.fleet else ())
            if self.target_follower is not None:
                self.target_follower.record_truth()
            self.journal.recorder.flush()
            if self.streamer is None or not self.streamer.streams:
                self._good_moment(self.journal.time())

    def _good_moment(self, now_s: float) -> None:
        if self.in_good_moments is not None:
            self.in_good_moments(now_s)

    async def _put_back(self, failsafes: Failsafes) -> None:
        try:
            await failsafes.put_back()
        except VehicleError as error:
            self.journal.event("warning", f"failsafe parameters are not restored: {error}")

    def _count(self) -> None:
        vehicles = self.fleet.vehicles if self.fleet else ()
        self.result.lost = tuple(vehicle.address for vehicle in vehicles if vehicle.phase is Phase.LOST)
        self.result.not_down = tuple(v.address for v in vehicles if v.armed or v.phase is Phase.LOST)
        self.result.vehicles_landed = sum(not v.armed and v.phase is Phase.LANDED for v in vehicles)


def _places(networks: Mapping[str, tuple[Endpoint, ...]]) -> str:
    """Return where vehicles are expected, with the networks' names if there are several."""
    texts = {name: ", ".join(map(str, endpoints)) for name, endpoints in networks.items()}
    return "; ".join(f"{name}: {text}" for name, text in texts.items()) if len(texts) > 1 else "".join(texts.values())
