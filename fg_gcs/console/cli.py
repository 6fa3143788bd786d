"""The command line. Its top imports almost nothing, so that ``--help`` is there at once."""

from __future__ import annotations

import argparse
import json
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from fg_gcs.console import plan_options, swarm_options
from fg_gcs.console.numbers import count, instances, positive

if TYPE_CHECKING:
    from fg_gcs.sitl.instances import SwarmOptions

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"  # noqa: SLF001 # it has no other name

EXPERIMENTS = ("table1", "times", "sensitivity", "multi", "formulations", "moving", "measured", "figures", "all")

EPILOG = """\
examples:
  fg-gcs fly missions/demo.toml                      fly it with the built-in simulator
  fg-gcs fly missions/demo.toml --speed max          the same in virtual time: seconds, not minutes
  fg-gcs fly missions/sitl.toml --connect udpin:127.0.0.1:14550
                                                     fly real PX4 or ArduPilot SITL vehicles
  fg-gcs fly missions/sitl.toml --px4 9              nine PX4 SITL instances, at the ports that they have
  fg-gcs fly missions/sitl.toml --signing-key swarm.key
                                                     nothing that is not signed with that key is sent or taken
  fg-gcs plan missions/*.toml --json                 plan without flying, one JSON line a file
  fg-gcs check missions/*.toml                       is each file a valid mission?
  fg-gcs sim --vehicles 9 --autopilot ardupilot      only the simulator, for any ground station
  fg-gcs experiment all                              the paper's tables and figures anew, into docs/
  fg-gcs bench plan --json                           the planner against the paper's way
  fg-gcs bench track --flights 20 --jobs 2           moving targets and what is required; 20 random flights besides
  fg-gcs bench record                                what recording nine vehicles takes of a core
  fg-gcs bench stream                                setpoints beside other ground stations and a bare loop
  fg-gcs bench sim                                   the simulator alone, and whole flights with it
  fg-gcs swarm px4 --binary build/px4_sitl_default/bin/px4 --vehicles 9
                                                     start nine real PX4, and watch them
  fg-gcs recover                                     bring down what a crash left flying, put parameters back
  fg-gcs trial missions/*.toml --count 100           flights with random faults, judged by the simulator's truth
  fg-gcs report logs/2026-01-31T12-00-00-demo        write the report of a recorded run again

exit codes: 0 done, 1 the flight was aborted, and every vehicle is down, 2 bad input, 3 no vehicle answered,
  4 internal error, 5 ended, but not everything is as it should be:
  recording incomplete, or a vehicle not known to be down
"""


FLY_EPILOG = """examples:
  fg-gcs fly missions/demo.toml                      with the built-in simulator
  fg-gcs fly missions/sitl.toml --px4 9 --forward udpout:127.0.0.1:14560
                                                     nine PX4 SITL instances; another program watches
  fg-gcs fly missions/sitl.toml --swarm px4 --binary build/px4_sitl_default/bin/px4
                                                     as many real PX4 as the mission needs, started for it
  fg-gcs fly missions/sitl.toml --ardupilot 8 --connect serial:/dev/ttyUSB0:57600
                                                     eight ArduPilot SITL instances, and one behind a radio
  fg-gcs fly missions/sitl.toml --connect tcpin:0.0.0.0:5760
                                                     vehicles connect to us, from other machines as well
  fg-gcs fly missions/sitl.toml --connect west=udpin:14550 --connect east=udpin:14551 --signing-key west=west.key
                                                     two networks, one of which is signed
"""


STREAM_EPILOG = """examples:
  fg-gcs bench stream                                everything; takes some minutes, on a quiet machine
  fg-gcs bench stream --alone --vehicles 250         ours beside the bare loop, for a swarm of 250
  fg-gcs bench stream --json --seconds 30            longer, and one JSON object for programs

Vehicles are played by a small process of their own, which sends frames made beforehand and counts what comes.
"""


RECOVER_EPILOG = """examples:
  fg-gcs recover                                     after a crash: everything that run had in the air
  fg-gcs recover --connect udpin:127.0.0.1:14550     the same where vehicles are heard elsewhere now
  fg-gcs recover --signing-key swarm.key             the same where vehicles take only what is signed

exit codes: 0 everything is down and has its own parameters, 2 the run is alive, 3 no vehicle answered,
  5 something is left to do
"""


