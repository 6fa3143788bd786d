"""Where vehicles lag behind what they are told: learnt from each one's own telemetry in flight, and sent ahead of it.

Two things keep a vehicle off its setpoints for which setpoints can make up:

- **Drag.** The acceleration that a plan asks for is the vehicle's; what its thrust has to give is that and what the air
  takes, k v. An autopilot that does not know k learns the difference by its integrator, seconds late, and has to
  unlearn it at every stop and turn. So k v is added to the horizontal acceleration. The lean of a multicopter tells
  k: with u = g tan(lean) in the direction that it leans in, u = dv/dt + k (v - w), so that over half a second
  U - dv = k dx - k w dt, fitted by least squares. A vehicle that accelerates without leaning tells nothing.
- **Lag.** A vehicle that is where it should have been L ago gets position and velocity ahead of the plan by L:
  p + v L + a L^2 / 2 and v + a L. L is what remains of the error along the velocity, -sum(e v) / sum(v v) over some
  seconds, integrated. Over a link that is late by more than its jitter nothing is told apart from that: there what was
  learnt fades, and setpoints are as planned.

What is learnt is bounded, changes slowly, and is kept to itself: plans, the gate and the record have where vehicles are
to be, and only the bytes have what they are told for that.
"""

from __future__ import annotations

import asyncio
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.gate import Gate
from fg_gcs.flight.journal import Journal
from fg_gcs.link.clock import ticks

GRAVITY_M_S2: Final = 9.80665
LEARNS_S: Final = 0.05  # between two looks
SPAN_S: Final = 0.5  # of a sum of the fit: longer than lags of attitude, shorter than what is to be told apart
FRESH_S: Final = 0.1  # samples that are older, or came late, do not tell a lag from what they are late by
FORGETS_S: Final = 40.0  # time constant of the fit of drag: longer than a flight's turns, shorter than its wind
ERRORS_S: Final = 5.0  # time constant of the errors that a lag is read from
SLOWLY_PER_S: Final = 0.25  # share of a lag that is taken up in a second
MOST_DRAG_PER_S: Final = 1.5
MOST_LEAD_S: Final = 0.5
LEANS: Final = 0.3  # squares of what leans say over those of what velocities do
PRIOR_M2: Final = 4.0  # says as much as a way of some metres that drag is as expected
MOVED_M2_S2: Final = 1.0  # squares of velocities' changes in sum from which on a vehicle's lean is told from noise
PRIOR_M2_S: Final = 60.0  # likewise of a lag: four seconds at four metres per second


class Compensation:
    """Learns as long as :meth:`run` runs.

    Args:
        fleet: with its frames.
        gate: knows what vehicles are to do.
        known: drag [1/s] and lag [s] that the last flight of each one's firmware taught, shape (V, 2); None: nothing.

    Attributes:
        drag_per_s: of each vehicle, shape (V,) [1/s].
        lead_s: likewise [s].
        turned_s: the loop's time of the newest sign of life [s].
    """

    def __init__(self, fleet: Fleet, gate: Gate, known: Array | None = None) -> None:
        count = len(fleet.vehicles)
        drag_per_s, lag_s = (np.zeros((count, 2)) if known is None else known).T
        self.turned_s = -np.inf
        self._fleet, self._gate = fleet, gate
        self._may_add_drag = np.array([vehicle.profile.drag_is_compensated for vehicle in fleet.vehicles])
        self._fit = DragFit(np.clip(drag_per_s, 0.0, MOST_DRAG_PER_S))
        self.drag_per_s = np.where(self._may_add_drag, self._fit.drag_per_s, 0.0)
        self.lead_s = np.clip(lag_s, 0.0, MOST_LEAD_S)
        self._behind, self._squares = np.zeros(count), np.zeros(count)

    async def run(self) -> None:
        """Learn, for ever."""
        loop = asyncio.get_running_loop()
        async for _ in ticks(loop.time(), LEARNS_S):
            self.turned_s = loop.time()
            self.learn(self.turned_s)

    def learn(self, now_s: float) -> None:
        """Look once at what vehicles do, at the loop's time [s]; call it every `LEARNS_S`."""
        place, velocity = self._gate.told(now_s)
        located = self._fleet.located(now_s)
        fresh = located.age_s < FRESH_S
        told = np.isfinite(place).all(axis=1) & fresh
        error = np.where(told[:, None], located.position_enu_m - place, 0.0)
        flown = np.where(told[:, None], velocity, 0.0)
        fade = np.exp(-LEARNS_S / ERRORS_S)
        self._behind = fade * self._behind - (error * flown).sum(axis=1) * LEARNS_S
        self._squares = fade * self._squares + (flown * flown).sum(axis=1) * LEARNS_S
        lag_s = self._behind / (self._squares + PRIOR_M2_S)
        step_s = SLOWLY_PER_S * LEARNS_S * np.where(fresh, lag_s, -self.lead_s)
        self.lead_s = np.clip(self.lead_s + step_s, 0.0, MOST_LEAD_S)
        states = self._fleet.states
        self._fit.take(thrust_m_s2(states.yaw_rad, states.lean_rad), located.position_enu_m, located.velocity_enu_m_s)
        self.drag_per_s = np.where(self._may_add_drag, self._fit.drag_per_s, 0.0)

    def conclude(self, journal: Journal) -> None:
        """Say what was learnt: the drag of each vehicle, and the lead of its setpoints."""
        drag, lead = self.drag_per_s, self.lead_s
        journal.recorder.know(learnt_drag_per_s=drag.tolist(), learnt_lead_s=lead.tolist())
        if drag.any() or lead.any():
            spans = f"drag {drag.min():.2f} to {drag.max():.2f} /s, lag {lead.min():.2f} to {lead.max():.2f} s"
            journal.event("learnt", f"setpoints were sent ahead of what vehicles lag: {spans} at the end")

    def applied(self, rows: NDArray[np.int_], numbers: Array) -> Array:
        """Return what to tell vehicles so that they do what they are to.

        Args:
            rows: of the fleet.
            numbers: position, velocity, acceleration and yaw as planned, shape (n, 10) [m, m/s, m/s^2, rad; ENU].
        """
        return ahead(numbers, self.lead_s[rows], self.drag_per_s[rows])


