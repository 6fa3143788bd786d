"""Starts and asks the bare vehicles, see `fg_gcs.experiment.bare_vehicles`."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import IO, Final, NamedTuple

from fg_gcs.wire.bare import boot_frames

END_S: Final = 10.0  # a process that is told to end does so in milliseconds, unless the machine is very busy


class Deliveries(NamedTuple):
    """Setpoints that came so far."""

    right: int  # at the vehicle that each is for
    wrong: int  # at another one


class BareProcess:
    """Vehicles of a process of their own.

    Attributes:
        ports: of the loopback, where each of them listens.
    """

    def __init__(self, answers: IO[str], questions: IO[str]) -> None:
        """Take the process's output and input: `bare_vehicles` starts one."""
        self._answers, self._questions = answers, questions
        self.ports: tuple[int, ...] = tuple(json.loads(answers.readline())["ports"])

    def deliveries(self) -> Deliveries:
        """Return what came so far."""
        return self._ask({})

    def set_position_hz(self, position_hz: float) -> None:
        """Let every vehicle tell its position so often from now on."""
        self._ask({"position_hz": position_hz})

    def _ask(self, question: Mapping[str, float]) -> Deliveries:
        self._questions.write(json.dumps(question) + "\n")
        self._questions.flush()
        return Deliveries(**json.loads(self._answers.readline()))


@contextmanager
def bare_vehicles(remotes: Mapping[int, Sequence[int]], position_hz: float) -> Iterator[BareProcess]:
    """Play vehicles that speak to ports of the loopback; they cannot outlive this.

    Args:
        remotes: system ids by the port that they speak to.
        position_hz: how often each of them tells its position [Hz].
    """
    vehicles = [
        {"remote": ["127.0.0.1", port], "system_id": system_id}
        | {kind: frame.hex() for kind, frame in boot_frames(system_id).items()}
        for port, system_ids in remotes.items()
        for system_id in system_ids
    ]
    command = [sys.executable, "-m", "fg_gcs.experiment.bare_vehicles"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps({"vehicles": vehicles, "position_hz": position_hz}) + "\n")
        process.stdin.flush()
        try:
            yield BareProcess(process.stdout, process.stdin)
        finally:
            process.stdin.close()
            process.wait(END_S)


def free_ports(count: int) -> list[int]:
    """Return UDP ports of the loopback that are not in use now."""
    probes = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    try:
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [probe.getsockname()[1] for probe in probes]
    finally:
        for probe in probes:
            probe.close()
