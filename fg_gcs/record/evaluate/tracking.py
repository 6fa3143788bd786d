"""What the tables say about tracking: where targets were, how far off the formation was, how soon it reacted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import least_after_facing
from fg_gcs.record.evaluate.figures import Flown, Whereabouts, interpolated
from fg_gcs.record.read.tables import rows_of, vehicles_in
from fg_gcs.record.write.layouts import Columns
from fg_gcs.track.sightings import Verdict
from fg_gcs.wire.address import VehicleAddress

SETTLED_S = 2.0  # after the capture, which is when the formation still moves in: errors count from here on
TAKEN = Verdict.TAKEN.name.lower()  # as the tables have it
HOLDING = 0.9  # a flux metric from here on counts as held
RATE_HZ = 50.0  # instants at which errors are looked at, a second
KEYS = (
    "centre_error_rms_m",
    "centre_error_p95_m",
    "centre_error_commanded_rms_m",
    "capture_time_s",
    "sensed_to_setpoint_p99_ms",
    "stamp_to_setpoint_p99_ms",
    "commanded_position_step_max_m",
    "commanded_velocity_step_max_m_s",
    "flux_metric_share",
)


@dataclass(frozen=True)
class Followed:
    """What a flight with moving targets was about; times since the start of the run."""

    began_s: float
    ended_s: float
    caught_s: float | None
    weights: tuple[float, ...]  # of the targets, in the mission's order
    leaders_m: Array  # (N, 3) rim of the template in its winding order
    hold_depth_m: float
    capture_m: float
    lost_after_s: float


def true_centre(truth: Columns, weights: Sequence[float]) -> Whereabouts | None:
    """Return where the centre of all targets truly was; None where that is not known."""
    count = len(weights)
    whole = len(truth["time_s"]) // count * count  # the end of the table may be cut off
    time_s = truth["time_s"][:whole:count]
    centre = np.average(truth["position_enu_m"][:whole].reshape(-1, count, 3), axis=1, weights=np.array(weights))
    known = np.isfinite(centre).all(axis=1)
    return Whereabouts(time_s[known], centre[known]) if known.any() else None


def estimated_centre(replans: Columns) -> Whereabouts | None:
    """Return where the centre of all targets was believed to be; None before anything was known."""
    return Whereabouts(replans["time_s"], replans["position_enu_m"]) if len(replans["time_s"]) else None


class Fit(NamedTuple):
    """The formation's frame over T instants."""

    centre_enu_m: Array  # (T, 3)
    attitude: Array  # (T, 3, 3) template axes to ENU
    scale: Array  # (T,)


def fitted(rims_enu_m: Array, leaders_m: Array) -> Fit:
    """Return the best fit of the template to the leaders [Kabsch1976]_.

    Args:
        rims_enu_m: leaders over time in their winding order, shape (T, N, 3) [m].
        leaders_m: their slots, shape (N, 3) [m; template].
    """
    middle, middles = leaders_m.mean(axis=0), rims_enu_m.mean(axis=1)
    arms = leaders_m - middle
    spread = np.einsum("ni,tnk->tik", arms, rims_enu_m - middles[:, None])
    left, sizes, right = np.linalg.svd(spread)
    signs = np.ones_like(sizes)
    signs[:, 2] = np.sign(np.linalg.det(left @ right))
    attitude = np.einsum("tak,ta,tia->tki", right, signs, left)  # template axes to ENU
    scale = (sizes * signs).sum(axis=1) / (arms**2).sum()
    return Fit(middles - scale[:, None] * (attitude @ middle), attitude, scale)


def held_places(rims_enu_m: Array, leaders_m: Array, hold_depth_m: float) -> Array:
    """Return where a target is if the formation holds it, so far behind the face [m]: shape (T, 3) [m; ENU]."""
    fit = fitted(rims_enu_m, leaders_m)
    places: Array = fit.centre_enu_m - hold_depth_m * fit.attitude[:, :, 0]
    return places


