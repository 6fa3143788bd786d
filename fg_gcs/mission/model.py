"""A mission as data. The description of every key says what is accepted and what it means; error lines quote it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Formation, Pose, facing, hemisphere, rolled
from fg_gcs.core.frames import Geodetic
from fg_gcs.core.separation import Fence
from fg_gcs.mission.tables import (
    Deviation,
    Finite,
    Ground,
    MissionTable,
    NetworkName,
    NetworkSystemId,
    NotNegative,
    Plannable,
    Point,
    Positive,
    SystemId,
    VehicleEndpoint,
)
from fg_gcs.mission.target_tables import FileTable, MovingTarget, TrackTable
from fg_gcs.plan.flight_plan import Task
from fg_gcs.plan.formulations import FormulationName
from fg_gcs.plan.limits import Limits, Rules
from fg_gcs.plan.lost_link import Remedy
from fg_gcs.plan.targets import Charges, Target, centre_of_charge, effective_radius_m, uncertain
from fg_gcs.track.following_core import TrackingSettings

SETPOINTS_HZ = 50.0  # unless a mission says otherwise
AUTO = 1.2  # times the smallest separation that the closest pair of a formation has which is as small as is safe
FAULT_SEPARATION_M = 0.5  # likewise; nearer than this quadrotors touch
DEFAULT_ORIGIN = Geodetic(47.397742, 8.545594, 488.0)  # where PX4's own simulators start, near Zurich


class SwarmTable(MissionTable):
    """The vehicles that fly."""

    vehicles: int = Field(ge=3, le=250, description="a whole number from 3 to 250, as many as the formation has slots")
    system_ids: list[SystemId | NetworkSystemId] | None = Field(
        default=None,
        description="different whole numbers from 1 to 250, one for each vehicle; with several networks the network's "
        'name before each, as in "west/7" (default: 1, 2, 3, ...)',
    )
    forward_commands: bool = Field(
        default=False,
        description="true or false, whether what programs say that --forward names reaches vehicles (default false)",
    )

    def members(self) -> tuple[tuple[str, int], ...]:
        """Return network and system id of every vehicle, ascending; the network is "" where none is named."""
        if not self.system_ids:
            return tuple(("", system_id) for system_id in range(1, self.vehicles + 1))
        parts = (str(each).rpartition("/") for each in self.system_ids)
        return tuple(sorted((network, int(system_id)) for network, _, system_id in parts))

    def ids(self) -> tuple[int, ...]:
        """Return the system id of every vehicle, in the order of `members`."""
        return tuple(system_id for _, system_id in self.members())


class FormationTable(MissionTable):
    """The swarm's shape and where it gathers."""

    shape: Literal["hemisphere", "custom"] = Field(description='"hemisphere" or "custom"')
    leaders: int | None = Field(
        default=None, ge=3, description="hemisphere: a whole number, 3 or more, of vehicles on the rim"
    )
    followers: int | None = Field(
        default=None,
        ge=0,
        description="hemisphere: 0, 1 (the pole), as many as leaders (a circle behind them), or one more (both)",
    )
    edge_m: Positive | Literal["auto"] | None = Field(
        default=None,
        description="hemisphere: a number above 0, the distance between neighbouring leaders in metres, or "
        '"auto" (as small as is safe)',
    )
    leaders_yz_m: list[Ground] | None = Field(
        default=None,
        description="custom: 3 or more points [y, z] in metres, the rim, counter-clockwise as seen from the target",
    )
    followers_xyz_m: list[Point] | None = Field(
        default=None, description="custom: points [x, y, z] in metres, with x <= 0 so that they lie behind the face"
    )
    centre_enu_m: Point = Field(
        description="[east, north, up] in metres, the centre of the face where the formation gathers"
    )
    normal_enu: Point = Field(
        description="[east, north, up] of any length above 0, the direction in which the face looks there"
    )
    roll_deg: float = Field(
        default=0.0,
        ge=-180.0,
        le=180.0,
        description="a number from -180 to 180, by how much the face is turned about that direction in degrees",
    )

    def start(self) -> Pose:
        """Return where the face is before the approach.

        Raises:
            ValueError: the normal has no direction.
        """
        return Pose(np.array(self.centre_enu_m), rolled(facing(np.array(self.normal_enu)), math.radians(self.roll_deg)))

    def formation(self, separation_m: float) -> Formation:
        """Build the template; of a hemisphere that is as small as is safe, for vehicles that do not wander.

        Args:
            separation_m: the smallest distance between two vehicles [m].

        Raises:
            ValueError: the keys do not describe a formation; the text says why.
        """
        if self.shape == "hemisphere":
            if self.leaders is None or self.followers is None or self.edge_m is None:
                raise ValueError("keys are missing; accepted: a hemisphere with leaders, followers and edge_m")
            if self.edge_m == "auto":
                smallest = hemisphere(self.leaders, self.followers, 1.0)
                return hemisphere(self.leaders, self.followers, AUTO * separation_m / smallest.smallest_separation_m)
            return hemisphere(self.leaders, self.followers, self.edge_m)
        if self.leaders_yz_m is None:
            raise ValueError("a key is missing; accepted: a custom shape with leaders_yz_m")
        rim = np.array([(0.0, y, z) for y, z in self.leaders_yz_m]).reshape(-1, 3)
        return Formation(rim, np.array(self.followers_xyz_m or [], dtype=float).reshape(-1, 3))


