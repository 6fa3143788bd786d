"""What is learnt of drag and lag, and what setpoints make of it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.flight.compensation import GRAVITY_M_S2, LEARNS_S, DragFit, ahead, thrust_m_s2
from fg_gcs.mission import parse_mission
from fg_gcs.run import FlyOptions, fly_blocking
from tests.flight.harness import CIRCLING

angles = st.floats(-0.7, 0.7)


@given(st.floats(-math.pi, math.pi), angles, angles)
def test_a_lean_gives_what_the_body_s_axis_says(yaw_rad: float, roll_rad: float, pitch_rad: float) -> None:
    """The thrust points along -z of the body; its vertical part carries the weight."""
    c, s = np.cos, np.sin
    yaw = np.array([[c(yaw_rad), -s(yaw_rad), 0], [s(yaw_rad), c(yaw_rad), 0], [0, 0, 1]])
    pitch = np.array([[c(pitch_rad), 0, s(pitch_rad)], [0, 1, 0], [-s(pitch_rad), 0, c(pitch_rad)]])
    roll = np.array([[1, 0, 0], [0, c(roll_rad), -s(roll_rad)], [0, s(roll_rad), c(roll_rad)]])
    north, east, down = -(yaw @ pitch @ roll)[:, 2]
    found = thrust_m_s2(np.array([yaw_rad]), np.array([[roll_rad, pitch_rad]]))[0]
    assert found == pytest.approx(GRAVITY_M_S2 / -down * np.array([east, north]), abs=1e-9)


@given(st.floats(0.05, 1.0), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.integers(0, 2**32 - 1))
def test_drag_is_found_in_wind_and_noise(drag_per_s: float, wind_east: float, wind_north: float, seed: int) -> None:
    """Forty seconds on a curve at up to 6 m/s; velocities are off by 0.1 m/s, and what does not lean has no drag."""
    draw, fit = np.random.default_rng(seed), DragFit(np.zeros(2))
    wind = np.array([wind_east, wind_north])
    for k in range(round(40.0 / LEARNS_S)):
        t = k * LEARNS_S
        place = np.array([15.0 * math.sin(0.4 * t), 10.0 * math.sin(0.25 * t + 1.0)])
        velocity = np.array([6.0 * math.cos(0.4 * t), 2.5 * math.cos(0.25 * t + 1.0)])
        change = np.array([-2.4 * math.sin(0.4 * t), -0.625 * math.sin(0.25 * t + 1.0)])
        leans = change + drag_per_s * (velocity - wind)
        noisy = np.append(velocity + draw.normal(0.0, 0.1, 2), 0.0)
        fit.take(np.array([leans, [0.0, 0.0]]), np.tile(np.append(place, 10.0), (2, 1)), np.tile(noisy, (2, 1)))
    assert fit.drag_per_s[0] == pytest.approx(drag_per_s, abs=0.03 + 0.03 * drag_per_s)
    assert fit.drag_per_s[1] == 0.0


@given(st.floats(0.0, 0.5), st.floats(0.0, 1.5), st.lists(st.floats(-5.0, 5.0), min_size=9, max_size=9))
def test_what_is_sent_is_the_motion_of_later_with_its_drag(lead_s: float, drag: float, numbers: list[float]) -> None:
    """Exact at a constant acceleration; heights have no drag."""
    place, velocity, acceleration = np.reshape(numbers, (3, 3))
    planned = np.concatenate((place, velocity, acceleration, [0.3]))[None]
    sent = ahead(planned, np.array([lead_s]), np.array([drag]))[0]
    later = velocity + lead_s * acceleration
    assert sent[0:3] == pytest.approx(place + lead_s * velocity + 0.5 * lead_s**2 * acceleration)
    assert sent[3:6] == pytest.approx(later)
    assert sent[6:9] == pytest.approx(acceleration + drag * later * (1.0, 1.0, 0.0))
    assert sent[9] == 0.3


def test_px4_keeps_to_its_setpoints_better(tmp_path: Path) -> None:
    """Nine with the measured dynamics, whole flights: rms errors as a share of those without."""
    path = Path("missions/sitl_circle.toml")
    text = path.read_text().replace("duration_s = 30.0", "duration_s = 12.0")
    rms_m = []
    for compensation in ("false", "true"):
        options = FlyOptions(autopilot="px4", dynamics="measured", logs=tmp_path, write_report=False)
        mission = parse_mission(f"{text}\n[stream]\ncompensation = {compensation}\n", path)
        found = fly_blocking(mission, options, speed=math.inf).summary
        assert found["completed"] is True
        rms_m.append(float(str(found["tracking_rms_m"])))
    assert rms_m[1] < 0.5 * rms_m[0]


def test_a_late_link_teaches_no_lag(tmp_path: Path) -> None:
    """Particles do not lag: what seems to be lag there is lateness that jitter hides, another one for each vehicle."""
    late = {"delay_s": 0.1, "jitter_s": 0.1, "reorder": 0.1, "duplicate": 0.1}
    options = FlyOptions(impairments=(late,), logs=tmp_path, write_report=False)
    found = fly_blocking(parse_mission(CIRCLING), options, speed=math.inf).summary
    assert found["completed"] is True
    leads = found["learnt_lead_s"]
    assert isinstance(leads, list)
    assert max(leads) < 0.02
