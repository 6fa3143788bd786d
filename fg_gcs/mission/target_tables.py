"""Tables of a mission with moving targets: how each moves, where its sightings come from, and how it is tracked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PrivateAttr

from fg_gcs.core.arrays import Array
from fg_gcs.errors import MissionError
from fg_gcs.mission.position_files import FILES, PositionFile
from fg_gcs.mission.tables import (
    Deviation,
    FilePath,
    Finite,
    Length,
    MissionTable,
    NotNegative,
    Point,
    Positive,
    Rate,
    Seed,
    Share,
    SystemId,
)
from fg_gcs.scenario import motions, random_walk, recorded, waypoints
from fg_gcs.scenario.motions import TrueMotion
from fg_gcs.scenario.sensor import SensorSettings
from fg_gcs.track.estimate.estimator import Settings
from fg_gcs.track.following_core import TrackingSettings
from fg_gcs.track.sightings import Sighting

Udp = Annotated[str, Field(pattern=r"^udpin:(?:[^:\s]+:)?\d{1,5}$")]


class StaticMotion(MissionTable):
    """A target at rest."""

    kind: Literal["static"] = Field(description='"static"')
    position_enu_m: Point = Field(description="[east, north, up] in metres")

    def motion(self, target: str) -> TrueMotion:
        """Return the motion of the target of that name."""
        return motions.Static(self.position_enu_m)


class WaypointsMotion(MissionTable):
    """From point to point along straight legs."""

    kind: Literal["waypoints"] = Field(description='"waypoints"')
    points_enu_m: list[Point] = Field(
        min_length=2, max_length=1000, description="2 to 1000 points [east, north, up] in metres"
    )
    speed_m_s: Rate = Field(description="a number above 0, at most 1e4, the speed between corners")
    acceleration_m_s2: Rate = Field(
        default=1.0, description="a number above 0, at most 1e4, at the start, in corners and at the end (default 1)"
    )
    closed: bool = Field(
        default=False, description="true (round and round) or false (at rest at both ends; default false)"
    )

    def motion(self, target: str) -> TrueMotion:
        """Return the motion of the target of that name.

        Raises:
            ValueError: points that cannot be passed like that; says what would be accepted.
        """
        return waypoints.Waypoints(self.points_enu_m, self.speed_m_s, self.acceleration_m_s2, self.closed)


class CircleMotion(MissionTable):
    """Round a level circle without end."""

    kind: Literal["circle"] = Field(description='"circle"')
    centre_enu_m: Point = Field(description="[east, north, up] in metres")
    radius_m: Length = Field(description="a number of metres from 0.1 to 1e6")
    speed_m_s: Rate = Field(description="a number above 0, at most 1e4")
    phase_deg: Finite = Field(
        default=0.0, description="a number of degrees, where it is at first, counter-clockwise from east (default 0)"
    )
    clockwise: bool = Field(
        default=False, description="true or false, the sense of rotation as seen from above (default false)"
    )

    def motion(self, target: str) -> TrueMotion:
        """Return the motion of the target of that name."""
        return motions.Circle(self.centre_enu_m, self.radius_m, self.speed_m_s, self.phase_deg, self.clockwise)


class FigureEightMotion(MissionTable):
    """Along a level figure of eight without end."""

    kind: Literal["figure_eight"] = Field(description='"figure_eight"')
    centre_enu_m: Point = Field(description="[east, north, up] in metres, the crossing")
    length_m: Length = Field(description="a number of metres from 0.1 to 1e6, from end to end; it is half as wide")
    top_speed_m_s: Rate = Field(description="a number above 0, at most 1e4, the speed in the crossing")
    heading_deg: Finite = Field(
        default=90.0,
        description="a number of degrees, the direction of its length, clockwise from north (default 90, east)",
    )

    def motion(self, target: str) -> TrueMotion:
        """Return the motion of the target of that name."""
        return motions.FigureEight(self.centre_enu_m, self.length_m, self.top_speed_m_s, self.heading_deg)


class RandomWalkMotion(MissionTable):
    """At random inside a box."""

    kind: Literal["random_walk"] = Field(description='"random_walk"')
    low_enu_m: Point = Field(description="[west, south, low] in metres, one corner of its box")
    high_enu_m: Point = Field(description="[east, north, high] in metres, the opposite corner")
    start_enu_m: Point | None = Field(
        default=None,
        description="[east, north, up] in metres inside the box, where it starts at rest (default: the middle)",
    )
    speed_m_s: Rate = Field(description="a number above 0, at most 1e4, its largest speed")
    acceleration_m_s2: Rate = Field(
        default=1.0, description="a number above 0, at most 1e4, its largest acceleration (default 1)"
    )
    seed: Seed = Field(default=0, description="a whole number, 0 or more (default 0)")

    def motion(self, target: str) -> TrueMotion:
        """Return the motion of the target of that name.

        Raises:
            ValueError: the corners do not span a box, or the start lies outside it.
        """
        return random_walk.RandomWalk(
            self.low_enu_m, self.high_enu_m, self.speed_m_s, self.acceleration_m_s2, self.seed, self.start_enu_m
        )


class FileTable(MissionTable):
    """A table that names a file, which whoever loads the mission hands in."""

    path: FilePath = Field(
        description="the name of a CSV file, relative to the mission's folder, see missions/README.md"
    )
    _file: PositionFile | None = PrivateAttr(default=None)

    def model_post_init(self, context: Any) -> None:  # noqa: ANN401 - pydantic's own signature
        """Take the file out of the validation's context."""
        self._file = (context or {}).get(FILES, {}).get(self.path)

    @property
    def file(self) -> PositionFile:
        """What is in the file.

        Raises:
            MissionError: the mission was not loaded from anywhere, so the file was not read.
        """
        if self._file is None:
            raise MissionError(f"{self.path}: has not been read")
        return self._file


