"""What recording costs: the processor's time for everything that a flight records, beside how long the flight takes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import MAIN

BUDGET = 0.03  # of a core
TICK_HZ = 50  # rounds of setpoints
TELEMETRY_EVERY = 2  # rounds: 25 Hz of positions
OTHERS_EVERY = 2  # rounds: a vehicle's other messages, some 36 a second together with heartbeats
FLUSH_EVERY = 10  # rounds: five times a second, as a flight does it
REPLANS_HZ = 10


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
    position, other, setpoint = _frames()
    frames = 0
    with TemporaryDirectory(prefix="fg-gcs-bench-") as place:
        folder = Path(place)
        began_s = cpu_time()
        with Recorder(folder, "", 0.0, 1.7e9, in_thread=True) as recorder:
            for k in range(rounds):
                now_s = k / TICK_HZ
                numbers = (1.0 + now_s, 2.0 - now_s, 3.0, 0.1, 0.2, 0.3)
                for system_id in range(1, vehicles + 1):
                    recorder.frame(setpoint, now_s)
                    recorder.setpoints.append((now_s, MAIN, system_id, *numbers, 0.4, 0.5, 0.6, 0.7))
                    frames += 1
                    if k % TELEMETRY_EVERY == 0:
                        recorder.frame(position, now_s)
                        recorder.telemetry.append((now_s, MAIN, system_id, *numbers, 0.7, now_s, 3.0))
                        frames += 1
                    if k % OTHERS_EVERY == 0:
                        recorder.frame(other, now_s)
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


def _frames() -> tuple[bytes, bytes, bytes]:
    """Return a position, another message of a vehicle and a setpoint, as they travel."""
    packer = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    position = dialect.MAVLink_local_position_ned_message(1000, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
    other = dialect.MAVLink_attitude_message(1000, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    setpoint = dialect.MAVLink_set_position_target_local_ned_message(
        1000, 1, 1, 1, 0, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.0
    )
    first, second, third = (bytes(message.pack(packer)) for message in (position, other, setpoint))
    return first, second, third
