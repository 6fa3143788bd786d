"""The options of ``swarm``, and those that ``fly --swarm`` shares with it; imports nothing that takes its time."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from types import MappingProxyType

from fg_gcs.console.numbers import instances, positive, whole

EPILOG = """\
examples:
  fg-gcs swarm px4 --binary PX4-Autopilot/build/px4_sitl_default/bin/px4 --vehicles 9
                                                     nine on a grid of 6 m; fly them with: fly MISSION --px4 9
  fg-gcs swarm ardupilot --binary ardupilot/build/sitl/bin/arducopter --vehicles 9 --first-id 10
                                                     nine with ids 10-18, which can fly with those above
  fg-gcs swarm px4 --binary px4 --vehicles 4 --first-instance 9 --layout circle --spacing 20
                                                     instances 9-12, whose ids are 10-13, on a circle
  fg-gcs swarm ardupilot --binary arducopter --defaults copter.parm --param PSC_JERK_XY=20 --vehicles 9
                                                     a parameter set in each
  fg-gcs fly missions/sitl.toml --swarm px4 --binary px4
                                                     starts as many as the mission needs, flies it, and ends them

Each instance has a folder of its own, sitl/px4-0 and so on, with what it says in out.log. Whatever ends this program,
Ctrl-C, a closed terminal or kill -9, ends all instances.

exit codes: 0 stopped after all could be armed, 1 stopped before, or not all can be armed in time, or the machine is too
  slow, or no instance is left, 2 bad input, 3 an instance ended while it booted or is not heard, or a port is taken
"""

_OF_INSTANCES = MappingProxyType(  # names of values, and their options
    {
        **{name: f"--{name}" for name in ("binary", "defaults", "model", "param", "spacing", "folder")},
        "px4_etc": "--px4-etc",
        "keep_parameters": "--keep-parameters",
        "port": "--gcs-port",
        "base_port": "--base-port",
        "heartbeat_s": "--heard-within",
        "ready_s": "--ready-within",
    }
)


def add_swarm(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:  # it has no other name
    """Add the command."""
    swarm = commands.add_parser(
        "swarm",
        help="start real SITL instances, and watch them",
        description="Start SITL instances of an autopilot that you have built, wait until each can be armed, and watch "
        "them until Ctrl-C; then end them.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    swarm.add_argument("autopilot", choices=("px4", "ardupilot"), help="whose SITL the program is")
    swarm.add_argument("--vehicles", type=instances, required=True, metavar="N", help="how many instances")
    add_instances(swarm.add_argument_group("instances"))
    add = swarm.add_argument_group("where they are").add_argument
    add(
        "--layout",
        default="grid",
        metavar="LAYOUT",
        help="how homes lie: grid, line (eastwards), circle, or a file with a line EAST,NORTH in metres for each "
        "(default: %(default)s)",
    )
    add("--home", type=_home, metavar="LAT,LON,ALT", help="where the layout begins, or its centre (default: Zurich)")
    add("--first-instance", type=whole(0, 249), metavar="N", help="its number; ports follow from it (default: 0)")
    add("--first-id", type=instances, metavar="ID", help="its system id (default: one more than its number)")
    swarm.add_argument("--json", action="store_true", help="print a JSON object when all can be armed, and at the end")


def add_fly(fly: argparse.ArgumentParser) -> None:
    """Add what ``fly`` starts instances by."""
    group = fly.add_argument_group("instances that are started for the flight", "as many as the mission needs")
    group.add_argument("--swarm", choices=("px4", "ardupilot"), help="start SITL instances of it, see fg-gcs swarm")
    add_instances(group)


def add_instances(group: argparse._ArgumentGroup) -> None:  # it has no other name
    """Add what one instance is like."""
    add = group.add_argument
    add("--binary", type=Path, metavar="PATH", help="the SITL program: px4, or arducopter")
    add("--px4-etc", type=Path, metavar="DIR", help="PX4's folder with start scripts (default: ../etc beside it)")
    add("--defaults", type=Path, metavar="FILE", help="ArduPilot's parameters (default: copter.parm of its sources)")
    add("--model", metavar="NAME", help="of the vehicle (default: sihsim_quadx for px4, quad for ardupilot)")
    add("--param", action="append", metavar="NAME=VALUE", help="a parameter to set in each; repeat for more")
    add("--spacing", type=positive, metavar="M", help="between neighbours (default: the mission's, or 6 m)")
    add("--folder", type=Path, metavar="DIR", help="of their working folders (default: sitl, or the run's own)")
    add("--keep-parameters", action="store_true", help="keep what was stored there; else they start as if new")
    add(
        "--gcs-port",
        type=whole(1024, 65535, "port"),
        dest="port",
        metavar="P",
        help="where ArduPilot sends to (default: 14550)",
    )
    ports_from = whole(1024, 60000, "port")  # 250 instances have theirs above it
    add("--base-port", type=ports_from, metavar="P", help="of ArduPilot's instance 0 (default: 5760)")
    add("--heard-within", type=positive, dest="heartbeat_s", metavar="S", help="first heartbeats (default: 30 s)")
    add("--ready-within", type=positive, dest="ready_s", metavar="S", help="until all can be armed (default: 120 s)")
    add(
        "--slow-machine-ok",
        action="store_true",
        help="do not look whether the machine starves them: otherwise all their clocks must keep 0.95 of real time",
    )


def given(chosen: argparse.Namespace) -> list[str]:
    """Return which options of instances are given that mean nothing without any."""
    return [option for name, option in _OF_INSTANCES.items() if getattr(chosen, name)]


def _home(text: str) -> tuple[float, float, float]:
    try:
        latitude, longitude, altitude = map(float, text.split(","))
    except ValueError:
        latitude = math.nan
        longitude = altitude = 0.0
    if not (abs(latitude) <= 85.0 and abs(longitude) <= 180.0 and abs(altitude) < 1e4):
        raise argparse.ArgumentTypeError(f"{text!r} is not LAT,LON,ALT in degrees and metres, |LAT| <= 85")
    return latitude, longitude, altitude
