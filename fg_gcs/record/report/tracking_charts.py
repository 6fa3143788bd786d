"""The report's charts of a flight after targets that move: how far off, what was seen, how old that was."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from fg_gcs.core.formation import Formation
from fg_gcs.record.evaluate.tracking import flown_error, flown_scale
from fg_gcs.record.read.run import Run
from fg_gcs.record.report.charts import FAULT_COLOUR, FOLLOWER_COLOUR, INK, add_line, empty_chart, finished
from fg_gcs.track.follow.replanner import FollowMode
from fg_gcs.track.sightings import Verdict

MODE_COLOURS = {
    FollowMode.WAIT: "#cc79a7",
    FollowMode.TURN: "#e69f00",
    FollowMode.APPROACH: "#0072b2",
    FollowMode.FOLLOW: "#009e73",
}
SEEN_COLOURS = {Verdict.TAKEN: FOLLOWER_COLOUR, Verdict.TENTATIVE: "#56b4e9"}  # any other is a refusal
LEAST_M = 0.05  # what is less is drawn as this: on a logarithmic axis the zeros of a difference reach down for ever
MOST_MARKS = 4000  # of one kind in one chart: more than a browser's pixels tell apart


def centre_chart(run: Run) -> go.Figure | None:
    """Return how far the formation's centre was from its place around the target, by the truth and by the estimate."""
    followed, replans = run.followed, run.replans
    if followed is None or not len(replans["time_s"]):
        return None
    chart = empty_chart(run, "distance from the target's place [m]")
    if run.true_target is not None and run.series is not None:
        off = flown_error(run.series, run.leaders, followed, run.true_target)
        if off is not None:
            add_line(chart, off[0], np.maximum(off[1], LEAST_M), "flown, true target", INK, "m")
    modes = replans["mode"].astype(int)
    for index, mode in enumerate(FollowMode):
        if (modes == index).any():
            active = modes == index
            active[1:] |= modes[:-1] == index  # each piece reaches to where the next mode begins
            values = np.where(active, np.maximum(replans["error_m"], LEAST_M), np.nan)
            add_line(chart, replans["time_s"], values, mode.value, MODE_COLOURS[mode], "m")
    finished(chart, followed.capture_m, "caught within")
    chart.update_yaxes(type="log", dtick=1)  # from the whole way down to decimetres
    return chart


def sightings_chart(run: Run) -> go.Figure | None:
    """Return how far sightings lay from the target, taken ones and refused ones apart."""
    sightings, target = run.sightings, run.true_target or run.estimated_target
    if target is None or not len(sightings["time_s"]):
        return None
    chart = empty_chart(run, "distance from the target [m]", height=270)
    away = np.linalg.norm(sightings["position_enu_m"] - target.at(sightings["time_s"]), axis=1)
    codes = sightings["verdict"].astype(int)
    for index, verdict in enumerate(Verdict):
        chosen = np.flatnonzero((codes == index) & np.isfinite(away))
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


def size_chart(run: Run) -> go.Figure | None:
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


def age_chart(run: Run) -> go.Figure | None:
    """Return how old the newest sighting was whenever a trajectory was planned."""
    replans = run.replans
    if run.followed is None or not len(replans["time_s"]):
        return None
    chart = empty_chart(run, "age [s]", height=230)
    add_line(chart, replans["time_s"], replans["age_s"], "age of what is known", "#0072b2", "s")
    return finished(chart, run.followed.lost_after_s, "lost after")
