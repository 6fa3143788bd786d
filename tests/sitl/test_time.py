"""Simulated time that is paused, stepped and run free, by programs and over the port; manners of other versions."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from sitl_mock import Simulator, SimulatorOptions, grid, parse_impairment
from sitl_mock.autopilot.profile import Manners
from sitl_mock.host.clock import SimulatedClock
from sitl_mock.host.server import TIME_COMMAND, TimeAction
from tests.sitl.virtual import World, command, heartbeat

FIRST = 18570


def world(**more: Any) -> World:  # noqa: ANN401 - any option
    return World(SimulatorOptions(pads_enu_m=grid(2), port_base=FIRST, **more))


def test_a_paused_simulator_stands_still_and_answers() -> None:
    here = world()
    here.run(2.0)
    here.simulator.pause()
    here.run(0.01)  # what was under way
    before, now_s = len(here.station.heard), here.simulator.now_s
    here.run(5.0)
    assert len(here.station.heard) == before
    here.station.send(command(512, 148), FIRST)
    here.run(0.1)
    assert here.station.messages("AUTOPILOT_VERSION", FIRST)
    assert here.simulator.now_s == now_s
    here.simulator.resume()
    here.run(1.0)
    assert here.simulator.now_s == pytest.approx(now_s + 1.0, abs=0.02)
    assert here.simulator.counters.slipped_s == 0.0
    here.close()


def test_steps_give_the_same_telemetry_as_time_that_runs() -> None:
    running, stepped = world(), world(lockstep=True)
    running.run(5.005)
    assert stepped.simulator.now_s == 0.0
    for seconds in (1.0, 0.5, 0.01, 0.005, 3.485):
        stepped.simulator.step(seconds)
    stepped.run(0.01)
    said = [[(port, data) for _, port, data in here.station.heard] for here in (running, stepped)]
    assert said[0] == said[1]
    for here in (running, stepped):
        here.close()


def test_only_a_paused_simulator_can_be_stepped() -> None:
    here = world()
    with pytest.raises(RuntimeError, match="paused"):
        here.simulator.step(1.0)
    here.close()
    with pytest.raises(RuntimeError, match="was not started"):
        Simulator(SimulatorOptions()).pause()


def acknowledged(here: World, *parameters: float, port: int = FIRST) -> Any:  # noqa: ANN401 - pymavlink has no types
    """The answer to a command about time, and how much was heard before it."""
    here.station.send(command(TIME_COMMAND, *parameters, system=port - FIRST + 1), port)
    here.run(0.01)
    ((_, acknowledgement),) = here.station.messages("COMMAND_ACK", port, here.loop.time() - 0.01)
    return acknowledgement


def test_lockstep_over_the_port() -> None:
    """A step's acknowledgement is the last that comes of it, and tells the time."""
    here = world(lockstep=True)
    here.run(1.0)
    assert not here.station.heard
    for k in range(1, 11):
        answer = acknowledged(here, TimeAction.STEP, 0.25, port=FIRST + k % 2)
        assert (answer.result, answer.result_param2) == (0, 250 * k)
        assert here.station.heard[-1][2][7:10] == (77).to_bytes(3, "little")
    assert {m.time_boot_ms for _, m in here.station.messages("ATTITUDE", FIRST)} <= set(range(2501))
    assert acknowledged(here, TimeAction.RUN).result == 0
    here.run(1.0)
    assert acknowledged(here, TimeAction.PAUSE).result == 0
    assert here.simulator.now_s == pytest.approx(3.51, abs=0.02)
    here.close()


def test_lockstep_works_whatever_the_links_are_like() -> None:
    """Time itself hangs on these commands: their acknowledgements are neither late nor lost."""
    impairment = parse_impairment({"loss": 1.0, "corrupt": 1.0, "delay_s": 2.0})
    here = world(lockstep=True, impairments=(impairment,))
    assert [acknowledged(here, TimeAction.STEP, 0.5).result_param2 for _ in range(3)] == [500, 1000, 1500]
    here.close()


def test_steps_that_never_end_and_steps_of_what_has_ended_are_refused() -> None:
    here = world(lockstep=True)
    for seconds in (float("inf"), float("nan"), -1.0):
        with pytest.raises(ValueError, match="a step takes from 0"):
            here.simulator.step(seconds)
    here.close()
    with pytest.raises(RuntimeError, match="is closed"):
        here.simulator.resume()


@pytest.mark.parametrize(
    "parameters", [(3.0, 0.0), (2.0, -1.0), (2.0, float("nan")), (2.0, 10.5), (2.0, 1e9), (float("nan"), 0.0)]
)
def test_commands_about_time_that_mean_nothing_are_denied(parameters: tuple[float, float]) -> None:
    here = world(lockstep=True)
    assert acknowledged(here, *parameters).result == 2
    here.close()


