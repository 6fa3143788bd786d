"""Serial devices: a telemetry radio, or an autopilot's USB port, by the system's own calls (termios)."""

from __future__ import annotations

import array
import asyncio
import errno
import fcntl
import os
import termios
from contextlib import suppress
from typing import Final

from fg_gcs.link.kept_wire import Connection, KeptWire

QUEUE_S: Final = 0.1  # of sending at the device's rate: what waits longer is worth nothing
LEAST_QUEUE_BYTES: Final = 300  # one frame always has room: the longest has 293 bytes
_BITS_A_BYTE: Final = 10  # a start bit and a stop bit
_MOST_BYTES: Final = 4096  # read before the loop looks at its timers
_SPEED: Final = (4, 5)  # places of the two speeds, and of the special characters, in what termios gives
_CHARACTERS: Final = 6


class _Line(Connection):
    """A device that is open.

    Args:
        wire: Hears of all that happens.
        descriptor: Of the device, not blocking.
        baud: Its rate.
    """

    def __init__(self, wire: KeptWire, descriptor: int, baud: int) -> None:
        super().__init__()
        self._wire = wire
        self._descriptor = descriptor
        self._most_waiting = max(int(QUEUE_S * baud / _BITS_A_BYTE), LEAST_QUEUE_BYTES)
        self._rest = b""  # of a frame that the device has taken a part of
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(descriptor, self._read)

    def write(self, data: bytes) -> bool:
        """Send a frame, unless too much waits already; a frame that was begun is sent to its end."""
        if self._descriptor < 0 or self._rest or self._queued() + len(data) > self._most_waiting:
            return False
        self._rest = data
        self._write_rest()
        return True

    def close(self) -> None:
        """Close the device; may be called twice."""
        if self._descriptor < 0:
            return
        self._loop.remove_reader(self._descriptor)
        self._loop.remove_writer(self._descriptor)
        with suppress(termios.error):
            termios.tcflush(self._descriptor, termios.TCOFLUSH)  # closing would wait for what has not left yet
        os.close(self._descriptor)
        self._descriptor = -1
        self._wire.disconnected(self)

    def _queued(self) -> int:
        """Return how many bytes wait in the system."""
        found = array.array("i", [0])
        with suppress(OSError):
            fcntl.ioctl(self._descriptor, termios.TIOCOUTQ, found)
        return found[0]

    def _write_rest(self) -> None:
        try:
            self._rest = self._rest[os.write(self._descriptor, self._rest) :]
        except BlockingIOError:
            pass
        except OSError:
            self.close()
            return
        if self._rest:
            self._loop.add_writer(self._descriptor, self._write_rest)
        else:
            self._loop.remove_writer(self._descriptor)

    def _read(self) -> None:
        try:
            data = os.read(self._descriptor, _MOST_BYTES)
        except BlockingIOError:
            return
        except OSError:  # it was unplugged
            data = b""
        if data:
            self._wire.received(data)
        else:
            self.close()


class SerialWire(KeptWire):
    """A serial device; one that is unplugged is opened again when it is back."""

    async def _connect(self) -> Connection:
        line = _Line(self, _opened(self.endpoint.host, self.endpoint.port), self.endpoint.port)
        self.connected(line)
        return line


def _opened(device: str, baud: int) -> int:
    """Return a descriptor of a device: eight bits, no parity, no flow control, no translation, ours alone.

    Raises:
        OSError: It is not there, is not ours to open, is in use, or does not have that rate.
    """
    descriptor = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        if not os.isatty(descriptor):
            raise OSError(errno.ENOTTY, "not a serial device")
        speed = getattr(termios, f"B{baud}")
        try:
            fcntl.ioctl(descriptor, termios.TIOCEXCL)
            settings = termios.tcgetattr(descriptor)
            settings[0:4] = [0, 0, termios.CS8 | termios.CREAD | termios.CLOCAL, 0]
            settings[_SPEED[0]] = settings[_SPEED[1]] = speed
            settings[_CHARACTERS][termios.VMIN], settings[_CHARACTERS][termios.VTIME] = 0, 0
            termios.tcsetattr(descriptor, termios.TCSANOW, settings)
            termios.tcflush(descriptor, termios.TCIOFLUSH)
        except termios.error as error:
            raise OSError(errno.ENOTTY, "a serial device that cannot be set to that rate") from error
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor
