"""Frames of made-up vehicles and stations, for benchmarks and trials: they stand on the ground and are all right."""

from typing import Final

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.autopilots import PX4
from fg_gcs.wire.framing import Sender


def boot_frames(system_id: int) -> dict[str, bytes]:
    """Return the frames that a vehicle needs to be known, by kind: ``heartbeat``, ``origin`` and ``position``.

    Their sequence numbers say nothing. Vehicles stand 3 m apart on a line to the north.
    """
    sender = Sender(system_id, dialect.MAV_COMP_ID_AUTOPILOT1)
    messages = {
        "heartbeat": dialect.MAVLink_heartbeat_message(2, PX4.autopilot, 1, PX4.streaming_mode, 3, 3),
        "origin": dialect.MAVLink_gps_global_origin_message(473_977_418, 85_455_939, 488_000),
        "position": dialect.MAVLink_local_position_ned_message(1000, 3.0 * system_id, 0.5, -0.1, 0.1, 0.2, 0.3),
    }
    return {kind: sender.pack(message) for kind, message in messages.items()}


FOREIGN_STATION: Final = 250  # system id; ours is 255, as everybody's


class Speaker:
    """Packs what somebody says who is not one of ours.

    Args:
        system_id: of a vehicle.
        autopilot: its kind, a number of MAVLink's; None: it is another ground station.
    """

    def __init__(self, system_id: int, autopilot: int | None) -> None:
        if autopilot is None:
            self._sender = Sender(FOREIGN_STATION, dialect.MAV_COMP_ID_MISSIONPLANNER)
            self._heartbeat = dialect.MAVLink_heartbeat_message(6, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
        else:
            self._sender = Sender(system_id, dialect.MAV_COMP_ID_AUTOPILOT1)
            self._heartbeat = dialect.MAVLink_heartbeat_message(2, autopilot, 1, 0, 3, 3)

    def heartbeat(self) -> bytes:
        """Return the next heartbeat; of a vehicle that nobody has armed."""
        return self._sender.pack(self._heartbeat)

    def position(self, boot_time_s: float) -> bytes:
        """Return where it stands, 40 m north and east of its origin."""
        boot_ms = int(1e3 * boot_time_s)
        return self._sender.pack(dialect.MAVLink_local_position_ned_message(boot_ms, 40.0, 40.0, -0.1, 0.0, 0.0, 0.0))
