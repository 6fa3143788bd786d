"""State-to-state motion with bounded velocity, acceleration and jerk, by ruckig [Berscheid2021]_.

Position, velocity and acceleration are continuous; every joint keeps its own bounds. Only the state-to-state function
is used: intermediate waypoints of the community edition are worked out by a service in the network, and a ground
station must not depend on one. Motions of a closed form, to a velocity and of least jerk, are worked out here, since a
trajectory has several of them and is planned ten times a second; in the tests ruckig judges the former.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from ruckig import InputParameter, Result, Ruckig, RuckigError, Trajectory

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array

ROOM, SPARE_M_S = 1.01, 0.01  # a goal right on a bound has no way to it
SHORTEST_S = 1e-9  # phases shorter than this are none
FIRST_ROOM = 32  # phases of an axis that there is room for at first; a trajectory has some twenty
TO_STATE, TO_VELOCITY = 10, 5  # phases of an axis that a motion adds at most: back into the bounds, the way, the rest
ROUNDING = 1e-9  # [SI] of an axis's state: where it is said to be already
# Where a polynomial of fifth degree is sampled: between two of these its acceleration bends by 0.3 % of its largest,
# and right at its ends its jerk is the largest or the smallest
SHOWN = np.array([1e-3, *(np.arange(1, 32) / 32), 1.0 - 1e-3])


class Bounds(NamedTuple):
    """What each of D axes keeps, each of shape (D,)."""

    lowest_velocity: Array
    highest_velocity: Array
    lowest_acceleration: Array
    highest_acceleration: Array
    jerk: Array

    def reaching(self, goal: Array) -> Bounds:
        """Return bounds of velocity just wide enough for a goal's, shape (3, D), and for what its acceleration adds."""
        room = ROOM * np.abs(goal[1]) + goal[2] ** 2 / (2.0 * self.jerk) + SPARE_M_S
        return self._replace(
            lowest_velocity=np.minimum(self.lowest_velocity, -room),
            highest_velocity=np.maximum(self.highest_velocity, room),
        )


Motion = tuple[float, float, float]  # position, velocity and acceleration of an axis


class Phases(NamedTuple):
    """What D axes do one after the other, as compiled code reads it."""

    table: Array  # (D, P, 8) by rows: from when on it counts, its start, six powers of a polynomial from there on
    counts: NDArray[np.int_]  # (D,) of each axis's phases; the row after its last one is how it goes on at the end


