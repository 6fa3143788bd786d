"""Who speaks to a socket: the addresses that vehicles speak from, and strangers, who get no more than little."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

from fg_gcs.link.endpoint import Address, Endpoint, Wire
from fg_gcs.wire.address import VehicleAddress
from fg_gcs.wire.codec import Codec
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.signing import Signature
from fg_gcs.wire.vehicle import Vehicle

MOST_STRANGERS: Final = 256  # addresses without a vehicle that are remembered; the one heard longest ago goes first
STRANGERS_BYTES_S: Final = 32e3  # read of all strangers together: garbage of that size takes 3 % of a core
STRANGERS_BURST_BYTES: Final = 64e3  # a thousand vehicles that say their first word at once, and somewhat more
VEHICLE_BYTES_S: Final = 100e3  # of each vehicle behind an address: real PX4 sends 370 messages a second, 17 kB
VEHICLE_BURST_BYTES: Final = 512e3  # parameter lists come at once, 50 kB, and twice what is read of a TCP connection
MOST_WAITING: Final = 512  # datagrams of one address that wait to be read on
_HEARTBEAT_PAYLOAD_BYTES: Final = 9
_HEARTBEAT_BYTES: Final = 34  # the longest frame that is a heartbeat: MAVLink 2, signed


class TokenBucket:
    """A budget that fills at a rate, up to a burst; knows no clock.

    It is filled only when it is empty, because it is asked for every message: in t seconds it gives at most two bursts
    and what comes in t.

    Args:
        burst: The most that it holds; it begins full.
    """

    __slots__ = ("_at_s", "_burst", "_left")

    def __init__(self, burst: float) -> None:
        self._left = self._burst = burst
        self._at_s = 0.0  # when it was filled

    def take(self, amount: float, rate_s: float, now_s: float) -> bool:
        """Take so much out of it if it is there; tell whether it was.

        Args:
            amount: How much.
            rate_s: How much comes in each second.
            now_s: Loop time [s].
        """
        left = self._left - amount
        if left < 0.0:
            self._left = min(self._left + rate_s * (now_s - self._at_s), self._burst)
            self._at_s = now_s
            left = self._left - amount
            if left < 0.0:
                return False
        self._left = left
        return True


@dataclass(slots=True, eq=False)
class Peer:
    """One remote address: its own decoder, its own sequence numbers and its own budget.

    Attributes:
        vehicles: Those that speak from here, by their system ids.
        waiting: What has come and is not read yet, behind what the codec has begun.
        told: People were told that it sends too much.
        budget: How many bytes of it are read, if it is known [bytes].
        rate_s: How many of them come in each second [bytes/s].
    """

    network: str
    wire: Wire
    address: Address
    codec: Codec = field(init=False)
    sender: Sender = field(default_factory=Sender)
    vehicles: dict[int, Vehicle] = field(default_factory=dict)
    waiting: deque[bytes] = field(default_factory=deque)
    told: bool = False
    budget: TokenBucket = field(init=False)
    rate_s: float = VEHICLE_BYTES_S

    def __post_init__(self) -> None:
        """Make the decoder that the wire needs."""
        self.codec = Codec(datagrams=not self.wire.endpoint.kind.is_stream)
        self.budget = TokenBucket(VEHICLE_BURST_BYTES)

    @property
    def name(self) -> str:
        """Its address for people; a device has a rate in place of a port."""
        host, port = self.address[:2]
        return f"{host}:{port}"


class Peers:
    """The addresses that are known: those that count for as long as they do, and of the strangers the latest.

    Args:
        signatures: What signs our frames, by the endpoint; none: those there are not signed.

    Attributes:
        known: Those that we call first, and those with vehicles that count, by wire (its id) and address.
    """

    def __init__(self, signatures: Mapping[Endpoint, Signature] = MappingProxyType({})) -> None:
        self._signatures = signatures
        self.known: dict[tuple[int, Address], Peer] = {}
        self._strangers: dict[tuple[int, Address], Peer] = {}  # the one heard longest ago first
        self._strangers_budget = TokenBucket(STRANGERS_BURST_BYTES)
        self._counting: frozenset[VehicleAddress] | None = None  # None: all vehicles count
        self._gone_frames = self._gone_bad_bytes = self._gone_unknown = 0  # of those that were forgotten

    def __iter__(self) -> Iterator[Peer]:
        """Yield all of them."""
        yield from self.known.values()
        yield from self._strangers.values()

    def new(self, network: str, wire: Wire, address: Address) -> Peer:
        """Return a peer that was never heard before."""
        return Peer(network, wire, address, Sender(signature=self._signatures.get(wire.endpoint)))

    def stranger(self, network: str, wire: Wire, address: Address) -> Peer:
        """Return the peer at an address that is not known; the stranger heard longest ago may be forgotten for it."""
        key = (id(wire), address)
        peer = self._strangers.pop(key, None) or self.new(network, wire, address)
        self._strangers[key] = peer
        if len(self._strangers) > MOST_STRANGERS:
            self._forget(self._strangers.pop(next(iter(self._strangers))))
        return peer

    def settle(self, peer: Peer) -> None:
        """Keep a peer among the known ones, or among the strangers, as it is now."""
        key = (id(peer.wire), peer.address)
        peer.rate_s = VEHICLE_BYTES_S * max(len(peer.vehicles), 1)
        here, there = self.known, self._strangers
        if peer.wire.remote is not None or any(self._counts(vehicle) for vehicle in peer.vehicles.values()):
            here, there = there, here
        here.pop(key, None)
        there[key] = peer

    def count_only(self, addresses: Iterable[VehicleAddress]) -> None:
        """Let only these vehicles count from now on: whoever else speaks is a stranger."""
        self._counting = frozenset(addresses)
        for peer in list(self):
            self.settle(peer)

    def readable(self, data: bytes, now_s: float) -> bytes:
        """Return as much of what a stranger has sent as is read: all, a heartbeat that it begins with, or nothing.

        However many strangers there are and whatever they send, a vehicle that begins to speak is heard.

        Args:
            data: What it has sent.
            now_s: Loop time [s].
        """
        if self._strangers_budget.take(len(data), STRANGERS_BYTES_S, now_s):
            return data
        return data[:_HEARTBEAT_BYTES] if _begins_with_heartbeat(data) else b""

    @property
    def frames(self) -> int:
        """Good frames so far, unknown ones included."""
        return self._gone_frames + sum(peer.codec.frames for peer in self)

    @property
    def bad_bytes(self) -> int:
        """Bytes that belonged to no good frame."""
        return self._gone_bad_bytes + sum(peer.codec.bad_bytes for peer in self)

    @property
    def unknown_messages(self) -> int:
        """Frames whose message the dialect does not know."""
        return self._gone_unknown + sum(peer.codec.unknown_messages for peer in self)

    def _counts(self, vehicle: Vehicle) -> bool:
        return self._counting is None or vehicle.address in self._counting

    def _forget(self, peer: Peer) -> None:
        peer.waiting.clear()
        peer.codec.restart()
        self._gone_frames += peer.codec.frames
        self._gone_bad_bytes += peer.codec.bad_bytes
        self._gone_unknown += peer.codec.unknown_messages


def _begins_with_heartbeat(data: bytes) -> bool:
    """Tell by its header whether a datagram begins with the heartbeat of an autopilot: component 1, message 0."""
    if data[:1] == b"\xfd":
        return data[6:10] == b"\x01\0\0\0" and data[1] <= _HEARTBEAT_PAYLOAD_BYTES
    return data[:2] == bytes((0xFE, _HEARTBEAT_PAYLOAD_BYTES)) and data[4:6] == b"\x01\0"
