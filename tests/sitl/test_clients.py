"""What clients do to the simulator: hostile setpoints never reach its state, and none harms another's vehicles."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl_mock import SimulatorOptions, grid
from tests.sitl.driver import Station, ready
from tests.sitl.virtual import World, command, heartbeat

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
FIRST, SECOND = 18570, 18571
numbers = st.one_of(
    st.floats(-50.0, 50.0, width=32), st.floats(width=32), st.sampled_from([np.nan, np.inf, -np.inf, 3e38, 1e9, -1e9])
)
masks = st.one_of(st.sampled_from([0x800, 0x9F8, 0x9C7, 0x9C0, 0, 0xFFF]), st.integers(0, 0xFFFF))


def finite(station: Station) -> bool:
    swarm = station.fleet.swarm
    arrays = (
        swarm.position_m,
        swarm.velocity_m_s,
        swarm.acceleration_m_s2,
        swarm.yaw_rad,
        swarm.estimated_position_m,
        swarm.commands.position_m,
        swarm.commands.velocity_m_s,
        swarm.commands.acceleration_m_s2,
        swarm.commands.yaw_rad,
    )
    return all(np.isfinite(array).all() for array in arrays)


@pytest.fixture(
    scope="module", params=[("px4", "paper"), ("px4", "measured"), ("ardupilot", "paper"), ("ardupilot", "measured")]
)
def flying(request: pytest.FixtureRequest) -> Station:
    """One vehicle in the air, which goes on from one example to the next."""
    autopilot, dynamics = request.param
    station = Station(autopilot, dynamics=dynamics)
    station.run(2.0)
    station.fly_to(10.0)
    return station


@given(st.lists(numbers, min_size=10, max_size=10), masks, st.sampled_from([0, 1, 7, 8, 9, 21]))
@settings(max_examples=150, deadline=None)
def test_no_setpoint_makes_the_state_infinite(flying: Station, values: list[float], mask: int, frame: int) -> None:
    flying.setpoint((0.0, 0.0, -10.0), mask=0x800)  # as in a stream, which is read in another way
    flying.setpoint(values[:3], values[3:6], values[6:9], values[9], mask=mask, frame=frame)
    flying.run(0.03)
    assert finite(flying)


@BOTH
def test_a_flood_at_one_vehicle_changes_nothing_at_another(autopilot: str) -> None:
    """Ten thousand datagrams of noise and of good frames for the first; the second's are what they were without."""
    heard = []
    for flood in (False, True):
        here = World(SimulatorOptions(autopilot, grid(2), port_base=FIRST))
        here.station.send(heartbeat(), FIRST)
        here.run(1.0)
        draw = random.Random(4)
        for k in range(100):
            for _ in range(100 if flood else 0):
                here.station.transport.sendto(draw.randbytes(draw.randrange(1, 300)), ("127.0.0.1", FIRST))
                here.station.send(heartbeat(), FIRST, sequence=k)
            if k == 50:
                here.station.send(command(512, 148, system=2), SECOND)
            here.run(0.05)
        heard.append([(t, data) for t, port, data in here.station.heard if port == SECOND])
        assert len(here.station.messages("AUTOPILOT_VERSION", SECOND)) == 1
        here.close()
    assert heard[0] == heard[1]


@BOTH
def test_a_client_that_vanishes_and_comes_back_goes_on(autopilot: str) -> None:
    here = World(SimulatorOptions(autopilot, grid(1), port_base=FIRST))
    here.station.send(heartbeat(), FIRST)
    here.run(1.0)
    here.station.transport.close()
    here.run(20.0)
    again = here.other(14550)
    here.run(1.5)
    assert again.messages("HEARTBEAT", FIRST)
    again.send(command(512, 148), FIRST)
    here.run(0.1)
    assert again.messages("AUTOPILOT_VERSION", FIRST)
    here.close()


def test_two_clients_at_one_vehicle() -> None:
    """PX4: whoever comes second is obeyed, and its answers go to the first; ArduPilot hears its remote alone."""
    for autopilot in ("px4", "ardupilot"):
        here = World(SimulatorOptions(autopilot, grid(1), port_base=FIRST))
        second = here.other(40000)
        here.station.send(heartbeat(), FIRST)
        here.run(2.0)
        second.send(command(512, 148), FIRST)
        here.run(0.5)
        assert bool(here.station.messages("AUTOPILOT_VERSION", FIRST)) is (autopilot == "px4")
        assert not second.heard
        assert here.simulator.counters.dropped == (0 if autopilot == "px4" else 1)
        here.close()


def test_whoever_only_listens_opens_nothing() -> None:
    """Status texts are sent to those that spoke: a second remote that is silent gets telemetry and no texts."""
    station = ready("px4", links=2)
    station.command(400, 2.0)
    assert station.texts()
    assert not [m for m in station.messages("STATUSTEXT", link=1)]
