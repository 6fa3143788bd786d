"""How near vehicles come when one stops hearing us: what is computed, and what follows from it for a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import Fence
from fg_gcs.errors import PlanError
from fg_gcs.flight.motions import Follow
from fg_gcs.plan.flight_plan import MOST_SLOWER
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.lost_link import (
    DEAD,
    MOMENTS_S,
    SINK_M_S,
    SLOWER,
    SPARE_M,
    STEP_S,
    LostLink,
    LostLinkRule,
    Reaction,
    Remedy,
    _deaf,
    keeping_apart,
    nearest,
    too_near,
)
from fg_gcs.plan.pace import changing, stopping
from fg_gcs.plan.path.swarm_path import LinePath
from fg_gcs.plan.trajectory import Trajectory, timed
from fg_gcs.plan.verification import CheckedPlan, check
from tests.plan.scenes import compiled, task

PX4 = LostLink(1.0, runs_on=False, stays=False, lands=True, brakes_m_s2=3.0, gains_per_s=(0.95,))
ARDUPILOT = LostLink(0.75, runs_on=True, stays=True, lands=False, brakes_m_s2=2.5, gains_per_s=(0.95, 1.5))
BOTH = (PX4, ARDUPILOT)
NAMES = ("px4", "ardupilot")
REACTION = Reaction(0.6, 2.2, 0.6)
RULES = Rules(Limits(8.0, 4.0), 1.0, Fence((-99.0, -99.0, 0.0), (99.0, 99.0, 99.0)))
AHEAD = np.array([40.0, 0.0, 0.0])
IN_LINE = np.array([(0.0, 0.0, 20.0), (3.0, 0.0, 20.0), (0.0, 9.0, 20.0)])  # the first flies behind the second
GAZE = np.zeros(3)


def line(places: Array = IN_LINE, way: Array = AHEAD) -> list[Trajectory]:
    return [timed(LinePath(places, places + way), RULES.limits)]


def checked(places: Array = IN_LINE, way: Array = AHEAD, slower: float = 1.0) -> CheckedPlan:
    return check([piece.slower(slower) for piece in line(places, way)], RULES, GAZE)


def least_m(plan: CheckedPlan, behaviour: LostLink, reaction: Reaction = REACTION) -> float:
    return min(nearest(plan, [behaviour], reaction)).distance_m


def rule(remedy: Remedy, least_m: float = 0.5) -> LostLinkRule:
    return LostLinkRule(least_m, remedy, BOTH, REACTION)


def test_who_stays_where_it_rests_is_as_far_as_planned_and_who_lands_sinks_onto_those_below() -> None:
    places = np.array([(0.0, 0.0, 20.0), (0.0, 0.0, 14.0)])
    plan = checked(places, np.array([0.01, 0.0, 0.0]))
    assert least_m(plan, ARDUPILOT) == pytest.approx(6.0, abs=0.01)
    sinking_s = REACTION.waits_s + REACTION.leaving_s - PX4.timeout_s
    assert 6.0 - SINK_M_S * sinking_s <= least_m(plan, PX4) <= 6.0 - 0.7 * SINK_M_S * sinking_s
    fall = min(nearest(plan, [DEAD], REACTION))
    assert fall.distance_m < 0.3
    assert fall.pair == (0, 1)
    assert fall.after_s == pytest.approx(np.sqrt(2.0 * 6.0 / 9.81), abs=0.03)


def test_who_hovers_rests_where_it_comes_to_and_not_at_the_place_that_it_was_told_last() -> None:
    """PX4 is more than a metre past that place when its time-out is over; who flies behind it is not there yet."""
    plan, hovering = checked(slower=4.0), PX4._replace(lands=False)
    assert least_m(plan, hovering._replace(stays=True)) + 1.0 < least_m(plan, hovering)
    assert least_m(plan, hovering) < least_m(plan, PX4)  # who lands sinks out of the way besides


def test_the_time_out_is_chosen_that_makes_a_flight_shortest_and_a_shorter_one_of_the_users_stays() -> None:
    wanted = LostLinkRule(0.5, "slow", (ARDUPILOT._replace(timeout_s=1.0),), REACTION, (0.625, 0.5))
    each = {one.runs_on_s: compiled(replace(task(), lost_link=one)) for one in wanted.choices()}
    assert list(each) == [1.0, 0.625, 0.5]
    long_s = {
        timeout_s: made.gather.duration_s + made.approach.duration_s + made.home.duration_s
        for timeout_s, made in each.items()
    }
    chosen = compiled(replace(task(), lost_link=wanted)).task.lost_link
    assert chosen is not None
    assert chosen.shorter_s == ()
    kept = [s for s, made in each.items() if chosen.is_kept(made.nearest_in_fault[1])]
    assert chosen.runs_on_s == min(kept, key=long_s.__getitem__)
    own = replace(wanted, behaviours=(ARDUPILOT._replace(timeout_s=0.55), PX4))
    assert [one.runs_on_s for one in own.choices()] == [0.55, 0.5]
    assert all(PX4 in one.behaviours for one in own.choices())
    assert LostLinkRule(0.5, "slow", (PX4,), REACTION, (0.625,)).choices() == [
        LostLinkRule(0.5, "slow", (PX4,), REACTION)
    ]


def test_nobody_is_told_of_vehicles_that_fly_far_from_each_other() -> None:
    for behaviour in BOTH:
        assert least_m(checked(np.array([(0.0, 0.0, 20.0), (0.0, 30.0, 20.0)])), behaviour) == pytest.approx(30.0, 1e-3)


@pytest.mark.parametrize("behaviour", BOTH, ids=NAMES)
def test_it_is_named_who_where_and_when(behaviour: LostLink) -> None:
    plan = checked()
    found = min(nearest(plan, [behaviour], REACTION))
    assert set(found.pair) == {0, 1}
    assert 0.0 <= found.heard_s <= plan.duration_s
    assert -1.0 <= found.place_enu_m[0] <= 45.0
    assert found.distance_m < 1.0  # at 8 m/s, 3 m behind each other


@settings(max_examples=30, deadline=None)
@given(
    st.floats(0.0, 1.0),
    st.tuples(st.integers(0, 2), st.integers(0, 2)).filter(lambda pair: pair[0] != pair[1]),
    st.floats(0.0, 1.0),
)
def test_what_is_computed_is_no_farther_than_any_pair_that_is_followed_by_itself(
    share: float, pair: tuple[int, int], after: float
) -> None:
    """Until its time-out one flies straight on, as ArduPilot does; the others are flown as in flight."""
    plan = checked()
    heard_s = share * plan.duration_s
    stops = Follow.from_now(range(3), plan, 0.0).stopping(heard_s + REACTION.notice_s)
    time_s = after * ARDUPILOT.timeout_s
    place, velocity, acceleration = (part[0, pair[0]] for part in plan.sample(np.array([heard_s])))
    deaf = place + velocity * time_s + 0.5 * acceleration * time_s**2
    other = stops.at(heard_s + time_s).position_m[pair[1]]
    assert least_m(plan, ARDUPILOT) <= np.linalg.norm(deaf - other) + 0.05  # a tenth of a second between two moments


def followed(plan: CheckedPlan, behaviour: LostLink, gain_per_s: float) -> float:
    """Follow every pair from every moment on, step by step, and return the least distance [m]."""
    grid_s = np.arange(0.0, plan.duration_s + 2.0 * STEP_S, STEP_S)
    swarm, limits, least = plan.sample(grid_s), plan.limits, np.inf
    what = (behaviour.timeout_s, behaviour.runs_on, behaviour.stays, behaviour.lands, behaviour.falls)
    stride = round(MOMENTS_S / STEP_S)
    for i in [*range(0, len(grid_s) - 1, stride), len(grid_s) - 1]:
        begun_s = i * STEP_S + REACTION.notice_s
        motion, most = (swarm.velocity_m_s, swarm.acceleration_m_s2), (limits.acceleration_m_s2, limits.jerk_m_s3)
        lasts_s = stopping(*motion, begun_s, STEP_S, *most, 1.0, 0.0)
        over_s = max(REACTION.notice_s + lasts_s, REACTION.waits_s) + REACTION.leaving_s
        steps_s = np.arange(int(over_s / STEP_S) + 1) * STEP_S
        plan_s = [changing(s - REACTION.notice_s, begun_s, 1.0, 0.0, 0.0, lasts_s)[0] for s in steps_s.tolist()]
        heard = np.stack(
            [[np.interp(plan_s, grid_s, axis) for axis in way.T] for way in swarm.position_m.swapaxes(0, 1)]
        )
        deaf = np.empty((swarm.position_m.shape[1], len(steps_s), 3))
        for row, way in enumerate(deaf):
            state = (swarm.position_m[i, row], swarm.velocity_m_s[i, row], swarm.acceleration_m_s2[i, row])
            _deaf(*state, STEP_S, what, (behaviour.brakes_m_s2, gain_per_s), way)
        for others in (heard.swapaxes(1, 2), deaf):
            away_m = np.linalg.norm(deaf[:, None] - others[None], axis=-1)  # (V, V, S)
            away_m[np.eye(len(deaf), dtype=bool)] = np.inf
            least = min(least, float(away_m.min()))
    return least


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([PX4, ARDUPILOT, DEAD]), st.floats(4.0, 40.0))
def test_the_least_distance_is_that_of_all_pairs_followed_step_by_step(
    seed: int, behaviour: LostLink, wide_m: float
) -> None:
    draw = np.random.default_rng(seed)
    starts, ends = draw.uniform(-wide_m, wide_m, (2, 6, 3)) + np.array((0.0, 0.0, 50.0))
    open_sky = replace(RULES, separation_m=0.0)
    plan = check([timed(LinePath(starts, ends), RULES.limits)], open_sky, GAZE)
    for gain_per_s in behaviour.gains_per_s:
        found = min(nearest(plan, [behaviour._replace(gains_per_s=(gain_per_s,))], REACTION))
        assert found.distance_m == pytest.approx(followed(plan, behaviour, gain_per_s), abs=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.floats(1.0, 6.0), st.floats(1.0, 2.0))
def test_slower_is_never_nearer_for_those_behind_each_other(slower: float, still: float) -> None:
    for behaviour in BOTH:
        assert least_m(checked(slower=slower * still), behaviour) >= least_m(checked(slower=slower), behaviour) - 0.1


@settings(max_examples=15, deadline=None)
@given(st.floats(0.6, 1.5), st.floats(0.0, 1.0))
def test_who_notices_later_is_never_farther_from_one_that_stops_by_itself(notice_s: float, later_s: float) -> None:
    """Who stops sooner than that one is run into, as the others are by one that runs on: there it is not so."""
    plan = checked(slower=3.0)
    soon, late = (least_m(plan, PX4, Reaction(s, 4.0, 0.5)) for s in (notice_s, notice_s + later_s))
    assert late <= soon + 0.02


def test_a_plan_is_slowed_as_far_as_it_needs_and_no_further() -> None:
    kept = keeping_apart(line(), RULES, GAZE, rule("slow"))
    assert rule("slow").is_kept(kept.nearest)
    assert kept.slower[0] > 1.2
    hasty = check([line()[0].slower(kept.slower[0] / 1.1)], RULES, GAZE)
    assert not rule("slow").is_kept(min(nearest(hasty, BOTH, REACTION)))


def test_a_plan_is_left_as_it_is_where_all_keep_apart_or_where_slowing_is_not_wanted() -> None:
    wide = np.array([(0.0, 0.0, 20.0), (0.0, 9.0, 20.0)])
    assert keeping_apart(line(wide), RULES, GAZE, rule("slow")).slower == (1.0,)
    refused = keeping_apart(line(), RULES, GAZE, rule("refuse"))
    assert refused.slower == (1.0,)
    assert 'fault_remedy = "slow"' in too_near(refused.nearest, rule("refuse"))


def test_what_no_speed_helps_is_given_up_and_said_in_one_line() -> None:
    above = np.array([(0.0, 0.0, 30.0), (0.0, 0.0, 28.5)])
    kept = keeping_apart(line(above), RULES, GAZE, rule("slow"))
    assert not rule("slow").is_kept(kept.nearest)
    text = too_near(kept.nearest, rule("slow"))
    assert text.startswith("if vehicle 1 stops hearing us at t=")
    assert "vehicle 2 come within" in text
    assert "\n" not in text


def test_a_flight_is_slowed_widened_or_refused_as_it_says() -> None:
    plain = compiled()
    slow = compiled(replace(task(), lost_link=rule("slow")))
    assert plain.faults == {}
    assert slow.approach.duration_s > 1.2 * plain.approach.duration_s
    for name, found in slow.faults.items():
        # Kept, or as slow as a flight gets for it
        assert found.nearest.distance_m >= 0.5 + 0.99 * SPARE_M or MOST_SLOWER / SLOWER < found.slower <= MOST_SLOWER
        assert found.slower == pytest.approx(getattr(slow, name).duration_s / getattr(plain, name).duration_s, rel=0.2)
    gentle = replace(RULES.limits, speed_m_s=4.0, acceleration_m_s2=4.0)
    calm = task(limits=gentle)
    wide = compiled(replace(calm, lost_link=rule("widen")))
    assert 1.0 < wide.task.formation.gyration_m / calm.formation.gyration_m <= 3.0
    assert wide.faults["approach"].slower == pytest.approx(1.0)
    with pytest.raises(PlanError, match=r"if vehicle \d stops hearing us at t=.* \[limits\] fault_separation_m"):
        compiled(replace(task(), lost_link=rule("refuse")))
