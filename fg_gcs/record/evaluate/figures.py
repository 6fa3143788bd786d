"""What the telemetry says about a flight: every ``flown_`` figure is computed here from the tables alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.core.coverage import coverage, flux_metric
from fg_gcs.core.separation import closest_approach, smallest_over_time
from fg_gcs.record.read.tables import rows_of, vehicles_in
from fg_gcs.record.write.layouts import Columns
from fg_gcs.wire.address import VehicleAddress

ACCELERATION_SPAN_S = 0.1  # velocity differences over less drown in the millisecond stamps of the vehicles' clocks
AIRBORNE_M = 0.3  # below this height a vehicle touches down or lifts off: ground contact is no flown acceleration
GRID_HZ = 50.0  # common instants for what concerns several vehicles at once
MOST_SAMPLES = 50_000_000  # of all vehicles on them: 250 vehicles for an hour, in a gigabyte
FLOWN_KEYS = (
    "flown_flux_metric",
    "flown_peak_speed_m_s",
    "flown_peak_acceleration_m_s2",
    "flown_min_separation_m",
    "tracking_rms_m",
    "tracking_max_m",
    "setpoint_rate_hz",
    "setpoint_late_p99_ms",
)
BLOCK = 10_000  # instants whose faces are measured together: some megabytes of work space, however long the flight
TRACK = (
    "time_s",
    "position_enu_m",
    "velocity_enu_m_s",
    "boot_time_s",
    "height_m",
)  # what is wanted of a vehicle's rows
PLANNED_STAGES = ("gather", "approach", "hold", "home")


@dataclass(frozen=True)
class Whereabouts:
    """Where something was over time; before and after it stands still."""

    time_s: Array  # (T,) ascending, T >= 1 [s]
    position_m: Array  # (T, 3) [m; ENU]

    @classmethod
    def standing(cls, position_m: Array) -> Whereabouts:
        """Return those of something that never moves, shape (3,) [m; ENU]."""
        return cls(np.zeros(1), np.asarray(position_m, dtype=float)[None])

    def at(self, time_s: Array) -> Array:
        """Return where it was, shape (S,) [s] to (S, 3) [m; ENU]."""
        return interpolated(time_s, self.time_s, self.position_m)


@dataclass(frozen=True)
class Flown:
    """A flight's series on common instants, and per vehicle on its own samples."""

    vehicles: tuple[VehicleAddress, ...]  # all V that were heard, ascending
    time_s: Array  # (T,) common instants from the first to the last that all vehicles share
    position_m: Array  # (T, V, 3) [m; ENU]
    separation_m: Array  # (T,) closest pair
    flux_metric: Array  # (T,)
    coverage: Array  # (T,)
    own_time_s: tuple[Array, ...]  # per vehicle (S,)
    speed_m_s: tuple[Array, ...]
    acceleration_m_s2: tuple[Array, ...]
    airborne: tuple[NDArray[np.bool_], ...]
    error_m: tuple[Array, ...]  # distance from the setpoint; NaN outside the planned stages

    def places_m(self, vehicles: Sequence[VehicleAddress]) -> Array | None:
        """Return where these vehicles were, in this order, shape (T, N, 3) [m; ENU]; None unless all were heard."""
        row_of = {vehicle: row for row, vehicle in enumerate(self.vehicles)}
        rows = [row_of[vehicle] for vehicle in vehicles if vehicle in row_of]
        return self.position_m[:, rows] if len(rows) == len(vehicles) > 0 else None


def flown(
    telemetry: Columns,
    setpoints: Columns,
    stages: Mapping[str, tuple[float, float]],
    leaders: Sequence[VehicleAddress],
    target: Whereabouts,
) -> Flown | None:
    """Return the series of a flight, or None when the vehicles share no time in the tables, or far too much of it.

    Flux and coverage are NaN unless every leader was heard: a face without one of its corners is another face.

    Args:
        telemetry: columns of the telemetry table.
        setpoints: columns of the setpoint table.
        stages: begin and end of each stage of the flight [s].
        leaders: in the rim's winding order; fewer than 3 span no face.
        target: what is surrounded.
    """
    vehicles = vehicles_in(telemetry)
    times = [telemetry["time_s"][rows_of(telemetry, vehicle)] for vehicle in vehicles]
    if not times or min(map(len, times)) < 2:
        return None
    begin, end = max(own_s[0] for own_s in times), min(own_s[-1] for own_s in times)
    if end <= begin or (end - begin) * GRID_HZ * len(times) > MOST_SAMPLES:
        return None
    time_s = np.arange(begin, end, 1.0 / GRID_HZ)
    position = np.empty((len(time_s), len(vehicles), 3))
    speeds, accelerations, airborne, errors = [], [], [], []
    for row, vehicle in enumerate(vehicles):  # one after the other: an hour of one is some megabytes
        track = _rows(telemetry, vehicle, TRACK)
        position[:, row] = interpolated(time_s, track["time_s"], track["position_enu_m"])
        speeds.append(np.linalg.norm(track["velocity_enu_m_s"], axis=1))
        accelerations.append(_acceleration(track))
        airborne.append(track["height_m"] > AIRBORNE_M)
        errors.append(_errors(track, _rows(setpoints, vehicle, ("time_s", "position_enu_m")), stages))
    nothing = np.full(len(time_s), np.nan)
    series = Flown(
        vehicles=vehicles,
        time_s=time_s,
        position_m=position,
        separation_m=smallest_over_time(position) if len(vehicles) > 1 else nothing,
        flux_metric=nothing,
        coverage=nothing,
        own_time_s=tuple(times),
        speed_m_s=tuple(speeds),
        acceleration_m_s2=tuple(accelerations),
        airborne=tuple(airborne),
        error_m=tuple(errors),
    )
    rims = series.places_m(leaders)
    if rims is None or len(leaders) < 3:
        return series
    there = target.at(time_s)
    return replace(series, flux_metric=_in_blocks(flux_metric, rims, there), coverage=_in_blocks(coverage, rims, there))


