"""Faults inside vehicles while time goes on: each begins at its time or stage, acts, and ends."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from sitl_mock.autopilot.autopilot import Autopilot, Refusal
from sitl_mock.faults.schema import FLIGHT_STAGES, RESULTS, FaultOptions, Window
from sitl_mock.physics.arrays import Array
from sitl_mock.physics.swarm import Disturbances

ORIGIN_TOLD_S = 1.0  # how often a moving origin is told


class Subject(NamedTuple):
    """A vehicle that a fault is in."""

    row: int  # of the fleet's arrays
    autopilot: Autopilot
    disturbances: Disturbances


class Effect:
    """What one fault does to one vehicle.

    Args:
        values: of the fault's keys.
        subject: the vehicle.
    """

    shared = False  # while another one of its kind goes on in the same vehicle, it does not end

    def __init__(self, values: Mapping[str, Any], subject: Subject) -> None:
        self.values = values
        self.vehicle = subject.autopilot
        self.disturbances = subject.disturbances
        self.row = subject.row

    def begin(self, now_s: float) -> None:
        """Begin, at a simulated time."""

    def go_on(self, passed_s: float) -> None:
        """Act, some time after the beginning: 50 times a second, before anybody else does; sums are cleared before."""

    def end(self, now_s: float) -> None:
        """End, at a simulated time; of several that are alike, each ends by itself, unless they are `shared`."""


class _PositionNoise(Effect):
    def go_on(self, passed_s: float) -> None:
        noise_m = self.disturbances.estimate_noise_m
        noise_m[self.row] = math.hypot(noise_m[self.row], self.values["sigma_m"])


class _PositionOff(Effect):
    """An estimate that is off by a vector times a share that depends on time."""

    key = "offset_enu_m"

    def share(self, passed_s: float) -> float:
        return 1.0

    def go_on(self, passed_s: float) -> None:
        self.disturbances.estimate_offset_m[self.row] += _ned(self.values[self.key]) * self.share(passed_s)


class _PositionJump(_PositionOff):
    pass


class _PositionBias(_PositionOff):
    def share(self, passed_s: float) -> float:
        over_s = self.values["over_s"]
        return 1.0 if over_s <= 0.0 else min(passed_s / over_s, 1.0)


class _PositionDrift(_PositionOff):
    key = "rate_enu_m_s"

    def share(self, passed_s: float) -> float:
        return passed_s


class _GpsLoss(Effect):
    shared = True

    def begin(self, now_s: float) -> None:
        if self.vehicle.gps_lost_at_s is None:
            self.vehicle.gps_lost_at_s = now_s

    def go_on(self, passed_s: float) -> None:
        self.disturbances.gps_lost[self.row] = True

    def end(self, now_s: float) -> None:
        self.vehicle.gps_lost_at_s = None


class _EstimatorStuck(Effect):
    def go_on(self, passed_s: float) -> None:
        self.disturbances.estimate_frozen[self.row] = True


class _Origin(Effect):
    def begin(self, now_s: float) -> None:
        self._moved_s = 0.0
        self._told_s = 0.0
        self._move(_ned(self.values["offset_enu_m"]))
        self._tell()

    def go_on(self, passed_s: float) -> None:
        self._move(_ned(self.values["rate_enu_m_s"]) * (passed_s - self._moved_s))
        self._moved_s = passed_s
        if any(self.values["rate_enu_m_s"]) and passed_s - self._told_s >= ORIGIN_TOLD_S:
            self._told_s = passed_s
            self._tell()

    def _move(self, by_m: Array) -> None:
        self.vehicle.table.origin_ned_m[self.row] += by_m
        if not self.values["told"]:
            self.vehicle.table.told_origin_error_m[self.row] -= by_m

    def _tell(self) -> None:
        if self.values["told"]:
            self.vehicle.send("GPS_GLOBAL_ORIGIN")


class _OriginWrong(Effect):
    def begin(self, now_s: float) -> None:
        self.vehicle.table.told_origin_error_m[self.row] += _ned(self.values["offset_enu_m"])

    def end(self, now_s: float) -> None:
        self.vehicle.table.told_origin_error_m[self.row] -= _ned(self.values["offset_enu_m"])


class _Wind(Effect):
    def go_on(self, passed_s: float) -> None:
        towards_rad = math.radians(self.values["from_deg"] + 180.0)
        speed_m_s = self.values["speed_m_s"]
        blowing = speed_m_s * np.array([math.cos(towards_rad), math.sin(towards_rad), 0.0])
        self.disturbances.wind_m_s[self.row] += blowing
        gust_m_s = self.disturbances.gust_m_s
        gust_m_s[self.row] = math.hypot(gust_m_s[self.row], self.values["gusts_m_s"])


class _MotorWeak(Effect):
    def go_on(self, passed_s: float) -> None:
        share = self.disturbances.thrust_share
        share[self.row] = min(share[self.row], self.values["thrust"])


class _MotorDead(Effect):
    def go_on(self, passed_s: float) -> None:
        self.disturbances.thrust_share[self.row] = 0.0


class _BatteryLow(Effect):
    def begin(self, now_s: float) -> None:
        self.vehicle.battery.fall_to(self.values["remaining"])


class _BatteryEmpty(Effect):
    def begin(self, now_s: float) -> None:
        self.vehicle.battery.fall_to(0.0)

    def go_on(self, passed_s: float) -> None:
        if passed_s >= self.values["lasts_s"] and not self.vehicle.dead:
            self.vehicle.die()


class _HeartbeatFrozen(Effect):
    shared = True

    def begin(self, now_s: float) -> None:
        self.vehicle.heartbeat_frozen = True

    def end(self, now_s: float) -> None:
        self.vehicle.heartbeat_frozen = False


class _CommandsRefused(Effect):
    def begin(self, now_s: float) -> None:
        result = RESULTS[self.values["result"]]
        self._refusal = Refusal(self.values["command"], result, self.values["text"])
        self.vehicle.refusals.append(self._refusal)

    def end(self, now_s: float) -> None:
        self.vehicle.refusals.remove(self._refusal)


class _Reboot(Effect):
    def begin(self, now_s: float) -> None:
        self.vehicle.reboot()


class _ClockJump(Effect):
    def begin(self, now_s: float) -> None:
        self.vehicle.table.change_clock(self.row, now_s, self.values["by_s"], 0.0)


class _ClockDrift(Effect):
    def begin(self, now_s: float) -> None:
        self.vehicle.table.change_clock(self.row, now_s, 0.0, self.values["rate"])

    def end(self, now_s: float) -> None:
        self.vehicle.table.change_clock(self.row, now_s, 0.0, -self.values["rate"])


class _Dead(Effect):
    def begin(self, now_s: float) -> None:
        self.vehicle.die()


class _TakenOver(Effect):
    def begin(self, now_s: float) -> None:
        self.vehicle.failsafe = None
        self.vehicle.change(self.vehicle.modes[self.values["mode"]], keep_intention=False)


EFFECTS: Mapping[str, Callable[[Mapping[str, Any], Subject], Effect]] = MappingProxyType(
    {
        "position_noise": _PositionNoise,
        "position_bias": _PositionBias,
        "position_drift": _PositionDrift,
        "position_jump": _PositionJump,
        "gps_loss": _GpsLoss,
        "estimator_stuck": _EstimatorStuck,
        "origin": _Origin,
        "origin_wrong": _OriginWrong,
        "wind": _Wind,
        "motor_weak": _MotorWeak,
        "motor_dead": _MotorDead,
        "battery_low": _BatteryLow,
        "battery_empty": _BatteryEmpty,
        "heartbeat_frozen": _HeartbeatFrozen,
        "commands_refused": _CommandsRefused,
        "reboot": _Reboot,
        "clock_jump": _ClockJump,
        "clock_drift": _ClockDrift,
        "dead": _Dead,
        "taken_over": _TakenOver,
    }
)


class Stages:
    """When the stages began that faults and impairments wait for.

    Args:
        vehicles: whose own stages are seen by `look`.
    """

    def __init__(self, vehicles: Sequence[Autopilot]) -> None:
        self._vehicles = tuple(vehicles)
        self._flight: dict[str, float] = {}
        self._own: dict[tuple[str, int], float] = {}

    def begin(self, stage: str, now_s: float) -> None:
        """A stage of the flight begins, as the ground station says; the first time counts.

        Raises:
            ValueError: there is no such stage.
        """
        if stage not in FLIGHT_STAGES:
            raise ValueError(f"stage {stage!r}; accepted: {', '.join(FLIGHT_STAGES)}")
        self._flight.setdefault(stage, now_s)

    def look(self, now_s: float) -> None:
        """See which stages the vehicles have begun by themselves."""
        for row, vehicle in enumerate(self._vehicles):
            if vehicle.armed:
                self._own.setdefault(("armed", row), now_s)
            if vehicle.airborne:
                self._own.setdefault(("airborne", row), now_s)
            elif vehicle.landed_at_s is not None:
                self._own.setdefault(("landed", row), now_s)

    def start_s(self, window: Window, row: int) -> float:
        """When a window opens for a vehicle [s of simulated time]; infinity while that is not known."""
        if not window.stage:
            return window.at_s
        if window.stage in FLIGHT_STAGES:
            return self._flight.get(window.stage, math.inf) + window.at_s
        return self._own.get((window.stage, row), math.inf) + window.at_s


class _Running(NamedTuple):
    """A fault that has begun, or will."""

    options: FaultOptions
    effect: Effect


class FaultSchedule:
    """All faults of a fleet.

    Args:
        faults: which.
        subjects: the vehicles, in the order of their rows.
        stages: when stages began.
    """

    def __init__(self, faults: Sequence[FaultOptions], subjects: Sequence[Subject], stages: Stages) -> None:
        self._stages = stages
        self._waiting: list[_Running] = []
        self._active: list[tuple[_Running, float]] = []  # and since when
        for options in faults:
            for subject in subjects:
                if options.window.vehicles and subject.autopilot.system_id not in options.window.vehicles:
                    continue
                effect = EFFECTS[options.kind](options.values, subject)
                self._waiting.append(_Running(options, effect))
        self._disturbances = subjects[0].disturbances if subjects else None
        self._cleared = True

    def advance(self, now_s: float) -> set[int]:
        """Begin, act and end what is due.

        Returns:
            Rows of the vehicles that something is wrong with, or was until now.
        """
        if not (self._waiting or self._active):
            return set()
        touched = set()
        self._stages.look(now_s)
        if self._disturbances is not None and not self._cleared:
            self._disturbances.clear()
            self._cleared = True
        still_waiting = []
        for running in self._waiting:
            start_s = self._stages.start_s(running.options.window, running.effect.row)
            if now_s < start_s:
                still_waiting.append(running)
                continue
            running.effect.vehicle.enter(now_s)
            running.effect.begin(now_s)
            touched.add(running.effect.row)
            self._active.append((running, now_s))
        self._waiting = still_waiting
        still_active = []
        for running, since_s in self._active:
            if now_s - since_s >= running.options.window.for_s:
                running.effect.vehicle.enter(now_s)
                if not (running.effect.shared and self._goes_on(running, now_s)):
                    running.effect.end(now_s)
                touched.add(running.effect.row)
                continue
            touched.add(running.effect.row)
            running.effect.go_on(now_s - since_s)
            self._cleared = False
            still_active.append((running, since_s))
        self._active = still_active
        return touched

    def _goes_on(self, ended: _Running, now_s: float) -> bool:
        """Whether another fault of the same kind goes on in the same vehicle."""
        return any(
            type(other.effect) is type(ended.effect)
            and other.effect.row == ended.effect.row
            and now_s - since_s < other.options.window.for_s
            for other, since_s in self._active
            if other is not ended
        )


def _ned(vector_enu: tuple[float, float, float]) -> Array:
    east, north, up = vector_enu
    return np.array([north, east, -up])
