"""What recording costs: the processor's time for everything that a flight records, beside how long the flight takes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fg_gcs.record.write.layouts import TELEMETRY
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import MAIN

BUDGET = 0.03  # of a core
TICK_HZ = 50  # rounds of setpoints
TELEMETRY_EVERY = 2  # rounds: 25 Hz of positions
OTHERS_EVERY = 2  # rounds: a vehicle's other messages, some 36 a second together with heartbeats
FLUSH_EVERY = 10  # rounds: five times a second, as a flight does it
REPLANS_HZ = 10
POSITION_BYTES, OTHER_BYTES, SETPOINT_BYTES = 40, 40, 65  # of frames: LOCAL_POSITION_NED, ATTITUDE and our setpoint


class RecordingFigures(NamedTuple):
    """How much of a core recording takes."""

    vehicles: int
    flight_s: float  # that was recorded
    cpu_s: float  # of all threads
    share: float  # of a core
    budget: float
    bytes_s: float  # written, a second of flight
    frames_hz: float


def record_bench(cpu_time: Callable[[], float], vehicles: int = 9, flight_s: float = 60.0) -> RecordingFigures:
    """Record a made-up flight at full rates, as fast as that goes, and measure what it takes.

    Telemetry comes at 25 Hz and setpoints leave at 50 Hz for every vehicle, with all frames of both directions, ticks,
    sightings and replans, and a writer in its own thread, as in real time.

    Args:
        cpu_time: returns what all threads of this process have computed so far [s].
        vehicles: how many.
        flight_s: how long [s].
    """
    rounds = int(flight_s * TICK_HZ)
    position, other, setpoint = bytes(POSITION_BYTES), bytes(OTHER_BYTES), bytes(SETPOINT_BYTES)
    frames, network = 0, TELEMETRY.text("network", MAIN)
    with TemporaryDirectory(prefix="fg-gcs-bench-") as place:
        folder = Path(place)
        began_s = cpu_time()
        with Recorder(folder, "", 0.0, 1.7e9, in_thread=True) as recorder:
            for k in range(rounds):
                now_s = k / TICK_HZ
                numbers = (1.0 + now_s, 2.0 - now_s, 3.0, 0.1, 0.2, 0.3)
                recorder.frames([setpoint] * vehicles, now_s)
                recorder.setpoints.extend(_setpoints(recorder, now_s, numbers, vehicles))
                frames += vehicles
                for system_id in range(1, vehicles + 1):
                    if k % TELEMETRY_EVERY == 0:
                        recorder.frames([position], now_s)
                        recorder.telemetry.append((now_s, network, system_id, *numbers, 0.7, now_s, 3.0))
                        frames += 1
                    if k % OTHERS_EVERY == 0:
                        recorder.frames([other], now_s)
                        frames += 1
                recorder.ticks.append((now_s, 0.0))
                recorder.truth.append((now_s, "target", 1.0, 2.0, 3.0))
                if k % (TICK_HZ // REPLANS_HZ) == 0:
                    recorder.sightings.append((now_s, now_s, "target", 1.0, 2.0, 3.0, "taken"))
                    recorder.replans.append((now_s, now_s, now_s, "follow", True, *numbers, 0.1, 0.2, 0.3))
                if k % TICK_HZ == 0:
                    recorder.event(now_s, "text", "vehicle 1: something that it has to say", severity=6)
                if k % FLUSH_EVERY == 0:
                    recorder.flush()
                    recorder.settle()  # in real time there is a fifth of a second for it
        cpu_s = cpu_time() - began_s
        size = sum(path.stat().st_size for path in folder.iterdir())
    return RecordingFigures(vehicles, flight_s, cpu_s, cpu_s / flight_s, BUDGET, size / flight_s, frames / flight_s)


def _setpoints(recorder: Recorder, now_s: float, numbers: tuple[float, ...], vehicles: int) -> NDArray[np.void]:
    """Return the rows of one round, as the streamer makes them."""
    rows = recorder.setpoints.rows(vehicles)
    rows["time_s"], rows["network"], rows["system_id"] = now_s, MAIN.encode(), np.arange(1, vehicles + 1)
    rows["position_enu_m"], rows["velocity_enu_m_s"] = numbers[:3], numbers[3:]
    rows["acceleration_enu_m_s2"], rows["yaw_rad"] = (0.4, 0.5, 0.6), 0.7
    return rows
