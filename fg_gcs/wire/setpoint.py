"""Position targets on the hot path: SET_POSITION_TARGET_LOCAL_NED of a whole swarm in one array of frames.

Position, velocity, acceleration and yaw go out together, always: an autopilot ignores a whole group when one of its
bits is ignored, and ArduPilot turns the nose into the direction of travel when yaw is (measured, see docs/autopilots).
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.framing import CHECKSUM_BYTES, HEADER_BYTES, Frames, Round, Sender, id_bytes

NUMBERS: Final = 10  # of one setpoint: position [m], velocity [m/s], acceleration [m/s^2], each NED, and yaw [rad]
TYPE_MASK: Final[int] = dialect.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE  # 0x800: everything counts but yaw rate

_KIND: Final = dialect.MAVLink_set_position_target_local_ned_message
_ID: Final = id_bytes(_KIND.id)
_CRC_EXTRA: Final = bytes([_KIND.crc_extra])
# The last byte of the payload, coordinate_frame, is not zero, so MAVLink 2 never shortens this message.
_LOCAL_NED: Final[int] = dialect.MAV_FRAME_LOCAL_NED
_AUTOPILOT: Final[int] = dialect.MAV_COMP_ID_AUTOPILOT1
_LAYOUT: Final = np.dtype(
    [
        ("header", np.uint8, (HEADER_BYTES,)),
        ("time_boot_ms", "<u4"),
        ("numbers", "<f4", (NUMBERS,)),
        ("yaw_rate", "<f4"),
        ("type_mask", "<u2"),
        ("target_system", np.uint8),
        ("target_component", np.uint8),
        ("coordinate_frame", np.uint8),
        ("checksum", np.uint8, (CHECKSUM_BYTES,)),
    ]
)


class SetpointRound:
    """Packs the setpoints of V vehicles, round by round.

    Args:
        system_ids: The vehicles.
        senders: Of their links, give our address and the sequence numbers.
    """

    def __init__(self, system_ids: Sequence[int] | NDArray[np.int_], senders: Sequence[Sender]) -> None:
        made = np.zeros(len(senders), _LAYOUT)  # the time stamp stays 0: both autopilots ignore it
        made["type_mask"] = TYPE_MASK
        made["target_system"] = system_ids
        made["target_component"] = _AUTOPILOT
        made["coordinate_frame"] = _LOCAL_NED
        self._round = Round(made.view(np.uint8).reshape(len(made), _LAYOUT.itemsize), senders, _ID, _CRC_EXTRA)

    def pack(self, numbers: NDArray[np.float64]) -> Frames:
        """Return the frames that stream setpoints to the vehicles' autopilots.

        Args:
            numbers: Those of each setpoint, in the vehicle's own local frame, all of them finite and none beyond
                `fg_gcs.core.admissible.LARGEST`; shape
                (V, `NUMBERS`).

        Returns:
            Whole frames, shape (V, size).
        """
        frames = self._round.frames()
        frames[:, : _LAYOUT.itemsize].view(_LAYOUT)["numbers"] = numbers[:, None]  # a signature may follow
        self._round.finish(frames)
        return frames
