"""How often vehicles that wander about their places would come too near to each other, and how wide is wide enough.

A vehicle that hovers, or follows a plan, is not where it is told to be: its estimator and its controller wander, each
vehicle's by themselves, slowly and as a normal distribution. So the distance of a pair that a plan puts d apart is
d + n, n along the line between them with the variance s^2 = u' (S_i + S_j) u of both, as long as d is several s. By
Rice's formula it falls below a minimum m as often as it crosses its mean, times exp(-z^2 / 2), z = (d - m) / s. The
number expected for a pair over a plan is the integral of that, and at least the chance at its closest moment,
Phi(-z). Their sum over all pairs bounds the chance that any of them comes too near during the flight [Rice1945].
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import BLOCK_ELEMENTS
from fg_gcs.plan.verification import CheckedPlan

Indices = NDArray[np.intp]

RISK: Final = 0.002  # a pair too near in a flight: few enough that a bound of 95 % over 500 flights is 1 %
CROSSES_PER_S: Final = (
    0.1  # how often a wander passes its mean in one direction: PX4's 0.07, see docs/measured-dynamics
)
LOOKS_S: Final = 0.2  # between two looks at a plan: a tenth of the time in which a wander changes
ABOVE_PADS_S: Final = 30.0  # taking off, settling there after the way home, and landing
ROOM: Final = 4.2  # standard deviations of a pair that lines between places keep where there is room
WIDEST, NARROWEST, STEP = 8.0, 0.1, 1.1  # times its size that a formation is tried at, and the steps to there
MOST: Final = 99.0  # percent of flights: nearly all
EXACT: Final = 1.005  # to which the least size is told
ON_PADS: Final = "take-off and landing"
SETTLES_S: Final = 12.0  # where the formation gathers: until it has settled, and is measured


class Wander(NamedTuple):
    """How far vehicles are from where they are told to be.

    Attributes:
        sigma_m: standard deviation of each, shape (V, 3) [m; ENU].
        hold_s: for how long the flight holds around its target [s].
        lag_s: by how much they lag behind differently, standard deviation [s]; what all do alike brings nobody nearer.
    """

    sigma_m: Array
    hold_s: float
    lag_s: float = 0.0

    @property
    def level_m(self) -> float:
        """The greatest rms distance of a vehicle from its place, as seen from above [m]."""
        return float(np.hypot(self.sigma_m[:, 0], self.sigma_m[:, 1]).max())

    @property
    def room_m(self) -> float:
        """What lines between places keep beside the separation [m]."""
        return float(ROOM * np.sqrt(2.0) * self.sigma_m.max())


class Risk(NamedTuple):
    """How often a pair is expected to come below the minimum in one flight; of the pair that does so most often.

    Attributes:
        breaches: expected number, of all pairs together.
        stage: where most of them are.
        pair: which pair has most there.
        distance_m: how near the plan brings that pair [m].
    """

    breaches: float
    stage: str
    pair: tuple[int, int]
    distance_m: float

    @property
    def is_kept(self) -> bool:
        """Whether it is small enough to fly."""
        return self.breaches <= RISK

    @property
    def percent(self) -> float:
        """At most in how many of a hundred flights a pair comes too near; breaches come as a Poisson process does."""
        return float(-100.0 * np.expm1(-self.breaches))


class Part(NamedTuple):
    """Where vehicles are told to be in one stage of a flight.

    Attributes:
        stage: its name.
        position_m: at some instants, shape (T, V, 3) [m; ENU].
        velocity_m_s: likewise [m/s].
        spans_s: for how long each of them counts, shape (T,) [s].
    """

    stage: str
    position_m: Array
    velocity_m_s: Array
    spans_s: Array


def risk_of(parts: Iterable[Part], wander: Wander, separation_m: float) -> Risk:
    """Return how often a pair comes too near in a flight.

    Args:
        parts: its stages.
        wander: how far vehicles are from where they are told to be.
        separation_m: the minimum [m].
    """
    total, worst = 0.0, Risk(-1.0, "", (0, 1), np.inf)
    for part in parts:
        first, second = np.triu_indices(part.position_m.shape[1], k=1)
        expected, nearest_m = _of_pairs(part, (first, second), wander, separation_m)
        most = int(expected.argmax())
        found = float(expected.sum())
        total += found
        if found > worst.breaches:
            worst = Risk(found, part.stage, (int(first[most]), int(second[most])), float(nearest_m[most]))
    return worst._replace(breaches=total)


def _of_pairs(part: Part, pairs: tuple[Indices, Indices], wander: Wander, separation_m: float) -> tuple[Array, Array]:
    """Expected breaches of each pair, shape (P,), and its smallest distance as planned, shape (P,) [m]."""
    first, second = pairs
    variances = wander.sigma_m[first] ** 2 + wander.sigma_m[second] ** 2  # (P, 3)
    crossings, nearest_m, least = np.zeros(len(first)), np.full(len(first), np.inf), np.full(len(first), np.inf)
    rows = max(1, BLOCK_ELEMENTS // max(1, len(first)))
    for start in range(0, len(part.position_m), rows):
        places_m, spans_s = part.position_m[start : start + rows], part.spans_s[start : start + rows]
        gaps = places_m[:, first] - places_m[:, second]  # (t, P, 3)
        squares = np.maximum((gaps**2).sum(axis=2), np.finfo(float).tiny)
        along = np.einsum("tpk,pk->tp", gaps**2, variances)
        if wander.lag_s > 0.0:
            velocity_m_s = part.velocity_m_s[start : start + rows]
            for each in pairs:
                along += (wander.lag_s * np.einsum("tpk,tpk->tp", gaps, velocity_m_s[:, each])) ** 2
        along, distances = along / squares, np.sqrt(squares)
        margins = np.maximum(distances - separation_m, 0.0)
        shares = np.divide(margins, np.sqrt(along), out=np.full_like(margins, np.inf), where=along > 0.0)
        crossings += CROSSES_PER_S * (spans_s[:, None] * np.exp(-0.5 * shares**2)).sum(axis=0)
        nearest_m = np.minimum(nearest_m, distances.min(axis=0))
        least = np.minimum(least, shares.min(axis=0))
    return crossings + ndtr(-least), nearest_m


def parts_of(gather: CheckedPlan, approach: CheckedPlan, home: CheckedPlan, hold_s: float) -> list[Part]:
    """Return the stages of a flight: above the pads, on its plans, and at rest between them.

    Args:
        gather: from above the pads.
        approach: to the target.
        home: back to above the pads.
        hold_s: around the target [s].
    """
    found = [_above_pads(gather.sample(np.zeros(1)).position_m[0])]
    for name, plan, rests_s in (("gather", gather, SETTLES_S), ("approach", approach, hold_s), ("home", home, 0.0)):
        instants = np.linspace(0.0, plan.duration_s, max(2, int(plan.duration_s / LOOKS_S) + 1))
        spans = np.full(len(instants), plan.duration_s / len(instants))
        spans[-1] += rests_s
        sample = plan.sample(instants)
        found.append(Part(name, sample.position_m, sample.velocity_m_s, spans))
    return found


def _above_pads(tops_enu_m: Array) -> Part:
    """Taking off and landing, above the pads, shape (V, 3) [m]."""
    return Part(ON_PADS, tops_enu_m[None], np.zeros((1, *tops_enu_m.shape)), np.array([ABOVE_PADS_S]))


def least_times(risk_at: Callable[[float], float]) -> float | None:
    """Return the least size at which a formation keeps the risk, in times its own; None: none is wide enough.

    Args:
        risk_at: expected breaches at a size; they become fewer as it grows.
    """
    low = high = 1.0
    if risk_at(1.0) <= RISK:
        while low > NARROWEST and risk_at(low / STEP) <= RISK:
            low /= STEP
        low, high = low / STEP, low
    else:
        while risk_at(high * STEP) > RISK:
            high *= STEP
            if high > WIDEST:
                return None
        low, high = high, high * STEP
    while high > EXACT * low:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if risk_at(middle) <= RISK else (middle, high)
    return high


def least_pads(tops_enu_m: Array, wander: Wander, separation_m: float) -> float:
    """Return how many times further apart vehicles must take off at least, for half the risk of a flight; at least 1.

    Args:
        tops_enu_m: the places above their pads, shape (V, 3) [m].
        wander: how far they are from there.
        separation_m: the minimum [m].
    """

    def risk_at(times: float) -> float:
        return 2.0 * risk_of([_above_pads(times * tops_enu_m)], wander, separation_m).breaches

    found = least_times(risk_at)
    return WIDEST if found is None else max(1.0, found)


def too_often(risk: Risk, wander: Wander, separation_m: float) -> str:
    """Return why a flight cannot be flown as planned, in words.

    Args:
        risk: of the flight.
        wander: of its vehicles.
        separation_m: the minimum [m].
    """
    first, second = risk.pair
    share = risk.percent
    often = "in nearly all flights" if share > MOST else f"in {share:.2g} % of flights"
    return (
        f"vehicles wander by {wander.level_m:.2f} m, so that {often} two come below {separation_m:.2f} m: vehicles "
        f"{first + 1} and {second + 1} are {risk.distance_m:.2f} m apart as planned ({risk.stage})"
    )


def what_would_do(edge_m: float | None, pads_m: float | None) -> str:
    """Return with what a flight would be safe, in words.

    Args:
        edge_m: the least edge [m]; None: none is.
        pads_m: how far apart vehicles must take off [m]; None: where they stand.
    """
    helps = "no formation is wide enough in this fence"
    if edge_m is not None:
        helps = f"the smallest edge that is safe is {edge_m:.1f} m"
    return helps if pads_m is None else f"{helps}, with vehicles {pads_m:.1f} m apart on the ground"