def _in_blocks(measure: Callable[[Array, Array], Array], rims_enu_m: Array, target_enu_m: Array) -> Array:
    """Measure faces over time, (T, N, 3) and (T, 3) to (T,), some at a time."""
    starts = range(0, len(rims_enu_m), BLOCK)
    return np.concatenate([measure(rims_enu_m[k : k + BLOCK], target_enu_m[k : k + BLOCK]) for k in starts])


def figures(
    series: Flown | None, ticks: Columns, setpoints: Columns, stages: Mapping[str, tuple[float, float]]
) -> dict[str, float | None]:
    """Return a flight's figures by the names of the command line's JSON; None where there is nothing to measure."""
    result: dict[str, float | None] = dict.fromkeys(FLOWN_KEYS)
    if len(ticks["time_s"]):
        result["setpoint_late_p99_ms"] = float(np.percentile(ticks["late_s"], 99) * 1e3)
    result["setpoint_rate_hz"] = _slowest_rate(setpoints)
    if series is None:
        return result
    if "hold" in stages:
        holding = (series.time_s >= stages["hold"][0]) & (series.time_s <= stages["hold"][1])
        if holding.any() and np.isfinite(series.flux_metric[holding]).all():
            result["flown_flux_metric"] = float(series.flux_metric[holding].mean())
    errors = np.concatenate(series.error_m)
    planned = np.isfinite(errors)
    if planned.any():  # take-off and landing are the autopilots' own business: no plan of ours has a limit for them
        result["flown_peak_speed_m_s"] = float(np.concatenate(series.speed_m_s)[planned].max())
        accelerations = np.concatenate(series.acceleration_m_s2)[planned]
        known = accelerations[np.isfinite(accelerations)]
        result["flown_peak_acceleration_m_s2"] = float(known.max()) if len(known) else None
        result["tracking_rms_m"] = float(np.sqrt((errors[planned] ** 2).mean()))
        result["tracking_max_m"] = float(errors[planned].max())
    if len(series.vehicles) > 1:
        result["flown_min_separation_m"] = closest_approach(series.position_m, series.time_s).distance_m
    return result


def _rows(columns: Columns, vehicle: VehicleAddress, names: Sequence[str]) -> dict[str, Array]:
    mine = rows_of(columns, vehicle)
    return {name: columns[name][mine] for name in names}


def interpolated(at_s: Array, time_s: Array, values: Array) -> Array:
    """Return values between samples, constant beyond them; (S,), (T,) [s] and (T, K) to (S, K)."""
    return np.stack([np.interp(at_s, time_s, values[:, axis]) for axis in range(values.shape[1])], axis=1)


def _acceleration(track: Columns) -> Array:
    """Norm of the mean acceleration over the span before each sample, by the vehicle's own clock; NaN at first."""
    clock, velocity = track["boot_time_s"], track["velocity_enu_m_s"]
    earlier = np.searchsorted(clock, clock - ACCELERATION_SPAN_S + 1e-6, side="right") - 1
    valid = earlier >= 0
    spans = np.where(valid, clock - clock[earlier], np.nan)
    norms = np.linalg.norm(velocity - velocity[earlier], axis=1)
    return np.where(spans > 0.0, norms / np.where(spans > 0.0, spans, 1.0), np.nan)


def _errors(track: Columns, setpoints: Columns, stages: Mapping[str, tuple[float, float]]) -> Array:
    """Distance between each sample and the setpoint of that instant, in the stages that follow a plan."""
    errors = np.full(len(track["time_s"]), np.nan)
    if len(setpoints["time_s"]) < 2:
        return errors
    wanted = interpolated(track["time_s"], setpoints["time_s"], setpoints["position_enu_m"])
    distance = np.linalg.norm(track["position_enu_m"] - wanted, axis=1)
    for begin, end in (stages[name] for name in PLANNED_STAGES if name in stages):
        inside = (track["time_s"] >= begin) & (track["time_s"] <= min(end, setpoints["time_s"][-1]))
        errors[inside] = distance[inside]
    return errors


def _slowest_rate(setpoints: Columns) -> float | None:
    """Setpoints a second of the vehicle that was served worst [Hz]."""
    rates = []
    for vehicle in vehicles_in(setpoints):
        times = setpoints["time_s"][rows_of(setpoints, vehicle)]
        if len(times) > 1:
            rates.append((len(times) - 1) / (times[-1] - times[0]))
    return float(min(rates)) if rates else None
