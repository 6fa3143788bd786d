"""Telemetry logs: every frame of both directions with its time, as MAVExplorer, QGroundControl and mavlogdump read."""

from __future__ import annotations

import struct
from collections.abc import Iterable

STAMP = struct.Struct(">Q")  # microseconds since 1970, big-endian, before every frame


def stamped(frames: Iterable[bytes | memoryview], unix_s: float) -> bytes:
    """Return what a tlog holds of whole frames that passed at a Unix time [s]."""
    stamp = STAMP.pack(int(unix_s * 1e6))
    return b"".join([part for frame in frames for part in (stamp, frame)])
