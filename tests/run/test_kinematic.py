from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fg_gcs.core.coverage import flux_metric
from fg_gcs.core.formation import Pose, facing, hemisphere
from fg_gcs.core.separation import Fence
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.record.evaluate.tracking import HOLDING
from fg_gcs.run.kinematic import TICK_S, KinematicSimulation, simulate_kinematics
from fg_gcs.scenario.motions import Circle, Static, TrueMotion
from fg_gcs.scenario.sensor import Sensor, SensorSettings
from fg_gcs.track.estimate.estimator import Settings
from fg_gcs.track.follow.replanner import RUN_ON_S, FollowMode, Swarm
from fg_gcs.track.following_core import LIVE_S, QUIET_S, FollowingCore, TrackingSettings
from fg_gcs.track.sightings import Sighting, Verdict, isotropic

FORMATION = hemisphere(4, 1, 6.0)
RULES = Rules(Limits(8.0, 4.0), 1.5, Fence((-40.0, -40.0, 2.0), (40.0, 40.0, 40.0)))
SWARM = Swarm(FORMATION, FORMATION.slots_m, 1.0, RULES)
START = Pose(np.array([0.0, 0.0, 15.0]), facing(np.array([1.0, 0.0, 0.0])))
NEAR = Static((12.0, 4.0, 16.0))
ROUND = Circle((10.0, 0.0, 16.0), 15.0, 2.0)


def simulated(
    motions: dict[str, TrueMotion],
    sensor: SensorSettings | None = None,
    seconds: float = 16.0,
    weights: dict[str, float] | None = None,
    seed: int = 0,
) -> KinematicSimulation:
    tracking = TrackingSettings(weights or dict.fromkeys(motions, 1.0), Settings(), most_radius_m=6.0)
    sensors = [Sensor(name, sensor or SensorSettings(), seed) for name in motions]
    return simulate_kinematics(SWARM, tracking, START, motions, sensors, seconds, lambda: 0.0)


def test_a_target_at_rest_is_caught_held_and_nothing_is_broken() -> None:
    run = simulated({"boat": NEAR})
    figures = run.figures()
    assert figures.caught_s is not None
    assert figures.caught_s < 10.0
    assert figures.error_rms_m is not None
    assert figures.error_rms_m < 0.5
    assert figures.error_rms_m == pytest.approx(np.sqrt((run.error_m[run.settled] ** 2).mean()))
    since = run.time_s >= figures.caught_s
    metric = flux_metric(run.position_m[since, : len(FORMATION.leaders_m)], np.array(NEAR.position_enu_m))
    assert figures.flux_metric_share == (metric >= HOLDING).mean()
    assert (metric >= HOLDING).mean() > 0.8  # half a metre of noise against a metre of depth
    assert figures.broken == ()
    assert figures.found_again_s == ()
    assert figures.separation_m == pytest.approx(FORMATION.smallest_separation_m, rel=0.01)  # chords between ticks
    assert np.linalg.norm(run.velocity_m_s[0]) == 0.0
    assert run.place_m[0] == pytest.approx(START.centre_enu_m - [1.0, 0.0, 0.0])