class TargetTable(MissionTable):
    """A target at rest: one point or several, their extent, and how exactly they are known."""

    position_enu_m: Point | None = Field(
        default=None,
        description="[east, north, up] in metres, inside the fence; or positions_enu_m instead",
    )
    positions_enu_m: list[Point] | None = Field(
        default=None,
        min_length=1,
        max_length=1000,
        description="1 to 1000 points [east, north, up] in metres, inside the fence",
    )
    weights: list[Positive] | None = Field(
        default=None, description="numbers above 0, one for each of positions_enu_m (default: all equal)"
    )
    source: Literal["centre", "charges"] = Field(
        default="centre",
        description='"centre" (one source at their mean) or "charges" (one at each point; default "centre")',
    )
    radius_m: NotNegative = Field(
        default=0.0,
        description="a number, 0 or more, the radius of the target in metres (default 0: a point)",
    )
    sigma_m: Deviation | tuple[Deviation, Deviation, Deviation] | None = Field(
        default=None,
        description="0 to 1e6, a number or [east, north, up], standard deviation in metres (default: known exactly)",
    )
    confidence: float = Field(
        default=0.95,
        gt=0,
        lt=1,
        description="between 0 and 1, the probability with which the face covers the target (default 0.95)",
    )

    def target(self) -> Target:
        """Return the target to plan for. Three radii add up: that of the points, of their extent, of the uncertainty.

        Raises:
            PlanError: numbers so large or so different that they have no centre or radius.
        """
        target = self._exact().wider(self.radius_m)
        if self.sigma_m is None:
            return target
        variances = np.broadcast_to(np.square(self.sigma_m), 3)
        return target.wider(uncertain(target.centre_enu_m, np.diag(variances), self.confidence).radius_m)

    def _exact(self) -> Target:
        """Return the target as if its points had no extent and were known exactly."""
        if self.positions_enu_m is None:
            assert self.position_enu_m is not None, "the loader refuses targets without a position"
            return Target.ball(self.position_enu_m)
        weights = np.ones(len(self.positions_enu_m)) if self.weights is None else np.array(self.weights)
        weights = weights / weights.max()  # only ratios matter, and the sum of large ones would overflow
        if self.source == "centre":
            return centre_of_charge(self.positions_enu_m, weights)
        charges = Charges(np.array(self.positions_enu_m), weights)
        return Target(charges, effective_radius_m(charges))


class HoldTable(MissionTable):
    """How long the formation stays around the target, and how deep inside it the target lies."""

    duration_s: NotNegative = Field(default=5.0, description="a number of seconds, 0 or more (default 5)")
    depth_m: NotNegative = Field(
        default=0.25,
        description="a number of metres, 0 or more, how far behind the face the target lies (default 0.25)",
    )


