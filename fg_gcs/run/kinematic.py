"""What planning alone makes of sightings: the inner loop against made-up targets, with vehicles that follow perfectly.

No clock, no network and no simulator: time is counted in ticks of the stream, planning takes none of it, and what is
commanded is what is flown. The same arguments give the same kinematic simulation, but for how long the planning took.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import coverage, flux_metric, least_after_facing
from fg_gcs.core.formation import Pose
from fg_gcs.core.separation import closest_approach
from fg_gcs.mission.model import SETPOINTS_HZ
from fg_gcs.plan.rules import Peaks, broken, peaks_of
from fg_gcs.record.evaluate.tracking import HOLDING, SETTLED_S
from fg_gcs.scenario.motions import TrueMotion
from fg_gcs.scenario.sensor import Measurement, Sensor
from fg_gcs.track.follow.formation_frames import Frames
from fg_gcs.track.follow.replanner import FollowMode, Swarm
from fg_gcs.track.following_core import QUIET_S, FollowingCore, TrackingSettings
from fg_gcs.track.sightings import Verdict

Flags = NDArray[np.bool_]

TICK_S = 1.0 / SETPOINTS_HZ


class Replanned(NamedTuple):
    """One attempt at a better trajectory."""

    time_s: float
    mode: FollowMode
    taken: bool
    took_s: float  # by the stopwatch


class Figures(NamedTuple):
    """What a kinematic simulation amounts to; None where there was nothing to measure."""

    caught_s: float | None  # since the beginning
    error_rms_m: float | None  # of the formation's place around the true target, once settled
    error_p95_m: float | None
    flux_metric_share: float | None  # of the time since the capture in which the metric is 0.9 or more
    coverage_min_after_facing: float | None  # of the true target, on the way to the capture
    found_again_s: tuple[float | None, ...]  # per loss: from the first sighting to an error below the capture's
    separation_m: float  # of the closest pair
    outside_m: float  # by how much a vehicle leaves the fence, negative inside
    peaks: Peaks
    position_step_m: float  # largest that the velocities before and after do not explain
    velocity_step_m_s: float  # largest beyond what the limit of the acceleration allows
    replans_taken: int
    replans_refused: int
    replan_median_ms: float | None
    replan_p99_ms: float | None
    broken: tuple[str, ...]  # names of the rules that the commanded motion broke


@dataclass(frozen=True)
class KinematicSimulation:
    """A whole kinematic simulation over its T ticks."""

    swarm: Swarm
    tracking: TrackingSettings
    time_s: Array  # (T,) since tracking began
    position_m: Array  # (T, V, 3) commanded [m; ENU]
    velocity_m_s: Array  # (T, V, 3)
    acceleration_m_s2: Array  # (T, V, 3)
    place_m: Array  # (T, 3) where a target is if it is held [m; ENU]
    scale: Array  # (T,)
    targets_m: Array  # (T, C, 3) true, in the order of the weights [m; ENU]
    estimate_m: Array  # (T, 3) of all targets together as it was known then; NaN before they were seen [m; ENU]
    mode: tuple[FollowMode, ...]  # T of them
    received_s: Array  # (S,) when sightings came, whatever became of them
    counts: Mapping[Verdict, int]  # of sightings
    replans: tuple[Replanned, ...]
    caught_s: float | None

    @property
    def truth_m(self) -> Array:
        """The true centre of all targets by their weights, shape (T, 3) [m; ENU]."""
        weights = np.array(list(self.tracking.weights.values()))
        centre: Array = np.einsum("tck,c->tk", self.targets_m, weights / weights.sum())
        return centre

    @property
    def error_m(self) -> Array:
        """Distance of the formation's place from the true centre, shape (T,) [m]."""
        error: Array = np.linalg.norm(self.place_m - self.truth_m, axis=1)
        return error

    @property
    def settled(self) -> Flags:
        """Whether the formation has had time to settle around the target, shape (T,)."""
        since_s = np.inf if self.caught_s is None else self.caught_s + SETTLED_S
        after: Flags = self.time_s >= since_s
        return after

    def figures(self) -> Figures:
        """Return what it amounts to."""
        rules, settled = self.swarm.rules, self.settled
        error, rims = self.error_m, self.position_m[:, : len(self.swarm.formation.leaders_m)]
        caught = self.time_s >= (np.inf if self.caught_s is None else self.caught_s)
        held = flux_metric(rims, self.truth_m) >= HOLDING
        took_ms = [1e3 * replan.took_s for replan in self.replans]
        taken = sum(replan.taken for replan in self.replans)
        separation_m = closest_approach(self.position_m, self.time_s).distance_m
        outside_m = float(rules.fence.excess_m(self.position_m).max())
        peaks = peaks_of(self.velocity_m_s, self.acceleration_m_s2, self.time_s)
        return Figures(
            caught_s=self.caught_s,
            error_rms_m=float(np.sqrt((error[settled] ** 2).mean())) if settled.any() else None,
            error_p95_m=float(np.percentile(error[settled], 95.0)) if settled.any() else None,
            flux_metric_share=float(held[caught].mean()) if caught.any() else None,
            coverage_min_after_facing=self._coverage_on_the_way(rims),
            found_again_s=self._found_again_s(error),
            separation_m=separation_m,
            outside_m=outside_m,
            peaks=peaks,
            **self._steps(),
            replans_taken=taken,
            replans_refused=len(self.replans) - taken,
            replan_median_ms=float(np.median(took_ms)) if took_ms else None,
            replan_p99_ms=float(np.percentile(took_ms, 99.0)) if took_ms else None,
            broken=broken(peaks, outside_m, separation_m, rules),
        )

    def _coverage_on_the_way(self, rims: Array) -> float | None:
        """The smallest from when it first faces the target until it is caught."""
        if self.caught_s is None:
            return None
        way = self.time_s < self.caught_s
        return least_after_facing(coverage(rims[way], self.truth_m[way]))

    def _found_again_s(self, error: Array) -> tuple[float | None, ...]:
        """How long it took after each loss: a time without any sighting, longer than a target may stay unseen."""
        gaps = np.flatnonzero(np.diff(self.received_s) > self.tracking.estimator.lost_after_s)
        found: list[float | None] = []
        for seen_s in self.received_s[gaps + 1]:
            there = self.time_s[(self.time_s >= seen_s) & (error < self.tracking.capture_m)]
            found.append(float(there[0] - seen_s) if len(there) else None)
        return tuple(found)

    def _steps(self) -> dict[str, float]:
        velocity = self.velocity_m_s
        explained = 0.5 * TICK_S * (velocity[1:] + velocity[:-1])
        position = np.linalg.norm(np.diff(self.position_m, axis=0) - explained, axis=2)
        gained = np.linalg.norm(np.diff(velocity, axis=0), axis=2)
        allowed = TICK_S * self.swarm.rules.limits.acceleration_m_s2
        return {
            "position_step_m": float(position.max()),
            "velocity_step_m_s": max(float(gained.max()) - allowed, 0.0),
        }