def flown_scale(series: Flown, leaders: Sequence[VehicleAddress], followed: Followed) -> tuple[Array, Array] | None:
    """Return instants of the tracking and the flown formation's size then, times the template, (T,), (T,).

    None unless all leaders, in their winding order, were heard.
    """
    rims = series.places_m(leaders)
    if rims is None:
        return None
    inside = (series.time_s >= followed.began_s) & (series.time_s <= followed.ended_s)
    return series.time_s[inside], fitted(rims[inside], followed.leaders_m).scale


def flown_error(
    series: Flown, leaders: Sequence[VehicleAddress], followed: Followed, target: Whereabouts
) -> tuple[Array, Array] | None:
    """Return instants of the tracking and how far the flown formation's centre was from its place then, (T,), (T,).

    None unless all leaders, in their winding order, were heard.
    """
    rims = series.places_m(leaders)
    if rims is None:
        return None
    inside = (series.time_s >= followed.began_s) & (series.time_s <= followed.ended_s)
    return series.time_s[inside], _error(rims[inside], series.time_s[inside], followed, target)


def commanded_error(
    setpoints: Columns, leaders: Sequence[VehicleAddress], followed: Followed, target: Whereabouts
) -> tuple[Array, Array] | None:
    """Return the same of the setpoints; None unless all leaders got some."""
    time_s = np.arange(followed.began_s, followed.ended_s, 1.0 / RATE_HZ)
    rows = [rows_of(setpoints, leader) for leader in leaders]
    if not rows or not all(row.any() for row in rows):
        return None
    ways = [interpolated(time_s, setpoints["time_s"][row], setpoints["position_enu_m"][row]) for row in rows]
    return time_s, _error(np.stack(ways, axis=1), time_s, followed, target)


def found_again(time_s: Array, error_m: Array, sightings: Columns, followed: Followed) -> list[float | None]:
    """Return for every loss how long after the first new sighting the error was below the capture's; None: never."""
    believed = sightings["verdict"] == TAKEN
    taken, received = sightings["received_s"][believed], sightings["received_s"]
    found: list[float | None] = []
    for last in np.flatnonzero(np.diff(taken) > followed.lost_after_s):
        seen_s = float(received[received > taken[last]][0])
        there = time_s[(time_s >= seen_s) & (error_m < followed.capture_m)]
        found.append(float(there[0] - seen_s) if len(there) else None)
    return found


def reaction_s(replans: Columns, setpoints: Columns) -> Array:
    """Return the time from a sighting's arrival to the first setpoint of the trajectory it led to, one for each."""
    arrived, left = _reactions(replans, setpoints)
    return left - arrived


def latency_s(replans: Columns, setpoints: Columns, sightings: Columns) -> Array:
    """Return the same from the sighting's stamp on, so with the sensor's own delay."""
    arrived, left = _reactions(replans, setpoints)
    taken = sightings["verdict"] == TAKEN
    stamps, arrivals = sightings["time_s"][taken], sightings["received_s"][taken]
    which = np.searchsorted(arrivals, arrived)
    known = which < len(stamps)
    latency: Array = left[known] - stamps[which[known]]
    return latency


def _reactions(replans: Columns, setpoints: Columns) -> tuple[Array, Array]:
    """Return when the sighting that led to each trajectory came, and when the trajectory's first setpoint left."""
    waited = np.isfinite(replans["sighted_s"]) & replans["taken"]
    sighted, planned = replans["sighted_s"][waited], replans["planned_s"][waited]
    after = np.searchsorted(setpoints["time_s"], planned, side="right")
    left = after < len(setpoints["time_s"])
    return sighted[left], setpoints["time_s"][after[left]]


