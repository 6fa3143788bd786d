"""Moving targets in flight: sightings come in, trajectories go to the streamer, planning never delays a setpoint."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import Geodetic
from fg_gcs.flight.journal import Journal
from fg_gcs.flight.motions import FormationMotion, Gaze, Headings
from fg_gcs.flight.planning import LATE_S, Durations, Planning
from fg_gcs.flight.sightings.sighting_sources import SightingSources, Substitutes
from fg_gcs.flight.streamer import Streamer
from fg_gcs.flight.yaw_limiter import YawRateLimiter
from fg_gcs.mission.model import SETPOINTS_HZ, Mission
from fg_gcs.plan.flight_plan import Task
from fg_gcs.record.write.layouts import TRUTH
from fg_gcs.track.estimate.group import GroupEstimate
from fg_gcs.track.follow.axes import Axes
from fg_gcs.track.follow.replanner import FollowMode, Goal, Replan, Swarm
from fg_gcs.track.following_core import LIVE_S, QUIET_S, FollowingCore
from fg_gcs.track.sightings import Sighting, Verdict, isotropic

LOST_SPARE_S = 1.0  # on top of the time after which a target counts as lost, before the swarm goes home for it
TRUE_PLACES = "where the targets truly are"
TRUTH_S = 1.0 / SETPOINTS_HZ  # between instants for which true positions are written down
KEPT = frozenset({Verdict.TAKEN, Verdict.TENTATIVE})  # any other verdict is a refusal


class TrackingStatus(NamedTuple):
    """What a person wants to know of the tracking now."""

    mode: FollowMode
    targets: int  # how many there are
    known: GroupEstimate | None  # of all targets together; None before any was seen
    error_m: float  # of the formation's centre, by the estimate; infinite before anything is known
    growth: float  # size of the formation as a share of that at the start
    rests: bool  # the formation has come to the end of its trajectory: it stands until there is another one
    caught: bool  # the formation has been around the target
    patience_s: float  # after so much more without a sighting, or without the capture, the swarm goes home
    sightings: int  # all that came so far
    refused: dict[Verdict, int]
    latency_s: float  # from the last sighting's stamp to when the first setpoint that it led to had left; NaN: none yet


class TrackingSummary(NamedTuple):
    """What came of the tracking; times are loop times."""

    began_s: float
    ended_s: float
    caught_s: float | None
    planned: int  # replans that came to their end
    planning_s: tuple[float, ...]  # their durations by the stopwatch; of very many a fair sample, see `Durations`
    late: int  # replans that took too long and were given up
    sightings: int  # all that came, whatever became of them
    refused: dict[Verdict, int]


class TargetFollower:
    """Tracks a mission's targets with a formation that stands ready.

    First :meth:`open`, then :meth:`run` as a task; tracking goes on from :meth:`begin` to :meth:`stop`.

    Args:
        mission: with moving targets.
        task: the mission under the limits that the vehicles really have.
        slots_m: template slot of every vehicle, shape (V, 3) [m].
        streamer: gets the motion.
        journal: where to say what happens.
        stopwatch: returns seconds, for planning durations alone.
        substitutes: what comes in the place of the mission's sources.

    Attributes:
        turned_s: the loop's time of the newest sign of life of its task [s].
        holds_until_s: when the formation need be around the target no longer, if it is then; infinite: not known [s].

    Raises:
        MissionError: a target's file cannot be read, or something in it is wrong.
    """

    def __init__(
        self,
        mission: Mission,
        task: Task,
        slots_m: Array,
        streamer: Streamer,
        journal: Journal,
        stopwatch: Callable[[], float],
        substitutes: Substitutes,
    ) -> None:
        self.turned_s = -np.inf
        self.holds_until_s = np.inf
        self._swarm = Swarm(task.formation, slots_m, task.hold_depth_m, task.rules)
        self._settings = mission.tracking()
        self._names = list(self._settings.weights)
        self._track = mission.track
        self._task = task
        self._streamer = streamer
        self._journal = journal
        self._stopwatch = stopwatch
        self._sources = SightingSources(
            mission.targets or [],
            self._sighted,
            self._refused,
            substitutes,
            lambda text: journal.event("warning", text),
            journal.recorder.unix_s,
        )
        self._time = journal.time
        self._wake = asyncio.Event()
        self._core: FollowingCore | None = None
        self._formation_motion: FormationMotion | None = None
        self._ended_s: float | None = None
        self._resting = False  # no trajectories for now
        self._began_s = self._taken_s = self._time()
        self._sighted_s = np.nan  # when the oldest sighting came that no trajectory was planned for yet
        self._stamp_s = np.nan  # when what it says was true
        self._told_s = (
            np.nan,
            np.nan,
        )  # that of the newest one that a trajectory was planned for, and when that was done
        self._latency_s = np.nan
        self._planning = Planning(streamer)
        self._told_late = False
        self._durations = Durations()
        self._count = 0
        self._refusals: Counter[Verdict] = Counter()
        self._modes: set[FollowMode] = set()
        self._lost: tuple[str, ...] = ()
        self._truths = 0  # instants for which it is written down where the targets truly were

    async def open(self) -> None:
        """Open the ports of all sources.

        Raises:
            LinkError: one is taken; none stays open.
        """
        await self._sources.open()
        for name, endpoint in self._sources.endpoints.items():
            self._journal.event("open", f"listening for sightings of {name} at {endpoint}")

    def begin(self, origin: Geodetic) -> None:
        """Track from now on, from rest in the start pose; the origin is that of the mission's frame."""
        motion = self._streamer.motion
        assert motion is not None, "the formation has gathered, so there is a motion"
        now_s = self._began_s = self._taken_s = self._time()
        self._core = FollowingCore(self._swarm, self._settings, self._task.start, now_s)
        headings = Headings(now_s, motion.at(now_s).yaw_rad)
        self._stream(
            FormationMotion.beginning(
                motion.rows, self._swarm.slots_m, self._core.trajectory, self._task.target_enu_m, headings
            )
        )
        self._sources.begin(origin)
        self._tell_record()

    async def run(self) -> None:
        """Plan whenever something was seen, or nothing for a while: run it as a task."""
        while True:
            self.turned_s = self._time()
            with suppress(TimeoutError):
                async with asyncio.timeout(QUIET_S):
                    await self._wake.wait()
            self._wake.clear()
            await self._planning.gap()
            if self._core is not None and self._formation_motion is not None and not self._is_over():
                await self._replan(self._core, self._formation_motion)

    def _is_over(self) -> bool:
        """Say whether no trajectory is wanted, for now or for good."""
        return self._resting or self._ended_s is not None

    def stop(self) -> tuple[FormationMotion, float]:
        """Track no longer, and come to rest; return the motion, and the time at which the formation rests [s]."""
        assert self._core is not None, "only what has begun is stopped"
        motion, now_s = self._formation_motion, self._time()
        assert motion is not None, "likewise"
        if self._ended_s is None and not self._resting:  # it comes to rest already, and more suddenly
            gaze = Gaze(now_s, motion.gaze.at(now_s), np.zeros(3))
            motion = motion.with_trajectory(self._core.replanner.stop(now_s).trajectory, gaze)
            self._stream(motion)
        self.close()
        return motion, max(motion.trajectory.end_s, now_s)

    def rests(self, wanted: bool) -> None:
        """Come to rest and stay there, or go on; sightings are taken all the time."""
        if wanted is self._resting or self._core is None or self._formation_motion is None or self._ended_s is not None:
            return
        self._resting = wanted
        now_s = self._time()
        if wanted:
            gaze = Gaze(now_s, self._formation_motion.gaze.at(now_s), np.zeros(3))
            stopped = self._core.replanner.stop(now_s, at_once=True)
            self._stream(self._formation_motion.with_trajectory(stopped.trajectory, gaze))
        else:
            self._wake.set()

    def close(self) -> None:
        """Track no longer, write down how it was, and close all ports; may be called at any time, and twice."""
        if self._core is not None and self._ended_s is None:
            self._ended_s = self._time()
            with self._journal.recorder.guard(TRUE_PLACES):
                self._write_truth(self._ended_s)
            self._tell_record()
            refused = ", ".join(f"{count} {said(verdict)}" for verdict, count in self._refusals.items())
            self._journal.event("track", f"{self._count} sightings came; refused: {refused or 'none'}")
        self._sources.close()

    @property
    def caught_s(self) -> float | None:
        """The loop's time at which the target was caught, None until then [s]."""
        return None if self._core is None else self._core.caught_s

    @property
    def holds(self) -> bool:
        """Whether the formation is around the target now, as far as sightings say."""
        known = None if self._core is None else self._core.known(self._time())
        return self._core is not None and known is not None and self._core.holds(known)

    @property
    def gaze_enu_m(self) -> Array:
        """The point that all noses are turned to now, shape (3,) [m; ENU]."""
        return (
            self._task.target_enu_m if self._formation_motion is None else self._formation_motion.gaze.at(self._time())
        )

    @property
    def status(self) -> TrackingStatus | None:
        """What a person wants to know now; None while nothing is tracked."""
        if self._core is None or self._ended_s is not None:
            return None
        now_s = self._time()
        self._measure()
        known = self._core.known(now_s)
        caught = self.caught_s is not None
        uncaught_s = np.inf if caught else self._track.give_up_s - (now_s - self._began_s)
        return TrackingStatus(
            self._core.replanner.mode,
            len(self._names),
            known,
            np.inf if known is None else self._core.error_m(known),
            float(self._core.trajectory.frames(np.array([now_s])).scale[0]) / self._task.start.scale,
            now_s >= self._core.trajectory.end_s,
            caught,
            min(self._patience_s(now_s), uncaught_s),
            self._count,
            dict(self._refusals),
            self._latency_s,
        )

    @property
    def tracking(self) -> TrackingSummary | None:
        """What came of it so far; None if tracking never began."""
        if self._core is None:
            return None
        ended_s = self._time() if self._ended_s is None else self._ended_s
        return TrackingSummary(
            self._began_s,
            ended_s,
            self.caught_s,
            self._durations.count,
            self._durations.kept_s,
            self._planning.late,
            self._count,
            dict(self._refusals),
        )

    def give_up_reason(self) -> str | None:
        """Return why it makes no sense to go on, None if it does."""
        now_s, track = self._time(), self._track
        if self._patience_s(now_s) < 0.0:
            if now_s - self._taken_s > track.give_up_s:
                return f"no sightings for {track.give_up_s:g} s"
            return f"every target is lost: no sightings for {track.lost_after_s + LOST_SPARE_S:g} s"
        if self.caught_s is None and now_s - self._began_s > track.give_up_s:
            faster = self._is_outrun(now_s)
            return (
                "the target is faster than the vehicles"
                if faster
                else f"the target is not caught within {track.give_up_s:g} s{self._old(now_s)}"
            )
        if now_s - self.holds_until_s > track.give_up_s:
            return f"the target is not held within {track.give_up_s:g} s of the end of the hold{self._old(now_s)}"
        return None

    def _old(self, now_s: float) -> str:
        """Say that sightings come, and are too old to catch or hold a target by; empty where that is not so."""
        known = None if self._core is None else self._core.known(now_s)
        if known is None or not known.lost or now_s - self._taken_s > LIVE_S:
            return ""
        return (
            f": its sightings are {known.age_s:.1f} s old, and it counts as lost after {self._track.lost_after_s:g} s"
        )

    def _patience_s(self, now_s: float) -> float:
        """Return how much longer nothing may be seen before the swarm goes home [s]."""
        track = self._track
        seen = self._taken_s > self._began_s
        soon = track.on_lost == "home" and seen
        patience_s = min(track.give_up_s, track.lost_after_s + LOST_SPARE_S) if soon else track.give_up_s
        return patience_s - (now_s - self._taken_s)

    # --- sightings -----------------------------------------------------------------------------------------------

    def _sighted(self, sighting: Sighting) -> None:
        if self._core is None or self._ended_s is not None:
            return
        now_s, recorder = self._time(), self._journal.recorder
        verdict = self._core.sighted(sighting, now_s)
        self._count += 1
        target = sighting.target if sighting.target in self._names else ""
        stamp_s, arrived_s = recorder.since_start_s(sighting.time_s), recorder.since_start_s(now_s)
        position = sighting.position_enu_m.tolist()
        recorder.sightings.append((stamp_s, arrived_s, target, *position, verdict.name.lower()))
        if verdict not in KEPT:
            self._refuse(verdict, 1)
        elif verdict is Verdict.TAKEN:
            self._taken_s = now_s
            if np.isnan(self._sighted_s):
                self._sighted_s, self._stamp_s = now_s, sighting.time_s
            self._wake.set()

    def _refused(self, verdict: Verdict, count: int) -> None:
        if self._core is not None and self._ended_s is None:
            self._count += count
            self._refuse(verdict, count)

    def _refuse(self, verdict: Verdict, count: int) -> None:
        """Count, and tell the first of a kind: a flood of them must not become a flood of lines."""
        if not self._refusals[verdict]:
            text = f"first sighting refused as {said(verdict)}: {verdict.value}"
            self._journal.event("refused", text, reason=verdict.name.lower())
        self._refusals[verdict] += count

    # --- planning ------------------------------------------------------------------------------------------------

    def _stream(self, motion: FormationMotion) -> None:
        self._formation_motion = self._streamer.motion = motion

    async def _replan(self, core: FollowingCore, motion: FormationMotion) -> None:
        now_s, began_s, was_caught = self._time(), self._stopwatch(), core.caught_s is not None
        known = core.known(now_s)
        if known is None:  # no target has been seen yet
            return
        sighted_s, stamp_s = self._sighted_s, self._stamp_s
        self._sighted_s = self._stamp_s = np.nan  # what comes from now on is for the next trajectory
        replan = await self._planning.result(core.replanning(known), self._is_over)
        if replan is None:  # the present trajectory goes on, and it was verified
            self._sighted_s, self._stamp_s = np.fmin(sighted_s, self._sighted_s), np.fmin(stamp_s, self._stamp_s)
            if self._planning.late and not self._told_late:
                self._told_late = True
                self._journal.event(
                    "notice", f"planning takes longer than {LATE_S:g} s; the present trajectory goes on"
                )
            return
        self._stream(motion.with_trajectory(replan.trajectory, Gaze(now_s, known.position_enu_m, known.velocity_m_s)))
        planned_s = self._time()
        self._measure()
        if np.isfinite(sighted_s) and replan.taken:
            self._told_s = stamp_s, planned_s
        if self._streamer.due_s - sighted_s > 1.01 * self._streamer.period_s:  # it had to let a round pass already
            self._streamer.send_now()
        self._durations.add(self._stopwatch() - began_s)
        self._write(replan, known, (now_s, sighted_s, planned_s), core.error_m(known))
        self._tell(replan.mode, known)
        if not was_caught and core.caught_s is not None:
            self._journal.event("track", f"the target is caught after {now_s - self._began_s:.1f} s")
            self._tell_record()

    def _measure(self) -> None:
        """Find out when the first setpoint after the last trajectory left, once it has."""
        stamp_s, planned_s = self._told_s
        left_s = self._streamer.left_after(planned_s)
        if left_s is not None:
            self._latency_s, self._told_s = left_s - stamp_s, (np.nan, np.nan)

    def _write(self, replan: Replan, known: GroupEstimate, times_s: tuple[float, ...], error_m: float) -> None:
        """Write a replan down: when it began, when the sighting came that it is for, and when it was done."""
        recorder = self._journal.recorder
        began_s, sighted_s, done_s = map(recorder.since_start_s, times_s)
        what = replan.mode.name.lower(), replan.taken
        estimate = *known.position_enu_m.tolist(), *known.velocity_m_s.tolist(), known.age_s, known.radius_m
        recorder.replans.append((began_s, sighted_s, done_s, *what, *estimate, error_m))

    def _tell(self, mode: FollowMode, known: GroupEstimate) -> None:
        """Tell people of targets that are lost or found, and of every mode the first time."""
        if mode not in self._modes:
            self._modes.add(mode)
            self._journal.event("track", mode.value)
        for name in self._names:
            if (name in known.lost) != (name in self._lost):
                kind, what = ("notice", "lost") if name in known.lost else ("track", "seen again")
                self._journal.event(kind, f"{name} is {what}", target=name)
        self._lost = known.lost

    def _is_outrun(self, now_s: float) -> bool:
        known = None if self._core is None else self._core.known(now_s)
        if self._core is None or known is None:
            return False
        return self._core.replanner.chases(Goal(known.prediction, 1.0))

    def record_truth(self) -> None:
        """Write down where the targets truly were, as far as that is known for good; to be called now and then."""
        if self._core is not None and self._ended_s is None:
            with self._journal.recorder.guard(TRUE_PLACES):
                self._write_truth(min(self._time(), self._sources.known_until_s()))

    def _write_truth(self, until_s: float) -> None:
        """Write down where the targets truly were from where that ended last time, if it is known at all."""
        recorder = self._journal.recorder
        step_s = (self._began_s + TRUTH_S) - self._began_s  # as between two numbers of that size
        count = max(int(np.ceil((max(until_s, self._began_s) - self._began_s) / TRUTH_S)), self._truths)
        time_s: Array = self._began_s + step_s * np.arange(self._truths, count, dtype=float)
        self._truths = count
        truth = self._sources.truth(time_s) if len(time_s) else None
        if truth is None:
            return
        rows = recorder.truth.rows(truth.shape[0] * truth.shape[1])
        rows["time_s"] = np.repeat(recorder.since_start_s(time_s), len(self._names))
        rows["target"] = np.tile([TRUTH.text("target", name) for name in self._names], len(time_s))
        rows["position_enu_m"] = truth.reshape(-1, 3)
        recorder.truth.extend(rows)

    def _tell_record(self) -> None:
        """Let the record know since when targets are tracked, caught, and tracked no longer."""
        times_s = {"began_s": self._began_s, "ended_s": self._ended_s, "caught_s": self.caught_s}
        since_start_s = self._journal.recorder.since_start_s
        told = {key: None if time_s is None else since_start_s(time_s) for key, time_s in times_s.items()}
        self._journal.recorder.know(tracking=told)


