"""Mission files in TOML: parsed once into a checked type, or refused in one clear line."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from fg_gcs.errors import MissionError
from fg_gcs.mission.model import Mission
from fg_gcs.mission.position_files import FILES, PositionFile
from fg_gcs.mission.tables import MissionTable, Problem
from fg_gcs.mission.validation import problems_of

MAX_BYTES = 1_000_000  # a mission is some 2 kB; a file hundreds of times larger is not one
MAX_POSITION_BYTES = 20_000_000  # of a file of positions: 10 Hz for half a day


def load_mission(path: Path) -> Mission:
    """Read and check a mission file, and the files that it names.

    Raises:
        MissionError: one line that names file, table and key and says what would be accepted.
    """
    try:
        if path.exists() and not path.is_file():
            raise MissionError(f"{path}: cannot be read: it is a folder or a device; accepted: a mission file")
        if path.stat().st_size > MAX_BYTES:
            raise MissionError(f"{path}: larger than {MAX_BYTES} bytes; accepted: a mission file, which has some 2 kB")
        text = path.read_bytes().decode()
    except OSError as error:
        raise MissionError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise _no_toml(path, error) from error
    return parse_mission(text, path)


def parse_mission(
    text: str, path: Path = Path("mission.toml"), files: Callable[[str], PositionFile] | None = None
) -> Mission:
    """Check the text of a mission file.

    Args:
        text: in TOML.
        path: the file that it is from, or would be: its name is the run's.
        files: returns a file of positions by its path in the mission; without it, those beside ``path`` are read.

    Raises:
        MissionError: one line that names file, table and key and says what would be accepted.
    """
    try:
        tables = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # of its syntax, or numbers of thousands of digits
        raise _no_toml(path, error) from error
    read = files or (lambda named: read_positions(path.parent / named))
    named = {name: read(name) for name in dict.fromkeys(_named_files(tables))}
    try:
        # By way of JSON, whose lists the strict model takes for points; TOML's dates become text and are refused there
        text_of_tables = json.dumps(tables, default=str)
        mission = Mission.model_validate_json(text_of_tables, context={FILES: named})
    except RecursionError as error:
        raise _no_toml(path, error) from error
    except ValidationError as error:
        found = [_explained(details) for details in error.errors()]
        # One problem a key, the first: a key of several types is reported once for each of them
        problems = list({(problem.table, problem.key): problem for problem in reversed(found)}.values())[::-1]
    else:
        problems = list(problems_of(mission))
    if problems:
        table, key, what = problems[0]
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        place = " ".join(part for part in (f"[{table}]" if table else "", key) if part)
        raise MissionError(f"{path}: {place}: {what}{more}")
    return mission.read_from(path, text)


def _no_toml(path: Path, error: Exception) -> MissionError:
    return MissionError(f"{path}: not a TOML file: {' '.join(str(error).split())}")


def read_positions(path: Path, name: str | None = None) -> PositionFile:
    """Read a file of positions; what is wrong with it is told when its rows are asked for.

    Args:
        path: where it is.
        name: that errors have (default: its path).
    """
    shown = str(path) if name is None else name
    try:
        if path.exists() and not path.is_file():
            return PositionFile(shown, b"", "not a file that has an end; accepted: a CSV file")
        if path.stat().st_size > MAX_POSITION_BYTES:
            return PositionFile(shown, b"", f"larger than {MAX_POSITION_BYTES} bytes")
        return PositionFile(shown, path.read_bytes())
    except (OSError, ValueError) as error:  # ValueError: a path with a null byte
        return PositionFile(shown, b"", f"cannot be read: {getattr(error, 'strerror', None) or error}")


def _named_files(tables: Mapping[str, Any]) -> Iterator[str]:
    """Yield the paths in a mission whose tables may still be anything at all."""
    targets = tables.get("targets")
    for target in targets if isinstance(targets, list) else ():
        inner = [target.get(key) for key in ("motion", "source")] if isinstance(target, dict) else []
        for table in inner:
            if isinstance(table, dict) and table.get("kind") in ("file", "csv") and isinstance(table.get("path"), str):
                yield table["path"]


def _explained(details: ErrorDetails) -> Problem:
    """Turn pydantic's finding into table, key and what would be accepted."""
    kinds: list[type[MissionTable]] = [Mission]  # of the table at hand; with several, its tag comes next
    path: list[str] = []
    key, accepted, which = "", "the tables that missions/README.md lists", ""
    for depth, part in enumerate(details["loc"]):
        if not kinds:
            break  # inside a value: its key is known already
        if isinstance(part, int):
            which = f" of target {part + 1}"
            continue
        if len(kinds) > 1:
            kinds = [kind for kind in kinds if _tag(kind) == part]
            continue
        path += [key] if key else []
        key, field = part, kinds[0].model_fields.get(part)
        if field is None:
            if details["type"] == "extra_forbidden" and depth == len(details["loc"]) - 1:
                what = "tables and keys" if kinds[0] is Mission else "keys"
                text = f"unknown key; accepted {what}: {', '.join(kinds[0].model_fields)}"
                return Problem(".".join(path), key + which, text)
            break
        accepted, kinds = field.description or accepted, _tables(field.annotation)
    found = "missing" if details["type"] == "missing" else f"got {_short(details['input'])}"
    if details["type"].startswith("union_tag"):  # the table does not state its kind
        tag = details.get("ctx", {}).get("tag")
        path, key, found = [*path, key], "kind", "missing" if tag is None else f"got {_short(tag)}"
        accepted = ", ".join(f'"{_tag(kind)}"' for kind in kinds)
    return Problem(".".join(path), key + (which if path else ""), f"{found}; accepted: {accepted}")


def _tables(annotation: object) -> list[type[MissionTable]]:
    """Return the tables that a key may hold."""
    if isinstance(annotation, type) and issubclass(annotation, MissionTable):
        return [annotation]
    return [table for inner in get_args(annotation) for table in _tables(inner)]


def _tag(table: type[MissionTable]) -> str:
    """Return the ``kind`` of a table that is one of several."""
    return str(get_args(table.model_fields["kind"].annotation)[0])


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."  # one line stays one line