def simulate_kinematics(
    swarm: Swarm,
    tracking: TrackingSettings,
    start: Pose,
    motions: Mapping[str, TrueMotion],
    sensors: Sequence[Sensor],
    seconds: float,
    stopwatch: Callable[[], float],
) -> KinematicSimulation:
    """Track made-up targets from rest.

    Args:
        swarm: what flies.
        tracking: what is tracked, and how.
        start: where the formation rests at time 0.
        motions: true ones by the names of all targets that are tracked.
        sensors: what they are measured by.
        seconds: how long, two ticks or more.
        stopwatch: returns seconds, for the durations of replanning alone.
    """
    core = FollowingCore(swarm, tracking, start, 0.0)
    time_s: Array = TICK_S * np.arange(float(round(seconds / TICK_S)))
    arrivals = _arrivals(motions, sensors)
    due = next(arrivals)
    planned_s = 0.0
    received: list[float] = []
    replans: list[Replanned] = []
    frames: list[Frames] = []
    modes: list[FollowMode] = []
    estimate_m = np.full((len(time_s), 3), np.nan)
    for tick, now_s in enumerate(time_s.tolist()):
        due, came_s = _received(core, due, arrivals, now_s)
        received += came_s
        if came_s or now_s - planned_s >= QUIET_S:
            planned_s = came_s[-1] if came_s else now_s  # once for all that came since the last tick
            replans += _replanned(core, planned_s, stopwatch)
        known = core.known(now_s)
        if known is not None:
            estimate_m[tick] = known.position_enu_m
        frames.append(core.trajectory.frames(np.array([now_s])))
        modes.append(core.replanner.mode)
    flown = Frames(*(np.concatenate(parts) for parts in zip(*frames, strict=True)))
    position, velocity, acceleration = flown.swarm(swarm.slots_m)
    return KinematicSimulation(
        swarm=swarm,
        tracking=tracking,
        time_s=time_s,
        position_m=position,
        velocity_m_s=velocity,
        acceleration_m_s2=acceleration,
        place_m=flown.centre[:, 0] - swarm.hold_depth_m * flown.arms[:, 0, :, 0] / flown.scale[:, None],
        scale=flown.scale,
        targets_m=np.stack([motions[name].at(time_s)[0] for name in tracking.weights], axis=1),
        estimate_m=estimate_m,
        mode=tuple(modes),
        received_s=np.array(received),
        counts=Counter(core.counts),
        replans=tuple(replans),
        caught_s=core.caught_s,
    )


def _received(
    core: FollowingCore, due: Measurement, arrivals: Iterator[Measurement], now_s: float
) -> tuple[Measurement, list[float]]:
    """Hand in what has come by now; return what comes next, and when each sighting came [s]."""
    came_s: list[float] = []
    while due.received_s <= now_s:
        if due.sighting is not None:
            core.sighted(due.sighting, due.received_s)
            came_s.append(due.received_s)
        due = next(arrivals)
    return due, came_s


def _replanned(core: FollowingCore, now_s: float, stopwatch: Callable[[], float]) -> list[Replanned]:
    """Plan anew; return what came of it, nothing while nothing is known of the targets."""
    began = stopwatch()
    replan = core.replan(now_s)
    return [] if replan is None else [Replanned(now_s, replan.mode, replan.taken, stopwatch() - began)]


def _arrivals(motions: Mapping[str, TrueMotion], sensors: Sequence[Sensor]) -> Iterator[Measurement]:
    """All measurements of all sensors for ever, in the order of arrival."""
    each = (sensor.measurements(motions[sensor.target]) for sensor in sensors)
    return heapq.merge(*each, key=lambda each: each.received_s)
