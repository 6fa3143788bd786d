"""What flies: the paper's particle, or a multicopter with one autopilot's control law, as numbers from a TOML file.

```toml
law = "direct"                # setpoints straight into P and PID; "shaped": jerk-limited shaping first
hover_m = 0.5                 # how far a vehicle hovers off its place, rms, as seen from above, as measured
[model]                       # one key a column of `records.MODEL`; vectors as [north, east, down]
[spread]                      # standard deviation of a column from vehicle to vehicle, as a share of it
[parameters]                  # which autopilot parameter sets which column: NAME = { column, scale }
```
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl_mock.physics.arrays import Array
from sitl_mock.physics.records import MODEL

LAWS = ("direct", "shaped")
WANDERS = ("wander_sigma_m", "wander_sigma_m_s")  # columns of the estimator's errors
SPREAD_MOST = 2.5  # in standard deviations


@dataclass(frozen=True, slots=True)
class FlightModel:
    """Airframe, estimator and control law of a kind of vehicle.

    Attributes:
        law: one of `LAWS`; None: the paper's particle.
        values: columns of `records.MODEL`, SI units; absent ones are 0.
        spread: standard deviation from vehicle to vehicle, as a share of the value.
        parameters: by the name of an autopilot's parameter, the column that it sets and the factor to SI units.
        hover_m: how far a vehicle hovers off its place, rms, as seen from above, without what all do alike [m].
    """

    law: str | None
    values: Mapping[str, float | tuple[float, ...]]
    spread: Mapping[str, float]
    parameters: Mapping[str, tuple[str, float]]
    hover_m: float = 0.0

    def __post_init__(self) -> None:
        columns = set(MODEL.names or ())
        used = {*self.values, *self.spread, *(column for column, _ in self.parameters.values())}
        if unknown := sorted(used - columns):
            raise ValueError(f"the flight model has no {', '.join(unknown)}")
        if self.law is not None and (missing := sorted(columns - set(self.values))):
            raise ValueError(f"the flight model lacks {', '.join(missing)}")
        if self.law is not None and self.law not in LAWS:
            raise ValueError(f"law {self.law!r} is not one of: {', '.join(LAWS)}")

    def noisy(self, level_m: float) -> FlightModel:
        """Return it with an estimator that makes it hover so far off its place [m] instead of `hover_m`.

        Raises:
            ValueError: it does not say how far that is.
        """
        if not self.hover_m > 0.0:
            raise ValueError("the flight model lacks hover_m")
        times = level_m / self.hover_m
        scaled = {name: tuple(times * x for x in np.atleast_1d(self.values[name])) for name in WANDERS}
        return replace(self, values={**self.values, **scaled}, hover_m=level_m)

    def table(self, vehicles: int, random: np.random.Generator) -> tuple[NDArray[np.void], dict[str, Array]]:
        """The numbers of each vehicle.

        Args:
            vehicles: how many.
            random: of what differs from one to the next; a vehicle's share does not depend on how many there are.

        Returns:
            (V,) records of `records.MODEL`, and the factor (V,) of each column that differs.
        """
        table = np.zeros(vehicles, MODEL)
        for column, value in self.values.items():
            table[column] = value
        shares, headings = random.spawn(2)
        drawn = shares.standard_normal((vehicles, len(self.spread)))
        factors = {}
        for (column, share), numbers in zip(
            self.spread.items(), np.clip(drawn, -SPREAD_MOST, SPREAD_MOST).T, strict=True
        ):
            factors[column] = 1.0 + share * numbers
            table[column] = (table[column].T * factors[column]).T
        heading = headings.uniform(0.0, 2.0 * np.pi, vehicles)  # of a drift without GPS
        drift = table["drift_m_s2"][:, 0].copy()
        table["drift_m_s2"] = np.stack((drift * np.cos(heading), drift * np.sin(heading)), axis=1)
        return table, factors


def read_flight_model(text: str) -> FlightModel:
    """A flight model from its TOML text.

    Raises:
        ValueError: a column is unknown or missing, or the law is unknown; TOML errors are `ValueError` too.
    """
    tables: Mapping[str, Any] = tomllib.loads(text)
    values = {key: tuple(value) if isinstance(value, list) else value for key, value in tables["model"].items()}
    parameters = {name: (entry["column"], entry["scale"]) for name, entry in tables["parameters"].items()}
    return FlightModel(tables["law"], values, tables["spread"], parameters, tables.get("hover_m", 0.0))
