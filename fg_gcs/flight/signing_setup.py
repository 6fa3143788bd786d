"""Vehicles that have no key yet are given ours, and nothing is begun before every one of them signs with it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Final

from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.journal import Journal
from fg_gcs.wire.address import vehicles_named
from fg_gcs.wire.codec import Message
from fg_gcs.wire.dialogue import Request
from fg_gcs.wire.signing import Signing
from fg_gcs.wire.vehicle import Vehicle

SETTLE_S: Final = 5.0  # heartbeats come once a second; one that is signed has to be among them


async def set_up_signing(fleet: Fleet, signing: Mapping[str, Signing], journal: Journal) -> None:
    """Give the vehicles of each network that is to be set up its key; what they send unsigned is not taken any more.

    Others may still be heard unsigned, in case one of them has to fly instead, until `Signing.rely`.

    Args:
        fleet: nobody has armed them.
        signing: of each network, by its name.
        journal: where it is told.

    Raises:
        NotDone: a vehicle does not sign.
    """
    given = [vehicle for vehicle in fleet.vehicles if _is_to_be_given(vehicle, signing)]
    await fleet.ask(given, lambda vehicle: [_request(signing[vehicle.address.network])])
    signed = [vehicle.address for vehicle in fleet.vehicles if vehicle.address.network in signing]
    if signed:
        journal.event("signing", f"{vehicles_named(signed)} {'signs' if len(signed) == 1 else 'sign'} with our key")


def _is_to_be_given(vehicle: Vehicle, signing: Mapping[str, Signing]) -> bool:
    network = signing.get(vehicle.address.network)
    return network is not None and network.sets_up and vehicle.system_id not in network.signed


def _request(signing: Signing) -> Request:
    return Request(
        "sign what it sends with the key that it was given",
        partial(_messages, signing),
        lambda vehicle, _: vehicle.system_id in signing.signed,
        deadline_s=SETTLE_S,
    )


def _messages(signing: Signing, vehicle: Vehicle) -> list[Message]:
    return [signing.set_up(vehicle.system_id)]
