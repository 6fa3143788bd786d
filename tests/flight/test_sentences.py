"""What a flight says when something does not happen: whole sentences, the right vehicles, their own reasons."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.core.separation import Fence
from fg_gcs.errors import VehicleError
from fg_gcs.flight.fleet import NotInTime, until
from fg_gcs.flight.preparation import not_ready
from fg_gcs.flight.safety import Kind, faults
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.plan.limits import Limits, Rules
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
        await until(vehicles, lambda vehicle: vehicle.system_id not in (2, 5), 10.0, "arrive at the formation")

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner, pytest.raises(NotInTime) as caught:
        runner.run(wait())
    assert str(caught.value) == "vehicles 2, 5 did not arrive at the formation within 10 s"
    assert caught.value.waiting == (vehicles[1], vehicles[4])
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


def said(vehicles: Sequence[Vehicle], east_m: Sequence[float] = (0.0, 5.0, 10.0, 15.0, 20.0)) -> list[str]:
    places = np.array([[east, 0.0, 10.0] for east in east_m])
    return [fault.text for fault in faults(vehicles, places, RULES, 0.1)]


def test_every_fault_is_a_sentence_about_its_vehicles() -> None:
    vehicles = fleet(network="west")
    assert said(vehicles) == []
    vehicles[0].phase, vehicles[1].phase, vehicles[2].phase = Phase.LOST, Phase.TAKEN, Phase.LANDED
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
    (fault,) = faults(fleet(2), places, RULES, 0.1)
    assert (fault.kind, [str(vehicle) for vehicle in fault.vehicles]) == (Kind.SEPARATION, ["1", "2"])
