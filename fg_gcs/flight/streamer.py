"""The one source of setpoints: samples the present motion at a fixed rate and sends each vehicle its part.

Ticks have absolute deadlines; a late tick samples the motion at the time it really is, and is never made up for.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import swap_ned_enu
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.motions import Motion, SwarmSetpoint
from fg_gcs.flight.yaw_limiter import YawRateLimiter
from fg_gcs.link.clock import ticks
from fg_gcs.link.router import Routes
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import vehicles_named
from fg_gcs.wire.framing import Frames
from fg_gcs.wire.setpoint import LARGEST, NUMBERS, SetpointRound, all_sendable, sendable

REMEMBERED = 100  # rounds of setpoints: a second or two of them, more than is ever asked for


class Streamer:
    """Sends the present motion's setpoints to every vehicle that is not released.

    Attributes:
        motion: what is streamed; None: nothing.
        late_ticks: rounds that were skipped because the loop was busy.
        refused: setpoints that were not sent because of their numbers; those of the other vehicles were.
        after_round: called with the loop's time [s] after each round of setpoints; must not raise.
        period_s: between two rounds [s].
    """

    def __init__(self, fleet: Fleet, recorder: Recorder, rate_hz: float) -> None:
        """Stream at ``rate_hz`` [Hz] as soon as there is a motion and a vehicle is engaged."""
        self.motion: Motion | None = None
        self.late_ticks = 0
        self.refused = 0
        self.after_round: Callable[[float], None] | None = None
        self._fleet = fleet
        self._recorder = recorder
        self.period_s = 1.0 / rate_hz
        self._yaw_limiter: YawRateLimiter | None = None  # of the present motion, if it asks for one
        self._engaged = np.zeros(len(fleet.vehicles), dtype=bool)
        self._rows: tuple[Sequence[int], NDArray[np.int_]] = ((), np.empty(0, dtype=int))  # of the present motion
        self._round: tuple[Routes, SetpointRound] | None = None  # while the ways to the vehicles are the same
        self._told: set[int] = set()  # rows of vehicles whose refused setpoints people know of
        self._sent = asyncio.Event()
        self._due_s = -np.inf
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
            if self.motion is not None and self._engaged.any():
                self.late_ticks += k - last - 1 if last >= 0 else 0
                last = k
                now_s = loop.time()
                self._send(self.motion, now_s)
                self._recorder.ticks.append((self._recorder.since_start_s(now_s), late_s))
                self._due_s = start_s + (k + 1) * self.period_s
                self._sent.set()  # wakes whatever waits now
                self._sent.clear()
                if self.after_round is not None:
                    self.after_round(now_s)

    def _send(self, motion: Motion, now_s: float) -> None:
        fleet, rows = self._fleet, self._rows_of(motion)
        wanted = self._turned(motion, motion.at(now_s), now_s)
        numbers = np.empty((len(rows), NUMBERS))
        enu = np.empty((len(rows), 3, 3))
        enu[:, 0] = fleet.from_origins(rows, wanted.position_m)
        enu[:, 1], enu[:, 2] = wanted.velocity_m_s, wanted.acceleration_m_s2
        numbers[:, 0:9] = swap_ned_enu(enu).reshape(-1, 9)
        numbers[:, 9] = wanted.yaw_rad
        engaged = self._engaged[rows]
        if not (engaged.all() and all_sendable(numbers)):
            safe = sendable(numbers)
            if (engaged & ~safe).any():
                self._refuse(rows[engaged & ~safe].tolist(), now_s)
            chosen = np.flatnonzero(engaged & safe)
            rows, numbers, wanted = rows[chosen], numbers[chosen], wanted.of(chosen)
        fleet.router.send_all(*self._packed(rows, numbers))
        self._rounds_s.append(asyncio.get_running_loop().time())
        self._record(rows, wanted, now_s)

    def _rows_of(self, motion: Motion) -> NDArray[np.int_]:
        """Return the fleet's rows that a motion moves, as an array that is made once."""
        if motion.rows is not self._rows[0]:
            self._rows = motion.rows, np.asarray(motion.rows)
        return self._rows[1]

    def _packed(self, rows: NDArray[np.int_], numbers: Array) -> tuple[Routes, Frames]:
        """Return the ways to the vehicles at some rows, and their frames."""
        routes = self._fleet.router.routes(self._fleet.addresses_of(rows))
        if self._round is None or routes is not self._round[0]:
            self._round = routes, SetpointRound(self._fleet.system_ids[rows], routes.senders)
        return routes, self._round[1].pack(numbers)

    def _record(self, sent: NDArray[np.int_], wanted: SwarmSetpoint, now_s: float) -> None:
        """Write down what left at the vehicles of some rows."""
        recorder = self._recorder
        table = recorder.setpoints.rows(len(sent))
        table["time_s"] = recorder.since_start_s(now_s)
        table["network"] = self._fleet.networks[sent]
        table["system_id"] = self._fleet.system_ids[sent]
        table["position_enu_m"], table["velocity_enu_m_s"] = wanted.position_m, wanted.velocity_m_s
        table["acceleration_enu_m_s2"], table["yaw_rad"] = wanted.acceleration_m_s2, wanted.yaw_rad
        recorder.setpoints.extend(table)

    def _refuse(self, rows: Sequence[int], now_s: float) -> None:
        """Count setpoints that must not leave, and tell of each vehicle's first."""
        self.refused += len(rows)
        new = [row for row in rows if row not in self._told]
        if new:
            self._told.update(new)
            subject = vehicles_named(self._fleet.vehicles[row].address for row in new)
            text = f"setpoints of {subject} are not finite or beyond {LARGEST:g} and are not sent; the others are"
            self._recorder.event(now_s, "warning", text)

    def _turned(self, motion: Motion, wanted: SwarmSetpoint, now_s: float) -> SwarmSetpoint:
        """Return what is wanted with the headings that may be sent; each call counts as sent."""
        if motion.turns_from is None:
            self._yaw_limiter = None
            return wanted
        if self._yaw_limiter is None:
            self._yaw_limiter = YawRateLimiter(motion.turns_from)
        return wanted._replace(yaw_rad=self._yaw_limiter.turn(wanted.yaw_rad, now_s))
