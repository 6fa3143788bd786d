"""Command line of the simulator: `python -m sitl_mock`."""

from __future__ import annotations

import argparse
import math
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sitl_mock.host.server import SimulatorOptions
    from sitl_mock.host.targets import TargetOptions

PX4_PORT_BASE = 18570  # where the real one listens
EXAMPLES = """\
examples:
  python -m sitl_mock --vehicles 9
      nine PX4 vehicles on a 3 m grid, telemetry to 127.0.0.1:14550
  python -m sitl_mock --vehicles 3 --autopilot ardupilot --pads "0,0 4,0 0,4" --wind 5
      three ArduPilot vehicles on given pads (east,north in metres) in a breeze
  python -m sitl_mock --vehicles 2 --remote 127.0.0.1:14550 --remote 127.0.0.1:14540 --port-base 0
      two ground stations at once, any free local ports
  python -m sitl_mock --vehicles 0 --target '{"system_id": 101, "kind": "circle", "centre_enu_m": [0, 0, 18],
      "radius_m": 50, "speed_m_s": 4}'
      nothing but a vehicle to be followed, on a circle
"""
USAGE_ERROR = 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the simulator's options to a parser (also to `fg-gcs sim`'s)."""
    add = parser.add_argument
    add("--vehicles", type=_count, default=None, metavar="N", help="how many (default: as many as --pads, or 1)")
    add(
        "--target",
        type=_target,
        action="append",
        metavar="JSON",
        help='also a vehicle to be followed, with "system_id" and "kind": "static", "waypoints", "circle" or '
        '"figure_eight"; its keys are those of [targets.motion], see missions/README.md, and "rate_hz" and '
        '"follow_target"; repeat for more',
    )
    add(
        "--autopilot",
        choices=("px4", "ardupilot"),
        default="px4",
        help="which autopilot to play (default: %(default)s)",
    )
    add(
        "--remote",
        type=_address,
        action="append",
        metavar="HOST:PORT",
        help="where telemetry goes; repeat for more (default: 127.0.0.1:14550)",
    )
    add(
        "--port-base",
        type=_port,
        default=None,
        metavar="PORT",
        help="vehicle k listens on PORT+k, and 3990 lower for each further remote; 0: any free ports "
        "(default: 18570 for px4, 0 for ardupilot)",
    )
    add(
        "--pads", type=_pads, default=None, metavar='"X,Y ..."', help="east,north of each pad in metres from the origin"
    )
    add(
        "--spacing",
        type=_positive,
        default=3.0,
        metavar="M",
        help="of the default grid of pads (default: %(default)s m)",
    )
    add(
        "--origin",
        type=_origin,
        default=(47.397742, 8.545594, 488.0),
        metavar="LAT,LON,ALT",
        help="of the world's ENU axes (default: 47.397742,8.545594,488.0)",
    )
    add(
        "--system-ids", type=_system_ids, default=None, metavar='"1,2,5"', help="one per vehicle (default: 1, 2, 3 ...)"
    )
    add("--seed", type=int, default=0, metavar="S", help="of everything random (default: %(default)s)")
    add("--speed", type=_positive, default=1.0, metavar="X", help="simulated seconds per second (default: %(default)s)")
    add("--real-boot", action="store_true", help="boot as slowly as the real ones: 4 s px4, 41 s ardupilot")
    add(
        "--wind",
        type=_not_negative,
        default=0.0,
        metavar="M_S",
        help="mean wind with gusts in m/s (default: still air)",
    )
    add("--with-parent", action="store_true", help="exit when standard input ends")


def run(arguments: argparse.Namespace) -> int:
    """Simulate until interrupted.

    Returns:
        Exit code: 0 ended by SIGINT, SIGTERM or the parent's end; 2 bad options or a port in use.
    """
    try:
        options = options_of(arguments)
    except ValueError as error:
        print(f"sitl_mock: {error}", file=sys.stderr)
        return USAGE_ERROR
    from sitl_mock.host.session import simulate  # numpy and pymavlink: not for a mere --help

    return simulate(options, arguments.with_parent)


def options_of(arguments: argparse.Namespace) -> SimulatorOptions:
    """Complete and check the parsed options.

    Raises:
        ValueError: options that contradict each other.
    """
    from sitl_mock.host.server import SimulatorOptions

    pads = arguments.pads
    vehicles = (len(pads) if pads else 1) if arguments.vehicles is None else arguments.vehicles
    targets = tuple(arguments.target or ())
    if vehicles + len(targets) == 0:
        raise ValueError("--vehicles: 0 is no number of vehicles without a --target")
    if pads is None:
        pads = grid(vehicles, arguments.spacing)
    if len(pads) != vehicles:
        raise ValueError(f"--pads has {len(pads)} pads for {vehicles} vehicles")
    system_ids = arguments.system_ids or tuple(range(1, vehicles + 1))
    if len(system_ids) != vehicles:
        raise ValueError(f"--system-ids has {len(system_ids)} ids for {vehicles} vehicles")
    if max(system_ids, default=0) > 255:
        raise ValueError("MAVLink has no system ids above 255")
    every = [*system_ids, *(target.system_id for target in targets)]
    if len(set(every)) < len(every):
        raise ValueError("--target names a system id that another vehicle has")
    port_base = arguments.port_base
    if port_base is None:
        port_base = PX4_PORT_BASE if arguments.autopilot == "px4" else 0
    return SimulatorOptions(
        autopilot=arguments.autopilot,
        pads_enu_m=pads,
        system_ids=system_ids,
        remotes=tuple(arguments.remote or [("127.0.0.1", 14550)]),
        port_base=port_base,
        origin_deg_m=arguments.origin,
        seed=arguments.seed,
        speed=arguments.speed,
        real_boot=arguments.real_boot,
        wind_m_s=arguments.wind,
        targets=targets,
    )


def grid(vehicles: int, spacing_m: float) -> tuple[tuple[float, float], ...]:
    """Pads (east, north) on a grid as square as possible, the first at 0,0; none for no vehicles."""
    columns = math.ceil(math.sqrt(vehicles))
    return tuple((spacing_m * (k % columns), spacing_m * (k // columns)) for k in range(vehicles))


def main() -> int:
    """Parse the command line and simulate."""
    parser = argparse.ArgumentParser(
        prog="python -m sitl_mock",
        description="A particle simulator of MAVLink vehicles that answers as PX4 or ArduPilot SITL does.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_arguments(parser)
    return run(parser.parse_args())


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return value


def _positive(text: str) -> float:
    value = _number(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} must be greater than 0")
    return value


def _not_negative(text: str) -> float:
    value = _number(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} must not be negative")
    return value


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) > 255:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of vehicles (0 to 255)")
    return int(text)


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port (0 to 65535)")
    return int(text)


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if host not in ("127.0.0.1", "localhost"):
        raise argparse.ArgumentTypeError(f"{text!r}: telemetry goes to 127.0.0.1:PORT only")
    return "127.0.0.1", _port(port)


def _pads(text: str) -> tuple[tuple[float, float], ...]:
    pads = tuple(tuple(_number(part) for part in pad.split(",")) for pad in text.split())
    if not pads or any(len(pad) != 2 for pad in pads):
        raise argparse.ArgumentTypeError(f'{text!r} is not a list of pads like "0,0 3,0"')
    return tuple((pad[0], pad[1]) for pad in pads)


def _origin(text: str) -> tuple[float, float, float]:
    parts = tuple(_number(part) for part in text.split(","))
    if len(parts) != 3 or abs(parts[0]) > 90.0 or abs(parts[1]) > 180.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not LAT,LON,ALT in degrees and metres")
    return parts[0], parts[1], parts[2]


def _target(text: str) -> TargetOptions:
    from sitl_mock.host.targets import parse_target  # pymavlink: not for a mere --help

    try:
        return parse_target(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: {error}") from error


def _system_ids(text: str) -> tuple[int, ...]:
    parts = text.split(",")
    if not all(part.strip().isdecimal() and 1 <= int(part) <= 255 for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of system ids (1 to 255)")
    ids = tuple(int(part) for part in parts)
    if len(set(ids)) != len(ids):
        raise argparse.ArgumentTypeError(f"{text!r} names a system id twice")
    return ids


if __name__ == "__main__":
    sys.exit(main())
