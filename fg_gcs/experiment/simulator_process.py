"""The simulator as a process of its own, beside a sink that counts; on Linux, which tells what a process takes."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

from fg_gcs.errors import LinkError
from fg_gcs.experiment.memory_bench import memory_mb

BOOT_S: Final = 2.0  # until every stream goes
END_S: Final = 10.0
SINK_BYTES: Final = 1 << 22  # of its buffer: whatever holds the sink up is no loss
LONGEST_FRAME: Final = 300
POLL_S: Final = 0.05
SAMPLE: Final = 2000  # frames that are kept


class Alone(NamedTuple):
    """The simulator with V vehicles, which stand on the ground and tell all that they tell unasked, in real time."""

    vehicles: int
    core: float  # share of a core
    late_p99_ms: float
    late_worst_ms: float
    left_out: int  # ticks
    messages_s: float
    message_us: float  # of the processor, with everything else that the simulator does
    memory_mb: float


def simulator_alone(vehicles: int, seconds: float) -> tuple[Alone, list[bytes]]:
    """Let the simulator run beside a sink.

    Args:
        vehicles: how many, 1 to 250.
        seconds: how long they are counted, once every stream goes [s].

    Returns:
        What it took, and some of the frames that came.

    Raises:
        LinkError: it does not start.
    """
    with TemporaryDirectory(prefix="fg-gcs-bench-") as place, socket.socket(type=socket.SOCK_DGRAM) as sink:
        sink.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SINK_BYTES)
        sink.bind(("127.0.0.1", 0))
        sink.settimeout(POLL_S)
        timing = Path(place) / "timing.json"
        options = [f"--vehicles={vehicles}", f"--remote=127.0.0.1:{sink.getsockname()[1]}", f"--timing={timing}"]
        with _running(options) as process:
            _count(sink, BOOT_S, [])
            began_s, cpu_s, frames = time.monotonic(), _cpu_s(process), list[bytes]()
            count = _count(sink, seconds, frames)
            cpu_s, taken_s = _cpu_s(process) - cpu_s, time.monotonic() - began_s
            size_mb = memory_mb("VmRSS", process)
        late = json.loads(timing.read_text())
    figures = (late["late_p99_ms"], late["late_worst_ms"], late["left_out"])
    message_us = 1e6 * cpu_s / max(count, 1)
    return Alone(vehicles, cpu_s / taken_s, *figures, count / taken_s, message_us, size_mb), frames


def parts_alone(physics: Sequence[int], telemetry: Sequence[int], seconds: float) -> dict[str, list[dict[str, Any]]]:
    """Return how fast the simulator's parts are, see `sitl_mock.host.measure`.

    Args:
        physics: numbers of vehicles.
        telemetry: numbers of vehicles.
        seconds: of the processor, for each figure [s].
    """
    asked = {"physics": list(physics), "telemetry": list(telemetry), "seconds": seconds}
    command = [sys.executable, "-m", "sitl_mock.host.measure"]
    done = subprocess.run(command, input=json.dumps(asked) + "\n", stdout=subprocess.PIPE, text=True, check=True)
    found: dict[str, list[dict[str, Any]]] = json.loads(done.stdout)
    return found


@contextmanager
def _running(options: Sequence[str]) -> Iterator[int]:
    """Run the simulator; yield its number; it cannot outlive this.

    Raises:
        LinkError: it does not start.
    """
    command = [sys.executable, "-m", "sitl_mock", "--port-base=0", "--with-parent", *options]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            if not process.stdout.readline().startswith(b"ready"):
                raise LinkError("the simulator did not start")
            yield process.pid
        finally:
            process.stdin.close()
            process.wait(END_S)


def _count(sink: socket.socket, seconds: float, kept: list[bytes]) -> int:
    """Return how many datagrams come; the first ones are kept."""
    count, end_s = 0, time.monotonic() + seconds
    while time.monotonic() < end_s:
        try:
            frame = sink.recv(LONGEST_FRAME)
        except TimeoutError:
            continue
        count += 1
        if count <= SAMPLE:
            kept.append(frame)
    return count


def _cpu_s(process: int) -> float:
    """Return what all threads of a process have computed so far, to a hundredth [s]."""
    user, system = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
