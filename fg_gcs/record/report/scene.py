"""The report's rotatable picture: where every vehicle was told to fly, and where it flew."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.record.evaluate.evaluation import EvaluatedRun
from fg_gcs.record.evaluate.figures import PLANNED_STAGES
from fg_gcs.record.read.tables import rows_of, vehicles_in
from fg_gcs.record.report.charts import INK, colour_of
from fg_gcs.record.write.layouts import Columns
from fg_gcs.wire.address import VehicleAddress

POINTS_PER_PATH = 400  # straight pieces of a decimetre or so: smooth from any side
POINTS_IN_ALL = 25_000  # under half a megabyte each for the ways out, the ways home and the plans
FLATTEST = 0.2  # shortest axis against the longest: room enough for its labels
TARGET_COLOUR, FACE_COLOUR, PLAN_COLOUR, PAD_COLOUR = "#c62828", "#e6a700", "#78909c", "#455a64"
ESTIMATE_COLOUR = "#f4a3a0"


def scene(run: EvaluatedRun) -> go.Figure | None:
    """Return flown and planned paths, faces, pads and target; None when there is no sample at all."""
    vehicles, leaders = vehicles_in(run.telemetry), run.leaders
    if not vehicles:
        return None
    figure = go.Figure()
    points = min(POINTS_PER_PATH, max(50, POINTS_IN_ALL // len(vehicles)))
    turn_s = next((band.begin_s for band in run.bands if band.stage == "home"), np.inf)
    out, back = _between(run.telemetry, -np.inf, turn_s), _between(run.telemetry, turn_s, np.inf)
    for vehicle in sorted(vehicles, key=lambda each: leaders.index(each) if each in leaders else len(leaders)):
        _add_flown(figure, run, vehicle, along(_path_of(out, vehicle), points))
    for vehicle in vehicles:
        _add_return(figure, run, vehicle, along(_path_of(back, vehicle), points))
    following = [band for band in run.bands if band.stage in PLANNED_STAGES]
    span = (following[0].begin_s, following[-1].end_s) if following else (0.0, 0.0)
    setpoints = _between(run.setpoints, *span)
    planned = [along(_path_of(setpoints, vehicle), points) for vehicle in vehicles]
    _add_group(
        figure, [path for path in planned if len(path)], "planned paths", PLAN_COLOUR, {"width": 2, "dash": "dot"}
    )
    _add_faces(figure, run)
    pads = np.concatenate([_path_of(run.telemetry, vehicle)[:1] for vehicle in vehicles])
    _add_points(figure, pads, "where they stood", PAD_COLOUR, "square", 3)
    places = np.concatenate([_path_of(run.telemetry, vehicle) for vehicle in vehicles] + _add_target(figure, run))
    figure.update_layout(
        template="none",
        height=640,
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        font={"family": "system-ui, sans-serif", "size": 12, "color": INK},
        legend={
            "x": 1.0,
            "xanchor": "right",
            "y": 0.94,
            "tracegroupgap": 0,
            "itemsizing": "constant",
            "bgcolor": "rgba(255,255,255,0.8)",
        },
        scene=_view(places) | {"camera": {"eye": _eye(pads, run.target_enu_m), "center": {"x": 0, "y": 0, "z": -0.1}}},
    )
    return figure


def along(path: Array, points: int) -> Array:
    """Return at most ``points`` samples of a path, evenly spread along its way; shape (T, 3) to (P, 3) [m]."""
    if len(path) <= points:
        return path
    way = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
    index = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], points)))
    chosen: Array = path[np.minimum(index, len(path) - 1)]
    return chosen


def _view(places: Array) -> dict[str, Any]:
    """Return axes of equal scale around all places; the longest is 1.2 long, however flat or long the flight."""
    if not len(places):
        places = np.zeros((1, 3))
    low, high = places.min(axis=0), places.max(axis=0)
    longest = max(float((high - low).max()), 1.0)
    spans = np.maximum(1.06 * (high - low), FLATTEST * longest)
    begins = (low + high - spans) / 2.0
    look = {"backgroundcolor": "#f7f9fa", "gridcolor": "#d5dbe0", "showbackground": True, "zeroline": False}
    view: dict[str, Any] = {"aspectmode": "manual", "aspectratio": dict(zip("xyz", 1.2 * spans / longest, strict=True))}
    for axis, title, begin, span in zip("xyz", ("east", "north", "up"), begins, spans, strict=True):
        view[f"{axis}axis"] = {"title": {"text": f"{title} [m]"}, "range": [begin, begin + span], **look}
    return view


def _eye(pads: Array, target_enu_m: Array | None) -> dict[str, float]:
    """Return where to look from: from the right of the way to the target and a little behind, so that faces show."""
    way = np.array([0.0, 1.0, 0.0]) if target_enu_m is None or not len(pads) else target_enu_m - pads.mean(axis=0)
    bearing = float(np.arctan2(way[1], way[0])) - np.deg2rad(120.0)
    return {"x": 2.0 * float(np.cos(bearing)), "y": 2.0 * float(np.sin(bearing)), "z": 0.7}


def _path_of(columns: Columns, vehicle: VehicleAddress) -> Array:
    path: Array = columns["position_enu_m"][rows_of(columns, vehicle)]
    known: Array = path[np.isfinite(path).all(axis=1)]
    return known


def _between(columns: Columns, begin_s: float, end_s: float) -> Columns:
    inside = (columns["time_s"] >= begin_s) & (columns["time_s"] < end_s)
    return {name: column[inside] for name, column in columns.items()}


def _add_flown(figure: go.Figure, run: EvaluatedRun, vehicle: VehicleAddress, path: Array) -> None:
    """Draw a vehicle's way up to and around the target: a leader under its own name."""
    leads = vehicle in run.leaders
    name = f"leader {vehicle}" if leads else "followers" if run.leaders else "vehicles"
    width = 5.0 if leads else 2.5
    _add_path(figure, path, name, _hover(vehicle), {"color": colour_of(run, vehicle), "width": width})


