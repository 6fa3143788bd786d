"""The whole flight as checked plans, compiled before anything moves: gather, approach, home."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import coverage, flux_metric, least_after_facing
from fg_gcs.core.formation import Formation, Pose
from fg_gcs.core.separation import Separation
from fg_gcs.errors import PlanError
from fg_gcs.plan.by_themselves import ByThemselves, by_themselves
from fg_gcs.plan.formulations import FORMULATIONS, FormulationName
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.lost_link import DEAD, Kept, LostLinkRule, Nearest, keeping_apart, nearest, too_near
from fg_gcs.plan.roll import apart_m, clearest_roll
from fg_gcs.plan.rules import Peaks
from fg_gcs.plan.targets import Target
from fg_gcs.plan.trajectory import Trajectory, timed
from fg_gcs.plan.transit import gather
from fg_gcs.plan.verification import CheckedPlan, check
from fg_gcs.plan.wander import Risk, Wander, least_pads, least_times, parts_of, risk_of, too_often, what_would_do
from fg_gcs.plan.way_home import plan_home

Indices = NDArray[np.intp]

STAGES = ("gather", "approach", "home")
WIDER = np.arange(1.1, 3.01, 0.1)  # times its size that a formation is widened to where a mission wants that
SLOWED = (1.0, 1.03, 1.06, 1.1)  # times as wide that a formation is made for what it is flown slower for faults
MOST_SLOWER = 3.0  # times that a part is flown slower for the sake of lost links; what remains is told
FIGURES_HZ = 100.0  # density of the figures about an approach: every 0.1 m at 10 m/s


@dataclass(frozen=True)
class Task:
    """What a flight is about, in the planner's words."""

    formation: Formation
    start: Pose  # where the formation gathers
    target: Target  # what to surround; a radius changes the formation's size on the way
    hold_depth_m: float  # how far the target's centre lies behind the face during the hold [m]
    rules: Rules
    formulation: FormulationName = "rigid"
    lost_link: LostLinkRule | None = None  # how near vehicles may come when one stops hearing us; None: not computed
    wander: Wander | None = None  # how far vehicles are from where they are told to be; None: not computed
    widens: bool = False  # where that is too far for the formation, it is made wider; else the flight is refused

    def times_as_wide(self, times: float) -> Task:
        """Return the task with a formation so many times as wide."""
        formation = Formation(times * self.formation.leaders_m, times * self.formation.followers_m)
        return replace(self, formation=formation)

    @property
    def edge_m(self) -> float:
        """The distance between the first two leaders: of a hemisphere, its edge [m]."""
        return float(np.linalg.norm(self.formation.leaders_m[1] - self.formation.leaders_m[0]))

    @property
    def target_enu_m(self) -> Array:
        """The centre of the target, shape (3,) [m]."""
        return self.target.centre_enu_m

    @property
    def last_scale(self) -> float:
        """Scale of the formation around the target.

        Raises:
            PlanError: no scale makes the face hold the target.
        """
        return self.target.last_scale(self.formation, self.start.scale)


class FaultFigures(NamedTuple):
    """How near vehicles come in one part of a flight when one stops hearing us, and what was done about it."""

    nearest: Nearest
    fall: Nearest  # likewise if it falls instead: nothing that a plan does about that, but how the formation stands
    slower: float  # how many times longer the part takes for it


class ApproachFigures(NamedTuple):
    """What the approach is like; lengths are sums over the leaders, flux and coverage those of the target's centre."""

    path_length_m: float
    straight_length_m: float
    iterates: int
    flux_metric: float
    coverage_mean: float
    coverage_min_after_facing: float
    last_scale: float  # of the formation around the target, times its template


@dataclass(frozen=True)
class FlightPlan:
    """Three plans that follow each other; between the last two the swarm holds around the target.

    Row v of every sample belongs to vehicle v, whatever slot or pad it was given.
    """

    gather: CheckedPlan
    approach: CheckedPlan
    home: CheckedPlan
    slot_of: Indices  # (V,)
    rim_of: Indices  # (N,) the vehicle at each place of the rim
    figures: ApproachFigures
    faults: dict[str, FaultFigures]  # by the names of the three plans; none: not computed
    task: Task  # what was planned: its formation may be wider than it was asked for
    alone: ByThemselves  # how the swarm comes down when its station is gone
    risk: Risk | None  # that vehicles which wander come too near to each other; None: not computed
    plan_time_s: float  # flux-guided search
    timing_time_s: float  # timing, transits and checks

    @property
    def separation(self) -> Separation:
        """The closest approach of the whole flight; its time counts within its own plan."""
        return min(plan.separation for plan in (self.gather, self.approach, self.home))

    @property
    def nearest_in_fault(self) -> tuple[str, Nearest]:
        """In which part vehicles come nearest when one of them stops hearing us, and how near."""
        return min(((name, each.nearest) for name, each in self.faults.items()), key=lambda part: part[1])

    @property
    def nearest_fall(self) -> tuple[str, Nearest]:
        """In which part a vehicle that falls comes nearest to another one, and how near."""
        return min(((name, each.fall) for name, each in self.faults.items()), key=lambda part: part[1])

    @property
    def peaks(self) -> Peaks:
        """Largest speed and acceleration of the whole flight."""
        return Peaks(*np.max([plan.peaks for plan in (self.gather, self.approach, self.home)], axis=0).tolist())


