"""The one source of setpoints: samples the present motion at a fixed rate and sends each vehicle its part.

Ticks have absolute deadlines; a late tick samples the motion at the time it really is, and is never made up for.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import swap_ned_enu
from fg_gcs.flight.fleet import Fleet
from fg_gcs.link.clock import ticks
from fg_gcs.plan.trajectory import Sample
from fg_gcs.plan.verification import CheckedPlan
from fg_gcs.record.write.layouts import NETWORK
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.setpoint import Setpoint, pack_setpoint

REMEMBERED = 100  # rounds of setpoints: a second or two of them, which is longer than anybody asks back


class SwarmSetpoint(NamedTuple):
    """What V vehicles should be doing at one instant; each array of shape (V, 3) but the yaw."""

    position_m: Array  # [m; ENU]
    velocity_m_s: Array  # [m/s; ENU]
    acceleration_m_s2: Array  # [m/s^2; ENU]
    yaw_rad: Array  # (V,) [rad; clockwise from north]


class Motion(Protocol):
    """Something to stream."""

    rows: Sequence[int]  # the fleet's rows that it moves, in the order of its own

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return what is wanted at a reading of the loop's clock [s]."""


class Rest:
    """Stay at fixed places."""

    def __init__(self, rows: Sequence[int], position_enu_m: Array, yaw_rad: Array) -> None:
        """Take places of shape (V, 3) [m; ENU] and headings of shape (V,) [rad]."""
        still = np.zeros_like(position_enu_m)
        self.rows = rows
        self._wanted = SwarmSetpoint(position_enu_m, still, still, yaw_rad)

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return the same at any time."""
        return self._wanted


class Follow:
    """Fly a checked plan from ``start_s`` on, and rest at its end."""

    def __init__(self, rows: Sequence[int], plan: CheckedPlan, start_s: float) -> None:
        """Take the plan and the clock's reading at which it begins [s]."""
        self.rows = rows
        self.plan = plan
        self.start_s = start_s

    @property
    def end_s(self) -> float:
        """The clock's reading at which the plan ends [s]."""
        return self.start_s + self.plan.duration_s

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return the plan's sample."""
        return looking(self.plan, *_row(self.plan.sample(np.array([now_s - self.start_s]))))


class Brake:
    """Come to rest on a plan's own path, so that the separation it verifies still holds.

    The plan's time runs slower and slower until it stands still: with the rate ``r(t)`` falling from 1 to 0 over the
    braking time, speeds are multiplied by ``r`` and accelerations become ``a r^2 + v r'``.
    """

    def __init__(self, motion: Follow, start_s: float) -> None:
        """Begin to brake at a reading of the clock [s]."""
        self.rows = motion.rows
        self._plan = motion.plan
        self._begin_s = start_s - motion.start_s
        self.start_s = start_s
        _, velocity, _ = _row(motion.plan.sample(np.array([self._begin_s])))
        speed = float(np.linalg.norm(velocity, axis=1).max())
        limit = max(motion.plan.peaks.acceleration_m_s2, 0.5)  # a plan that hardly accelerates still has to stop
        self._duration_s = max(0.5, 2.0 * speed / limit)  # v r' then takes half of what the plan accelerates by

    @property
    def end_s(self) -> float:
        """The clock's reading at which everything is at rest [s]."""
        return self.start_s + self._duration_s

    def at(self, now_s: float) -> SwarmSetpoint:
        """Return the slowed sample."""
        passed = min(max(now_s - self.start_s, 0.0), self._duration_s)
        rate = 1.0 - passed / self._duration_s
        plan_s = self._begin_s + passed * (1.0 + rate) / 2.0
        position, velocity, acceleration = _row(self._plan.sample(np.array([plan_s])))
        braking = velocity / -self._duration_s if rate > 0.0 else np.zeros_like(velocity)
        return looking(self._plan, position, velocity * rate, acceleration * rate**2 + braking)


class Streamer:
    """Sends the present motion's setpoints to every vehicle that is not released."""

    def __init__(self, fleet: Fleet, recorder: Recorder, rate_hz: float) -> None:
        """Stream at ``rate_hz`` [Hz] as soon as there is a motion and a vehicle is engaged."""
        self.motion: Motion | None = None
        self.late_ticks = 0
        self._fleet = fleet
        self._recorder = recorder
        self.period_s = 1.0 / rate_hz
        self._engaged = [False] * len(fleet.vehicles)
        self._sent = asyncio.Event()
        self._due_s = -np.inf
        self._rounds_s: deque[float] = deque(maxlen=REMEMBERED)  # when the last ones had left

    @property
    def due_s(self) -> float:
        """The loop's time at which the next setpoints leave; in the past while nothing is streamed [s]."""
        return self._due_s

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
        if self.motion is not None and any(self._engaged):
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
                self._sent.set()  # wakes who waits now
                self._sent.clear()

    def _send(self, motion: Motion, now_s: float) -> None:
        rows = motion.rows
        wanted = motion.at(now_s)
        time_s = self._recorder.since_start_s(now_s)
        positions = self._fleet.ned_from_enu(rows, wanted.position_m).tolist()
        velocities = swap_ned_enu(wanted.velocity_m_s).tolist()
        accelerations = swap_ned_enu(wanted.acceleration_m_s2).tolist()
        headings = wanted.yaw_rad.tolist()
        router, record = self._fleet.router, self._recorder.setpoints.append
        table = np.concatenate((wanted.position_m, wanted.velocity_m_s, wanted.acceleration_m_s2), axis=1).tolist()
        for index, row in enumerate(rows):
            if self._engaged[row]:
                system_id = self._fleet.vehicles[row].system_id
                setpoint = Setpoint(positions[index], velocities[index], accelerations[index], headings[index])
                router.send(system_id, pack_setpoint(setpoint, system_id, router.sender(system_id)))
                record((time_s, NETWORK, system_id, *table[index], headings[index]))
        self._rounds_s.append(asyncio.get_running_loop().time())


def looking(plan: CheckedPlan, position_m: Array, velocity_m_s: Array, acceleration_m_s2: Array) -> SwarmSetpoint:
    """Complete a sample by the headings that look at the plan's target."""
    return SwarmSetpoint(position_m, velocity_m_s, acceleration_m_s2, plan.yaw_rad(position_m))


def _row(sample: Sample) -> tuple[Array, Array, Array]:
    return sample.position_m[0], sample.velocity_m_s[0], sample.acceleration_m_s2[0]
