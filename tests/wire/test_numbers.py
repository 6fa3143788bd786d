"""Numbers on the wire, held against the documents that they come from."""

import math

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire import commands
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.autopilots import ARDUPILOT, PX4, AutopilotProfile
from fg_gcs.wire.codec import Codec
from fg_gcs.wire.dialogue import Dialogue, State
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.reading import ReadParameters, Wanted
from fg_gcs.wire.vehicle import Vehicle

PX4_MODES = {  # main and sub mode, px4_custom_mode.h
    "MANUAL": (1, 0),
    "ALTCTL": (2, 0),
    "POSCTL": (3, 0),
    "TAKEOFF": (4, 2),
    "LOITER": (4, 3),
    "MISSION": (4, 4),
    "RTL": (4, 5),
    "LAND": (4, 6),
    "ACRO": (5, 0),
    "OFFBOARD": (6, 0),
    "STABILIZED": (7, 0),
}


def test_every_mode_has_its_autopilots_number() -> None:
    assert {name: (mode >> 16 & 0xFF, mode >> 24) for name, mode in PX4.modes.items()} == PX4_MODES
    for name, mode in ARDUPILOT.modes.items():
        assert mode == getattr(dialect, f"COPTER_MODE_{name}")


@pytest.mark.parametrize("profile", [PX4, ARDUPILOT], ids=lambda profile: profile.name)
def test_limits_are_metres_but_for_the_old_names_of_ardupilot(profile: AutopilotProfile) -> None:
    for limit in profile.limits:
        for name, scale in limit.names.items():
            assert scale == (0.01 if name.startswith("WPNAV_") else 1.0), name


def test_take_off_says_its_height_and_leaves_all_else_to_the_vehicle() -> None:
    vehicle = Vehicle(VehicleAddress(MAIN, 4), ARDUPILOT, 0.0)
    (sent,) = Dialogue(vehicle, commands.take_off(7.5)).step(0.0)
    parameters = [getattr(sent, f"param{number}") for number in range(1, 8)]
    assert (sent.command, sent.confirmation, parameters) == (dialect.MAV_CMD_NAV_TAKEOFF, 0, [0.0] * 6 + [7.5])


def test_a_parameter_is_asked_for_by_its_name_alone() -> None:
    question = ReadParameters((Wanted(("FS_GCS_ENABLE",), needed=True),))
    (sent,) = question.dialogue(Vehicle(VehicleAddress(MAIN, 4), ARDUPILOT, 0.0)).step(0.0)
    assert (sent.param_id, sent.param_index) == ("FS_GCS_ENABLE", -1)  # any other index would count instead


def test_what_a_vehicle_said_before_is_no_reason_of_what_fails_now() -> None:
    vehicle, theirs, codec = Vehicle(VehicleAddress(MAIN, 4), ARDUPILOT, 0.0), Sender(4, 1), Codec()

    def says(text: bytes, now_s: float) -> None:
        for heard in codec.receive(theirs.pack(dialect.MAVLink_statustext_message(2, text, 0, 0))):
            vehicle.handle(heard, now_s)

    says(b"Crash: disarming", 1.0)
    dialogue = Dialogue(vehicle, commands.arm())
    dialogue.step(2.0)
    says(b"Arm: throttle too high", 2.5)
    dialogue.step(math.inf)
    assert dialogue.state is State.TIMED_OUT
    assert "throttle too high" in dialogue.reason
    assert "Crash" not in dialogue.reason
