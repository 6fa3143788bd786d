"""What all tables of a mission file are made of."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from pydantic import BaseModel, ConfigDict, Field


class Problem(NamedTuple):
    """What is wrong with which key of which table."""

    table: str  # empty for the top of the file
    key: str
    text: str


class MissionTable(BaseModel):
    """A table of the file: strict types, no unknown keys, read-only."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Plannable = Annotated[float, Field(ge=1e-6, le=1e6)]  # arithmetic still works with its square and its inverse
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Deviation = Annotated[float, Field(ge=0, le=1e6)]  # its square still counts beside those of metres
Length = Annotated[float, Field(ge=0.1, le=1e6)]  # of made-up motions: angles and times stay numbers
Rate = Annotated[float, Field(gt=0, le=1e4)]  # speeds and accelerations of those
Seed = Annotated[int, Field(ge=0, le=2**63)]
SystemId = Annotated[int, Field(ge=1, le=250)]
NetworkName = Annotated[str, Field(pattern=r"^[a-z0-9_-]{1,16}$")]
NetworkSystemId = Annotated[str, Field(pattern=r"^[a-z0-9_-]{1,16}/(?:[1-9]\d?|1\d\d|2[0-4]\d|250)$")]
VehicleEndpoint = Annotated[
    str, Field(pattern=r"^(?:(?:udp|udpin|udpout|tcp|tcpin):(?:[^:\s]+:)?\d{1,5}|serial:/[^\s=]+:\d{1,7})$")
]
Point = tuple[Finite, Finite, Finite]
Ground = tuple[Finite, Finite]
FilePath = Annotated[str, Field(min_length=1, max_length=1000)]  # absolute, or from the mission's folder
