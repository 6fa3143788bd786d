"""``bench sim`` as people and scripts see it."""

import json

import pytest

from fg_gcs.console.cli import main


def test_bench_sim_shows_what_is_required_and_what_was_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "sim", "--json", "--vehicles", "2", "--swarm", "0", "--seconds", "0.2"]) == 0
    told = capsys.readouterr()
    figures = json.loads(told.out.splitlines()[-1])
    assert [each["vehicles"] for each in figures["alone"]] == [2]
    assert figures["real"] is None
    assert figures["virtual"]["vehicles"] == 9
    assert figures["met"] is all(figure["met"] for figure in figures["required"])
    assert "What is required" in told.err


def test_its_help_has_examples(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["bench", "sim", "--help"])
    assert "fg-gcs bench sim --swarm 0 --vehicles 250" in capsys.readouterr().out


def test_more_vehicles_than_ids_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "sim", "--vehicles", "251"]) == 2
    assert "--vehicles 251; accepted: up to 250" in capsys.readouterr().err
