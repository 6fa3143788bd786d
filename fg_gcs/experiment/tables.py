"""Tables of results: cells with a format, as text for terminals, Markdown and CSV."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import NamedTuple

Cell = str | float | None  # None: there is no such figure

NOTHING = "-"  # how people read None


class Column(NamedTuple):
    """What a column holds and how its numbers are written."""

    title: str
    digits: int = 2  # behind the point
    timed: bool = False  # depends on the machine: two significant digits are all that it is worth

    def write(self, cell: Cell) -> str:
        """Return a cell as text; machines' and people's tables hold the same digits."""
        if cell is None or isinstance(cell, str):
            return cell or ""
        if not self.timed:
            return f"{cell:.{self.digits}f}"
        return f"{float(f'{cell:.2g}'):.6f}".rstrip("0").rstrip(".")


@dataclass(frozen=True)
class ResultTable:
    """One experiment's results."""

    name: str  # of its file, without ending
    title: str
    text: str  # what it shows and how it was made: one paragraph
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def written(self) -> tuple[tuple[str, ...], ...]:
        """Return every cell as text."""
        return tuple(
            tuple(column.write(cell) for column, cell in zip(self.columns, row, strict=True)) for row in self.rows
        )

    def csv(self) -> str:
        """Return the table as CSV with a heading; a missing figure is an empty cell."""
        page = io.StringIO()
        writer = csv.writer(page, lineterminator="\n")
        writer.writerow([column.title for column in self.columns])
        writer.writerows(self.written())
        return page.getvalue()

    def markdown(self) -> str:
        """Return the table as Markdown; numbers stand on the right."""
        numeric = [any(isinstance(row[i], int | float) for row in self.rows) for i in range(len(self.columns))]
        lines = [[column.title for column in self.columns], ["---:" if right else "---" for right in numeric]]
        lines += [[cell or NOTHING for cell in row] for row in self.written()]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
