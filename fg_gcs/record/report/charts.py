"""The report's charts over time; all have the flight's span as their time axis and its stages as their background.

Those of moving targets show how far off the formation was, what was seen, and how old that was.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Formation
from fg_gcs.record.evaluate.evaluation import EvaluatedRun
from fg_gcs.record.evaluate.tracking import flown_error, flown_scale
from fg_gcs.track.follow.replanner import FollowMode
from fg_gcs.track.sightings import Verdict
from fg_gcs.wire.address import VehicleAddress

LEADER_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#6a3d9a", "#8c510a")
FOLLOWER_COLOUR, LIMIT_COLOUR, FAULT_COLOUR, INK = "#9aa0a6", "#c62828", "#c62828", "#263238"
BAND_COLOURS = {
    "take-off": "#f3f5f7",
    "gather": "#eef4fb",
    "approach": "#e3f1e4",
    "hold": "#fdf3d8",
    "home": "#eef4fb",
    "land": "#f3f5f7",
}
NARROWEST_LABEL = 0.045  # share of the width; a stage's name does not fit a narrower band
POINTS_PER_LINE = 1500  # more than the pixels of a screen's width
POINTS_PER_CHART = 40_000  # under half a megabyte a chart, however many vehicles
MODE_COLOURS = {
    FollowMode.WAIT: "#cc79a7",
    FollowMode.TURN: "#e69f00",
    FollowMode.APPROACH: "#0072b2",
    FollowMode.FOLLOW: "#009e73",
}
SEEN_COLOURS = {Verdict.TAKEN: FOLLOWER_COLOUR, Verdict.TENTATIVE: "#56b4e9"}  # any other is a refusal
LEAST_M = 0.05  # what is less is drawn as this: on a logarithmic axis the zeros of a difference reach down for ever
MOST_MARKS = 4000  # of one kind in one chart: more than a browser's pixels tell apart
MARGIN = {"l": 64, "r": 150, "t": 26, "b": 42}  # the same everywhere, so that the time axes stand below each other


def speed_chart(run: EvaluatedRun) -> go.Figure | None:
    """Return the speed of every vehicle, by its own samples."""
    if run.series is None:
        return None
    chart = empty_chart(run, "speed [m/s]")
    _lines(chart, run, run.series.own_time_s, run.series.speed_m_s, "m/s")
    return finished(chart, run.summary.limit("speed_m_s"), "limit")


def acceleration_chart(run: EvaluatedRun) -> go.Figure | None:
    """Return the acceleration of every vehicle while it is in the air."""
    if run.series is None:
        return None
    in_the_air = [
        np.where(airborne, values, np.nan)
        for airborne, values in zip(run.series.airborne, run.series.acceleration_m_s2, strict=True)
    ]
    chart = empty_chart(run, "acceleration [m/s²]")
    _lines(chart, run, run.series.own_time_s, in_the_air, "m/s²")
    return finished(chart, run.summary.limit("acceleration_m_s2"), "limit")


def face_chart(run: EvaluatedRun) -> go.Figure | None:
    """Return flux metric and coverage of the flown face."""
    if run.series is None or not np.isfinite(run.series.flux_metric).any():
        return None
    chart = empty_chart(run, "share [0 to 1]", height=270)
    for name, values, colour in (
        ("flux metric", run.series.flux_metric, "#0072b2"),
        ("coverage", run.series.coverage, "#e69f00"),
    ):
        add_line(chart, run.series.time_s, values, name, colour, "")
    chart.update_yaxes(range=[-0.03, 1.06])
    return chart


def separation_chart(run: EvaluatedRun) -> go.Figure | None:
    """Return the distance of the closest pair."""
    if run.series is None or not np.isfinite(run.series.separation_m).any():
        return None
    chart = empty_chart(run, "closest pair [m]", height=270)
    add_line(chart, run.series.time_s, run.series.separation_m, "closest pair", "#0072b2", "m")
    return finished(chart, run.number("separation_m"), "minimum")


def tracking_chart(run: EvaluatedRun) -> go.Figure | None:
    """Return every vehicle's distance from its setpoint in the stages that follow a plan."""
    if run.series is None or not any(np.isfinite(error).any() for error in run.series.error_m):
        return None
    chart = empty_chart(run, "distance from setpoint [m]", height=270)
    _lines(chart, run, run.series.own_time_s, run.series.error_m, "m")
    chart.update_yaxes(rangemode="tozero")
    return chart


def lateness_chart(run: EvaluatedRun) -> go.Figure | None:
    """Return how late every round of setpoints was sent."""
    times, late_ms = run.ticks["time_s"], run.ticks["late_s"] * 1e3
    if not len(times):
        return None
    chart = empty_chart(run, "lateness [ms]", height=230)
    add_line(chart, times, late_ms, "lateness", "#0072b2", "ms")
    period_ms = None if run.mission is None else 1e3 / run.mission.stream.rate_hz
    return finished(chart, period_ms, "one period")


