"""What other ground stations do with a swarm's setpoints, each in the way that its own examples show.

They hear the vehicles at one UDP port, as ours does, and send each vehicle its setpoint. A bare loop of ``sendto``
beside them says what the system takes for it.
"""

from __future__ import annotations

import asyncio
import math
import socket
import time
from collections.abc import Sequence
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import LinkError
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.setpoint import TYPE_MASK, SetpointRound

Numbers = NDArray[np.float64]  # (V, 10), see `fg_gcs.wire.setpoint`

BARE_LOOP: Final = 254  # system id of the bare loop
HEAR_S: Final = 20.0  # heartbeats come once a second


class GroundStation(Protocol):
    """Hears vehicles, and sends all of them their setpoints."""

    async def hear(self, system_ids: Sequence[int], wait_s: float = HEAR_S) -> None:
        """Wait until all vehicles are known.

        Raises:
            LinkError: some of them are not, within ``wait_s`` [s].
        """

    async def send(self, numbers: Numbers) -> None:
        """Send each vehicle its setpoint, in the order of the ids that were heard."""

    def close(self) -> None:
        """Close all sockets."""


class BareLoop:
    """Sends frames that are there already, one ``sendto`` each: what nobody can do without."""

    def __init__(self, system_ids: Sequence[int], ports: Sequence[int], numbers: Numbers) -> None:
        """Take vehicles and the ports of the loopback that they listen at."""
        frames = SetpointRound(system_ids, [Sender(BARE_LOOP) for _ in system_ids]).pack(numbers)
        self._datagrams = [(frame.tobytes(), ("127.0.0.1", port)) for frame, port in zip(frames, ports, strict=True)]
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(self) -> None:
        """Send all frames."""
        sendto = self._socket.sendto
        for data, address in self._datagrams:
            sendto(data, address)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Mavutil:
    """pymavlink's own way: one connection for all vehicles, and one message object for each setpoint."""

    def __init__(self, port: int) -> None:
        """Listen at a port of the loopback."""
        # Imported here: it sets environment variables and picks a dialect for the whole process
        from pymavlink import mavutil

        self._master: Any = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}")
        self._system_ids: Sequence[int] = ()

    async def hear(self, system_ids: Sequence[int], wait_s: float = HEAR_S) -> None:
        """Wait until all vehicles are known."""
        self._system_ids, heard, end_s = system_ids, set[int](), time.monotonic() + wait_s
        while heard < set(system_ids):
            message = self._master.recv_msg()
            if message is not None:
                heard.add(message.get_srcSystem())
            elif time.monotonic() > end_s:
                raise LinkError(f"mavutil hears {len(heard)} of {len(system_ids)} vehicles within {wait_s:g} s")
            else:
                await asyncio.sleep(0.001)

    async def send(self, numbers: Numbers) -> None:
        """Send each vehicle its setpoint."""
        send = self._master.mav.set_position_target_local_ned_send
        for system_id, row in zip(self._system_ids, numbers.tolist(), strict=True):
            send(0, system_id, 1, 1, TYPE_MASK, *row, 0.0)

    def receive(self, count: int) -> None:
        """Read so many messages that wait already."""
        for _ in range(count):
            self._master.recv_msg()

    def close(self) -> None:
        """Close the socket."""
        self._master.close()


class Mavsdk:
    """MAVSDK's way: a system a vehicle, each with its offboard setter, which sends at once."""

    def __init__(self, mavsdk: Any) -> None:  # noqa: ANN401 - ships no types
        """Take what `open` makes."""
        self._mavsdk = mavsdk
        self._setters: list[Any] = []

    @classmethod
    async def open(cls, port: int) -> Mavsdk:
        """Listen at a port of the loopback."""
        from mavsdk.asyncio import ComponentType, Configuration
        from mavsdk.asyncio import Mavsdk as Library
        from mavsdk.logging import log_subscribe

        log_subscribe(lambda *_: True)  # a line for each vehicle that comes or goes is no figure
        library = Library(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        await library.add_any_connection(f"udpin://127.0.0.1:{port}")
        return cls(library)

    async def hear(self, system_ids: Sequence[int], wait_s: float = HEAR_S) -> None:
        """Wait until all vehicles are known."""
        from mavsdk.asyncio.plugins.offboard import OffboardAsync

        found: dict[int, Any] = {}
        end_s = time.monotonic() + wait_s
        while found.keys() < set(system_ids):
            if time.monotonic() > end_s:
                raise LinkError(f"MAVSDK hears {len(found)} of {len(system_ids)} vehicles within {wait_s:g} s")
            await asyncio.sleep(0.1)
            for system in await self._mavsdk.get_systems():
                if await system.has_autopilot():
                    found[await system.get_system_id()] = system
        self._setters = [OffboardAsync(found[system_id]) for system_id in system_ids]

    async def send(self, numbers: Numbers) -> None:
        """Send each vehicle its setpoint."""
        from mavsdk.asyncio.plugins.offboard import AccelerationNed, PositionNedYaw, VelocityNedYaw

        for setter, row in zip(self._setters, numbers.tolist(), strict=True):
            yaw_deg = math.degrees(row[9])
            await setter.set_position_velocity_acceleration_ned(
                PositionNedYaw(*row[:3], yaw_deg), VelocityNedYaw(*row[3:6], yaw_deg), AccelerationNed(*row[6:9])
            )

    def close(self) -> None:
        """End its threads."""
        for setter in self._setters:
            setter.destroy()
        self._mavsdk.destroy()


def pymavlink_us(frames: Sequence[bytes], seconds: float) -> float:
    """Return what pymavlink takes to make and pack messages, from Python's numbers to a frame [us a message].

    Args:
        frames: of these messages, one or more.
        seconds: of the processor; at least so many [s].
    """
    mav = dialect.MAVLink(None, 1, 1)
    messages = [mav.decode(bytearray(frame)) for frame in frames]
    made = [(type(each), [getattr(each, name) for name in each.fieldnames]) for each in messages]
    count, began_s = 0, time.process_time()
    while (taken_s := time.process_time() - began_s) < seconds or not count:
        for kind, values in made:
            kind(*values).pack(mav)
        count += len(made)
    return 1e6 * taken_s / count