class FileMotion(FileTable):
    """Through the positions of a file."""

    kind: Literal["file"] = Field(description='"file"')

    def motion(self, target: str) -> TrueMotion:
        """Return the motion of the target of that name.

        Raises:
            MissionError: the file could not be read, or something in it is wrong.
            ValueError: its times do not ascend.
        """
        rows = self.file.rows(target, 0.0)
        times_s = np.array([row.time_s for row in rows])
        return recorded.Recorded(times_s, np.array([row.position_enu_m for row in rows]))


Motion = StaticMotion | WaypointsMotion | CircleMotion | FigureEightMotion | RandomWalkMotion | FileMotion


class ScriptSource(MissionTable):
    """The motion of the mission file, seen by the sensor."""

    kind: Literal["script"] = Field(description='"script"')


class CsvSource(FileTable):
    """Sightings of a file, replayed from the start of tracking."""

    kind: Literal["csv"] = Field(description='"csv"')


class UdpSource(MissionTable):
    """Sightings in datagrams."""

    kind: Literal["udp"] = Field(description='"udp"')
    endpoint: Udp = Field(description='"udpin:HOST:PORT", with a port that no other source uses')


class VehicleSource(MissionTable):
    """A MAVLink vehicle that reports its own position."""

    kind: Literal["vehicle"] = Field(description='"vehicle"')
    system_id: SystemId = Field(description="a whole number from 1 to 250 that no other vehicle uses")
    message: Literal["GLOBAL_POSITION_INT", "FOLLOW_TARGET"] = Field(
        default="GLOBAL_POSITION_INT",
        description='"GLOBAL_POSITION_INT" or "FOLLOW_TARGET" (default "GLOBAL_POSITION_INT")',
    )
    simulated: bool = Field(
        default=False,
        description="true (a simulated vehicle flies the motion) or false (a real one is awaited; default false)",
    )
    endpoint: Udp | None = Field(
        default=None,
        description='"udpin:HOST:PORT" where a real vehicle is heard (vehicles may share it), not if simulated',
    )


Source = ScriptSource | CsvSource | UdpSource | VehicleSource


class SensorTable(MissionTable):
    """How often and how exactly a target is seen."""

    rate_hz: Annotated[float, Field(gt=0, le=100)] = Field(
        default=10.0, description="a number above 0, at most 100, of measurements a second (default 10)"
    )
    sigma_m: Deviation = Field(
        default=0.5,
        description="a number of metres from 0 to 1e6, the deviation along each axis (default 0.5)",
    )
    delay_s: Annotated[float, Field(ge=0, le=60)] = Field(
        default=0.1, description="a number of seconds from 0 to 60, from measurement to arrival (default 0.1)"
    )
    jitter_s: Annotated[float, Field(ge=0, le=10)] = Field(
        default=0.0, description="a number of seconds from 0 to 10, how early or late a measurement may be (default 0)"
    )
    drop: Share = Field(
        default=0.0, description="a number from 0 to 1, the share of sightings that are lost (default 0)"
    )
    outliers: Share = Field(
        default=0.0, description="a number from 0 to 1, the share of sightings that are outliers (default 0)"
    )
    outlier_m: NotNegative = Field(
        default=20.0, description="a number of metres, 0 or more, how far off outliers are (default 20)"
    )
    silence: list[tuple[NotNegative, NotNegative]] = Field(
        default=[],
        max_length=100,
        description="up to 100 spans [from, to] in seconds of tracking without sightings (default [])",
    )
    seed: Seed = Field(default=0, description="a whole number, 0 or more (default 0)")

    def settings(self) -> SensorSettings:
        """Return the settings as the sensor takes them."""
        return SensorSettings(
            self.rate_hz,
            self.sigma_m,
            self.delay_s,
            self.jitter_s,
            self.drop,
            self.outliers,
            self.outlier_m,
            tuple(self.silence),
        )


