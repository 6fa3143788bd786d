"""Telemetry logs: every frame of both directions with its time, as MAVExplorer, QGroundControl and mavlogdump read."""

from __future__ import annotations

import struct

STAMP = struct.Struct(">Q")  # microseconds since 1970, big-endian, before every frame


def stamped(frame: bytes, unix_s: float) -> bytes:
    """Return what a tlog holds of a whole frame that passed at a Unix time [s]."""
    return STAMP.pack(int(unix_s * 1e6)) + frame
