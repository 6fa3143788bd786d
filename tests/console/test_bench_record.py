"""``bench record`` as people and scripts see it."""

import json

import pytest

from fg_gcs.console.cli import main
from fg_gcs.experiment.record_bench import BUDGET


def test_bench_record_shows_what_is_required_and_what_was_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "record", "--json"]) == 0
    told = capsys.readouterr()
    figures = json.loads(told.out.splitlines()[-1])
    assert (figures["vehicles"], figures["budget"]) == (9, BUDGET)
    assert figures["met"] is (figures["share"] <= BUDGET)
    assert "share of a core" in told.err
    assert "<= 3" in told.err
