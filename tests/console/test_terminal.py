"""What people see while flying: whole flights are looked at in terminals of several sizes."""

from __future__ import annotations

import asyncio
import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from fg_gcs.console.terminal import (
    BEGIN_FRAME,
    END_FRAME,
    EVENT_LINES,
    HEIGHT,
    HINT,
    Terminal,
    closing_lines,
    tracking_lines,
    vehicle_lines,
)
from fg_gcs.flight.snapshot import (
    CounterSnapshot,
    RunEvent,
    Snapshot,
    TrackingSnapshot,
    VehicleSnapshot,
)
from fg_gcs.flight.snapshot_maker import SnapshotMaker
from fg_gcs.link.clock import ticks
from fg_gcs.mission import Mission
from fg_gcs.wire.address import MAIN
from tests.flight.harness import CIRCLE, CIRCLING, SMALL, Flight, fly, mission_of, moving

SIZES = ((100, 30), (80, 24), (60, 20))
SEEN_BADLY = "[targets.sensor]\nsilence = [[8.0, 13.0]]\noutliers = 0.1\n"
LOSING = CIRCLING.replace(CIRCLE, CIRCLE + SEEN_BADLY)
SILENT = moving(
    '[[targets]]\nname = "lead"\nposition_enu_m = [15.0, 0.0, 12.0]\n'
    '[targets.source]\nkind = "udp"\nendpoint = "udpin:127.0.0.1:15000"\n',
    "[track]\ngive_up_s = 6.0\n",
)
MARKS = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


@dataclass
class Screen:
    """A terminal that keeps everything."""

    width: int
    height: int

    def __post_init__(self) -> None:
        self.file = io.StringIO()
        self.console = Console(
            file=self.file, force_terminal=True, width=self.width, height=self.height, color_system=None
        )

    def lines(self, what: object) -> list[str]:
        """Render something; return its lines without padding."""
        with self.console.capture() as capture:
            self.console.print(what)
        return [MARKS.sub("", line).rstrip() for line in capture.get().splitlines()]


class Nowhere:
    """Readers that want nothing."""

    def wanted(self) -> bool:
        return False

    def take(self, snapshot: Snapshot) -> None:
        raise AssertionError("not wanted")


Pictures = dict[tuple[int, int], list[tuple[str, list[str]]]]


def watched(folder: Path, text: str, *sizes: tuple[int, int]) -> tuple[Mission, Flight, Pictures]:
    """Fly a mission; return all pictures, by size of the terminal, each with the stage that it was taken in."""
    mission = mission_of(folder, text)
    pictures: Pictures = {size: [] for size in sizes}

    async def look(flight: Flight) -> None:
        screens = [Screen(*size) for size in sizes]
        shows = [Terminal(mission.description, screen.console, live=True) for screen in screens]
        maker = SnapshotMaker(flight.director, Nowhere(), 4.0)
        loop = asyncio.get_running_loop()
        async for _ in ticks(0.0, 0.25):
            snapshot = maker.snapshot(loop.time())
            for size, screen, show in zip(sizes, screens, shows, strict=True):
                pictures[size].append((snapshot.stage, screen.lines(show.picture(snapshot))))

    flight = fly(folder, "px4", look, mission)
    return mission, flight, pictures


def test_the_picture_while_tracking_fits_never_jumps_and_tells_of_loss_and_return(tmp_path: Path) -> None:
    mission, flight, pictures = watched(tmp_path, LOSING, *SIZES)
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    for (width, height), taken in pictures.items():
        assert max(len(line) for _, lines in taken for line in lines) <= width
        flying = [lines for _, lines in taken if any(" phase " in line for line in lines)]
        assert {len(lines) for lines in flying} == {1 + HEIGHT + 1 + mission.swarm.vehicles + 1}
        assert len(flying[0]) + EVENT_LINES <= height
        assert {lines[-1] for lines in flying} == {HINT}
        tracking = [lines[1 : 1 + HEIGHT] for stage, lines in taken if stage in ("approach", "hold")][2:]
        assert {tuple(line.split()[0] for line in lines) for lines in tracking} == {
            ("target", "formation", "sightings", "latency")
        }
        lost = ["LOST" in lines[0] for lines in tracking]
        assert (lost[0], lost[-1]) == (False, False)
        assert np.count_nonzero(np.diff(lost)) == 2  # lost once, found once
        for lines, gone in zip(tracking, lost, strict=True):
            assert ("predicted" in lines[1] or "waiting" in lines[1]) if gone else " m off" in lines[1]
            seen = re.search(r"seen [01]\.\d s ago, \d\.\d m/s at \d+ [EW]", lines[0])
            assert "home in" in lines[0] if gone else seen, lines[0]
        assert "gated" in tracking[-1][2]
        stages = [stage for stage, _ in taken]
        assert set(stages) >= {"connect", "take-off", "approach", "hold", "home", "land"}