def ahead(numbers: Array, lead_s: Array, drag_per_s: Array) -> Array:
    """Return setpoints ahead of a motion, with what the air takes of their acceleration.

    Args:
        numbers: of the motion, shape (n, 10) as `Compensation.applied` has them.
        lead_s: by how much ahead, shape (n,) [s].
        drag_per_s: horizontal drag by speed, shape (n,) [1/s].
    """
    sent, by_s = numbers.copy(), lead_s[:, None]
    sent[:, 0:3] += by_s * (numbers[:, 3:6] + 0.5 * by_s * numbers[:, 6:9])
    sent[:, 3:6] += by_s * numbers[:, 6:9]
    sent[:, 6:8] += drag_per_s[:, None] * sent[:, 3:5]
    return sent


class DragFit:
    """Least squares of U - dv = k dx + w dt for V vehicles, east and north together; older sums count less.

    Args:
        expected_per_s: k of each vehicle as it is expected, shape (V,) [1/s].

    Attributes:
        drag_per_s: k of each vehicle, shape (V,) [1/s]; as expected until it has moved, and 0 where it then does not
            lean for that.
    """

    def __init__(self, expected_per_s: Array) -> None:
        count = len(expected_per_s)
        self._expected_per_s = expected_per_s
        self._steps = 0
        self._thrust = np.zeros((count, 2))  # times time, since the span began
        self._begin: tuple[Array, Array] | None = None  # position and velocity then
        self._matrix = np.zeros((count, 3, 3))  # normal equations: k and the wind's two
        self._right = np.zeros((count, 3))
        self._leaned, self._changed = np.zeros(count), np.zeros(count)  # squares of U and of dv
        self.drag_per_s = expected_per_s.copy()

    def take(self, thrust_m_s2: Array, position_m: Array, velocity_m_s: Array) -> None:
        """Take a look, `LEARNS_S` after the one before; shapes (V, 2), (V, 3), (V, 3)."""
        if self._begin is None:
            self._begin = position_m[:, :2].copy(), velocity_m_s[:, :2].copy()
            self._thrust[:], self._steps = 0.0, 0
            return
        self._thrust += thrust_m_s2 * LEARNS_S
        self._steps += 1
        if self._steps * LEARNS_S < SPAN_S - 0.5 * LEARNS_S:
            return
        sums = np.stack((position_m[:, :2] - self._begin[0], velocity_m_s[:, :2] - self._begin[1], self._thrust))
        known = np.asarray(np.isfinite(sums).all(axis=2).all(axis=0))
        way, change, thrust = np.where(known[:, None], sums, 0.0)
        fade = np.exp(-SPAN_S / FORGETS_S)
        for kept in (self._matrix, self._right, self._leaned, self._changed):
            kept *= fade
        for axis in (0, 1):
            columns = np.zeros((len(way), 3))
            columns[:, 0], columns[:, 1 + axis] = way[:, axis], SPAN_S
            self._matrix += columns[:, :, None] * columns[:, None, :]
            self._right += columns * (thrust - change)[:, axis, None]
        self._leaned += (thrust**2).sum(axis=1)
        self._changed += (change**2).sum(axis=1)
        self._begin = None
        weighted = self._matrix + np.diag([PRIOR_M2, SPAN_S**2, SPAN_S**2])
        right = self._right.copy()
        right[:, 0] += PRIOR_M2 * self._expected_per_s
        found = np.linalg.solve(weighted, right[:, :, None])[:, 0, 0]
        leans = (self._leaned > LEANS * self._changed) | (self._changed < MOVED_M2_S2)
        self.drag_per_s = np.where(leans, np.clip(found, 0.0, MOST_DRAG_PER_S), 0.0)


def thrust_m_s2(yaw_rad: Array, lean_rad: Array) -> Array:
    """Return the horizontal acceleration that a lean gives while height is kept, shape (V, 2) [m/s^2; east, north].

    The thrust points along -z of the body, R(yaw) R(pitch) R(roll) e_z, and carries the weight.

    Args:
        yaw_rad: shape (V,) [rad; clockwise from north].
        lean_rad: roll and pitch, shape (V, 2) [rad].
    """
    roll, pitch = lean_rad[:, 0], lean_rad[:, 1]
    forward, aside = -np.tan(pitch), np.tan(roll) / np.cos(pitch)
    north = forward * np.cos(yaw_rad) - aside * np.sin(yaw_rad)
    east = forward * np.sin(yaw_rad) + aside * np.cos(yaw_rad)
    return GRAVITY_M_S2 * np.stack((east, north), axis=1)
