"""The simulator as a process of its own, for tests with other people's clients."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

END_S = 10.0  # a process that is told to end does so in milliseconds, unless the machine is very busy


def free_udp_port() -> int:
    """A port that nobody had a moment ago."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def simulator(*options: str) -> Iterator[tuple[int, ...]]:
    """Run `python -m sitl_mock --port-base 0 ...`; give the vehicles' ports. It cannot outlive the test."""
    command = [sys.executable, "-m", "sitl_mock", "--port-base", "0", "--with-parent", *options]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line.startswith("ready "), line
        span = line.split("ports=")[1].strip()
        if match := re.fullmatch(r"(\d+)-(\d+)", span):
            yield tuple(range(int(match[1]), int(match[2]) + 1))
        else:
            yield tuple(map(int, span.split(",")))
    finally:
        process.stdin.close()
        code = process.wait(END_S)
        process.stdout.close()
    assert code == 0
