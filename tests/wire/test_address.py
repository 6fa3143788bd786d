import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.wire.address import MAIN, VehicleAddress, names, vehicles_named

ADDRESSES = st.builds(VehicleAddress, st.sampled_from([MAIN, "east", "west"]), st.integers(1, 250))


def main(*system_ids: int) -> list[VehicleAddress]:
    return [VehicleAddress(MAIN, system_id) for system_id in system_ids]


@pytest.mark.parametrize(
    ("addresses", "text"),
    [
        ([], ""),
        (main(7), "7"),
        (main(4, 2, 1, 3, 7), "1-4, 7"),
        ([VehicleAddress("west", 2), *(VehicleAddress("east", n) for n in (1, 2, 3))], "east/1-3, west/2"),
        ([VehicleAddress("east", 1), VehicleAddress("west", 2)], "east/1, west/2"),
    ],
)
def test_runs_are_joined_within_a_network(addresses: list[VehicleAddress], text: str) -> None:
    assert names(addresses) == text


def test_a_sentence_has_the_number_of_its_subject() -> None:
    assert vehicles_named(main(3)) == "vehicle 3"
    assert vehicles_named(main(3, 5)) == "vehicles 3, 5"


@given(addresses=st.sets(ADDRESSES, max_size=30))
def test_names_tell_every_vehicle_and_no_other(addresses: set[VehicleAddress]) -> None:
    told = set()
    for run in names(addresses).split(", ") if addresses else []:
        network, _, ids = run.rpartition("/")
        first, _, last = ids.partition("-")
        told |= {VehicleAddress(network or MAIN, n) for n in range(int(first), int(last or first) + 1)}
    assert told == addresses


@given(addresses=st.lists(ADDRESSES))
def test_vehicles_are_ordered_by_network_then_by_system_id(addresses: list[VehicleAddress]) -> None:
    assert sorted(addresses) == sorted(addresses, key=lambda address: (address.network, address.system_id))


def test_files_hold_the_system_id_alone_while_there_is_one_network() -> None:
    assert VehicleAddress(MAIN, 7).label == 7
    assert VehicleAddress("west", 7).label == "west/7"


@given(address=ADDRESSES)
def test_labels_lead_back_to_their_vehicle(address: VehicleAddress) -> None:
    assert VehicleAddress.labelled(address.label) == VehicleAddress.labelled(str(address)) == address
