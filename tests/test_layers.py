"""The rules of the design that keep the rooms apart, read off the sources themselves."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
ROOMS = ["errors", "core", "plan", "track", "mission", "wire", "link", "record", "experiment", "flight", "console"]
CLOCKS = {"asyncio", "socket", "selectors", "select", "time", "threading"}
ADAPTERS = {  # who alone may import what
    "toppra": {"fg_gcs/plan/paper_way.py"},
    "ruckig": {"fg_gcs/track/follow.py"},
    "mavsdk": {"fg_gcs/link/mavsdk_link.py"},
    "plotly": {"fg_gcs/record/"},
    "matplotlib": {"fg_gcs/record/", "fg_gcs/experiment/drawings.py"},
    "rich": {"fg_gcs/console/"},
    "pydantic": {"fg_gcs/mission/"},
    "pydantic_core": {"fg_gcs/mission/"},
    "pymavlink": {"fg_gcs/wire/", "sitl_mock/wire.py"},
}
SOURCES = sorted((ROOT / "fg_gcs").rglob("*.py")) + sorted((ROOT / "sitl_mock").rglob("*.py"))


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name(path)}: a relative import"
            yield node.module or ""


def room(module: str) -> int | None:
    parts = module.split(".")
    return ROOMS.index(parts[1]) if parts[0] == "fg_gcs" and len(parts) > 1 else None


def module_of(path: Path) -> str:
    return name(path).removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def test_there_is_something_to_look_at() -> None:
    assert len(SOURCES) > 40
    assert {room(module_of(path)) for path in SOURCES} >= {ROOMS.index(r) for r in ("core", "plan", "wire", "flight")}


def test_imports_go_left_only() -> None:
    wrong = []
    for path in SOURCES:
        own = room(module_of(path))
        for module in imports(path):
            other = room(module)
            if own is not None and other is not None and other > own:
                wrong.append((name(path), module))
    assert not wrong


def test_no_import_cycles() -> None:
    modules = {module_of(path): path for path in SOURCES}
    edges = {module: {m for m in imports(path) if m in modules and m != module} for module, path in modules.items()}
    done: set[str] = set()

    def visit(module: str, way: tuple[str, ...]) -> None:
        assert module not in way, f"a cycle: {' -> '.join((*way, module))}"
        if module not in done:
            for other in edges[module]:
                visit(other, (*way, module))
            done.add(module)

    for module in edges:
        visit(module, ())


@pytest.mark.parametrize("package", sorted(ADAPTERS))
def test_foreign_packages_stay_behind_their_adapters(package: str) -> None:
    for path in SOURCES:
        if any(module.split(".")[0] == package for module in imports(path)):
            assert any(name(path).startswith(place) for place in ADAPTERS[package]), f"{name(path)} imports {package}"


def test_core_is_pure_mathematics() -> None:
    allowed = {
        "numpy",
        "scipy",
        "numba",
        "fg_gcs",
        "__future__",
        "dataclasses",
        "typing",
        "collections",
        "itertools",
        "math",
    }
    for path in (ROOT / "fg_gcs" / "core").rglob("*.py"):
        assert {module.split(".")[0] for module in imports(path)} <= allowed, name(path)


def test_clocks_and_sockets_live_at_the_edge() -> None:
    edge = ("fg_gcs/link/", "fg_gcs/flight/", "fg_gcs/console/", "sitl_mock/server.py", "sitl_mock/session.py")
    for path in SOURCES:
        if not name(path).startswith(edge):
            assert not {module.split(".")[0] for module in imports(path)} & CLOCKS, name(path)


def test_the_ground_station_and_the_simulator_meet_as_bytes_only() -> None:
    starters = {"fg_gcs/console/cli.py", "fg_gcs/console/simulator.py"}
    for path in SOURCES:
        packages = {module.split(".")[0] for module in imports(path)}
        if name(path).startswith("sitl_mock/"):
            assert "fg_gcs" not in packages, name(path)
        elif name(path) not in starters:
            assert "sitl_mock" not in packages, name(path)


def test_no_prints_globals_or_star_imports() -> None:
    for path in SOURCES:
        may_print = name(path).startswith("fg_gcs/console/") or name(path) == "sitl_mock/__main__.py"
        for node in ast.walk(ast.parse(path.read_text())):
            assert not isinstance(node, ast.Global), f"{name(path)}:{node.lineno}"
            if isinstance(node, ast.ImportFrom):
                assert all(alias.name != "*" for alias in node.names), f"{name(path)}:{node.lineno}"
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print":
                assert may_print, f"{name(path)}:{node.lineno}"


def test_no_mutable_state_in_modules() -> None:
    for path in SOURCES:
        for node in ast.parse(path.read_text()).body:
            value = node.value if isinstance(node, (ast.Assign, ast.AnnAssign)) else None
            names = [t.id for t in getattr(node, "targets", [getattr(node, "target", None)]) if isinstance(t, ast.Name)]
            constant = all(n.isupper() or n.startswith("__") or n[:1].isupper() or n.startswith("_") for n in names)
            if isinstance(value, (ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp)):
                assert constant, f"{name(path)}:{node.lineno}: a mutable module variable"


def test_files_and_functions_keep_their_size() -> None:
    for path in SOURCES:
        text = path.read_text()
        assert len(text.splitlines()) <= 400, name(path)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                assert (node.end_lineno or 0) - node.lineno <= 75, f"{name(path)}:{node.name}"


def test_every_package_is_installed() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    found = {module_of(path) for path in SOURCES if path.name == "__init__.py"}
    assert set(listed) == found
