"""The command line of ``plan`` and ``check``; light enough to be read at every start."""

from __future__ import annotations

import argparse
from pathlib import Path

from fg_gcs.console.numbers import not_negative

EPILOG = """examples:
  fg-gcs plan missions/demo.toml --plot plan.svg     a picture of it
  fg-gcs plan missions/sitl.toml --wander px4        is it wide enough for real PX4, and how wide must it be?
  fg-gcs plan missions/circle.toml --wander 0.2 --lag 0.05
                                                     for vehicles that hover off their places by so much, and lag
"""


def add_plan(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add both commands."""
    plan = commands.add_parser(
        "plan",
        help="plan missions without flying",
        description="Plan and verify missions.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    plan.add_argument("missions", type=Path, nargs="+", metavar="MISSION")
    plan.add_argument("--json", action="store_true", help="print one JSON object a mission on stdout")
    plan.add_argument("--plot", type=Path, metavar="FILE", help="draw the plan (png, svg or pdf); one mission only")
    plan.add_argument(
        "--wander",
        type=_wander,
        metavar="M",
        help="how far vehicles hover off their places, rms in metres as seen from above, or px4 or ardupilot: as real "
        "ones do; says how often two come too near, and which edge is safe (default: as the mission has it)",
    )
    plan.add_argument(
        "--lag",
        type=not_negative,
        default=0.0,
        metavar="S",
        help="by how much vehicles lag behind differently, standard deviation in seconds (default: 0)",
    )
    check = commands.add_parser("check", help="validate mission files", description="Validate mission files.")
    check.add_argument("missions", type=Path, nargs="+", metavar="MISSION")


def _wander(text: str) -> float | str:
    return text if text in ("px4", "ardupilot") else not_negative(text)