def test_without_lockstep_time_is_nobodys() -> None:
    here = world()
    here.run(2.0)
    here.station.send(command(TIME_COMMAND, TimeAction.PAUSE), FIRST)
    here.run(1.0)
    assert here.station.messages("COMMAND_ACK", FIRST)[-1][1].result == 3
    assert here.simulator.now_s == pytest.approx(3.0, abs=0.02)
    here.close()


def test_as_fast_as_possible() -> None:
    """A minute takes no minute, on a loop in real time; other work of the loop goes on meanwhile."""

    async def run() -> tuple[float, float, int]:
        turns = 0
        async with Simulator(SimulatorOptions(pads_enu_m=grid(2), speed=float("inf"))) as simulator:
            began_s = time.perf_counter()
            while simulator.now_s < 60.0:
                turns += 1
                await asyncio.sleep(0)
            return simulator.now_s, time.perf_counter() - began_s, turns

    simulated_s, real_s, turns = asyncio.run(run())
    assert simulated_s == pytest.approx(60.0, abs=0.1)
    assert real_s < 30.0
    assert turns > 1000


def test_a_clock_goes_on_from_where_it_stood() -> None:
    now = [10.0]
    clock = SimulatedClock(lambda: now[0], 2.0, paused=False)
    now[0] = 11.0
    assert clock.now_s() == 2.0
    clock.pause()
    now[0] = 50.0
    assert clock.now_s() == 2.0
    clock.move(0.5)
    clock.run()
    now[0] = 51.0
    assert clock.now_s() == 4.5
    assert clock.loop_s(6.5) == 52.0
    clock.slip(1.0)
    assert (clock.now_s(), clock.slipped_s) == (3.5, 1.0)


# -- manners ----------------------------------------------------------------------------------------------------------


def results(here: World, number: int, *parameters: float) -> list[int]:
    began_s = here.loop.time()
    here.station.send(command(number, *parameters), FIRST)
    here.run(0.05)
    return [m.result for _, m in here.station.messages("COMMAND_ACK", FIRST, began_s)]


def test_strict_commands() -> None:
    """Parameters that a command does not have are 0 or NaN, or it is denied."""
    nan = float("nan")
    for strict in (False, True):
        here = world(manners=Manners(strict_commands=strict))
        here.run(2.0)
        assert results(here, 511, 32, 1e5, 0, 5.0) == ([2] if strict else [0])
        assert results(here, 511, 32, 1e5, 0, nan) == [0]
        assert results(here, 20, 0, nan, 0, 0) == [0]
        assert results(here, 20, 1.0) == ([2] if strict else [0])
        assert results(here, 22, 0, 0, 0, nan, nan, nan, nan) == [0]
        assert results(here, 22, -1.0, 0, 0, nan, nan, nan, nan) == ([2] if strict else [0])
        assert results(here, 65000, 1.0, 1.0) == [3]
        here.close()


def test_a_partner_that_fell_silent_is_replaced() -> None:
    for new in (False, True):
        here = world(manners=Manners(new_partner=new))
        stranger = here.other(40000)
        here.station.send(heartbeat(), FIRST)
        here.run(3.0)
        stranger.send(heartbeat(), FIRST)
        here.run(1.0)
        assert not stranger.heard
        here.run(3.0)
        stranger.send(heartbeat(), FIRST)
        here.run(1.0)
        assert bool(stranger.heard) is new
        here.close()


def test_a_changed_parameter_freezes_the_link() -> None:
    """The answer comes, then nothing until something is heard; whoever speaks first is the partner then."""
    here = world(manners=Manners(parameter_freeze=True))
    here.station.send(heartbeat(), FIRST)
    here.run(2.0)
    set_height = dialect.MAVLink_param_set_message
    here.station.send(set_height(1, 1, b"MIS_TAKEOFF_ALT", 2.5, 9), FIRST)  # the value that it has: no change
    here.run(0.5)
    assert here.station.heard[-1][0] > here.loop.time() - 0.2
    began_s = here.loop.time()
    here.station.send(set_height(1, 1, b"MIS_TAKEOFF_ALT", 4.0, 9), FIRST)
    here.run(3.0)
    assert [m.param_value for _, m in here.station.messages("PARAM_VALUE", FIRST, began_s)] == [4.0]
    assert max(t for t, port, _ in here.station.heard if port == FIRST) < began_s + 0.1
    here.station.send(heartbeat(), FIRST)
    here.run(1.0)
    assert here.station.heard[-1][0] > here.loop.time() - 0.2
    here.close()


def test_manners_of_another_autopilot_are_refused() -> None:
    with pytest.raises(ValueError, match="strict_commands is no manner of ardupilot"):
        SimulatorOptions("ardupilot", manners=Manners(strict_commands=True))
