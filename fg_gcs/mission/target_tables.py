"""Tables of a mission with moving targets: how each moves, who senses it, how well, and how it is tracked."""

from __future__ import annotations

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
from fg_gcs.track.sightings import Sighting

Udp = Annotated[str, Field(pattern=r"^udpin:(?:[^:\s]+:)?\d{1,5}$")]


class StaticMotion(MissionTable):
    """It stays."""

    kind: Literal["static"] = Field(description='"static"')
    position_enu_m: Point = Field(description="[east, north, up] in metres")

    def motion(self, target: str) -> TrueMotion:
        """Return the motion of the target of that name."""
        return motions.Static(self.position_enu_m)


class WaypointsMotion(MissionTable):
    """From point to point."""

    kind: Literal["waypoints"] = Field(description='"waypoints"')
    points_enu_m: list[Point] = Field(
        min_length=2, max_length=1000, description="2 to 1000 points [east, north, up] in metres"
    )
    speed_m_s: Rate = Field(description="speed between the corners, above 0, at most 1e4")
    acceleration_m_s2: Rate = Field(
        default=1.0, description="at the start, in the corners and at the end: above 0, at most 1e4 (default 1)"
    )
    closed: bool = Field(default=False, description="true (round and round) or false (rest at both ends; default)")

    def motion(self, target: str) -> TrueMotion:
        """Return the motion of the target of that name.

        Raises:
            ValueError: points that cannot be passed like that; says what would be accepted.
        """
        return waypoints.Waypoints(self.points_enu_m, self.speed_m_s, self.acceleration_m_s2, self.closed)


class CircleMotion(MissionTable):
    """Round and round."""

    kind: Literal["circle"] = Field(description='"circle"')
    centre_enu_m: Point = Field(description="[east, north, up] in metres")
    radius_m: Length = Field(description="0.1 to 1e6")
    speed_m_s: Rate = Field(description="above 0, at most 1e4")
    phase_deg: Finite = Field(
        default=0.0, description="where it is at first, counter-clockwise from east: degrees (default 0)"
    )
    clockwise: bool = Field(default=False, description="true or false, as seen from above (default false)")

    def motion(self, target: str) -> TrueMotion:
        """Return the motion of the target of that name."""
        return motions.Circle(self.centre_enu_m, self.radius_m, self.speed_m_s, self.phase_deg, self.clockwise)


class FigureEightMotion(MissionTable):
    """A lying eight."""

    kind: Literal["figure_eight"] = Field(description='"figure_eight"')
    centre_enu_m: Point = Field(description="[east, north, up] of the crossing in metres")
    length_m: Length = Field(description="from end to end, 0.1 to 1e6; it is half as wide")
    top_speed_m_s: Rate = Field(description="in the crossing, above 0, at most 1e4")
    heading_deg: Finite = Field(
        default=90.0, description="of its length, clockwise from north: degrees (default 90, eastwards)"
    )

    def motion(self, target: str) -> TrueMotion:
        """Return the motion of the target of that name."""
        return motions.FigureEight(self.centre_enu_m, self.length_m, self.top_speed_m_s, self.heading_deg)


class RandomWalkMotion(MissionTable):
    """Dodging at random inside a box."""

    kind: Literal["random_walk"] = Field(description='"random_walk"')
    low_enu_m: Point = Field(description="[west, south, low] corner of its box in metres")
    high_enu_m: Point = Field(description="[east, north, high] corner of its box in metres")
    start_enu_m: Point | None = Field(
        default=None, description="[east, north, up] inside the box (default: its middle)"
    )
    speed_m_s: Rate = Field(description="norm of its velocity at most, above 0, at most 1e4")
    acceleration_m_s2: Rate = Field(
        default=1.0, description="norm of its acceleration at most, above 0, at most 1e4 (default 1)"
    )
    seed: Seed = Field(default=0, description="a whole number, 0 or more (default 0)")

    def motion(self, target: str) -> TrueMotion:
        """Return the motion of the target of that name.

        Raises:
            ValueError: the corners are no box, or the start is outside.
        """
        return random_walk.RandomWalk(
            self.low_enu_m, self.high_enu_m, self.speed_m_s, self.acceleration_m_s2, self.seed, self.start_enu_m
        )


class FileTable(MissionTable):
    """A table that names a file, which whoever loads the mission hands in."""

    path: FilePath = Field(description="a CSV file, from the mission's folder, see missions/README.md")
    _file: PositionFile | None = PrivateAttr(default=None)

    def model_post_init(self, context: Any) -> None:  # noqa: ANN401 - pydantic's own signature
        """Take the file out of the validation's context."""
        self._file = (context or {}).get(FILES, {}).get(self.path)

    @property
    def file(self) -> PositionFile:
        """What is in the file.

        Raises:
            MissionError: the mission was not loaded from anywhere, so nobody has read it.
        """
        if self._file is None:
            raise MissionError(f"{self.path}: has not been read")
        return self._file


