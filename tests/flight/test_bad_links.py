"""Flights on links that lose, delay, double and overtake, and with single answers that are never heard."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.flight.harness import AUTOPILOTS, fly
from tests.flight.meddling import Judge, MeddlingLoop, lossy

FAILSAFES = {"px4": ("COM_OBL_RC_ACT", 4.0), "ardupilot": ("FS_GCS_ENABLE", 5.0)}


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize(
    "judge",
    [lossy(1, 0.2), lossy(2, 0.0, 0.1, 0.2, double=0.1), lossy(3, 0.3, 0.1, 0.2)],
    ids=["20 % lost", "150±50 ms, doubled", "30 % lost, 150±50 ms"],
)
def test_a_flight_on_a_bad_link_completes(judge: Judge, autopilot: str, tmp_path: Path) -> None:
    flight = fly(tmp_path, autopilot, loop=lambda: MeddlingLoop(judge))
    assert flight.result is not None
    assert flight.result.completed, flight.result.reason
    assert flight.down_and_disarmed
    assert flight.truth_separation_m >= 1.4
