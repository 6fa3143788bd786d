"""Connection strings, and what an open one is like, whatever is behind it."""

import re
import termios
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final

from fg_gcs.errors import LinkError
from fg_gcs.wire.address import MAIN
from fg_gcs.wire.framing import Frames

Address = tuple[str, int]
Datagram = tuple[bytes, Address]  # what to send, and where to

FORMS: Final = (
    "udpin:HOST:PORT (vehicles come to us), udpout:HOST:PORT (we call first), tcp:HOST:PORT (we connect), "
    "tcpin:HOST:PORT (vehicles connect to us) or serial:DEVICE:BAUD"
)

PX4_PORT: Final = 14540  # of instance 0, and one higher for each up to instance 9
PX4_PORTS: Final = 10
ARDUPILOT_PORT: Final = 5760  # of instance 0
ARDUPILOT_STEP: Final = 10

_PATTERN: Final = re.compile(r"(?P<kind>[a-z]+):(?://)?(?:(?P<host>[^:/\s]*):)?(?P<port>\d{1,5})/?", re.IGNORECASE)
_SERIAL: Final = re.compile(r"serial:(?P<device>/[^\s=]+):(?P<baud>\d{1,7})", re.IGNORECASE | re.ASCII)
_RATE: Final = re.compile(r"B[1-9]\d{3,}")  # slower ones are none for MAVLink
_NETWORK: Final = re.compile(r"\s*(?P<name>[^=]*?)\s*=(?P<endpoint>.*)", re.DOTALL)
_NETWORK_NAME: Final = re.compile(r"[a-z0-9_-]{1,16}")
_LOCAL: Final = "127.0.0.1"


class Change(Enum):
    """What becomes of a connection on the way, in words for people."""

    LOST = "connection lost, connecting again"
    BACK = "connected again"


class Kind(Enum):
    """Who speaks first, and over what."""

    UDP_IN = "udpin"
    UDP_OUT = "udpout"
    TCP = "tcp"
    TCP_IN = "tcpin"
    SERIAL = "serial"

    @property
    def verb(self) -> str:
        """What we do there, for people."""
        if self in (Kind.UDP_IN, Kind.TCP_IN):
            return "listening at"
        return "calling" if self is Kind.UDP_OUT else "connected to"

    @property
    def is_stream(self) -> bool:
        """Whether bytes come one after the other, and not in datagrams."""
        return self not in (Kind.UDP_IN, Kind.UDP_OUT)


