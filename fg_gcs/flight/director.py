"""One run from the first heartbeat to the last word: connects, prepares, plans, flies, and always comes back."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic
from fg_gcs.errors import FgError, MissionError, PlanError, VehicleError
from fg_gcs.flight.calibration import FleetCalibration
from fg_gcs.flight.compensation import Compensation
from fg_gcs.flight.context import Context
from fg_gcs.flight.custody import Custody
from fg_gcs.flight.descents import Descents
from fg_gcs.flight.discovery import choose, discover
from fg_gcs.flight.failsafes import Failsafes
from fg_gcs.flight.fleet import STEP_S, Fleet, NotDone
from fg_gcs.flight.garbage import short_collections
from fg_gcs.flight.gate import LASTS_S, Gate, GateCounts
from fg_gcs.flight.journal import Journal
from fg_gcs.flight.link_check import unfit_links, unless_doubled
from fg_gcs.flight.link_recorder import LinkRecorder
from fg_gcs.flight.lost_links import rule_of
from fg_gcs.flight.policy import (
    Fault,
    FaultKind,
    Part,
    RequestKind,
    Response,
    Rung,
    Situation,
    refused,
    respond,
)
from fg_gcs.flight.preparation import prepare, vehicle_limits
from fg_gcs.flight.return_settings import let_return
from fg_gcs.flight.safety import Bounds
from fg_gcs.flight.sightings.sighting_sources import Substitutes
from fg_gcs.flight.signing_setup import set_up_signing
from fg_gcs.flight.sortie import Sortie
from fg_gcs.flight.streamer import Streamer
from fg_gcs.flight.supervisor import Duty, Supervisor, bystander
from fg_gcs.flight.target_follower import TargetFollower, TrackingSummary
from fg_gcs.flight.wander import expected_wander
from fg_gcs.flight.watch import Watch
from fg_gcs.link.clock import ticks
from fg_gcs.link.counters import Counters
from fg_gcs.link.endpoint import Endpoint, places
from fg_gcs.link.forwarding import Forwards
from fg_gcs.link.router import Router
from fg_gcs.mission.model import Mission
from fg_gcs.plan.flight_plan import FlightPlan, Task, compile_flight, fault_words, plan_figures
from fg_gcs.record.write.kept_calibrations import KeptCalibrations
from fg_gcs.record.write.kept_parameters import KeptParameters
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import MAIN, VehicleAddress, names, vehicles_named
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.signing import Signing

STREAMER_DOG_S = 0.2  # without a sign of life a task hangs: what streams
WATCH_DOG_S = 0.5  # what watches, and what brings vehicles down
PLANNER_DOG_S = 2.0  # the inner loop: a plan takes milliseconds, and is begun every quarter of a second
HEARTBEAT_DOG_S = 3.0  # our heartbeats, and the notice of silent vehicles
BYSTANDER_DOG_S = 5.0  # what writes down
TOLD: Mapping[Rung, str] = {Rung.LANDING: "landing apart from each other", Rung.LAND_NOW: "landing at once"}
MOST_STOPS = 3  # asked so often to stop, the program ends without waiting for anybody to land
DRAIN_S = 0.2  # how often everything is written down: soon enough for a person to read along, and after a crash


class Setup(NamedTuple):
    """How a run is connected."""

    networks: Mapping[str, tuple[Endpoint, ...]]  # by name, see `parse_networks`
    wait_s: float  # how long to wait for the vehicles' first heartbeats
    simulated: bool  # the vehicles are our own simulator's: the mission says where the world's origin is
    stopwatch: Callable[[], float]  # seconds, for planning times
    substitutes: Substitutes = Substitutes()  # for the sources of sightings that the mission names
    kept: KeptParameters | None = None  # where users' own values of parameters are kept while they are changed
    signing: Mapping[str, Signing] = MappingProxyType({})  # by network, see `Router.open`
    forwards: Forwards | None = None  # who else gets telemetry
    least_pace: float = 0.0  # slower clocks than this share of real time are not flown


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
    died: tuple[str, ...] = ()  # names of tasks of this program that raised or hung, and were started again
    late_ticks: int = 0
    gate: GateCounts | None = None  # setpoints that did not pass the last gate; None: there was none
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
        around: returns the duty that a task really gets; trials let tasks die by it.
        in_good_moments: called with the loop's time [s] when milliseconds of work delay no setpoint; must not raise.
    """

    def __init__(self, mission: Mission, setup: Setup, recorder: Recorder) -> None:
        """Prepare to fly; nothing is opened before :meth:`fly`."""
        self.result = FlightResult()
        self.fleet: Fleet | None = None
        self.journal = Journal(recorder, asyncio.get_running_loop().time)
        self.target_follower: TargetFollower | None = None
        self.streamer: Streamer | None = None
        self.around: Callable[[Duty], Duty] = lambda duty: duty
        self.in_good_moments: Callable[[float], None] | None = None
        self.mission = mission
        self._router: Router | None = None
        self._link_recorder = LinkRecorder(recorder)
        self._setup = setup
        self._custody: Custody | None = None
        self._calibration: FleetCalibration | None = None
        self._rung = Rung.GO_ON
        self._stops = 0
        self._decision: _Decision | None = None
        self._decided = asyncio.Event()
        self._drained_s = -np.inf
        self._failure: BaseException | None = None

    def interrupt(self, reason: str) -> None:
        """Stop the flight: first by flying home, then by a verified landing, the third time by landing at once."""
        self._stops += 1
        response = respond(RequestKind.STOP, self._situation)
        if self._stops >= MOST_STOPS:
            self._decision = _Decision(response, reason)
            self._decided.set()
        self._decide(response, reason)

    def fail(self, context: dict[str, Any]) -> None:
        """Take an exception that came up in a callback of the event loop: a fault of ours, so the flight ends.

        It is raised by :meth:`fly` once all vehicles are down.
        """
        error = context.get("exception") or RuntimeError(context["message"])
        if self._failure is None:
            self._failure = error
            self._fault(FaultKind.PROGRAM, f"internal error: {error!r}")

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
        if self.streamer is None:
            return np.full((0 if self.fleet is None else len(self.fleet.vehicles), 3), np.nan)
        return self.streamer.gate.told(now_s)[0]

    async def fly(self) -> FlightResult:
        """Fly the mission; returns with every vehicle that still obeys on the ground.

        Raises:
            LinkError: too few vehicles answered, or a port is taken.
            MissionError: the mission's vehicles are in a network that is not there.
            PlanError: the mission has no plan; nothing was armed.
        """
        networks = self._setup.networks
        wanted = self._wanted()
        hearer, setup = self._link_recorder, self._setup
        router = self._router = await Router.open(
            networks, on_frame=hearer.on_frame, tap=hearer.tap, signing=setup.signing, forwards=setup.forwards
        )
        self.journal.event("open", places(networks))
        supervisor = Supervisor(self._report, self.journal, self.around)
        try:
            with short_collections():
                async with supervisor:
                    supervisor.start(
                        bystander("heartbeat", router.keep_alive, lambda: router.turned_s, HEARTBEAT_DOG_S)
                    )
                    supervisor.start(
                        bystander("recorder", partial(self._drain, router), lambda: self._drained_s, BYSTANDER_DOG_S)
                    )
                    await self._run(router, wanted, supervisor)
        finally:
            self.result.died = tuple(name for name, _ in supervisor.deaths)
            self.journal.drain(router, self.fleet.vehicles if self.fleet else ())
            self.result.stages = self.journal.stages
            router.close()
            self.result.counters = router.counters  # with what still waited to be forwarded
            if self.target_follower is not None:
                self.target_follower.close()
                self.result.tracking = self.target_follower.tracking
        if self._failure is not None:
            raise self._failure
        return self.result

    async def _run(self, router: Router, wanted: tuple[VehicleAddress, ...] | None, supervisor: Supervisor) -> None:
        flights: list[Flight] = []
        failsafes: list[Failsafes] = []

        async def on_the_ground() -> None:
            fleet, task = await self._ready(router, wanted, failsafes)
            with self.journal.in_stage("plan"):
                plan = await self._plan(fleet, task)
                flights.append(await self._flight(fleet, plan.task, plan))
                assert self._custody is not None, "made with the flight"
                await let_return(fleet, plan, failsafes[0], self._custody, self.journal)
                unfit = unfit_links(router, fleet.vehicles, self._setup.least_pace)
                if unfit is not None:
                    raise VehicleError(unfit)

        try:
            try:
                await self._until_decided(on_the_ground())
            except VehicleError as error:
                self._abort(str(error))
                return
            if self._decision is not None:
                self._abort(self._decision.text)
                return
            flight = flights[0]
            self._start(flight, supervisor)
            watch = partial(failsafes[0].watch, self._report)
            supervisor.start(bystander("parameters", watch, lambda: failsafes[0].turned_s, BYSTANDER_DOG_S))
            await self._conduct(flight)
        finally:
            for flight in flights:
                await self._bring_down(flight)
                self.result.late_ticks = flight.context.streamer.late_ticks
                self.result.gate = flight.context.streamer.gate.counts
                flight.context.streamer.conclude(self.journal)
                if self._calibration is not None:
                    self._calibration.keep(flight.sortie.wander_m, flight.context.streamer.compensation, self.journal)
            self._count()
            for failsafe in failsafes:
                await self._put_back(failsafe)

    # --- what is decided -----------------------------------------------------------------------------------------

    def _report(self, fault: Fault) -> None:
        """Take a fault; the policy says what follows."""
        self._decide(respond(fault.kind, self._situation), fault.text)

    def _stalled(self, seconds: float) -> None:
        """Say that this program stood still; nothing that was planned for then is sent now."""
        self._fault(FaultKind.STALL, f"this program stood still for {seconds:.1f} s", (), seconds)

    def _gated(self, vehicles: tuple[VehicleAddress, ...]) -> None:
        """Say that a motion does not pass the gate; all come to rest, and go home from there."""
        if self.target_follower is not None:
            self.target_follower.close()
        text = f"setpoints of {vehicles_named(vehicles)} have not passed the last gate for {LASTS_S:g} s"
        self._fault(FaultKind.GATE, text, vehicles, LASTS_S)

    def _fault(
        self, kind: FaultKind, text: str, vehicles: tuple[VehicleAddress, ...] = (), value: float | None = None
    ) -> None:
        """Tell of a fault that is noticed here, and take it."""
        labels = [vehicle.label for vehicle in vehicles]
        self.journal.event("fault", text, fault=kind.value, vehicles=labels, value=value)
        self._report(Fault(kind, vehicles, text, self.journal.time(), value or 0.0))

    def _decide(self, response: Response, text: str) -> None:
        rung = self._rung if self._decision is None else self._decision.response.rung
        if response.rung > max(rung, Rung.HOLD) or (response.again and response.rung >= rung):
            self._decision = _Decision(response, text)
            self._decided.set()

    @property
    def _situation(self) -> Situation:
        rung = self._rung if self._decision is None else self._decision.response.rung
        return Situation(self._part, rung, self._stops)

    @property
    def _part(self) -> Part:
        if self._custody is None or not self._custody.asked:
            return Part.GROUND
        return {"take-off": Part.TAKE_OFF, "land": Part.DESCENT}.get(self.journal.stage, Part.FLIGHT)

    async def _until_decided(self, work: Coroutine[Any, Any, None]) -> None:
        """Do the work, or end it as soon as something else is decided.

        Raises:
            Exception: what the work raises.
        """
        job, decided = asyncio.ensure_future(work), asyncio.ensure_future(self._decided.wait())
        try:
            await asyncio.wait((job, decided), return_when=asyncio.FIRST_COMPLETED)
            if job.done():
                job.result()
        finally:
            for future in (job, decided):
                future.cancel()
            await asyncio.gather(job, decided, return_exceptions=True)

    async def _conduct(self, flight: Flight) -> None:
        """Fly as planned, and whatever way down is decided, until there is nothing more to decide."""
        work = flight.sortie.as_planned(self._origin())
        while True:
            try:
                await self._until_decided(work)
            except (VehicleError, PlanError) as error:
                self._refuse(error)
            if self._decision is None:
                self.result.completed = self._rung is Rung.GO_ON
                return
            decision, self._decision = self._decision, None
            self._decided.clear()
            self._rung = decision.response.rung
            self._abort(decision.text)
            if self._stops >= MOST_STOPS:
                await flight.sortie.let_go()
                return
            work = flight.sortie.way_down(self._rung)

    def _refuse(self, error: FgError) -> None:
        """Decide what follows when what is under way cannot be done: unless that is decided already, the next rung."""
        if self._decision is not None:
            return
        if self._rung is Rung.GO_ON:
            kind = FaultKind.TARGET if self.journal.stage in ("approach", "hold") else FaultKind.REFUSED
            vehicles = error.vehicles if isinstance(error, NotDone) else ()
            self._fault(kind, str(error), tuple(vehicle.address for vehicle in vehicles))
        elif self._rung is Rung.LAND_NOW:
            self.journal.event("warning", str(error))
        else:
            self._decide(refused(self._situation), str(error))

    def _abort(self, text: str) -> None:
        """Tell why the flight does not go on as planned, or why it is now on another rung."""
        if not self.result.reason:
            self.result.reason = text
        self.journal.event("abort", f"{TOLD.get(self._rung, 'aborting')}: {text}", rung=self._rung.name.lower())

    # --- a flight and its end ------------------------------------------------------------------------------------

    async def _flight(self, fleet: Fleet, task: Task, plan: FlightPlan) -> Flight:
        """Put together what flies a plan; of a moving target its sources are open then."""
        tops_enu_m = plan.gather.sample(np.zeros(1)).position_m[0]
        custody = self._custody = Custody(fleet, tops_enu_m * (1.0, 1.0, 0.0), self.journal.time)
        gate = Gate(fleet, task.rules, lambda: custody.kept_clear)
        streamer = Streamer(fleet, self.journal.recorder, self.mission.stream.rate_hz, gate)
        if self.mission.stream.compensation:
            known = None if self._calibration is None else self._calibration.drag_and_lag
            streamer.compensation = Compensation(fleet, gate, known)
        context = Context(fleet, self.mission, task, tops_enu_m, streamer, custody, self.journal)
        descents = Descents(fleet, streamer, custody, self.journal, self.mission.faults.taken_wait_s)
        if self.mission.targets is not None:
            self.target_follower = await self._listen(streamer, task, plan)
        sortie = Sortie(context, plan, descents, self.target_follower)
        faults = self.mission.faults
        bounds = Bounds(faults.silent_s, faults.off_course_m, faults.battery_low)
        watch = Watch(context, descents, bounds, self._report)
        return Flight(context, sortie, descents, watch)

    def _start(self, flight: Flight, supervisor: Supervisor) -> None:
        """Start the tasks of a flight."""
        streamer, descents, watch = flight.context.streamer, flight.descents, flight.watch
        self.streamer = streamer
        streamer.after_round = self._good_moment
        streamer.stalled = self._stalled
        streamer.gated = self._gated
        again = FaultKind.STREAMER_AGAIN
        supervisor.start(
            Duty("streamer", streamer.run, lambda: streamer.turned_s, STREAMER_DOG_S, FaultKind.STREAMER, again)
        )
        home = FaultKind.PROGRAM
        supervisor.start(Duty("watch", watch.run, lambda: watch.turned_s, WATCH_DOG_S, home, home))
        supervisor.start(Duty("descents", descents.run, lambda: descents.turned_s, WATCH_DOG_S, home, home))
        learns = streamer.compensation
        if learns is not None:
            supervisor.start(bystander("compensation", learns.run, lambda: learns.turned_s, BYSTANDER_DOG_S))
        follower = self.target_follower
        if follower is not None:
            planner = FaultKind.PLANNER
            supervisor.start(Duty("planner", follower.run, lambda: follower.turned_s, PLANNER_DOG_S, planner, planner))

    async def _bring_down(self, flight: Flight) -> None:
        """Stay until every vehicle that was asked to arm is down, or was silent for longer than landing takes.

        Whoever else has a vehicle may bring it down; if it only hovers, it is landed after a while.
        """
        descents, asked = flight.descents, sorted(flight.context.custody.asked)
        descents.begin(asked)
        async for _ in ticks(self.journal.time(), STEP_S):
            if all(descents.is_down(row) or row in descents.given_up for row in asked) or self._stops >= MOST_STOPS:
                return

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

    async def _ready(
        self, router: Router, wanted: tuple[VehicleAddress, ...] | None, failsafes: list[Failsafes]
    ) -> tuple[Fleet, Task]:
        """Get vehicles ready to arm; one that does not become so is passed over, if another one can fly instead.

        Raises:
            NotDone: there is no other one.
            VehicleError: two of them have one id.
        """
        unready: frozenset[VehicleAddress] = frozenset()
        while True:
            fleet = await self._connect(router, wanted, unready)
            with self.journal.in_stage("prepare"):
                try:
                    await unless_doubled(prepare(fleet, self.journal), router, fleet.vehicles)
                except NotDone as error:
                    unready |= {vehicle.address for vehicle in error.vehicles}
                    count = self.mission.swarm.vehicles
                    if wanted is not None or len(choose(router.vehicles.values(), count, None, unready)) < count:
                        raise
                    self.journal.event("notice", f"{error}; others fly instead")
                    continue
                for signing in self._setup.signing.values():
                    signing.rely()
                return fleet, await self._prepare(fleet, failsafes)

    async def _connect(
        self, router: Router, wanted: tuple[VehicleAddress, ...] | None, unready: frozenset[VehicleAddress]
    ) -> Fleet:
        setup, count = self._setup, self.mission.swarm.vehicles
        with self.journal.in_stage("connect"):
            found = await discover(router, setup.networks, count, wanted, setup.wait_s, self.journal, unready)
            if not unready:
                router.tell_shortages()
            self.fleet = self._link_recorder.fleet = Fleet(router, found)
            self.result.vehicles = tuple(self.fleet.row_of)
            kinds = sorted({vehicle.profile.name for vehicle in found})
            self.journal.event("vehicles", f"{vehicles_named(self.fleet.row_of)} answered ({', '.join(kinds)})")
            await set_up_signing(self.fleet, setup.signing, self.journal)
        return self.fleet

    async def _prepare(self, fleet: Fleet, failsafes: list[Failsafes]) -> Task:
        """Set failsafes, and learn frames; return the mission's task under the limits that the vehicles really have."""
        task = self.mission.task()
        jerk_m_s3 = self.mission.limits.vehicle_jerk_m_s3
        failsafes.append(Failsafes(fleet, self.journal, self._setup.kept, jerk_m_s3))
        await failsafes[0].set()
        limits = vehicle_limits(fleet, task.rules.limits, self.journal)
        origin = self.mission.origin_geodetic() if self._knows_origin else None
        fleet.learn_frames(origin, self.mission.pads_enu_m()[0], task.start.centre_enu_m)
        self.journal.recorder.know(
            vehicles=len(fleet.vehicles),
            limits=vars(limits),
            separation_m=task.rules.separation_m,
            target_enu_m=task.target_enu_m,
        )
        kept = self._setup.kept
        calibration = FleetCalibration(fleet, None if kept is None else KeptCalibrations(kept.folder))
        self._calibration = calibration
        wander = await expected_wander(fleet, self.mission, calibration.wander_m, self.journal)
        rules = replace(task.rules, limits=limits)
        return replace(task, rules=rules, lost_link=rule_of(self.mission, fleet), wander=wander)

    async def _plan(self, fleet: Fleet, task: Task) -> FlightPlan:
        """Plan from where the vehicles really stand, and verify it, before anything is armed."""
        tops = fleet.positions_enu_m()
        tops[:, 2] = self.mission.takeoff.height_m
        plan = await asyncio.to_thread(compile_flight, task, tops, self._setup.stopwatch)
        self.result.plan, self.result.task = plan, plan.task
        ids = [vehicle.label for vehicle in fleet.row_of]
        leaders = [ids[row] for row in plan.rim_of]
        self.journal.recorder.know(leader_ids=leaders, **plan_figures(ids, plan))
        self.journal.event(
            "plan",
            f"{plan.figures.path_length_m:.1f} m for {len(plan.rim_of)} leaders in {plan.approach.duration_s:.1f} s, "
            f"never closer than {plan.separation.distance_m:.2f} m; "
            f"planned in {1e3 * (plan.plan_time_s + plan.timing_time_s):.0f} ms",
        )
        for line in fault_words(ids, plan):
            self.journal.event("plan", line)
        return plan

    @property
    def _knows_origin(self) -> bool:
        return self.mission.origin is not None or self._setup.simulated

    async def _listen(self, streamer: Streamer, task: Task, plan: FlightPlan) -> TargetFollower:
        """Open the sources of moving targets, before anything is armed."""
        setup = self._setup
        slots_m = task.formation.slots_m[plan.slot_of]
        target_follower = TargetFollower(
            self.mission, task, slots_m, streamer, self.journal, setup.stopwatch, setup.substitutes
        )
        await target_follower.open()
        return target_follower

    def _origin(self) -> Geodetic:
        """Return where on Earth the mission's (0, 0, 0) is: as the file says, or as learnt from the first vehicle."""
        learnt = None if self.fleet is None else self.fleet.origin
        return learnt or self.mission.origin_geodetic()

    async def _drain(self, router: Router) -> None:
        """Write down what vehicles and router say while it happens, and all tables: run it as a task."""
        async for _ in ticks(self.journal.time(), DRAIN_S):
            self._drained_s = self.journal.time()
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
        for line in failsafes.told_at_the_end():
            self.journal.event("end", line)

    def _count(self) -> None:
        vehicles = self.fleet.vehicles if self.fleet else ()
        given_up = () if self._custody is None else self._custody.lost
        gone = {vehicle.address for vehicle in vehicles if vehicle.phase is Phase.LOST}
        self.result.lost = tuple(sorted(gone | {vehicles[row].address for row in given_up}))
        self.result.not_down = tuple(v.address for v in vehicles if v.armed or v.phase is Phase.LOST)
        self.result.vehicles_landed = sum(not v.armed and v.phase is Phase.LANDED for v in vehicles)


@dataclass(frozen=True)
class Flight:
    """What flies a plan."""

    context: Context
    sortie: Sortie
    descents: Descents
    watch: Watch


class _Decision(NamedTuple):
    """What was decided, and why."""

    response: Response
    text: str
