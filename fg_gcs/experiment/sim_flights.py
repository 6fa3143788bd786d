"""Whole flights with the simulator, and what they take: one in virtual time, and a large swarm in real time."""

from __future__ import annotations

import math
import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

from fg_gcs.errors import FgError
from fg_gcs.mission.formats.toml import parse_mission
from fg_gcs.mission.model import Mission
from fg_gcs.run.flying import FlyOptions, RunResult, fly_blocking
from fg_gcs.run.reporting import report

IMPORTS: Final = "import fg_gcs.run.flying, fg_gcs.flight.target_follower, sitl_mock.host.server"
EDGE_M: Final = 2.5  # of the face of a large swarm
LEAST_RADIUS_M: Final = 4.0
POLE_M: Final = 8.0  # height of the lowest vehicle; plans keep the outline of a swarm, which is wider, above 3 m


class VirtualFlight(NamedTuple):
    """A flight in virtual time, station and simulator in one process."""

    vehicles: int
    flight_s: float  # of virtual time
    cpu_s: float  # of all threads, without what follows
    imports_s: float  # of a process that loads all that both need, Python's own start included
    report_s: float

    @property
    def times_real(self) -> float:
        """Return how many times as fast as real time it is on one core."""
        return self.flight_s / self.cpu_s


class RealFlight(NamedTuple):
    """A flight of a large swarm in real time, station and simulator as two processes on the same machine."""

    vehicles: int
    rate_hz: float
    flight_s: float
    completed: bool
    reason: str  # why it was not
    error_rms_m: float | None
    error_worst_m: float | None
    setpoint_hz: float | None  # that each vehicle got
    late_p99_ms: float | None
    left_out: int  # rounds of setpoints
    station_core: float  # share of a core, planning and evaluation included
    simulator_core: float


def virtual_flight(text: str) -> VirtualFlight:
    """Fly a mission twice and measure the second time, when everything is loaded.

    Args:
        text: of the mission file.

    Raises:
        FgError: the mission is wrong, or was not completed.
    """
    before_s = _children_s()
    subprocess.run([sys.executable, "-c", IMPORTS], check=True)
    imports_s = _children_s() - before_s
    mission = parse_mission(text)
    with TemporaryDirectory(prefix="fg-gcs-bench-") as place:
        _completed(_fly(mission, Path(place), math.inf))
        began_s = time.process_time()
        result = _completed(_fly(mission, Path(place), math.inf))
        flown_s = time.process_time()
        report(result.folder)
        report_s = time.process_time() - flown_s
    return VirtualFlight(mission.swarm.vehicles, _duration_s(result), flown_s - began_s, imports_s, report_s)


def real_flight(vehicles: int, speed: float = 1.0) -> RealFlight:
    """Fly a large swarm in real time.

    Args:
        vehicles: how many, see :func:`swarm_mission`.
        speed: of time; shares of a core are of the seconds that it gives.

    Raises:
        FgError: there is no such mission.
    """
    mission = parse_mission(swarm_mission(vehicles))
    with TemporaryDirectory(prefix="fg-gcs-bench-") as place:
        station_s, simulator_s = time.process_time(), _children_s()
        result = _fly(mission, Path(place), speed)
        station_s, simulator_s = time.process_time() - station_s, _children_s() - simulator_s
    told, flight_s = result.summary, _duration_s(result)
    return RealFlight(
        vehicles=vehicles,
        rate_hz=mission.stream.rate_hz,
        flight_s=flight_s,
        completed=result.completed,
        reason=result.reason,
        error_rms_m=_number(told["tracking_rms_m"]),
        error_worst_m=_number(told["tracking_max_m"]),
        setpoint_hz=_number(told["setpoint_rate_hz"]),
        late_p99_ms=_number(told["setpoint_late_p99_ms"]),
        left_out=int(_number(told["late_ticks"]) or 0),
        station_core=station_s / flight_s,
        simulator_core=simulator_s / flight_s,
    )


def swarm_mission(vehicles: int) -> str:
    """Return a mission of a hemisphere that looks upwards, and surrounds a target at rest above it.

    Args:
        vehicles: an odd number from 7 on: leaders, as many followers, and the pole.

    Raises:
        FgError: the number is even, or too small.
    """
    if vehicles < 7 or not vehicles % 2:
        raise FgError(f"a hemisphere of {vehicles} vehicles; accepted: an odd number from 7 on")
    leaders = (vehicles - 1) // 2
    half_turn = math.sin(math.pi / leaders)
    radius_m = max(LEAST_RADIUS_M, EDGE_M / (2.0 * half_turn))
    height_m, corner_m = radius_m + POLE_M, 1.5 * math.ceil(math.sqrt(vehicles))
    return f"""\
description = "A large swarm in real time"

[swarm]
vehicles = {vehicles}

[formation]
shape = "hemisphere"
leaders = {leaders}
followers = {leaders + 1}
edge_m = {2.0 * radius_m * half_turn:.6f}
centre_enu_m = [0.0, 0.0, {height_m:.3f}]
normal_enu = [0.0, 0.0, 1.0]

[target]
position_enu_m = [60.0, 20.0, {height_m + 34.0:.3f}]

[hold]
duration_s = 10.0

[limits]
speed_m_s = 8.0
acceleration_m_s2 = 3.0
separation_m = 1.5

[fence]
low_enu_m = [{-radius_m - 100.0:.3f}, {-radius_m - 100.0:.3f}, 3.0]
high_enu_m = [{radius_m + 150.0:.3f}, {radius_m + 100.0:.3f}, {2.0 * radius_m + 60.0:.3f}]

[pads]
first_enu_m = [{-corner_m:.3f}, {-corner_m:.3f}]
"""


def _fly(mission: Mission, folder: Path, speed: float) -> RunResult:
    options = FlyOptions(logs=folder, serve_snapshots=False, write_report=False)
    return fly_blocking(mission, options, speed=speed)


def _completed(result: RunResult) -> RunResult:
    """Return a flight that was completed.

    Raises:
        FgError: it was not; says why.
    """
    if not result.completed:
        raise FgError(f"the flight was not completed: {result.reason}")
    return result


def _duration_s(result: RunResult) -> float:
    """Return how long a flight was, from the first word to the last landing [s]."""
    stages = result.summary["stages"]
    assert isinstance(stages, dict)
    return max(float(end_s) for _, end_s in stages.values())


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _children_s() -> float:
    """Return what processes that this one started, and that have ended, have computed [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
