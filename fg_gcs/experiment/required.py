"""Figures beside what is required of them."""

from __future__ import annotations

import math
from typing import NamedTuple

from fg_gcs.experiment.tables import NOTHING


class Figure(NamedTuple):
    """One measured figure beside what is required of it."""

    name: str
    required: str
    measured: float | None
    met: bool


def at_most(name: str, most: float, measured: float | None) -> Figure:
    """Return a figure with an upper bound; an infinite one requires nothing, but that there is a figure."""
    required = f"<= {most:g}" if math.isfinite(most) else NOTHING
    return Figure(name, required, measured, measured is not None and measured <= most)


def at_least(name: str, least: float, measured: float | None) -> Figure:
    """Return a figure with a lower bound; 0 requires nothing, but that there is a figure."""
    required = f">= {least:g}" if least > 0.0 else NOTHING
    return Figure(name, required, measured, measured is not None and measured >= least)
