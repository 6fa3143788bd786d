import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.link.endpoint import Endpoint, Kind
from fg_gcs.link.peers import MOST_STRANGERS, STRANGERS_BURST_BYTES, STRANGERS_BYTES_S, Peers, TokenBucket
from fg_gcs.link.udp_wire import MemoryWire
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.autopilots import PX4
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.vehicle import Vehicle

WIRE = MemoryWire(Endpoint(Kind.UDP_IN, "127.0.0.1", 14550), lambda wire, address, data: None)


@given(
    burst=st.floats(1.0, 1e5),
    rate_s=st.floats(0.0, 1e5),
    wishes=st.lists(st.tuples(st.floats(0.0, 10.0), st.floats(0.0, 1e4)), max_size=50),
)
def test_a_budget_gives_its_rate_and_its_burst_and_no_more(
    burst: float, rate_s: float, wishes: list[tuple[float, float]]
) -> None:
    bucket, now_s, taken = TokenBucket(burst), 0.0, 0.0
    for after_s, amount in wishes:
        now_s += after_s
        if bucket.take(amount, rate_s, now_s):
            taken += amount
        assert taken <= (2.0 * burst + rate_s * now_s) * (1.0 + 1e-9)


@pytest.mark.parametrize("version", [1, 2])
def test_heartbeats_of_strangers_are_read_whatever_else_came(version: int) -> None:
    peers = Peers()
    assert len(peers.readable(bytes(int(STRANGERS_BURST_BYTES)), 0.0)) == STRANGERS_BURST_BYTES
    packer = dialect.MAVLink(None, 1, 1)
    beat = dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 3, 3).pack(packer, force_mavlink1=version == 1)
    other = Sender(1, 1).pack(dialect.MAVLink_attitude_message(1, 1, 1, 1, 1, 1, 1))
    camera = Sender(1, 100).pack(dialect.MAVLink_heartbeat_message(30, 8, 1, 0, 3, 3))
    assert peers.readable(beat, 0.0) == beat
    assert peers.readable(beat + other * 100, 0.0).startswith(beat)
    assert len(peers.readable(beat + other * 100, 0.0)) < 40
    for data in (other, camera, b"x", b"", b"\xfd", b"\xfe\x09"):
        assert peers.readable(data, 0.0) == b""
    assert peers.readable(other, 1.0) == other


def test_all_strangers_together_are_read_no_more_than_stated() -> None:
    peers, read = Peers(), 0
    for k in range(100_000):
        read += len(peers.readable(b"\xfe\0" * 50, k / 1e4))
    assert read <= 2.0 * STRANGERS_BURST_BYTES + 10.0 * STRANGERS_BYTES_S


def test_a_flood_of_addresses_drives_no_vehicle_out() -> None:
    peers = Peers()
    good = peers.stranger(MAIN, WIRE, ("127.0.0.1", 1))
    good.vehicles[1] = Vehicle(VehicleAddress(MAIN, 1), PX4, 0.0)
    peers.settle(good)
    for port in range(2, 5000):
        peers.stranger(MAIN, WIRE, ("127.0.0.1", port)).codec.receive(b"abc")
    assert len(list(peers)) == MOST_STRANGERS + 1
    assert peers.known == {(id(WIRE), ("127.0.0.1", 1)): good}
    assert peers.bad_bytes == 3 * 4998  # those that were forgotten as well