def compile_flight(task: Task, tops_enu_m: Array, stopwatch: Callable[[], float]) -> FlightPlan:
    """Plan and verify a whole flight.

    Where vehicles would come too near to one that stops hearing us, the flight is made slower, or wider, as the task
    says; where they wander too far for its formation, it is made wider if the task may be.

    Args:
        task: formation, target and rules.
        tops_enu_m: the places above the pads where the vehicles are after take-off, shape (V, 3) [m; ENU].
        stopwatch: returns seconds; planning reads no clock by itself.

    Raises:
        PlanError: some part of the flight has no plan that keeps the rules.
    """
    slots = len(task.formation.slots_m)
    if len(tops_enu_m) != slots:
        raise PlanError(f"the formation has {slots} slots, but there are {len(tops_enu_m)} vehicles")
    if task.wander is None:
        return _kept_in_faults(task, tops_enu_m, stopwatch)
    wander, separation_m = task.wander, task.rules.separation_m
    task = replace(task, rules=replace(task.rules, room_m=wander.room_m))
    wide = max(1.0, least_wide(task, tops_enu_m) or 1.0) if task.widens else 1.0
    for more in SLOWED if task.widens else (1.0,):
        made = _kept_in_faults(task.times_as_wide(more * wide), tops_enu_m, stopwatch)
        if made.risk is not None and made.risk.is_kept:
            return made
    assert made.risk is not None, "the wander is known"
    pads = least_pads(tops_enu_m, wander, separation_m)
    wider_m = pads * (tops_enu_m - tops_enu_m.mean(axis=0)) + tops_enu_m.mean(axis=0)
    times = least_wide(task, wider_m)
    apart_m = float(pdist(wider_m).min()) if pads > 1.0 else None
    helps = what_would_do(times and times * task.edge_m, apart_m)
    raise PlanError(f"{too_often(made.risk, wander, separation_m)}; {helps}")


def _kept_in_faults(task: Task, tops_enu_m: Array, stopwatch: Callable[[], float]) -> FlightPlan:
    """Plan a flight, and make it wider for faults if the task says so."""
    if task.lost_link is None or task.lost_link.remedy != "widen":
        return _compiled(task, tops_enu_m, stopwatch)
    problem: PlanError | None = None
    for times in (1.0, *WIDER.tolist()):
        try:
            return _compiled(task.times_as_wide(times), tops_enu_m, stopwatch)
        except PlanError as error:
            problem = problem or error
    raise PlanError(f"{problem}; no formation up to {WIDER[-1]:g} times as wide helps") from problem


def least_wide(task: Task, tops_enu_m: Array) -> float | None:
    """Return how many times as wide a task's formation is at least where its vehicles, which wander, are safe.

    Args:
        task: with what is known of their wander.
        tops_enu_m: as :func:`compile_flight` takes them.

    Returns:
        Less than 1 where it is wider than it need be; None: no size is wide enough, or they stand too near to each
        other on the ground.
    """
    return least_times(lambda times: _risk_of_size(task, tops_enu_m, times))


def _risk_of_size(task: Task, tops_enu_m: Array, times: float) -> float:
    """Expected breaches of a flight in a formation so many times as wide; without a plan for it there is no end."""
    try:
        parts, _ = _parts(task.times_as_wide(times), tops_enu_m)
    except PlanError:
        return np.inf
    return _risk(parts, task).breaches


def _risk(parts: Mapping[str, CheckedPlan], task: Task) -> Risk:
    """How often vehicles come too near to each other on a flight's parts, as they wander."""
    assert task.wander is not None, "asked for where it is known"
    stages = parts_of(parts["gather"], parts["approach"], parts["home"], task.wander.hold_s)
    return risk_of(stages, task.wander, task.rules.separation_m)


