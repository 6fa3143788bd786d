"""How near vehicles come when one stops hearing us at any moment of a plan, and how slowly to fly so that it is enough.

A vehicle without setpoints does what its autopilot does, see `LostLink`; the others fly on for `Reaction.notice_s`,
come to rest on their path as :func:`fg_gcs.plan.pace.stopping` says, and stay there until they leave. All of that is
computed in steps for every vehicle and many moments, against every other vehicle, be that one at rest by then or deaf
as well. What follows when they leave is planned anew and keeps clear of it (:mod:`fg_gcs.plan.keep_clear`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fg_gcs.compiling import kernel, long_kernel
from fg_gcs.core.arrays import Array
from fg_gcs.plan.limits import Rules
from fg_gcs.plan.pace import changing, stopping
from fg_gcs.plan.rules import too_close
from fg_gcs.plan.trajectory import Trajectory, place_text
from fg_gcs.plan.verification import CheckedPlan, check

Remedy = Literal["slow", "widen", "refuse"]

STEP_S: Final = 0.02  # of the computation: at 10 m/s every 0.2 m, between which motion is straight
SAMPLES: Final = 3_000  # of a plan at most: a longer one is slow, and needs fewer a second
MOMENTS_S: Final = 0.1  # between two moments at which a vehicle stops hearing us
MOMENTS: Final = 300  # at most, likewise
PAIRS: Final = 1_000_000  # of vehicles times moments, about: more moments are left out, down to
FEWEST_MOMENTS: Final = 40
SINK_M_S, SLOW_SINK_M_S = 1.5, 0.7  # speeds of a landing above HIGH_M and below LOW_M; ArduPilot's are no higher
HIGH_M, LOW_M = 10.0, 5.0  # above the ground; in between PX4 changes from one to the other
GRAVITY_M_S2: Final = 9.81
TINY_M: Final = 1e-3  # on what a pair may near each other in a step
SPARE: Final = 0.2  # of the least distance, as far as that is less
SPARE_M: Final = 0.1  # that is planned on top of the least distance: vehicles are off their setpoints
VELOCITY_GAIN_PER_S: Final = 3.0  # how quickly a multicopter takes up a velocity: 1.8 to 4 in both autopilots
BRAKING_SHARE: Final = 0.6  # of what a vehicle brakes by, which it plans with when it goes to a place
SLOWER: Final = 1.3  # between two factors that are tried
FINER: Final = 3  # halvings after that: to within 4 %
SLOWEST: Final = 20.0  # times slower: what is too near then is so at rest


class LostLink(NamedTuple):
    """What an autopilot does without setpoints; measured, see docs/autopilots.

    Attributes:
        timeout_s: how long it goes on before it acts [s].
        runs_on: whether it moves its last setpoint on by its velocity and acceleration meanwhile; otherwise it goes to
            that place, past it by what the velocity that it still feeds forward takes it.
        stays: whether it stays at that place after the time-out; otherwise it brakes where it is then.
        lands: whether it sinks after the time-out while it brakes, down to the ground.
        brakes_m_s2: by what it corrects its motion at most, and brakes [m/s^2].
        gains_per_s: of positions, the least and the greatest that are known; both are computed [1/s].
        falls: whether it falls instead, as one does whose autopilot is dead.
    """

    timeout_s: float
    runs_on: bool
    stays: bool
    lands: bool
    brakes_m_s2: float
    gains_per_s: tuple[float, ...]
    falls: bool = False


DEAD: Final = LostLink(0.0, runs_on=False, stays=False, lands=False, brakes_m_s2=0.0, gains_per_s=(0.0,), falls=True)


class Reaction(NamedTuple):
    """What those do that still hear us.

    Attributes:
        notice_s: when they begin to come to rest, since the vehicle stopped hearing [s].
        waits_s: how long they wait at rest at least, since then [s].
        leaving_s: until they are under way after that [s].
    """

    notice_s: float
    waits_s: float
    leaving_s: float


class Nearest(NamedTuple):
    """The least distance of a pair of which one vehicle stopped hearing us."""

    distance_m: float
    heard_s: float  # until when it heard, in the plan's time [s]
    after_s: float  # how long after that the pair is so near [s]
    pair: tuple[int, int]  # indices: it, and the other
    place_enu_m: tuple[float, float, float]  # where it is then [m]


@dataclass(frozen=True)
class LostLinkRule:
    """How near vehicles may come when one stops hearing us.

    Attributes:
        least_m: what every pair has to keep [m].
        remedy: what is done where they would come nearer.
        behaviours: of the autopilots in the swarm.
        reaction: of the others.
        shorter_s: time-outs that vehicles which run on may be given instead, as far as they are shorter [s].
    """

    least_m: float
    remedy: Remedy
    behaviours: tuple[LostLink, ...]
    reaction: Reaction
    shorter_s: tuple[float, ...] = ()

    def choices(self) -> list[LostLinkRule]:
        """Return this rule with each time-out that there is to choose, the longest first; none is left to choose."""
        longest_s = self.runs_on_s or 0.0
        return [self.within(most_s) for most_s in (longest_s, *(s for s in self.shorter_s if s < longest_s))]

    def within(self, most_s: float) -> LostLinkRule:
        """Return this rule for vehicles that run on no longer than that [s]."""
        behaviours = (
            each._replace(timeout_s=min(each.timeout_s, most_s)) if each.runs_on else each for each in self.behaviours
        )
        return replace(self, behaviours=tuple(sorted(set(behaviours))), shorter_s=())

    @property
    def runs_on_s(self) -> float | None:
        """How long vehicles run on that do so, at most; None: nobody does [s]."""
        return max((each.timeout_s for each in self.behaviours if each.runs_on), default=None)

    def is_kept(self, found: Nearest) -> bool:
        """Say whether vehicles that come so near are far enough from each other."""
        return not too_close(found.distance_m, self.least_m + min(SPARE_M, SPARE * self.least_m))


class Kept(NamedTuple):
    """A plan, and how near vehicles come in it when one stops hearing us."""

    plan: CheckedPlan
    nearest: Nearest
    slower: tuple[float, ...]  # how many times slower each piece is than it could be flown


def nearest(plan: CheckedPlan, behaviours: Sequence[LostLink], reaction: Reaction) -> list[Nearest]:
    """Return for each piece of a plan how near a pair comes that it brings together after a vehicle stopped hearing us.

    A moment counts for the piece in which the vehicle hears us last, and for that in which the others notice.

    Args:
        plan: what is flown.
        behaviours: of the autopilots in the swarm; each is computed for all vehicles.
        reaction: of the others.
    """
    step_s = max(STEP_S, plan.duration_s / SAMPLES)
    time_s = np.arange(0.0, plan.duration_s + 2.0 * step_s, step_s)  # beyond its end it rests
    swarm = plan.sample(time_s)
    if swarm.position_m.shape[1] < 2:
        return [Nearest(np.inf, 0.0, 0.0, (0, 0), (0.0, 0.0, 0.0))] * len(plan.pieces)
    moments = min(MOMENTS, max(FEWEST_MOMENTS, PAIRS // swarm.position_m.shape[1] ** 2))
    stride = max(1, round(max(MOMENTS_S, plan.duration_s / moments) / step_s))
    piece_of = np.searchsorted(plan.starts_s, np.stack((time_s, time_s + reaction.notice_s)), side="right") - 1
    best = np.zeros((len(plan.pieces), 8))
    best[:, 0] = np.inf  # a piece that is over before anybody notices brings nobody together
    for behaviour in behaviours:
        for gain_per_s in behaviour.gains_per_s:
            _nearest(
                swarm.position_m,
                swarm.velocity_m_s,
                swarm.acceleration_m_s2,
                step_s,
                stride,
                piece_of,
                (plan.limits.acceleration_m_s2, plan.limits.jerk_m_s3),
                (behaviour.timeout_s, behaviour.runs_on, behaviour.stays, behaviour.lands, behaviour.falls),
                (behaviour.brakes_m_s2, gain_per_s),
                (reaction.notice_s, reaction.waits_s, reaction.leaving_s),
                best,
            )
    return [
        Nearest(row[0], row[1], row[2], (int(row[3]), int(row[4])), (row[5], row[6], row[7])) for row in best.tolist()
    ]


def keeping_apart(
    pieces: Sequence[Trajectory], rules: Rules, gaze_enu_m: Array, rule: LostLinkRule, slowest: float = SLOWEST
) -> Kept:
    """Verify trajectories, each slowed as far as a rule needs it, if its remedy is that, and as far as it helps.

    Args:
        pieces: as those of :func:`fg_gcs.plan.verification.check`.
        rules: limits, separation and fence.
        gaze_enu_m: the point that every nose points at, shape (3,) [m].
        rule: how near vehicles may come, and what is done where they would come nearer.
        slowest: how many times slower at most.

    Raises:
        PlanError: another rule is broken.
    """

    def tried(factors: Array) -> tuple[CheckedPlan, list[Nearest]]:
        slowed = [piece if k == 1.0 else piece.slower(k) for piece, k in zip(pieces, factors.tolist(), strict=True)]
        made = check(slowed, rules, gaze_enu_m)
        return made, nearest(made, rule.behaviours, rule.reaction)

    good = np.ones(len(pieces))  # for each piece the quickest that is known to keep the rule
    plan, found = tried(good)
    bad = _bad(found, rule)
    if bad.any() and rule.remedy == "slow":
        quick = good  # the slowest that does not
        while bad.any() and good.max() * SLOWER <= slowest:
            quick, good = np.where(bad, good, quick), np.where(bad, good * SLOWER, good)
            plan, found = tried(good)
            bad = _bad(found, rule)
        for _ in range(0 if bad.any() else FINER):
            between = np.sqrt(quick * good)
            middle = tried(between)
            bad = _bad(middle[1], rule)
            quick = np.where(bad, between, quick)
            if not bad.any():
                good, (plan, found) = between, middle
    return Kept(plan, min(found), tuple(good.tolist()))


def _bad(found: Sequence[Nearest], rule: LostLinkRule) -> NDArray[np.bool_]:
    """Say in which pieces vehicles come too near."""
    return np.array([not rule.is_kept(one) for one in found])


def too_near(worst: Nearest, rule: LostLinkRule) -> str:
    """Return why a plan does not keep a rule, in one line that says what would help."""
    first, second = worst.pair
    where = place_text(np.array(worst.place_enu_m))
    helps = "widen the formation, or turn it so that no vehicle is behind or below another one"
    if rule.remedy == "refuse":
        helps = f'fly slower (fault_remedy = "slow" does), {helps}'
    return (
        f"if vehicle {first + 1} stops hearing us at t={worst.heard_s:.1f} s, it and vehicle {second + 1} come within "
        f"{worst.distance_m:.2f} m of each other {worst.after_s:.1f} s later, at {where} "
        f"(minimum {rule.least_m:.2f} m, [limits] fault_separation_m, and {SPARE_M:g} m to spare); {helps}"
    )


@kernel
def _deaf(
    place: Array,
    velocity: Array,
    acceleration: Array,
    step: float,
    behaviour: tuple[float, bool, bool, bool, bool],
    loop: tuple[float, float],
    way: Array,
) -> None:
    """Fill the way of a vehicle that has heard its last setpoint, shape (S, 3), see `LostLink`."""
    timeout, runs_on, stays, lands, falls = behaviour
    brakes, gain = loop
    x, u = place.copy(), velocity.copy()
    target, wanted, asked = np.empty(3), np.empty(3), np.empty(3)
    for j in range(len(way)):
        time = j * step
        run = min(time, timeout) if runs_on else 0.0
        over = time >= timeout
        away = 0.0
        for k in range(3):
            target[k] = place[k] + velocity[k] * run + 0.5 * acceleration[k] * run * run
            away += (target[k] - x[k]) ** 2
        pull = _pull(away, gain, BRAKING_SHARE * brakes)
        size = 0.0
        for k in range(3):
            way[j, k] = x[k]
            if over and not stays:
                share = min(max((x[2] - LOW_M) / (HIGH_M - LOW_M), 0.0), 1.0)
                wanted[k] = -(SLOW_SINK_M_S + share * (SINK_M_S - SLOW_SINK_M_S)) if lands and k == 2 else 0.0
            else:
                wanted[k] = pull * (target[k] - x[k])
                if not over:
                    wanted[k] += velocity[k] + acceleration[k] * run
            asked[k] = VELOCITY_GAIN_PER_S * (wanted[k] - u[k])
            size += asked[k] * asked[k]
        scale = 1.0 if size <= brakes * brakes else brakes / math.sqrt(size)
        for k in range(3):
            a = scale * asked[k] + (0.0 if over else acceleration[k])
            if falls:
                a = -GRAVITY_M_S2 if k == 2 else 0.0
            x[k] += u[k] * step + 0.5 * a * step * step
            u[k] += a * step


@kernel
def _pull(square: float, gain: float, brakes: float) -> float:
    """Speed per distance, whose square this is, towards a place: proportional when near, else at constant deceleration.

    ArduPilot's ``sqrt_controller``; PX4 is proportional also when it is far.
    """
    if gain == 0.0 or square < (brakes / (gain * gain)) ** 2:
        return gain
    away = math.sqrt(square)
    return math.sqrt(2.0 * brakes * (away - 0.5 * brakes / (gain * gain))) / away


@long_kernel
def _nearest(
    position: Array,
    velocity: Array,
    acceleration: Array,
    step: float,
    stride: int,
    piece_of: NDArray[np.intp],
    limits: tuple[float, float],
    behaviour: tuple[float, bool, bool, bool, bool],
    loop: tuple[float, float],
    reaction: tuple[float, float, float],
    best: Array,
) -> None:
    """Lower the least distance of each piece.

    Args:
        position: of the plan, shape (T, V, 3) [m].
        velocity: likewise [m/s].
        acceleration: likewise [m/s^2].
        step: between two samples [s].
        stride: samples between two moments that are looked at.
        piece_of: for which pieces each moment counts, the first and the last of them, shape (2, T).
        limits: of acceleration and jerk.
        behaviour: see `LostLink`.
        loop: by what it brakes, and one gain.
        reaction: see `Reaction`.
        best: fields of `Nearest`, one row a piece, shape (P, 8), changed in place.
    """
    notice, waits, leaving = reaction
    last, vehicles = len(position) - 1, position.shape[1]
    moments = (last + stride) // stride + 1
    for moment in range(moments):
        i = min(moment * stride, last)
        begun = i * step + notice
        lasts = stopping(velocity, acceleration, begun, step, limits[0], limits[1], 1.0, 0.0)
        steps = int((max(notice + lasts, waits) + leaving) / STEP_S) + 1
        ways = np.empty((2, vehicles, steps, 3))  # of all as if they heard us, and as if they did not
        for j in range(steps):
            time, _, _ = changing(j * STEP_S - notice, begun, 1.0, 0.0, 0.0, lasts)
            _places(position, time / step, j, ways[0])
        for v in range(vehicles):
            _deaf(position[i, v], velocity[i, v], acceleration[i, v], STEP_S, behaviour, loop, ways[1, v])
        boxes, nearing = _bounds(ways)
        pieces = best[piece_of[0, i] : piece_of[1, i] + 1]
        row = pieces[np.argmax(pieces[:, 0])].copy()  # nothing nearer than this is of any interest
        for first in range(vehicles):
            for second in range(vehicles):
                for deaf in range(2 if second > first else 1):
                    if first != second and _gap(boxes[1, first], boxes[deaf, second]) < row[0]:
                        closing = nearing[1, first] + nearing[deaf, second]
                        _pair(ways[1, first], ways[deaf, second], first, second, closing, i * step, row)
        for piece in pieces:
            if row[0] < piece[0]:
                piece[:] = row


@kernel
def _places(position: Array, where: float, j: int, ways: Array) -> None:
    """Fill step j of the ways, shape (V, S, 3), with a plan's places at a time; its samples are 1 apart."""
    last = len(position) - 1
    i = min(int(where), last)
    share = min(where - i, 1.0) if i < last else 0.0
    for v in range(len(ways)):
        for k in range(3):
            ways[v, j, k] = position[i, v, k]
            if share > 0.0:
                ways[v, j, k] += share * (position[i + 1, v, k] - position[i, v, k])


