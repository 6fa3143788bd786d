"""What vehicles say: all of it, in its order, and together what many say alike."""

from __future__ import annotations

import asyncio
from pathlib import Path

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.flight.journal import Journal
from fg_gcs.link.router import Router
from fg_gcs.record.write.recorder import Recorder
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.autopilots import PX4
from fg_gcs.wire.codec import Codec
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.vehicle import Vehicle


def test_what_many_vehicles_say_alike_is_one_line(tmp_path: Path) -> None:
    vehicles = [Vehicle(VehicleAddress(MAIN, number), PX4, 0.0) for number in range(1, 250)]
    armed = dialect.MAVLink_heartbeat_message(2, PX4.autopilot, 0x80, PX4.streaming_mode, 4, 3)
    text = dialect.MAVLink_statustext_message(4, b"GPS fix lost", 0, 0)
    for vehicle in vehicles:
        sender = Sender(vehicle.system_id, 1)
        said = [armed, text, text] if vehicle.system_id < 249 else [armed]
        for frame in Codec().receive(b"".join(map(sender.pack, said))):
            vehicle.handle(frame, 1.0)
    lines: list[tuple[str, str]] = []
    loop = asyncio.new_event_loop()
    router = Router(loop, None, None)
    loop.close()
    router.notices.append("something of the router's own")
    with Recorder(tmp_path, "", 0.0, 0.0) as recorder:
        recorder.listeners.append(lambda _time_s, kind, line: lines.append((kind, line)))
        journal = Journal(recorder, lambda: 1.0)
        journal.drain(router, vehicles)
        journal.drain(router, vehicles)
    assert lines == [
        ("notice", "something of the router's own"),
        ("text", "vehicles 1-248: GPS fix lost"),
        ("phase", "vehicles 1-249: armed on the ground"),
    ]
