"""One vehicle as the server sees it: datagrams in and out, per link. Sans-IO; time is an argument."""

from __future__ import annotations

from typing import NamedTuple

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.ground import GroundWatch
from sitl_mock.autopilot.guidance import BodyState
from sitl_mock.messages import Outgoing
from sitl_mock.protocol import services
from sitl_mock.protocol.codec import Codec
from sitl_mock.protocol.dialect import Dialect


class Datagram(NamedTuple):
    """Bytes for one link."""

    link: int
    data: bytes


class Vehicle:
    """An autopilot with a codec per link.

    Args:
        autopilot: the decisions.
        dialect: how it speaks.
    """

    def __init__(self, autopilot: Autopilot, dialect: Dialect) -> None:
        self.autopilot = autopilot
        self._dialect = dialect
        self._ground = GroundWatch(autopilot)
        self.codecs = [Codec() for _ in autopilot.links]

    def receive(self, link: int, data: bytes, body: BodyState) -> list[Datagram]:
        """Act on one datagram. Never raises, whatever the bytes are.

        Args:
            link: index of the remote it came from.
            data: the datagram.
            body: the vehicle's state now.

        Returns:
            The answers.
        """
        for message in self.codecs[link].decode(data):
            self._dialect.receive(self.autopilot, message, link, body.time_s)
        return self._drain(body)

    def update(self, body: BodyState) -> list[Datagram]:
        """Run the logic once (50 Hz); what it says is returned."""
        self.autopilot.enter(body)
        if self.autopilot.armed:
            self.autopilot.rules.watch_failsafes(self.autopilot)
        self._ground.watch()
        self.autopilot.steer()
        services.continue_lists(self.autopilot)
        return self._drain(body)

    def telemetry(self, now_s: float) -> list[tuple[int, str]]:
        """Link and message of every stream that is due."""
        return [(k, name) for k, link in enumerate(self.autopilot.links) for name in link.due(now_s)]

    def pack(self, due: list[tuple[int, str]], body: BodyState) -> list[Datagram]:
        """Datagrams of due streams; what cannot be sent now is left out."""
        return [d for link, name in due for d in self._datagrams(Outgoing(name, None, link), body)]

    def _drain(self, body: BodyState) -> list[Datagram]:
        if not self.autopilot.outbox:
            return []
        outbox, self.autopilot.outbox = self.autopilot.outbox, []
        return [d for message in outbox for d in self._datagrams(message, body)]

    def _datagrams(self, message: Outgoing, body: BodyState) -> list[Datagram]:
        fields = message.fields
        if fields is None:
            fields = self._dialect.fields_of(message.name, self.autopilot, body)
            if fields is None:
                return []
        links = range(len(self.codecs)) if message.link is None else (message.link,)
        system_id = self.autopilot.system_id
        datagrams = [Datagram(k, self.codecs[k].encode(message.name, fields, system_id)) for k in links]
        return [d for d in datagrams if d.data]
