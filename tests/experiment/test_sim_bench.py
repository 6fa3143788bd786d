"""The benchmark of the simulator, small: what it says of the simulator and of requirements, not of times."""

from pathlib import Path

import pytest

from fg_gcs.errors import FgError
from fg_gcs.experiment.baselines.ground_stations import pymavlink_us
from fg_gcs.experiment.required import at_least, at_most
from fg_gcs.experiment.sim_bench import SimBench, Size, sim_bench
from fg_gcs.experiment.sim_flights import real_flight, swarm_mission
from fg_gcs.experiment.tables import NOTHING
from fg_gcs.mission.formats.toml import parse_mission
from fg_gcs.run.planning import plan
from fg_gcs.wire.bare import boot_frames

SMALL = (Path(__file__).parents[2] / "missions" / "demo.toml").read_text()
TOLD_HZ = 66  # messages of a PX4 vehicle a second


@pytest.fixture(scope="module")
def made() -> SimBench:
    return sim_bench(SMALL, lambda _: None, Size((2,), (1, 3), swarm=0, part_s=0.05, alone_s=1.0))


def test_every_part_has_its_figures(made: SimBench) -> None:
    assert [(row.dynamics, row.vehicles) for row in made.physics] == [("paper", 2), ("ardupilot", 2), ("px4", 2)]
    assert all(row.steps_s > 0.0 for row in made.physics)
    assert [row.vehicles for row in made.packing] == [each.vehicles for each in made.alone] == [1, 3]
    assert all(row.ratio > 0.0 for row in made.packing)
    assert made.virtual.flight_s > 20.0
    assert made.virtual.times_real > 1.0
    assert made.real is None


def test_the_sink_gets_what_vehicles_tell_unasked(made: SimBench) -> None:
    for each in made.alone:
        assert each.messages_s == pytest.approx(TOLD_HZ * each.vehicles, rel=0.3)
        assert each.late_p99_ms <= each.late_worst_ms + 0.1
        assert each.memory_mb > 10.0


def test_what_is_required_of_large_fleets_is_not_required_of_small_ones(made: SimBench) -> None:
    paper, measured, core, late, *memory, virtual = made.figures()
    assert (paper.required, paper.met) == (measured.required, measured.met) == (NOTHING, True)
    assert [figure.required for figure in (core, late, virtual)] == ["<= 1", "<= 10", ">= 20"]
    assert [figure.required for figure in memory] == ["<= 100.05", "<= 100.15"]


def test_a_swarm_flies_beside_the_simulator_and_what_it_took_is_required(made: SimBench) -> None:
    flown = real_flight(7, speed=5.0)
    assert (flown.vehicles, flown.rate_hz, flown.completed) == (7, 50.0, True)
    assert flown.flight_s > 30.0
    assert flown.station_core > 0.0
    assert flown.simulator_core > 0.0
    completed, error, late = made._replace(real=flown).figures()[-3:]
    assert completed.met
    assert (error.required, error.measured) == ("<= 0.1", flown.error_rms_m)
    assert (late.required, late.measured) == ("<= 10", flown.late_p99_ms)


def test_bounds() -> None:
    assert [at_most("", 1.0, value).met for value in (0.5, 1.0, 1.5, None)] == [True, True, False, False]
    assert [at_least("", 1.0, value).met for value in (0.5, 1.0, 1.5, None)] == [False, True, True, False]


@pytest.mark.parametrize("vehicles", [7, 41, 249])
def test_swarms_of_any_odd_number_have_a_plan(vehicles: int) -> None:
    mission = parse_mission(swarm_mission(vehicles))
    assert mission.swarm.vehicles == vehicles
    assert plan(mission).flight.separation.distance_m >= mission.limits.separation_m


@pytest.mark.parametrize("vehicles", [5, 248])
def test_other_numbers_are_one_line(vehicles: int) -> None:
    with pytest.raises(FgError, match=f"a hemisphere of {vehicles} vehicles; accepted: an odd number from 7 on"):
        swarm_mission(vehicles)


def test_pymavlink_packs_what_it_has_read() -> None:
    assert pymavlink_us(list(boot_frames(3).values()), 0.0) > 0.0