def commanded_steps(setpoints: Columns, span_s: tuple[float, float], acceleration_m_s2: float) -> tuple[float, float]:
    """Return the largest jumps between a vehicle's consecutive setpoints that their own derivatives do not explain.

    Args:
        setpoints: columns of the setpoint table.
        span_s: which of them, by their time [s].
        acceleration_m_s2: limit of the vehicles.

    Returns:
        Of positions, beyond the mean of both velocities [m]; of velocities, beyond the limit, never below 0 [m/s].
    """
    inside = (setpoints["time_s"] >= span_s[0]) & (setpoints["time_s"] <= span_s[1])
    position, velocity = 0.0, 0.0
    for vehicle in vehicles_in(setpoints):
        mine = inside & rows_of(setpoints, vehicle)
        step_s = np.diff(setpoints["time_s"][mine])
        way, speed = setpoints["position_enu_m"][mine], setpoints["velocity_enu_m_s"][mine]
        explained = 0.5 * step_s[:, None] * (speed[1:] + speed[:-1])
        jumps = np.linalg.norm(np.diff(way, axis=0) - explained, axis=1)
        gains = np.linalg.norm(np.diff(speed, axis=0), axis=1) - acceleration_m_s2 * step_s
        position, velocity = max(position, jumps.max(initial=0.0)), max(velocity, gains.max(initial=0.0))
    return float(position), float(velocity)


def tracking_figures(
    series: Flown | None, leaders: Sequence[VehicleAddress], followed: Followed, tables: Mapping[str, Columns]
) -> dict[str, object]:
    """Return the figures of the tracking by the names of the command line's JSON; None where there is nothing.

    Args:
        series: of the flight, with flux and coverage of the target as well as it is known.
        leaders: in their winding order; figures of the formation need all of them.
        followed: what it was about.
        tables: columns of the run's tables, by their names.
    """
    result: dict[str, object] = dict.fromkeys(KEYS)
    result |= {"found_again_s": [], "replans": len(tables["replans"]["time_s"])}
    reaction = reaction_s(tables["replans"], tables["setpoints"])
    if len(reaction):
        result["sensed_to_setpoint_p99_ms"] = 1e3 * float(np.percentile(reaction, 99))
    latency = latency_s(tables["replans"], tables["setpoints"], tables["sightings"])
    if len(latency):
        result["stamp_to_setpoint_p99_ms"] = 1e3 * float(np.percentile(latency, 99))
    if followed.caught_s is not None:
        result["capture_time_s"] = followed.caught_s - followed.began_s
    truth = true_centre(tables["truth"], followed.weights)
    target = truth or estimated_centre(tables["replans"])
    off = None if series is None or target is None else flown_error(series, leaders, followed, target)
    if series is None or off is None:
        return result
    time_s, error = off
    result["found_again_s"] = found_again(time_s, error, tables["sightings"], followed)
    if followed.caught_s is None:
        return result
    after = (series.time_s >= followed.caught_s) & (series.time_s <= followed.ended_s)
    if after.any():
        result["flux_metric_share"] = float((series.flux_metric[after] >= HOLDING).mean())
    settled = error[time_s >= followed.caught_s + SETTLED_S]
    if truth is not None and len(settled):
        result["centre_error_rms_m"] = float(np.sqrt((settled**2).mean()))
        result["centre_error_p95_m"] = float(np.percentile(settled, 95))
        commanded = commanded_error(tables["setpoints"], leaders, followed, truth)
        if commanded is not None:
            told = commanded[1][commanded[0] >= followed.caught_s + SETTLED_S]
            result["centre_error_commanded_rms_m"] = float(np.sqrt((told**2).mean()))
    return result


def coverage_after_facing(series: Flown, span_s: tuple[float, float]) -> float | None:
    """Return the smallest coverage between two times [s], from when it first faces the target."""
    return least_after_facing(series.coverage[(series.time_s >= span_s[0]) & (series.time_s <= span_s[1])])


def _error(rims: Array, time_s: Array, followed: Followed, target: Whereabouts) -> Array:
    places = held_places(rims, followed.leaders_m, followed.hold_depth_m)
    error: Array = np.linalg.norm(places - target.at(time_s), axis=1)
    return error
