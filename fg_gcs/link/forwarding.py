"""Telemetry for other programs, such as QGroundControl or a logger, and what they say to vehicles.

Whoever is slow, or not there, misses some of it: what does not leave at once is dropped and counted. Frames pass as
they came, signatures included, some together in a datagram.
"""

from __future__ import annotations

import asyncio
import re
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Final, NamedTuple

from fg_gcs.errors import LinkError
from fg_gcs.link.endpoint import Address, Endpoint, Kind, Wire, parse_endpoint
from fg_gcs.link.opening import open_wire
from fg_gcs.link.peers import TokenBucket
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.addressed import addressee, is_question
from fg_gcs.wire.codec import Codec, Frame
from fg_gcs.wire.signing import SETUP_SIGNING, Signing
from fg_gcs.wire.vehicle import Vehicle

FORMS: Final = "[NAME=]udpout:HOST:PORT or [NAME=]tcp:HOST:PORT"
TOGETHER_BYTES: Final = 1200  # in one datagram: none has to be split on its way, whatever the network
HELD_S: Final = 0.02  # the longest that a frame waits for others
SAID_BYTES_S: Final = 20e3  # read of one receiver: a joystick and a few questions are a tenth of it
SAID_BURST_BYTES: Final = 64e3

_NAMED: Final = re.compile(r"\s*(?:(?P<network>[a-z0-9_-]{1,16})\s*=)?(?P<endpoint>.*)", re.DOTALL)


class Forwards(NamedTuple):
    """Who gets telemetry.

    Attributes:
        receivers: By the network whose vehicles they see.
        passes_commands: What they say reaches vehicles, each of which is theirs from then on.
    """

    receivers: Mapping[str, Sequence[Endpoint]]
    passes_commands: bool


@dataclass(slots=True)
class ForwardCounts:
    """What was passed on so far.

    Attributes:
        forwarded: Frames of vehicles, once for each receiver.
        not_forwarded: Those that a receiver missed.
        commands_passed: Frames of receivers to vehicles, questions included.
        commands_dropped: Those that were not passed on.
    """

    forwarded: int = 0
    not_forwarded: int = 0
    commands_passed: int = 0
    commands_dropped: int = 0


def parse_forwards(texts: Sequence[str], networks: Mapping[str, Collection[Endpoint]]) -> dict[str, list[Endpoint]]:
    """Return the receivers of each network, from texts ``[NAME=]ENDPOINT``; with one network names mean nothing.

    Args:
        texts: as people give them.
        networks: where the vehicles of each network are; nowhere that is known: its endpoints are empty.

    Raises:
        LinkError: A text is at fault; says what is accepted.
    """
    found: dict[str, list[Endpoint]] = {}
    own = {endpoint for endpoints in networks.values() for endpoint in endpoints}
    for text in texts:
        match = _NAMED.fullmatch(text)
        assert match is not None  # anything is an endpoint so far
        network = MAIN if set(networks) == {MAIN} else match["network"]
        if network not in networks:
            raise LinkError(f"{text!r} names no network; accepted: NAME=ENDPOINT with {' or '.join(networks)}")
        endpoint = parse_endpoint(match["endpoint"])
        if endpoint.kind not in (Kind.UDP_OUT, Kind.TCP):
            raise LinkError(f"{text!r} is not of the form {FORMS}")
        if any(endpoint.port == one.port and one.kind in (Kind.UDP_IN, endpoint.kind) for one in own):
            raise LinkError(f"{text!r}: vehicles are heard at port {endpoint.port}; another program needs another one")
        if endpoint in found.get(network, ()):
            raise LinkError(f"{text!r} occurs twice")
        found.setdefault(network, []).append(endpoint)
    return found


@dataclass(slots=True, eq=False)
class _Receiver:
    """One program.

    Attributes:
        network: That it sees.
        wire: To it.
        codec: Of what it says.
        budget: Of what is read of it [bytes].
        told: People were told that what it says is not passed on.
    """

    network: str
    wire: Wire
    codec: Codec = field(init=False)
    budget: TokenBucket = field(default_factory=lambda: TokenBucket(SAID_BURST_BYTES))
    told: bool = False

    def __post_init__(self) -> None:
        """Make the decoder that the wire needs."""
        self.codec = Codec(datagrams=not self.wire.endpoint.kind.is_stream)

    def send(self, data: bytes) -> bool:
        """Send bytes; tell whether they left."""
        wire = self.wire
        before = wire.dropped + wire.errors
        if wire.remote is not None:
            wire.send(data, wire.remote)
        return wire.dropped + wire.errors == before


@dataclass(slots=True, eq=False)
class _Waiting:
    """Frames of one network that wait for each other."""

    frames: list[bytes] = field(default_factory=list)
    size: int = 0
    timer: asyncio.TimerHandle | None = None


