"""How late ticks are, and how streams are spread so that no tick is long."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sitl_mock.host.fleet import Fleet, FleetOptions, grid
from sitl_mock.host.lateness import BIN_S, Lateness
from sitl_mock.host.memory import unchanged
from sitl_mock.links import PHASE_VEHICLES, Link, phase_s

TICK_S = 0.01
times_s = st.floats(0.0, 0.5)


@given(st.lists(times_s, min_size=1, max_size=60), st.floats(1.0, 100.0))
def test_percentiles_are_numpys_to_a_bin(late_s: list[float], percent: float) -> None:
    lateness = Lateness()
    for each in late_s:
        lateness.add(each, 0, TICK_S)
    true_s = float(np.percentile(late_s, percent, method="inverted_cdf"))
    assert true_s - 1e-9 <= lateness.percentile_s(percent) <= true_s + BIN_S + 1e-9
    assert lateness.worst_s == max(late_s)
    assert (lateness.ticks, lateness.left_out) == (len(late_s), 0)


def test_a_tick_that_is_left_out_is_late_by_a_whole_tick_and_one_before_it_by_two() -> None:
    lateness = Lateness()
    lateness.add(0.0, 0, TICK_S)
    lateness.add(0.001, 2, TICK_S)
    assert (lateness.ticks, lateness.left_out, lateness.worst_s) == (4, 2, 2.0 * TICK_S)
    assert lateness.percentile_s(50.0) == pytest.approx(0.001, abs=BIN_S)
    assert lateness.percentile_s(75.0) == pytest.approx(TICK_S, abs=BIN_S)
    assert lateness.percentile_s(99.0) == pytest.approx(2.0 * TICK_S, abs=BIN_S)


def test_before_the_first_tick_there_is_none() -> None:
    assert Lateness().figures() == {"ticks": 0, "left_out": 0, "late_p99_ms": 0.0, "late_worst_ms": 0.0}


@given(st.integers(0, 2_000), st.integers(0, 100_000), st.integers(1, 200))
def test_asked_for_streams_keep_to_the_links_own_phase(start_ms: int, asked_ms: int, rate_hz: int) -> None:
    start_s, asked_s, period_s = 1e-3 * start_ms, 1e-3 * asked_ms, 1.0 / rate_hz
    link = Link({}, start_s)
    link.set_interval("ATTITUDE", period_s, asked_s)
    assert link.due(asked_s) == []
    assert asked_s - 2e-6 < link.next_s <= max(start_s, asked_s + period_s) + 2e-6
    turns = (link.next_s - start_s) / period_s
    assert turns == pytest.approx(round(turns), abs=1e-5)
    assert link.due(link.next_s) == ["ATTITUDE"]
    assert link.next_s == pytest.approx(start_s + (round(turns) + 1) * period_s)
    link.set_interval("ATTITUDE", None, asked_s)
    assert link.period_s("ATTITUDE") is None
    assert link.due(asked_s + 1e6) == []


def test_small_fleets_speak_at_once_and_large_ones_in_turn() -> None:
    assert {phase_s(row) for row in range(PHASE_VEHICLES)} == {0.0}
    fleet = Fleet(FleetOptions(pads_enu_m=grid(250)))
    said = []
    for tick in range(200):
        fleet.advance(tick * TICK_S)
        said.append(len(fleet.telemetry(tick * TICK_S)))
    ten_hz = 5
    assert min(said[100:]) >= PHASE_VEHICLES * ten_hz  # something is said in every tick,
    assert max(said) <= PHASE_VEHICLES * 16  # and never more than all streams of one group


MAPS = """\
7f0000000000-7f0000002000 r--p 00000000 08:01 42                         /usr/lib/some library.so
Rss:                   8 kB
Anonymous:             0 kB
7f0000002000-7f0000004000 r-xp 00002000 08:01 42                         /usr/lib/some library.so
Anonymous:             0 kB
7f0000004000-7f0000005000 r--p 00004000 08:01 42                         /usr/lib/some library.so
Anonymous:             4 kB
7f0000005000-7f0000006000 rw-p 00005000 08:01 42                         /usr/lib/some library.so
Anonymous:             0 kB
7f0000006000-7f0000007000 r--s 00000000 08:01 43                         /shared
Anonymous:             0 kB
7f0000007000-7f0000008000 r-xp 00000000 00:00 0
Anonymous:             0 kB
7f0000008000-7f0000009000 r-xp 00000000 00:00 0                          [vdso]
Anonymous:             0 kB
"""


def test_only_what_is_as_its_file_is_can_be_dropped() -> None:
    assert unchanged(MAPS) == [(0x7F0000000000, 0x7F0000002000), (0x7F0000002000, 0x7F0000004000)]
    assert unchanged("") == unchanged("nonsense\nAnonymous: 0 kB\n") == []


def test_the_process_writes_how_late_it_was(tmp_path: Path) -> None:
    timing = tmp_path / "timing.json"
    command = [sys.executable, "-m", "sitl_mock", "--port-base=0", "--with-parent", f"--timing={timing}"]
    subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=True)
    assert set(json.loads(timing.read_text())) == {"ticks", "left_out", "late_p99_ms", "late_worst_ms"}
