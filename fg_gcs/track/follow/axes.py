"""State-to-state motion with bounded velocity, acceleration and jerk, by ruckig [Berscheid2021]_.

Position, velocity and acceleration are continuous; every joint keeps its own bounds. Only the state-to-state function
is used: intermediate waypoints of the community edition are worked out by a service in the network, and a ground
station must not depend on one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from ruckig import ControlInterface, InputParameter, Result, Ruckig, RuckigError, Synchronization, Trajectory

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array

ROOM, SPARE_M_S = 1.01, 0.01  # a goal right on a bound has no way to it
SHORTEST_S = 1e-9  # phases shorter than this are none
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


class Axes:
    """D axes over time: state-to-state motions one after the other; before and after they go on straight."""

    def __init__(self, start_s: float, start: Array) -> None:
        """Begin at a time [s] with a state, shape (3, D): position, velocity, acceleration."""
        self.start_s = self.end_s = start_s
        self._end = np.array(start, dtype=float)
        # Each joint's phases: from when on it counts, its start, and a polynomial's powers from there, lowest first
        self._phases = [[(-np.inf, start_s, *_straight(*state))] for state in self._end.T.tolist()]
        self._table: Array | None = None
        self._shown_s: list[float] = []

    @property
    def end(self) -> Array:
        """The state at ``end_s``, shape (3, D)."""
        return self._end

    @property
    def seams_s(self) -> Array:
        """Times between which accelerations are straight lines, or hardly bend [s]."""
        return np.unique([*self._shown_s, *[phase[1] for phases in self._phases for phase in phases]])

    def at(self, time_s: Array) -> Array:
        """Return the states at times, shape (T,) [s]; (T, 3, D)."""
        if self._table is None:
            most = max(map(len, self._phases)) + 1
            rest = [(self.end_s, self.end_s, *_straight(*state)) for state in self._end.T.tolist()]
            rows = [[*phases, *[last] * (most - len(phases))] for phases, last in zip(self._phases, rest, strict=True)]
            self._table = np.array(rows)
        return _states(self._table, np.asarray(time_s, dtype=float))

    def smoothly(self, goal: Array, duration_s: float) -> float:
        """Add the motion to a state, shape (3, D), of the least squared jerk in a time: polynomials of fifth degree.

        Flown again and again from where it has come to, it leads to the goal without ringing, so that it suits goals
        that change a little all the time; it knows no bounds. Returns the norm of the jerk that it starts with.
        """
        t = duration_s
        start, end = self._end, goal
        gap = end[0] - start[0] - t * (start[1] + 0.5 * t * start[2])
        velocity_gap = t * (end[1] - start[1] - t * start[2])
        acceleration_gap = t * t * (end[2] - start[2])
        cubic = (10.0 * gap - 4.0 * velocity_gap + 0.5 * acceleration_gap) / t**3
        quartic = (-15.0 * gap + 7.0 * velocity_gap - acceleration_gap) / t**4
        quintic = (6.0 * gap - 3.0 * velocity_gap + 0.5 * acceleration_gap) / t**5
        powers = np.stack((start[0], start[1], 0.5 * start[2], cubic, quartic, quintic), axis=1)
        for phases, row in zip(self._phases, powers.tolist(), strict=True):
            phases.append((self.end_s, self.end_s, *row))
        self._shown_s += (self.end_s + t * SHOWN).tolist()
        self._end = np.array(goal, dtype=float)
        self.end_s, self._table = self.end_s + t, None
        return 6.0 * float(np.linalg.norm(cubic))

    def to(self, goal: Array, bounds: Bounds, least_s: float = 0.0) -> bool:
        """Add the fastest motion to a state, shape (3, D), that takes ``least_s`` or longer; False if there is none.

        An axis that is there already stays there: that it is off by a rounding, and has time, makes ruckig go round.
        """
        there = (np.abs(self._end - goal) < ROUNDING).all(axis=0) & ~goal[1:].any(axis=0)
        self._end = np.where(there, goal, self._end)
        asked = self._input(bounds)
        asked.target_position, asked.target_velocity, asked.target_acceleration = goal.tolist()
        if least_s > 0.0:
            asked.minimum_duration = least_s
        return self._add(asked)

    def to_velocity(self, velocity: Array, bounds: Bounds) -> bool:
        """Add the fastest motion to a velocity, shape (D,), without acceleration, wherever it ends."""
        asked = self._input(bounds)
        asked.control_interface = ControlInterface.Velocity
        asked.synchronization = Synchronization.No  # who needs no time to brake shall not stretch it
        asked.target_velocity = velocity.tolist()
        return self._add(asked)

    def straight_on(self, until_s: float) -> None:
        """Go on at the velocity reached, without acceleration, up to a time [s]."""
        passed_s = until_s - self.end_s
        if passed_s > 0.0:
            for phases, state in zip(self._phases, self._end.T.tolist(), strict=True):
                phases.append((self.end_s, self.end_s, *_straight(*state)))
            self._end = np.stack((self._end[0] + passed_s * self._end[1], self._end[1], np.zeros_like(self._end[2])))
            self.end_s, self._table = until_s, None

    def _input(self, bounds: Bounds) -> InputParameter:
        asked = InputParameter(self._end.shape[1])
        asked.current_position, asked.current_velocity, asked.current_acceleration = self._end.tolist()
        asked.min_velocity, asked.max_velocity = bounds.lowest_velocity.tolist(), bounds.highest_velocity.tolist()
        asked.min_acceleration = bounds.lowest_acceleration.tolist()
        asked.max_acceleration, asked.max_jerk = bounds.highest_acceleration.tolist(), bounds.jerk.tolist()
        return asked

    def _add(self, asked: InputParameter) -> bool:
        piece = Trajectory(self._end.shape[1])
        try:
            result = Ruckig(self._end.shape[1]).calculate(asked, piece)
        except RuckigError:  # the state, the goal or a bound contradicts another, or is no number
            return False
        if result is not Result.Working and result is not Result.Finished:
            return False
        for phases, profile in zip(self._phases, piece.profiles[0], strict=True):
            begin_s, brake = self.end_s, profile.brake
            for part in (brake, profile):  # brake: back into the bounds first, where the state was outside of them
                for span_s, jerk, acceleration, velocity, position in zip(
                    part.t, part.j, part.a, part.v, part.p, strict=False
                ):
                    if span_s > SHORTEST_S:
                        phases.append((begin_s, begin_s, position, velocity, acceleration / 2.0, jerk / 6.0, 0.0, 0.0))
                        begin_s += span_s
            phases.append(_after(phases[-1], begin_s))
        self.end_s += piece.duration
        self._end = np.array(piece.at_time(piece.duration))
        self._table = None
        return True


def _straight(position: float, velocity: float, _acceleration: float) -> tuple[float, ...]:
    return (position, velocity, 0.0, 0.0, 0.0, 0.0)


def _after(phase: tuple[float, ...], time_s: float) -> tuple[float, ...]:
    """The phase without jerk that one of constant jerk leads to at a time."""
    _, start_s, position, velocity, half, sixth, _, _ = phase
    t = time_s - start_s
    there = position + t * (velocity + t * (half + t * sixth))
    return (time_s, time_s, there, velocity + t * (2.0 * half + 3.0 * t * sixth), half + 3.0 * t * sixth, 0.0, 0.0, 0.0)


@kernel
def _states(table: Array, times: Array) -> Array:
    """States, (T, 3, D), by phases, (D, P, 8): valid from, start, and six powers, lowest first."""
    axes, phases = table.shape[0], table.shape[1]
    states = np.empty((len(times), 3, axes))
    for d in range(axes):
        phase = 0
        for i in range(len(times)):
            while phase < phases - 1 and times[i] >= table[d, phase + 1, 0]:
                phase += 1
            while phase > 0 and times[i] < table[d, phase, 0]:
                phase -= 1
            t = times[i] - table[d, phase, 1]
            position, velocity, acceleration = 0.0, 0.0, 0.0
            for power in range(5, -1, -1):  # Horner's scheme with two derivatives
                acceleration = acceleration * t + 2.0 * velocity
                velocity = velocity * t + position
                position = position * t + table[d, phase, 2 + power]
            states[i, 0, d], states[i, 1, d], states[i, 2, d] = position, velocity, acceleration
    return states
