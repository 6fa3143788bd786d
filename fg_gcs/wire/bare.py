"""Frames of a made-up vehicle, for benchmarks: what an autopilot says that stands on the ground and is all right."""

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