class Axes:
    """D axes over time: state-to-state motions one after the other; before and after they go on straight."""

    def __init__(self, start_s: float, start: Array) -> None:
        """Begin at a time [s] with a state, shape (3, D): position, velocity, acceleration."""
        self.start_s = self.end_s = start_s
        self._end = np.array(start, dtype=float, order="C")
        axes = self._end.shape[1]
        self._table, self._counts = np.empty((axes, FIRST_ROOM, 8)), np.zeros(axes, dtype=int)
        self._most = 1  # phases that an axis has at most
        _straight(self._table, self._counts, -np.inf, start_s, self._end)
        _close(self._table, self._counts, start_s, self._end)
        self._shown_s: list[Array] = []  # instants inside of phases whose accelerations bend

    @property
    def end(self) -> Array:
        """The state at ``end_s``, shape (3, D)."""
        return self._end

    @property
    def phases(self) -> Phases:
        """What the axes do, to be read only."""
        return Phases(self._table, self._counts)

    @property
    def seams_s(self) -> Array:
        """Times between which accelerations are straight lines, or hardly bend; unordered, some twice [s]."""
        return np.concatenate((*self._shown_s, _starts(self._table, self._counts)))

    def at(self, time_s: Array) -> Array:
        """Return the states at times, shape (T,) [s]; (T, 3, D)."""
        return _states(self._table, self._counts, np.asarray(time_s, dtype=float))

    def smoothly(self, goal: Array, duration_s: float) -> float:
        """Add the motion to a state, shape (3, D), of the least squared jerk in a time: polynomials of fifth degree.

        Flown again and again from where it has come to, it leads to the goal without ringing, so that it suits goals
        that change a little all the time; it knows no bounds. Returns the norm of the jerk that it starts with.
        """
        self._make_room(1)
        jerk = _smooth(self._table, self._counts, self.end_s, self._end, goal, duration_s)
        self._shown_s.append(self.end_s + duration_s * SHOWN)
        self.end_s += duration_s
        return jerk

    def to(self, goal: Array, bounds: Bounds, least_s: float = 0.0) -> bool:
        """Add the fastest motion to a state, shape (3, D), that takes ``least_s`` or longer; False if there is none.

        An axis that is there already stays there: that it is off by a rounding, and has time, makes ruckig go round.
        """
        there = (np.abs(self._end - goal) < ROUNDING).all(axis=0) & ~goal[1:].any(axis=0)
        self._end = np.where(there, goal, self._end)
        asked = InputParameter(self._end.shape[1])
        asked.current_position, asked.current_velocity, asked.current_acceleration = self._end.tolist()
        asked.target_position, asked.target_velocity, asked.target_acceleration = goal.tolist()
        asked.min_velocity, asked.max_velocity = bounds.lowest_velocity.tolist(), bounds.highest_velocity.tolist()
        asked.min_acceleration = bounds.lowest_acceleration.tolist()
        asked.max_acceleration, asked.max_jerk = bounds.highest_acceleration.tolist(), bounds.jerk.tolist()
        if least_s > 0.0:
            asked.minimum_duration = least_s
        return self._add(asked)

    def to_velocity(self, velocity: Array, bounds: Bounds) -> bool:
        """Add the fastest motion of each axis to a velocity, shape (D,), without acceleration, wherever it ends.

        An axis that is there before the others goes on at its velocity. False if a number is none, or no bound.
        """
        self._make_room(TO_VELOCITY)
        limits = bounds.lowest_acceleration, bounds.highest_acceleration, bounds.jerk
        end_s = _reach_velocity(self._table, self._counts, self.end_s, self._end, velocity, *limits)
        if math.isnan(end_s):
            return False
        self.end_s = end_s
        return True

    def straight_on(self, until_s: float) -> None:
        """Go on at the velocity reached, without acceleration, up to a time [s]."""
        passed_s = until_s - self.end_s
        if passed_s > 0.0:
            self._make_room(1)
            _straight(self._table, self._counts, self.end_s, self.end_s, self._end)
            self._end = np.stack((self._end[0] + passed_s * self._end[1], self._end[1], np.zeros_like(self._end[2])))
            self.end_s = until_s
            _close(self._table, self._counts, self.end_s, self._end)

    def _make_room(self, phases: int) -> None:
        """Make room for so many phases more, and for how it goes on after them."""
        self._most += phases
        if self._most >= self._table.shape[1]:
            self._table = np.concatenate((self._table, np.empty_like(self._table)), axis=1)

    def _add(self, asked: InputParameter) -> bool:
        piece = Trajectory(self._end.shape[1])
        try:
            result = Ruckig(self._end.shape[1]).calculate(asked, piece)
        except RuckigError:  # the state, the goal or a bound contradicts another, or is no number
            return False
        if result is not Result.Working and result is not Result.Finished:
            return False
        self._make_room(TO_STATE)
        for d, profile in enumerate(piece.profiles[0]):
            brake = profile.brake
            parts = (brake, profile) if brake.duration > 0.0 else (profile,)  # back into the bounds first
            rows = [row for part in parts for row in zip(part.t, part.j, part.a, part.v, part.p, strict=False)]
            _profile(self._table, self._counts, d, self.end_s, np.array(rows))
        self.end_s += piece.duration
        self._end = np.array(piece.at_time(piece.duration))
        _close(self._table, self._counts, self.end_s, self._end)
        return True


@kernel
def _put(
    table: Array, counts: NDArray[np.int_], d: int, time: float, powers: tuple[float, float, float, float, float, float]
) -> None:
    """Append a phase of an axis: when it begins, and a polynomial's powers from there on, lowest first."""
    row = table[d, counts[d]]
    row[0], row[1] = time, time
    for power in range(6):
        row[2 + power] = powers[power]
    counts[d] += 1