class _Ways(NamedTuple):
    """What a flight's parts consist of."""

    pieces: dict[str, Sequence[Trajectory]]
    goal_of: Indices
    iterates: int
    plan_time_s: float


def _parts(
    task: Task, tops_enu_m: Array, stopwatch: Callable[[], float] = lambda: 0.0
) -> tuple[dict[str, CheckedPlan], _Ways]:
    """Return a flight's parts, verified but for faults, by their names.

    Raises:
        PlanError: there are none.
    """
    rules = task.rules
    search = FORMULATIONS[task.formulation]
    began = stopwatch()
    path = search(task.formation, task.start, task.target.source, task.hold_depth_m, task.last_scale, rules.fence)
    found = stopwatch()
    into = gather(tops_enu_m, task.formation.place(task.start), rules)
    approach = timed(path.swarm_path(into.goal_of), rules.limits)
    pieces: dict[str, Sequence[Trajectory]] = {"approach": [approach], "gather": into.pieces}
    free = {name: check(each, rules, task.target_enu_m) for name, each in pieces.items()}
    hold = approach.sample(np.array([approach.duration_s])).position_m[0]
    pieces["home"] = plan_home(hold, tops_enu_m, rules).pieces
    free["home"] = check(pieces["home"], rules, task.target_enu_m)
    return free, _Ways(pieces, into.goal_of, path.iterates, found - began)


def _compiled(task: Task, tops_enu_m: Array, stopwatch: Callable[[], float]) -> FlightPlan:
    rules = task.rules
    began = stopwatch()
    free, ways = _parts(task, tops_enu_m, stopwatch)
    alone = by_themselves(free, tops_enu_m * (1.0, 1.0, 0.0), rules.fence, rules.separation_m)
    rule = task.lost_link
    if rule is not None and alone.heights_m is not None:  # one that hears nothing hovers first
        hovering = tuple(behaviour._replace(lands=False) for behaviour in rule.behaviours)
        rule = replace(rule, behaviours=hovering)
    kept, rule = _verified(free, ways.pieces, task, rule)
    task = replace(task, lost_link=rule)
    rim = np.argsort(ways.goal_of)[: len(task.formation.leaders_m)]
    return FlightPlan(
        **{name: kept[name][0] for name in STAGES},
        slot_of=ways.goal_of,
        rim_of=rim,
        figures=_figures(task, ways.iterates, kept["approach"][0], rim),
        faults={name: figures for name in STAGES if (figures := kept[name][1]) is not None},
        task=task,
        alone=alone,
        risk=None if task.wander is None else _risk({name: kept[name][0] for name in STAGES}, task),
        plan_time_s=ways.plan_time_s,
        timing_time_s=stopwatch() - began - ways.plan_time_s,
    )


def _verified(
    free: Mapping[str, CheckedPlan], pieces: Mapping[str, Sequence[Trajectory]], task: Task, rule: LostLinkRule | None
) -> tuple[dict[str, tuple[CheckedPlan, FaultFigures | None]], LostLinkRule | None]:
    """Verify a flight's parts against lost links, and slow them down for them if need be.

    Of the time-outs that a rule leaves to choose that one is taken which keeps it and makes the flight shortest.

    Returns:
        The parts with their figures, and the rule with the time-outs that are to be set.

    Raises:
        PlanError: a part breaks a rule.
    """
    if rule is None:
        return {name: (part, None) for name, part in free.items()}, None

    def tried(rule: LostLinkRule) -> Iterator[tuple[dict[str, Kept], LostLinkRule]]:
        for choice in rule.choices():
            found = {
                name: keeping_apart(each, task.rules, task.target_enu_m, choice, MOST_SLOWER)
                for name, each in pieces.items()
            }
            yield found, choice
            if all(choice.is_kept(each.nearest) and max(each.slower) == 1.0 for each in found.values()):
                return  # none is shorter

    def merit(one: tuple[dict[str, Kept], LostLinkRule]) -> tuple[bool, float]:
        kept, choice = one
        worst = min(each.nearest for each in kept.values())
        good = choice.is_kept(worst)
        return good, -sum(each.plan.duration_s for each in kept.values()) if good else worst.distance_m

    kept, rule = max(tried(rule), key=merit)
    worst = min(each.nearest for each in kept.values())
    if not rule.is_kept(worst) and rule.remedy != "slow":
        raise PlanError(too_near(worst, rule))
    parts: dict[str, tuple[CheckedPlan, FaultFigures | None]] = {}
    for name, each in kept.items():
        fall = min(nearest(each.plan, [DEAD], rule.reaction))
        slower = each.plan.duration_s / sum(piece.duration_s for piece in pieces[name])
        parts[name] = each.plan, FaultFigures(each.nearest, fall, slower)
    return parts, rule