class PlanTable(MissionTable):
    """How the path is searched for."""

    formulation: FormulationName = Field(
        default="rigid",
        description='"rigid" (the formation is one body) or "free" (each leader moves by itself; default "rigid")',
    )


class LimitsTable(MissionTable):
    """Limits that no vehicle exceeds; where a vehicle's own limit is lower, that one holds."""

    speed_m_s: Plannable = Field(description="a number from 1e-6 to 1e6, the largest norm of a vehicle's velocity")
    acceleration_m_s2: Plannable = Field(
        description="a number from 1e-6 to 1e6, the largest norm of a vehicle's acceleration"
    )
    climb_m_s: Plannable | None = Field(
        default=None, description="a number from 1e-6 to 1e6 (default: speed_m_s alone holds)"
    )
    descent_m_s: Plannable | None = Field(
        default=None, description="a number from 1e-6 to 1e6 (default: speed_m_s alone holds)"
    )
    jerk_m_s3: Plannable | None = Field(default=None, description="a number from 1e-6 to 1e6 (default: no limit)")
    vehicle_jerk_m_s3: float | None = Field(
        default=None,
        ge=1.0,
        le=100.0,
        description="1 to 100, the jerk limit that vehicles get for the flight which shape setpoints by one of their "
        "own (default: each keeps its own)",
    )
    separation_m: Plannable = Field(
        description="a number from 1e-6 to 1e6, the smallest distance between two vehicles in metres"
    )
    fault_separation_m: Plannable | None = Field(
        default=None,
        description="a number from 1e-6 to separation_m, the smallest distance in metres to a vehicle that stops "
        "hearing us (default 0.5, or separation_m if that is less)",
    )
    fault_remedy: Remedy = Field(
        default="slow",
        description='"slow", "widen" or "refuse": what is done where vehicles would come nearer than that '
        '(default "slow")',
    )
    wander_m: NotNegative | None = Field(
        default=None,
        description="a number of metres, 0 or more, how far vehicles hover off their places, rms, as seen from above "
        "(default: as they do on the ground before a flight tells)",
    )

    @property
    def fault_least_m(self) -> float:
        """The smallest distance to a vehicle that stops hearing us [m]."""
        found = self.fault_separation_m
        return min(FAULT_SEPARATION_M, self.separation_m) if found is None else found


class FaultsTable(MissionTable):
    """From when on something is a fault in flight; what follows is in docs/failures.md."""

    silent_s: float = Field(
        default=0.5,
        ge=0.3,
        le=2.0,
        description="0.3 to 2 seconds without a message or a position of a vehicle, from when on the others wait for "
        "it (default 0.5)",
    )
    off_course_m: float = Field(
        default=1.5,
        ge=0.5,
        le=10.0,
        description="0.5 to 10 metres that a vehicle may be from where it is told to be, beside what its speed "
        "explains (default 1.5)",
    )
    battery_low: float = Field(
        default=0.15,
        ge=0.0,
        le=0.5,
        description="0 to 0.5, the share of its charge below which a vehicle sends everybody home (default 0.15; "
        "0: none)",
    )
    taken_wait_s: float = Field(
        default=60.0,
        ge=0.0,
        le=600.0,
        description="0 to 600 seconds that a vehicle which somebody else has may stay in the air after all others are "
        "down, before it is landed (default 60)",
    )


class FenceTable(MissionTable):
    """The box that no vehicle leaves while it follows a plan."""

    low_enu_m: Point = Field(description="[west, south, floor] in metres, one corner of the fence")
    high_enu_m: Point = Field(
        description="[east, north, ceiling] in metres, the opposite corner, each number above that of low_enu_m"
    )

    def box(self) -> Fence:
        """Return the fence as the planner takes it."""
        return Fence(self.low_enu_m, self.high_enu_m)


class TakeoffTable(MissionTable):
    """The climb from the pads, before the swarm gathers."""

    height_m: Positive = Field(
        default=4.0, description="a number of metres above 0, not below the floor of the fence (default 4)"
    )


