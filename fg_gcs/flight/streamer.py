"""The one source of setpoints: samples the present motion at a fixed rate and sends each vehicle its part.

Ticks have absolute deadlines; a late tick samples the motion at the time it really is, and is never made up for.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable

import numpy as np

from fg_gcs.core.frames import swap_ned_enu
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.motions import Motion, SwarmSetpoint
from fg_gcs.flight.yaw_limiter import YawRateLimiter
from fg_gcs.link.clock import ticks
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.setpoint import Setpoint, pack_setpoint

REMEMBERED = 100  # rounds of setpoints: a second or two of them, more than is ever asked for


class Streamer:
    """Sends the present motion's setpoints to every vehicle that is not released.

    Attributes:
        motion: what is streamed; None: nothing.
        late_ticks: rounds that were skipped because the loop was busy.
        after_round: called with the loop's time [s] after each round of setpoints; must not raise.
        period_s: between two rounds [s].
    """

    def __init__(self, fleet: Fleet, recorder: Recorder, rate_hz: float) -> None:
        """Stream at ``rate_hz`` [Hz] as soon as there is a motion and a vehicle is engaged."""
        self.motion: Motion | None = None
        self.late_ticks = 0
        self.after_round: Callable[[float], None] | None = None
        self._fleet = fleet
        self._recorder = recorder
        self.period_s = 1.0 / rate_hz
        self._yaw_limiter: YawRateLimiter | None = None  # of the present motion, if it asks for one
        self._engaged = [False] * len(fleet.vehicles)
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
        return self.motion is not None and any(self._engaged)

    def engaged(self, row: int) -> bool:
        """Tell whether this vehicle gets setpoints."""
        return self._engaged[row]

    def engage(self, rows: Iterable[int]) -> None:
        """Send setpoints to these vehicles from the next tick on."""
        for row in rows:
            self._engaged[row] = True

    def release(self, rows: Iterable[int]) -> None:
        """Send these vehicles no more setpoints."""
        for row in rows:
            self._engaged[row] = False

    def left_after(self, time_s: float) -> float | None:
        """Return when the first round of setpoints after a loop time had left [s]; None if none has yet."""
        return next((round_s for round_s in self._rounds_s if round_s > time_s), None)

    async def quiet_moment(self) -> None:
        """Wait until setpoints have just left: work done now delays none, if it ends before the next tick."""
        if self.streams:
            await self._sent.wait()

    def send_now(self) -> None:
        """Send a round of setpoints between two: for news that would wait too long for the next."""
        if self.motion is not None and any(self._engaged):
            self._send(self.motion, asyncio.get_running_loop().time())

    async def run(self) -> None:
        """Stream for ever: run it as a task."""
        loop = asyncio.get_running_loop()
        start_s, last = loop.time(), -1
        async for k, late_s in ticks(start_s, self.period_s):
            if self.motion is not None and any(self._engaged):
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
        rows = motion.rows
        wanted = self._turned(motion, motion.at(now_s), now_s)
        time_s = self._recorder.since_start_s(now_s)
        positions = self._fleet.ned_from_enu(rows, wanted.position_m).tolist()
        velocities = swap_ned_enu(wanted.velocity_m_s).tolist()
        accelerations = swap_ned_enu(wanted.acceleration_m_s2).tolist()
        headings = wanted.yaw_rad.tolist()
        router, record = self._fleet.router, self._recorder.setpoints.append
        table = np.concatenate((wanted.position_m, wanted.velocity_m_s, wanted.acceleration_m_s2), axis=1).tolist()
        for index, row in enumerate(rows):
            if self._engaged[row]:
                address = self._fleet.vehicles[row].address
                setpoint = Setpoint(positions[index], velocities[index], accelerations[index], headings[index])
                router.send(address, pack_setpoint(setpoint, address.system_id, router.sender(address)))
                record((time_s, *address, *table[index], headings[index]))
        self._rounds_s.append(asyncio.get_running_loop().time())

    def _turned(self, motion: Motion, wanted: SwarmSetpoint, now_s: float) -> SwarmSetpoint:
        """Return what is wanted with the headings that may be sent; each call counts as sent."""
        if motion.turns_from is None:
            self._yaw_limiter = None
            return wanted
        if self._yaw_limiter is None:
            self._yaw_limiter = YawRateLimiter(motion.turns_from)
        return wanted._replace(yaw_rad=self._yaw_limiter.turn(wanted.yaw_rad, now_s))
