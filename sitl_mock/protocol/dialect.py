"""How one autopilot speaks: its tables of messages, commands and telemetry, and with its rules the whole strategy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from sitl_mock.autopilot.autopilot import Autopilot, Rules
from sitl_mock.messages import CommandResult, Fields, Received, Severity
from sitl_mock.protocol import commands, services, telemetry
from sitl_mock.protocol.commands import Command, acknowledgement, command_of
from sitl_mock.protocol.rows import RowBuilder


@dataclass(frozen=True, slots=True)
class Dialect:
    """Tables from what is received to what is done, and from a message's name to how it is made.

    Attributes:
        messages: by the message's name; what is not there is ignored. Commands have tables of their own.
        commands: by MAV_CMD; a handler that returns None has acknowledged already, or never does.
        used_parameters: by MAV_CMD, which of the first four parameters a command has, as bits; others are not checked.
        fixed_results: of commands that do nothing; any other command is UNSUPPORTED.
        builders: by the message's name; what is neither here nor in `row_builders` is never sent.
        row_builders: likewise, of messages that come often.
    """

    messages: Mapping[str, services.Handler]
    commands: Mapping[int, commands.Handler]
    used_parameters: Mapping[int, int]
    fixed_results: Mapping[int, CommandResult]
    builders: Mapping[str, telemetry.Builder]
    row_builders: Mapping[str, RowBuilder]

    def receive(self, vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
        """Let a vehicle act on one message that arrived on a link."""
        if not vehicle.profile.texts.need_gcs:
            vehicle.links[link].texts_open = True
        if vehicle.uptime_s < vehicle.boot.heartbeat_s:
            return
        if message.name in ("COMMAND_LONG", "COMMAND_INT"):
            if services.addressed(vehicle, message, vehicle.profile.obeys_system_0):
                self._execute(vehicle, command_of(message, link))
        elif (handler := self.messages.get(message.name)) is not None:
            handler(vehicle, message, link, now_s)

    def fields_of(self, name: str, vehicle: Autopilot) -> Fields | None:
        """The fields of a message, or None when the vehicle cannot send it now (or at all)."""
        builder = self.builders.get(name)
        return None if builder is None else builder(vehicle, vehicle.body)

    def _execute(self, vehicle: Autopilot, command: Command) -> None:
        """Do what a command asks and acknowledge it to its sender."""
        for refusal in vehicle.refusals:
            if refusal.command in (0, command.number):
                vehicle.send_text(refusal.text, Severity.WARNING)
                vehicle.outbox.append(acknowledgement(command, refusal.result))
                return
        if vehicle.manners.strict_commands and not self._is_clean(command):
            vehicle.outbox.append(acknowledgement(command, CommandResult.DENIED))
            return
        handler = self.commands.get(command.number)
        fixed = self.fixed_results.get(command.number, CommandResult.UNSUPPORTED)
        result = fixed if handler is None else handler(vehicle, command)
        if result is not None:
            vehicle.outbox.append(acknowledgement(command, result))

    def _is_clean(self, command: Command) -> bool:
        """Whether all parameters that a command does not have are 0 or NaN."""
        used = self.used_parameters.get(command.number, 0b1111)
        unused = [value for k, value in enumerate(command.parameters[:4]) if not used & 1 << k]
        return all(value == 0.0 or math.isnan(value) for value in unused)


class Strategy(NamedTuple):
    """One autopilot: what it does, and how it speaks."""

    rules: Rules
    dialect: Dialect
