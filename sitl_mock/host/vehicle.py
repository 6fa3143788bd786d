"""One vehicle as the server sees it: datagrams in, messages out, per link. Sans-IO; time is an argument."""

from __future__ import annotations

import math

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.ground import GroundWatch
from sitl_mock.messages import Outgoing, Received
from sitl_mock.protocol import services
from sitl_mock.protocol.codec import COMPONENT, Codec
from sitl_mock.protocol.dialect import Dialect
from sitl_mock.protocol.signing import Signing


class Vehicle:
    """An autopilot with a codec per link.

    Args:
        autopilot: the decisions.
        dialect: how it speaks.
        signing: how its frames are signed, and which are taken.
    """

    def __init__(self, autopilot: Autopilot, dialect: Dialect, signing: Signing) -> None:
        self.autopilot = autopilot
        self.signing = signing
        self._dialect = dialect
        self._ground = GroundWatch(autopilot)
        self.codecs = [Codec(signing, link) for link in range(len(autopilot.links))]

    def receive(self, link: int, data: bytes, now_s: float) -> list[Outgoing]:
        """Act on one datagram. Never raises, whatever the bytes are.

        Args:
            link: index of the remote it came from.
            data: the datagram.
            now_s: simulated time.

        Returns:
            The answers.
        """
        self.autopilot.enter(now_s)
        if self.autopilot.dead:
            return []
        self.autopilot.links[link].frozen_s = math.inf
        for message in self.codecs[link].decode(data):
            if message.name == "SETUP_SIGNING":
                self._set_up_signing(message)
            self._dialect.receive(self.autopilot, message, link, now_s)
        return self._drained()

    def update(self, now_s: float) -> list[Outgoing]:
        """Run the logic once (50 Hz); what it says is returned."""
        autopilot = self.autopilot
        autopilot.enter(now_s)
        if autopilot.dead:
            return []
        autopilot.go_on()
        autopilot.rules.watch_position(autopilot)
        if autopilot.armed:
            autopilot.rules.watch_failsafes(autopilot)
        self._ground.watch()
        autopilot.steer()
        services.continue_lists(autopilot)
        return self._drained()

    def _set_up_signing(self, message: Received) -> None:
        fields = message.fields
        if fields["target_system"] == self.autopilot.system_id and fields["target_component"] in (0, COMPONENT):
            self.signing.set_up(bytes(fields["secret_key"]), fields["initial_timestamp"])

    def _drained(self) -> list[Outgoing]:
        outbox = self.autopilot.outbox
        if outbox:
            self.autopilot.outbox = []
        return outbox
