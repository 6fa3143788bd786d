"""Telemetry logs: every frame of both directions with its time, as MAVExplorer, QGroundControl and mavlogdump read."""

from __future__ import annotations

import struct
from collections.abc import Sequence

STAMP = struct.Struct(">Q")  # microseconds since 1970, big-endian, before every frame


def stamped(frames: Sequence[bytes], unix_s: float) -> bytes:
    """Return what a tlog holds of whole frames that passed at a Unix time [s]."""
    if not frames:
        return b""
    stamp = STAMP.pack(int(unix_s * 1e6))
    return stamp + stamp.join(frames)
