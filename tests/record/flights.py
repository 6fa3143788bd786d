"""Flights with known answers, written down by the recorder itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.record.write.layouts import SETPOINTS, TELEMETRY, TICKS, Columns
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import MAIN, VehicleAddress

Row = Sequence[float | str]

STAGES = {
    "connect": (0.0, 0.5),
    "take-off": (0.5, 2.0),
    "gather": (2.0, 4.0),
    "approach": (4.0, 8.0),
    "hold": (8.0, 10.0),
    "home": (10.0, 14.0),
    "land": (14.0, 16.0),
}
TARGET = (1.0, 2.0, 20.0)
MISSION = """description = "{description}"
[swarm]
vehicles = 5
[formation]
shape = "hemisphere"
leaders = 4
followers = 1
edge_m = 6.0
centre_enu_m = [0.0, 0.0, 12.0]
normal_enu = [1.0, 0.0, 0.0]
[target]
position_enu_m = [1.0, 2.0, 20.0]
[limits]
speed_m_s = 10.0
acceleration_m_s2 = 4.0
separation_m = 1.5
[fence]
low_enu_m = [-50.0, -50.0, 3.0]
high_enu_m = [50.0, 50.0, 40.0]
[stream]
rate_hz = 40.0
"""
SUMMARY: dict[str, object] = {
    "mission": "missions/circle.toml",
    "vehicles": 5,
    "leaders": 4,
    "plan_time_s": 0.0123,
    "timing_time_s": 0.2345,
    "peak_speed_m_s": 9.98,
    "peak_acceleration_m_s2": 3.97,
    "min_separation_m": 2.22,
    "flux_metric": 1.0,
    "completed": True,
    "reason": "",
    "vehicles_landed": 5,
    "flown_flux_metric": 0.987,
    "flown_peak_speed_m_s": 9.87,
    "flown_peak_acceleration_m_s2": 4.11,
    "flown_min_separation_m": 2.15,
    "tracking_rms_m": 0.123,
    "tracking_max_m": 0.456,
    "setpoint_rate_hz": 39.9,
    "setpoint_late_p99_ms": 1.75,
    "late_ticks": 3,
    "lost": [],
    "bad_bytes": 17,
    "unknown_messages": 2,
    "frames_in": 12345,
    "frames_out": 6789,
    "limits": {"speed_m_s": 10.0, "acceleration_m_s2": 4.0, "climb_m_s": None, "descent_m_s": 1.5},
    "separation_m": 1.5,
    "target_enu_m": list(TARGET),
    "leader_ids": [1, 2, 3, 4],
    "stages": {name: list(span) for name, span in STAGES.items()},
}


def main(*system_ids: int) -> tuple[VehicleAddress, ...]:
    """Return the vehicles of the only network."""
    return tuple(VehicleAddress(MAIN, system_id) for system_id in system_ids)


class Circle:
    """Vehicles evenly spread on a circle, in a plane through the target that looks east."""

    def __init__(self, vehicles: int = 5, radius_m: float = 4.0, rate_rad_s: float = 0.8) -> None:
        self.vehicles = vehicles
        self.radius_m = radius_m
        self.rate_rad_s = rate_rad_s

    @property
    def speed_m_s(self) -> float:
        return self.radius_m * self.rate_rad_s

    @property
    def acceleration_m_s2(self) -> float:
        return self.radius_m * self.rate_rad_s**2

    @property
    def separation_m(self) -> float:
        return 2.0 * self.radius_m * float(np.sin(np.pi / self.vehicles))

    def at(self, vehicle: int, time_s: Array) -> tuple[Array, Array]:
        """Position and velocity, each of shape (T, 3)."""
        angle = self.rate_rad_s * time_s + 2.0 * np.pi * vehicle / self.vehicles
        east = np.full_like(time_s, TARGET[0])
        radius, speed = self.radius_m, self.speed_m_s
        position = (east, TARGET[1] + radius * np.cos(angle), TARGET[2] + radius * np.sin(angle))
        velocity = (np.zeros_like(time_s), -speed * np.sin(angle), speed * np.cos(angle))
        return np.stack(position, axis=1), np.stack(velocity, axis=1)

    def telemetry(self, time_s: Array, boot_time_s: Array | None = None) -> list[Row]:
        rows: list[Row] = []
        boot = time_s + 3.0 if boot_time_s is None else boot_time_s
        for vehicle in range(self.vehicles):
            position, velocity = self.at(vehicle, time_s)
            for k, now_s in enumerate(time_s.tolist()):
                place = position[k].tolist()
                row = (now_s, MAIN, vehicle + 1, *place, *velocity[k].tolist(), 0.0, float(boot[k]), place[2])
                rows.append(row)
        return rows

    def setpoints(self, time_s: Array, offset_m: float) -> list[Row]:
        """Setpoints that lie ``offset_m`` east of where the vehicles are."""
        rows: list[Row] = []
        for vehicle in range(self.vehicles):
            position, velocity = self.at(vehicle, time_s)
            for k, now_s in enumerate(time_s.tolist()):
                east, north, up = position[k].tolist()
                place = east + offset_m, north, up
                rows.append((now_s, MAIN, vehicle + 1, *place, *velocity[k].tolist(), 0, 0, 0, 0))
        return rows


def instants(rate_hz: float = 50.0) -> Array:
    return np.arange(0.5, 16.0, 1.0 / rate_hz)


def told(system_id: int, time_s: float, *cells: float) -> Row:
    """A row of the setpoint table; what is not given is 0."""
    return (time_s, MAIN, system_id, *cells, *[0.0] * (10 - len(cells)))


def write_run(
    folder: Path,
    description: str = "Five vehicles on a circle",
    texts: tuple[str, ...] = ("vehicle 2 lost: nothing heard from it",),
    changes: Mapping[str, object] | None = None,
    *,
    flown: bool = True,
) -> Path:
    """Write a whole run's folder; without ``flown`` its tables are empty."""
    folder.mkdir(parents=True)
    toml = MISSION.format(description=description)
    with Recorder(folder, toml, start_s=100.0, epoch_s=1.7e9) as recorder:
        for name, (begin_s, _) in STAGES.items():
            recorder.event(100.0 + begin_s, "stage", name, stage=name)
        for text in texts:
            recorder.event(109.0, "fault", text, fault="lost")
            recorder.event(109.1, "text", text, severity=2)
        recorder.event(109.2, "phase", "vehicle 1: a phase for developers", phase="FLYING")
        if flown:
            circle = Circle()
            for row in circle.telemetry(instants(20.0)):
                recorder.telemetry.append(row)
            for row in circle.setpoints(instants(20.0), 0.25):
                recorder.setpoints.append(row)
            for now_s in instants(40.0).tolist():
                recorder.ticks.append((now_s, 0.001))
        recorder.finish({**SUMMARY, **(changes or {})})
    return folder


def columns_of(circle: Circle, rate_hz: float = 50.0, offset_m: float = 0.25) -> tuple[Columns, Columns, Columns]:
    """Telemetry, setpoints and ticks of a circle."""
    time_s = instants(rate_hz)
    ticks = [(now_s, 0.001 * (k % 10)) for k, now_s in enumerate(time_s.tolist())]
    telemetry, setpoints = circle.telemetry(time_s), circle.setpoints(time_s, offset_m)
    return TELEMETRY.table(telemetry), SETPOINTS.table(setpoints), TICKS.table(ticks)
