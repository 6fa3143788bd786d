"""The one source of setpoints: samples the present motion at a fixed rate and sends each vehicle its part.

Ticks have absolute deadlines; a late tick samples the motion at the time it really is, and is never made up for.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import LocalFrames, swap_ned_enu
from fg_gcs.core.mending import BRAKED, CHANGED
from fg_gcs.flight.compensation import Compensation
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.gate import Change, Gate
from fg_gcs.flight.journal import Journal
from fg_gcs.flight.motions import Braking, Motion, SwarmSetpoint
from fg_gcs.flight.yaw_limiter import YawRateLimiter
from fg_gcs.link.clock import ticks
from fg_gcs.link.routes import Routes
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import VehicleAddress
from fg_gcs.wire.setpoint import NUMBERS, SetpointRound

STALL_S = 0.4  # without setpoints: PX4 gives up after 1 s, ArduPilot brakes after 3 s, but both run on from the first
REMEMBERED = 100  # rounds of setpoints: a second or two of them, more than is ever asked for

# The numbers of a setpoint in the mission's frame, ENU, as those of a vehicle's: which of them, and with which sign
_ENU_TO_NED: Final = np.array([1, 0, 2, 4, 3, 5, 7, 6, 8, 9])
_NED_SIGNS: Final = np.array([1.0, 1.0, -1.0] * 3 + [1.0])


class _Own(NamedTuple):
    """The own frames of some vehicles, as setpoints are turned into them."""

    origins_ned_m: Array  # shape (V, 3)
    axes: Array  # local metres northwards and eastwards per metre northwards and eastwards, shape (V, 2, 2)

    @classmethod
    def of(cls, frames: LocalFrames, rows: NDArray[np.int_]) -> _Own:
        """Return those of the vehicles at some rows."""
        return cls(swap_ned_enu(frames.origins_enu_m[rows]), np.ascontiguousarray(frames.inverse[rows][:, ::-1, ::-1]))

    def take_in(self, numbers: Array) -> None:
        """Turn positions, the first three columns of setpoints, into these frames; velocities differ by up to 0.3 %."""
        numbers[:, 0:3] -= self.origins_ned_m
        numbers[:, 0:2] = np.einsum("vij,vj->vi", self.axes, numbers[:, 0:2])


class _Moved(NamedTuple):
    """The vehicles of a motion."""

    given: Sequence[int]  # their rows as the motion has them
    frames: LocalFrames  # of the fleet
    rows: NDArray[np.int_]
    own: _Own


class _Going(NamedTuple):
    """Where a round of setpoints goes."""

    routes: Routes
    setpoints: SetpointRound
    table: NDArray[np.void]  # rows of the record with the vehicles' names in them, filled in anew each round


class Streamer:
    """Sends the present motion's setpoints to every vehicle that is not released.

    Attributes:
        motion: what is streamed; None: nothing.
        late_ticks: rounds that were skipped because the loop was busy.
        after_round: called with the loop's time [s] after each round of setpoints; must not raise.
        stalled: called with how long nothing was sent [s], instead of a round, when this program stood still: what the
            motion says by then may be metres from where the vehicles are, so that it is dropped.
        gated: called with vehicles whose setpoints have not passed the gate for a while; the motion is dropped, and all
            come to rest from what left last.
        gate: what setpoints pass last.
        compensation: what vehicles are told beyond that so that they keep to it; None: nothing.
        period_s: between two rounds [s].
        turned_s: the loop's time of the newest sign of life [s].
    """

    def __init__(self, fleet: Fleet, recorder: Recorder, rate_hz: float, gate: Gate) -> None:
        """Stream at ``rate_hz`` [Hz] through a gate as soon as there is a motion and a vehicle is engaged."""
        self.motion: Motion | None = None
        self.late_ticks = 0
        self.turned_s = -np.inf
        self.after_round: Callable[[float], None] | None = None
        self.stalled: Callable[[float], None] | None = None
        self.gated: Callable[[tuple[VehicleAddress, ...]], None] | None = None
        self.gate = gate
        self.compensation: Compensation | None = None
        self._fleet = fleet
        self._recorder = recorder
        self.period_s = 1.0 / rate_hz
        self._yaw_limiter: YawRateLimiter | None = None  # of the present motion, if it asks for one
        self._engaged = np.zeros(len(fleet.vehicles), dtype=bool)
        self._moved: _Moved | None = None
        self._going: _Going | None = None
        self._chosen: NDArray[np.int_] | None = None  # rows that are sent to, where others of the motion's are not
        self._told: set[tuple[int, str]] = set()  # rows of vehicles and why their setpoints do not pass
        self._sent = asyncio.Event()
        self._due_s = self._stalled_s = -np.inf
        self._rounds_s: deque[float] = deque(maxlen=REMEMBERED)  # when the last ones had left

    @property
    def due_s(self) -> float:
        """The loop's time at which the next setpoints leave; in the past while nothing is streamed [s]."""
        return self._due_s

    @property
    def streams(self) -> bool:
        """Whether setpoints are sent to any vehicle."""
        return self.motion is not None and bool(self._engaged.any())

    def engaged(self, row: int) -> bool:
        """Tell whether this vehicle gets setpoints."""
        return bool(self._engaged[row])

    def engage(self, rows: Iterable[int]) -> None:
        """Send setpoints to these vehicles from the next tick on."""
        self._engaged[list(rows)] = True

    def release(self, rows: Iterable[int]) -> None:
        """Send these vehicles no more setpoints."""
        self._engaged[list(rows)] = False

    def left_after(self, time_s: float) -> float | None:
        """Return when the first round of setpoints after a loop time had left [s]; None if none has yet."""
        return next((round_s for round_s in self._rounds_s if round_s > time_s), None)

    async def quiet_moment(self) -> None:
        """Wait until setpoints have just left: work done now delays none, if it ends before the next tick."""
        if self.streams:
            await self._sent.wait()

    def send_now(self) -> None:
        """Send a round of setpoints between two: for news that would wait too long for the next."""
        if self.motion is not None and self._engaged.any():
            self._send(self.motion, asyncio.get_running_loop().time())

    async def run(self) -> None:
        """Stream for ever: run it as a task."""
        loop = asyncio.get_running_loop()
        start_s, last = loop.time(), -1
        async for k, late_s in ticks(start_s, self.period_s):
            self.turned_s = loop.time()
            if self.motion is not None and self._engaged.any():
                missed = k - last - 1 if last >= 0 else 0
                self.late_ticks += missed
                began, last, now_s = last < 0, k, loop.time()
                stood_s = max(missed * self.period_s, late_s) + self.period_s
                if not began and stood_s > STALL_S and self.stalled is not None:
                    self.stood_still(stood_s)
                    continue
                self._send(self.motion, now_s)
                self._recorder.ticks.append((self._recorder.since_start_s(now_s), late_s))
                self._due_s = start_s + (k + 1) * self.period_s
                self._sent.set()  # wakes whatever waits now
                self._sent.clear()
                if self.after_round is not None:
                    self.after_round(now_s)
            else:
                last = -1

    def conclude(self, journal: Journal) -> None:
        """Say at the end what was learnt of the vehicles."""
        if self.compensation is not None:
            self.compensation.conclude(journal)

    def stood_still(self, seconds: float) -> None:
        """Drop the motion, as this program stood still for so long [s]; told once, whoever notices it first."""
        now_s = asyncio.get_running_loop().time()
        if self.stalled is not None and now_s - self._stalled_s > STALL_S:
            self.motion, self._stalled_s = None, now_s
            self.stalled(seconds)

    def _send(self, motion: Motion, now_s: float) -> None:
        moved = self._moved_by(motion)
        wanted = self._turned(motion, motion.at(now_s), now_s)
        enu = np.empty((len(moved.rows), NUMBERS))
        enu[:, 0:3], enu[:, 3:6] = wanted.position_m, wanted.velocity_m_s
        enu[:, 6:9], enu[:, 9] = wanted.acceleration_m_s2, wanted.yaw_rad
        rows, own = moved.rows, moved.own
        engaged = self._engaged[rows]
        if not engaged.all():
            rows, enu, own = self._only(rows, engaged), enu[engaged], _Own(*(array[engaged] for array in own))
        passed = self.gate.passed(rows, enu, now_s)
        if len(passed.rows) < len(rows):
            own = _Own.of(moved.frames, passed.rows)
        sent = passed.numbers if self.compensation is None else self.compensation.applied(passed.rows, passed.numbers)
        numbers = sent.take(_ENU_TO_NED, axis=1)
        numbers *= _NED_SIGNS
        own.take_in(numbers)
        going = self._going_to(passed.rows)
        self._fleet.router.send_all(going.routes, going.setpoints.pack(numbers))
        self._rounds_s.append(asyncio.get_running_loop().time())
        self._record(going.table, passed.numbers, now_s)
        if passed.changes:
            self._tell(passed.changes, now_s)
            self._brake(motion, now_s)

    def _only(self, rows: NDArray[np.int_], engaged: NDArray[np.bool_]) -> NDArray[np.int_]:
        """Return the engaged ones; the same array as long as they are the same."""
        chosen = rows[engaged]
        if self._chosen is None or not np.array_equal(chosen, self._chosen):
            self._chosen = chosen
        return self._chosen

    def _moved_by(self, motion: Motion) -> _Moved:
        """Return what of a motion's vehicles is the same in every round."""
        known, frames = self._moved, self._fleet.known_frames
        if known is None or motion.rows is not known.given or frames is not known.frames:
            rows = np.asarray(motion.rows)
            known = self._moved = _Moved(motion.rows, frames, rows, _Own.of(frames, rows))
        return known

    def _going_to(self, rows: NDArray[np.int_]) -> _Going:
        """Return the ways to the vehicles at some rows, and what is the same in every round that goes there."""
        fleet = self._fleet
        routes = fleet.router.routes(fleet.addresses_of(rows))
        if self._going is None or routes is not self._going.routes:
            table = self._recorder.setpoints.rows(len(rows))
            table["network"], table["system_id"] = fleet.networks[rows], fleet.system_ids[rows]
            self._going = _Going(routes, SetpointRound(fleet.system_ids[rows], routes.senders), table)
        return self._going

    def _record(self, table: NDArray[np.void], enu: Array, now_s: float) -> None:
        """Write down what left."""
        table["time_s"] = self._recorder.since_start_s(now_s)
        table["position_enu_m"], table["velocity_enu_m_s"] = enu[:, 0:3], enu[:, 3:6]
        table["acceleration_enu_m_s2"], table["yaw_rad"] = enu[:, 6:9], enu[:, 9]
        self._recorder.setpoints.extend(table)

    def _tell(self, changes: Sequence[Change], now_s: float) -> None:
        """Tell of each vehicle's first setpoint that does not pass, once a reason."""
        vehicles = self._fleet.vehicles
        for change in changes:
            new = [reason for reason in change.reasons if (change.row, reason) not in self._told]
            if not new:
                continue
            self._told.update((change.row, reason) for reason in new)
            near = (
                "" if change.other < 0 else f": {change.distance_m:.2f} m from vehicle {vehicles[change.other].address}"
            )
            text = f"setpoint of vehicle {vehicles[change.row].address} {_done(change)} ({', '.join(new)}){near}"
            self._recorder.event(
                now_s,
                "warning",
                text,
                vehicle=vehicles[change.row].address.label,
                reasons=new,
                by_m=change.by_m if np.isfinite(change.by_m) else None,
            )

    def _brake(self, motion: Motion, now_s: float) -> None:
        """Drop a motion that the gate has not let pass for a while: everybody comes to rest from what left last."""
        lasting = self.gate.lasting(now_s)
        if not lasting or self.gated is None:
            return
        rows = [row for row in motion.rows if self._engaged[row]]
        self.motion = Braking(rows, self.gate.last(rows), now_s, self.gate.acceleration_m_s2)
        self.gate.forgive()
        self.gated(tuple(self._fleet.vehicles[row].address for row in lasting))

    def _turned(self, motion: Motion, wanted: SwarmSetpoint, now_s: float) -> SwarmSetpoint:
        """Return what is wanted with the headings that may be sent; each call counts as sent."""
        if motion.turns_from is None:
            self._yaw_limiter = None
            return wanted
        if self._yaw_limiter is None:
            self._yaw_limiter = YawRateLimiter(motion.turns_from)
        return wanted._replace(yaw_rad=self._yaw_limiter.turn(wanted.yaw_rad, now_s))


def _done(change: Change) -> str:
    """Say what became of a setpoint."""
    if change.status == CHANGED:
        return f"changed by {change.by_m:.2f} m"
    return "braked" if change.status == BRAKED else "held back"