def test_the_latency_is_that_of_the_sensor_and_one_round_of_setpoints(tmp_path: Path) -> None:
    seen: list[float] = []

    async def look(flight: Flight) -> None:
        await flight.reaches("hold")
        async for _ in ticks(0.0, 0.25):
            status = None if flight.director.target_follower is None else flight.director.target_follower.status
            if status is None:
                return
            seen.append(status.latency_s)

    delayed = CIRCLING.replace(CIRCLE, CIRCLE + "[targets.sensor]\ndelay_s = 0.3\nsilence = [[14.0, 17.0]]\n")
    fly(tmp_path, "px4", look, mission_of(tmp_path, delayed))
    assert len(seen) > 40
    assert min(seen) >= 0.3
    assert max(seen) <= 0.3 + 0.02 + 1e-6  # a round of 50 a second; in virtual time planning takes none


def test_a_source_that_says_nothing_is_told_with_the_time_that_is_left(tmp_path: Path) -> None:
    mission, flight, pictures = watched(tmp_path, SILENT, (80, 24))
    assert flight.result is not None
    assert flight.result.reason == "no sightings for 6 s"
    assert "listening for sightings of lead at udpin:127.0.0.1:15000" in flight.events
    lines = [lines[1] for stage, lines in pictures[80, 24] if stage == "approach"]
    left = [int(found[1]) for line in lines if (found := re.search(r"not seen yet, home in (\d+) s", line))]
    assert left[0] == 6
    assert left == sorted(left, reverse=True)
    assert left[-1] == 0
    told = dict(closing_lines(_summary(capture_time_s=None, sightings=0, sightings_rejected={}), mission))
    assert told["caught after"] == "never"
    assert told["sightings"] == "0, refused: none"
    assert "centre off the target" not in told


def _summary(**changes: object) -> dict[str, object]:
    figures = ("centre_error_rms_m", "centre_error_p95_m", "flux_metric_share", "replan_p99_ms")
    latencies = ("sensed_to_setpoint_p99_ms", "stamp_to_setpoint_p99_ms")
    known = {"vehicles_landed": 4, "replans": 0, "bad_bytes": 0, "unknown_messages": 0, "lost": []}
    return {**dict.fromkeys((*figures, *latencies)), **known, **changes}


def test_the_last_words_are_about_what_was_measured(tmp_path: Path) -> None:
    mission = mission_of(tmp_path, CIRCLING)
    told = dict(
        closing_lines(
            _summary(
                capture_time_s=8.25, centre_error_rms_m=0.5, centre_error_p95_m=0.75, flux_metric_share=0.9876,
                sightings=99, sightings_rejected={"too_old": 2, "gated": 5}, stamp_to_setpoint_p99_ms=120.04,
            ),
            mission,
        )
    )  # fmt: skip
    assert told["caught after"] == "8.2 s"
    assert told["centre off the target"] == "0.50 m rms, 95 % below 0.75 m"
    assert told["target held"] == "98.8 % of the time after that"
    assert told["sightings"] == "99, refused: 5 gated, 2 too old"
    assert told["stamp to setpoint"] == "99 % in less than 120.0 ms"
    assert "arrival to setpoint" not in told


def test_a_formation_that_grows_and_a_target_that_is_lost_among_others_are_told(tmp_path: Path) -> None:
    second = f'[[targets]]\nname = "rear"\n{CIRCLE.replace("radius_m = 15.0", "radius_m = 13.0")}{SEEN_BADLY}'
    _, flight, pictures = watched(tmp_path, CIRCLING + second + "[track]\nmost_radius_m = 12.0\n", (100, 30))
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    taken = [lines[1 : 1 + HEIGHT] for stage, lines in pictures[100, 30] if stage == "hold"]
    assert all(lines[0].startswith("targets") for lines in taken)
    assert any("rear LOST; seen" in lines[0] for lines in taken)
    sizes = [float(found[1]) for lines in taken if (found := re.search(r"size x (\d\.\d\d)", lines[1]))]
    assert max(sizes) > 1.1