@kernel
def _bounds(ways: Array) -> tuple[Array, Array]:
    """Bound ways, shape (2, V, S, 3), beside the mean of those that hear us, with which all of them move along.

    Returns:
        Least and greatest coordinates of each way, shape (2, V, 2, 3) [m], and the most by which it nears any place
        that moves with the mean in a step, shape (2, V) [m].
    """
    vehicles, steps = ways.shape[1], ways.shape[2]
    mean = np.zeros((steps, 3))
    for v in range(vehicles):
        for j in range(steps):
            for k in range(3):
                mean[j, k] += ways[0, v, j, k] / vehicles
    boxes, nearing = np.empty((2, vehicles, 2, 3)), np.empty((2, vehicles))
    boxes[:, :, 0], boxes[:, :, 1] = np.inf, -np.inf
    for deaf in range(2):
        for v in range(vehicles):
            box, fastest = boxes[deaf, v], 0.0
            before = ways[deaf, v, 0] - mean[0]
            for j in range(steps):
                square = 0.0
                for k in range(3):
                    place = ways[deaf, v, j, k] - mean[j, k]
                    box[0, k], box[1, k] = min(box[0, k], place), max(box[1, k], place)
                    square += (place - before[k]) ** 2
                    before[k] = place
                fastest = max(fastest, square)
            nearing[deaf, v] = math.sqrt(fastest) + TINY_M
    return boxes, nearing


@kernel
def _gap(box: Array, other: Array) -> float:
    """Distance of two boxes, shape (2, 3) each; no more than this, but for what rounding makes of it."""
    square = 0.0
    for k in range(3):
        apart = max(box[0, k] - other[1, k], other[0, k] - box[1, k], 0.0)
        square += apart * apart
    return math.sqrt(square) - TINY_M


@kernel
def _pair(way: Array, other: Array, first: int, second: int, closing: float, heard: float, best: Array) -> None:
    """Lower the least distance by that of one pair, of which the first vehicle does not hear us.

    Where a pair is far apart, as many steps are left out as it needs at least to come nearer than the least so far.
    """
    j = 0
    while j < len(way):
        square = 0.0
        for k in range(3):
            square += (way[j, k] - other[j, k]) ** 2
        distance = math.sqrt(square)
        if distance < best[0]:
            best[0], best[1], best[2], best[3], best[4] = distance, heard, j * STEP_S, first, second
            best[5], best[6], best[7] = way[j, 0], way[j, 1], way[j, 2]
        j += max(1, int((distance - best[0]) / closing))
