"""Command line of the simulator: `python -m sitl_mock`."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from sitl_mock import profiles

if TYPE_CHECKING:
    from sitl_mock.host.server import SimulatorOptions
    from sitl_mock.host.targets import TargetOptions

EXAMPLES = """\
examples:
  python -m sitl_mock --vehicles 9
      nine PX4 vehicles on a grid of 3 m, which send their telemetry to 127.0.0.1:14550
  python -m sitl_mock --vehicles 3 --autopilot ardupilot --pads "0,0 4,0 0,4" --wind 5
      three ArduPilot vehicles on given pads (east,north in metres) in a wind of 5 m/s
  python -m sitl_mock --vehicles 2 --remote 127.0.0.1:14550 --remote 127.0.0.1:14540 --port-base 0
      two vehicles with two ground stations at once, on any free local ports
  python -m sitl_mock --vehicles 0 --target '{"system_id": 101, "kind": "circle", "centre_enu_m": [0, 0, 18],
      "radius_m": 50, "speed_m_s": 4}'
      only a vehicle to be followed, which flies a circle
  python -m sitl_mock --vehicles 9 --fault '{"kind": "gps_loss", "vehicles": [3], "at_s": 30}'
      vehicle 3 loses its satellites after half a minute
  python -m sitl_mock --vehicles 9 --impair '{"loss": 0.2, "delay_s": 0.1, "jitter_s": 0.05}'
      every link loses a fifth of its datagrams, the others come 100 to 150 ms late
  python -m sitl_mock --vehicles 9 --signing-key swarm.key
      vehicles that sign all they send, and take nothing that is not signed with the same key
"""
USAGE_ERROR = 2

Options = TypeVar("Options")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the simulator's options to a parser (also to `fg-gcs sim`'s)."""
    _add_vehicles(parser)
    _add_sockets(parser)
    _add_world(parser)
    _add_trouble(parser)


