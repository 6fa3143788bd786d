"""Which vehicle: its network and its system id, since two networks may each have a vehicle 7."""

from collections.abc import Iterable
from typing import Final, NamedTuple, Self

MAIN: Final = "main"  # the network without a name of its own, and the only one whatever its name: never shown


class VehicleAddress(NamedTuple):
    """One vehicle among all networks; ordered by network, then by system id.

    Attributes:
        network: Name of its network.
        system_id: MAVLink system id, 1 to 250.
    """

    network: str
    system_id: int

    @classmethod
    def labelled(cls, label: int | str) -> Self:
        """Return the vehicle that a label, or what ``str`` makes of an address, stands for.

        Raises:
            ValueError: it is no label.
        """
        network, _, system_id = str(label).rpartition("/")
        return cls(network or MAIN, int(system_id))

    def __str__(self) -> str:
        return f"{self._prefix}{self.system_id}"

    @property
    def label(self) -> int | str:
        """As files hold it: the system id alone, or ``west/7`` where a network has to be told."""
        return str(self) if self._prefix else self.system_id

    @property
    def _prefix(self) -> str:
        return "" if self.network == MAIN else f"{self.network}/"


def names(addresses: Iterable[VehicleAddress]) -> str:
    """Return addresses as people write them, runs joined: ``1-4, 7`` or ``east/1-3, west/2``."""
    runs: list[tuple[VehicleAddress, VehicleAddress]] = []
    for address in sorted(addresses):
        if runs and runs[-1][1] == address._replace(system_id=address.system_id - 1):
            runs[-1] = (runs[-1][0], address)
        else:
            runs.append((address, address))
    return ", ".join(str(first) if first == last else f"{first}-{last.system_id}" for first, last in runs)


def vehicles_named(addresses: Iterable[VehicleAddress]) -> str:
    """Return addresses as the subject of a sentence: ``vehicle 3`` or ``vehicles 1-4, 7``."""
    listed = tuple(addresses)
    return f"vehicle{'s' if len(listed) > 1 else ''} {names(listed)}"
