"""Parameters on the wire: PX4 bytewise with errors, ArduPilot cast with silence."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.profiles.px4 import PROFILE as PX4
from tests.sitl.driver import ready

INT8, INT32, REAL32 = 2, 6, 9


def bytewise(value: int) -> float:
    number: float = struct.unpack("<f", struct.pack("<i", value))[0]
    return number


@given(st.integers(-(2**31), 2**31 - 1))
def test_px4_integers_survive_the_float_field(value: int) -> None:
    # The patterns of signalling NaN are the one kind that a float field may change on its way.
    if math.isnan(bytewise(value)):
        value &= 0x7F7FFFFF
    parameters = Parameters(PX4, 1)
    parameters.write("COM_OBL_RC_ACT", bytewise(value), INT32)
    assert parameters["COM_OBL_RC_ACT"] == value
    assert struct.pack("<f", parameters.message("COM_OBL_RC_ACT", True)["param_value"]) == struct.pack("<i", value)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_list_is_complete_and_in_order(autopilot: str) -> None:
    station = ready(autopilot)
    station.send(dialect.MAVLink_param_request_list_message(1, 1))
    station.run(2.0)
    values = station.messages("PARAM_VALUE")
    if station.px4:
        assert values[0].param_id == "_HASH_CHECK"
        values = values[1:]
    assert [m.param_index for m in values] == list(range(values[0].param_count))
    assert [m.param_id for m in values] == sorted(m.param_id for m in values)


def test_px4_answers() -> None:
    station = ready("px4")
    (value,) = station.parameter("MPC_XY_VEL_MAX", 5.0)
    assert (value.param_id, value.param_value, value.param_type) == ("MPC_XY_VEL_MAX", 5.0, REAL32)
    station.run(0.1)
    assert len(station.messages("PARAM_VALUE")) == 2  # told again, because it changed
    for name, kind, error in (("NO_SUCH", INT32, 1), ("MPC_XY_VEL_MAX", INT32, 7), ("COM_OBL_RC_ACT", 5, 6)):
        (answer,) = station.parameter(name, 1.0, kind)
        assert (answer.get_type(), answer.error) == ("PARAM_ERROR", error)
    (answer,) = station.send(dialect.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    assert answer.get_type() == "PARAM_ERROR"
    (answer,) = station.send(dialect.MAVLink_param_request_read_message(1, 0, b"MPC_XY_VEL_MAX", -1))
    assert answer.param_value == 5.0
    assert station.send(dialect.MAVLink_param_request_read_message(2, 1, b"MPC_XY_VEL_MAX", -1)) == []


def test_px4_stores_nan_but_flies_its_default() -> None:
    station = ready("px4")
    (value,) = station.parameter("MPC_XY_VEL_MAX", math.nan)
    assert math.isnan(value.param_value)
    assert station.autopilot.parameters["MPC_XY_VEL_MAX"] == 12.0


@pytest.mark.parametrize(("wish", "stored"), [(1.7, 1.0), (300.0, 127.0), (-1e9, -128.0), (math.inf, 127.0)])
def test_ardupilot_clips_integers(wish: float, stored: float) -> None:
    (value,) = ready("ardupilot").parameter("FS_GCS_ENABLE", wish)
    assert (value.param_value, value.param_type) == (stored, INT8)


def test_ardupilot_is_silent_about_what_it_does_not_know() -> None:
    station = ready("ardupilot")
    assert station.parameter("NO_SUCH", 1.0) == []
    assert station.parameter("WPNAV_SPEED", math.nan) == []
    assert station.send(dialect.MAVLink_param_request_read_message(1, 1, b"WPNAV_SPEED", -1)) == []
    station.run(0.15)  # reads are answered from a slow task
    assert station.messages("PARAM_VALUE")[-1].param_value == 1000.0


def test_ardupilot_changes_its_system_id_at_once() -> None:
    station = ready("ardupilot")
    station.parameter("MAV_SYSID", 7.0)
    station.run(1.1)
    assert station.messages("HEARTBEAT")[-1].get_srcSystem() == 7
    assert station.command(400, 0) == []
    assert station.command(400, 0, system=7) == [0]
