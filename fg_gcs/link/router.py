"""From sockets to vehicles and back: each message leaves once, to the address its vehicle was heard from."""

import asyncio
import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Final, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from fg_gcs.link.clock import ticks
from fg_gcs.link.endpoint import Address, Change, Endpoint, Wire, in_rows, open_wire
from fg_gcs.wire import commands
from fg_gcs.wire.address import VehicleAddress
from fg_gcs.wire.autopilots import profile_of
from fg_gcs.wire.codec import GCS_SYSTEM, Codec, Frame, Message, is_known
from fg_gcs.wire.framing import Frames, Sender, laid_out
from fg_gcs.wire.messages import HEARTBEAT
from fg_gcs.wire.vehicle import LOST_AFTER_S, Vehicle

MOST_PEERS: Final = 2048  # addresses kept, twice a thousand vehicles; a flood of made-up senders fills no memory
_AUTOPILOT: Final = 1  # component id
_MOST_AT_ONCE: Final = 50  # heartbeats sent, or vehicles looked at, before others have their turn: half a millisecond

_Item = TypeVar("_Item")


class Direction(Enum):
    """Which way a frame went."""

    IN = "in"
    OUT = "out"


Tap = Callable[[Direction, Sequence[bytes], float], None]
OnFrame = Callable[[Vehicle, Frame, float], None]


class Counters(NamedTuple):
    """What went through a router so far.

    Attributes:
        frames_in: Good frames, unknown messages included.
        frames_out: Frames sent.
        bad_bytes: Bytes that belonged to no good frame.
        unknown_messages: Frames whose message the dialect does not know.
        dropped: Frames not sent because the way out was full or closed.
        unroutable: Frames for a vehicle that was never heard.
        clashes: Frames ignored because their vehicle is already heard from elsewhere in its network.
        errors: Errors the system reported for our sockets.
    """

    frames_in: int
    frames_out: int
    bad_bytes: int
    unknown_messages: int
    dropped: int
    unroutable: int
    clashes: int
    errors: int

    @classmethod
    def none(cls) -> Self:
        """Return those of a router that never opened."""
        return cls(*[0] * len(cls._fields))


@dataclass(slots=True, eq=False)
class Peer:
    """One remote address: its own decoder and its own sequence numbers.

    Attributes:
        vehicles: Those that speak from here, by their system ids.
    """

    network: str
    wire: Wire
    address: Address
    codec: Codec = field(default_factory=Codec)
    sender: Sender = field(default_factory=Sender)
    vehicles: dict[int, Vehicle] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Routes:
    """The ways to some vehicles, each to where its vehicle was heard.

    Attributes:
        addresses: Of the vehicles.
        senders: What numbers the frames to each of them; for `fg_gcs.wire.setpoint.SetpointRound`.
        rounds: For each wire the vehicles' places among the addresses (None: all of them), and what sends to them.
    """

    addresses: tuple[VehicleAddress, ...]
    senders: list[Sender]
    rounds: Sequence[tuple[NDArray[np.int_] | None, Callable[[Frames], None]]]

    @classmethod
    def of(cls, addresses: tuple[VehicleAddress, ...], peers: Sequence[Peer]) -> Self:
        """Return the ways to vehicles that are heard from these peers."""
        by_wire: dict[Wire, list[int]] = {}
        for place, peer in enumerate(peers):
            by_wire.setdefault(peer.wire, []).append(place)
        rounds = [
            (None if len(by_wire) == 1 else np.array(places), wire.round_to([peers[place].address for place in places]))
            for wire, places in by_wire.items()
        ]
        return cls(addresses, [peer.sender for peer in peers], rounds)


