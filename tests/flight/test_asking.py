"""How a fleet is asked: in order, so many at a time, all vehicles side by side, and every failure told."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fg_gcs.errors import VehicleError
from fg_gcs.flight.fleet import STEP_S, Fleet
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.link.router import Router
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.autopilots import PX4
from fg_gcs.wire.codec import Message
from fg_gcs.wire.commands import arm
from fg_gcs.wire.dialogue import State
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.reading import ReadParameters, Wanted
from fg_gcs.wire.vehicle import Vehicle


@dataclass
class Taking:
    """A question that takes its time, and is then done or refused; notes when it was asked."""

    seconds: float
    refused: bool
    asked: list[tuple[float, float]]  # from and to, of all of one vehicle

    state: State = State.PENDING
    reason: str = ""
    _ends_s: float | None = field(default=None)

    def dialogue(self, vehicle: Vehicle) -> Taking:
        self.reason = f"vehicle {vehicle.address} did not want to"
        return self

    def step(self, now_s: float) -> Sequence[Message]:
        if self._ends_s is None:
            self._ends_s = now_s + self.seconds
            self.asked.append((now_s, self._ends_s))
        if now_s >= self._ends_s - 1e-9:
            self.state = State.REFUSED if self.refused else State.DONE
        return ()


def asked(scripts: list[list[tuple[float, bool]]], at_once: int) -> tuple[list[list[tuple[float, float]]], str]:
    """Ask several vehicles; return when each question was asked, and what was told of failures."""
    times: list[list[tuple[float, float]]] = [[] for _ in scripts]

    async def run() -> str:
        router = await Router.open({})
        vehicles = [Vehicle(VehicleAddress(MAIN, 1 + number), PX4, 0.0) for number in range(len(scripts))]

        def script(vehicle: Vehicle) -> Iterator[Taking]:
            row = vehicle.system_id - 1
            for seconds, refused in scripts[row]:
                yield Taking(seconds, refused, times[row])

        try:
            await Fleet(router, vehicles).ask(vehicles, script, at_once)
        except VehicleError as error:
            return str(error)
        return ""

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return times, runner.run(run())


DURATIONS = st.integers(0, 20).map(lambda steps: steps * STEP_S)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.lists(st.tuples(DURATIONS, st.just(False)), max_size=6), min_size=1, max_size=4), st.integers(1, 4))
def test_every_question_is_asked_in_order_and_never_too_many_at_once(
    scripts: list[list[tuple[float, bool]]], at_once: int
) -> None:
    times, told = asked(scripts, at_once)
    assert told == ""
    for script, of_one in zip(scripts, times, strict=True):
        assert len(of_one) == len(script)
        begins_s = [begin_s for begin_s, _ in of_one]
        assert begins_s == sorted(begins_s)
        for begin_s in begins_s:
            assert sum(begin <= begin_s < end - 1e-9 for begin, end in of_one) <= at_once


def test_after_a_failure_nothing_new_is_begun_and_the_others_go_on() -> None:
    times, told = asked([[(0.1, True), (0.5, False), (0.1, False)], [(1.0, False), (0.2, True)]], 2)
    assert [len(of_one) for of_one in times] == [2, 2]
    assert told == "vehicle 1 did not want to; vehicle 2 did not want to"


def test_of_a_vehicle_that_is_lost_nothing_more_is_waited_for() -> None:
    """Parameters are asked for longer than all else, but not of one that is silent."""

    async def run() -> float:
        time = asyncio.get_running_loop().time
        vehicle = Vehicle(VehicleAddress(MAIN, 7), PX4, 0.0)
        vehicle.phase = Phase.LOST
        with pytest.raises(VehicleError, match="did not arm within 12 s"):
            await Fleet(await Router.open({}), [vehicle]).ask([vehicle], lambda one: [reading, arm()], 2)
        return time()

    reading = ReadParameters((Wanted(("FS_GCS_ENABLE",), needed=True),))
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        assert runner.run(run()) < 13.0


def test_a_vehicle_that_is_not_there_is_told_after_the_deadline() -> None:
    async def run() -> None:
        router = await Router.open({})
        vehicle = Vehicle(VehicleAddress(MAIN, 7), PX4, 0.0)
        await Fleet(router, [vehicle]).ask([vehicle], lambda one: [arm()])

    with (
        asyncio.Runner(loop_factory=VirtualTimeLoop) as runner,
        pytest.raises(VehicleError, match=r"^vehicle 7 did not arm within 12 s$"),
    ):
        runner.run(run())