@kernel
def _straight(table: Array, counts: NDArray[np.int_], since: float, start: float, state: Array) -> None:
    """Append a phase of each axis that counts since a time, and goes straight through a state, (3, D), at another."""
    for d in range(len(counts)):
        _put(table, counts, d, start, (state[0, d], state[1, d], 0.0, 0.0, 0.0, 0.0))
        table[d, counts[d] - 1, 0] = since


@kernel
def _close(table: Array, counts: NDArray[np.int_], end: float, state: Array) -> None:
    """Let each axis go straight on after its last phase, until another one is appended."""
    _straight(table, counts, end, end, state)
    for d in range(len(counts)):
        counts[d] -= 1


@kernel
def _starts(table: Array, counts: NDArray[np.int_]) -> Array:
    """When the phases of all axes start [s]."""
    starts, found = np.empty(counts.sum()), 0
    for d in range(len(counts)):
        for phase in range(counts[d]):
            starts[found] = table[d, phase, 1]
            found += 1
    return starts


@kernel
def _smooth(table: Array, counts: NDArray[np.int_], begin: float, state: Array, goal: Array, duration: float) -> float:
    """Append a polynomial of fifth degree for each axis, and turn the state, (3, D), into the goal.

    Returns the norm of the jerk that they start with.
    """
    t, square = duration, 0.0
    for d in range(len(counts)):
        place, velocity, acceleration = state[0, d], state[1, d], state[2, d]
        gap = goal[0, d] - place - t * (velocity + 0.5 * t * acceleration)
        velocity_gap = t * (goal[1, d] - velocity - t * acceleration)
        acceleration_gap = t * t * (goal[2, d] - acceleration)
        cubic = (10.0 * gap - 4.0 * velocity_gap + 0.5 * acceleration_gap) / t**3
        quartic = (-15.0 * gap + 7.0 * velocity_gap - acceleration_gap) / t**4
        quintic = (6.0 * gap - 3.0 * velocity_gap + 0.5 * acceleration_gap) / t**5
        _put(table, counts, d, begin, (place, velocity, 0.5 * acceleration, cubic, quartic, quintic))
        square += cubic * cubic
        for order in range(3):
            state[order, d] = goal[order, d]
    _close(table, counts, begin + t, state)
    return 6.0 * math.sqrt(square)


@kernel
def _pushed(
    table: Array, counts: NDArray[np.int_], d: int, begin: float, state: Motion, jerk: float, span: float
) -> tuple[float, Motion]:
    """Append a phase of constant jerk, unless it is too short to be one; return when it ends, in which state."""
    place, velocity, acceleration = state
    if span > SHORTEST_S:
        _put(table, counts, d, begin, (place, velocity, acceleration / 2.0, jerk / 6.0, 0.0, 0.0))
        begin += span
    ended = (
        place + span * (velocity + span * (acceleration / 2.0 + span * jerk / 6.0)),
        velocity + span * (acceleration + span * jerk / 2.0),
        acceleration + span * jerk,
    )
    return begin, ended


@kernel
def _profile(table: Array, counts: NDArray[np.int_], d: int, begin: float, rows: Array) -> None:
    """Append an axis's phases of constant jerk, and that it goes on without jerk after them.

    Args:
        table: of all axes.
        counts: of all axes.
        d: the axis.
        begin: of the first phase [s].
        rows: of each phase span, jerk, and acceleration, velocity and position at its start, shape (P, 5).
    """
    state = (0.0, 0.0, 0.0)
    for i in range(len(rows)):
        state = (rows[i, 4], rows[i, 3], rows[i, 2])
        begin, state = _pushed(table, counts, d, begin, state, rows[i, 1], rows[i, 0])
    _put(table, counts, d, begin, (state[0], state[1], state[2] / 2.0, 0.0, 0.0, 0.0))


