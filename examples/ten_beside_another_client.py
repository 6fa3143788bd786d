"""Put ten simulated vehicles beside another client: here pymavlink's own, as any ground station could be."""

from __future__ import annotations

import asyncio
import socket

from pymavlink import mavutil

from sitl_mock import Simulator, SimulatorOptions, grid

VEHICLES = 10


def free_port() -> int:
    """Return a UDP port of this machine that is not in use."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def hear(port: int, patience_s: float) -> dict[int, str]:
    """Wait for heartbeats as another ground station does; return the autopilots by their system ids."""
    client = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}")
    heard: dict[int, str] = {}
    while len(heard) < VEHICLES:
        message = client.recv_match(type="HEARTBEAT", blocking=True, timeout=patience_s)
        if message is None:
            break
        heard[message.get_srcSystem()] = mavutil.mavlink.enums["MAV_AUTOPILOT"][message.autopilot].name
    client.close()
    return heard


async def main() -> None:
    """Simulate, and let the other client listen in a thread of its own."""
    port = free_port()
    options = SimulatorOptions(autopilot="ardupilot", pads_enu_m=grid(VEHICLES), remotes=(("127.0.0.1", port),))
    async with Simulator(options):
        heard = await asyncio.to_thread(hear, port, 10.0)
    for system_id, autopilot in sorted(heard.items()):
        print(f"vehicle {system_id}: {autopilot}")


if __name__ == "__main__":
    asyncio.run(main())