def said(verdict: Verdict) -> str:
    """Return the short name of a reason, as people read it."""
    return verdict.name.lower().replace("_", " ")


def warm_up(mission: Mission) -> None:
    """Track the mission's targets for a moment on paper, so that no sighting in flight waits for compiled code.

    Raises:
        PlanError: the target's numbers are absurd; the loader refuses those.
        MissionError: a target's file cannot be read, or something in it is wrong.
    """
    task = mission.task()
    swarm = Swarm(task.formation, task.formation.slots_m, task.hold_depth_m, task.rules)
    core = FollowingCore(swarm, mission.tracking(), task.start, 0.0)
    for stamp_s in (0.0, 0.1, 0.2, 0.3):
        for target in mission.targets or ():
            sighting = Sighting(target.name, stamp_s, target.first_enu_m(), isotropic(0.5), stamp_s)
            core.sighted(sighting, stamp_s)
    for now_s in (0.4, 0.5, 99.0):  # 99: all targets are lost by then
        core.replan(now_s)
    rows = range(len(swarm.slots_m))
    headings = Headings(0.0, np.zeros(len(rows)))
    wanted = FormationMotion.beginning(rows, swarm.slots_m, core.trajectory, np.zeros(3), headings).at(1.0)
    YawRateLimiter(headings).turn(wanted.yaw_rad, 1.0)
    core.replanner.stop(99.0)
    Axes(0.0, np.zeros((3, 3))).smoothly(np.zeros((3, 3)), 1.0)  # nothing above came near enough to a target for it
