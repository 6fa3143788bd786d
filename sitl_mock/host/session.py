"""The simulator as a process: start, say so, wait for the end, close."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import stat
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from sitl_mock.faults.incidents import write_truth
from sitl_mock.faults.schema import FLIGHT_STAGES
from sitl_mock.host.memory import settle
from sitl_mock.host.server import Counters, PortUnavailable, Simulator, SimulatorOptions

BAD_INPUT, PORT_UNAVAILABLE = 2, 3  # exit codes
CHUNK_BYTES = 4096


def simulate(options: SimulatorOptions, with_parent: bool, timing: Path | None = None) -> int:
    """Run until SIGINT or SIGTERM, or (`with_parent`) until standard input ends.

    Args:
        options: what to simulate.
        with_parent: end with standard input, and read stages there.
        timing: a JSON file for how late ticks were, see `Lateness.figures`; written at the end.

    Returns:
        Exit code.
    """
    simulator = Simulator(replace(options, epoch_s=time.time()))
    if options.truth is not None:
        try:
            write_truth(options.truth, simulator.fleet.incidents)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            sys.stderr.write(f"sitl_mock: --truth {str(options.truth)!r}: {reason}\n")
            return BAD_INPUT
    settle()  # everything is loaded now, and no tick waits yet
    code = asyncio.run(_simulate(simulator, with_parent))
    if timing is not None:
        with suppress(OSError):  # a full disk is no matter for vehicles
            timing.write_text(json.dumps(simulator.lateness.figures()) + "\n")
    return code


async def _simulate(simulator: Simulator, with_parent: bool) -> int:
    loop = asyncio.get_running_loop()
    ended = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    try:
        async with simulator:
            watcher = asyncio.create_task(_watch_parent(simulator, ended)) if with_parent else None
            sys.stdout.write(ready_line(simulator) + "\n")
            sys.stdout.flush()
            await ended.wait()
            if watcher is not None:
                watcher.cancel()
    except PortUnavailable as error:
        sys.stderr.write(f"sitl_mock: {error}\n")
        return PORT_UNAVAILABLE
    for incident in simulator.fleet.incidents.found:
        sys.stderr.write(f"sitl_mock: {incident}\n")
    sys.stderr.write(closing_line(simulator.counters))
    return 0


async def _line(reader: asyncio.StreamReader) -> bytes:
    """The next line, or what there is of one that is too long; empty at the end."""
    try:
        return await reader.readline()
    except ValueError:  # longer than the reader's buffer
        return await reader.read(CHUNK_BYTES)


def ready_line(simulator: Simulator) -> str:
    """What a parent process waits for on standard output."""
    ports, options = simulator.ports, simulator.options
    in_a_row = ports == tuple(range(ports[0], ports[0] + len(ports)))
    span = f"{ports[0]}-{ports[-1]}" if in_a_row else ",".join(map(str, ports))
    return f"ready vehicles={len(ports)} autopilot={options.autopilot} ports={span}"


def closing_line(counters: Counters) -> str:
    """What went wrong on the way, for people; empty when nothing did."""
    found = [
        (counters.bad_bytes, "bytes received in no valid frame"),
        (counters.dropped, "datagrams from unknown senders ignored"),
        (counters.not_signed, "frames refused because of their signature"),
        (counters.unsendable, "messages not sent because a number did not fit"),
        (counters.send_errors, "errors while sending"),
        (round(counters.slipped_s, 3), "s of simulated time skipped, the machine being too slow"),
    ]
    lines = [f"{number:g} {what}" for number, what in found if number]
    return f"sitl_mock: {'; '.join(lines)}\n" if lines else ""


async def _watch_parent(simulator: Simulator, ended: asyncio.Event) -> None:
    """Read what the parent tells, and set `ended` when it tells nothing more: it has ended, or wants this to end."""
    if not (sys.stdin.isatty() or stat.S_ISFIFO(mode := os.fstat(sys.stdin.fileno()).st_mode) or stat.S_ISSOCK(mode)):
        ended.set()  # a file or /dev/null: no parent is at the other end, and it cannot be waited for
        return
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    transport, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    try:
        while line := await _line(reader):
            word, _, stage = line.decode("utf-8", "replace").strip().partition(" ")
            if word == "stage" and stage in FLIGHT_STAGES:
                simulator.begin_stage(stage)
    finally:
        transport.close()
    ended.set()
