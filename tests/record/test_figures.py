from collections.abc import Sequence

import numpy as np
import pytest

from fg_gcs.core.coverage import flux_metric
from fg_gcs.record.evaluate.figures import Whereabouts, figures, flown
from fg_gcs.record.write.layouts import SETPOINTS, TELEMETRY, TICKS, Columns
from fg_gcs.wire.address import MAIN, VehicleAddress
from tests.record.flights import STAGES, TARGET, Circle, columns_of, instants, main, told

LEADERS = main(1, 2, 3, 4)
STANDING = Whereabouts.standing(np.array(TARGET))
NAMES = {
    "flown_flux_metric",
    "flown_peak_speed_m_s",
    "flown_peak_acceleration_m_s2",
    "flown_min_separation_m",
    "tracking_rms_m",
    "tracking_max_m",
    "setpoint_rate_hz",
    "setpoint_late_p99_ms",
}


def measured(
    telemetry: Columns, setpoints: Columns, ticks: Columns, leaders: Sequence[VehicleAddress] = LEADERS
) -> dict[str, float | None]:
    series = flown(telemetry, setpoints, STAGES, leaders, STANDING)
    return figures(series, ticks, setpoints, STAGES)


@pytest.mark.parametrize("circle", [Circle(), Circle(7, 6.0, 1.2), Circle(4, 2.0, 0.3)])
@pytest.mark.parametrize("rate_hz", [20.0, 50.0])
def test_circles_have_the_figures_of_circles(circle: Circle, rate_hz: float) -> None:
    found = measured(*columns_of(circle, rate_hz, offset_m=0.25), leaders=main(*range(1, circle.vehicles + 1)))
    assert found.keys() == NAMES
    assert found["flown_peak_speed_m_s"] == pytest.approx(circle.speed_m_s)
    # The mean over 0.1 s of a turning acceleration is smaller by (w t)^2 / 24, 0.06 % at 1.2 rad/s
    assert found["flown_peak_acceleration_m_s2"] == pytest.approx(circle.acceleration_m_s2, rel=1e-3)
    # Between the common instants a chord lies inside its arc by (w t)^2 / 8, 0.05 % at 20 Hz
    assert found["flown_min_separation_m"] == pytest.approx(circle.separation_m, rel=1e-3)
    assert found["tracking_rms_m"] == pytest.approx(0.25)
    assert found["tracking_max_m"] == pytest.approx(0.25)
    assert found["flown_flux_metric"] == pytest.approx(1.0)  # the target lies in the plane of the face
    assert found["setpoint_rate_hz"] == pytest.approx(rate_hz)
    assert found["setpoint_late_p99_ms"] == pytest.approx(9.0)


@pytest.mark.parametrize("seed", range(5))
def test_accelerations_survive_clocks_that_cut_off_their_milliseconds(seed: int) -> None:
    random = np.random.default_rng(seed)
    circle = Circle(rate_rad_s=1.0)
    time_s = np.cumsum(random.uniform(0.005, 0.03, size=600)) + 0.5
    boot_s = np.floor((time_s + 12.3456) * 1e3) / 1e3
    telemetry = TELEMETRY.table(circle.telemetry(time_s, boot_s))
    series = flown(telemetry, SETPOINTS.table([]), STAGES, LEADERS, STANDING)
    assert series is not None
    for acceleration in series.acceleration_m_s2:
        known = acceleration[np.isfinite(acceleration)]
        assert len(known) > 580
        assert known == pytest.approx(circle.acceleration_m_s2, rel=0.02)


def test_two_vehicles_that_pass_between_two_samples() -> None:
    telemetry = []
    for now_s in np.arange(-0.75, 1.0, 0.5).tolist():  # never sampled where they pass, at 0
        for system_id, side in ((1, 1.0), (2, -1.0)):
            place = (side * 4.0 * now_s, side * 0.6, 10.0)
            telemetry.append((now_s, MAIN, system_id, *place, side * 4.0, 0.0, 0.0, 0.0, now_s, 10.0))
    found = measured(TELEMETRY.table(telemetry), SETPOINTS.table([]), TICKS.table([]), leaders=())
    assert found["flown_min_separation_m"] == pytest.approx(1.2)
    assert found["flown_flux_metric"] is None or np.isnan(found["flown_flux_metric"])


def test_errors_count_in_planned_stages_only() -> None:
    telemetry, setpoints, _ = columns_of(Circle())
    outside = (setpoints["time_s"] < STAGES["gather"][0] - 0.1) | (setpoints["time_s"] > STAGES["home"][1] + 0.1)
    setpoints["position_enu_m"][outside] += 100.0  # on the ground, and while landing, setpoints mean nothing
    series = flown(telemetry, setpoints, STAGES, LEADERS, STANDING)
    assert series is not None
    for time_s, error in zip(series.own_time_s, series.error_m, strict=True):
        planned = (time_s >= STAGES["gather"][0]) & (time_s <= STAGES["home"][1])
        assert np.array_equal(np.isfinite(error), planned)
        assert error[planned] == pytest.approx(0.25)


def test_peaks_outside_the_planned_stages_do_not_count() -> None:
    telemetry, setpoints, ticks = columns_of(Circle())
    row = int(np.searchsorted(telemetry["time_s"], 1.0))
    telemetry["velocity_enu_m_s"][row] = (90.0, 0.0, 0.0)
    assert STAGES["take-off"][0] < telemetry["time_s"][row] < STAGES["take-off"][1]
    found = measured(telemetry, setpoints, ticks)
    assert found["flown_peak_speed_m_s"] == pytest.approx(Circle().speed_m_s)
    assert found["flown_peak_acceleration_m_s2"] == pytest.approx(Circle().acceleration_m_s2, rel=1e-3)