class Router:
    """Owns the sockets, learns where each vehicle is, and keeps its state; open one with `Router.open`.

    Attributes:
        vehicles: Every vehicle heard so far. The same system id in two networks is two vehicles.
        turned_s: The loop time of the newest sign of life of `keep_alive` [s].
        notices: Lines for people, such as a lost connection, or two vehicles with one address (said once).
    """

    def __init__(self, time: Callable[[], float], on_frame: OnFrame | None, tap: Tap | None) -> None:
        self.vehicles: dict[VehicleAddress, Vehicle] = {}
        self.notices: deque[str] = deque(maxlen=64)
        self.turned_s = -math.inf
        self._on_frame = on_frame
        self._tap = tap
        self._wires: list[Wire] = []
        self._peers: dict[tuple[int, Address], Peer] = {}  # by wire (its id) and address
        self._routes: dict[VehicleAddress, Peer] = {}
        self._latest: Routes | None = None  # of the last round, while no vehicle has moved
        self._clashing: set[VehicleAddress] = set()
        self._frames_out = self._unroutable = self._clashes = 0
        self._time = time

    @classmethod
    async def open(
        cls, networks: Mapping[str, Iterable[Endpoint]], *, on_frame: OnFrame | None = None, tap: Tap | None = None
    ) -> Self:
        """Open all endpoints of all networks.

        Args:
            networks: Where vehicles are to be found, by the name of the network.
            on_frame: Gets every message of every vehicle, after the vehicle took it, with the loop time [s].
            tap: Gets all frames of both directions, unknown ones included, together those that pass together, with the
                loop time [s]: the recorder.

        Raises:
            LinkError: A port is taken, or a connection is refused; nothing stays open.
        """
        router = cls(asyncio.get_running_loop().time, on_frame, tap)
        try:
            for network, endpoints in networks.items():
                for endpoint in endpoints:
                    wire = await open_wire(endpoint, partial(router._receive, network), router._changed)
                    router._wires.append(wire)
                    if wire.remote is not None:
                        router._peer(network, wire, wire.remote)
        except BaseException:
            router.close()
            raise
        return router

    @property
    def counters(self) -> Counters:
        """What went through so far."""
        codecs = [peer.codec for peer in self._peers.values()]
        return Counters(
            frames_in=sum(codec.frames for codec in codecs),
            frames_out=self._frames_out,
            bad_bytes=sum(codec.bad_bytes for codec in codecs),
            unknown_messages=sum(codec.unknown_messages for codec in codecs),
            dropped=sum(wire.dropped for wire in self._wires),
            unroutable=self._unroutable,
            clashes=self._clashes,
            errors=sum(wire.errors for wire in self._wires),
        )

    def routes(self, addresses: tuple[VehicleAddress, ...]) -> Routes:
        """Return the ways to these vehicles as they are now; to be asked for each round, as vehicles move.

        Raises:
            KeyError: One of them was never heard.
        """
        if self._latest is None or self._latest.addresses != addresses:
            self._latest = Routes.of(addresses, [self._routes[address] for address in addresses])
        return self._latest

    def send_all(self, routes: Routes, frames: Frames) -> None:
        """Send each vehicle its own frame, once.

        Args:
            routes: The ways to the vehicles, see `routes`.
            frames: Packed by the routes' senders, shape (V, size).
        """
        for places, send in routes.rounds:
            send(frames if places is None else frames[places])
        self._frames_out += len(frames)
        if self._tap is not None and len(frames):
            self._tap(Direction.OUT, in_rows(frames), self._time())

    def send_message(self, address: VehicleAddress, message: Message) -> None:
        """Pack a message and send it to one vehicle."""
        peer = self._routes.get(address)
        if peer is None:
            self._unroutable += 1
        else:
            self._send(peer, peer.sender.pack(message))

    async def keep_alive(self, period_s: float = 1.0) -> None:
        """Send heartbeats and notice silent vehicles, for ever: run it as a task.

        Heartbeats go to every address that a vehicle speaks from, and to whom we are to call first. A thousand take ten
        milliseconds: after every few of them, whoever else is due has a turn.

        Args:
            period_s: Autopilots want one heartbeat a second.
        """
        heartbeat = laid_out(commands.heartbeat())
        async for _, late_s in ticks(self._time(), period_s):
            self.turned_s = self._time()
            called = [peer for peer in self._peers.values() if peer.wire.remote is not None]
            for some in _batches(list(dict.fromkeys([*self._routes.values(), *called]))):
                for peer in some:
                    self._send(peer, peer.sender.finish(*heartbeat))
                await asyncio.sleep(0.0)
            if late_s > LOST_AFTER_S / 2:  # this program stood still: what vehicles said meanwhile has yet to be read
                continue
            for vehicles in _batches(list(self.vehicles.values())):
                for vehicle in vehicles:
                    vehicle.watch(self._time())
                await asyncio.sleep(0.0)

    def tell_shortages(self) -> None:
        """Tell people of buffers that are too small for the vehicles heard so far; once, when all of them are."""
        vehicles = Counter(peer.wire for peer in self._routes.values())
        for wire, count in vehicles.items():
            self.notices.extend(wire.shortages(count))

    def close(self) -> None:
        """Close all sockets; may be called twice."""
        for wire in self._wires:
            wire.close()

    def _send(self, peer: Peer, data: bytes) -> None:
        peer.wire.send(data, peer.address)
        self._frames_out += 1
        if self._tap is not None:
            self._tap(Direction.OUT, (data,), self._time())

    def _peer(self, network: str, wire: Wire, address: Address) -> Peer | None:
        key = (id(wire), address)
        peer = self._peers.get(key)
        if peer is None and len(self._peers) < MOST_PEERS:
            peer = self._peers[key] = Peer(network, wire, address)
        return peer

    def _changed(self, wire: Wire, change: Change) -> None:
        """Tell people of a connection that broke or stands again; no message begins in one and ends in the next."""
        self.notices.append(f"{wire.endpoint}: {change.value}")
        for peer in self._peers.values():
            if peer.wire is wire:
                peer.codec.restart()

    def _receive(self, network: str, wire: Wire, address: Address, data: bytes) -> None:
        peer = self._peers.get((id(wire), address)) or self._peer(network, wire, address)
        if peer is None:
            return
        now_s, frames = self._time(), peer.codec.receive(data)
        if self._tap is not None and frames:
            self._tap(Direction.IN, [frame.raw for frame in frames], now_s)
        for frame in frames:
            if frame.component_id == _AUTOPILOT and is_known(frame):
                vehicle = peer.vehicles.get(frame.system_id) or self._found(peer, frame, now_s)
                if vehicle is not None:
                    vehicle.handle(frame, now_s)
                    if self._on_frame is not None:
                        self._on_frame(vehicle, frame, now_s)

    def _found(self, peer: Peer, frame: Frame, now_s: float) -> Vehicle | None:
        """Return the vehicle of an autopilot that was not heard from this peer before; a heartbeat makes one."""
        address = VehicleAddress(peer.network, frame.system_id)
        vehicle = self.vehicles.get(address)
        if vehicle is not None:
            return vehicle if self._moved(vehicle, peer, frame, now_s) else None
        if frame.system_id in (0, GCS_SYSTEM) or frame.message_id != HEARTBEAT:
            return None
        profile = profile_of(frame.fields())
        if profile is None:
            return None
        vehicle = self.vehicles[address] = peer.vehicles[frame.system_id] = Vehicle(address, profile, now_s)
        self._routes[address] = peer
        return vehicle

    def _moved(self, vehicle: Vehicle, peer: Peer, frame: Frame, now_s: float) -> bool:
        """Tell whether a vehicle speaks from a new address now; while the old one is alive, it is another vehicle."""
        if now_s - vehicle.heard_at_s > LOST_AFTER_S and frame.message_id == HEARTBEAT:
            del self._routes[vehicle.address].vehicles[vehicle.system_id]
            peer.vehicles[vehicle.system_id] = vehicle
            self._routes[vehicle.address] = peer
            self._latest = None
            return True
        self._clashes += 1
        if vehicle.address not in self._clashing:
            self._clashing.add(vehicle.address)
            host, port = peer.address
            self.notices.append(
                f"two vehicles have the system id {vehicle.address}: the one at {host}:{port} is ignored"
            )
        return False


def _batches(items: Sequence[_Item]) -> Iterator[Sequence[_Item]]:
    """Yield items in their order, so many at once that nothing else waits long."""
    for start in range(0, len(items), _MOST_AT_ONCE):
        yield items[start : start + _MOST_AT_ONCE]
