"""Memory stays what it is however long a flight takes."""

import sys

import pytest

from fg_gcs.experiment.memory_bench import memory_bench
from tests.flight.harness import CIRCLING


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells a process how much memory it has")
def test_memory_does_not_grow_with_the_flight() -> None:
    found = memory_bench(CIRCLING, hold_s=110.0)
    assert found.flight_s >= 60.0
    # 50 rounds a second: a thousand bytes kept of each would be three megabytes in this minute
    assert found.growth_mb < 1.0
    assert found.evaluation_mb < 60.0