class MovingTarget(MissionTable):
    """One moving target."""

    name: str = Field(
        pattern=r"^[a-z0-9_]{1,32}$", description="1 to 32 of the characters a-z, 0-9 and _, different for every target"
    )
    position_enu_m: Point | None = Field(
        default=None,
        description="[east, north, up] in metres, where it is at first (default: where its motion or file begins)",
    )
    weight: Positive = Field(default=1.0, description="a number above 0, its weight among the targets (default 1)")
    motion: Annotated[Motion, Field(discriminator="kind")] | None = Field(default=None, description="a table")
    source: Annotated[Source, Field(discriminator="kind")] = Field(
        default=ScriptSource(kind="script"), description="a table"
    )
    sensor: SensorTable = Field(default=SensorTable(), description="a table")

    @property
    def simulated(self) -> bool:
        """Whether a simulated vehicle flies its motion."""
        return isinstance(self.source, VehicleSource) and self.source.simulated

    def true_motion(self) -> TrueMotion | None:
        """Return how it moves; None for a target whose motion is not part of the mission.

        Raises:
            MissionError: its file could not be read, or something in it is wrong.
            ValueError: its keys contradict each other; the loader refuses those.
        """
        return None if self.motion is None else self.motion.motion(self.name)

    def replay(self) -> list[Sighting]:
        """Return the sightings of a source of kind ``csv``, in the order of their stamps; none for other kinds.

        Raises:
            MissionError: the file could not be read, or something in it is wrong.
        """
        if not isinstance(self.source, CsvSource):
            return []
        rows = self.source.file.rows(self.name, self.sensor.sigma_m)
        return sorted(rows, key=lambda row: row.time_s)

    def first_enu_m(self) -> Array:
        """Return where it is at first, shape (3,) [m; ENU].

        Raises:
            MissionError: its file could not be read, or something in it is wrong.
            ValueError: nothing says so; the loader refuses that.
        """
        if self.position_enu_m is not None:
            return np.array(self.position_enu_m)
        motion = self.true_motion()
        if motion is not None:
            first: Array = motion.at(np.zeros(1))[0][0]
            return first
        rows = self.replay()
        if not rows:
            raise ValueError("missing; accepted: a position_enu_m where neither a motion nor a file gives one")
        return rows[0].position_enu_m


class TrackTable(MissionTable):
    """How moving targets are tracked."""

    model: Literal["mixed", "velocity", "acceleration"] = Field(
        default="mixed",
        description=(
            '"velocity" (constant but for noise), "acceleration" (one that comes and fades) or "mixed" (that or a '
            'steady turn, as the sightings show; default "mixed")'
        ),
    )
    lost_after_s: Positive = Field(
        default=1.0, description="a number of seconds above 0 without a sighting until a target is lost (default 1)"
    )
    give_up_s: Positive = Field(
        default=60.0,
        description="a number of seconds above 0 without a capture or sighting until the swarm goes home (default 60)",
    )
    on_lost: Literal["hold", "home"] = Field(
        default="hold", description='"hold" (wait for it, up to give_up_s) or "home" (go home at once; default "hold")'
    )
    capture_m: Positive = Field(
        default=1.5,
        description="a number of metres above 0 from its place in the formation, within it is caught (default 1.5)",
    )
    confidence: float = Field(
        default=0.95,
        gt=0,
        lt=1,
        description="between 0 and 1, the probability with which the face covers the targets (default 0.95)",
    )
    most_radius_m: Positive = Field(
        default=12.0,
        description="a number of metres above 0, the largest radius that the face grows to cover (default 12)",
    )

    def settings(self, weights: Mapping[str, float]) -> TrackingSettings:
        """Return what following needs to know, with the weight of every target by its name."""
        estimator = Settings(model=self.model, lost_after_s=self.lost_after_s)
        return TrackingSettings(weights, estimator, self.capture_m, self.confidence, self.most_radius_m)
