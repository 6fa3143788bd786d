"""From sockets to vehicles and back: each message leaves once, to the address its vehicle was heard from."""

import asyncio
import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from functools import partial
from types import MappingProxyType
from typing import Final, NamedTuple, Self, TypeVar

from fg_gcs.link.clock import ticks
from fg_gcs.link.counters import Counters
from fg_gcs.link.endpoint import Address, Change, Endpoint, Wire
from fg_gcs.link.forwarding import ForwardCounts, Forwarder, Forwards
from fg_gcs.link.opening import open_wire
from fg_gcs.link.peers import MOST_WAITING, Peer, Peers
from fg_gcs.link.routes import Routes
from fg_gcs.wire import commands
from fg_gcs.wire.address import VehicleAddress, vehicles_named
from fg_gcs.wire.autopilots import profile_of
from fg_gcs.wire.codec import GCS_SYSTEM, Frame, Message, is_known
from fg_gcs.wire.framing import Frames, as_sent, laid_out, same_for_all
from fg_gcs.wire.messages import HEARTBEAT
from fg_gcs.wire.signing import LINK_IDS, SETUP_SIGNING, Refusal, Signature, Signing
from fg_gcs.wire.timing import timesync
from fg_gcs.wire.vehicle import LOST_AFTER_S, Vehicle

KEEP_ALIVE_S: Final = 0.5  # autopilots want one heartbeat a second; ArduPilot gives up after 5 s, ten lost in a row
CLASH_S: Final = 10.0  # somebody else who has been silent for longer is not there any more
MOST_WORK: Final = 512  # of reading one address's bytes before others have their turn: half a millisecond
FLOOD: Final = 500  # datagrams of strangers within `FLOOD_WINDOW_S`: to read and drop more takes a share of a core
FLOOD_WINDOW_S: Final = 0.1
SHUT_S: Final = 10.0  # strangers are shut out by the system for so long, then it is seen whether they still come
OPEN: Final = 4.0  # a share of heartbeats that says that all else is let in as well; a quarter of it is all of them
STALE_S: Final = 0.02
LEAST_SHARE: Final = 1.0 / 64.0  # of strangers' heartbeats that are let in at least
_TIMESYNC_PEERS: Final = 128  # that are asked for their time in every period; more take turns
_AUTOPILOT: Final = 1  # component id
_MOST_AT_ONCE: Final = 50  # heartbeats sent, or vehicles looked at, before others have their turn: half a millisecond

_Item = TypeVar("_Item")


class Direction(Enum):
    """Which way a frame went."""

    IN = "in"
    OUT = "out"


Tap = Callable[[Direction, Sequence[bytes] | Frames, float], None]  # frames one by one, or in the rows of an array
OnFrame = Callable[[Vehicle, Frame, float], None]


class _Clash(NamedTuple):
    """Somebody else who speaks under a vehicle's id."""

    peer: Peer
    since_s: float
    at_s: float  # the last time


@dataclass(slots=True)
class _Gate:
    """What is let in of strangers at one wire.

    Attributes:
        share: Of their heartbeats, while nothing else is.
        until_s: How long they are shut out.
        count: Their datagrams since a time.
        since_s: That time.
        is_stale: The system does not know yet whom we know.
        timer: For when their time is over.
    """

    share: float = OPEN
    until_s: float = -math.inf
    count: int = 0
    since_s: float = -math.inf
    is_stale: bool = False
    timer: asyncio.TimerHandle | None = None


class _Called(NamedTuple):
    """Who is called all the time.

    Attributes:
        peers: Those that vehicles speak from.
        batches: The ways to them, so many together that nothing else waits long.
    """

    peers: tuple[Peer, ...]
    batches: Sequence[Routes]


