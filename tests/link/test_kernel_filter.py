"""Real sockets on the loopback, where a datagram has arrived as soon as it is sent."""

import socket
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.link.kernel_filter import attach, dropped_by_system, program
from fg_gcs.wire.framing import Sender

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the filter is Linux's")

BEAT = dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 3, 3)
BEATS = [Sender(1, 1).pack(BEAT), bytes(BEAT.pack(dialect.MAVLink(None, 1, 1), force_mavlink1=True))]
OTHERS = [b"", b"x", b"\xfd", b"hello, world", b"\xfe\0" * 20, Sender(1, 154).pack(BEAT), bytes(1000)]


@pytest.fixture
def ports() -> Iterator[list[socket.socket]]:
    with ExitStack() as stack:
        made = [stack.enter_context(socket.socket(type=socket.SOCK_DGRAM)) for _ in range(5)]
        for each in made:
            each.bind(("127.0.0.1", 0))
            each.setblocking(False)
        yield made


def arrived(own: socket.socket) -> Counter[bytes]:
    found: Counter[bytes] = Counter()
    while True:
        try:
            found[own.recv(2000)] += 1
        except BlockingIOError:
            return found


def test_known_addresses_pass_and_of_strangers_heartbeats(ports: list[socket.socket]) -> None:
    own, first, second, *strangers = ports
    assert attach(own, [first.getsockname(), second.getsockname(), ("127.0.0.2", 9)], 1.0)
    for sender, wanted in ((first, BEATS + OTHERS), (second, BEATS + OTHERS), *((each, BEATS) for each in strangers)):
        for data in BEATS + OTHERS:
            sender.sendto(data, own.getsockname())
        assert arrived(own) == Counter(wanted)
    assert dropped_by_system(own) == len(strangers) * len(OTHERS)
    attach(own, None, 0.0)
    strangers[0].sendto(b"x", own.getsockname())
    assert arrived(own) == {b"x": 1}


def test_a_share_of_heartbeats_passes(ports: list[socket.socket]) -> None:
    own, stranger, *_ = ports
    assert attach(own, [], 0.25)
    passed = 0
    for _ in range(100):
        for _ in range(10):
            stranger.sendto(BEATS[0], own.getsockname())
        passed += arrived(own).total()
    assert 150 < passed < 350  # seven standard deviations


def test_there_is_no_filter_for_more_addresses_than_a_filter_can_have(ports: list[socket.socket]) -> None:
    own, known, *_ = ports
    many = [("127.0.0.1", port) for port in range(1, 1001)]
    assert attach(own, [*many, known.getsockname()], 1.0)
    known.sendto(b"x", own.getsockname())
    assert arrived(own) == {b"x": 1}
    assert not attach(own, [(f"10.0.{host}.1", port) for host in range(10) for port in range(1, 300)], 1.0)
    assert not attach(own, [("::1", 5)], 1.0)


@given(addresses=st.lists(st.tuples(st.ip_addresses(v=4).map(str), st.integers(1, 65535)), max_size=50))
def test_no_jump_leaves_the_program(addresses: list[tuple[str, int]]) -> None:
    code = program(addresses, 0.5)
    assert len(code) % 8 == 0
    with socket.socket(type=socket.SOCK_DGRAM) as own:
        assert attach(own, addresses, 0.5)  # the system verifies it
