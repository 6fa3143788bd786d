from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice, takewhile
from typing import Any

import numpy as np
import pytest

from fg_gcs.scenario.motions import Circle, Static, TrueMotion
from fg_gcs.scenario.sensor import Sensor, SensorSettings
from fg_gcs.track.sightings import Sighting

CIRCLE = Circle((0.0, 0.0, 15.0), 50.0, 4.0)
STILL = Static((1.0, 2.0, 3.0))


def sightings(sensor: Sensor, motion: TrueMotion) -> Iterator[Sighting]:
    return (measure.sighting for measure in sensor.measurements(motion) if measure.sighting is not None)


def until(seconds: float, settings: SensorSettings, seed: int = 0, target: str = "lead") -> list[Sighting]:
    return list(takewhile(lambda s: s.time_s < seconds, sightings(Sensor(target, settings, seed), CIRCLE)))


def test_an_exact_sensor_tells_the_truth_in_time() -> None:
    seen = until(30.0, SensorSettings(sigma_m=0.0))
    times = np.array([sighting.time_s for sighting in seen])
    assert times == pytest.approx(np.arange(300) / 10.0)
    assert np.array([s.position_enu_m for s in seen]) == pytest.approx(CIRCLE.at(times)[0])
    assert [s.received_s - s.time_s for s in seen] == pytest.approx([0.1] * 300)
    assert {s.target for s in seen} == {"lead"}


def test_noise_has_the_deviation_that_the_sighting_states() -> None:
    sensor = Sensor("lead", SensorSettings(sigma_m=0.5), 1)
    seen = list(islice(sightings(sensor, STILL), 4000))
    errors = np.array([sighting.position_enu_m for sighting in seen]) - STILL.position_enu_m
    # 4,000 draws: the mean is known to 0.008 m, deviations and correlations to some 2 %; four of those
    assert errors.mean(axis=0) == pytest.approx(0.0, abs=0.032)
    assert errors.std(axis=0) == pytest.approx(0.5, rel=0.05)
    assert np.asarray(np.corrcoef(errors.T)) == pytest.approx(np.eye(3), abs=0.064)
    assert seen[0].covariance_m2 == pytest.approx(0.25 * np.eye(3))


def test_shares_of_drops_and_outliers() -> None:
    settings = SensorSettings(sigma_m=0.0, drop=0.3, outliers=0.05, outlier_m=20.0)
    sensor = Sensor("lead", settings, 2)
    seen = list(islice(sightings(sensor, STILL), 4000))
    errors = np.linalg.norm(np.array([sighting.position_enu_m for sighting in seen]) - STILL.position_enu_m, axis=1)
    wild = errors > 1.0
    assert errors[wild] == pytest.approx(20.0)
    assert errors[~wild] == pytest.approx(0.0)
    assert wild.mean() == pytest.approx(0.05, abs=4.0 * math.sqrt(0.05 * 0.95 / 4000))
    measurements = round(seen[-1].time_s * 10.0) + 1
    assert 1.0 - 4000 / measurements == pytest.approx(0.3, abs=4.0 * math.sqrt(0.3 * 0.7 / measurements))


def test_nothing_is_seen_in_a_silence() -> None:
    times = [sighting.time_s for sighting in until(40.0, SensorSettings(silence_s=((20.0, 28.0), (30.0, 31.0))))]
    assert not [t for t in times if 20.0 <= t < 28.0 or 30.0 <= t < 31.0]
    assert len(times) == 400 - 80 - 10


@pytest.mark.parametrize("jitter_s", [0.02, 0.05, 0.4])
def test_jitter_moves_looks_and_keeps_the_order_of_arrival(jitter_s: float) -> None:
    seen = until(60.0, SensorSettings(sigma_m=0.0, jitter_s=jitter_s))
    times = np.array([sighting.time_s for sighting in seen])
    received = np.array([sighting.received_s for sighting in seen])
    assert (np.diff(received) >= 0.0).all()
    assert (times >= 0.0).all()
    # around the looks of an even rate, in their order, none is further away than the jitter
    assert np.abs(times - np.arange(len(times)) / 10.0).max() <= jitter_s + 1e-9
    assert np.array([s.position_enu_m for s in seen]) == pytest.approx(CIRCLE.at(times)[0])
    steps = np.diff(times)
    assert steps.std() > 0.3 * min(jitter_s, 0.1)


def positions(seen: list[Sighting]) -> dict[float, list[float]]:
    return {sighting.time_s: sighting.position_enu_m.tolist() for sighting in seen}


def test_seed_and_name_alone_decide() -> None:
    settings = SensorSettings(drop=0.2, outliers=0.1, jitter_s=0.01)
    assert positions(until(20.0, settings)) == positions(until(20.0, settings))
    assert positions(until(20.0, settings)) != positions(until(20.0, settings, seed=1))
    assert positions(until(20.0, settings)) != positions(until(20.0, settings, target="other"))
    sensor = Sensor("lead", settings, 0)
    first = list(islice(sightings(sensor, CIRCLE), 20))
    assert positions(first) == positions(list(islice(sightings(sensor, CIRCLE), 20)))


def test_what_fails_does_not_change_what_is_seen_otherwise() -> None:
    whole = positions(until(40.0, SensorSettings()))
    holed = positions(until(40.0, SensorSettings(drop=0.4, silence_s=((3.0, 5.0),))))
    assert holed.items() < whole.items()


def test_looks_one_by_one_are_those_of_the_whole() -> None:
    settings = SensorSettings(drop=0.2, outliers=0.1)
    sensor = Sensor("lead", settings, 5)
    times = np.arange(100) / 10.0
    looked = [sensor.measure(t, p) for t, p in zip(times.tolist(), CIRCLE.at(times)[0], strict=True)]
    shown = [sighting for sighting in looked if sighting is not None]
    # but for the jitter's draw, which a look from outside does not take
    assert 60 < len(shown) < 95
    assert all(sighting.received_s == pytest.approx(sighting.time_s + 0.1) for sighting in shown)
    again = Sensor("lead", settings, 5)
    assert positions(shown) == positions(
        [s for t, p in zip(times.tolist(), CIRCLE.at(times)[0], strict=True) if (s := again.measure(t, p)) is not None]
    )


@pytest.mark.parametrize("blind", [{"drop": 1.0}, {"silence_s": ((0.0, 1e9),)}])
def test_a_blind_sensor_goes_on_looking(blind: dict[str, Any]) -> None:
    measurements = list(islice(Sensor("lead", SensorSettings(**blind), 0).measurements(CIRCLE), 50))
    assert [measure.sighting for measure in measurements] == [None] * 50
    assert [measure.received_s for measure in measurements] == pytest.approx([0.1 + k / 10.0 for k in range(50)])


@pytest.mark.parametrize("wrong", [{"rate_hz": 0.0}, {"sigma_m": -1.0}, {"drop": 1.5}, {"delay_s": math.nan}])
def test_sensors_that_are_none_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        SensorSettings(**wrong)
