"""Vehicles to be followed: where they say they are, when, and on which sockets."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.core.frames import Geodetic, enu_from_geodetic
from fg_gcs.scenario.motions import Circle, FigureEight, Static, TrueMotion
from fg_gcs.scenario.waypoints import Waypoints
from sitl_mock.host.server import Simulator, SimulatorOptions
from sitl_mock.host.targets import TargetOptions, Targets, parse_target
from tests.sitl.process import simulator
from tests.sitl.test_server import STATION, VirtualLoop

ORIGIN = (47.397742, 8.545594, 488.0)
CORNERS = [(0.0, 0.0, 18.0), (40.0, 0.0, 18.0), (40.0, 30.0, 24.0), (0.0, 30.0, 20.0)]
COURSE = {"points_enu_m": CORNERS, "speed_m_s": 4.0, "acceleration_m_s2": 2.0}
CASES: dict[str, tuple[dict[str, Any], TrueMotion]] = {
    "static": ({"position_enu_m": (3.0, -4.0, 18.0)}, Static((3.0, -4.0, 18.0))),
    "circle": (
        {"centre_enu_m": (5.0, -5.0, 18.0), "radius_m": 50.0, "speed_m_s": 4.0, "phase_deg": 30.0},
        Circle((5.0, -5.0, 18.0), 50.0, 4.0, 30.0),
    ),
    "circle, clockwise": (
        {"centre_enu_m": (5.0, -5.0, 18.0), "radius_m": 20.0, "speed_m_s": 3.0, "clockwise": True},
        Circle((5.0, -5.0, 18.0), 20.0, 3.0, clockwise=True),
    ),
    "figure_eight": (
        {"centre_enu_m": (5.0, -5.0, 18.0), "length_m": 60.0, "top_speed_m_s": 5.0, "heading_deg": 25.0},
        FigureEight((5.0, -5.0, 18.0), 60.0, 5.0, 25.0),
    ),
    "waypoints": (COURSE, Waypoints(CORNERS, 4.0, 2.0)),
    "waypoints, closed": (COURSE | {"closed": True}, Waypoints(CORNERS, 4.0, 2.0, closed=True)),
}


def target(name: str, system_id: int = 101, **more: Any) -> TargetOptions:  # noqa: ANN401  # any of its keys
    keys = {"system_id": system_id, "kind": name.split(",")[0], **CASES[name][0], **more}
    return parse_target(json.dumps(keys))


def decoded(data: bytes) -> list[Any]:
    return list(dialect.MAVLink(None).parse_buffer(data) or [])


def place(message: Any) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:  # noqa: ANN401  # pymavlink has no types
    altitude_m = message.alt / 1e3 if message.get_type() == "GLOBAL_POSITION_INT" else message.alt
    return enu_from_geodetic(Geodetic(message.lat / 1e7, message.lon / 1e7, altitude_m), Geodetic(*ORIGIN))


@pytest.mark.parametrize("name", CASES)
def test_targets_are_where_the_ground_station_understands_the_same_motion(name: str) -> None:
    targets = Targets([target(name, follow_target=True)], 1, ORIGIN)
    counted = {"HEARTBEAT": 0, "GLOBAL_POSITION_INT": 0, "FOLLOW_TARGET": 0}
    for tick in range(9000):
        now_s = tick / 100.0
        for message in [m for sent in targets.telemetry(now_s) for m in decoded(sent.data)]:
            kind = message.get_type()
            counted[kind] += 1
            assert message.get_srcSystem() == 101
            if kind == "HEARTBEAT":
                assert (message.type, message.autopilot) == (
                    dialect.MAV_TYPE_GROUND_ROVER,
                    dialect.MAV_AUTOPILOT_GENERIC,
                )
                continue
            positions, velocities = CASES[name][1].at(np.array([now_s]))
            # degrees come in steps of 1e-7, which is 11 mm; heights in mm
            assert place(message) == pytest.approx(positions[0], abs=0.0085)
            east, north, up = velocities[0]
            if kind == "FOLLOW_TARGET":
                assert message.timestamp == round(now_s * 1e3)
                assert message.vel == pytest.approx([north, east, -up], abs=1e-5)
            else:
                assert message.time_boot_ms == round(now_s * 1e3)
                assert [message.vx, message.vy, message.vz] == pytest.approx(
                    [100 * north, 100 * east, -100 * up], abs=0.51
                )
                assert message.relative_alt == pytest.approx(1e3 * positions[0][2], abs=0.51)
    assert counted == {"HEARTBEAT": 90, "GLOBAL_POSITION_INT": 900, "FOLLOW_TARGET": 900}


def sent_by(simulated: Simulator, loop: VirtualLoop, seconds: float) -> list[tuple[float, int, bytes]]:
    loop.run_until_complete(simulated.start())
    loop.run_until_s(seconds)
    loop.run_until_complete(simulated.close())
    loop.close()
    assert {remote for _, _, remote, _ in loop.sent} == {STATION}
    return [(at_s, address[1], data) for at_s, address, _, data in loop.sent]


def test_targets_fly_beside_vehicles_on_sockets_of_their_own() -> None:
    targets = (target("circle"), target("waypoints", 102, rate_hz=20.0))
    options = SimulatorOptions(pads_enu_m=((0.0, 0.0),), system_ids=(1,), targets=targets)
    loop = VirtualLoop()
    simulated = Simulator(options)
    assert simulated.targets_enu_m[1] == pytest.approx(CORNERS[0])
    sent = sent_by(simulated, loop, 3.0)
    systems = {port: data[5] for _, port, data in sent}  # byte 5 of a MAVLink 2 frame is the sender's system id
    assert sorted(systems.values()) == [1, 101, 102]
    for system_id, rate_hz in ((101, 10.0), (102, 20.0)):
        own = [(at_s, data) for at_s, _, data in sent if data[5] == system_id]
        times = [at_s for at_s, data in own if decoded(data)[0].get_type() == "GLOBAL_POSITION_INT"]
        assert np.diff(times[1:]) == pytest.approx(1.0 / rate_hz, abs=0.0015)  # the first tick is late
    assert simulated.counters.unsendable == 0


def test_the_same_targets_send_the_same_bytes_and_listen_to_nobody() -> None:
    runs = []
    for noise in (b"", b"\xfd\x00\xff noise"):
        loop = VirtualLoop()
        simulated = Simulator(SimulatorOptions(pads_enu_m=(), system_ids=(), targets=(target("figure_eight"),)))
        loop.run_until_complete(simulated.start())
        simulated.receive(0, 0, noise)
        loop.run_until_s(2.0)
        loop.run_until_complete(simulated.close())
        loop.close()
        runs.append([data for *_, data in loop.sent])
    assert len(runs[0]) >= 21
    assert runs[0] == runs[1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("circle", "not a JSON object"),
        ("[" * 9999, "not a JSON object"),
        ("[]", "not a JSON object"),
        ('{"kind": "static", "position_enu_m": [0, 0, 9]}', "system_id must be a whole number from 1 to 255"),
        ('{"system_id": 300, "kind": "static", "position_enu_m": [0, 0, 9]}', "system_id must be"),
        ('{"system_id": 9, "position_enu_m": [0, 0, 9]}', "kind 'None' is not one of: static, circle"),
        ('{"system_id": 9, "kind": "static"}', "position_enu_m"),
        ('{"system_id": 9, "kind": "static", "position_enu_m": [0, 9]}', "position_enu_m must be [east, north, up]"),
        (
            '{"system_id": 9, "kind": "static", "position_enu_m": [0, 0, NaN]}',
            "position_enu_m must be [east, north, up]",
        ),
        ('{"system_id": 9, "kind": "static", "position_enu_m": [0, 0, 9], "colour": 3}', "colour"),
        ('{"system_id": 9, "kind": "static", "position_enu_m": [0, 0, 9], "rate_hz": 0}', "rate_hz must be a number"),
        (
            '{"system_id": 9, "kind": "circle", "centre_enu_m": [0, 0, 9], "radius_m": 0}',
            "radius_m must be a number",
        ),
        ('{"system_id": 9, "kind": "waypoints", "points_enu_m": [[0, 0, 9]], "speed_m_s": 4}', "at least two points"),
        ('{"system_id": 9, "kind": "waypoints", "points_enu_m": [[0, 0, 9], [1, 0, 9]], "speed_m_s": 4}', "too short"),
        (
            '{"system_id": 9, "kind": "waypoints", "points_enu_m": [[0, 0, 9], [0, 0, 9]], "speed_m_s": 4}',
            "one place",
        ),
        ('{"system_id": 9, "kind": "waypoints", "points_enu_m": 3, "speed_m_s": 4}', "points_enu_m must be a list"),
    ],
)
def test_targets_that_are_none_are_refused(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=f"^[^\n]*{re.escape(said)}[^\n]*$"):
        parse_target(text)


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@given(
    st.sampled_from(sorted(CASES)), st.sampled_from(["system_id", "rate_hz", "kind", "points_enu_m", "radius_m"]), JSON
)
def test_any_value_makes_a_target_or_one_clear_line(name: str, key: str, value: Any) -> None:  # noqa: ANN401  # any JSON
    keys = {"system_id": 101, "kind": name.split(",")[0], **CASES[name][0], key: value}
    said = ""
    try:
        assert Targets([parse_target(json.dumps(keys))], 1, ORIGIN).telemetry(0.0) is not None
    except ValueError as error:
        said = str(error)
    assert "\n" not in said


def test_the_command_line_takes_targets() -> None:
    text = json.dumps({"system_id": 101, "kind": "static", "position_enu_m": [0.0, 0.0, 18.0]})
    with simulator("--vehicles", "0", "--target", text) as ports:
        assert len(ports) == 1
    for arguments, said in (
        (["--vehicles", "0", "--target", "3"], "not a JSON object"),
        (["--target", text.replace("101", "1")], "system id 1 belongs to 2 vehicles"),
    ):
        command = [sys.executable, "-m", "sitl_mock", *arguments]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        assert run.returncode == 2
        assert said in run.stderr.splitlines()[-1]
