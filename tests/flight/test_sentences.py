"""What a flight says when something does not happen: whole sentences, the right vehicles, their own reasons."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import Fence
from fg_gcs.errors import VehicleError
from fg_gcs.flight.fleet import NotInTime, until
from fg_gcs.flight.located import POSITION_SIGMA_M, Located
from fg_gcs.flight.policy import FaultKind
from fg_gcs.flight.preparation import not_ready
from fg_gcs.flight.safety import STALE_S, Bounds, Finding, Picture, faults, findings
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.rules import too_close
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.autopilots import PX4
from fg_gcs.wire.codec import Codec
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.phases import Phase
from fg_gcs.wire.texts import Text
from fg_gcs.wire.vehicle import Battery, Vehicle

RULES = Rules(Limits(8.0, 4.0), 1.5, Fence((-30.0, -30.0, 2.0), (30.0, 30.0, 30.0)))


def fleet(count: int = 5, network: str = MAIN) -> list[Vehicle]:
    position = dialect.MAVLink_local_position_ned_message(0, 0.0, 0.0, -10.0, 0.0, 0.0, 0.0)
    vehicles = [Vehicle(VehicleAddress(network, number), PX4, 0.0) for number in range(1, count + 1)]
    for vehicle in vehicles:
        for heard in Codec().receive(Sender(vehicle.system_id, 1).pack(position)):
            vehicle.handle(heard, 0.0)
        vehicle.phase = Phase.FLYING
    return vehicles


def test_what_does_not_happen_in_time_names_who_did_not_do_it() -> None:
    vehicles = fleet()

    async def wait() -> None:
        await until(lambda: [vehicles[1], vehicles[4]], 10.0, "arrive at the formation")

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner, pytest.raises(NotInTime) as caught:
        runner.run(wait())
    assert str(caught.value) == "vehicles 2, 5 did not arrive at the formation within 10 s"
    assert caught.value.vehicles == (vehicles[1], vehicles[4])
    assert isinstance(caught.value, VehicleError)


def test_vehicles_that_are_not_ready_for_one_reason_are_named_together() -> None:
    vehicles = fleet()
    for vehicle in vehicles[:3]:
        vehicle.recent_texts.append(Text(4, "GPS fix missing", 0.0))
    vehicles[4].recent_texts.append(Text(4, "compass not calibrated", 0.0))
    assert not_ready(vehicles[:3]) == "not ready to arm within 90 s: vehicles 1-3 (GPS fix missing)"
    assert not_ready(vehicles) == (
        "not ready to arm within 90 s: vehicles 1-3 (GPS fix missing), vehicle 4 (no reason given), "
        "vehicle 5 (compass not calibrated)"
    )


def found(vehicles: Sequence[Vehicle], places: Array, now_s: float = 0.1, at_s: Array | None = None) -> list[Finding]:
    heard_at_s = np.array([vehicle.position_at_s for vehicle in vehicles]) if at_s is None else at_s
    nothing, slow = np.full((len(vehicles), 3), np.nan), np.zeros(len(vehicles))
    sure = np.full(len(vehicles), POSITION_SIGMA_M)
    where = Located(now_s, places, np.zeros_like(places), now_s - heard_at_s, sure)
    return findings(Picture(vehicles, range(len(vehicles)), where, nothing, slow, now_s), RULES, Bounds())


def said(vehicles: Sequence[Vehicle], east_m: Sequence[float] = (0.0, 5.0, 10.0, 15.0, 20.0)) -> list[str]:
    places = np.array([[east, 0.0, 10.0] for east in east_m])
    return [fault.text for fault in faults(found(vehicles, places), RULES)]


def test_every_fault_is_a_sentence_about_its_vehicles() -> None:
    vehicles = fleet(network="west")
    assert said(vehicles) == []
    vehicles[1].phase, vehicles[2].phase = Phase.TAKEN, Phase.LANDED
    vehicles[0].heard_at_s = -9.0
    vehicles[1].mode = PX4.modes["LOITER"]
    vehicles[3].battery = Battery(14.0, 0.1)
    assert said(vehicles) == [
        "vehicle west/1 is lost: nothing is heard from it",
        "vehicle west/2 is taken over: something else changed its mode (LOITER)",
        "vehicle west/3 disarmed in flight",
        "vehicle west/4 has a low battery",
    ]
    assert said(fleet(), (0.0, 1.25, 10.0, 15.0, 31.0)) == [
        "vehicles 1 and 2 are 1.25 m apart (minimum 1.50 m)",
        "vehicle 5 is outside the fence by 1.0 m",
    ]


def test_a_fault_of_a_pair_is_of_both() -> None:
    places = np.array([[0.0, 0.0, 10.0], [1.0, 0.0, 10.0]])
    (fault,) = faults(found(fleet(2), places), RULES)
    assert (fault.kind, [str(vehicle) for vehicle in fault.vehicles]) == (FaultKind.SEPARATION, ["1", "2"])


def test_a_whole_swarm_with_one_fault_is_one_line() -> None:
    vehicles = fleet(249)
    for number, vehicle in enumerate(vehicles):
        vehicle.battery = Battery(14.0, 0.1)
        vehicle.phase = Phase.TAKEN if number % 2 else Phase.FLYING
        vehicle.heard_at_s = 0.0 if number % 2 else -9.0
        vehicle.mode = PX4.modes["LOITER" if number < 100 else "RTL"]
    lost, taken, fence, battery = said(vehicles, [40.0 + 2.0 * number for number in range(249)])
    assert lost.startswith("vehicles 1, 3, 5")
    assert lost.endswith("249 are lost: nothing is heard from them")
    assert taken.endswith("248 are taken over: something else changed their modes (LOITER, RTL)")
    assert battery.endswith("248 have low batteries")
    assert fence == "vehicles 1-249 are outside the fence by up to 506.0 m"
    assert said(fleet(5), [0.0, 1.0, 1.5, 10.0, 20.0]) == [
        "vehicles 2 and 3 are 0.50 m apart (minimum 1.50 m); with one other pair of vehicles 1-3 it is likewise"
    ]


def test_positions_that_are_old_or_not_known_say_nothing() -> None:
    places = np.array([[0.0, 0.0, 10.0], [1.0, 0.0, 10.0]])
    assert {one.kind for one in found(fleet(2), places, now_s=STALE_S + 0.1)} == {FaultKind.SILENT}
    unheard = [Vehicle(VehicleAddress(MAIN, number), PX4, 0.0) for number in (1, 2)]
    assert {one.kind for one in found(unheard, np.full((2, 3), np.nan))} == {FaultKind.LOST}


@given(
    places=arrays.arrays(np.float64, st.tuples(st.integers(0, 12), st.just(3)), elements=st.floats(0.0, 5.0)),
    ages_s=st.lists(st.floats(0.0, 2.0 * STALE_S), min_size=12, max_size=12),
)
def test_every_pair_of_fresh_positions_that_is_too_close_is_found(places: Array, ages_s: list[float]) -> None:
    vehicles, at_s = fleet(len(places)), -np.array(ages_s)[: len(places)]
    pairs = {
        (vehicles[first].address, vehicles[second].address)
        for first, second in combinations(range(len(places)), 2)
        if -at_s[first] < STALE_S
        and -at_s[second] < STALE_S
        and too_close(float(np.linalg.norm(places[first] - places[second])), RULES.separation_m)
    }
    made = found(vehicles, places, 0.0, at_s)
    assert {one.vehicles for one in made if one.kind is FaultKind.SEPARATION} == pairs