def test_the_same_seed_gives_the_same_simulation_and_another_one_another() -> None:
    one, same, other = (simulated({"boat": ROUND}, seconds=6.0, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(one.position_m, same.position_m)
    assert one.replans == same.replans
    assert not np.array_equal(one.position_m, other.position_m)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_commanded_is_continuous_whatever_is_seen(seed: int) -> None:
    rough = SensorSettings(drop=0.3, outliers=0.1, outlier_m=10.0, jitter_s=0.05)
    run = simulated({"boat": ROUND}, rough, seed=seed)
    figures = run.figures()
    # Between ticks no more than what changing accelerations bend: a dt^2, and far from what is allowed
    assert figures.position_step_m < RULES.limits.acceleration_m_s2 * TICK_S**2
    assert figures.velocity_step_m_s == 0.0
    assert figures.peaks.speed_m_s <= RULES.limits.speed_m_s
    assert len(run.received_s) == sum(run.counts.values())
    assert run.counts[Verdict.GATED] > 0
    assert figures.replans_taken + figures.replans_refused == len(run.replans)


def test_a_broken_rule_and_a_step_are_told() -> None:
    run = simulated({"boat": NEAR}, seconds=4.0)
    jumped = run.position_m.copy()
    jumped[100:, 1] += [0.0, 0.0, 0.5]
    stepped = replace(run, position_m=jumped, velocity_m_s=3.0 * run.velocity_m_s).figures()
    assert stepped.position_step_m > 0.4
    assert stepped.velocity_step_m_s > 0.0
    tight = Rules(Limits(1.0, 1.0, 0.01, 0.01, 0.1), 7.0, Fence((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
    broken = replace(run, swarm=replace(SWARM, rules=tight)).figures().broken
    assert broken == ("speed", "acceleration", "jerk", "climb", "descent", "separation", "fence")


def test_a_lost_target_is_found_again_and_the_time_counts_from_its_first_sighting() -> None:
    silence = SensorSettings(silence_s=((8.0, 10.5),))
    run = simulated({"boat": NEAR}, silence, seconds=14.0)
    (found_s,) = run.figures().found_again_s
    assert found_s == pytest.approx(0.0, abs=TICK_S)  # it stood still, and so did the formation
    late = replace(run, place_m=run.place_m + np.where(run.time_s > 12.0, 0.0, 50.0)[:, None])
    (found_s,) = late.figures().found_again_s
    assert found_s == pytest.approx(12.0 - 10.6, abs=2.0 * TICK_S)
    never = replace(run, place_m=run.place_m + 50.0).figures()
    assert never.found_again_s == (None,)


def test_without_sightings_it_rests_and_knows_nothing() -> None:
    run = simulated({"boat": ROUND}, SensorSettings(drop=1.0), seconds=3.0)
    figures = run.figures()
    assert np.isnan(run.estimate_m).all()
    assert np.ptp(run.position_m, axis=0).max() == 0.0
    assert figures[:5] == (None,) * 5
    assert figures.replan_p99_ms is None
    assert not run.replans


def test_it_looks_again_while_nothing_is_seen() -> None:
    run = simulated({"boat": NEAR}, SensorSettings(silence_s=((3.0, 9.0),)), seconds=8.0)
    gaps = np.diff([replan.time_s for replan in run.replans])
    assert gaps.max() <= QUIET_S + TICK_S + 1e-9


def test_several_targets_count_by_their_weights_and_their_sightings_are_planned_for_at_once() -> None:
    ends: dict[str, TrueMotion] = {"one": Static((12.0, 0.0, 15.0)), "two": Static((12.0, 4.0, 15.0))}
    run = simulated(ends, weights={"one": 3.0, "two": 1.0}, seconds=10.0)
    assert run.truth_m == pytest.approx(np.tile([12.0, 1.0, 15.0], (len(run.time_s), 1)))
    assert run.targets_m.shape == (len(run.time_s), 2, 3)
    times = [replan.time_s for replan in run.replans]
    assert len(set(times)) == len(times)
    assert len(run.received_s) > 1.9 * len(times)
    assert run.scale[-1] > 1.2  # the face holds both


def test_durations_are_the_stopwatch_s() -> None:
    measurements = itertools.count()
    tracking = TrackingSettings({"boat": 1.0}, Settings())
    run = simulate_kinematics(
        SWARM,
        tracking,
        START,
        {"boat": NEAR},
        [Sensor("boat", SensorSettings(), 0)],
        2.0,
        lambda: float(next(measurements)),
    )
    figures = run.figures()
    assert (figures.replan_median_ms, figures.replan_p99_ms) == (1000.0, 1000.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_target_that_is_seen_no_more_is_followed_on_for_a_while_with_a_growing_formation(seed: int) -> None:
    lost_s, most = 12.0, 6.0 / FORMATION.inscribed_radius_m
    run = simulated({"boat": ROUND}, SensorSettings(silence_s=((lost_s, np.inf),)), seconds=40.0, seed=seed)
    figures = run.figures()
    assert figures.caught_s is not None
    assert figures.caught_s < lost_s
    assert figures.broken == ()
    end_s = lost_s + RUN_ON_S
    speed = np.linalg.norm(run.velocity_m_s, axis=2).max(axis=1)
    going, over = (run.time_s > lost_s) & (run.time_s < end_s - 1.0), run.time_s > end_s + 20.0 * TICK_S
    assert speed[going].min() > 0.5  # it does go on
    braked_s = ROUND.top_speed_m_s / (0.2 * RULES.limits.acceleration_m_s2)  # with a fifth of what is allowed at least
    assert speed[run.time_s > end_s + braked_s + 4.0].max() < 0.01  # and growing in place takes some seconds, too
    assert over.any()
    assert run.scale.max() <= most * (1.0 + 1e-9)
    assert run.scale[-1] == pytest.approx(most)
    assert run.scale[run.time_s < lost_s] == pytest.approx(1.0)
    assert (np.diff(run.scale[run.time_s > lost_s]) > -1e-9).all()  # the longer unseen, the larger


def test_one_of_several_that_is_gone_does_not_end_what_the_others_are_followed_by() -> None:
    tracking = TrackingSettings({"boat": 1.0, "other": 1.0}, Settings(), most_radius_m=6.0)
    core = FollowingCore(SWARM, tracking, START, 0.0)
    for k in range(250):
        now_s = 0.1 * k
        for name, gone_s in (("boat", np.inf), ("other", 5.0)):
            place = np.array([14.0, 2.0, 16.0])
            if now_s < gone_s:
                core.sighted(Sighting(name, now_s, place, isotropic(0.1), now_s), now_s)
        core.replan(now_s)
    known = core.known(25.0)
    assert known is not None
    assert known.lost == ("other",)
    assert known.age_s > RUN_ON_S
    assert core.replanner.mode is FollowMode.FOLLOW
    assert (
        core.trajectory.end_s > 24.9 + RUN_ON_S - 0.1
    )  # the trajectory goes on for as long as one is trusted that is seen


@given(
    rate_hz=st.sampled_from([1.0, 4.0, 10.0]),
    delay_s=st.floats(0.0, 0.4),
    gone_s=st.floats(8.0, 12.0),
    others=st.booleans(),
)
@settings(max_examples=8, deadline=None)
def test_what_is_only_predicted_is_neither_caught_nor_held(
    rate_hz: float, delay_s: float, gone_s: float, others: bool
) -> None:
    tracking = TrackingSettings({"boat": 1.0, **({"other": 1.0} if others else {})}, Settings(), most_radius_m=6.0)
    core, place, due = FollowingCore(SWARM, tracking, START, 0.0), np.array([12.0, 2.0, 16.0]), 0
    came_s = np.inf
    for k in range(300):
        now_s = 0.05 * k
        while due / rate_hz + delay_s <= now_s:
            for name in tracking.weights:
                if name == "boat" or due / rate_hz < gone_s:
                    core.sighted(Sighting(name, due / rate_hz, place, isotropic(0.1), now_s), now_s)
            due, came_s = due + 1, now_s
        known = core.known(now_s)
        if known is None:
            continue
        core.replan(now_s)
        if core.holds(known):
            assert now_s - came_s <= LIVE_S
            assert core.error_m(known) < tracking.capture_m
        assert not (others and now_s > gone_s + 1.0 / rate_hz + delay_s + LIVE_S and core.holds(known))
    assert core.caught_s is not None
    assert core.caught_s < gone_s
