"""Where a moving target is, how fast it goes and how sure that is, from noisy, late and unordered sightings.

Kalman filters along stamps, not arrivals [BarShalom2001]_: every sighting of the last seconds is kept together with
what was known after it, so that a late one is put in its place and the newer ones are taken again. The result is
the same whatever the order of arrival. One rule begins tracks and ends wrong ones: sightings that do not belong to the
track are held, and as soon as enough of them agree with each other, the track begins anew from those. So neither a wild
first sighting nor a target that jumped can mislead the filter for longer than a few sightings. docs/derivations.md has
the equations.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, NamedTuple, get_args

import numpy as np
from scipy.stats import chi2

from fg_gcs.core.arrays import Array
from fg_gcs.errors import PlanError
from fg_gcs.track.estimate.imm import Belief, Prediction, carried_on, changes, filtered, merged
from fg_gcs.track.estimate.kalman import FLOOR_M2, Dynamics
from fg_gcs.track.sightings import Sighting, Verdict

Model = Literal["mixed", "velocity", "acceleration"]

MOST_M2 = 1e8  # a deviation of 10 km says nothing about where a target is
OLDEST_S = 60.0  # no news of a minute ago says where a target is now
MOST_KEPT = 200  # sightings in the history: 100 Hz over 2 s; more would make one late sighting cost a control period
ASYMMETRY = 1e-9  # of the largest entry: more than rounding, and a matrix is no covariance


@dataclass(frozen=True)
class Settings:
    """How a target is believed to move, and which sightings of it are believed.

    The model "mixed" believes in steady turns as long as the sightings do, and else in accelerations that come and
    fade. The process noise was chosen for targets of up to 5 m/s and 1.5 m/s^2, seen ten times a second to half a
    metre; it lies below those accelerations because they last: a filter that follows turns more closely follows noise,
    too.
    """

    model: Model = "mixed"  # or one alone: "acceleration", "velocity" (for targets seldom or badly seen)
    acceleration_m_s2: float = 0.3  # standard deviation of an acceleration that fades [Singer1970]_
    ease_s: float = 4.0  # time constant by which it fades
    density_m2_s3: float = 0.3  # of the white acceleration, for the model "velocity"
    turning_m2_s5: float = 5e-4  # density of what changes a steady turn, for the model "mixed" [BestNorton1997]_
    steady_s: float = 30.0  # mean time for which a target turns steadily, for the model "mixed"
    unsteady_s: float = 10.0  # mean time for which it does not
    confidence: float = 0.999  # share of the right sightings that pass the gate
    top_speed_m_s: float = 15.0  # no target is faster: bounds how far apart two sightings of one may be
    agreeing_first: int = 3  # sightings that must agree with each other before there is an estimate
    agreeing_again: int = 5  # sightings in a row outside the gate that must agree before the track begins anew
    lost_after_s: float = 1.0  # without a sighting
    history_s: float = 2.0  # how far behind the newest stamp a late sighting still counts
    future_s: float = 0.05  # how far ahead of the clock a stamp may be: clocks of two computers differ
    centre_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m; ENU]
    reach_m: float = 10_000.0  # how far from the centre a target may be

    def __post_init__(self) -> None:
        """Refuse what no filter can work with.

        Raises:
            PlanError: an unknown model, a confidence outside (0, 1), or a quantity that is not above 0.
        """
        if self.model not in get_args(Model):
            raise PlanError(f"the model must be one of {', '.join(get_args(Model))}, got {self.model!r}")
        if not 0.0 < self.confidence < 1.0:
            raise PlanError(f"the confidence must lie between 0 and 1, got {self.confidence}")
        for name, value in vars(self).items():
            if isinstance(value, (int, float)) and not 0.0 < value < math.inf:
                raise PlanError(f"{name} must be a finite number above 0, got {value}")
        if not all(math.isfinite(each) for each in self.centre_enu_m):
            raise PlanError("centre_enu_m must be three finite numbers")

    @property
    def dynamics(self) -> tuple[Dynamics, ...]:
        """The numbers of each model that is mixed, all of one order."""
        if self.model == "velocity":
            return (Dynamics(2, self.density_m2_s3, math.inf),)
        fading = Dynamics(3, 2.0 * self.acceleration_m_s2**2 / self.ease_s, self.ease_s, self.unsteady_s)
        steady = Dynamics(3, self.turning_m2_s5, math.inf, self.steady_s)
        return (steady, fading) if self.model == "mixed" else (fading,)


class Estimate(NamedTuple):
    """What is known of a target at one time."""

    time_s: float  # [s of the flight's clock]
    position_enu_m: Array  # (3,) [m; ENU]
    velocity_m_s: Array  # (3,) [m/s; ENU]
    acceleration_m_s2: Array  # (3,) [m/s^2; ENU]; zeros in the model "velocity"
    covariance: Array  # (6, 6) or (9, 9), in blocks of three: position, velocity and, in the larger one, acceleration
    age_s: float  # since the newest sighting taken
    belief: Belief  # of each model that is mixed, at the same time
    dynamics: tuple[Dynamics, ...]

    @classmethod
    def of(cls, time_s: float, belief: Belief, age_s: float, dynamics: tuple[Dynamics, ...]) -> Estimate:
        """Return what a belief of that age amounts to."""
        doubts = belief.weights @ changes(_leaving(dynamics), age_s)
        mean, covariance = merged(belief.weights, doubts, belief.means, belief.covariances)
        acceleration = mean[2] if len(mean) == 3 else np.zeros(3)
        return cls(time_s, mean[0], mean[1], acceleration, covariance, age_s, belief, dynamics)

    def predicted(self, time_s: float) -> Estimate:
        """Return what that says of a later time; an estimate is not carried back, so an earlier time returns itself.

        Accelerations fade or turn, so that the speed stays bounded; the covariance goes on growing.
        """
        step_s = max(time_s - self.time_s, 0.0)
        if step_s == 0.0:
            return self
        return Estimate.of(
            self.time_s + step_s, _later(self.belief, self.dynamics, step_s), self.age_s + step_s, self.dynamics
        )

    @property
    def prediction(self) -> Prediction:
        """Where the target goes from here."""
        weights, means, _, rates = self.belief
        whole = np.zeros((len(means), 3, 3))
        whole[:, : means.shape[1]] = means
        eases = np.array([each.ease_s if each.order == 3 else 1.0 for each in self.dynamics])
        return Prediction(self.time_s, weights, whole, eases, rates)


class _Track(NamedTuple):
    """The filter after a sighting."""

    time_s: float
    belief: Belief


class _State(NamedTuple):
    """All that a next sighting meets."""

    track: _Track | None
    held: tuple[Sighting, ...]  # outside of the track, since the last one that was inside


class _Seen(NamedTuple):
    """A sighting in the history and what was known after it."""

    key: tuple[float, ...]  # stamp and position: its place
    sighting: Sighting
    after: _State


class Estimator:
    """Keeps the track of one target.

    There is no estimate before ``agreeing_first`` sightings agree with each other. Two agree if their distance is one
    that noise at the gate's confidence and the top speed explain. What is then known is the same for any order of
    arrival within ``history_s``. Verdicts are those on arrival: a late sighting may change what became of newer ones.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._dynamics = settings.dynamics
        self._models, self._leaving = _models(self._dynamics), _leaving(self._dynamics)
        self._gate = float(chi2.ppf(settings.confidence, df=3))
        self._before = _State(None, ())  # what was known before the history
        self._history: list[_Seen] = []
        self._counts: Counter[Verdict] = Counter()
        any_one = Sighting("", 0.0, np.zeros(3), np.eye(3), 0.0)
        self._begun([any_one, any_one])  # once through the compiler now, so that no sighting waits for it

    @property
    def counts(self) -> Mapping[Verdict, int]:
        """How many sightings met which verdict."""
        return MappingProxyType(self._counts)

    def add(self, sighting: Sighting, now_s: float) -> Verdict:
        """Take a sighting if it is to be believed; never raises, whatever numbers it holds.

        Args:
            sighting: of this target.
            now_s: the time [s of the flight's clock].
        """
        own = sighting._replace(  # copies: the caller may go on writing to its own
            position_enu_m=np.array(sighting.position_enu_m, dtype=float),
            covariance_m2=np.array(sighting.covariance_m2, dtype=float),
        )
        verdict = self._refusal(own, now_s) or self._merged(own)
        self._counts[verdict] += 1
        return verdict

    def at(self, time_s: float) -> Estimate | None:
        """Return what the sightings up to a time say of it.

        None before there is a track, and for times before the history.
        """
        found = self._place((time_s, math.inf))
        state = self._history[found - 1].after if found else self._before
        track = state.track
        if track is None or track.time_s > time_s:
            return None
        step_s = time_s - track.time_s
        return Estimate.of(time_s, _later(track.belief, self._dynamics, step_s), step_s, self._dynamics)

    def lost(self, now_s: float) -> bool:
        """Say whether nothing was seen of the target for too long; a lost one is still predicted."""
        track = (self._history[-1].after if self._history else self._before).track
        return track is None or now_s - track.time_s > self._settings.lost_after_s

    def _place(self, key: tuple[float, ...]) -> int:
        """Return how many of the history come before a key; one that only begins like it comes before it."""
        return bisect_left(self._history, key, key=lambda seen: seen.key)

    def _refusal(self, sighting: Sighting, now_s: float) -> Verdict | None:
        """Return why a sighting is refused whatever is known of the target, if it is."""
        settings = self._settings
        position, covariance = sighting.position_enu_m, sighting.covariance_m2
        if position.shape != (3,) or covariance.shape != (3, 3):
            return Verdict.MALFORMED
        if not (math.isfinite(sighting.time_s) and np.isfinite(position).all()):
            return Verdict.NOT_FINITE
        if not _is_covariance(covariance):
            return Verdict.BAD_COVARIANCE
        if sighting.time_s > now_s + settings.future_s:
            return Verdict.FUTURE
        if sighting.time_s < now_s - OLDEST_S:
            return Verdict.TOO_OLD
        if math.dist(position.tolist(), settings.centre_enu_m) > settings.reach_m:
            return Verdict.FAR
        return None

    def _merged(self, sighting: Sighting) -> Verdict:
        """Put a sighting in its place, and take the newer ones again."""
        key = (sighting.time_s, *sighting.position_enu_m.tolist())
        newest_s = max(self._history[-1].key[0], sighting.time_s) if self._history else sighting.time_s
        oldest_s = newest_s - self._settings.history_s
        if sighting.time_s < oldest_s:
            return Verdict.TOO_OLD
        forgotten = self._place((oldest_s,))
        if forgotten:
            self._before = self._history[forgotten - 1].after
            del self._history[:forgotten]
        place = self._place(key)
        if place < len(self._history) and self._history[place].key == key:
            return Verdict.DUPLICATE
        if len(self._history) >= MOST_KEPT:
            return Verdict.FLOOD
        state = self._history[place - 1].after if place else self._before
        state, verdict = self._next(state, sighting)
        self._history.insert(place, _Seen(key, sighting, state))
        for later in range(place + 1, len(self._history)):
            seen = self._history[later]
            state, _ = self._next(state, seen.sighting)
            self._history[later] = seen._replace(after=state)
        return verdict

    def _next(self, state: _State, sighting: Sighting) -> tuple[_State, Verdict]:
        """Return what is known after a sighting, in the order of stamps, and what became of it."""
        settings, track = self._settings, state.track
        if track is not None:
            updated, distance = self._filtered(track, sighting)
            if distance <= self._gate:
                return _State(updated, ()), Verdict.TAKEN
        enough = settings.agreeing_first if track is None else settings.agreeing_again
        agreeing = self._agreeing(state.held, sighting)
        if len(agreeing) >= enough:
            return _State(self._begun(agreeing), ()), Verdict.TAKEN
        held = (*state.held, sighting)[-2 * enough :]  # among as many, wild ones between them do no harm
        return _State(track, held), Verdict.TENTATIVE if track is None else Verdict.GATED

    def _filtered(self, track: _Track, sighting: Sighting) -> tuple[_Track, float]:
        """Return the track updated by a sighting, and the sighting's squared Mahalanobis distance from it."""
        step_s = sighting.time_s - track.time_s
        seen = sighting.position_enu_m, sighting.covariance_m2
        *belief, distance = filtered(*track.belief[:3], self._models, self._leaving, step_s, *seen)
        return _Track(sighting.time_s, Belief(*belief)), distance

    def _agreeing(self, held: Sequence[Sighting], sighting: Sighting) -> list[Sighting]:
        """Return the sighting and those held that agree with it and each other, in the order of stamps."""
        agreeing = [sighting]
        for other in reversed(held):
            if all(self._agree(other, each) for each in agreeing):
                agreeing.append(other)
        return agreeing[::-1]

    def _agree(self, one: Sighting, other: Sighting) -> bool:
        apart_m = math.dist(one.position_enu_m.tolist(), other.position_enu_m.tolist())
        noise_m2 = float(np.abs(one.covariance_m2 + other.covariance_m2).sum(axis=1).max())  # >= largest eigenvalue
        moved_m = self._settings.top_speed_m_s * abs(one.time_s - other.time_s)
        return apart_m <= moved_m + math.sqrt(self._gate * (noise_m2 + 2.0 * FLOOR_M2))

    def _begun(self, agreeing: Sequence[Sighting]) -> _Track:
        """Return the track of sightings that agree, from standing still, not known better than the top speed."""
        first, count, order = agreeing[0], len(self._dynamics), self._dynamics[0].order
        mean = np.zeros((order, 3))
        mean[0] = first.position_enu_m
        covariance = np.zeros((3 * order, 3 * order))
        covariance[:3, :3] = first.covariance_m2 + FLOOR_M2 * np.eye(3)
        covariance[3:6, 3:6] = (0.5 * self._settings.top_speed_m_s) ** 2 * np.eye(3)
        covariance[6:, 6:] = self._settings.acceleration_m_s2**2 * np.eye(3 * (order - 2))
        lasting = np.array([each.lasts_s for each in self._dynamics]) if count > 1 else np.ones(1)
        weights = lasting / lasting.sum()  # nothing is known yet: each as likely as it lasts
        belief = Belief(weights, np.stack([mean] * count), np.stack([covariance] * count), np.zeros(count))
        track = _Track(first.time_s, belief)
        for sighting in agreeing[1:]:
            track, _ = self._filtered(track, sighting)
        return track


def _later(belief: Belief, dynamics: tuple[Dynamics, ...], step_s: float) -> Belief:
    """Return a belief a step later, without anything seen."""
    means, covariances = carried_on(belief.means, belief.covariances, belief.rates_rad_s, _models(dynamics), step_s)
    return belief._replace(means=means, covariances=covariances)


def _models(dynamics: tuple[Dynamics, ...]) -> Array:
    """Densities and time constants, shape (B, 2)."""
    return np.array([(each.density, each.ease_s) for each in dynamics])


def _leaving(dynamics: tuple[Dynamics, ...]) -> Array:
    """How often a target leaves each model for the other, shape (B,) [1/s]."""
    return np.array([1.0 / each.lasts_s for each in dynamics])


def _is_covariance(matrix: Array) -> bool:
    """Say whether a 3x3 matrix is finite, bounded, symmetric and, but for rounding, positive semi-definite."""
    most = float(np.abs(matrix).max())  # not a number if one is none
    if not most <= MOST_M2 or np.abs(matrix - matrix.T).max() > ASYMMETRY * most:
        return False
    return bool(np.linalg.eigvalsh(matrix)[0] >= -min(ASYMMETRY * most, 0.5 * FLOOR_M2))
