"""A way out for text that never makes its writer wait: a terminal that stands still must not stop a flight."""

from __future__ import annotations

import io
import os
import queue
import sys
import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING, Final, TextIO

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

MOST_WAITING: Final = 64  # texts; of a terminal that takes none, the picture alone fills that in a quarter of a minute
LARGEST_BYTES: Final = 1 << 16  # of one text: several pictures of a large terminal, so that none is cut in two
CLOSE_S: Final = 2.0  # real seconds for the last words: a slow line needs less, a dead one would need for ever


class NonBlockingWriter(io.RawIOBase):
    """Hands bytes on to a file descriptor by a thread of its own; what is too much, or comes too late, is dropped.

    Somebody presses Ctrl-S, a remote terminal's network is gone, a pager does not read on: writing then blocks, and the
    event loop would block with it, and the vehicles would run out of setpoints.

    Attributes:
        dropped: texts that were not handed on.
    """

    def __init__(self, descriptor: int, most: int = MOST_WAITING) -> None:
        """Write to a copy of an open file descriptor; ``most`` texts may wait."""
        self.dropped = 0
        self._descriptor = os.dup(descriptor)
        self._terminal = os.isatty(descriptor)
        self._waiting: queue.Queue[bytes | None] = queue.Queue(most)
        self._thread = threading.Thread(target=self._hand_on, name="outlet", daemon=True)
        self._thread.start()

    def isatty(self) -> bool:
        """Tell whether it ends at a terminal."""
        return self._terminal

    def writable(self) -> bool:
        """Return True: it always is."""
        return True

    def write(self, data: ReadableBuffer, /) -> int:
        """Take a text and return its length, whatever becomes of it."""
        text = bytes(data)
        try:
            self._waiting.put_nowait(text)
        except queue.Full:
            self.dropped += 1
        return len(text)

    def close(self) -> None:
        """Wait a moment for the last words to leave; may be called twice."""
        if not self.closed:
            super().close()
            try:
                self._waiting.put(None, timeout=CLOSE_S)
            except queue.Full:  # it stands still to the very end
                return
            self._thread.join(CLOSE_S)

    def _hand_on(self) -> None:
        """Write what comes, until nothing more will: the thread."""
        while (text := self._waiting.get()) is not None:
            try:
                while text:
                    text = text[os.write(self._descriptor, text) :]
            except OSError:  # the terminal has gone: the flight goes on without
                self.dropped += 1
        os.close(self._descriptor)


def unhurried(stream: TextIO) -> TextIO:
    """Return a stream of text beside an open one, to the same place, that never makes its writer wait."""
    return io.TextIOWrapper(
        io.BufferedWriter(NonBlockingWriter(stream.fileno()), LARGEST_BYTES), stream.encoding, "replace"
    )


def unhurried_errors(stack: ExitStack) -> TextIO:
    """Return a way to standard error that never makes us wait, open as long as the stack."""
    try:
        return stack.enter_context(unhurried(sys.stderr))
    except OSError:  # it is no file, so nothing that could stand still
        return sys.stderr