TRIAL_EPILOG = """examples:
  fg-gcs trial missions/*.toml --count 1000 --jobs 2   a thousand flights with faults, on two cores
  fg-gcs trial missions/demo.toml --only 17            seed 17 again, alone, with all that was said
  fg-gcs trial missions/sitl.toml --dynamics measured --autopilot px4

exit codes: 0 no law was broken, 5 one was, 2 bad input
"""


SIM_EPILOG = """examples:
  fg-gcs bench sim                                   everything; takes some minutes, on a quiet machine
  fg-gcs bench sim --swarm 0 --vehicles 250          without the flight in real time
  fg-gcs bench sim --json --seconds 60               longer, and one JSON object for programs

A tick that is left out counts as late by a whole tick. Shares of a core and memory are what Linux tells of a process.
"""


def parser() -> argparse.ArgumentParser:
    """Build the parser of all commands."""
    top = argparse.ArgumentParser(
        prog="fg-gcs",
        description="Flux-guided ground control: a swarm of simulated MAVLink vehicles flies to a target and "
        "surrounds it, its face towards the target all the way.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)

    _add_fly(commands)
    plan_options.add_plan(commands)
    _add_sim(commands)
    _add_experiment(commands)
    _add_bench(commands)
    _add_trial(commands)
    _add_recover(commands)
    swarm_options.add_swarm(commands)
    report = commands.add_parser("report", help="write a run's report again", description="Write a report again.")
    report.add_argument("log", type=Path, metavar="LOG", help="folder of a recorded run")
    return top


def _add_fly(commands: Commands) -> None:
    fly = commands.add_parser(
        "fly",
        help="fly a mission",
        description="Fly a mission and write a report.",
        epilog=FLY_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    fly.add_argument(
        "missions",
        type=Path,
        nargs="+",
        metavar="MISSION",
        help="mission file, see missions/README.md; several are flown one after the other until one is not completed",
    )
    _add_links(fly)
    fly.add_argument(
        "--wait", type=positive, default=30.0, metavar="S", help="for the first heartbeats (default: %(default)g s)"
    )
    fly.add_argument(
        "--speed",
        type=_speed,
        default=1.0,
        metavar="X",
        help="run time X times as fast; max: virtual time, as fast as it can be computed (simulator only)",
    )
    fly.add_argument(
        "--autopilot", choices=("px4", "ardupilot"), help="which autopilot the simulator plays, whatever the file says"
    )
    fly.add_argument(
        "--dynamics",
        choices=("paper", "measured"),
        help="how simulated vehicles fly: as the paper's particle, or as the real autopilots were measured to",
    )
    fly.add_argument(
        "--fault",
        action="append",
        metavar="JSON",
        help="something that goes wrong inside simulated vehicles, as in [[simulator.faults]] of a mission; repeat for "
        "more (kinds and keys: fg-gcs sim --list-faults)",
    )
    fly.add_argument(
        "--impair",
        action="append",
        metavar="JSON",
        help="something that goes wrong on their links, as in [[simulator.impairments]]; repeat for more",
    )
    swarm_options.add_fly(fly)
    fly.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR", help="where runs go (default: logs)")
    fly.add_argument("--json", action="store_true", help="print one JSON object a mission, the last line of stdout")


def _add_links(fly: argparse.ArgumentParser) -> None:
    """Add where vehicles are, who else sees them, and what is signed with."""
    fly.add_argument(
        "--connect",
        action="append",
        metavar="[NAME=]ENDPOINT",
        help="fly vehicles found here instead of starting the simulator: udpin:HOST:PORT, udpout:HOST:PORT, "
        "tcp:HOST:PORT, tcpin:HOST:PORT or serial:DEVICE:BAUD; repeat for more, of any kind; NAME=ENDPOINT puts it "
        "into a network of that name, each of which has its own system ids",
    )
    _add_presets(fly)
    fly.add_argument(
        "--forward",
        action="append",
        metavar="[NAME=]ENDPOINT",
        help="pass every vehicle's telemetry on, to QGroundControl, MAVProxy or a logger at udpout:HOST:PORT or "
        "tcp:HOST:PORT; repeat for more; what they say to vehicles is dropped unless the mission allows it",
    )
    _add_signing_key(fly)
    fly.add_argument(
        "--signing-setup",
        action="store_true",
        help="the vehicles do not have the key yet: give it to them, and arm nothing before each signs with it; "
        "whoever overhears that has the key, too",
    )


def _add_presets(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--px4",
        type=instances,
        default=0,
        metavar="N",
        help="hear N SITL instances of PX4 where they send by themselves: UDP 14540, 14541 ..., from the 10th on 14549",
    )
    command.add_argument(
        "--ardupilot",
        type=instances,
        default=0,
        metavar="N",
        help="connect to N SITL instances of ArduPilot: TCP 5760, 5770 ...",
    )


def _connections(chosen: argparse.Namespace) -> tuple[str, ...]:
    """Return all endpoints that were asked for."""
    from fg_gcs.link.endpoint import ardupilot_endpoints, px4_endpoints

    return (*(chosen.connect or ()), *px4_endpoints(chosen.px4), *ardupilot_endpoints(chosen.ardupilot))


def _add_signing_key(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--signing-key",
        action="append",
        metavar="[NAME=]FILE",
        help="sign all that is sent, and take nothing that is not signed with this key (MAVLink 2): 32 bytes, 64 "
        "hexadecimal digits or a passphrase, in a file that nobody else may read; NAME=FILE is for one network",
    )


def _add_sim(commands: Commands) -> None:
    sim = commands.add_parser("sim", help="run only the simulator", description="Run the built-in simulator.")
    from sitl_mock.__main__ import EXAMPLES, add_arguments

    sim.epilog = EXAMPLES.replace("python -m sitl_mock", "fg-gcs sim")
    sim.formatter_class = argparse.RawDescriptionHelpFormatter
    add_arguments(sim)


def _add_trial(commands: Commands) -> None:
    trial = commands.add_parser(
        "trial",
        help="fly with random faults, judged by the truth",
        description="Fly missions in virtual time with one or two random faults each, and judge every flight by the "
        "simulator's truth: no two vehicles meet, none is left in the air. One line a seed that breaks a law.",
        epilog=TRIAL_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    trial.add_argument("missions", type=Path, nargs="+", metavar="MISSION", help="mission file; each seed picks one")
    trial.add_argument("--count", type=count, default=100, metavar="N", help="trials (default: %(default)s)")
    trial.add_argument("--seed", type=int, default=0, metavar="S", help="of the first trial (default: %(default)s)")
    trial.add_argument("--only", type=int, metavar="S", dest="single", help="fly this seed alone, and tell everything")
    trial.add_argument("--jobs", type=_jobs, default=1, metavar="N", help="processes (default: %(default)s)")
    trial.add_argument(
        "--autopilot", action="append", choices=("px4", "ardupilot"), help="repeat for more (default: both)"
    )
    trial.add_argument(
        "--dynamics", action="append", choices=("paper", "measured"), help="repeat for more (default: paper)"
    )
    trial.add_argument(
        "--faults",
        type=count,
        metavar="N",
        help="in each flight; 0: none, and the last gate must never act (default: 1 or 2)",
    )
    trial.add_argument("--json", action="store_true", help="print one JSON object on stdout")


def _add_recover(commands: Commands) -> None:
    recover = commands.add_parser(
        "recover",
        help="bring down what a crash left flying",
        description="Find the vehicles of a run that crashed or was killed, bring them down apart from each other, and "
        "put their own parameters back where they are still as that run set them. Others are left alone.",
        epilog=RECOVER_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    recover.add_argument(
        "--connect",
        action="append",
        metavar="[NAME=]ENDPOINT",
        help="where vehicles are (default: where that run had them)",
    )
    _add_presets(recover)
    recover.add_argument(
        "--wait", type=positive, default=5.0, metavar="S", help="for heartbeats (default: %(default)g s)"
    )
    _add_signing_key(recover)
    recover.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR", help="where runs go (default: logs)")
    recover.add_argument(
        "--state", type=Path, metavar="DIR", help="where parameters are kept (default: the user's own)"
    )
    recover.add_argument("--json", action="store_true", help="print one JSON object on stdout")


def _add_experiment(commands: Commands) -> None:
    experiment = commands.add_parser(
        "experiment",
        help="regenerate the paper's tables and figures",
        description="Run an experiment of the paper; show its results beside the published ones.",
    )
    experiment.add_argument("name", choices=EXPERIMENTS, metavar="NAME", help=f"one of: {', '.join(EXPERIMENTS)}")
    experiment.add_argument(
        "--out", type=Path, default=Path("docs"), metavar="DIR", help="where tables and figures go (default: docs)"
    )


def _add_bench(commands: Commands) -> None:
    bench = commands.add_parser("bench", help="measure", description="Measure: a table for people, JSON for programs.")
    whats = bench.add_subparsers(dest="what", metavar="WHAT", required=True)
    plan = whats.add_parser("plan", help="the planner against the paper's way, as ratios side by side in one run")
    track = whats.add_parser("track", help="whole flights after moving targets beside what is required of them")
    record = whats.add_parser("record", help="what recording nine vehicles at full rates takes of a core")
    stream = whats.add_parser(
        "stream",
        help="setpoints to up to a thousand vehicles: ours, mavutil, MAVSDK and a bare loop of sendto in one run",
        epilog=STREAM_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_stream(stream)
    sim = whats.add_parser(
        "sim",
        help="the simulator alone, a flight in virtual time, and a large swarm in real time",
        epilog=SIM_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_sim_bench(sim)
    for each in (plan, track, record, stream, sim):
        each.add_argument("--json", action="store_true", help="print one JSON object, the last line of stdout")
    track.add_argument(
        "--flights", type=count, default=0, metavar="N", help="fly N random missions besides (default: none)"
    )
    track.add_argument(
        "--seed", type=count, default=0, metavar="S", help="of the first of them; the next has S + 1 (default: 0)"
    )
    track.add_argument(
        "--jobs",
        type=_jobs,
        default=1,
        metavar="N",
        help="random flights at once, a process each (default: %(default)s)",
    )
    record.add_argument(
        "--hour", action="store_true", help="how memory grows in an hour of virtual flight instead: takes minutes"
    )
    for each in (track, record, sim):
        each.add_argument(
            "--missions",
            type=Path,
            default=Path("missions"),
            metavar="DIR",
            help="mission files (default: %(default)s)",
        )


def _add_stream(stream: argparse.ArgumentParser) -> None:
    stream.add_argument(
        "--vehicles",
        type=_jobs,
        nargs="+",
        default=[9, 50, 100, 250],
        metavar="N",
        help="swarms to measure, of one network (default: 9 50 100 250)",
    )
    stream.add_argument(
        "--many", type=_jobs, default=1000, metavar="N", help="vehicles in four networks (default: %(default)s)"
    )
    stream.add_argument(
        "--seconds", type=positive, default=10.0, metavar="S", help="of each stream (default: %(default)g s)"
    )
    stream.add_argument("--alone", action="store_true", help="leave mavutil and MAVSDK out")


def _add_sim_bench(sim: argparse.ArgumentParser) -> None:
    sim.add_argument(
        "--vehicles",
        type=_jobs,
        nargs="+",
        default=[9, 50, 100, 250],
        metavar="N",
        help="fleets to measure alone, up to 250 (default: 9 50 100 250)",
    )
    sim.add_argument(
        "--swarm",
        type=count,
        default=249,
        metavar="N",
        help="vehicles of the flight in real time, an odd number; 0: no such flight (default: %(default)s)",
    )
    sim.add_argument(
        "--seconds", type=positive, default=20.0, metavar="S", help="of each fleet alone (default: %(default)g s)"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; with ``--json`` programs get their object whatever the code is."""
    from fg_gcs.console.codes import ExitCode

    try:
        chosen = parser().parse_args(arguments)
    except SystemExit as ended:  # usage, which argparse has told already; or --help
        if ended.code and "--json" in (sys.argv[1:] if arguments is None else arguments):
            _ended(argparse.Namespace(json=True), ExitCode.BAD_INPUT, "usage")
        raise
    from fg_gcs.errors import FgError, LinkError

    try:
        return _run(chosen)
    except FgError as error:
        code = ExitCode.NO_ANSWER if isinstance(error, LinkError) else ExitCode.BAD_INPUT
        print(f"fg-gcs: {error}", file=sys.stderr)
        return _ended(chosen, code, str(error))
    except KeyboardInterrupt:
        print("\nfg-gcs: stopped", file=sys.stderr)  # on a line of its own, after the terminal's ^C
        return _ended(chosen, ExitCode.ABORTED, "stopped")
    except BrokenPipeError:  # the reader of our output has gone, as `| head` does
        return ExitCode.DONE
    except Exception as error:
        traceback.print_exc()
        print("fg-gcs: internal error; the lines above belong into a bug report", file=sys.stderr)
        return _ended(chosen, ExitCode.INTERNAL_ERROR, repr(error))


def _ended(chosen: argparse.Namespace, code: int, reason: str) -> int:
    """Tell programs of an end without a result, and return the code."""
    if getattr(chosen, "json", False):
        with suppress(BrokenPipeError):
            print(json.dumps({"completed": False, "reason": reason, "exit_code": int(code)}), flush=True)
    return code


def _run(chosen: argparse.Namespace) -> int:
    """Load what the chosen command needs, and run it."""
    match chosen.command:
        case "fly":
            return _fly(chosen)
        case "plan":
            from fg_gcs.console.plan import plan

            return plan(chosen)
        case "check":
            from fg_gcs.console.plan import check

            return check(chosen.missions)
        case "experiment":
            from fg_gcs.console.experiment import experiment

            return experiment(chosen.name, chosen.out)
        case "bench":
            from fg_gcs.console import bench

            return bench.run(chosen)
        case "recover":
            from fg_gcs.console import recover

            return recover.run(chosen, _connections(chosen))
        case "swarm":
            from fg_gcs.console import swarm

            return swarm.run(chosen)
        case "trial":
            from fg_gcs.console import trial

            return trial.run(chosen)
        case "report":
            from fg_gcs.console.plan import report

            return report(chosen.log)
        case _:
            from sitl_mock.__main__ import run

            return run(chosen)


def _tables(option: str, texts: Sequence[str] | None) -> tuple[dict[str, object], ...]:
    """Return the JSON objects that an option was given.

    Raises:
        MissionError: a text is none.
    """
    from fg_gcs.errors import MissionError

    tables = []
    for number, text in enumerate(texts or (), start=1):
        try:
            table = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise MissionError(f"{option} {number}: not a JSON object: {error}") from error
        if not isinstance(table, dict):
            raise MissionError(f"{option} {number}: not a JSON object")
        tables.append(table)
    return tuple(tables)


def _fly(chosen: argparse.Namespace) -> int:
    """Fly missions one after the other, until one is not completed."""
    from fg_gcs.console.codes import ExitCode
    from fg_gcs.console.fly import Manner, fly
    from fg_gcs.run.flying import FlyOptions
    from fg_gcs.wire.timing import LEAST_PACE

    options = FlyOptions(
        connect=_connections(chosen),
        wait_s=chosen.wait,
        autopilot=chosen.autopilot,
        dynamics=chosen.dynamics,
        faults=_tables("--fault", chosen.fault),
        impairments=_tables("--impair", chosen.impair),
        logs=chosen.logs,
        signing_keys=tuple(chosen.signing_key or ()),
        signing_setup=chosen.signing_setup,
        forward=tuple(chosen.forward or ()),
        swarm=_swarm(chosen),
        spacing_m=chosen.spacing,
        least_pace=0.0 if chosen.slow_machine_ok else LEAST_PACE,
    )
    manner = Manner(chosen.speed, chosen.json)
    codes = (fly(path, options, manner) for path in chosen.missions)
    return next((code for code in codes if code is not ExitCode.DONE), ExitCode.DONE)


def _swarm(chosen: argparse.Namespace) -> SwarmOptions | None:
    """Return how instances are started for a flight; None: they are not.

    Raises:
        MissionError: an option is at fault.
    """
    from fg_gcs.console.swarm import options_of
    from fg_gcs.errors import MissionError

    if chosen.swarm is not None:
        return options_of(chosen, chosen.swarm)
    for option in swarm_options.given(chosen):
        raise MissionError(f"{option} is for --swarm px4 or --swarm ardupilot, which is not given")
    return None


def _jobs(text: str) -> int:
    if (value := count(text)) == 0:
        raise argparse.ArgumentTypeError("0: at least one job is needed")
    return value


def _speed(text: str) -> float:
    return float("inf") if text == "max" else positive(text)


if __name__ == "__main__":
    sys.exit(main())