@kernel
def _reach_velocity(
    table: Array,
    counts: NDArray[np.int_],
    begin: float,
    state: Array,
    goal: Array,
    lowest: Array,
    highest: Array,
    jerk: Array,
) -> float:
    """Append each axis's fastest way to a velocity, and update the state, (3, D); return when the last one is there.

    First back into the bounds of acceleration, if it is outside of them. Then ``a`` rises to a peak, stays there, and
    falls to 0; towards lower velocities all is mirrored. With the change of velocity ``u`` still to come, a peak ``p``
    without a stay changes it by ``(p^2 - a^2 / 2) / j``, so that ``p^2 = j u + a^2 / 2``; where a bound is below
    that, it is the peak, and the stay changes the rest. Not a number if a number is none, or if no bound is one.
    """
    end = begin
    for d in range(len(counts)):
        low, high, j = lowest[d], highest[d], jerk[d]
        if not (low < 0.0 < high and j > 0.0 and math.isfinite(goal[d] + state[0, d] + state[1, d] + state[2, d])):
            return math.nan
    reached = np.empty(len(counts))
    for d in range(len(counts)):
        low, high, j = lowest[d], highest[d], jerk[d]
        first = counts[d]
        now, motion = begin, (state[0, d], state[1, d], state[2, d])
        beyond = motion[2] - min(max(motion[2], low), high)
        now, motion = _pushed(table, counts, d, now, motion, -math.copysign(j, beyond), abs(beyond) / j)
        _, velocity, a = motion
        side = 1.0 if goal[d] - velocity >= a * abs(a) / (2.0 * j) else -1.0
        change, a, most = side * (goal[d] - velocity), side * a, high if side > 0.0 else -low
        peak = min(math.sqrt(max(j * change + 0.5 * a * a, 0.0)), most)
        stay = max(change - (peak * peak - 0.5 * a * a) / j, 0.0) / most
        now, motion = _pushed(table, counts, d, now, motion, side * j, max(peak - a, 0.0) / j)
        now, motion = _pushed(table, counts, d, now, motion, 0.0, stay)
        now, motion = _pushed(table, counts, d, now, motion, -side * j, peak / j)
        if counts[d] > first:
            _put(table, counts, d, now, (motion[0], goal[d], 0.0, 0.0, 0.0, 0.0))
        else:
            # Nothing to do: the axis goes on by the cubic part of its last phase. After one of fifth degree that is a
            # jump, which verification refuses. The replanner lives on that refusal: going on smoothly instead, it
            # takes run-ons that it finds no way out of (a target found again while the swarm sinks at its limit).
            last = table[d, counts[d] - 1]
            t = now - last[1]
            place = last[2] + t * (last[3] + t * (last[4] + t * last[5]))
            speed, half = last[3] + t * (2.0 * last[4] + 3.0 * t * last[5]), last[4] + 3.0 * t * last[5]
            _put(table, counts, d, now, (place, speed, half, 0.0, 0.0, 0.0))
        state[0, d], state[1, d], state[2, d], reached[d] = motion[0], goal[d], 0.0, now
        end = max(end, now)
    for d in range(len(counts)):
        state[0, d] += (end - reached[d]) * state[1, d]
    _close(table, counts, end, state)
    return end


@kernel
def axis_at(table: Array, counts: NDArray[np.int_], d: int, near: int, time: float) -> tuple[int, Motion]:
    """Return an axis's phase at a time, searched for from another one on, and how it moves then."""
    phase = near
    while phase < counts[d] and time >= table[d, phase + 1, 0]:
        phase += 1
    while phase > 0 and time < table[d, phase, 0]:
        phase -= 1
    row = table[d, phase]
    t = time - row[1]
    position, velocity, acceleration = row[7], 0.0, 0.0
    for power in range(6, 1, -1):  # Horner's scheme with two derivatives
        acceleration = acceleration * t + 2.0 * velocity
        velocity = velocity * t + position
        position = position * t + row[power]
    return phase, (position, velocity, acceleration)


@kernel
def _states(table: Array, counts: NDArray[np.int_], times: Array) -> Array:
    """States at times, (T, 3, D)."""
    states = np.empty((len(times), 3, len(counts)))
    for d in range(len(counts)):
        phase = 0
        for i in range(len(times)):
            phase, motion = axis_at(table, counts, d, phase, times[i])
            states[i, 0, d], states[i, 1, d], states[i, 2, d] = motion
    return states