_KINDS: Final = {
    "udp": Kind.UDP_IN,
    "udpin": Kind.UDP_IN,
    "udpout": Kind.UDP_OUT,
    "tcp": Kind.TCP,
    "tcpin": Kind.TCP_IN,
}


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Where vehicles are to be found.

    Attributes:
        kind: Who speaks first, and over what.
        host: The host to bind, or to call; the device.
        port: The port to bind, or to call; the device's rate [baud].
    """

    kind: Kind
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.kind.value}:{self.host}:{self.port}"


def parse_endpoint(text: str) -> Endpoint:
    """Return the endpoint that a connection string names; the host may be left out (127.0.0.1).

    Raises:
        LinkError: Not a connection string; the message lists the forms.
    """
    device = _SERIAL.fullmatch(text.strip())
    if device is not None:
        return _serial(device["device"], int(device["baud"]))
    match = _PATTERN.fullmatch(text.strip())
    kind = _KINDS.get(match["kind"].lower()) if match else None
    if match is None or kind is None or not 0 < int(match["port"]) < 65536:
        raise LinkError(f"endpoint {text!r} is not of the form {FORMS}")
    return Endpoint(kind, match["host"] or _LOCAL, int(match["port"]))


def _serial(device: str, baud: int) -> Endpoint:
    """Return the endpoint of a device.

    Raises:
        LinkError: The system does not have that rate.
    """
    if not hasattr(termios, f"B{baud}") or not baud:
        rates = sorted(int(name[1:]) for name in dir(termios) if _RATE.fullmatch(name))
        raise LinkError(f"serial:{device}:{baud}: no rate of this system; accepted: {', '.join(map(str, rates))}")
    return Endpoint(Kind.SERIAL, device, baud)


def px4_endpoints(instances: int, first: int = 0) -> tuple[str, ...]:
    """Return where SITL instances of PX4 send by themselves, from the first one's number on, as their script has it.

    Each sends to a ground station's port, 14550 for all, and to one of its own for an onboard computer: that one, so
    that another ground station can have the first. From instance 9 on they share one (measured, see docs/autopilots).
    """
    ports = dict.fromkeys(PX4_PORT + min(number, PX4_PORTS - 1) for number in range(first, first + instances))
    return tuple(f"{Kind.UDP_IN.value}:{_LOCAL}:{port}" for port in ports)


def ardupilot_endpoints(instances: int) -> tuple[str, ...]:
    """Return where SITL instances 0, 1, 2 ... of ArduPilot listen, as they do unless told otherwise."""
    return tuple(f"{Kind.TCP.value}:{_LOCAL}:{ARDUPILOT_PORT + ARDUPILOT_STEP * k}" for k in range(instances))


def parse_networks(texts: Iterable[str]) -> dict[str, tuple[Endpoint, ...]]:
    """Return the networks that texts of the form ``[NAME=]ENDPOINT`` declare, each with its endpoints, in their order.

    Endpoints of one name are one network; those without a name are the network ``main``. If there is only one network,
    it is ``main`` whatever its name: names tell networks apart.

    Raises:
        LinkError: A text is at fault, or an endpoint occurs twice; the message says what is accepted.
    """
    networks: dict[str, tuple[Endpoint, ...]] = {}
    known: set[Endpoint] = set()
    for text in texts:
        match = _NETWORK.fullmatch(text)
        name = MAIN if match is None else match["name"]
        if not _NETWORK_NAME.fullmatch(name):
            raise LinkError(f"network {name!r} in {text!r} is not a name of 1 to 16 of a-z, 0-9, - and _")
        endpoint = parse_endpoint(text if match is None else match["endpoint"])
        if endpoint in known:
            raise LinkError(f"endpoint {endpoint} occurs twice; each of them belongs to one network, once")
        known.add(endpoint)
        networks[name] = (*networks.get(name, ()), endpoint)
    if len(networks) == 1:
        (only,) = networks.values()
        return {MAIN: only}
    return networks


def places(networks: Mapping[str, Sequence[Endpoint]]) -> str:
    """Return what we do at endpoints to hear vehicles, for people: ``listening at A, B; connected to C``.

    With several networks each endpoint's network is told: ``listening at east: A; west: B``.
    """
    by_verb: dict[str, dict[str, list[str]]] = {}
    for name, endpoints in networks.items():
        for endpoint in endpoints:
            by_verb.setdefault(endpoint.kind.verb, {}).setdefault(name, []).append(str(endpoint))
    told = []
    for verb, by_name in by_verb.items():
        texts = {name: ", ".join(listed) for name, listed in by_name.items()}
        named = (f"{name}: {text}" for name, text in texts.items()) if len(networks) > 1 else texts.values()
        told.append(f"{verb} {'; '.join(named)}")
    return "; ".join(told)


def in_rows(frames: Frames) -> list[bytes]:
    """Return frames that stand in an array, each by itself."""
    rows: list[bytes] = frames.view(f"V{frames.shape[1]}").ravel().tolist()
    return rows


OnData = Callable[["Wire", Address, bytes], None]
OnChange = Callable[["Wire", Change], None]


class Wire(ABC):
    """One open endpoint: hands in bytes with the address they came from, takes bytes for an address; never raises.

    Attributes:
        endpoint: What it was opened for.
        remote: The one partner of a connected endpoint, None for ``udpin``.
        dropped: Messages not sent because the way out is full or closed.
        errors: Errors the system reported (a refused port, a broken connection, a vain attempt at another).
    """

    def __init__(self, endpoint: Endpoint, on_data: OnData) -> None:
        self.endpoint = endpoint
        self.remote: Address | None = None
        self.dropped = 0
        self.errors = 0
        self._on_data = on_data

    def send(self, data: bytes, address: Address) -> None:
        """Send whole frames to ``address``."""
        self.send_all(((data, address),))

    @abstractmethod
    def send_all(self, datagrams: Iterable[Datagram]) -> None:
        """Send whole frames, to the address of each; what the way out does not take is dropped."""

    def round_to(self, addresses: Sequence[Address]) -> Callable[[Frames], None]:
        """Return what sends a round of frames, the one in row n to the n-th of these addresses, as `send_all` does."""
        return lambda frames: self.send_all(zip(in_rows(frames), addresses, strict=True))

    def reaches(self, address: Address) -> bool:
        """Tell whether what is sent to an address that was heard here can still arrive."""
        return True

    def shortages(self, vehicles: int) -> list[str]:
        """Return what is too small for so many vehicles, a line for people each."""
        return []

    def admit_only(self, known: Collection[Address] | None, share: float) -> bool:
        """Let the system drop what comes from elsewhere, but for a share of the heartbeats; tell whether it can.

        Args:
            known: Where everything is taken from; None: from everywhere.
            share: Of the heartbeats, 0 to 1.
        """
        return False

    @property
    def unread(self) -> int:
        """Datagrams that the system has dropped before they were read, as far as it tells."""
        return 0

    @abstractmethod
    def close(self) -> None:
        """Close it."""
