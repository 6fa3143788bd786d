"""A run's summary read back: any JSON may stand there, so each value is asked for by the type that it should have."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.record.read.regular import regular
from fg_gcs.record.read.tables import MOST_S
from fg_gcs.wire.address import VehicleAddress

Kind = Callable[[object], bool]


class RunSummary:
    """Figures and facts by the names of the command line's JSON; what is absent or of another type is None or empty.

    Attributes:
        values: as they were read.
        remarks: what was not as it should be, a line each.
    """

    def __init__(self, values: Mapping[str, Any], remarks: tuple[str, ...] = ()) -> None:
        self.values = values
        self.remarks = remarks

    @classmethod
    def read(cls, path: Path) -> RunSummary:
        """Read a summary; one that is damaged has no values."""
        try:
            values = json.loads(regular(path).read_bytes())
        except OSError as error:
            return cls({}, (f"{path.name}: cannot be read: {error.strerror or error}",))
        except (ValueError, RecursionError) as error:
            return cls({}, (f"{path.name}: not JSON: {' '.join(str(error).split())[:200]}",))
        if not isinstance(values, dict):
            return cls({}, (f"{path.name}: not an object",))
        wrong = [key for key, kind in KINDS.items() if values.get(key) is not None and not kind(values[key])]
        return cls(values, tuple(f"{path.name}: {key} is not understood" for key in wrong))

    def number(self, key: str) -> float | None:
        """Return a figure."""
        return as_number(self.values.get(key))

    def text(self, key: str) -> str:
        """Return a text; empty when there is none."""
        value = self.values.get(key)
        return value if isinstance(value, str) else ""

    def is_true(self, key: str) -> bool:
        """Tell whether a key says yes."""
        return self.values.get(key) is True

    def table(self, key: str) -> Mapping[str, Any]:
        """Return an object by itself."""
        value = self.values.get(key)
        return value if isinstance(value, dict) else {}

    def vehicles(self, key: str) -> tuple[VehicleAddress, ...]:
        """Return vehicles, in their order."""
        return tuple(VehicleAddress.labelled(label) for label in self._if(_is_labels, key, []))

    @property
    def incidents(self) -> tuple[str, ...]:
        """What simulated vehicles truly hit, a line each; empty where that is not known."""
        hits = [hit for key in ("collisions", "ground_strikes") for hit in self._if(_is_incidents, key, ())]
        return tuple(hit["text"] for hit in hits)

    def point(self, key: str) -> Array | None:
        """Return a place, shape (3,)."""
        value = self._if(_is_point, key, None)
        return None if value is None else np.array(value, dtype=float)

    def durations(self, key: str) -> tuple[float | None, ...]:
        """Return durations [s]; None: without an end."""
        return tuple(None if each is None else float(each) for each in self._if(_is_durations, key, []))

    def limit(self, key: str) -> float | None:
        """Return a limit that the flight was planned with."""
        return as_number(self.table("limits").get(key))

    def spans(self, last_s: float) -> dict[str, tuple[float, float]]:
        """Return begin and end of every stage [s]; one that had not ended ends with the record."""
        spans = {}
        for name, span in self.table("stages").items():
            if _is_span(span):
                begin_s, end_s = float(span[0]), last_s if span[1] is None else float(span[1])
                spans[name] = begin_s, max(begin_s, end_s)
        return spans

    def _if(self, is_kind: Kind, key: str, otherwise: object) -> Any:  # noqa: ANN401 - what the kind says
        value = self.values.get(key)
        return value if is_kind(value) else otherwise


def as_number(value: object) -> float | None:
    """Return a finite number as a float; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _is_time(value: object) -> bool:
    number = as_number(value)
    return number is not None and abs(number) <= MOST_S


def _is_span(value: object) -> bool:
    return (
        isinstance(value, list) and len(value) == 2 and _is_time(value[0]) and (value[1] is None or _is_time(value[1]))
    )


def _is_stages(value: object) -> bool:
    return isinstance(value, dict) and all(_is_span(span) for span in value.values())


def _is_labels(value: object) -> bool:
    return isinstance(value, list) and all(_is_label(each) for each in value)


def _is_label(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        return False
    try:
        return 0 < VehicleAddress.labelled(value).system_id < 256
    except ValueError:  # among them integers of more digits than Python writes
        return False


def _is_point(value: object) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(as_number(each) is not None for each in value)


def _is_incidents(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(each, dict) and _is_text(each.get("text")) for each in value)


def _is_durations(value: object) -> bool:
    return isinstance(value, list) and all(each is None or _is_time(each) for each in value)


def _is_counts(value: object) -> bool:
    return isinstance(value, dict) and all(as_number(each) is not None for each in value.values())


def _is_limits(value: object) -> bool:
    return isinstance(value, dict) and all(each is None or as_number(each) is not None for each in value.values())


def _is_missing(value: object) -> bool:
    return isinstance(value, dict) and all(_is_time(each) for each in value.values())


def _is_times(value: object) -> bool:
    return isinstance(value, dict) and all(each is None or _is_time(each) for each in value.values())


def _is_flag(value: object) -> bool:
    return isinstance(value, bool)


def _is_text(value: object) -> bool:
    return isinstance(value, str)


KINDS: dict[str, Kind] = {  # keys that are more than a figure, and what they have to be
    "stages": _is_stages,
    "leader_ids": _is_labels,
    "lost": _is_labels,
    "vehicles_not_down": _is_labels,
    "target_enu_m": _is_point,
    "found_again_s": _is_durations,
    "sightings_rejected": _is_counts,
    "limits": _is_limits,
    "recording_missing": _is_missing,
    "collisions": _is_incidents,
    "ground_strikes": _is_incidents,
    "tracking": lambda value: (
        isinstance(value, dict) and all(each is None or _is_time(each) for each in value.values())
    ),
    "completed": lambda value: isinstance(value, bool),
    "reason": lambda value: isinstance(value, str),
}
