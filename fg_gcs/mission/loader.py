"""Mission files in TOML: read once into a type that proves them, or refused in one clear line."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from fg_gcs.errors import MissionError
from fg_gcs.mission.model import Mission

MAX_BYTES = 1_000_000  # a mission is some 2 kB; a file hundreds of times larger is not one


class Problem(NamedTuple):
    """What is wrong with which key of which table."""

    table: str  # empty for the top of the file
    key: str
    text: str


def load_mission(path: Path) -> Mission:
    """Read and check a mission file.

    Raises:
        MissionError: one line that names file, table and key and says what would be accepted.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise MissionError(f"{path}: larger than {MAX_BYTES} bytes, so not a mission file")
        tables = tomllib.loads(path.read_bytes().decode())
    except OSError as error:
        raise MissionError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise MissionError(f"{path}: not a TOML file: {' '.join(str(error).split())}") from error
    try:
        # By way of JSON, whose lists the strict model takes for points; TOML's dates become text and are refused there
        mission = Mission.model_validate_json(json.dumps(tables, default=str))
    except ValidationError as error:
        problems = [_explained(details) for details in error.errors()]
    else:
        problems = list(contradictions(mission))
    if problems:
        table, key, text = problems[0]
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        place = " ".join(part for part in (f"[{table}]" if table else "", key) if part)
        raise MissionError(f"{path}: {place}: {text}{more}")
    return mission


def contradictions(mission: Mission) -> Iterator[Problem]:
    """Yield what is wrong between keys that are each right by themselves."""
    ids = mission.swarm.ids()
    vehicles = mission.swarm.vehicles
    if len(set(ids)) < len(ids):
        twice = sorted({i for i in ids if ids.count(i) > 1})
        yield Problem("swarm", "system_ids", f"{twice[0]} occurs twice; accepted: a different id for every vehicle")
    if len(ids) != vehicles:
        yield Problem("swarm", "system_ids", f"{len(ids)} ids for {vehicles} vehicles; accepted: {vehicles} ids")
    fence = mission.fence.box()
    if not (np.array(fence.low_enu_m) < np.array(fence.high_enu_m)).all():
        yield Problem("fence", "high_enu_m", "each number must be larger than that of low_enu_m")
        return  # against a fence without an inside everything else is wrong, too
    yield from _formation_contradictions(mission)
    floor = fence.low_enu_m[2]
    target = mission.target.position_enu_m
    if target[2] < floor:
        text = f"up = {target[2]:g} m lies below the floor; accepted: {floor:g} or more ([fence] low_enu_m)"
        yield Problem("target", "position_enu_m", text)
    elif fence.excess_m(np.array(target)) > 0:
        yield Problem("target", "position_enu_m", f"{list(target)} lies outside the fence; accepted: a point inside")
    if mission.takeoff.height_m < floor:
        text = f"{mission.takeoff.height_m:g} m is below the floor; accepted: {floor:g} or more ([fence] low_enu_m)"
        yield Problem("takeoff", "height_m", text)
    separation = mission.limits.separation_m
    if mission.pads.spacing_m <= separation:
        text = f"{mission.pads.spacing_m:g} m; accepted: more than the separation of {separation:g} m"
        yield Problem("pads", "spacing_m", text)


def _formation_contradictions(mission: Mission) -> Iterator[Problem]:
    table = mission.formation
    try:
        formation = table.formation()
    except ValueError as error:
        yield Problem("formation", "shape", str(error))
        return
    slots, vehicles = len(formation.slots_m), mission.swarm.vehicles
    if slots != vehicles:
        text = f"{vehicles} vehicles for {slots} slots of the formation; accepted: {slots}"
        yield Problem("swarm", "vehicles", text)
    separation = mission.limits.separation_m
    if formation.smallest_separation_m < separation:
        text = (
            f"{separation:g} m, but the closest slots of the formation are {formation.smallest_separation_m:.2f} m "
            "apart; accepted: less than that, or a wider formation"
        )
        yield Problem("limits", "separation_m", text)
    try:
        places = formation.place(table.start())
    except ValueError as error:
        yield Problem("formation", "normal_enu", str(error))
        return
    excess = mission.fence.box().excess_m(places)
    if excess.max() > 0:
        text = f"slot {int(excess.argmax()) + 1} lies {excess.max():.2f} m outside the fence; accepted: a centre inside"
        yield Problem("formation", "centre_enu_m", text)


def _explained(details: ErrorDetails) -> Problem:
    """Turn pydantic's finding into table, key and what would be accepted."""
    model: type[BaseModel] = Mission
    names = [str(part) for part in details["loc"]]
    path: list[str] = []
    for depth, name in enumerate(names):
        field = model.model_fields.get(name)
        inner = field and next((t for t in (field.annotation, *get_args(field.annotation)) if _is_table(t)), None)
        last = depth == len(names) - 1
        if details["type"] == "extra_forbidden" and last:
            kind = "keys" if model is not Mission else "tables and keys"
            return Problem(".".join(path), name, f"unknown key; accepted {kind}: {', '.join(model.model_fields)}")
        if field is None or inner is None or last:
            accepted = field.description if field else "see missions/README.md"
            found = "missing" if details["type"] == "missing" else f"got {_short(details['input'])}"
            return Problem(".".join(path), name, f"{found}; accepted: {accepted}")
        path.append(name)
        model = inner
    return Problem("", "", "; ".join((details["msg"], "accepted: the tables that missions/README.md names")))


def _is_table(annotation: object) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."  # one line stays one line
