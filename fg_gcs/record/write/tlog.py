"""Telemetry logs: every frame of both directions with its time, as MAVExplorer, QGroundControl and mavlogdump read."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

STAMP = struct.Struct(">Q")  # microseconds since 1970, big-endian, before every frame


def stamped(frames: Sequence[bytes] | NDArray[np.uint8], unix_s: float) -> bytes:
    """Return what a tlog holds of whole frames that passed at a Unix time [s].

    Args:
        frames: One by one, or in the rows of an array, shape (count, size).
        unix_s: The Unix time [s].
    """
    stamp = STAMP.pack(int(unix_s * 1e6))
    if isinstance(frames, np.ndarray):
        rows = np.empty((len(frames), len(stamp) + frames.shape[1]), np.uint8)
        rows[:, : len(stamp)] = np.frombuffer(stamp, np.uint8)
        rows[:, len(stamp) :] = frames
        return rows.tobytes()
    return stamp + stamp.join(frames) if frames else b""
