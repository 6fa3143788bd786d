"""Many datagrams in one call of the system, where it has such a call (Linux: ``sendmmsg``, see its manual page).

A call for each datagram takes Python as long as the kernel: its arguments, the address parsed, the lock given back.
"""

from __future__ import annotations

import ctypes
import errno
import socket
import sys
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

Send = Callable[[int, int, int, int], int]  # descriptor, address of the headers, how many, flags

# The kernel's structures on every 64-bit Linux; `bulk_send_of` refuses others
_ADDRESS: Final = np.dtype([("family", "=u2"), ("port", ">u2"), ("host", np.uint8, (4,)), ("zero", np.uint8, (8,))])
_PIECE: Final = np.dtype([("base", "=u8"), ("size", "=u8")])
_HEADER: Final = np.dtype(
    [
        ("name", "=u8"),
        ("name_size", "=u8"),  # of 32 bits, and padding
        ("pieces", "=u8"),
        ("count", "=u8"),
        ("control", "=u8"),
        ("control_size", "=u8"),
        ("flags", "=u8"),  # of 32 bits, and padding
        ("sent", "=u8"),  # likewise; the kernel's answer
    ]
)


def bulk_send_of(library: object | None = None) -> Send | None:
    """Return the system's call, None where there is none.

    Args:
        library: a C library to look for it in; None: the process's own.
    """
    if ctypes.sizeof(ctypes.c_void_p) != 8 or sys.byteorder != "little":
        return None
    found = getattr(library or ctypes.CDLL(None, use_errno=True), "sendmmsg", None)
    if found is None:
        return None
    found.argtypes, found.restype = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int), ctypes.c_int
    send: Send = found
    return send


class Bulk:
    """Where a round of frames goes through one socket, laid out for the kernel.

    Args:
        send: The system's call.
        addresses: IPv4 addresses (host, port) of the frames, in their order; None: the socket is connected.
        count: How many frames there are.
    """

    def __init__(self, send: Send, addresses: Sequence[tuple[str, int]] | None, count: int) -> None:
        self._send = send
        self._pieces = np.zeros(count, _PIECE)
        self._headers = np.zeros(count, _HEADER)
        self._headers["pieces"] = self._pieces.ctypes.data + np.arange(count) * _PIECE.itemsize
        self._headers["count"] = 1
        self._addresses = np.zeros(count, _ADDRESS)  # kept alive here: the kernel has numbers only
        if addresses is not None:
            self._addresses["family"] = socket.AF_INET
            self._addresses["port"] = [port for _, port in addresses]
            hosts = b"".join(socket.inet_aton(host) for host, _ in addresses)
            self._addresses["host"] = np.frombuffer(hosts, np.uint8).reshape(-1, 4)
            self._headers["name"] = self._addresses.ctypes.data + np.arange(count) * _ADDRESS.itemsize
            self._headers["name_size"] = _ADDRESS.itemsize
        self._size, self._offsets = 0, np.zeros(count, np.uint64)  # of the frames, one behind the other
        self._first = self._headers.ctypes.data

    def send(self, descriptor: int, frames: NDArray[np.uint8]) -> list[int]:
        """Send each frame to its address, once; return the system's error numbers for those that did not leave.

        Args:
            descriptor: Of a socket that does not block.
            frames: One a row, as many as there are addresses; shape (count, size), contiguous.
        """
        count, size = frames.shape
        if size != self._size:
            self._size, self._pieces["size"], self._offsets = size, size, np.arange(count, dtype=np.uint64) * size
        np.add(self._offsets, frames.__array_interface__["data"][0], out=self._pieces["base"])
        done, errors = 0, list[int]()
        while done < count:
            sent = self._send(descriptor, self._first + done * _HEADER.itemsize, count - done, 0)
            if sent > 0:
                done += sent
                continue
            error = ctypes.get_errno()
            if error == errno.EINTR:
                continue
            full = error in (errno.EAGAIN, errno.ENOBUFS)  # an old setpoint is worth nothing: no more is tried
            errors.extend([error] * (count - done if full else 1))
            done = count if full else done + 1
        return errors
