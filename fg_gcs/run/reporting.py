"""Write a recorded run's report again."""

from __future__ import annotations

from pathlib import Path

from fg_gcs.errors import MissionError
from fg_gcs.record.report.report import WrittenReport, write_report


def report(folder: Path) -> WrittenReport:
    """Write the report of a run's folder from what is recorded there: the same bytes every time, wherever it lies.

    Returns:
        The report's path, and a line for everything that is missing from it.

    Raises:
        FgError: the folder does not hold a recorded run, or the report cannot be written; one line.
    """
    try:
        return write_report(folder)
    except OSError as error:
        raise MissionError(f"{folder}: the report cannot be written: {error.strerror or error}") from error
