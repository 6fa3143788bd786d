"""The report as a web page: style, tables and charts in one file that needs no network."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import NamedTuple

import plotly.graph_objects as go
import plotly.io
from plotly.offline import get_plotlyjs

CONFIG = {
    "displaylogo": False,
    "responsive": True,
    "showSendToCloud": False,  # plotly's own default is a button that uploads the flight
    "plotlyServerURL": "",
    "modeBarButtonsToRemove": ["select2d", "lasso2d"],
}

# The browser refuses to fetch anything, whatever text from a vehicle has found its way into the page; eval is what
# plotly's 3-D pictures build their shaders with
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:; "
    "worker-src blob:; font-src data:"
)

STYLE = """
body { margin: 0; background: #f2f4f6; color: #263238; font: 15px/1.5 system-ui, "Segoe UI", Roboto, sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 24px 20px 60px; }
section, header {
  background: #fff; border: 1px solid #dde2e6; border-radius: 8px; padding: 18px 22px; margin: 0 0 18px;
}
h1 { font-size: 26px; line-height: 1.25; margin: 0 0 4px; }
h2 { font-size: 18px; margin: 0 0 6px; }
p { margin: 4px 0 10px; }
.about, .note { color: #546e7a; }
.note { font-size: 14px; margin: 6px 0 0; }
.outcome { display: inline-block; font-weight: 600; padding: 4px 12px; border-radius: 6px; margin: 6px 0 8px; }
.good .outcome { background: #e2f3e4; color: #1b5e20; }
.bad .outcome { background: #fde3e1; color: #b71c1c; }
header.good { border-top: 5px solid #2e7d32; }
header.bad { border-top: 5px solid #c62828; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th { text-align: left; color: #607d8b; font-weight: 600; font-size: 13px; }
th, td { padding: 5px 12px 5px 0; border-bottom: 1px solid #e7ebee; vertical-align: top; }
tr:last-child td { border-bottom: 0; }
td.yes { color: #2e7d32; white-space: nowrap; } td.no { color: #c62828; font-weight: 600; white-space: nowrap; }
tr.fault td { color: #b71c1c; font-weight: 600; } tr.care td { color: #8a5a00; }
tr.stage td { font-weight: 600; background: #f7f9fa; }
.columns { display: grid; grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); gap: 4px 40px; }
.events td { overflow-wrap: anywhere; }
.events th, .events td:first-child, .events td:nth-child(2) { white-space: nowrap; }
@media print { body { background: #fff; } section, header { break-inside: avoid; } }
"""

# Zooming one chart over time zooms all of them
LINKED = """
const charts = [...document.querySelectorAll(".over-time .plotly-graph-div")];
for (const chart of charts) chart.on("plotly_relayout", () => {
  const [begin, end] = chart.layout.xaxis.range;
  for (const other of charts) {
    const range = other.layout.xaxis.range;
    if (range[0] !== begin || range[1] !== end) Plotly.relayout(other, {"xaxis.range": [begin, end]});
  }
});
"""


class Cell(NamedTuple):
    """A table's cell: its text, as it is, and its class in the style."""

    text: str
    style: str = ""


class Row(NamedTuple):
    """A table's row: its cells and its class in the style."""

    cells: Sequence[Cell | str]
    style: str = ""


def table(header: Sequence[str], rows: Iterable[Row], style: str = "") -> str:
    """Return a table; all text is escaped."""
    lines = [f'<table class="{style}">']
    if header:
        lines.append("<tr>" + "".join(f"<th>{escape(name)}</th>" for name in header) + "</tr>")
    for row in rows:
        cells = (Cell(cell) if isinstance(cell, str) else cell for cell in row.cells)
        inner = "".join(f'<td class="{cell.style}">{escape(cell.text)}</td>' for cell in cells)
        lines.append(f'<tr class="{row.style}">{inner}</tr>')
    return "\n".join([*lines, "</table>"])


def section(title: str, body: str, note: str = "", style: str = "") -> str:
    """Return a section; title and note are escaped, the body is taken as it is."""
    below = f'<p class="note">{escape(note)}</p>' if note else ""
    return f'<section class="{style}"><h2>{escape(title)}</h2>\n{body}\n{below}</section>'


def chart(name: str, title: str, figure: go.Figure | None, note: str, style: str = "over-time") -> str:
    """Return a section with a chart, or nothing when there is nothing to draw.

    Args:
        name: the chart's name within the page; letters only.
        title: what it shows.
        figure: the chart.
        note: a sentence on how to read it.
        style: the section's class in the style.
    """
    if figure is None:
        return ""
    body = plotly.io.to_html(
        figure,
        include_plotlyjs=False,
        full_html=False,
        div_id=name,  # else a random one: the same run gives the same bytes
        config=CONFIG,
        default_height=f"{figure.layout.height}px",
    )
    return section(title, body, note, style)


def page(title: str, sections: Iterable[str]) -> str:
    """Return the whole page; the title is escaped, the sections are taken as they are."""
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}</title>\n<style>{STYLE}</style>",
            f"<script>{get_plotlyjs()}</script>\n</head>\n<body>\n<main>",
            *sections,
            f"</main>\n<script>{LINKED}</script>\n</body>\n</html>\n",
        ]
    )
