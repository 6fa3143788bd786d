"""A drawing of a plan for papers and mission reviews: the approach in space, and what it keeps over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import coverage, flux_metric
from fg_gcs.core.separation import smallest_over_time
from fg_gcs.errors import MissionError
from fg_gcs.plan.flight_plan import FlightPlan, Task
from fg_gcs.plan.trajectory import Sample
from fg_gcs.plan.verification import CheckedPlan
from fg_gcs.record.report.charts import FOLLOWER_COLOUR, LEADER_COLOURS, LIMIT_COLOUR
from fg_gcs.record.report.scene import FACE_COLOUR, TARGET_COLOUR

ENDINGS = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}  # no dates: same bytes
SAMPLE_HZ = 50.0  # a fifth of a metre at 10 m/s: less than the width of a line
FACES = 4  # drawn along the approach, its end included
STAGE_COLOURS = {"gather": "#eef4fb", "approach": "#e3f1e4", "home": "#eef4fb"}


class Stretch(NamedTuple):
    """One of the flight's plans, sampled; in the drawing they follow each other without the hold between them."""

    stage: str
    time_s: Array  # (T,) since the begin of the first plan [s]
    sample: Sample


def plot_plan(plan: FlightPlan, task: Task, path: Path) -> None:
    """Draw a plan into a file: paths and faces of the approach; speed, acceleration, face and separation over time.

    Args:
        plan: what is drawn.
        task: what it was planned for; its limits and its target are drawn as well.
        path: the ending says the format: png, svg or pdf. The same plan gives the same bytes.

    Raises:
        MissionError: the ending is none of these, or the file cannot be written.
    """
    ending = path.suffix.lower().removeprefix(".")
    if ending not in ENDINGS:
        raise MissionError(f"--plot {path}: accepted endings: {', '.join(f'.{name}' for name in ENDINGS)}")
    figure = Figure(figsize=(15.0, 8.5), layout="constrained")  # without pyplot: no window, no state
    grid = figure.add_gridspec(4, 2, width_ratios=(1.05, 1.0))
    first = figure.add_subplot(grid[0, 1])
    axes = [first, *(figure.add_subplot(grid[row, 1], sharex=first) for row in range(1, 4))]
    stretches = _sampled(plan)
    colours = _colours(plan)
    _draw_space(figure, grid[:, 0], plan, task, stretches[1].sample.position_m, colours)
    _draw_times(axes, plan, task, stretches, colours)
    try:
        with mpl.rc_context({"svg.hashsalt": "fg-gcs"}):  # else ids in the file are random
            figure.savefig(path, format=ending, dpi=120, metadata=ENDINGS[ending])
    except OSError as error:
        raise MissionError(f"--plot {path}: {error.strerror or error}") from error


def _sampled(plan: FlightPlan) -> list[Stretch]:
    begin_s, stretches = 0.0, []
    named: Sequence[tuple[str, CheckedPlan]] = (
        ("gather", plan.gather),
        ("approach", plan.approach),
        ("home", plan.home),
    )
    for stage, part in named:
        time_s = np.linspace(0.0, part.duration_s, max(2, int(part.duration_s * SAMPLE_HZ) + 1))
        stretches.append(Stretch(stage, time_s + begin_s, part.sample(time_s)))
        begin_s += part.duration_s
    return stretches


def _colours(plan: FlightPlan) -> list[str]:
    """Return every vehicle's colour: leaders each their own, followers grey."""
    colours = [FOLLOWER_COLOUR] * len(plan.slot_of)
    for place, vehicle in enumerate(plan.rim_of.tolist()):
        colours[vehicle] = LEADER_COLOURS[place % len(LEADER_COLOURS)]
    return colours