class PadsTable(MissionTable):
    """Where simulated vehicles stand; real vehicles are found where they stand."""

    first_enu_m: Ground = Field(
        default=(0.0, 0.0), description="[east, north] in metres, the pad of the first vehicle (default [0, 0])"
    )
    spacing_m: Plannable = Field(
        default=3.0, description="a number of metres above the separation, between neighbouring pads (default 3)"
    )


class OriginTable(MissionTable):
    """Where on Earth the mission's (0, 0, 0) is."""

    latitude_deg: float = Field(ge=-89, le=89, description="a number of degrees from -89 to 89")
    longitude_deg: float = Field(ge=-180, le=180, description="a number of degrees from -180 to 180")
    altitude_m: Finite = Field(description="a number of metres above sea level")


class StreamTable(MissionTable):
    """How setpoints are sent."""

    rate_hz: Finite = Field(
        default=SETPOINTS_HZ,
        ge=20,
        le=200,
        description="a number from 20 to 200, setpoints a second to each vehicle (default 50)",
    )
    compensation: bool = Field(
        default=True,
        description="true or false: whether setpoints are sent ahead of what vehicles were seen to lag (default true)",
    )


class SimulatorTable(MissionTable):
    """The built-in simulator; it has no effect with --connect."""

    autopilot: Literal["px4", "ardupilot"] = Field(default="px4", description='"px4" or "ardupilot" (default "px4")')
    seed: int = Field(default=0, ge=0, description="a whole number, 0 or more (default 0)")
    wind_m_s: NotNegative = Field(
        default=0.0, description="a number of metres a second, 0 or more, the mean wind (default 0)"
    )
    dynamics: Literal["paper", "measured"] = Field(
        default="paper", description='"paper" or "measured": as the real autopilots fly (default "paper")'
    )
    noise_m: float | None = Field(
        default=None,
        ge=0.0,
        le=10.0,
        description='0 to 10 metres that vehicles hover off their places with dynamics "measured", rms, as seen from '
        "above (default: as measured)",
    )
    collisions: bool = Field(default=True, description="true or false (default true)")
    strict_commands: bool = Field(default=False, description="true or false (default false)")
    new_partner: bool = Field(default=False, description="true or false (default false)")
    parameter_freeze: bool = Field(default=False, description="true or false (default false)")
    faults: list[dict[str, Any]] = Field(default=[], description="tables [[simulator.faults]], see missions/README.md")
    impairments: list[dict[str, Any]] = Field(
        default=[], description="tables [[simulator.impairments]], see missions/README.md"
    )


