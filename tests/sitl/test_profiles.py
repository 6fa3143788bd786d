"""Autopilots are strategies: nothing asks for a name, and a new one is a module and a file of parameters."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from sitl_mock import profiles
from sitl_mock.autopilot.profile import Behaviour, ModeEvent
from tests.sitl.driver import ARM, LAND, TAKEOFF, Station

ROOT = Path(profiles.__file__).parent.parent
EVERYWHERE_ELSE = [path for path in sorted(ROOT.rglob("*.py")) if path.parent.name != "profiles"]
FAMILY = re.compile(r"px4|ardu|apm|copter", re.IGNORECASE)
GENERIC = '''
"""A third autopilot: ArduPilot's tables with a few numbers of its own."""

import dataclasses
from pathlib import Path

from sitl_mock.autopilot.parameters import read_defaults
from sitl_mock.profiles.ardupilot import PROFILE, STRATEGY, ArduPilotRules
from sitl_mock.protocol.dialect import Strategy

OWN = dataclasses.replace(PROFILE, autopilot=0, parameters=read_defaults(Path(__file__).with_suffix(".toml")))


class GenericRules(ArduPilotRules):
    def landing_speed_m_s(self, parameters, height_m):
        return parameters["DESCENT"]


STRATEGY = Strategy(GenericRules(OWN), STRATEGY.dialect)
'''


def names_in(node: ast.AST) -> set[str]:
    """Every name, attribute and text in an expression."""
    found = set()
    for part in ast.walk(node):
        if isinstance(part, ast.Name):
            found.add(part.id)
        elif isinstance(part, ast.Attribute):
            found.add(part.attr)
        elif isinstance(part, ast.Constant) and isinstance(part.value, str):
            found.add(part.value)
    return found


def branches(tree: ast.AST) -> list[ast.AST]:
    """What a decision is made by: conditions, comparisons, match subjects and patterns, keys of look-ups."""
    found: list[ast.AST] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.If | ast.IfExp | ast.While):
            found.append(node.test)
        elif isinstance(node, ast.comprehension):
            found += node.ifs
        elif isinstance(node, ast.Compare | ast.BoolOp | ast.MatchValue):
            found.append(node)
        elif isinstance(node, ast.Match):
            found.append(node.subject)
        elif isinstance(node, ast.Subscript):
            found.append(node.slice)
        elif isinstance(node, ast.Dict):
            found += [key for key in node.keys if key is not None]
    return found


@pytest.mark.parametrize("path", EVERYWHERE_ELSE, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_nothing_branches_on_the_autopilot(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in branches(tree):
        assert not [name for name in names_in(node) if FAMILY.search(name)], f"{path.name}:{node.lineno}"  # type: ignore[attr-defined]


def test_the_search_finds_branches() -> None:
    for text in ("x = 1 if self.is_px4 else 2", "name == 'px4'", "TABLE['ardupilot']", "{'px4': 1}", "a and not px4"):
        assert any(FAMILY.search(name) for node in branches(ast.parse(text)) for name in names_in(node)), text


@pytest.mark.parametrize("name", profiles.names())
def test_profiles_name_only_modes_and_parameters_that_they_have(name: str) -> None:
    profile = profiles.strategy(name).rules.profile
    modes = {mode.name for mode in profile.modes}
    named = {profile.first_mode, profile.stream_mode, *profile.transitions.values()}
    named |= {mode for mode, _ in profile.transitions}
    named |= {mode for table in profile.failsafe_modes.values() for mode in table.values() if mode}
    assert named <= modes
    assert len({mode.number for mode in profile.modes}) == len(modes) == len(profile.modes)
    speeds = profile.speeds
    assert {speeds.horizontal, speeds.climb, speeds.descent, speeds.takeoff, speeds.acceleration} <= set(
        profile.parameters
    )
    assert {profile.system_id_parameter, profile.idle_disarm_parameter} <= set(profile.parameters)
    assert profile.failsafe_modes.get(ModeEvent.GCS_LOST)
    assert next(mode for mode in profile.modes if mode.name == profile.stream_mode).behaviour is Behaviour.FOLLOW


def test_an_unknown_autopilot_is_refused_with_those_there_are() -> None:
    with pytest.raises(ValueError, match=r"autopilot 'paparazzi' is not one of: ardupilot, px4"):
        profiles.strategy("paparazzi")


def test_a_new_autopilot_is_a_module_and_a_file_of_parameters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It can be chosen by its name, boots, takes off and lands by a rule and a parameter of its own."""
    parameters = (ROOT / "profiles" / "ardupilot" / "parameters.toml").read_text(encoding="utf-8")
    (tmp_path / "generic.py").write_text(GENERIC, encoding="utf-8")
    (tmp_path / "generic.toml").write_text(f"{parameters}\nDESCENT = 2.0\n", encoding="utf-8")
    monkeypatch.setattr(profiles, "__path__", [*profiles.__path__, str(tmp_path)])
    assert profiles.names() == ("ardupilot", "generic", "px4")
    station = Station("generic")
    station.run(2.0)
    assert station.messages("HEARTBEAT")[-1].autopilot == 0
    station.command(176, 1, 4)
    assert station.command(ARM, 1) == [0]
    assert station.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 20.0) == [0]
    station.run(18.0)
    assert station.command(LAND) == [0]
    station.run(2.0)
    high_m = station.height_m()
    station.run(2.0)
    assert (high_m - station.height_m()) / 2.0 == pytest.approx(1.5, abs=0.55)  # 1.5: WPNAV_SPEED_DN, and headroom
    station.run(15.0)
    assert not station.autopilot.armed


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_parameters_and_flight_model_agree(autopilot: str) -> None:
    """What a parameter says at boot is what the vehicle flies with."""
    model, parameters = profiles.flight_model(autopilot), profiles.strategy(autopilot).rules.profile.parameters
    for name, (column, scale) in model.parameters.items():
        value = model.values[column]
        assert parameters[name].value * scale == pytest.approx(value, rel=1e-3), name