def _draw_space(
    figure: Figure, place: SubplotSpec, plan: FlightPlan, task: Task, position: Array, colours: Sequence[str]
) -> None:
    axes: Any = figure.add_subplot(place, projection="3d")  # matplotlib ships no types for axes in space
    for vehicle, colour in enumerate(colours):
        leads = colour != FOLLOWER_COLOUR
        axes.plot(*position[:, vehicle].T, color=colour, linewidth=1.8 if leads else 0.8)
    for instant in np.linspace(0, len(position) - 1, FACES).astype(int):
        rim = position[instant, plan.rim_of]
        count = len(rim)
        corners = np.concatenate((rim, rim.mean(axis=0, keepdims=True)))
        fan = [(count, corner, (corner + 1) % count) for corner in range(count)]
        axes.plot_trisurf(*corners.T, triangles=fan, color=FACE_COLOUR, alpha=0.35, shade=False)
        axes.plot(*np.concatenate((rim, rim[:1])).T, color=FACE_COLOUR, linewidth=1.2)
        axes.scatter(*position[instant].T, color=list(colours), s=10, depthshade=False)
    sources_enu_m = task.target.sources.positions_enu_m  # (C, 3)
    size = 160.0 / np.sqrt(len(sources_enu_m))  # many stars shall not hide what surrounds them
    axes.scatter(*sources_enu_m.T, color=TARGET_COLOUR, marker="*", s=size, depthshade=False)
    everything = np.concatenate((position.reshape(-1, 3), sources_enu_m))
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.05 * float((high - low).max()) + 0.5
    for setter, begin, end in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), low, high, strict=True):
        setter(begin - margin, end + margin)
    axes.set_box_aspect(tuple((high - low + 2.0 * margin).tolist()), zoom=0.86)  # leaves room for the labels
    for label, text in ((axes.set_xlabel, "east [m]"), (axes.set_ylabel, "north [m]"), (axes.set_zlabel, "up [m]")):
        label(text, labelpad=7.0)
    way = task.target_enu_m - task.start.centre_enu_m
    axes.view_init(elev=22.0, azim=float(np.degrees(np.arctan2(way[1], way[0]))) - 120.0)  # so that faces show
    figures = plan.figures
    axes.set_title(
        f"{len(colours)} vehicles, {len(plan.rim_of)} leaders: approach of {plan.approach.duration_s:.1f} s, "
        f"{figures.path_length_m:.1f} m over all leaders,\nflux metric {figures.flux_metric:.3f} at the end, "
        f"coverage {figures.coverage_mean:.3f} on average",
        fontsize=11,
    )
    marks = [
        Line2D([], [], color=LEADER_COLOURS[0], linewidth=1.8, label="leaders"),
        Line2D([], [], color=FOLLOWER_COLOUR, linewidth=0.8, label="followers"),
        Line2D([], [], color=FACE_COLOUR, linewidth=6.0, alpha=0.5, label="face"),
        Line2D([], [], color=TARGET_COLOUR, marker="*", markersize=11, linestyle="", label="target"),
    ]
    axes.legend(handles=marks, loc="upper left", frameon=False)


def _draw_times(
    axes: Sequence[Axes], plan: FlightPlan, task: Task, stretches: Sequence[Stretch], colours: Sequence[str]
) -> None:
    speed, acceleration, face, separation = axes
    limits = task.rules.limits
    for stretch in stretches:
        for each in axes:
            each.axvspan(stretch.time_s[0], stretch.time_s[-1], color=STAGE_COLOURS[stretch.stage], zorder=0)
        middle = float(stretch.time_s[0] + stretch.time_s[-1]) / 2.0
        place = speed.get_xaxis_transform()
        speed.text(middle, 1.03, stretch.stage, transform=place, ha="center", va="bottom", color="#607d8b")
        for chart, values in ((speed, stretch.sample.velocity_m_s), (acceleration, stretch.sample.acceleration_m_s2)):
            norms = np.linalg.norm(values, axis=2)  # (T, V)
            for vehicle in sorted(range(len(colours)), key=lambda v: colours[v] != FOLLOWER_COLOUR):
                width = 1.2 if colours[vehicle] != FOLLOWER_COLOUR else 0.7
                chart.plot(stretch.time_s, norms[:, vehicle], color=colours[vehicle], linewidth=width)
        if len(colours) > 1:
            separation.plot(stretch.time_s, smallest_over_time(stretch.sample.position_m), color=LEADER_COLOURS[0])
    approach = stretches[1]
    rims = approach.sample.position_m[:, plan.rim_of]
    face.plot(approach.time_s, flux_metric(rims, task.target_enu_m), color=LEADER_COLOURS[0], label="flux metric")
    face.plot(approach.time_s, coverage(rims, task.target_enu_m), color=LEADER_COLOURS[4], label="coverage")
    face.legend(loc="center right", frameon=False)
    face.set(ylim=(-0.03, 1.06), ylabel="share [0 to 1]")
    for chart, limit, name in (
        (speed, limits.speed_m_s, "speed [m/s]"),
        (acceleration, limits.acceleration_m_s2, "acceleration [m/s²]"),
        (separation, task.rules.separation_m, "closest pair [m]"),
    ):
        chart.axhline(limit, color=LIMIT_COLOUR, linestyle="--", linewidth=1.2)
        chart.set_ylim(bottom=0.0)
        chart.set_ylabel(name)
    for each in axes:
        each.grid(color="#dfe4e8", linewidth=0.6)
        each.tick_params(labelbottom=each is separation)
    separation.set(xlim=(0.0, float(stretches[-1].time_s[-1])), xlabel="time of the plans, without the hold [s]")