def _add_vehicles(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument_group("vehicles").add_argument
    add(
        "--vehicles",
        type=_count,
        default=None,
        metavar="N",
        help="number of vehicles (default: as many as --pads has, or 1)",
    )
    add(
        "--autopilot",
        choices=profiles.names(),
        default="px4",
        help="autopilot that the vehicles imitate (default: %(default)s)",
    )
    add(
        "--system-ids",
        type=_system_ids,
        default=None,
        metavar='"1,2,5"',
        help="MAVLink system id of each vehicle (default: 1, 2, 3 ...)",
    )
    add(
        "--pads",
        type=_pads,
        default=None,
        metavar='"X,Y ..."',
        help="pad of each vehicle: metres east,north of the origin (default: a square grid)",
    )
    add(
        "--spacing",
        type=_positive,
        default=3.0,
        metavar="M",
        help="spacing of the default grid of pads in metres (default: %(default)s)",
    )
    add("--real-boot", action="store_true", help="boot as slowly as the real autopilots: px4 4 s, ardupilot 41 s")
    add(
        "--target",
        type=_target,
        action="append",
        metavar="JSON",
        help='add a vehicle to be followed: a JSON object with "system_id", "kind" ("static", "waypoints", "circle" '
        'or "figure_eight"), the keys of that kind as in [targets.motion] (see missions/README.md), and, if wanted, '
        '"rate_hz" and "follow_target"; repeat for more',
    )


def _add_sockets(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument_group("sockets and process").add_argument
    add(
        "--remote",
        type=_address,
        action="append",
        metavar="HOST:PORT",
        help="where telemetry is sent; repeat for more (default: 127.0.0.1:14550)",
    )
    add(
        "--port-base",
        type=_port,
        default=None,
        metavar="PORT",
        help="vehicle k listens on PORT+k, and 3990 lower for each further remote; 0: on any free ports "
        "(default: 18570 for px4, 0 for ardupilot)",
    )
    add(
        "--signing-key",
        type=Path,
        metavar="FILE",
        help="vehicles sign what they send and take nothing unsigned; FILE holds 32 bytes, 64 hexadecimal digits or a "
        "passphrase, and nobody else may read it (default: no key, until SETUP_SIGNING gives one)",
    )
    add("--with-parent", action="store_true", help="exit when standard input ends; lines there tell stages: stage hold")
    add("--truth", type=Path, metavar="FILE", help="write what vehicles truly hit, and how close they came, as JSON")
    add(
        "--timing", type=Path, metavar="FILE", help="write how late the simulator's own ticks were, as JSON, at the end"
    )


def _add_trouble(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("what goes wrong on purpose (all kinds and keys: --list-faults)")
    group.add_argument(
        "--fault",
        action="append",
        metavar="JSON",
        help='a fault inside vehicles: a JSON object with "kind", and if wanted "vehicles", "at_s", "stage", "for_s" '
        "and the keys of that kind; repeat for more",
    )
    group.add_argument(
        "--impair",
        action="append",
        metavar="JSON",
        help='an impairment of links: a JSON object with "loss", "delay_s", "jitter_s", "reorder", "duplicate" or '
        '"corrupt", and if wanted "vehicles", "at_s", "stage", "for_s", "direction" and "messages"; repeat for more',
    )
    group.add_argument(
        "--harmless", action="store_true", help="vehicles that hit each other or the ground fly on; it is only told"
    )
    group.add_argument("--list-faults", action=_ListFaults, help="print all kinds and keys, and exit")
    group = parser.add_argument_group("manners of other versions")
    for name, text in (
        (
            "strict-commands",
            "parameters that a command does not have must be 0 or NaN, else it is denied (PX4 of 2026)",
        ),
        ("new-partner", "a client that fell silent for 5 s is replaced by whoever speaks next (PX4 of 2026)"),
        ("parameter-freeze", "after a changed parameter nothing is sent until something is heard again (PX4)"),
    ):
        group.add_argument(f"--{name}", action="store_true", help=text)


def _add_world(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument_group("world").add_argument
    add(
        "--origin",
        type=_origin,
        default=(47.397742, 8.545594, 488.0),
        metavar="LAT,LON,ALT",
        help="origin of the world's ENU axes in degrees and metres (default: 47.397742,8.545594,488.0)",
    )
    add(
        "--wind",
        type=_not_negative,
        default=0.0,
        metavar="M_S",
        help="mean wind speed in m/s, with gusts (default: still air)",
    )
    add(
        "--noise",
        type=float,
        default=None,
        metavar="M",
        help="how far vehicles hover off their places under measured dynamics, rms in metres (default: as measured: "
        "px4 0.69, ardupilot 0.02)",
    )
    add(
        "--dynamics",
        choices=("paper", "measured"),
        default="paper",
        help="how vehicles fly: as the paper's particle, or as the real autopilots do (default: %(default)s)",
    )
    add("--seed", type=int, default=0, metavar="S", help="seed of everything random (default: %(default)s)")
    add(
        "--speed",
        type=_speed,
        default=1.0,
        metavar="X",
        help='simulated seconds per second of real time, or "max": as fast as possible (default: %(default)s)',
    )
    add(
        "--lockstep",
        action="store_true",
        help="time stands still until a program lets it go, by COMMAND_LONG 31010 to any vehicle: param1 0 runs, "
        "1 pauses, 2 steps by param2 seconds; the acknowledgement comes behind all that was said meanwhile",
    )


def run(arguments: argparse.Namespace) -> int:
    """Simulate until the process is interrupted.

    Returns:
        Exit code: 0 after SIGINT, SIGTERM or the end of the parent; 2 for bad options, 3 for a port in use.
    """
    try:
        options = options_of(arguments)
    except ValueError as error:
        print(f"sitl_mock: {error}", file=sys.stderr)
        return USAGE_ERROR
    from sitl_mock.host.session import simulate  # numpy and pymavlink: not for a mere --help

    return simulate(options, arguments.with_parent, arguments.timing)


def options_of(arguments: argparse.Namespace) -> SimulatorOptions:
    """Complete and check the parsed options.

    Raises:
        ValueError: options that contradict each other.
    """
    from sitl_mock.autopilot.profile import Manners
    from sitl_mock.faults.schema import parse_fault, parse_impairment
    from sitl_mock.host.fleet import grid
    from sitl_mock.host.server import SimulatorOptions
    from sitl_mock.protocol.signing import read_key

    pads = arguments.pads
    vehicles = (len(pads) if pads else 1) if arguments.vehicles is None else arguments.vehicles
    targets = tuple(arguments.target or ())
    if vehicles + len(targets) == 0:
        raise ValueError("there is nothing to simulate: --vehicles is 0 and there is no --target")
    if pads is None:
        pads = grid(vehicles, arguments.spacing)
    if len(pads) != vehicles:
        raise ValueError(f"the number of pads ({len(pads)}) is not the number of vehicles ({vehicles})")
    port_base = arguments.port_base
    if port_base is None:
        port_base = profiles.strategy(arguments.autopilot).rules.profile.port_base
    return SimulatorOptions(
        autopilot=arguments.autopilot,
        pads_enu_m=pads,
        system_ids=arguments.system_ids or (),
        remotes=tuple(arguments.remote or [("127.0.0.1", 14550)]),
        port_base=port_base,
        origin_deg_m=arguments.origin,
        seed=arguments.seed,
        speed=arguments.speed,
        real_boot=arguments.real_boot,
        wind_m_s=arguments.wind,
        noise_m=arguments.noise,
        targets=targets,
        truth=arguments.truth,
        collisions=not arguments.harmless,
        dynamics=arguments.dynamics,
        lockstep=arguments.lockstep,
        signing_key=None if arguments.signing_key is None else read_key(arguments.signing_key),
        faults=_read_all("--fault", parse_fault, arguments.fault),
        impairments=_read_all("--impair", parse_impairment, arguments.impair),
        manners=Manners(arguments.strict_commands, arguments.new_partner, arguments.parameter_freeze),
    )


def _read_all(option: str, parse: Callable[[str], Options], texts: list[str] | None) -> tuple[Options, ...]:
    """Read the JSON of an option that may be repeated.

    Raises:
        ValueError: one line that says what is wrong with which of them.
    """
    found = []
    for number, text in enumerate(texts or (), start=1):
        try:
            found.append(parse(text))
        except ValueError as error:
            raise ValueError(f"{option} {number}: {error}") from error
    return tuple(found)


def main() -> int:
    """Parse the command line and simulate."""
    parser = argparse.ArgumentParser(
        prog="python -m sitl_mock",
        description="Simulate MAVLink vehicles that answer as PX4 or ArduPilot SITL does, until Ctrl-C.",
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


def _speed(text: str) -> float:
    return math.inf if text == "max" else _positive(text)


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
        raise argparse.ArgumentTypeError(f"{text!r}: telemetry can be sent to 127.0.0.1:PORT only")
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


class _ListFaults(argparse.Action):
    """Print what may go wrong."""

    def __init__(self, option_strings: list[str], dest: str, **more: Any) -> None:  # noqa: ANN401  # argparse's own
        super().__init__(option_strings, dest, nargs=0, **more)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from sitl_mock.faults.schema import told  # pymavlink: not for a mere --help

        print(told())
        parser.exit()


def _system_ids(text: str) -> tuple[int, ...]:
    parts = text.split(",")
    if not all(part.strip().isdecimal() and 1 <= int(part) <= 255 for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of system ids (1 to 255)")
    return tuple(int(part) for part in parts)


if __name__ == "__main__":
    sys.exit(main())
