"""The parameters of one vehicle and how they travel: PX4 puts integers bytewise into floats, ArduPilot casts."""

from __future__ import annotations

import math
import struct
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from sitl_mock.autopilot.profile import AutopilotProfile, ParameterDefault
from sitl_mock.messages import Fields

TYPE_IDS = MappingProxyType({"INT8": 2, "INT16": 4, "INT32": 6, "REAL32": 9})  # MAV_PARAM_TYPE
RANGES = MappingProxyType({"INT8": (-128, 127), "INT16": (-32768, 32767), "INT32": (-(2**31), 2**31 - 1)})
UNINDEXED = 65535  # param_index of an answer that belongs to no list
LEAST = 0.05  # [m/s or m/s^2] a speed or acceleration of zero would freeze a vehicle in the air
# PARAM_ERROR.error as PX4 sends it
ERROR_NAME, ERROR_TYPE_UNSUPPORTED, ERROR_TYPE_MISMATCH, ERROR_VALUE = 1, 6, 7, 3


class WriteRefused(Exception):
    """A PARAM_SET that changes nothing.

    Args:
        error: PARAM_ERROR.error, for autopilots that answer.
    """

    def __init__(self, error: int) -> None:
        self.error = error
        super().__init__(f"the parameter is refused with error {error}")


@dataclass(slots=True)
class Parameter:
    """One value with its type; integers are kept as whole floats."""

    type: str
    value: float
    default: float


class Parameters:
    """All parameters of one vehicle, in the order of their names.

    Args:
        profile: whose parameters, and how they are encoded.
        system_id: value of the profile's `system_id_parameter`.

    Attributes:
        changes: how often a value was changed.
    """

    def __init__(self, profile: AutopilotProfile, system_id: int) -> None:
        self._bytewise = profile.parameters_bytewise
        rows = sorted(profile.parameters.items())
        self._table = {name: Parameter(default.type, default.value, default.value) for name, default in rows}
        self._names = list(self._table)
        self.changes = 0
        own = self._table[profile.system_id_parameter]
        own.value = own.default = float(system_id)

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: str) -> bool:
        return name in self._table

    def name_at(self, index: int) -> str | None:
        """The name at an index of the list, or None."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def __getitem__(self, name: str) -> float:
        """The value that the vehicle acts on. NaN can be stored (nothing checks it) but is not flown: the default is.

        Raises:
            KeyError: the simulator has no such parameter.
        """
        parameter = self._table[name]
        return parameter.value if math.isfinite(parameter.value) else parameter.default

    def positive(self, name: str, scale: float = 1.0) -> float:
        """A speed or acceleration times `scale`, at least 0.05: zero would freeze a vehicle in the air."""
        return max(self[name] * scale, LEAST)

    def message(self, name: str, indexed: bool) -> Fields:
        """PARAM_VALUE of one parameter; `indexed` when it answers a list or an index."""
        parameter = self._table[name]
        value = parameter.value
        if self._bytewise and parameter.type != "REAL32":
            value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        return {
            "param_id": name.encode(),
            "param_value": value,
            "param_type": TYPE_IDS[parameter.type],
            "param_count": len(self._names),
            "param_index": self._names.index(name) if indexed else UNINDEXED,
        }

    def write(self, name: str, value: float, type_id: int) -> bool:
        """Store what a PARAM_SET brought. No range is checked: the real ones do not check either.

        Returns:
            Whether the value changed.

        Raises:
            WriteRefused: unknown name, wrong type (bytewise), or NaN (cast).
        """
        if self._bytewise and type_id not in (TYPE_IDS["INT32"], TYPE_IDS["REAL32"]):
            raise WriteRefused(ERROR_TYPE_UNSUPPORTED)
        parameter = self._table.get(name)
        if parameter is None:
            raise WriteRefused(ERROR_NAME)
        if self._bytewise:
            if type_id != TYPE_IDS[parameter.type]:
                raise WriteRefused(ERROR_TYPE_MISMATCH)
            new = value if parameter.type == "REAL32" else float(_bits(value))
        else:
            if math.isnan(value):
                raise WriteRefused(ERROR_VALUE)
            new = value if parameter.type == "REAL32" else _clipped(value, parameter.type)
        changed = new != parameter.value
        parameter.value = new
        self.changes += changed
        return changed


def read_defaults(path: Path) -> Mapping[str, ParameterDefault]:
    """Read a profile's parameters: name = integer (INT32) or float (REAL32), or { type, value }.

    Raises:
        OSError, tomllib.TOMLDecodeError: the file cannot be read, or holds no TOML.
    """
    table: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    return MappingProxyType({name: _default(entry) for name, entry in table.items()})


def _default(entry: Any) -> ParameterDefault:  # noqa: ANN401  # a value of the TOML file
    if isinstance(entry, dict):
        return ParameterDefault(str(entry["type"]), float(entry["value"]))
    return ParameterDefault("INT32" if isinstance(entry, int) else "REAL32", float(entry))


def _bits(value: float) -> int:
    whole: int = struct.unpack("<i", struct.pack("<f", value))[0]
    return whole


def _clipped(value: float, type_name: str) -> float:
    low, high = RANGES[type_name]
    return float(math.trunc(min(max(value, low), high)))
