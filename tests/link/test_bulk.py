"""A round of datagrams in one call of the system: the same as one call for each."""

import errno
import socket

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fg_gcs.link.bulk import Bulk, Send, bulk_send_of


@pytest.fixture(scope="module")
def send() -> Send:
    found = bulk_send_of()
    if found is None:
        pytest.skip("this system has no call for many datagrams")
    return found


def numbered(count: int, size: int) -> NDArray[np.uint8]:
    frames = np.zeros((count, size), np.uint8)
    frames[:, 0], frames[:, 1] = np.arange(count) % 256, np.arange(count) // 256
    return frames


@given(ways=st.lists(st.integers(0, 4), min_size=1, max_size=40), size=st.integers(2, 280))
def test_each_frame_reaches_its_own_address_once_and_in_order(send: Send, ways: list[int], size: int) -> None:
    ends = [socket.socket(type=socket.SOCK_DGRAM) for _ in range(5)]
    with socket.socket(type=socket.SOCK_DGRAM) as ours:
        for end in ends:
            end.bind(("127.0.0.1", 0))
            end.setblocking(False)
        ours.setblocking(False)
        bulk, frames = Bulk(send, [ends[way].getsockname() for way in ways], len(ways)), numbered(len(ways), size)
        for _ in range(2):
            assert bulk.send(ours.fileno(), frames) == []
            for number, end in enumerate(ends):
                for place in np.flatnonzero(np.array(ways) == number):
                    assert end.recv(1000) == frames[place].tobytes()
                with pytest.raises(BlockingIOError):
                    end.recv(1000)
    for end in ends:
        end.close()


def test_more_frames_than_the_system_takes_at_once(send: Send) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as end, socket.socket(type=socket.SOCK_DGRAM) as ours:
        end.bind(("127.0.0.1", 0))
        end.settimeout(5.0)
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        frames = numbered(1500, 4)  # the system's own limit is 1024
        assert Bulk(send, [end.getsockname()] * 1500, 1500).send(ours.fileno(), frames) == []
        got = int(end.recv(10) == frames[0].tobytes())
        end.setblocking(False)
        while got < 1500:
            assert end.recv(10) == frames[got].tobytes()
            got += 1


def test_a_partner_that_is_gone_and_comes_back(send: Send) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as partner, socket.socket(type=socket.SOCK_DGRAM) as ours:
        partner.bind(("127.0.0.1", 0))
        address = partner.getsockname()
        ours.connect(address)
        partner.close()
        bulk, frames = Bulk(send, None, 6), numbered(6, 4)
        for _ in range(3):
            assert set(bulk.send(ours.fileno(), frames)) <= {errno.ECONNREFUSED}
        with socket.socket(type=socket.SOCK_DGRAM) as again:
            again.bind(address)
            again.settimeout(5.0)
            refused = bulk.send(ours.fileno(), frames)  # the system tells of the round before, once
            assert refused in ([], [errno.ECONNREFUSED])
            for frame in frames[len(refused) :]:
                assert again.recv(10) == frame.tobytes()


def test_a_full_way_out_takes_no_more_of_the_round(send: Send) -> None:
    # Datagrams of another kind: unlike those of UDP they are kept until they are read, so that the way can be full
    ours, deaf = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, deaf:
        ours.setblocking(False)
        errors = Bulk(send, None, 5000).send(ours.fileno(), numbered(5000, 200))
        assert 0 < len(errors) < 5000
        assert set(errors) == {errno.EAGAIN}
        for number in range(5000 - len(errors)):
            assert deaf.recv(300) == numbered(5000, 200)[number].tobytes()


def test_a_closed_socket_is_an_error_for_each_and_nothing_more(send: Send) -> None:
    ours = socket.socket(type=socket.SOCK_DGRAM)
    ours.close()
    assert Bulk(send, None, 3).send(ours.fileno(), numbered(3, 4)) == [errno.EBADF] * 3


def test_no_frames_are_no_call(send: Send) -> None:
    assert Bulk(send, [], 0).send(-1, numbered(0, 4)) == []


def test_a_system_without_the_call_is_told_apart() -> None:
    class Library:
        """A C library that has nothing."""

    assert bulk_send_of(Library()) is None