class Router:
    """Owns the sockets, learns where each vehicle is, and keeps its state; open one with `Router.open`.

    Attributes:
        vehicles: Every vehicle heard so far. The same system id in two networks is two vehicles.
        turned_s: The loop time of the newest sign of life of `keep_alive` [s].
        notices: Lines for people, such as a lost connection, or two vehicles with one address (said once).
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        on_frame: OnFrame | None,
        tap: Tap | None,
        signing: Mapping[str, Signing] = MappingProxyType({}),
        signatures: Mapping[Endpoint, Signature] = MappingProxyType({}),
    ) -> None:
        self.vehicles: dict[VehicleAddress, Vehicle] = {}
        self.notices: deque[str] = deque(maxlen=64)
        self.turned_s = -math.inf
        self._on_frame = on_frame
        self._tap = tap
        self._wires: list[Wire] = []
        self._signing = signing
        self._peers = Peers(signatures)
        self._forwarder: Forwarder | None = None
        self._not_taken: set[tuple[str, Refusal]] = set()  # of which people know
        self._known = self._peers.known
        self._asked = _Called((), ())  # for their time, by whoever uses this
        self._unfinished: deque[Peer] = deque()  # those of whose bytes some wait to be read on
        self._routes: dict[VehicleAddress, Peer] = {}
        # Of the last round, while no vehicle has moved: the vehicles, and the ways to them
        self._latest: tuple[tuple[VehicleAddress, ...], Routes] | None = None
        self._clashing: dict[VehicleAddress, _Clash] = {}
        self._told: set[VehicleAddress] = set()  # those of which people know that there are two
        self._frames_out = self._unroutable = self._clashes = self._refused = 0
        self._refusal_told = False  # of strangers
        self._gates: dict[Wire, _Gate] = {}
        self._loop = loop
        self._time = loop.time

    @classmethod
    async def open(
        cls,
        networks: Mapping[str, Iterable[Endpoint]],
        *,
        on_frame: OnFrame | None = None,
        tap: Tap | None = None,
        signing: Mapping[str, Signing] = MappingProxyType({}),
        forwards: Forwards | None = None,
    ) -> Self:
        """Open all endpoints of all networks.

        Args:
            networks: Where vehicles are to be found, by the name of the network.
            on_frame: Gets every message of every vehicle, after the vehicle took it, with the loop time [s].
            tap: Gets all frames of both directions, unknown ones included, together those that pass together, with the
                loop time [s]: the recorder. A message that gives a vehicle a key is not among them.
            signing: What signs and judges the frames of a network, by its name; none: they are not signed, and whatever
                comes there is taken.
            forwards: Who else gets telemetry.

        Raises:
            LinkError: A port is taken, or a connection is refused; nothing stays open.
        """
        all_endpoints = {name: tuple(endpoints) for name, endpoints in networks.items()}
        places = ((name, endpoint) for name, endpoints in all_endpoints.items() for endpoint in endpoints)
        signatures = {
            endpoint: signing[name].signature(number % LINK_IDS)
            for number, (name, endpoint) in enumerate(places)
            if name in signing
        }
        router = cls(asyncio.get_running_loop(), on_frame, tap, signing, signatures)
        try:
            for network, endpoints in all_endpoints.items():
                for endpoint in endpoints:
                    wire = await open_wire(endpoint, partial(router._receive, network), router._changed)
                    router._wires.append(wire)
                    if wire.remote is not None:
                        router._peers.settle(router._peers.new(network, wire, wire.remote))
            if forwards is not None:
                router._forwarder = Forwarder(forwards, router.vehicles, router._pass_on, router.notices, signing)
                await router._forwarder.open()
        except BaseException:
            router.close()
            raise
        return router

    @property
    def counters(self) -> Counters:
        """What went through so far."""
        return Counters(
            frames_in=self._peers.frames,
            frames_out=self._frames_out,
            bad_bytes=self._peers.bad_bytes,
            unknown_messages=self._peers.unknown_messages,
            dropped=sum(wire.dropped for wire in self._wires),
            unroutable=self._unroutable,
            clashes=self._clashes,
            errors=sum(wire.errors for wire in self._wires),
            refused=self._refused + sum(wire.unread for wire in self._wires),
            unsigned=self._count_not_taken(Refusal.UNSIGNED),
            forged=self._count_not_taken(Refusal.FORGED),
            replayed=self._count_not_taken(Refusal.REPLAYED),
            **asdict(ForwardCounts() if self._forwarder is None else self._forwarder.counts),
        )

    @property
    def doubled(self) -> dict[VehicleAddress, str]:
        """What tells that two vehicles have one system id in one network, in one line for people; by that address."""
        lines = ((address, self._double_of(vehicle)) for address, vehicle in self.vehicles.items())
        return {address: line for address, line in lines if line is not None}

    def count_only(self, addresses: Iterable[VehicleAddress]) -> None:
        """Let only these vehicles count from now on: what others send is read like strangers' bytes, a little of it."""
        self._peers.count_only(addresses)
        self._gates_are_stale()

    def routes(self, addresses: tuple[VehicleAddress, ...]) -> Routes:
        """Return the ways to these vehicles as they are now; to be asked for each round, as vehicles move.

        Raises:
            KeyError: One of them was never heard.
        """
        if self._latest is None or self._latest[0] != addresses:
            self._latest = addresses, Routes.of([self._routes[address] for address in addresses])
        return self._latest[1]

    def endpoint_of(self, address: VehicleAddress) -> str:
        """Return where a vehicle is heard, as people write it; empty if it was never heard."""
        peer = self._routes.get(address)
        return "" if peer is None else str(peer.wire.endpoint)

    def send_all(self, routes: Routes, frames: Frames) -> None:
        """Send each vehicle its own frame, once.

        Args:
            routes: The ways to the vehicles, see `routes`.
            frames: Packed by the routes' senders, shape (V, size).
        """
        for places, is_shorter, send in routes.rounds:
            own = frames if places is None else frames[places]
            own = as_sent(own) if is_shorter else own
            send(own)
            if self._tap is not None and len(own):
                self._tap(Direction.OUT, own, self._time())
        self._frames_out += len(frames)

    def send_message(self, address: VehicleAddress, message: Message) -> None:
        """Pack a message and send it to one vehicle."""
        peer = self._routes.get(address)
        if peer is None:
            self._unroutable += 1
            return
        is_secret = message.get_msgId() == SETUP_SIGNING  # a key stays with who has it
        self._send(peer, peer.sender.pack(message), None if is_secret else self._tap)

    async def keep_alive(self, period_s: float = KEEP_ALIVE_S) -> None:
        """Send heartbeats, ask for the time and notice silent vehicles, for ever: run it as a task.

        Heartbeats go to every address that a vehicle speaks from, and to whom we are to call first. A thousand take ten
        milliseconds: after every few of them, whoever else is due has a turn.

        Args:
            period_s: How often [s].
        """
        heartbeat = laid_out(commands.heartbeat())
        called = _Called((), ())
        async for k, late_s in ticks(self._time(), period_s):
            self.turned_s = self._time()
            spoken = tuple(dict.fromkeys(self._routes.values()))
            if spoken != called.peers:
                called = _Called(spoken, [Routes.of(some) for some in _batches(spoken)])
            shares = 1 + len(spoken) // _TIMESYNC_PEERS
            for routes in called.batches[k % shares :: shares]:
                self._ask_for_time(routes)
                await asyncio.sleep(0.0)
            silent = [peer for peer in self._known.values() if peer.wire.remote is not None and not peer.vehicles]
            for routes in (*called.batches, *(Routes.of(some) for some in _batches(silent))):
                self.send_all(routes, same_for_all(heartbeat, routes.senders))
                await asyncio.sleep(0.0)
            if late_s > LOST_AFTER_S / 2:  # this program stood still: what vehicles said meanwhile has yet to be read
                continue
            for vehicles in _batches(list(self.vehicles.values())):
                for vehicle in vehicles:
                    self._watch(vehicle)
                await asyncio.sleep(0.0)

    def ask_for_time(self, addresses: Iterable[VehicleAddress]) -> None:
        """Send TIMESYNC requests to vehicles: whoever answers hears us."""
        peers = tuple(dict.fromkeys(self._routes[each] for each in addresses if each in self._routes))
        if peers != self._asked.peers:
            self._asked = _Called(peers, [Routes.of(peers)] if peers else [])
        for routes in self._asked.batches:
            self._ask_for_time(routes)

    def tell_shortages(self) -> None:
        """Tell people of buffers that are too small for the vehicles heard so far; once, when all of them are."""
        vehicles = Counter(peer.wire for peer in self._routes.values())
        for wire, count in vehicles.items():
            self.notices.extend(wire.shortages(count))

    def close(self) -> None:
        """Close all sockets; may be called twice. What was not read yet is not read any more."""
        self._unfinished.clear()
        if self._forwarder is not None:
            self._forwarder.close()
        for wire in self._wires:
            wire.close()

    def _send(self, peer: Peer, data: bytes, tap: Tap | None) -> None:
        peer.wire.send(data, peer.address)
        self._frames_out += 1
        if tap is not None:
            tap(Direction.OUT, (data,), self._time())

    def _pass_on(self, address: VehicleAddress, data: bytes) -> None:
        """Send a vehicle what another program says to it (the forwarder calls this)."""
        self._send(self._routes[address], data, self._tap)

    def _ask_for_time(self, routes: Routes) -> None:
        now_s = self._time()
        said_ns = round(now_s * 1e9)
        self.send_all(routes, same_for_all(laid_out(timesync(said_ns)), routes.senders))
        for peer in routes.peers:
            for vehicle in peer.vehicles.values():
                vehicle.timing.asked(said_ns, now_s)

    def _watch(self, vehicle: Vehicle) -> None:
        """Notice what only time shows: silence, losses, another vehicle under the same id."""
        now_s = self._time()
        vehicle.watch(now_s)
        vehicle.timing.roll(now_s)
        line = None if vehicle.address in self._told else self._double_of(vehicle)
        if line is not None:
            self._told.add(vehicle.address)
            self.notices.append(line)

    def _double_of(self, vehicle: Vehicle) -> str | None:
        """Return what tells that another vehicle speaks under the same id now, in one line for people."""
        address, clash = vehicle.address, self._clashing.get(vehicle.address)
        if clash is not None and self._time() - clash.at_s < CLASH_S and vehicle.heard_at_s > clash.since_s:
            return (
                f"two vehicles have the system id {address}: at {self._routes[address].name} and at {clash.peer.name}"
            )
        reason = vehicle.timing.doubled
        if reason is None:
            return None
        return f"two vehicles have the system id {address}, both at {self._routes[address].name}: {reason}"

    def _changed(self, wire: Wire, change: Change) -> None:
        """Tell people of a connection that broke or stands again; no message begins in one and ends in the next."""
        self.notices.append(f"{wire.endpoint}: {change.value}")
        for peer in self._peers:
            if peer.wire is wire:
                peer.codec.restart()
                peer.waiting.clear()

    def _receive(self, network: str, wire: Wire, address: Address, data: bytes) -> None:
        now_s, peer = self._time(), self._known.get((id(wire), address))
        if peer is None:
            self._count_stranger(wire, now_s)
            peer, size = self._peers.stranger(network, wire, address), len(data)
            data = self._peers.readable(data, now_s)
            if len(data) < size:
                self._refuse(peer)
        elif not peer.budget.take(len(data), peer.rate_s, now_s):
            self._refuse(peer)
            return
        if peer.codec.waiting or peer.waiting:
            if len(peer.waiting) < MOST_WAITING:
                peer.waiting.append(data)
            else:
                self._refuse(peer)
            return
        self._take(peer, peer.codec.receive(data, MOST_WORK), now_s)
        if peer.codec.waiting:
            self._put_off(peer)

    def _count_stranger(self, wire: Wire, now_s: float) -> None:
        """Count a stranger's datagram; if there are too many, let the system drop them, and then heartbeats as well."""
        gate = self._gates.get(wire)
        if gate is None:
            gate = self._gates[wire] = _Gate()
        if now_s - gate.since_s >= FLOOD_WINDOW_S:
            gate.since_s, gate.count = now_s, 0
        gate.count += 1
        if gate.count == FLOOD:
            gate.share = max(gate.share / 4.0, LEAST_SHARE)
            gate.until_s = now_s + SHUT_S
            self._shut(wire, gate)

    def _shut(self, wire: Wire, gate: _Gate) -> None:
        """Let the system drop what strangers send, and let them in again when their time is over."""
        gate.is_stale = False
        if gate.until_s > self._time():
            wire.admit_only([peer.address for peer in self._known.values() if peer.wire is wire], gate.share)
            if gate.timer is not None:
                gate.timer.cancel()
            gate.timer = self._loop.call_at(gate.until_s, self._shut, wire, gate)
        elif gate.share != OPEN:
            gate.share = OPEN
            wire.admit_only(None, 0.0)

    def _gates_are_stale(self) -> None:
        """Let those through soon that have become known, all who do about now at once."""
        for wire, gate in self._gates.items():
            if gate.share != OPEN and not gate.is_stale:
                gate.is_stale = True
                self._loop.call_later(STALE_S, self._shut, wire, gate)

    def _put_off(self, peer: Peer) -> None:
        """Read a peer's bytes on after others have had their turn."""
        if not self._unfinished:
            self._loop.call_soon(self._go_on)
        self._unfinished.append(peer)

    def _go_on(self) -> None:
        """Read some more of the bytes that wait (the loop calls this)."""
        if not self._unfinished:  # closed
            return
        peer = self._unfinished.popleft()
        if peer.codec.waiting or peer.waiting:
            data = b"" if peer.codec.waiting else peer.waiting.popleft()
            self._take(peer, peer.codec.receive(data, MOST_WORK), self._time())
        if peer.codec.waiting or peer.waiting:
            self._unfinished.append(peer)
        if self._unfinished:
            self._loop.call_soon(self._go_on)

    def _refuse(self, peer: Peer) -> None:
        """Count what is not read; tell people once of each address with vehicles, and once of strangers."""
        self._refused += 1
        if peer.vehicles and not peer.told:
            peer.told = True
            speakers = vehicles_named(vehicle.address for vehicle in peer.vehicles.values())
            self.notices.append(f"too much comes from {speakers} at {peer.name}: some of it is not read")
        elif not peer.vehicles and not self._refusal_told:
            self._refusal_told = True
            self.notices.append(f"too much comes from strangers such as {peer.name}: only heartbeats are read of it")

    def _count_not_taken(self, refusal: Refusal) -> int:
        return sum(signing.counts[refusal] for signing in self._signing.values())

    def _judged(self, signing: Signing, peer: Peer, frames: list[Frame]) -> list[Frame]:
        """Return the frames that are signed as they should be; tell people of others, once of each kind."""
        good = []
        for frame in frames:
            refusal = signing.refusal(frame)
            if refusal is None:
                good.append(frame)
            elif (peer.network, refusal) not in self._not_taken:
                self._not_taken.add((peer.network, refusal))
                self.notices.append(f"what comes from {peer.name} is {refusal.value}: it is not taken")
        return good

    def _take(self, peer: Peer, frames: list[Frame], now_s: float) -> None:
        signing = self._signing.get(peer.network)
        if signing is not None:
            frames = self._judged(signing, peer, frames)
        if self._tap is not None and frames:
            self._tap(Direction.IN, [frame.raw for frame in frames], now_s)
        for frame in frames:
            if frame.component_id != _AUTOPILOT:
                continue
            vehicle = peer.vehicles.get(frame.system_id) or self._found(peer, frame, now_s)
            if vehicle is not None:
                vehicle.timing.sequence.add(frame.get_seq(), frame.raw[-2:], now_s)
                if is_known(frame):
                    vehicle.handle(frame, now_s)
                    if self._on_frame is not None:
                        self._on_frame(vehicle, frame, now_s)
        if self._forwarder is not None:
            self._forwarder.take(peer.network, frames)

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
        self._peers.settle(peer)
        self._gates_are_stale()
        return vehicle

    def _moved(self, vehicle: Vehicle, peer: Peer, frame: Frame, now_s: float) -> bool:
        """Tell whether a vehicle speaks from a new address now; while the old one is alive, it is another vehicle."""
        before = self._routes[vehicle.address]
        again = before.wire is peer.wire and before.address == peer.address  # it was forgotten among strangers
        is_gone = now_s - vehicle.heard_at_s > LOST_AFTER_S or not before.wire.reaches(before.address)
        if again or (is_gone and frame.message_id == HEARTBEAT):
            before.vehicles.pop(vehicle.system_id, None)
            if not again:
                self._peers.settle(before)
            peer.vehicles[vehicle.system_id] = vehicle
            self._routes[vehicle.address] = peer
            self._peers.settle(peer)
            self._latest = None
            self._clashing.pop(vehicle.address, None)
            self._gates_are_stale()
            return True
        self._clashes += 1
        clash = self._clashing.get(vehicle.address)
        if clash is None or now_s - clash.at_s >= CLASH_S:
            clash = _Clash(peer, now_s, now_s)
        self._clashing[vehicle.address] = clash._replace(at_s=now_s)
        if vehicle.address not in self._told:
            self._told.add(vehicle.address)
            line = f"two vehicles have the system id {vehicle.address}: the one at {peer.name} is ignored"
            self.notices.append(line)
        return False


def _batches(items: Sequence[_Item]) -> Iterator[Sequence[_Item]]:
    """Yield items in their order, so many at once that nothing else waits long."""
    for start in range(0, len(items), _MOST_AT_ONCE):
        yield items[start : start + _MOST_AT_ONCE]
