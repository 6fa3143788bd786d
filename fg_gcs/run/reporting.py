"""Write a recorded run's report again."""

from __future__ import annotations

from pathlib import Path

from fg_gcs.errors import MissionError
from fg_gcs.record.report.report import write_report


def report(folder: Path) -> Path:
    """Write the report of a run's folder from what is recorded there, and return its path.

    Raises:
        MissionError: the folder does not hold a recorded run.
    """
    try:
        return write_report(folder)
    except (OSError, ValueError, KeyError) as error:
        raise MissionError(f"{folder}: not the folder of a recorded run: {error}") from error