class FileMotion(FileTable):
    """As a file says."""

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
    """The motion itself, seen through the sensor."""

    kind: Literal["script"] = Field(description='"script"')


class CsvSource(FileTable):
    """Sightings from a file, replayed from when tracking begins."""

    kind: Literal["csv"] = Field(description='"csv"')


class UdpSource(MissionTable):
    """Sightings in datagrams."""

    kind: Literal["udp"] = Field(description='"udp"')
    endpoint: Udp = Field(description='"udpin:HOST:PORT", a port that no other source uses')


class VehicleSource(MissionTable):
    """A MAVLink vehicle that tells where it is."""

    kind: Literal["vehicle"] = Field(description='"vehicle"')
    system_id: SystemId = Field(description="a whole number from 1 to 250 that no other vehicle has")
    message: Literal["GLOBAL_POSITION_INT", "FOLLOW_TARGET"] = Field(
        default="GLOBAL_POSITION_INT",
        description='"GLOBAL_POSITION_INT" or "FOLLOW_TARGET" (default "GLOBAL_POSITION_INT")',
    )
    simulated: bool = Field(
        default=False, description="true (a simulated vehicle flies the motion) or false (a real one comes; default)"
    )
    endpoint: Udp | None = Field(
        default=None,
        description='"udpin:HOST:PORT" of a real vehicle, which vehicles may share; none if simulated',
    )


Source = ScriptSource | CsvSource | UdpSource | VehicleSource


class SensorTable(MissionTable):
    """How well a target is seen."""

    rate_hz: Annotated[float, Field(gt=0, le=100)] = Field(
        default=10.0, description="a number above 0, at most 100 (default 10)"
    )
    sigma_m: Deviation = Field(default=0.5, description="standard deviation along each axis, 0 to 1e6 (default 0.5)")
    delay_s: Annotated[float, Field(ge=0, le=60)] = Field(default=0.1, description="0 to 60 (default 0.1)")
    jitter_s: Annotated[float, Field(ge=0, le=10)] = Field(
        default=0.0, description="looks are this much early or late at most, 0 to 10 (default 0)"
    )
    drop: Share = Field(default=0.0, description="share of the sightings that are lost, 0 to 1 (default 0)")
    outliers: Share = Field(default=0.0, description="share of the sightings that are wild, 0 to 1 (default 0)")
    outlier_m: NotNegative = Field(default=20.0, description="how far off those are, 0 or more (default 20)")
    silence: list[tuple[NotNegative, NotNegative]] = Field(
        default=[],
        max_length=100,
        description="spans [from, to] in seconds of tracking in which nothing is seen (default: none)",
    )
    seed: Seed = Field(default=0, description="a whole number, 0 or more (default 0)")

    def settings(self) -> SensorSettings:
        """Return them in the tracker's words."""
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
    """One target that may move."""

    name: str = Field(pattern=r"^[a-z0-9_]{1,32}$", description="1 to 32 of the characters a-z, 0-9 and _, once")
    position_enu_m: Point | None = Field(
        default=None,
        description="[east, north, up] in metres where it is at first (default: where its motion or file begins)",
    )
    weight: Positive = Field(default=1.0, description="how much it counts among the targets, above 0 (default 1)")
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
        """Return how it moves, None where only the world knows.

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
            raise ValueError("missing; accepted: a position_enu_m where neither a motion nor a file has one")
        return rows[0].position_enu_m


class TrackTable(MissionTable):
    """How moving targets are tracked."""

    model: Literal["mixed", "velocity", "acceleration"] = Field(
        default="mixed",
        description=(
            'what a target is believed to do: keep its "velocity"; have an "acceleration" that comes and fades; or '
            '"mixed", that or steady turns, as the sightings say (default)'
        ),
    )
    lost_after_s: Positive = Field(
        default=1.0, description="a target not seen for so long is lost, a number above 0 (default 1)"
    )
    give_up_s: Positive = Field(
        default=60.0, description="home after so long without a capture or any sighting, above 0 (default 60)"
    )
    on_lost: Literal["hold", "home"] = Field(
        default="hold", description='"hold" (wait until give_up_s) or "home" (go home at once; default "hold")'
    )
    capture_m: Positive = Field(
        default=1.5, description="it is caught once the centre is this near by the estimate, above 0 (default 1.5)"
    )
    confidence: float = Field(
        default=0.95, gt=0, lt=1, description="that the face covers what is uncertain, between 0 and 1 (default 0.95)"
    )
    most_radius_m: Positive = Field(
        default=12.0, description="the face grows until it covers this radius, no further: above 0 (default 12)"
    )