def centre_chart(run: EvaluatedRun) -> go.Figure | None:
    """Return how far the formation's centre was from its place around the target, by the truth and by the estimate."""
    followed, replans = run.followed, run.replans
    if followed is None or not len(replans["time_s"]):
        return None
    chart = empty_chart(run, "distance from the target's place [m]")
    if run.true_target is not None and run.series is not None:
        off = flown_error(run.series, run.leaders, followed, run.true_target)
        if off is not None:
            add_line(chart, off[0], np.maximum(off[1], LEAST_M), "flown, true target", INK, "m")
    for mode in FollowMode:
        active = replans["mode"] == mode.name.lower()
        if active.any():
            active[1:] |= active[:-1].copy()  # each piece reaches to where the next mode begins
            values = np.where(active, np.maximum(replans["error_m"], LEAST_M), np.nan)
            add_line(chart, replans["time_s"], values, mode.value, MODE_COLOURS[mode], "m")
    finished(chart, followed.capture_m, "caught within")
    chart.update_yaxes(type="log", dtick=1)  # from the whole way down to decimetres
    return chart


def sightings_chart(run: EvaluatedRun) -> go.Figure | None:
    """Return how far sightings lay from the target, taken ones and refused ones apart."""
    sightings, target = run.sightings, run.true_target or run.estimated_target
    if target is None or not len(sightings["time_s"]):
        return None
    chart = empty_chart(run, "distance from the target [m]", height=270)
    away = np.linalg.norm(sightings["position_enu_m"] - target.at(sightings["time_s"]), axis=1)
    for verdict in Verdict:
        chosen = np.flatnonzero((sightings["verdict"] == verdict.name.lower()) & np.isfinite(away))
        if len(chosen):
            chosen = chosen[:: -(-len(chosen) // MOST_MARKS)]
            refused = verdict not in SEEN_COLOURS
            marker = {
                "color": SEEN_COLOURS.get(verdict, FAULT_COLOUR),
                "size": 8 if refused else 4,
                "symbol": "x" if refused else "circle",
            }
            chart.add_trace(
                go.Scatter(
                    x=sightings["received_s"][chosen].astype(np.float32), y=away[chosen].astype(np.float32),
                    name=f"{'refused: ' if refused else ''}{verdict.name.lower().replace('_', ' ')}",
                    mode="markers", marker=marker, hovertemplate="%{y:.2f} m at %{x:.2f} s",
                )
            )  # fmt: skip
    chart.update_layout(showlegend=True)
    chart.update_yaxes(rangemode="tozero")
    return chart


def size_chart(run: EvaluatedRun) -> go.Figure | None:
    """Return how large the targets' ball was believed to be, and the circle in the face that has to hold it.

    None where there was no ball: a single target that was seen all the time is a point.
    """
    followed, replans, series = run.followed, run.replans, run.series
    if followed is None or series is None or not (replans["radius_m"] > 0.0).any():
        return None
    chart = empty_chart(run, "radius [m]", height=270)
    add_line(chart, replans["time_s"], replans["radius_m"], "ball that holds what is surrounded", "#0072b2", "m")
    sizes = flown_scale(series, run.leaders, followed)
    if sizes is not None:
        inscribed_m = Formation(followed.leaders_m, np.empty((0, 3))).inscribed_radius_m
        add_line(chart, sizes[0], inscribed_m * sizes[1], "circle in the face, flown", INK, "m")
    return finished(chart, None, "")


def age_chart(run: EvaluatedRun) -> go.Figure | None:
    """Return how old the newest sighting was whenever a trajectory was planned."""
    replans = run.replans
    if run.followed is None or not len(replans["time_s"]):
        return None
    chart = empty_chart(run, "age [s]", height=230)
    add_line(chart, replans["time_s"], replans["age_s"], "age of what is known", "#0072b2", "s")
    return finished(chart, run.followed.lost_after_s, "lost after")


def colour_of(run: EvaluatedRun, vehicle: VehicleAddress) -> str:
    """Return the colour that a vehicle has in every picture."""
    if vehicle not in run.leaders:
        return FOLLOWER_COLOUR
    return LEADER_COLOURS[run.leaders.index(vehicle) % len(LEADER_COLOURS)]


def thinned(values: Array, points: int) -> NDArray[np.intp]:
    """Return the indices of at most ``points`` samples that keep every peak and dip, ascending.

    Args:
        values: shape (T,); NaN marks gaps, which stay.
        points: an even number, >= 2.
    """
    if len(values) <= points:
        return np.arange(len(values))
    buckets = points // 2
    width = -(-len(values) // buckets)
    index = np.minimum(np.arange(buckets * width), len(values) - 1).reshape(buckets, width)
    inside, rows = values[index], np.arange(buckets)
    peaks = np.where(np.isnan(inside), -np.inf, inside).argmax(axis=1)
    dips = np.where(np.isnan(inside), np.inf, inside).argmin(axis=1)
    return np.unique(np.concatenate((index[rows, peaks], index[rows, dips])))


def empty_chart(run: EvaluatedRun, title: str, height: int = 330) -> go.Figure:
    """Return an empty chart with the stages behind it and red marks where something went wrong."""
    chart = go.Figure()
    begin_s, end_s = run.span_s
    for stage, from_s, to_s in run.bands:
        chart.add_shape(
            type="rect", xref="x", yref="paper", x0=from_s, x1=to_s, y0=0, y1=1, layer="below",
            fillcolor=BAND_COLOURS[stage], line={"width": 0},
        )  # fmt: skip
        if to_s - from_s > NARROWEST_LABEL * (end_s - begin_s):
            middle = (from_s + to_s) / 2
            chart.add_annotation(_label(middle, stage, "#607d8b"))
    for event in run.events:
        if event.kind in ("abort", "fault"):
            chart.add_shape(
                type="line", xref="x", yref="paper", x0=event.time_s, x1=event.time_s, y0=0, y1=1,
                line={"color": FAULT_COLOUR, "width": 1.5, "dash": "dot"},
            )  # fmt: skip
            beside = {"y": 0.99, "yanchor": "top", "xanchor": "left", "xshift": 2}
            chart.add_annotation(_label(event.time_s, event.kind, FAULT_COLOUR) | beside)
    chart.update_layout(
        template="none",
        height=height,
        margin=MARGIN,
        font={"family": "system-ui, sans-serif", "size": 12, "color": INK},
        hovermode="closest",
        legend={"x": 1.01, "y": 1, "yanchor": "top", "tracegroupgap": 0, "itemsizing": "constant"},
        plot_bgcolor="#ffffff",
    )
    chart.update_xaxes(
        range=[begin_s, end_s], title={"text": "time since the run's start [s]", "standoff": 6},
        gridcolor="#dfe4e8", zeroline=False, ticks="outside",
    )  # fmt: skip
    chart.update_yaxes(title={"text": title}, gridcolor="#dfe4e8", zeroline=False)
    return chart


def _label(time_s: float, text: str, colour: str) -> dict[str, Any]:
    return {
        "x": time_s, "y": 1.0, "xref": "x", "yref": "paper", "yanchor": "bottom", "showarrow": False,
        "text": text, "font": {"size": 11, "color": colour},
    }  # fmt: skip


def finished(chart: go.Figure, limit: float | None, name: str) -> go.Figure:
    """Draw the limit, if there is one, and let the axis begin at zero."""
    if limit is not None:
        span = list(chart.layout.xaxis.range)
        chart.add_trace(
            go.Scatter(
                x=span, y=[limit, limit], name=f"{name} {limit:g}", mode="lines", hoverinfo="name",
                line={"color": LIMIT_COLOUR, "width": 1.5, "dash": "dash"},
            )
        )  # fmt: skip
    chart.update_yaxes(rangemode="tozero")
    return chart


def _lines(chart: go.Figure, run: EvaluatedRun, times: Sequence[Array], values: Sequence[Array], unit: str) -> None:
    """Draw one line a vehicle: followers first, so that the leaders lie on top of them."""
    assert run.series is not None  # there are times and values of every vehicle
    vehicles, leaders = run.series.vehicles, run.leaders
    points = min(POINTS_PER_LINE, 2 * max(50, POINTS_PER_CHART // len(vehicles) // 2))
    followers_listed = False
    places = [leaders.index(vehicle) if vehicle in leaders else -1 for vehicle in vehicles]
    for row in sorted(range(len(vehicles)), key=lambda row: places[row]):
        vehicle, leads = vehicles[row], places[row] >= 0
        chart.add_trace(
            _trace(times[row], values[row], f"{'leader' if leads else 'vehicle'} {vehicle}", unit, points).update(
                line={"color": colour_of(run, vehicle), "width": 1.6 if leads else 1.0},
                legendgroup=f"leader {vehicle}" if leads else "followers",
                showlegend=leads,
                legendrank=2,
            )
        )
        if not leads and not followers_listed:
            followers_listed = True
            chart.add_trace(
                go.Scatter(
                    x=[None], y=[None], name="followers" if leaders else "vehicles", mode="lines",
                    legendgroup="followers", line={"color": FOLLOWER_COLOUR, "width": 2}, legendrank=3,
                )
            )  # fmt: skip


def add_line(chart: go.Figure, times: Array, values: Array, name: str, colour: str, unit: str) -> None:
    """Draw one line, (T,) over (T,) [s]; NaN leaves a gap."""
    chart.add_trace(_trace(times, values, name, unit, POINTS_PER_LINE).update(line={"color": colour, "width": 1.6}))
    chart.update_layout(showlegend=True)


def _trace(times: Array, values: Array, name: str, unit: str, points: int) -> go.Scatter:
    keep = thinned(values, points)
    return go.Scatter(
        x=times[keep].astype(np.float32),  # a tenth of a millisecond in a quarter of an hour, at half the size
        y=values[keep].astype(np.float32),
        name=name,
        mode="lines",
        hovertemplate=f"%{{y:.3f}} {unit} at %{{x:.2f}} s",
    )