def _figures(task: Task, iterates: int, approach: CheckedPlan, rim: Indices) -> ApproachFigures:
    instants = np.linspace(0.0, approach.duration_s, max(2, int(approach.duration_s * FIGURES_HZ) + 1))
    rims = approach.sample(instants).position_m[:, rim]  # (T, N, 3)
    covered = coverage(rims, task.target_enu_m)
    least = least_after_facing(covered)
    straight_m = np.linalg.norm(task.target_enu_m - task.start.centre_enu_m)
    return ApproachFigures(
        path_length_m=float(np.linalg.norm(np.diff(rims, axis=0), axis=2).sum()),
        straight_length_m=float(len(rim) * straight_m),
        iterates=iterates,
        flux_metric=float(flux_metric(rims[-1:], task.target_enu_m)[0]),
        coverage_mean=float(covered.mean()),
        coverage_min_after_facing=float(covered.min()) if least is None else least,
        last_scale=task.last_scale,
    )


def plan_figures(system_ids: Sequence[int | str], made: FlightPlan) -> dict[str, object]:
    """Return a plan's figures by the names of the command line's JSON; peaks and separation are the whole flight's.

    Args:
        system_ids: of the vehicles, as files hold them, in the order of the plan's rows.
        made: the plan.
    """
    first, second = made.separation.pair
    return {
        "planner": "flux_guided",
        "vehicles": len(made.slot_of),
        "leaders": len(made.rim_of),
        **made.figures._asdict(),
        "plan_time_s": made.plan_time_s,
        "timing_time_s": made.timing_time_s,
        "duration_s": made.approach.duration_s,
        "peak_speed_m_s": made.peaks.speed_m_s,
        "peak_acceleration_m_s2": made.peaks.acceleration_m_s2,
        "min_separation_m": made.separation.distance_m,
        "min_separation_pair": [system_ids[first], system_ids[second]],
        **_fault_figures(system_ids, made),
    }


def fault_words(system_ids: Sequence[int | str], made: FlightPlan) -> list[str]:
    """Return what is known of vehicles that stop hearing us, and of those that fall, in lines for people; or none."""
    if not made.faults or made.task.lost_link is None:
        return []
    least_m = made.task.lost_link.least_m

    def least(part: tuple[str, Nearest]) -> str:
        stage, found = part
        first, second = (system_ids[each] for each in found.pair)
        return (
            f"{found.distance_m:.2f} m at least, from vehicle {first} to {second}, if that is {found.heard_s:.1f} s "
            f"into the {stage}"
        )

    slowed = [f"{name} {each.slower:.2f}" for name, each in made.faults.items() if each.slower > 1.005]
    times = f"; it is flown slower for that: {', '.join(slowed)} times" if slowed else ""
    if made.nearest_in_fault[1].distance_m < least_m:
        times += f"; not even that keeps it, and slower than {MOST_SLOWER:g} times it is not flown"
    lines = [f"if a vehicle stops hearing us: {least(made.nearest_in_fault)} (minimum {least_m:.2f} m){times}"]
    if made.nearest_fall[1].distance_m < least_m:
        slots_m, start = made.task.formation.slots_m, [made.task.start]
        roll = clearest_roll(slots_m, start)
        words = f"if a vehicle falls: {least(made.nearest_fall)}; the formation is not clear below it"
        if apart_m(slots_m, start) < least_m <= roll.apart_m:
            words += (
                f"; turned by {roll.by_deg:g} degrees ([formation] roll_deg) vehicles gather {roll.apart_m:.2f} m from "
                "each other as seen from above"
            )
        lines.append(words)
    return lines


def _fault_figures(system_ids: Sequence[int | str], made: FlightPlan) -> dict[str, object]:
    """Return what is known of vehicles that stop hearing us; without a rule about it there is nothing."""
    if not made.faults:
        return {}
    stage, found = made.nearest_in_fault
    return {
        "min_fault_separation_m": found.distance_m,
        "min_fault_separation_pair": [system_ids[each] for each in found.pair],
        "min_fault_separation_stage": stage,
        "min_fault_separation_heard_s": found.heard_s,
        "min_fault_separation_after_s": found.after_s,
        "min_fall_separation_m": made.nearest_fall[1].distance_m,
        "min_fall_separation_pair": [system_ids[each] for each in made.nearest_fall[1].pair],
        "slower_for_faults": {name: figures.slower for name, figures in made.faults.items()},
    }