def _add_return(figure: go.Figure, run: EvaluatedRun, vehicle: VehicleAddress, path: Array) -> None:
    """Draw a vehicle's way home, so thin that it does not hide the approach."""
    if len(path):
        _add_path(figure, path, "way home", _hover(vehicle), {"color": colour_of(run, vehicle), "width": 1.5})


def _add_path(figure: go.Figure, path: Array, group: str, hover: str, line: dict[str, Any]) -> None:
    """Draw a path; the legend lists its group once."""
    listed = any(trace.legendgroup == group for trace in figure.data)
    figure.add_trace(
        go.Scatter3d(
            **_xyz(path), mode="lines", line=line, name=group, legendgroup=group, showlegend=not listed,
            hovertemplate=hover,
        )
    )  # fmt: skip


def _hover(vehicle: VehicleAddress) -> str:
    return f"vehicle {vehicle}<br>%{{x:.1f}}, %{{y:.1f}}, %{{z:.1f}} m<extra></extra>"


def _add_group(figure: go.Figure, paths: list[Array], name: str, colour: str, line: dict[str, Any]) -> None:
    """Draw paths that the legend shows and hides as one: a single line with gaps."""
    if paths:
        gap = np.full((1, 3), np.nan)
        joined = np.concatenate([part for path in paths for part in (path, gap)])
        figure.add_trace(
            go.Scatter3d(**_xyz(joined), mode="lines", name=name, hoverinfo="skip", line={"color": colour, **line})
        )


def _add_faces(figure: go.Figure, run: EvaluatedRun) -> None:
    """Draw the leaders' polygon at the approach's begin and middle and at the hold's."""
    series, moments = run.series, []
    if "approach" in run.stages:
        begin_s, end_s = run.stages["approach"]
        moments = [begin_s, (begin_s + end_s) / 2.0]
    if "hold" in run.stages:
        moments.append(sum(run.stages["hold"]) / 2.0)
    rims = None if series is None else series.places_m(run.leaders)
    if series is None or rims is None or len(run.leaders) < 3:
        return
    faces = []
    for moment in moments:
        if series.time_s[0] <= moment <= series.time_s[-1]:
            rim = rims[np.abs(series.time_s - moment).argmin()]
            faces.append(np.concatenate((rim, rim[:1])))
            count = len(rim)
            fan = {"i": [count] * count, "j": list(range(count)), "k": [*range(1, count), 0]}
            corners = np.concatenate((rim, rim.mean(axis=0, keepdims=True)))
            figure.add_trace(
                go.Mesh3d(**_xyz(corners), **fan, color=FACE_COLOUR, opacity=0.3, hoverinfo="skip", legendgroup="face")
            )
    _add_group(figure, faces, "face (begin, middle, hold)", FACE_COLOUR, {"width": 4})
    if faces:
        figure.data[-1].legendgroup = "face"


def _add_target(figure: go.Figure, run: EvaluatedRun) -> list[Array]:
    """Draw the target, and where it went if it moved; return the places of that."""
    if run.target_enu_m is None:
        return []
    moves = run.followed is not None
    name = "target at first" if moves else "target"
    _add_points(figure, run.target_enu_m[None], name, TARGET_COLOUR, "diamond", 7)
    places = [run.target_enu_m[None]]
    for where, what, colour in (
        (run.estimated_target, "target as estimated", ESTIMATE_COLOUR),
        (run.true_target, "target's true way", TARGET_COLOUR),
    ):
        if where is not None:
            path = along(where.position_m, POINTS_PER_PATH)
            _add_group(figure, [path], what, colour, {"width": 4})
            places.append(path)
    return places


def _add_points(figure: go.Figure, places: Array, name: str, colour: str, symbol: str, size: int) -> None:
    figure.add_trace(
        go.Scatter3d(
            **_xyz(places), mode="markers", name=name,
            marker={"color": colour, "symbol": symbol, "size": size},
            hovertemplate=f"{name}<br>%{{x:.1f}}, %{{y:.1f}}, %{{z:.1f}} m<extra></extra>",
        )
    )  # fmt: skip


def _xyz(places: Array) -> dict[str, NDArray[np.float32]]:
    """Return coordinates as plotly takes them; single precision is a hundredth of a millimetre at 100 m."""
    return dict(zip("xyz", places.astype(np.float32).T, strict=True))
