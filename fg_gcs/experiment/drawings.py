"""The paper's figures, drawn anew as PNG and SVG; the same results give the same bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.experiment import ours
from fg_gcs.experiment.baselines.least_squares import FREE_SIZE, HELD_SIZE, plan_least_squares
from fg_gcs.experiment.flights import Flight
from fg_gcs.experiment.scenes import LEADERS, LIMITS, Scene
from fg_gcs.record.report.charts import FOLLOWER_COLOUR, LEADER_COLOURS, LIMIT_COLOUR
from fg_gcs.record.report.scene import FACE_COLOUR, TARGET_COLOUR
from fg_gcs.run.kinematic import KinematicSimulation

ENDINGS: dict[str, dict[str, str | None]] = {"png": {"Software": None}, "svg": {"Date": None}}  # no dates: same bytes
POINTS = 200  # of a line: finer than the eye, and files stay small
FACES = 4  # drawn along a flight, both ends included
DOTS_PER_INCH = 90  # a page's width in under 200 kB


def compare_paths(scenes: Sequence[Scene]) -> Figure:
    """Draw the leaders' paths by flux guiding and by least squares, a panel for each target.

    Raises:
        PlanError: a method does not reach a target.
    """
    figure = Figure(figsize=(6.0 * len(scenes), 5.5), layout="constrained")  # without pyplot: no window, no state
    for place, made in enumerate(scenes, start=1):
        axes = _space(figure, (1, len(scenes), place))
        path = ours.plan(made).path
        paths = [("flux guided (ours)", path.at(np.linspace(0.0, path.length_m, POINTS)).position_m[:, :LEADERS])]
        for baseline in (FREE_SIZE, HELD_SIZE):
            found = plan_least_squares(made.leaders_enu_m, made.target_enu_m, baseline).leaders_enu_m
            paths.append((baseline.name, found[_spread(len(found))]))
        for (name, leaders), colour in zip(paths, LEADER_COLOURS, strict=False):
            for leader in range(LEADERS):
                label = name if leader == 0 else None
                axes.plot(*leaders[:, leader].T, color=colour, linewidth=1.2, label=label)
        _finish_space(axes, made, np.concatenate([leaders.reshape(-1, 3) for _, leaders in paths]))
        axes.legend(loc="upper left", frameon=False)
    return figure


def draw_curves(flight: Flight) -> Figure:
    """Draw speed and acceleration of all vehicles over time with their limits; the paper's way thin behind ours."""
    figure = Figure(figsize=(9.0, 5.5), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for axes, field, limit, label in (
        (upper, "speed_m_s", LIMITS.speed_m_s, "speed [m/s]"),
        (lower, "acceleration_m_s2", LIMITS.acceleration_m_s2, "acceleration [m/s²]"),
    ):
        if flight.theirs is not None:
            kept = _spread(len(flight.theirs.time_s))
            worst = getattr(flight.theirs, field)[kept].max(axis=1)
            axes.plot(
                flight.theirs.time_s[kept], worst, color=FOLLOWER_COLOUR, linewidth=1.0, label="paper's way, largest"
            )
        kept = _spread(len(flight.ours.time_s))
        values = getattr(flight.ours, field)[kept]
        for vehicle in reversed(range(values.shape[1])):
            leads = vehicle < LEADERS
            axes.plot(
                flight.ours.time_s[kept],
                values[:, vehicle],
                color=LEADER_COLOURS[vehicle] if leads else FOLLOWER_COLOUR,
                linewidth=1.2 if leads else 0.6,
                linestyle="-" if leads else ":",
                label={0: "leaders", LEADERS: "followers"}.get(vehicle),
            )
        axes.axhline(limit, color=LIMIT_COLOUR, linestyle="--", linewidth=1.2, label="limit")
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel(label)
        axes.grid(color="#dfe4e8", linewidth=0.6)
    upper.legend(loc="upper right", frameon=False, ncols=2)
    upper.set_title(f"Flight to ({flight.scene.name})", fontsize=11)
    lower.set_xlabel("time [s]")
    return figure


def draw_flight(flight: Flight) -> Figure:
    """Draw all vehicles' paths, the face at some moments, and the target."""
    figure = Figure(figsize=(7.5, 6.0), layout="constrained")
    axes = _space(figure, (1, 1, 1))
    plan = flight.planned.plan
    places = plan.sample(np.linspace(0.0, plan.duration_s, POINTS)).position_m
    for vehicle in range(places.shape[1]):
        leads = vehicle < LEADERS
        colour = LEADER_COLOURS[vehicle] if leads else FOLLOWER_COLOUR
        axes.plot(*places[:, vehicle].T, color=colour, linewidth=1.4 if leads else 0.7)
    for moment in np.linspace(0, POINTS - 1, FACES).astype(int):
        rim = places[moment, :LEADERS]
        axes.plot(*np.concatenate((rim, rim[:1])).T, color=FACE_COLOUR, linewidth=1.2)
        corners = np.concatenate((rim, rim.mean(axis=0, keepdims=True)))
        fan = [(LEADERS, corner, (corner + 1) % LEADERS) for corner in range(LEADERS)]
        axes.plot_trisurf(*corners.T, triangles=fan, color=FACE_COLOUR, alpha=0.35, shade=False)
        colours = [*LEADER_COLOURS[:LEADERS], *[FOLLOWER_COLOUR] * (places.shape[1] - LEADERS)]
        axes.scatter(*places[moment].T, color=colours, s=12, depthshade=False)
    _finish_space(axes, flight.scene, places.reshape(-1, 3))
    return figure


def draw_tracks(simulations: Mapping[str, KinematicSimulation]) -> Figure:
    """Draw from above where the targets went, what was known of them and where the formation went, a panel each."""
    figure = Figure(figsize=(11.0, 5.0 * len(simulations) / 2.0), layout="constrained")
    for number, (name, simulation) in enumerate(simulations.items(), start=1):
        axes = figure.add_subplot((len(simulations) + 1) // 2, 2, number)
        kept = _spread(len(simulation.time_s))
        for places, colour, width, label in (
            (simulation.estimate_m, FOLLOWER_COLOUR, 0.8, "estimate"),
            (simulation.truth_m, TARGET_COLOUR, 2.4, "target"),
            (simulation.place_m, LEADER_COLOURS[0], 1.2, "formation"),
        ):
            axes.plot(*places[kept, :2].T, color=colour, linewidth=width, label=label)
        axes.plot(*simulation.place_m[0, :2], "o", color=LEADER_COLOURS[0], label="start")
        if simulation.caught_s is not None:
            caught = int(np.searchsorted(simulation.time_s, simulation.caught_s))
            axes.plot(*simulation.place_m[caught, :2], "D", color=LEADER_COLOURS[2], label="capture")
        axes.set_aspect("equal", adjustable="datalim")
        _finish_plane(axes, name, "x, east [m]", "y, north [m]")
    lines, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside lower center", frameon=False, ncols=len(labels))
    return figure


def draw_errors(simulations: Mapping[str, KinematicSimulation]) -> Figure:
    """Draw over time how far the formation's centre is from the true target, with the loss where there is one."""
    figure = Figure(figsize=(11.0, 1.9 * len(simulations)), layout="constrained")
    every = figure.subplots(len(simulations), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, simulation) in zip(every, simulations.items(), strict=True):
        kept = np.arange(0, len(simulation.time_s), 10)  # five a second: the error changes over seconds
        axes.plot(simulation.time_s[kept], simulation.error_m[kept], color=LEADER_COLOURS[0], linewidth=1.2)
        axes.axhline(simulation.tracking.capture_m, color=LIMIT_COLOUR, linestyle="--", linewidth=1.0, label="capture")
        if simulation.caught_s is not None:
            axes.axvline(simulation.caught_s, color=LEADER_COLOURS[2], linewidth=1.0, label="caught")
        gaps = np.flatnonzero(np.diff(simulation.received_s) > simulation.tracking.estimator.lost_after_s)
        for gap in gaps:
            axes.axvspan(*simulation.received_s[gap : gap + 2], color="#fbe9d0", label="unseen")
        axes.set_yscale("symlog", linthresh=2.0)  # decimetres once it is caught, tens of metres before
        axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.set_ylim(bottom=0.0)
        _finish_plane(axes, name, "", "error [m]")
    every[-1].set_xlabel("time [s]")
    shown = {label: line for axes in every for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend([*shown.values()], [*shown], loc="outside lower center", frameon=False, ncols=len(shown))
    return figure


def save(figure: Figure, folder: Path, name: str) -> tuple[Path, ...]:
    """Write a figure as PNG and SVG into a folder and return both paths."""
    written = []
    for ending, metadata in ENDINGS.items():
        path = folder / f"{name}.{ending}"
        with mpl.rc_context({"svg.hashsalt": "fg-gcs"}):  # else ids in the file are random
            figure.savefig(path, format=ending, dpi=DOTS_PER_INCH, metadata=metadata)
        written.append(path)
    return tuple(written)


def _space(figure: Figure, place: tuple[int, int, int]) -> Axes3D:
    axes = figure.add_subplot(*place, projection="3d")
    assert isinstance(axes, Axes3D), "what this projection makes"
    return axes


def _finish_space(axes: Axes3D, made: Scene, places: Array) -> None:
    axes.scatter(*made.target_enu_m, color=TARGET_COLOUR, marker="*", s=120, depthshade=False)
    everything = np.concatenate((places, made.target_enu_m[None]))
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin_m = 0.03 * float((high - low).max()) + 0.5
    for setter, begin, end in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), low, high, strict=True):
        setter(begin - margin_m, end + margin_m)
    axes.set_box_aspect(tuple((high - low + 2.0 * margin_m).tolist()), zoom=0.85)  # leaves room for the labels
    axes.set(xlabel="x, east [m]", ylabel="y, north [m]", zlabel="z, up [m]")
    axes.set_title(f"target ({made.name})", fontsize=11)


def _finish_plane(axes: Axes, name: str, across: str, up: str) -> None:
    axes.set(xlabel=across, ylabel=up)
    axes.set_title(name, fontsize=11)
    axes.grid(color="#dfe4e8", linewidth=0.6)


def _spread(count: int) -> NDArray[np.intp]:
    """Indices of at most ``POINTS`` samples, both ends among them."""
    return np.unique(np.linspace(0, count - 1, min(count, POINTS)).round().astype(np.intp))
