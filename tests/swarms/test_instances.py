"""What instances are started with: ports and ids never collide, and what cannot be started is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.errors import MissionError
from fg_gcs.link.endpoint import parse_endpoint, px4_endpoints
from fg_gcs.mission.model import DEFAULT_ORIGIN
from fg_gcs.sitl.instances import RECIPES, Instance, SwarmOptions, check_options, numbered


def px4_tree(folder: Path) -> Path:
    """Make what a build of PX4 has, as far as it is looked at; return the binary."""
    (folder / "etc" / "init.d-posix").mkdir(parents=True)
    (folder / "etc" / "init.d-posix" / "rcS").write_text("")
    (folder / "bin").mkdir()
    binary = folder / "bin" / "px4"
    binary.write_text("#!/bin/sh\n")
    binary.chmod(0o755)
    return binary


@pytest.mark.parametrize("autopilot", RECIPES)
@given(first=st.integers(0, 200), count=st.integers(1, 50))
def test_no_port_is_bound_twice_nor_by_us(autopilot: str, first: int, count: int) -> None:
    options = SwarmOptions(autopilot, Path("sitl"))
    numbers = range(first, first + count)
    ports = [port[:2] for number in numbers for port in options.recipe.ports(options, number)]
    assert len(set(ports)) == len(ports)
    ours = [parse_endpoint(text) for text in options.recipe.endpoints(options, numbers)]
    assert len(set(ours)) == len(ours)
    assert not {endpoint.port for endpoint in ours} & {number for _, number in ports}


def test_px4_is_started_by_its_environment_and_heard_where_it_sends(tmp_path: Path) -> None:
    binary = px4_tree(tmp_path)
    options = SwarmOptions("px4", binary, parameters=(("MPC_XY_VEL_MAX", 8.0),))
    etc = check_options(options)
    assert etc == tmp_path / "etc"
    start = options.recipe.start(options, etc, Instance(11, 12, DEFAULT_ORIGIN))
    assert start.arguments == (str(binary), "-d", "-i", "11", str(etc))
    assert start.environment["PX4_HOME_LAT"] == "47.397742000"
    assert start.environment["PX4_PARAM_MPC_XY_VEL_MAX"] == "8"
    assert options.recipe.endpoints(options, range(8, 12)) == px4_endpoints(4, 8)
    assert px4_endpoints(4, 8) == ("udpin:127.0.0.1:14548", "udpin:127.0.0.1:14549")


def test_ardupilot_is_started_by_its_arguments(tmp_path: Path) -> None:
    binary = tmp_path / "build" / "sitl" / "bin" / "arducopter"
    defaults = tmp_path / "Tools" / "autotest" / "default_params" / "copter.parm"
    for path in (binary, defaults):
        path.parent.mkdir(parents=True)
        path.write_text("")
    binary.chmod(0o755)
    options = SwarmOptions("ardupilot", binary, parameters=(("PSC_JERK_XY", 20.0),), port=24550)
    start = options.recipe.start(options, check_options(options), Instance(3, 14, DEFAULT_ORIGIN))
    told = dict(zip(start.arguments, start.arguments[1:], strict=False))
    assert (told["--sysid"], told["--base-port"], told["--rc-in-port"]) == ("14", "5790", "5531")
    assert told["--serial0"] == "udpclient:127.0.0.1:24550"
    assert told["--home"] == "47.397742000,8.545594000,488.000,0"
    assert told["--defaults"] == f"{defaults},extra.parm"
    assert start.texts == {"extra.parm": "PSC_JERK_XY 20\n"}
    assert "-w" in start.arguments
    assert "-w" not in options.recipe.start(replace(options, keep_parameters=True), defaults, some()).arguments


def some() -> Instance:
    return Instance(0, 1, DEFAULT_ORIGIN)


def test_what_cannot_be_started_is_refused_in_one_line(tmp_path: Path) -> None:
    good = SwarmOptions("px4", px4_tree(tmp_path))
    check_options(good)
    (tmp_path / "text").write_text("")
    for options, reason in (
        (replace(good, autopilot="paparazzi"), "accepted: px4 or ardupilot"),
        (replace(good, binary=tmp_path / "none"), "there is no such file"),
        (replace(good, binary=tmp_path / "text"), "not a program that can be run"),
        (replace(good, binary=tmp_path), "not a program that can be run"),
        (replace(good, files=tmp_path), "is not the folder etc"),
        (replace(good, autopilot="ardupilot"), "has not beside it a file of default parameters"),
        (replace(good, parameters=(("MAV_SYS_ID", 3.0),)), "all instances would have the same id"),
        (replace(good, parameters=(("a b", 3.0),)), "not a parameter and a number"),
        (replace(good, parameters=(("RTL_ALT", float("nan")),)), "not a parameter and a number"),
        (replace(good, port=24550), "PX4's ports follow from the number"),
    ):
        with pytest.raises(MissionError, match=reason) as refused:
            check_options(options)
        assert "\n" not in str(refused.value)


def test_ids_are_those_of_instances() -> None:
    home = [DEFAULT_ORIGIN] * 2
    assert [each.system_id for each in numbered([4, 7], [5, 8], home, "px4")] == [5, 8]
    for numbers, ids, autopilot, reason in (
        ([4, 7], [5, 9], "px4", "always has the system id 8"),
        ([0, 1], [7, 7], "ardupilot", "two instances would have the system id 7"),
        ([0, 1], [250, 251], "ardupilot", "ids are 1 to 250"),
        ([249, 250], [1, 2], "ardupilot", "instances 0 to 249"),
    ):
        with pytest.raises(MissionError, match=reason):
            numbered(numbers, ids, home, autopilot)