class Mission(MissionTable):
    """A whole mission file."""

    description: str = Field(default="", description="a line of text")
    swarm: SwarmTable = Field(description="a table")
    networks: dict[NetworkName, list[VehicleEndpoint]] | None = Field(
        default=None,
        description='a table of name = ["ENDPOINT", ...]; names of 1 to 16 of a-z, 0-9, - and _, endpoints '
        "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or serial:DEVICE:BAUD",
    )
    formation: FormationTable = Field(description="a table")
    target: TargetTable | None = Field(default=None, description="a table")
    targets: list[MovingTarget] | None = Field(
        default=None, min_length=1, max_length=20, description="1 to 20 tables [[targets]]"
    )
    track: TrackTable = Field(default=TrackTable(), description="a table")
    hold: HoldTable = Field(default=HoldTable(), description="a table")
    plan: PlanTable = Field(default=PlanTable(), description="a table")
    limits: LimitsTable = Field(description="a table")
    faults: FaultsTable = Field(default=FaultsTable(), description="a table")
    fence: FenceTable = Field(description="a table")
    takeoff: TakeoffTable = Field(default=TakeoffTable(), description="a table")
    pads: PadsTable = Field(default=PadsTable(), description="a table")
    origin: OriginTable | None = Field(default=None, description="a table")
    stream: StreamTable = Field(default=StreamTable(), description="a table")
    simulator: SimulatorTable = Field(default=SimulatorTable(), description="a table")

    _file: tuple[Path, str] = PrivateAttr(default=(Path("mission"), ""))

    def read_from(self, path: Path, text: str) -> Self:
        """Return it with the file that it was read from and that file's text."""
        made = self.model_copy()
        made._file = (path, text)  # noqa: SLF001 # its own
        return made

    @property
    def path(self) -> Path:
        """The file that it was read from."""
        return self._file[0]

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self._file[0].stem

    @property
    def text(self) -> str:
        """The file's text."""
        return self._file[1]

    def connections(self) -> tuple[str, ...]:
        """Return where vehicles are found, each as ``NAME=ENDPOINT``; none: the built-in simulator flies."""
        networks = self.networks or {}
        return tuple(f"{name}={endpoint}" for name, endpoints in networks.items() for endpoint in endpoints)

    def task(self) -> Task:
        """Return the planning task of the mission, under its own limits alone.

        Moving targets stand where they are at first.

        Raises:
            PlanError: the target's numbers are absurd; the loader refuses those.
            MissionError: a target's file could not be read, or something in it is wrong.
        """
        limits = self.limits
        return Task(
            formation=self.formation.formation(limits.separation_m),
            start=self.formation.start(),
            target=self.first_target(),
            hold_depth_m=self.hold.depth_m,
            rules=Rules(
                Limits(
                    limits.speed_m_s,
                    limits.acceleration_m_s2,
                    np.inf if limits.climb_m_s is None else limits.climb_m_s,
                    np.inf if limits.descent_m_s is None else limits.descent_m_s,
                    np.inf if limits.jerk_m_s3 is None else limits.jerk_m_s3,
                ),
                limits.separation_m,
                self.fence.box(),
            ),
            formulation=self.plan.formulation,
            widens=self.formation.edge_m == "auto",
        )

    def first_target(self) -> Target:
        """Return the target to plan for; moving targets stand where they are at first.

        Several of them count as one around their centre of charge. Its radius is that of all of them, at most that of
        ``[track] most_radius_m``.

        Raises:
            PlanError: the target's numbers are absurd; the loader refuses those.
            MissionError: a target's file could not be read, or something in it is wrong.
        """
        if self.targets is None:
            assert self.target is not None, "the loader refuses missions without a target"
            return self.target.target()
        places = [target.first_enu_m() for target in self.targets]
        if len(places) == 1:
            return Target.ball(places[0])
        group = centre_of_charge(places, [target.weight for target in self.targets])
        return Target.ball(group.centre_enu_m, min(group.radius_m, self.track.most_radius_m))

    def tracking(self) -> TrackingSettings:
        """Return how the moving targets are followed."""
        return self.track.settings({target.name: target.weight for target in self.targets or ()})

    def files(self) -> dict[str, bytes]:
        """Return what is in the files that it names, by the paths as it has them."""
        tables = [table for target in self.targets or () for table in (target.motion, target.source)]
        return {table.path: table.file.data for table in tables if isinstance(table, FileTable)}

    def pads_enu_m(self) -> Array:
        """Return the pads of simulated vehicles: a square grid, shape (V, 2) [m]."""
        pads: Array = square_grid(self.swarm.vehicles, self.pads.spacing_m) + np.array(self.pads.first_enu_m)
        return pads

    def tops_enu_m(self) -> Array:
        """Return the places above the simulated pads after take-off, shape (V, 3) [m; ENU]."""
        pads = self.pads_enu_m()
        return np.column_stack((pads, np.full(len(pads), self.takeoff.height_m)))

    def origin_geodetic(self) -> Geodetic:
        """Return where the mission's origin is; without a table, where PX4's simulators start."""
        if self.origin is None:
            return DEFAULT_ORIGIN
        return Geodetic(self.origin.latitude_deg, self.origin.longitude_deg, self.origin.altitude_m)


def square_grid(count: int, spacing_m: float) -> Array:
    """Return places on a square grid, row by row northwards from (0, 0), shape (V, 2) [m; east, north]."""
    columns = int(np.ceil(np.sqrt(count)))
    index = np.arange(count)
    grid: Array = np.column_stack((index % columns, index // columns)).astype(float)
    return grid * spacing_m