class Forwarder:
    """Passes telemetry on; open it with `open`.

    Args:
        wish: Who gets what.
        vehicles: All that are known.
        pass_on: Sends a frame to a vehicle as it is.
        notices: Lines for people.
        signing: Of networks with a key: what is said to their vehicles must be signed with it.

    Attributes:
        counts: What was passed on so far.
    """

    def __init__(
        self,
        wish: Forwards,
        vehicles: Mapping[VehicleAddress, Vehicle],
        pass_on: Callable[[VehicleAddress, bytes], None],
        notices: deque[str],
        signing: Mapping[str, Signing],
    ) -> None:
        self.counts = ForwardCounts()
        self._wish = wish
        self._vehicles = vehicles
        self._pass_on = pass_on
        self._notices = notices
        self._signing = signing
        self._loop = asyncio.get_running_loop()
        self._receivers: dict[str, list[_Receiver]] = {}
        self._waiting: dict[str, _Waiting] = {}
        self._handed_over: set[VehicleAddress] = set()  # of which people know

    async def open(self) -> None:
        """Open the ways to all receivers.

        Raises:
            LinkError: One cannot be opened; `close` closes the others.
        """
        for network, endpoints in self._wish.receivers.items():
            self._waiting[network], self._receivers[network] = _Waiting(), []
            for endpoint in endpoints:
                wire = await open_wire(endpoint, partial(self._said, network))
                self._receivers[network].append(_Receiver(network, wire))

    def take(self, network: str, frames: Sequence[Frame]) -> None:
        """Pass on those frames that come from vehicles."""
        waiting = self._waiting.get(network)
        if waiting is None:
            return
        vehicles = self._vehicles
        for frame in frames:
            if (network, frame.system_id) in vehicles:  # an address is a tuple: none has to be made
                if waiting.size + len(frame.raw) > TOGETHER_BYTES:
                    self._flush(network)
                    waiting = self._waiting[network]
                waiting.frames.append(frame.raw)
                waiting.size += len(frame.raw)
        if waiting.frames and waiting.timer is None:
            waiting.timer = self._loop.call_later(HELD_S, self._flush, network)

    def close(self) -> None:
        """Send what waits and close all ways; may be called twice."""
        for network, receivers in self._receivers.items():
            self._flush(network)
            for receiver in receivers:
                receiver.wire.close()
        self._receivers.clear()
        self._waiting.clear()

    def _flush(self, network: str) -> None:
        waiting = self._waiting[network]
        if waiting.timer is not None:
            waiting.timer.cancel()
        self._waiting[network] = _Waiting()
        if not waiting.frames:
            return
        data, count = b"".join(waiting.frames), len(waiting.frames)
        for receiver in self._receivers[network]:
            if receiver.send(data):
                self.counts.forwarded += count
            else:
                self.counts.not_forwarded += count

    def _said(self, network: str, wire: Wire, _address: Address, data: bytes) -> None:
        """Take what a receiver says."""
        receiver = next((one for one in self._receivers[network] if one.wire is wire), None)
        if receiver is None:  # it speaks before it is open to us
            return
        if not receiver.budget.take(len(data), SAID_BYTES_S, self._loop.time()):
            self.counts.commands_dropped += 1
            return
        for frame in receiver.codec.receive(data):
            target = addressee(frame)
            if target is not None:
                refusal = self._refusal(receiver, frame, target)
                if refusal:
                    self.counts.commands_dropped += 1
                    if not receiver.told:
                        receiver.told = True
                        self._notices.append(f"{wire.endpoint}: what it says to vehicles is not passed on: {refusal}")
                else:
                    self._pass(receiver, frame, VehicleAddress(network, target))

    def _refusal(self, receiver: _Receiver, frame: Frame, target: int) -> str:
        """Return why a frame does not reach a vehicle; empty: it does."""
        if not self._wish.passes_commands:
            return "the mission does not allow it ([swarm] forward_commands)"
        if frame.message_id == SETUP_SIGNING:
            return "keys are given over links of their own"
        signing = self._signing.get(receiver.network)
        refused = None if signing is None else signing.refusal(frame)
        if refused is not None:
            return f"it is {refused.value}"
        if (receiver.network, target) not in self._vehicles:
            return f"there is no vehicle {target}" if target else "it is for all vehicles at once"
        return ""

    def _pass(self, receiver: _Receiver, frame: Frame, address: VehicleAddress) -> None:
        if not is_question(frame):
            self._vehicles[address].hand_over(self._loop.time())
            if address not in self._handed_over:
                self._handed_over.add(address)
                said = f"{frame.get_type()} came for it from {receiver.wire.endpoint}"
                self._notices.append(f"vehicle {address} is somebody else's from now on: {said}")
        self.counts.commands_passed += 1
        self._pass_on(address, frame.raw)
