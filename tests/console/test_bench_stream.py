"""``bench stream`` as people and scripts see it."""

import json

import pytest

from fg_gcs.console.cli import main


def test_bench_stream_shows_what_is_required_and_what_was_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "stream", "--json", "--alone", "--vehicles", "3", "--many", "8", "--seconds", "0.5"]) == 0
    told = capsys.readouterr()
    figures = json.loads(told.out.splitlines()[-1])
    assert [row["station"] for row in figures["setpoints"]] == ["fg-gcs"]
    assert figures["many"]["vehicles"] == 8
    assert figures["met"] is all(figure["met"] for figure in figures["required"])
    assert "What is required" in told.err


def test_its_help_has_examples(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["bench", "stream", "--help"])
    assert "fg-gcs bench stream --alone --vehicles 250" in capsys.readouterr().out
