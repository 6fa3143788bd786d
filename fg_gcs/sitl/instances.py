"""What one instance of each autopilot's SITL needs to be started: the table `RECIPES`, and nothing that starts it.

PX4 derives its ports and its system id from the number of the instance, in its own start script (rcS, px4-rc.mavlink
of 1.17); ArduPilot is told them. Both are started as they are, by arguments and environment.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from fg_gcs.core.frames import Geodetic
from fg_gcs.errors import MissionError
from fg_gcs.link.endpoint import ARDUPILOT_PORT, ARDUPILOT_STEP, px4_endpoints
from fg_gcs.wire.autopilots import ARDUPILOT, PX4, AutopilotProfile
from fg_gcs.wire.timing import LEAST_PACE

GCS_PORT: Final = 14550  # where ground stations listen, by custom
MOST_INSTANCES: Final = 250  # system ids are 1 to 250; those above are of ground stations
PARAMETERS: Final = "extra.parm"  # in the working folder of an ArduPilot instance
RC_IN: Final = 5501 - ARDUPILOT_PORT  # ArduPilot's port for a remote control, by its base port
_ID_PARAMETERS: Final = frozenset({"MAV_SYS_ID", "MAV_SYSID", "SYSID_THISMAV"})
_NAME: Final = re.compile(r"[A-Z][A-Z0-9_]{0,15}")


class Layer(Enum):
    """What a port is of."""

    UDP = "UDP"
    TCP = "TCP"


class Port(NamedTuple):
    """A port that an instance binds."""

    layer: Layer
    number: int
    use: str  # in words for people


class Instance(NamedTuple):
    """One SITL process that is to be.

    Attributes:
        number: that its ports follow from, 0 and above.
        system_id: its MAVLink system id.
        home: where it stands at first.
    """

    number: int
    system_id: int
    home: Geodetic


@dataclass(frozen=True)
class SwarmOptions:
    """How instances are started, whatever their number.

    Attributes:
        autopilot: a key of `RECIPES`.
        binary: the SITL program.
        folder: each instance has a folder in here; None: the caller knows one.
        files: what the program needs beside itself, see `Recipe.files`; None: it is looked for beside the binary.
        model: of the vehicle, in the autopilot's words; None: a quadrotor.
        parameters: set in every instance, by name.
        keep_parameters: what instances have stored in their folders is kept; otherwise they start as if new.
        port: where ArduPilot sends to; PX4 has ports of its own.
        base_port: of ArduPilot's instance 0.
        heartbeat_s: how long an instance has for its first heartbeat [s].
        ready_s: how long it has until it can be armed [s].
        watch_s: how long clocks are watched once all can be armed; twice that, if one does not tell its time [s].
        least_pace: the slowest clock that is flown with, as a share of real time; 0: any.
    """

    autopilot: str
    binary: Path
    folder: Path | None = None
    files: Path | None = None
    model: str | None = None
    parameters: tuple[tuple[str, float], ...] = ()
    keep_parameters: bool = False
    port: int = GCS_PORT
    base_port: int = ARDUPILOT_PORT
    heartbeat_s: float = 30.0
    ready_s: float = 120.0
    watch_s: float = 7.0
    least_pace: float = LEAST_PACE

    @property
    def recipe(self) -> Recipe:
        """What an instance of this autopilot needs."""
        return RECIPES[self.autopilot]


class Start(NamedTuple):
    """How the process of an instance is started."""

    arguments: tuple[str, ...]
    environment: Mapping[str, str]  # beside our own
    texts: Mapping[str, str]  # files that must be in its folder, by name


@dataclass(frozen=True)
class Recipe:
    """What an instance of one autopilot's SITL needs.

    Attributes:
        profile: how it is talked to.
        program: the usual name of the binary.
        files: what it needs beside itself, for people, and the option that names it.
        beside: where that is, as seen from the binary.
        is_there: whether a path is that.
        stored: files in its working folder in which it stores parameters.
        start: how a process is started, of the options, the files and an instance.
        ports: which an instance binds.
        endpoints: where instances of these numbers are to be heard.
    """

    profile: AutopilotProfile
    program: str
    files: str
    beside: str
    is_there: Callable[[Path], bool]
    stored: tuple[str, ...]
    start: Callable[[SwarmOptions, Path, Instance], Start]
    ports: Callable[[SwarmOptions, int], tuple[Port, ...]]
    endpoints: Callable[[SwarmOptions, Sequence[int]], tuple[str, ...]]


def check_options(options: SwarmOptions) -> Path:
    """Refuse options that no instance can be started with; return the files that the program needs.

    Raises:
        MissionError: says which is at fault.
    """
    if options.autopilot not in RECIPES:
        raise MissionError(f"swarm {options.autopilot!r}; accepted: {' or '.join(RECIPES)}")
    recipe, binary = options.recipe, options.binary
    if not binary.exists():
        raise MissionError(f"--binary {binary}: there is no such file; it is the SITL program, {recipe.program}")
    if not binary.is_file() or not os.access(binary, os.X_OK):
        raise MissionError(f"--binary {binary}: not a program that can be run")
    for name, value in options.parameters:
        if not _NAME.fullmatch(name) or not math.isfinite(value):
            raise MissionError(f"--param {name}={value:g}: not a parameter and a number, as in {_AN_EXAMPLE}")
        if name in _ID_PARAMETERS:
            raise MissionError(f"--param {name}: all instances would have the same id; --first-id gives each its own")
    if options.recipe is _PX4 and (options.port, options.base_port) != (GCS_PORT, ARDUPILOT_PORT):
        raise MissionError("PX4's ports follow from the number of the instance: use --first-instance to move them")
    files = options.files or (binary.absolute().parent / recipe.beside)
    if not recipe.is_there(files):
        found = "is not" if options.files else "has not beside it"
        raise MissionError(f"{files if options.files else binary} {found} {recipe.files}")
    return Path(os.path.normpath(files.absolute()))


def numbered(numbers: Sequence[int], ids: Sequence[int], homes: Sequence[Geodetic], autopilot: str) -> list[Instance]:
    """Return instances of these numbers, ids and homes.

    Raises:
        MissionError: an id is none, occurs twice, or cannot be that of its instance.
    """
    for number, system_id in zip(numbers, ids, strict=True):
        if not (1 <= system_id <= MOST_INSTANCES and 0 <= number < MOST_INSTANCES):
            raise MissionError(
                f"instance {number} with system id {system_id}: ids are 1 to {MOST_INSTANCES}, instances 0 to "
                f"{MOST_INSTANCES - 1}; start fewer, or lower --first-id and --first-instance"
            )
        if RECIPES[autopilot] is _PX4 and system_id != number + 1:
            raise MissionError(
                f"instance {number} of PX4 always has the system id {number + 1}, not {system_id}: "
                "leave out --first-id or --first-instance"
            )
    twice = sorted({each for each in ids if list(ids).count(each) > 1})
    if twice:
        raise MissionError(f"two instances would have the system id {twice[0]}")
    return [Instance(*each) for each in zip(numbers, ids, homes, strict=True)]


def _degrees(value: float) -> str:
    return f"{value:.9f}"


def _start_px4(options: SwarmOptions, etc: Path, instance: Instance) -> Start:
    """PX4 reads homes and parameters from its environment; ``-d`` leaves its shell out."""
    environment = {
        "PX4_SIM_MODEL": options.model or "sihsim_quadx",
        "PX4_HOME_LAT": _degrees(instance.home.latitude_deg),
        "PX4_HOME_LON": _degrees(instance.home.longitude_deg),
        "PX4_HOME_ALT": f"{instance.home.altitude_m:.3f}",
    }
    environment |= {f"PX4_PARAM_{name}": f"{value:g}" for name, value in options.parameters}
    return Start((str(options.binary.absolute()), "-d", "-i", str(instance.number), str(etc)), environment, {})


def _start_ardupilot(options: SwarmOptions, defaults: Path, instance: Instance) -> Start:
    """ArduPilot is told all by arguments; of several files of defaults the last one counts."""
    home = instance.home
    base = options.base_port + ARDUPILOT_STEP * instance.number
    arguments = [str(options.binary.absolute()), "--model", options.model or "quad"]
    if not options.keep_parameters:
        arguments.append("-w")
    place = f"{_degrees(home.latitude_deg)},{_degrees(home.longitude_deg)},{home.altitude_m:.3f},0"
    arguments += ["--base-port", str(base), "--rc-in-port", str(base + RC_IN), f"-I{instance.number}"]
    arguments += ["--home", place, "--sysid", str(instance.system_id)]
    arguments += ["--serial0", f"udpclient:127.0.0.1:{options.port}"]
    if not options.parameters:
        return Start((*arguments, "--defaults", str(defaults)), {}, {})
    text = "".join(f"{name} {value:g}\n" for name, value in options.parameters)
    return Start((*arguments, "--defaults", f"{defaults},{PARAMETERS}"), {}, {PARAMETERS: text})


def _px4_ports(options: SwarmOptions, number: int) -> tuple[Port, ...]:
    return tuple(
        Port(Layer.UDP, first + number, use)
        for first, use in (
            (18570, "to ground stations"),
            (14580, "to onboard computers"),
            (14280, "to its camera"),
            (13030, "to its gimbal"),
        )
    )


def _ardupilot_ports(options: SwarmOptions, number: int) -> tuple[Port, ...]:
    base = options.base_port + ARDUPILOT_STEP * number
    serials = (Port(Layer.TCP, base + 2, "serial port 1"), Port(Layer.TCP, base + 3, "serial port 2"))
    return (*serials, Port(Layer.UDP, base + RC_IN, "remote control"))


def _px4_heard_at(options: SwarmOptions, numbers: Sequence[int]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(endpoint for number in numbers for endpoint in px4_endpoints(1, number)))


def _ardupilot_heard_at(options: SwarmOptions, numbers: Sequence[int]) -> tuple[str, ...]:
    return (f"udpin:127.0.0.1:{options.port}",)


_AN_EXAMPLE: Final = "--param MPC_XY_VEL_MAX=8"
_PX4: Final = Recipe(
    profile=PX4,
    program="px4",
    files="the folder etc with its start scripts, as a build has it; name it by --px4-etc",
    beside="../etc",
    is_there=lambda path: (path / "init.d-posix" / "rcS").is_file(),
    stored=("parameters.bson", "parameters_backup.bson", "dataman"),
    start=_start_px4,
    ports=_px4_ports,
    endpoints=_px4_heard_at,
)
_ARDUPILOT: Final = Recipe(
    profile=ARDUPILOT,
    program="arducopter",
    files="a file of default parameters, copter.parm in the sources; name it by --defaults",
    beside="../../../Tools/autotest/default_params/copter.parm",
    is_there=Path.is_file,
    stored=("eeprom.bin",),
    start=_start_ardupilot,
    ports=_ardupilot_ports,
    endpoints=_ardupilot_heard_at,
)
RECIPES: Final[Mapping[str, Recipe]] = MappingProxyType({"px4": _PX4, "ardupilot": _ARDUPILOT})