def test_without_a_moving_target_there_are_no_lines_for_one(tmp_path: Path) -> None:
    mission, _, pictures = watched(tmp_path, SMALL, (60, 20))
    flying = [lines for _, lines in pictures[60, 20] if any(" phase " in line for line in lines)]
    assert {len(lines) for lines in flying} == {1 + 1 + 1 + mission.swarm.vehicles + 1}
    assert not any("target" in line for lines in flying for line in lines)


def vehicle(system_id: int, *, lost: bool) -> VehicleSnapshot:
    phase = "lost" if lost else "discovered"
    return VehicleSnapshot(
        MAIN, system_id, False, phase, lost, "", False, 0.0, None, None, None, None, None, None, None, None
    )


def snapshot_of(tracking: TrackingSnapshot | None) -> Snapshot:
    counters = CounterSnapshot(0, 0, 0, 0, 0, 0, 0, 0, 0)
    return Snapshot(0, 1.0, "", "approach", ("approach",), 0.0, None, 1, (), None, None, tracking, True, counters, ())


@pytest.mark.parametrize("count", [1, 2, 7, 8, 40, 250])
@pytest.mark.parametrize("most", [2, 7, 12])
def test_what_needs_eyes_is_shown_however_many_there_are(count: int, most: int) -> None:
    vehicles = [vehicle(system_id, lost=system_id == count) for system_id in range(1, count + 1)]
    lines = Screen(80, 24).lines(vehicle_lines(vehicles, most))[1:]
    assert len(lines) == min(count, most)
    ids = [line.split()[0] for line in lines]
    assert str(count) in ids
    if count > most:
        shown = most - 1
        assert ids == [*map(str, range(1, shown)), str(count), "+"]
        assert lines[-1].split(maxsplit=1)[1] == f"{count - shown} more: {count - shown} discovered"
    else:
        assert ids == [str(system_id) for system_id in range(1, count + 1)]


def test_events_wrap_between_words_in_a_terminal_and_stay_whole_elsewhere() -> None:
    text = "COM_OBL_RC_ACT = 0, set to 4 for this flight on vehicles 1-9 (setpoints stop: land; the default sinks)"
    screen = Screen(60, 20)
    Terminal("", screen.console, live=False).event(RunEvent(2.5, "failsafe", text))
    lines = [line.rstrip() for line in MARKS.sub("", screen.file.getvalue()).splitlines()]
    assert [line[:11] for line in lines] == ["   2.50 s  ", " " * 11, " " * 11]
    assert " ".join(line[11:] for line in lines) == text
    piped = io.StringIO()
    Terminal("", Console(file=piped), live=False).event(RunEvent(2.5, "failsafe", text))
    assert piped.getvalue() == f"   2.50 s  {text}\n"
    Terminal("", Console(file=piped), live=False).event(RunEvent(2.5, "phase", "for developers"))
    assert "developers" not in piped.getvalue()


def test_whatever_a_live_terminal_gets_is_one_frame() -> None:
    screen = Screen(80, 24)
    with Terminal("", screen.console, live=True) as terminal:
        for k in range(3):
            terminal.event(RunEvent(float(k), "stage", "gather"))
    frames = screen.file.getvalue().split(BEGIN_FRAME)
    assert len(frames) == 1 + 3 + 1
    assert all(frame.endswith(END_FRAME) for frame in frames[1:])
    assert not frames[0].count(END_FRAME)


def test_before_and_after_tracking_the_lines_keep_their_place() -> None:
    screen = Screen(80, 24)
    assert len(screen.lines(tracking_lines(snapshot_of(None)))) == HEIGHT


@pytest.mark.parametrize("rests", [False, True])
def test_nothing_is_off_of_what_nobody_has_seen(rests: bool) -> None:
    status = TrackingSnapshot("waiting for the target", 1, None, 1.0, rests, False, 57.0, 4, (("malformed", 4),), None)
    lines = Screen(80, 24).lines(tracking_lines(snapshot_of(status)))
    assert [line.split(maxsplit=1)[1] for line in lines] == [
        "not seen yet, home in 57 s",
        "waiting for the target",
        "4, refused: 4 malformed",
        "-",
    ]
