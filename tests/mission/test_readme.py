"""missions/README.md lists every key of a mission, with its unit and the default that the model has."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, get_args

import pytest
from pydantic.fields import FieldInfo

from fg_gcs.console.cli import main
from fg_gcs.errors import MissionError
from fg_gcs.mission import Mission, load_mission
from fg_gcs.mission.tables import MissionTable
from sitl_mock.faults.schema import IMPAIRMENT, KINDS, WINDOW

MISSIONS = Path(__file__).parents[2] / "missions"
TEXT = (MISSIONS / "README.md").read_text()
SMALLEST = TEXT.partition("```toml\n")[2].partition("```")[0]
TOP = "top of the file"
ARRAYS = ("targets",)  # written with double brackets
UNITS = {"deg": "°", "hz": "Hz", "m": "m", "s": "s", "m_s": "m/s", "m_s2": "m/s²", "m_s3": "m/s³"}
WITHOUT_SUFFIX = {"silence": "s"}  # keys that have a unit and do not say so


class Row(NamedTuple):
    """A line of one of the page's tables of keys."""

    unit: str
    accepted: str
    default: str
    meaning: str


def rows() -> Iterator[tuple[tuple[str, str], Row]]:
    """Yield table, key and row of every line that lists a key; an empty table is that of the line above."""
    table = ""
    for line in TEXT.splitlines():
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        if len(cells) != 6 or cells[0] == "table" or cells[0].startswith("---"):
            continue
        table = cells[0] or table
        yield (table, cells[1].strip("`")), Row(*cells[2:])


def inner(annotation: object) -> list[type[MissionTable]]:
    if isinstance(annotation, type) and issubclass(annotation, MissionTable):
        return [annotation]
    return [table for part in get_args(annotation) for table in inner(part)]


def keys(model: type[MissionTable], name: str, label: str) -> Iterator[tuple[tuple[str, str], FieldInfo]]:
    """Yield table and key, as the page writes them, and field of every key; plain tables have lines of their own."""
    for key, field in model.model_fields.items():
        below = inner(field.annotation)
        path = f"{name}.{key}".lstrip(".")
        if not below or f"`{key}`" in TEXT:
            yield (label, key), field
        for kind in below:
            which = f' `"{get_args(kind.model_fields["kind"].annotation)[0]}"`' if len(below) > 1 else ""
            brackets = f"[[{path}]]" if path in ARRAYS else f"[{path}]"
            yield from keys(kind, path, f"`{brackets}`{which}")


LISTED = dict(rows())
KEYS = dict(keys(Mission, "", TOP))


def test_the_page_lists_every_key_and_no_other() -> None:
    assert len(KEYS) > 80
    plain = {(TOP, key) for key, field in Mission.model_fields.items() if inner(field.annotation)}
    assert set(KEYS) - plain <= set(LISTED)
    assert set(LISTED) <= set(KEYS)
    assert len(list(rows())) == len(LISTED), "a key is listed twice"


@pytest.mark.parametrize("place", sorted(LISTED), ids=" ".join)
def test_units_and_defaults_are_those_of_the_model(place: tuple[str, str]) -> None:
    row, field = LISTED[place], KEYS[place]
    suffix = re.search(r"_(deg|hz|m_s3|m_s2|m_s|m|s)$", place[1])
    assert row.unit == (UNITS[suffix[1]] if suffix else WITHOUT_SUFFIX.get(place[1], ""))
    assert row.accepted
    assert row.meaning
    assert (row.default == "required") == field.is_required()
    if row.default.startswith("`"):
        stated = tomllib.loads(f"value = {row.default.strip('`')}")["value"]
        default = field.get_default(call_default_factory=True)
        assert stated == (default.model_dump() if isinstance(default, MissionTable) else _listed(default))
    else:
        assert field.is_required() or field.default is None or inner(field.annotation)


def _listed(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


def test_every_key_has_a_description_for_errors() -> None:
    for place, field in KEYS.items():
        assert field.description, place


def test_the_smallest_mission_is_valid_and_has_no_key_too_many(tmp_path: Path) -> None:
    path = tmp_path / "smallest.toml"
    path.write_text(SMALLEST)
    mission = load_mission(path)
    assert mission.swarm.vehicles == len(mission.task().formation.slots_m) == 4
    lines = SMALLEST.splitlines()
    for number, line in enumerate(lines):
        if "=" in line:
            path.write_text("\n".join(lines[:number] + lines[number + 1 :]))
            with pytest.raises(MissionError, match="missing; accepted: "):
                load_mission(path)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_the_smallest_mission_flies(autopilot: str, tmp_path: Path) -> None:
    path = tmp_path / "smallest.toml"
    path.write_text(SMALLEST)
    assert main(["fly", str(path), "--speed", "max", "--autopilot", autopilot, "--logs", str(tmp_path)]) == 0


def test_every_mission_of_the_folder_is_listed() -> None:
    for path in MISSIONS.glob("*.toml"):
        assert f"`{path.name}`" in TEXT


def test_the_page_lists_every_kind_of_fault_and_every_key() -> None:
    for name, kind in KINDS.items():
        (line,) = [line for line in TEXT.splitlines() if line.startswith(f"| `{name}` |")]
        assert kind.says in line
        assert all(f"`{key}`" in line for key in kind.keys)
    for name, key in {**WINDOW, **IMPAIRMENT}.items():
        assert re.search(rf"\| `{name}` \| .*\| {re.escape(key.says)} \|", TEXT), name