def test_the_metric_is_that_of_the_leaders_in_their_order() -> None:
    telemetry, setpoints, _ = columns_of(Circle(8))
    leaders = main(7, 1, 3, 5)
    away = np.array(TARGET) + np.array([9.0, 0.0, 0.0])
    series = flown(telemetry, setpoints, STAGES, leaders, Whereabouts.standing(away))
    assert series is not None
    assert series.flux_metric == pytest.approx(flux_metric(series.position_m[:, [6, 0, 2, 4]], away))
    assert 0.0 < series.flux_metric.min() < 0.5
    assert series.coverage == pytest.approx(1.0)  # right in front of the face
    behind = flown(telemetry, setpoints, STAGES, leaders[::-1], Whereabouts.standing(away))
    assert behind is not None
    assert behind.coverage.max() == 0.0


def test_equal_ids_of_two_networks_are_two_vehicles() -> None:
    telemetry, setpoints, ticks = columns_of(Circle(4), offset_m=0.25)
    whole = measured(telemetry, setpoints, ticks)
    telemetry, setpoints = (
        dict(columns)
        | {
            "network": np.where(columns["system_id"] <= 2, "east", "west"),
            "system_id": (columns["system_id"] - 1) % 2 + 1,
        }
        for columns in (telemetry, setpoints)
    )
    leaders = [VehicleAddress(network, system_id) for network in ("east", "west") for system_id in (1, 2)]
    assert measured(telemetry, setpoints, ticks, leaders) == whole
    series = flown(telemetry, setpoints, STAGES, leaders, STANDING)
    assert series is not None
    assert series.vehicles == tuple(leaders)


def test_the_slowest_vehicle_counts_for_the_rate() -> None:
    served = [(k, system_id) for k in range(101) for system_id in (1, 2, 3)[: 3 if k % 4 == 0 else 2]]
    setpoints = SETPOINTS.table(told(system_id, k * 0.02) for k, system_id in served)
    assert measured(TELEMETRY.table([]), setpoints, TICKS.table([]))["setpoint_rate_hz"] == pytest.approx(12.5)


def test_nothing_to_measure() -> None:
    found = measured(TELEMETRY.table([]), SETPOINTS.table([]), TICKS.table([]), leaders=())
    assert found == dict.fromkeys(NAMES)


def test_vehicles_that_share_no_time_make_no_series() -> None:
    heard = ((1, 0.0), (1, 1.0), (2, 2.0), (2, 3.0))
    telemetry = TELEMETRY.table((now_s, MAIN, system_id, *[0.0] * 9) for system_id, now_s in heard)
    assert flown(telemetry, SETPOINTS.table([]), STAGES, LEADERS, STANDING) is None


def test_a_vehicle_lost_on_the_way_ends_the_common_series_but_not_the_others_own() -> None:
    telemetry, setpoints, _ = columns_of(Circle())
    kept = (telemetry["system_id"] != 3) | (telemetry["time_s"] < 6.0)
    cut = {name: column[kept] for name, column in telemetry.items()}
    series = flown(cut, setpoints, STAGES, LEADERS, STANDING)
    assert series is not None
    assert series.time_s[-1] < 6.0
    assert [times[-1] > 15.0 for times in series.own_time_s] == [True, True, False, True, True]
    assert series.separation_m == pytest.approx(Circle().separation_m, rel=1e-3)


@pytest.mark.parametrize("silent", range(1, 6))
def test_a_vehicle_that_was_never_heard_shifts_nobody_elses_figures(silent: int) -> None:
    whole, setpoints, ticks = columns_of(Circle())
    heard = whole["system_id"] != silent
    rest = {name: column[heard] for name, column in whole.items()}
    leaders = main(4, 1, 3, 2)  # an order of their own, so that a wrong row gives a wrong face
    away = Whereabouts.standing(np.array(TARGET) + np.array([9.0, 0.0, 0.0]))
    before, after = (flown(telemetry, setpoints, STAGES, leaders, away) for telemetry in (whole, rest))
    assert before is not None
    assert after is not None
    assert np.isfinite(before.flux_metric).all()
    kept = [row for row in range(5) if row + 1 != silent]
    assert after.vehicles == main(*(row + 1 for row in kept))
    assert np.array_equal(after.position_m, before.position_m[:, kept])
    for name in ("own_time_s", "speed_m_s", "acceleration_m_s2", "airborne", "error_m"):
        for now, row in zip(getattr(after, name), kept, strict=True):
            assert np.array_equal(now, getattr(before, name)[row], equal_nan=now.dtype.kind == "f"), name
    found, full = (figures(series, ticks, setpoints, STAGES) for series in (after, before))
    if main(silent)[0] in leaders:  # a face without one of its corners is another face
        assert np.isnan(after.flux_metric).all()
        assert np.isnan(after.coverage).all()
        assert found["flown_flux_metric"] is None
        assert after.places_m(leaders) is None
    else:
        assert np.array_equal(after.flux_metric, before.flux_metric)
        assert np.array_equal(after.coverage, before.coverage)
        assert found["flown_flux_metric"] == full["flown_flux_metric"]
    for name in ("flown_peak_speed_m_s", "tracking_rms_m", "setpoint_rate_hz", "setpoint_late_p99_ms"):
        assert found[name] == pytest.approx(full[name])  # all fly the same circle


def test_instants_lie_inside_every_stage() -> None:
    assert instants()[0] <= STAGES["take-off"][0]
    assert instants()[-1] > STAGES["home"][1]
