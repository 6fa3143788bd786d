"""Smooth flights seen through late, lossy and disordered telemetry."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.core.arrays import Array
from fg_gcs.core.frames import LocalFrames, swap_ned_enu
from fg_gcs.flight.located import MOST_CARRIED_S, located
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.autopilots import PX4
from fg_gcs.wire.codec import Codec
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.states import StateTable
from fg_gcs.wire.vehicle import Vehicle

SPEED_M_S, ACCELERATION_M_S2 = 5.0, 2.0
RADIUS_M = SPEED_M_S**2 / ACCELERATION_M_S2  # a circle flown so fast is left at so much acceleration
TURN_RAD_S = SPEED_M_S / RADIUS_M
APART_M = 2.0
MOST_ERROR_M = 0.1


def truth(vehicle: int, time_s: float) -> tuple[Array, Array]:
    """Return position and velocity of two vehicles that fly the same circle at a constant distance [m; NED]."""
    angle = TURN_RAD_S * time_s
    place = RADIUS_M * np.array([math.cos(angle), math.sin(angle), 0.2 * math.sin(0.3 * angle)])
    velocity = SPEED_M_S * np.array([-math.sin(angle), math.cos(angle), 0.06 * math.cos(0.3 * angle)])
    return place + np.array([0.0, 0.0, APART_M * vehicle]), velocity


def arrivals(draw: random.Random, rate_hz: float, duration_s: float, vehicle: int) -> list[tuple[float, int, float]]:
    """Return when samples arrive, of which vehicle, and when they were true: 150 +- 50 ms, 20 % lost, 10 % doubled."""
    found = []
    for k in range(int(rate_hz * duration_s)):
        true_s = (k + 0.37 * vehicle) / rate_hz
        copies = (draw.random() >= 0.2) * (1 + (draw.random() < 0.1))
        found += [(true_s + draw.uniform(0.1, 0.2), vehicle, true_s) for _ in range(copies)]
    return found


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rate_hz", [20.0, 25.0])
def test_late_lossy_disordered_telemetry_bends_nothing(seed: int, rate_hz: float) -> None:
    draw, states, vehicles = random.Random(seed), StateTable(2), list[Vehicle]()
    senders, codec, booted_s = [Sender(1, 1), Sender(2, 1)], Codec(), (-7.3, -1234.5)
    for row in (0, 1):
        vehicles.append(Vehicle(VehicleAddress(MAIN, row + 1), PX4, 0.0))
        vehicles[row].keep_state_in(states, row)
    events: list[tuple[float, int, float]] = []
    for row in (0, 1):
        events += arrivals(draw, rate_hz, 60.0, row)
        for k in range(120):  # TIMESYNC goes there and back through the same link
            there_s = 0.5 * k + draw.uniform(0.1, 0.2)
            events.append((there_s + draw.uniform(0.1, 0.2), row - 2, there_s))
            vehicles[row].timing.asked(k + 1, 0.5 * k)
    events += [(20.0 + k / 20.0, 9, 0.0) for k in range(780)]
    questions = {-2: 0, -1: 0}
    distances, ages, errors = [], [], []
    for at_s, kind, true_s in sorted(events):
        if kind in (0, 1):
            (x, y, z), velocity = truth(kind, true_s)
            told = dialect.MAVLink_local_position_ned_message(
                round(1e3 * (true_s - booted_s[kind])), x, y, z, *velocity
            )
            for frame in codec.receive(senders[kind].pack(told)):
                vehicles[kind].handle(frame, at_s)
        elif kind < 0:
            questions[kind] += 1
            vehicle = vehicles[kind + 2]
            vehicle.timing.answered(round(1e9 * (true_s - booted_s[kind + 2])), int((at_s - 0.2) / 0.5) + 1, at_s)
            vehicle.timing.roll(at_s)
        else:
            found = located(states, LocalFrames.parallel(np.zeros((2, 3))), at_s, ACCELERATION_M_S2)
            wanted = swap_ned_enu(np.array([truth(row, at_s)[0] for row in (0, 1)]))
            error_m = np.linalg.norm(found.position_enu_m - wanted, axis=1)
            assert (error_m < found.sigma_m).all()
            errors += error_m[found.age_s < MOST_CARRIED_S].tolist()  # older ones stand still, as sigma says
            ages.append(found.age_s.max())
            if max(ages[-1:]) < MOST_CARRIED_S:
                distances.append(np.linalg.norm(found.position_enu_m[0] - found.position_enu_m[1]))
    assert max(errors) < MOST_ERROR_M
    assert max(abs(distance - APART_M) for distance in distances) < MOST_ERROR_M
    assert 0.1 < np.median(ages) < 0.25
    assert max(ages) < 0.6


def table(velocity: tuple[float, float, float], measured_s: float) -> StateTable:
    states = StateTable(1)
    states.set_motion(0, 0.0, 0.0, 0.0, *velocity, 0.0, measured_s)
    states.set_measured(0, *velocity, measured_s)
    return states


def test_a_motion_at_constant_acceleration_is_carried_on_exactly() -> None:
    acceleration, states = np.array([1.0, -2.0, 0.5]), StateTable(1)
    for k in range(40):
        time_s = k / 25.0
        v_north, v_east, v_down = (acceleration * time_s).tolist()
        states.set_motion(0, *(0.5 * acceleration * time_s**2), v_north, v_east, v_down, time_s, time_s)
        states.set_measured(0, v_north, v_east, v_down, time_s)
    for ahead_s in (0.0, 0.1, 0.4):
        now_s = 39 / 25.0 + ahead_s
        found = located(states, LocalFrames.parallel(np.array([[1.0, 2.0, 3.0]])), now_s)
        assert found.position_enu_m[0] == pytest.approx([1.0 - now_s**2, 2.0 + 0.5 * now_s**2, 3.0 - 0.25 * now_s**2])
        assert found.age_s == pytest.approx([ahead_s])


def test_what_was_never_heard_is_nowhere_and_infinitely_old() -> None:
    found = located(StateTable(3), LocalFrames.parallel(np.zeros((3, 3))), 5.0)
    assert np.isnan(found.position_enu_m).all()
    assert np.isinf(found.age_s).all()


def test_before_the_stamps_are_known_the_arrival_stands_for_them() -> None:
    states = StateTable(1)
    states.set_motion(0, 1.0, 2.0, 3.0, 0.0, 1.0, 0.0, 77.0, 5.0)
    found = located(states, LocalFrames.parallel(np.zeros((1, 3))), 5.5)
    assert found.age_s.tolist() == [0.5]
    assert found.position_enu_m.tolist() == [[2.5, 1.0, -3.0]]


def test_age_and_uncertainty_grow_and_what_is_old_stands_still() -> None:
    states = table((3.0, 4.0, 0.0), 0.0)
    times = np.linspace(0.0, 6.0, 61)
    found = [located(states, LocalFrames.parallel(np.zeros((1, 3))), time_s) for time_s in times]
    assert [each.age_s[0] for each in found] == pytest.approx(times)
    sigmas = np.array([each.sigma_m[0] for each in found])
    assert (np.diff(sigmas) > 0.0).all()
    assert (np.diff(sigmas, 2) > -1e-9).all()
    for time_s, each in zip(times, found, strict=True):
        assert np.linalg.norm(each.position_enu_m) == pytest.approx(5.0 * min(time_s, MOST_CARRIED_S))
        # it may have gone on, or stopped, or turned round with all that it has
        assert each.sigma_m[0] > 5.0 * max(time_s - MOST_CARRIED_S, 0.0) + 0.5 * 5.0 * time_s**2
