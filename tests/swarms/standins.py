"""Programs that stand in for a SITL binary; each is a small script, written where a test wants it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from pathlib import Path

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.mission.model import DEFAULT_ORIGIN
from fg_gcs.sitl.instances import Instance, SwarmOptions, numbered
from fg_gcs.sitl.layout import Layout, homes, places
from fg_gcs.sitl.swarm import Listener, Swarm
from fg_gcs.wire.framing import Sender
from tests.sitl.process import free_udp_port

WHO_AM_I = """
import os, signal, socket, sys
def value(option):
    return sys.argv[sys.argv.index(option) + 1]
system_id, (host, port) = value("--sysid"), value("--serial0").split(":")[1:]
"""
OURS = """
latitude, longitude, altitude, _ = value("--home").split(",")
os.execv(sys.executable, [sys.executable, "-m", "sitl_mock", "--autopilot", "ardupilot", "--system-ids", system_id,
    "--origin", ",".join((latitude, longitude, altitude)), "--remote", f"{host}:{port}", "--port-base", "0"])
"""
HEARTBEATS = """
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
out.settimeout(0.1)
while True:
    out.sendto(bytes.fromhex(BEATS[system_id]), (host, int(port)))
    try:
        out.recv(512)  # what the station says; nothing follows
    except TimeoutError:
        pass
"""


def script(path: Path, text: str, *, lean: bool = True) -> Path:
    """Write a program in Python; a lean one starts in a hundredth of a second and knows only what comes along."""
    path.write_text(f"#!{sys.executable}{' -ES' if lean else ''}\n{WHO_AM_I}{text}")
    path.chmod(0o755)
    return path


def beating(path: Path, *, kind: int = dialect.MAV_TYPE_QUADROTOR, armed: bool = False, px4: bool = False) -> Path:
    """Write a program that says what it is, and nothing else."""
    autopilot = dialect.MAV_AUTOPILOT_PX4 if px4 else dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
    base_mode = 81 | (dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    message = dialect.MAVLink_heartbeat_message(kind, autopilot, base_mode, 0, 3, 3)
    beats = {str(system_id): Sender(system_id, 1).pack(message).hex() for system_id in range(1, 10)}
    return script(path, f"BEATS = {beats!r}{HEARTBEATS}")


def some(count: int) -> list[Instance]:
    """Return instances from 0 on, with ids from 1 on."""
    places_m = places(Layout.GRID, count, 4.0)
    return numbered(range(count), range(1, count + 1), homes(places_m, DEFAULT_ORIGIN), "ardupilot")


def options(folder: Path, binary: Path) -> SwarmOptions:
    """Return how these are started; their ports are of this process alone, as tests run beside each other."""
    defaults = folder / "copter.parm"
    defaults.write_text("")
    return SwarmOptions(
        "ardupilot",
        binary,
        folder=folder / "sitl",
        files=defaults,
        port=free_udp_port(),
        base_port=20_000 + 40 * (os.getpid() % 300),  # ephemeral ones are higher
        heartbeat_s=20.0,
        ready_s=20.0,
        watch_s=0.0,
    )


class Heard(Listener):
    """Keeps what is said, and which processes there were."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.pids: set[int] = set()

    def said(self, text: str) -> None:
        """Keep it."""
        self.lines.append(text)

    def ended(self, text: str) -> None:
        """Keep it."""
        self.lines.append(f"ended: {text}")

    def changed(self, swarm: Swarm) -> None:
        """Keep its processes."""
        self.pids |= {member.pid for member in swarm.members if member.pid}


def alive(pids: Iterable[int]) -> list[int]:
    """Return those of some processes that run still."""
    found = []
    for pid in pids:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if state != "Z":
            found.append(pid)
    return found
