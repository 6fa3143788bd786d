"""The rules of the design that keep the rooms apart, read off the sources themselves."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
ORDER = (  # imports go up this list only, never down it; the longest name that fits a module counts
    "fg_gcs.errors",
    "fg_gcs.compiling",
    "fg_gcs.core",
    "fg_gcs.plan.limits",
    "fg_gcs.plan.path",
    "fg_gcs.plan.search",
    "fg_gcs.plan.timing",
    "fg_gcs.plan",
    "fg_gcs.track.sightings",
    "fg_gcs.track.estimate",
    "fg_gcs.track.follow",
    "fg_gcs.track",
    "fg_gcs.scenario",
    "fg_gcs.mission",
    "fg_gcs.mission.formats",
    "fg_gcs.wire",
    "fg_gcs.link",
    "fg_gcs.record.write",
    "fg_gcs.record.read",
    "fg_gcs.record.evaluate",
    "fg_gcs.record.report",
    "fg_gcs.record",
    "fg_gcs.flight.sightings",
    "fg_gcs.flight",
    "fg_gcs.sitl",
    "fg_gcs.run",
    "fg_gcs.experiment.baselines",
    "fg_gcs.experiment",
    "fg_gcs.console",
    "sitl_mock.physics",
    "sitl_mock.messages",
    "sitl_mock.links",
    "sitl_mock.autopilot",
    "sitl_mock.protocol",
    "sitl_mock.profiles",
    "sitl_mock.faults",
    "sitl_mock.host",
    "sitl_mock",
)
ROOTS = {"fg_gcs", "sitl_mock"}
FACADES = {"fg_gcs.mission", "fg_gcs.run"}  # re-export what lies above them in the list
LAZY = {"fg_gcs.run", "sitl_mock", "sitl_mock.profiles"}  # import what is asked for at the moment that it is
CLOCKS = {"asyncio", "socket", "selectors", "select", "time", "threading"}
EDGE = (  # where clocks and sockets live
    "fg_gcs/compiling.py",  # the age of files
    "fg_gcs/link/",
    "fg_gcs/record/write/",  # one writer thread
    "fg_gcs/flight/",
    "fg_gcs/sitl/",
    "fg_gcs/run/",
    "fg_gcs/experiment/baselines/ground_stations.py",
    "fg_gcs/experiment/bare_process.py",
    "fg_gcs/experiment/bare_vehicles.py",
    "fg_gcs/experiment/sim_flights.py",
    "fg_gcs/experiment/simulator_process.py",
    "fg_gcs/experiment/stream_bench.py",
    "fg_gcs/experiment/streaming.py",
    "fg_gcs/console/",
    "sitl_mock/host/measure.py",
    "sitl_mock/host/server.py",
    "sitl_mock/host/session.py",
)
ADAPTERS = {  # what alone may import what
    "toppra": {"fg_gcs/experiment/baselines/reference_planner.py"},
    "ruckig": {"fg_gcs/track/follow/axes.py"},
    "mavsdk": {"fg_gcs/experiment/baselines/ground_stations.py"},
    "plotly": {"fg_gcs/record/report/"},
    "matplotlib": {"fg_gcs/record/report/plot.py", "fg_gcs/experiment/drawings.py"},
    "rich": {"fg_gcs/console/"},
    "pydantic": {"fg_gcs/mission/"},
    "pydantic_core": {"fg_gcs/mission/"},
    "pymavlink": {"fg_gcs/wire/", "fg_gcs/experiment/baselines/ground_stations.py", "sitl_mock/protocol/layouts.py"},
    "numba": {"fg_gcs/compiling.py", "sitl_mock/physics/compiling.py"},
}
MOST_LINES, MOST_FUNCTION_LINES = 600, 60
SOURCES = sorted((ROOT / "fg_gcs").rglob("*.py")) + sorted((ROOT / "sitl_mock").rglob("*.py"))
TREES = {path: ast.parse(path.read_text()) for path in SOURCES}

MAKERS = {"list", "dict", "set", "bytearray", "deque", "defaultdict", "Counter", "OrderedDict", "array", "ChainMap"}
CHANGERS = {
    *("append", "extend", "insert", "add", "update", "setdefault", "pop", "popitem", "popleft", "appendleft"),
    *("clear", "remove", "discard", "sort", "reverse", "subtract"),
}


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def imports(path: Path) -> Iterator[str]:
    for node in ast.walk(TREES[path]):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name(path)}: a relative import"
            yield node.module or ""
            yield from (
                f"{node.module}.{alias.name}" for alias in node.names if f"{node.module}.{alias.name}" in MODULES
            )


def module_of(path: Path) -> str:
    return name(path).removesuffix(".py").removesuffix("/__init__").replace("/", ".")


MODULES = {module_of(path): path for path in SOURCES}


def rank(module: str) -> int:
    """Place in the order; a façade stands with the last part of its room."""
    if module in (*FACADES, *ROOTS):
        return max(index for index, room in enumerate(ORDER) if f"{room}.".startswith(f"{module}."))
    fitting = [room for room in ORDER if f"{module}.".startswith(f"{room}.")]
    assert fitting, f"{module} has no place in the order"
    return ORDER.index(max(fitting, key=len))


def test_there_is_something_to_look_at() -> None:
    assert len(SOURCES) > 100
    used = {ORDER[rank(module)] for module in MODULES if module not in FACADES}
    assert used >= {room for room in ORDER if room not in ("fg_gcs.record", "fg_gcs.track")}


def test_imports_go_down_only_sub_rooms_included() -> None:
    wrong = []
    for module, path in MODULES.items():
        for other in imports(path):
            if other in MODULES and other not in ROOTS and other.split(".")[0] == module.split(".")[0]:
                target = other if MODULES[other].name != "__init__.py" or other in FACADES else None
                if target is not None and rank(target) > rank(module):
                    wrong.append(f"{module} imports {other}")
    assert not wrong


def test_no_import_cycles() -> None:
    edges = {module: {m for m in imports(path) if m in MODULES and m != module} for module, path in MODULES.items()}
    edges |= {module: set() for module in LAZY}
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
    own = {"numpy", "scipy", "fg_gcs"}
    standard = {"__future__", "dataclasses", "typing", "collections", "itertools", "math"}
    for path in (ROOT / "fg_gcs" / "core").rglob("*.py"):
        assert {module.split(".")[0] for module in imports(path)} <= own | standard, name(path)


def test_clocks_and_sockets_live_at_the_edge() -> None:
    for path in SOURCES:
        if not name(path).startswith(EDGE):
            assert not {module.split(".")[0] for module in imports(path)} & CLOCKS, name(path)


def test_the_ground_station_and_the_simulator_meet_as_bytes_only() -> None:
    starters = {"fg_gcs/console/cli.py", "fg_gcs/run/simulators.py"}
    for path in SOURCES:
        packages = {module.split(".")[0] for module in imports(path)}
        if name(path).startswith("sitl_mock/"):
            assert "fg_gcs" not in packages, name(path)
        elif name(path) not in starters:
            assert "sitl_mock" not in packages, name(path)


def test_no_prints_globals_or_star_imports() -> None:
    for path in SOURCES:
        may_print = name(path).startswith("fg_gcs/console/") or name(path) == "sitl_mock/__main__.py"
        for node in ast.walk(TREES[path]):
            assert not isinstance(node, ast.Global), f"{name(path)}:{node.lineno}"
            if isinstance(node, ast.ImportFrom):
                assert all(alias.name != "*" for alias in node.names), f"{name(path)}:{node.lineno}"
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print":
                assert may_print, f"{name(path)}:{node.lineno}"


def _is_container(value: ast.expr | None) -> bool:
    if isinstance(value, ast.Call):
        maker = value.func.attr if isinstance(value.func, ast.Attribute) else getattr(value.func, "id", "")
        return maker in MAKERS
    return isinstance(value, (ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp, ast.SetComp))


def _bound(body: list[ast.stmt]) -> Iterator[tuple[str, int]]:
    """Names that are bound to mutable containers in a module's or a class's body."""
    for node in body:
        if isinstance(node, (ast.If, ast.Try, ast.With)):
            yield from _bound(node.body)
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and _is_container(node.value):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            yield from ((target.id, node.lineno) for target in targets if isinstance(target, ast.Name))
        if isinstance(node, ast.ClassDef):
            yield from _bound(node.body)


def _changed(tree: ast.Module) -> Iterator[str]:
    """Names of what is changed in place anywhere: by a method, an item, or an operator."""
    for node in ast.walk(tree):
        place: ast.expr | None = None
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in CHANGERS:
            place = node.func.value
        elif isinstance(node, ast.AugAssign):
            place = node.target
        elif isinstance(node, ast.Subscript) and isinstance(node.ctx, (ast.Store, ast.Del)):
            place = node.value
        if isinstance(place, ast.Subscript):
            place = place.value
        if isinstance(place, ast.Name):
            yield place.id
        elif isinstance(place, ast.Attribute):
            yield place.attr


def mutable_state(tree: ast.Module) -> list[str]:
    """Say what a module keeps that can change: containers in variables, and constants that are changed after all."""
    found = []
    changed = set(_changed(tree))
    for bound, line in _bound(tree.body):
        constant = bound.isupper() or bound in ("__all__", "model_config")
        if not constant or bound in changed:
            found.append(f"line {line}: {bound}")
    return found


@pytest.mark.parametrize(
    "text",
    [
        "cache = {}",
        "known: list[int] = []",
        "from collections import deque\nlast = deque(maxlen=3)",
        "import collections\nseen = collections.Counter()",
        "_cells = [0 for _ in range(3)]",
        "class Peer:\n    every = []",
        "if True:\n    kept = set()",
        "TABLE = {}\ndef learn(key):\n    TABLE[key] = 1",
        "NAMES = []\ndef learn(name):\n    NAMES.append(name)",
        "NAMES = set()\ndef learn(name):\n    global NAMES\n    NAMES |= {name}",
        "SIZES = {'a': []}\ndef learn(size):\n    SIZES['a'].append(size)",
    ],
)
def test_mutable_state_is_found_where_there_is_some(text: str) -> None:
    assert mutable_state(ast.parse(text))


@pytest.mark.parametrize("text", ["TABLE = {'a': 1}", "LIMIT = 3", "def f():\n    found = []\n    found.append(1)"])
def test_what_never_changes_is_no_mutable_state(text: str) -> None:
    assert not mutable_state(ast.parse(text))


def test_no_mutable_state_in_modules() -> None:
    assert not {name(path): found for path, tree in TREES.items() if (found := mutable_state(tree))}


def test_files_and_functions_keep_their_size() -> None:
    for path, tree in TREES.items():
        assert len(path.read_text().splitlines()) <= MOST_LINES, name(path)
        for node in ast.walk(tree):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                assert (node.end_lineno or 0) - node.lineno < MOST_FUNCTION_LINES, f"{name(path)}:{node.name}"
