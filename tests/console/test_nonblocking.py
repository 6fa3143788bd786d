"""Text goes out in order and whole, and whoever writes never waits."""

from __future__ import annotations

import os
import pty
import threading

import pytest

from fg_gcs.console.nonblocking import MOST_WAITING, NonBlockingWriter, unhurried

LARGE = 1 << 20  # more than any pipe holds


def reader_of(descriptor: int, got: list[bytes]) -> threading.Thread:
    """Read to the end, by a thread that is running."""

    def read() -> None:
        while data := os.read(descriptor, 1 << 16):
            got.append(data)

    thread = threading.Thread(target=read)
    thread.start()
    return thread


def test_everything_arrives_in_order_before_it_is_closed() -> None:
    there, here = os.pipe()
    got: list[bytes] = []
    thread = reader_of(there, got)
    with os.fdopen(here, "w", encoding="utf-8") as stream, unhurried(stream) as out:
        for k in range(MOST_WAITING - 1):
            out.write(f"line {k} \u2501")
            out.write("\n")
            out.flush()
        out.write("unflushed")
    thread.join()
    os.close(there)
    assert b"".join(got).decode() == "".join(f"line {k} \u2501\n" for k in range(MOST_WAITING - 1)) + "unflushed"


def test_where_nobody_reads_texts_are_dropped_whole_and_nothing_waits() -> None:
    there, here = os.pipe()
    outlet = NonBlockingWriter(here, most=4)
    texts = [bytes([65 + k]) * LARGE for k in range(10)]
    for text in texts:
        assert outlet.write(text) == LARGE  # would block for ever, did it wait
    assert 5 <= outlet.dropped <= 6  # four wait, and one may be on its way
    got: list[bytes] = []
    thread = reader_of(there, got)
    outlet.close()
    outlet.close()
    os.close(here)
    thread.join()
    os.close(there)
    data = b"".join(got)
    runs = [data[k * LARGE : (k + 1) * LARGE] for k in range(len(data) // LARGE)]
    assert len(runs) * LARGE == len(data)
    assert runs == [text for text in texts if text in runs]
    assert len(runs) == 10 - outlet.dropped


def test_a_terminal_that_has_gone_is_no_error() -> None:
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "w") as stream:
        out = unhurried(stream)
        assert out.isatty()
        os.close(ours)
        for _ in range(3):
            out.write("anybody?\n")
            out.flush()
        out.close()


def test_a_pipe_is_no_terminal() -> None:
    there, here = os.pipe()
    with os.fdopen(here, "w") as stream, unhurried(stream) as out:
        assert not out.isatty()
        assert out.writable()
    os.close(there)


def test_what_is_closed_takes_nothing_more() -> None:
    there, here = os.pipe()
    with os.fdopen(here, "w") as stream:
        out = unhurried(stream)
        out.close()
        with pytest.raises(ValueError, match="closed"):
            out.write("too late")
    os.close(there)
